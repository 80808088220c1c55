"""Compile the functions that controller and planner call: ``python -m
dextar_control.control.prepare``.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ThreadPoolExecutor

from dextar_control.contract.resources import ROBOT_FILE, config_file
from dextar_control.contract.robot import load_robot
from dextar_control.contract.signals import run_command, tell
from dextar_control.control.reference import references_of
from dextar_control.control.safe_stop import stops_of
from dextar_control.control.supervisor import acts_of
from dextar_control.estimation.direct import direct_of
from dextar_control.estimation.filters import filters_of
from dextar_control.estimation.joint_filter import joint_filter_of
from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.model import Model, library_of
from dextar_control.planning.model import planning_library, states_library

ALWAYS = (
    library_of,
    acts_of,
    filters_of,
    direct_of,
    joint_filter_of,
    stops_of,
    references_of,
)
WHERE_PLANNED = planning_library, states_library


def prepare(mechanism: Mechanism) -> bool:
    """Load the functions of a mechanism, compiled in parallel unless the cache has
    them; whether they are compiled.
    """
    makers = (*WHERE_PLANNED, *ALWAYS) if isinstance(mechanism, FiveBar) else ALWAYS
    with ThreadPoolExecutor() as pool:
        libraries = list(pool.map(lambda make: make(mechanism), makers))
    return all(library.compiled for library in libraries)


def main(arguments: list[str] | None = None) -> int:
    """Run the console entry: prepare and print the time it took; interrupted, it
    returns 128 + the signal's number.
    """
    parser = argparse.ArgumentParser(
        prog="warmup",
        description=(
            "Compile the equations of the model, so that the nodes start at once. No"
            " topics, services or parameters."
        ),
    )
    parser.parse_args(arguments)
    return run_command("warmup", _prepare)


def _prepare() -> int:
    begin = time.perf_counter()
    compiled = prepare(Model.of(load_robot(config_file(ROBOT_FILE))).mechanism)
    tell(
        f"equations {'compiled' if compiled else 'interpreted'}, ready in"
        f" {time.perf_counter() - begin:.1f} s",
        sys.stdout,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
