"""The commands of ``dextar``: each module has SUMMARY, DESCRIPTION, ``add_arguments`` and ``run``; none imports ROS at once."""

from __future__ import annotations

EXIT_FAILED = 1
EXIT_USAGE = 2
