"""A refusal ends with what a user does next, from where the controller stands, so that
it takes a trip.
"""

from __future__ import annotations

from collections.abc import Mapping

from dextar_control.contract.topics import DIAGNOSTICS


def next_step(controller: str, lifecycle: str, phase: str, enabling: str = "") -> str:
    """Return the commands that lead to phase HOLD; empty where it holds already.

    Args:
        controller: the node's full name, as its services bear it.
        lifecycle: its state.
        phase: of its loop.
        enabling: as its diagnostics tell it.
    """
    if lifecycle != "active":
        if lifecycle == "finalized":
            return "start another controller"
        steps = {
            "unconfigured": ("configure", "activate"),
            "inactive": ("activate",),
        }.get(lifecycle)
        if steps is None:  # a transition is under way
            return "wait, then ask again"
        calls = (f"ros2 lifecycle set {controller} {step}" for step in steps)
        return f"type {', then '.join(calls)}"
    enable, reset = command(controller, "enable"), command(controller, "reset")
    if phase == "IDLE":
        if enabling == "waiting":
            return "wait until it enables by itself"
        return f"type {enable}"
    if phase == "SAFE_STOP":
        return f"once the robot rests type {reset}, then {enable}"
    if phase == "FAULT":
        return f"type {reset}, then {enable}"
    if phase == "HOLD":
        return ""
    return f"wait until it holds, or type {command(controller, 'stop')}"


def command(controller: str, name: str) -> str:
    """Return a command of ``dextar`` for the robot of this controller's namespace."""
    namespace = controller.rpartition("/")[0]
    return f"dextar {name} --namespace {namespace}" if namespace else f"dextar {name}"


def why_not(controller: str, told: Mapping[str, str]) -> str:
    """Return why a controller would not take a trajectory now, as far as it has told;
    empty when it would.

    It takes one while it holds, and while it waits to enable itself.

    Args:
        controller: the node's full name.
        told: the values of its diagnostics; empty before the first.
    """
    if not told:
        return f"no word of {controller} on {DIAGNOSTICS.name}; see that it runs"
    lifecycle, phase = told.get("lifecycle", "active"), told.get("phase", "")
    enabling, reason = told.get("enabling", ""), told.get("reason", "")
    step = next_step(controller, lifecycle, phase, enabling)
    if lifecycle != "active":
        return f"the controller is {lifecycle}; a trip needs an active one: {step}"
    if phase == "HOLD" or (phase == "IDLE" and enabling == "waiting"):
        return ""
    second = told.get("other_commanders") or told.get("state_publishers") or ""
    if second in reason:
        second = ""
    why = "; ".join(filter(None, (reason, second)))
    return (
        f"the controller is in phase {phase}{f' ({why})' if why else ''}; a trip starts"
        f" from HOLD: {step}"
    )
