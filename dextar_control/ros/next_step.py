"""What to call from where a controller stands so that it holds the robot, in words that a refusal ends with."""

from __future__ import annotations


def next_step(controller: str, lifecycle: str, phase: str, enabling: str = "") -> str:
    """The calls that lead to phase HOLD; empty where it holds already.

    Args:
        controller: the node's full name, as its services bear it.
        lifecycle: its state.
        phase: of its loop.
        enabling: as its diagnostics tell it.
    """
    if lifecycle != "active":
        steps = {"unconfigured": ("configure", "activate"), "inactive": ("activate",)}.get(lifecycle, ())
        calls = ", then ".join(f"ros2 lifecycle set {controller} {step}" for step in steps)
        return f"type {calls}" if calls else "start another controller" if lifecycle == "finalized" else "wait, then ask again"
    enable = f"{controller}/enable with data true"
    if phase == "IDLE":
        return "wait until it enables by itself" if enabling == "waiting" else f"call {enable}"
    if phase == "SAFE_STOP":
        return f"once the robot rests call {controller}/reset, then {enable}"
    if phase == "FAULT":
        return f"call {controller}/reset, then {enable}"
    return "" if phase == "HOLD" else f"wait until it holds, or call {controller}/stop"
