"""A run can take a DDS domain of its own, so that two runs on one machine do not hear
each other.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import tempfile

from dextar_control.contract.errors import DextarError

DOMAINS = range(1, 100)
"""The ports of these domains lie below those that Linux gives to others."""

_held: list[int] = []  # descriptors of locks, for as long as the process lives


def own_domain() -> int:
    """Return a domain that no other process has by this function, until this one ends.

    Raises:
        DextarError: all are taken, or there is no temporary folder.
    """
    try:
        folder = tempfile.gettempdir()
    except OSError as error:
        raise DextarError(
            "no temporary folder can be written, to mark a domain as taken; set"
            " ROS_DOMAIN_ID or TMPDIR"
        ) from error
    for number in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        lock = _opened(os.path.join(folder, f"dextar-domain-{number}.lock"))
        if lock is None:
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        _held.append(lock)
        return number
    raise DextarError(
        f"all {len(DOMAINS)} DDS domains are taken by other runs on this machine; set"
        " ROS_DOMAIN_ID to share one"
    )


def _opened(path: str) -> int | None:
    """Return the descriptor of a lock file, made where it does not exist. Another
    user's file, which may only be read, can be locked as well.
    """
    for flags in (os.O_RDWR | os.O_CREAT, os.O_RDONLY):
        with contextlib.suppress(OSError):
            return os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    return None


def discovery() -> str:
    """Return the DDS domain and how far discovery reaches, in words."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    return f"ROS_DOMAIN_ID {os.environ.get('ROS_DOMAIN_ID', '0')}, discovery {reach}"


def choose_domain() -> str:
    """Return ``ROS_DOMAIN_ID``, set to a domain of this process's own where it was not
    set.
    """
    if "ROS_DOMAIN_ID" not in os.environ:
        os.environ["ROS_DOMAIN_ID"] = str(own_domain())
    return os.environ["ROS_DOMAIN_ID"]
