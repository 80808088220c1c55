"""A DDS domain of one's own, so that two runs on one machine do not hear each other."""

from __future__ import annotations

import fcntl
import os
import random
import tempfile
from typing import IO

from dextar_control.contract.errors import DextarError

DOMAINS = range(1, 100)
"""All of them leave their ports below those that Linux gives to others."""

_held: list[IO[str]] = []  # locks, for as long as the process lives


def own_domain() -> int:
    """A domain that no other process has by this function, until this one ends.

    Raises:
        DextarError: all are taken.
    """
    for number in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        path = os.path.join(tempfile.gettempdir(), f"dextar-domain-{number}.lock")
        try:
            lock = open(path, "a")  # noqa: SIM115
        except OSError:  # somebody else's
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            continue
        _held.append(lock)
        return number
    raise DextarError(f"all {len(DOMAINS)} DDS domains are taken by other runs on this machine; set ROS_DOMAIN_ID to share one")


def choose_domain() -> str:
    """``ROS_DOMAIN_ID`` as it is set, or else set to one of one's own."""
    if "ROS_DOMAIN_ID" not in os.environ:
        os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    return os.environ["ROS_DOMAIN_ID"]
