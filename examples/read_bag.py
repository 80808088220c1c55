"""Read a recorded run in Python and plot its error around each crossing.

``make demo`` records one. The bag alone is enough: it holds the robot, the parameters,
the plan, and in simulation the truth.

Run it with ``.venv/bin/python examples/read_bag.py [BAG] [FIGURE]``.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

from dextar_control import compute_metrics, load_run
from dextar_control.analysis.tracking import tracked

BESIDE = 0.1  # s, before and after a crossing


def main(bag: str = "runs/latest", file: str = "crossings.png") -> None:
    """Print a line about each crossing and write the figure."""
    run = load_run(bag)
    metrics, track = compute_metrics(run), tracked(run)
    if track is None:
        raise SystemExit(f"{bag}: no trajectory was tracked")
    true = len(track.true_time) > 0
    time, error = (
        (track.true_time, track.true_error)
        if true
        else (track.time, track.estimated_error)
    )

    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for number, crossing in enumerate(metrics.crossings, start=1):
        since = time - crossing.planned_time  # s
        near = np.abs(since) <= BESIDE
        label = f"crossing {number}: {crossing.outcome or crossing.verdict}"
        axes.plot(1e3 * since[near], 1e3 * error[near], label=label)
        print(
            f"{label}, error {1e3 * np.nanmax(error[near], initial=0.0):.3f} mm at most"
        )
    axes.set(
        xlabel="time since the planned crossing (ms)",
        ylabel=f"{'true' if true else 'estimated'} error (mm)",
    )
    axes.axvline(0.0, linestyle=":", color="grey")
    figure.legend(loc="outside right upper")
    figure.savefig(file)
    print(f"{bag}: law {metrics.law}, estimator {metrics.estimator}; drawn in {file}")


if __name__ == "__main__":
    main(*sys.argv[1:])
