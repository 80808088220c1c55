"""What a loop asks of the kernel, and what is said where that is not permitted; in a
process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys

from patience import PATIENCE

PLAIN = {"thread_priority": 0, "cpu_affinity": [], "lock_memory": False}
ASK = """
import os, resource, threading
from dextar_control.nodekit.scheduling import ask_kernel
import ctypes
{before}
stay = threading.Event()
thread = threading.Thread(target=stay.wait)
thread.start()
told = []
ask_kernel({values}, told.append)
print(sorted(os.sched_getaffinity(thread.native_id)))
print("\\n".join(told))
stay.set()
"""
UNPRIVILEGED = (
    "os.setuid(65534) if os.getuid() == 0 else None;"
    " resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))"
)


def ask(before: str = "", **values: object) -> list[str]:
    code = ASK.format(before=before, values=repr(PLAIN | values))
    answer = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE,
    )
    return answer.stdout.strip().splitlines()


def test_nothing_is_asked_for_by_default() -> None:
    assert len(ask()) == 1


def test_the_threads_that_there_are_run_on_the_processors_that_were_asked_for() -> None:
    first = int(ask()[0].strip("[]").split(",")[0])
    assert ask(cpu_affinity=[float(first)]) == [f"[{first}]"]


def test_each_wish_that_is_not_permitted_costs_one_warning_and_nothing_else() -> None:
    _, affinity, priority, memory = ask(
        UNPRIVILEGED, thread_priority=50, cpu_affinity=[4095.0], lock_memory=True
    )
    assert ask(cpu_affinity=[-1.0])[1].startswith(
        "cpu_affinity [-1] cannot be had: negative CPU number; processors here: "
    )
    assert affinity.startswith(
        "cpu_affinity [4095] cannot be had: Invalid argument; processors here: "
    )
    assert priority.startswith(
        "thread_priority 50 (SCHED_FIFO) cannot be had: Operation not permitted; give"
        " the user rtprio"
    )
    assert memory.startswith("lock_memory cannot be had: ")


def test_who_stands_back_is_run_in_batches_unless_the_user_chose_another_way() -> None:
    code = """
import os
{}
from dextar_control.nodekit.scheduling import stand_back
stand_back()
print(os.sched_getscheduler(0))
"""
    for chosen, found in (
        ("", "SCHED_BATCH"),
        ("os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))", "SCHED_IDLE"),
    ):
        command = [sys.executable, "-c", code.format(chosen)]
        answer = subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=PATIENCE
        )
        assert int(answer.stdout) == getattr(os, found)
