"""A recorded run: load it, compute its metrics, draw it.

>>> from dextar_control.analysis import compute_metrics, load_run  # doctest: +SKIP
>>> run = load_run("runs/latest/run.mcap")  # arrays with stamps: a ``Run``
>>> metrics = compute_metrics(run)  # numbers: a ``Metrics``
>>> metrics.rms_true_error  # m

Figures, report, comparison, animation and tables are functions of the two.
"""

from dextar_control.analysis.compute import compute_metrics
from dextar_control.analysis.load import load_run
from dextar_control.analysis.metrics import Metrics
from dextar_control.analysis.run import Run

__all__ = ["Metrics", "Run", "compute_metrics", "load_run"]
