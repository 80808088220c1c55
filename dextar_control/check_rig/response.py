"""What the robot did under a trial's torques is judged here."""

from __future__ import annotations

import numpy as np

from dextar_control.check_rig.limits import EFFORT_SHARE, MIN_DOUBLET, MIN_MOVE, Limits
from dextar_control.check_rig.report import CheckLine, failed, judged, skipped
from dextar_control.check_rig.samples import (
    NANOSECOND,
    Array,
    by_name,
    joint_angles,
    times,
)
from dextar_control.check_rig.trial import Torque, TorqueTrial
from dextar_control.contract.robot import JOINT_NAMES

SETTLED = 0.5  # of a pulse, after which the effort counts
FEW = 3  # states of a pulse that are needed after that


def response_line(trial: TorqueTrial, limits: Limits) -> CheckLine:
    """Return the line ``response`` of a doublet's joint: its effort, and its movement
    in the torque's direction.
    """
    joint = JOINT_NAMES[trial.joint]
    name, tolerance = f"response {joint}", EFFORT_SHARE * limits.torque
    wanted = (
        f"effort ± {tolerance:.2g} N m; moves its way by {1e3 * MIN_MOVE:g} mrad or"
        " more"
    )
    if trial.trouble:
        return failed(name, trial.trouble, wanted)
    if len(trial.samples) < MIN_DOUBLET:
        return failed(name, f"only {len(trial.samples)} states", wanted)
    up, down, noise = movements(trial)
    limit = max(MIN_MOVE, noise)
    efforts = [_effort_at(trial, segment) for segment in ("up", "down")]
    follows = all(
        _follows(effort, trial.joint, sign * limits.torque, tolerance)
        for effort, sign in zip(efforts, (1.0, -1.0), strict=True)
        if effort is not None
    )
    parts = [
        f"{sign}: "
        + ("no effort" if effort is None else f"effort {effort[trial.joint]:+.4f} N m")
        + f", {1e3 * move:+.2f} mrad"
        for sign, effort, move in (("+", efforts[0], up), ("-", efforts[1], -down))
    ]
    text = "; ".join(parts)
    if not (up >= limit and down >= limit):
        wrong_way = up <= -limit and down <= -limit
        text += (
            ": the other way" if wrong_way else ": hardly moves (friction? --torque)"
        )
    elif not follows:
        text += ": effort does not follow"
    return judged(
        up >= limit and down >= limit and follows,
        name,
        text,
        wanted,
        up=up,
        down=-down,
        noise=noise,
    )


def movements(trial: TorqueTrial) -> tuple[float, float, float]:
    """Return (up, down, noise), rad: what the first pulse, by + and by - torque each,
    moves the joint in the torque's direction.

    Positions are fitted by a drift and the torques integrated twice, + and - apart;
    noise is what the fit leaves.
    """
    kept, q_a = joint_angles(trial.samples)
    answer = dict(
        zip((id(sample) for sample in trial.samples), trial.answers, strict=True)
    )
    commands: list[Torque | None] = [answer[id(sample)] for sample in kept]
    # NaN is refused, which gives no torque.
    torque = np.nan_to_num(
        [0.0 if command is None else command[trial.joint] for command in commands]
    )
    t = times(kept)
    # What one pulse of both integrals comes to.
    one = 0.5 * trial.limits.torque * trial.limits.pulse**2
    shapes = [
        _twice(t, np.maximum(torque, 0.0)) / one,
        _twice(t, np.minimum(torque, 0.0)) / one,
    ]
    columns = np.stack([np.ones_like(t), t, *shapes], axis=-1)
    solution, *_ = np.linalg.lstsq(columns, q_a[:, trial.joint], rcond=None)
    noise = float(np.sqrt(np.mean((q_a[:, trial.joint] - columns @ solution) ** 2)))
    return float(solution[2]), float(solution[3]), noise


def _twice(t: Array, held: Array) -> Array:
    """Return the double integral of a quantity that is held from each instant to the
    next.
    """
    dt = np.diff(t)
    first = np.concatenate([[0.0], np.cumsum(held[:-1] * dt)])
    return np.concatenate([[0.0], np.cumsum(first[:-1] * dt + 0.5 * held[:-1] * dt**2)])


def _effort_at(trial: TorqueTrial, segment: str) -> Array | None:
    """Return the median efforts of both motors, (2,), N m, in the settled part of a
    segment; None when there are none.
    """
    _, efforts = by_name(trial.of(segment, SETTLED), "effort")
    return np.median(efforts, axis=0) if len(efforts) >= FEW else None


def _follows(effort: Array, joint: int, torque: float, tolerance: float) -> bool:
    wanted = np.zeros(2)
    wanted[joint] = torque
    return bool((np.abs(effort - wanted) <= tolerance).all())


def watchdog_line(trial: TorqueTrial, limits: Limits) -> CheckLine:
    """Return the line ``watchdog`` of a silence."""
    limit = (
        f"{1e3 * limits.watchdog_limit:.1f} ms ({1e3 * limits.watchdog:g} declared, and"
        " the way)"
    )
    tolerance = EFFORT_SHARE * limits.torque
    before, silent = _effort_at(trial, "up"), trial.of("silent")
    if before is None or not _follows(before, trial.joint, limits.torque, tolerance):
        if trial.trouble:
            return failed("watchdog", trial.trouble, limit)
        return skipped("watchdog", "no effort was there to take away")
    kept, efforts = by_name(silent, "effort")
    on = [
        sample
        for sample, effort in zip(kept, efforts, strict=True)
        if (np.abs(effort) > tolerance).any()
    ]
    off = [sample for sample in kept if not on or sample.arrival > on[-1].arrival]
    if off and not trial.trouble:
        after = NANOSECOND * (off[0].arrival - trial.sent)
        text = f"gone {1e3 * after:.1f} ms after the last command"
        ok = after <= limits.watchdog_limit
        return judged(ok, "watchdog", text, limit, time=after, gone=1.0)
    seen = NANOSECOND * (kept[-1].arrival - trial.sent) if kept else 0.0
    left = np.abs(efforts[-1:]).max(initial=0.0)
    text = f"still {left:.4f} N m {1e3 * seen:.0f} ms after the last command"
    if trial.trouble:
        text += f"; {trial.trouble}"
    return failed("watchdog", text, limit, time=seen, gone=0.0)


def nan_line(trial: TorqueTrial, limits: Limits, *, responds: bool) -> CheckLine:
    """Return the line ``refuses NaN``.

    Args:
        trial: of ``nan_and_on``.
        limits: of the check.
        responds: whether its joint was seen to follow a torque before.
    """
    tolerance = EFFORT_SHARE * limits.torque
    wanted = f"effort below {tolerance:.2g} N m, finite numbers, then follows again"
    rest, under = trial.of("rest"), trial.of("nan")
    told = [
        field for field in ("position", "velocity", "effort") if by_name(rest, field)[0]
    ]  # what is NaN anyway tells nothing
    finite = [{id(sample) for sample in by_name(under, field)[0]} for field in told]
    odd = sum(any(id(sample) not in good for good in finite) for sample in under)
    worst = float(np.abs(by_name(under, "effort")[1]).max(initial=0.0))
    effort = (
        f"effort at most {worst:.4f} N m" if "effort" in told else "no effort is told"
    )
    text = f"under NaN: {effort}, {odd} of {len(under)} states not finite"
    ok = False
    if trial.trouble:
        text += f"; {trial.trouble}"
    elif odd or worst > tolerance or len(under) < FEW:
        pass  # told already
    elif not responds:
        ok, text = True, f"{text}; states go on"
    elif (after := _effort_at(trial, "up")) is None:
        ok, text = movements(trial)[0] >= MIN_MOVE, f"{text}; moves again"
    else:
        ok = _follows(after, trial.joint, limits.torque, tolerance)
        text += f"; then effort {after[trial.joint]:+.4f} N m on {limits.torque:+.4f}"
    return judged(ok, "refuses NaN", text, wanted, effort=worst, odd=odd)
