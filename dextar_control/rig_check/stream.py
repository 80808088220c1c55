"""Judges a driver by what it publishes, without commanding it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dextar_control.contract.robot import JOINT_NAMES, RobotParameters
from dextar_control.rig_check.limits import (
    MIN_STATES,
    VELOCITY_FLOOR,
    VELOCITY_MISSES,
    VELOCITY_SHARE,
    VELOCITY_WINDOW,
    Limits,
)
from dextar_control.rig_check.report import Line, failed, judged, passed, skipped
from dextar_control.rig_check.samples import NANOSECOND, Array, Endpoint, Graph, Sample, by_name, times

STREAM_LINES = (
    "joint names", "array sizes", "finite numbers", "rate", "jitter", "longest gap", "stamps rise", "stamp age", "stamp period",
    "closes", "velocity", "effort feedback",
)  # fmt: skip


def judge_graph(graph: Graph) -> list[Line]:
    """Topics, types, QoS, and who else commands."""
    drivers, readers = graph.drivers, graph.readers
    found = f"{graph.states}: {_who(drivers, 'publisher')}; {graph.commands}: {_who(readers, 'subscriber')}"
    lines = [judged(len(drivers) == 1 and bool(readers), "topics", found, "1 publisher; at least 1 subscriber")]
    wanted = "; ".join(dict.fromkeys((graph.state_type, graph.command_type)))
    if not drivers and not readers:
        lines += [skipped(name, "nobody there") for name in ("types", "QoS")]
    else:
        types = [f"{graph.states}: {end.type}" for end in drivers if end.type != graph.state_type]
        types += [f"{graph.commands}: {end.type}" for end in readers if end.type != graph.command_type]
        lines.append(judged(not types, "types", "; ".join(types) or wanted, wanted))
        troubles = [f"{end.node} offers its states best effort" for end in drivers if not end.reliable]
        troubles += [f"{end.node}: {end.mismatch}" for end in (*drivers, *readers) if end.mismatch]
        asked = "reliable" if drivers and all(end.reliable for end in drivers) else "no"
        lines.append(judged(not troubles, "QoS", "; ".join(troubles) or f"states {asked}, commands match",
                            "states reliable; commands match a reliable, volatile publisher"))  # fmt: skip
    others = _who(graph.commanders, "other publisher")
    lines.append(judged(not graph.commanders, "only commander", f"{graph.commands}: {others}", "0"))
    return lines


def _who(ends: Sequence[Endpoint], role: str) -> str:
    nodes = ", ".join(sorted({end.node for end in ends}))
    return f"{len(ends)} {role}{'' if len(ends) == 1 else 's'}" + (f" ({nodes})" if ends else "")


def judge_stream(samples: Sequence[Sample], robot: RobotParameters, limits: Limits, duration: float) -> list[Line]:
    """Everything that states alone tell, except the velocity, which a movement tells better (``judge_velocity``).

    Args:
        samples: in the order of their arrival.
        robot: whose links must close.
        limits: what is allowed.
        duration: of the watch, s.
    """
    new = len({sample.stamp for sample in samples})
    if new < MIN_STATES:
        return [_no_stream(samples, new, duration), *(skipped(name, "no stream of states") for name in STREAM_LINES)]
    lines = [passed("states", f"{len(samples)} in {duration:.1f} s", f"at least {MIN_STATES}", states=len(samples))]
    lines += [_names(samples), _sizes(samples), _numbers(samples), *_pace(samples, limits), *_stamps(samples, limits)]
    lines.append(_closes(samples, robot, limits))
    lines.append(_effort(samples))
    return lines


def _no_stream(samples: Sequence[Sample], new: int, duration: float) -> Line:
    limit = f"at least {MIN_STATES} new ones"
    if not samples:
        return failed("states", f"none in {duration:.1f} s", limit, states=0)
    text = f"{len(samples)} in {duration:.1f} s, {new} with a stamp of their own"
    if new < len(samples) or new == 1:
        text += ": they stop without answers, as a plant in lockstep does; only real-time rigs can be checked"
    return failed("states", text, limit, states=new)


def _names(samples: Sequence[Sample]) -> Line:
    seen = {sample.names for sample in samples}
    wrong = [names for names in seen if any(names.count(name) != 1 for name in JOINT_NAMES)]
    if wrong:
        return failed("joint names", f"{list(wrong[0])}", " and ".join(JOINT_NAMES))
    orders = {tuple(name for name in names if name in JOINT_NAMES) for names in seen}
    note = "" if orders == {JOINT_NAMES} else ": another order, which is taken by name"
    return passed("joint names", f"{list(next(iter(seen)))}{note}", " and ".join(JOINT_NAMES))


def _sizes(samples: Sequence[Sample]) -> Line:
    def fits(sample: Sample) -> bool:
        count = len(sample.names)
        return len(sample.position) == count and {len(sample.velocity), len(sample.effort)} <= {0, count}

    wrong = [sample for sample in samples if not fits(sample)]
    shown = wrong[0] if wrong else samples[0]
    counts = (len(shown.names), len(shown.position), len(shown.velocity), len(shown.effort))
    sizes = "{} names, {} positions, {} velocities, {} efforts".format(*counts)
    text = f"{sizes} in {len(wrong)} of {len(samples)} states" if wrong else sizes
    return judged(not wrong, "array sizes", text, "as many as names", wrong=len(wrong))


def _numbers(samples: Sequence[Sample]) -> Line:
    wrong = sum(not np.isfinite([*s.position, *s.velocity, *s.effort]).all() for s in samples)
    return judged(not wrong, "finite numbers", f"{wrong} of {len(samples)} states with a number that is not", "0", wrong=wrong)


def _pace(samples: Sequence[Sample], limits: Limits) -> list[Line]:
    intervals = NANOSECOND * np.diff([sample.arrival for sample in samples])
    rate = 1.0 / max(float(intervals.mean()), NANOSECOND)
    jitter = float(np.percentile(np.abs(intervals - limits.period), 99))
    gap = float(intervals.max())
    low, high = limits.rate * (1.0 - limits.rate_tolerance), limits.rate * (1.0 + limits.rate_tolerance)
    return [
        judged(low <= rate <= high, "rate", f"{rate:.1f} Hz", f"{low:.1f} to {high:.1f} Hz", rate=rate),
        judged(jitter <= limits.jitter, "jitter", f"{1e3 * jitter:.2f} ms", f"{1e3 * limits.jitter:g} ms", p99=jitter),
        judged(gap <= limits.max_gap, "longest gap", f"{1e3 * gap:.1f} ms", f"{1e3 * limits.max_gap:g} ms", gap=gap),
    ]


def _stamps(samples: Sequence[Sample], limits: Limits) -> list[Line]:
    stamps = np.array([sample.stamp for sample in samples], dtype=np.int64)
    arrivals = np.array([sample.arrival for sample in samples], dtype=np.int64)
    back = int((np.diff(stamps) <= 0).sum())
    ages = NANOSECOND * (arrivals - stamps)
    age, youngest = float(np.median(ages)), float(ages.min())
    interval = NANOSECOND * int(stamps[-1] - stamps[0]) / (len(stamps) - 1)
    pace = NANOSECOND * int(arrivals[-1] - arrivals[0]) / (len(arrivals) - 1)
    share = interval / max(pace, NANOSECOND)
    return [
        judged(back == 0, "stamps rise", f"{back} of {len(stamps) - 1} do not", "0", back=back),
        judged(-limits.ahead <= youngest and age <= limits.max_age, "stamp age",
               f"median {_ms(age)}, least {_ms(youngest)}", f"{_ms(-limits.ahead)} to {_ms(limits.max_age)}",
               median=age, least=youngest),
        judged(abs(share - 1.0) <= limits.rate_tolerance, "stamp period", f"{1e3 * interval:.4f} ms, {share:.3f} x the arrivals'",
               f"1 ± {limits.rate_tolerance:g}", period=interval, ratio=share),
    ]  # fmt: skip


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms" if abs(seconds) < 10.0 else f"{seconds:.3g} s"


def elbow_distance(robot: RobotParameters, q_a: Array) -> Array:
    """Between the two elbows, (n,), m, at joint angles (n, 2), rad."""
    reach = np.array([leg.proximal_length for leg in robot.legs])
    elbows = np.stack([reach * np.cos(q_a), reach * np.sin(q_a)], axis=-1)  # (n, 2 legs, 2)
    elbows[:, 1, 0] += robot.base_distance
    return np.asarray(np.hypot(*(elbows[:, 1] - elbows[:, 0]).T))


def _closes(samples: Sequence[Sample], robot: RobotParameters, limits: Limits) -> Line:
    _, q_a = by_name(samples, "position")
    if not len(q_a):
        return skipped("closes", "no state has finite positions of both joints")
    distance = elbow_distance(robot, q_a)
    lengths = [leg.distal_length for leg in robot.legs]
    low, high = abs(lengths[0] - lengths[1]), sum(lengths)
    least, most = float(distance.min()), float(distance.max())
    ok = low - limits.closing <= least and most <= high + limits.closing
    angles = ", ".join(f"{name} {angle:.3f}" for name, angle in zip(JOINT_NAMES, q_a[int(np.argmax(distance))], strict=True))
    return judged(ok, "closes", f"elbows {1e3 * least:.1f} to {1e3 * most:.1f} mm apart ({angles} rad)",
                  f"{1e3 * low:.1f} to {1e3 * high:.1f} mm, ± {1e3 * limits.closing:g}", least=least, most=most)  # fmt: skip


def _effort(samples: Sequence[Sample]) -> Line:
    kept, _ = by_name(samples, "effort")
    without = sum(not sample.effort for sample in samples)
    if not kept and without < len(samples):
        return skipped("effort feedback", "no state has finite efforts of both joints")
    return judged(not without, "effort feedback", f"{without} of {len(samples)} states without", "0", without=without)


def judge_velocity(stretches: Sequence[Sequence[Sample]]) -> Line:
    """Whether velocities integrate to positions, over windows of ``VELOCITY_WINDOW`` without a long gap.

    Args:
        stretches: unbroken runs of samples.
    """
    misses: list[bool] = []
    worst, seen = 0.0, False
    for stretch in stretches:
        both = by_name(by_name(stretch, "position")[0], "velocity")[0]
        if len(both) < 3:
            continue
        t, q_a, q_a_dot = times(both), by_name(both, "position")[1], by_name(both, "velocity")[1]
        steps = 0.5 * (q_a_dot[1:] + q_a_dot[:-1]) * np.diff(t)[:, None]
        travelled = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        marks = np.unique(np.searchsorted(t, np.arange(0.0, t[-1] + VELOCITY_WINDOW, VELOCITY_WINDOW)).clip(max=len(t) - 1))
        gaps = [np.diff(t[first : last + 1]).max() for first, last in pairwise(marks)]
        whole = np.array(gaps) <= max(0.5 * VELOCITY_WINDOW, 2.0 * float(np.median(np.diff(t))))
        change, integral = np.diff(q_a[marks], axis=0)[whole], np.diff(travelled[marks], axis=0)[whole]
        miss = np.abs(change - integral)
        moving = np.maximum(np.abs(change), np.abs(integral)) > VELOCITY_FLOOR
        over = miss > np.maximum(VELOCITY_FLOOR, VELOCITY_SHARE * np.abs(change))
        misses += over[moving].tolist()
        worst, seen = max([worst, *miss.ravel().tolist()]), True
    if not seen:
        return skipped("velocity", "none published, or not with positions; the controller does not need it")
    share = sum(misses) / max(len(misses), 1)
    windows = f"{sum(misses)} of {len(misses)} windows of {1e3 * VELOCITY_WINDOW:.0f} ms with movement"
    text = f"{windows} miss, by {1e3 * worst:.2f} mrad at most"
    limit = f"{100 * VELOCITY_MISSES:.0f} % by more than {1e3 * VELOCITY_FLOOR:g} mrad or {100 * VELOCITY_SHARE:.0f} %"
    return judged(share <= VELOCITY_MISSES, "velocity", text, limit, worst=worst, share=share)
