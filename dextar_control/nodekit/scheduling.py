"""A process can ask the kernel for precise timers, priority, processors and memory. No
ROS here.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Callable, Mapping

from dextar_control.contract.plain_data import ParameterValue

PR_SET_TIMERSLACK = 29  # of Linux' prctl
MCL_CURRENT, MCL_FUTURE = 1, 2  # of mlockall
REALTIME_LIMITS = "give the user rtprio and memlock in /etc/security/limits.conf"


def precise_timers() -> None:
    """Have the kernel end this thread's sleeps when they are over; by default they may
    last 0.05 ms longer.
    """
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def stand_back() -> None:
    """Have the kernel run this process, with the threads that begin later, without
    interrupting another when it has work to do.

    A process that is scheduled in another way than usual stays so.
    """
    if os.sched_getscheduler(0) == os.SCHED_OTHER:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def ask_kernel(
    values: Mapping[str, ParameterValue], warn: Callable[[str], object]
) -> None:
    """Ask for the priority, processors and memory that a node's parameters name, for
    all threads that the process has.

    What is not permitted costs one warning, and the node runs on without it. Threads
    that begin later, such as the one that checks a trajectory, have the usual priority.

    Args:
        values: of ``thread_priority`` (0 is the usual scheduling), ``cpu_affinity``
            (empty is any processor), ``lock_memory``.
        warn: told what is not permitted.
    """
    threads = [int(name) for name in os.listdir("/proc/self/task")]
    priority = values["thread_priority"]
    processors = [int(number) for number in values["cpu_affinity"]]
    if processors:
        try:
            for thread in threads:
                os.sched_setaffinity(thread, processors)
        # Python itself refuses a negative number.
        except (OSError, ValueError, OverflowError) as error:
            there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
            why = getattr(error, "strerror", None) or error
            warn(
                f"cpu_affinity {processors} cannot be had: {why}; processors here:"
                f" {there}"
            )
    if priority:
        try:
            for thread in threads:
                os.sched_setscheduler(
                    thread,
                    os.SCHED_FIFO | os.SCHED_RESET_ON_FORK,
                    os.sched_param(priority),
                )
        except OSError as error:
            warn(
                f"thread_priority {priority} (SCHED_FIFO) cannot be had:"
                f" {error.strerror}; {REALTIME_LIMITS}"
            )
    if values["lock_memory"] and ctypes.CDLL(None, use_errno=True).mlockall(
        MCL_CURRENT | MCL_FUTURE
    ):
        warn(
            f"lock_memory cannot be had: {os.strerror(ctypes.get_errno())};"
            f" {REALTIME_LIMITS}"
        )
