"""Each module is a command of ``dextar`` with SUMMARY, DESCRIPTION, ``add_arguments``
and ``run``; none imports ROS at once.
"""

from __future__ import annotations

from dextar_control.contract.signals import EXIT_FAILED as EXIT_FAILED
from dextar_control.contract.signals import EXIT_USAGE as EXIT_USAGE
