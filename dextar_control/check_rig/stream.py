"""A driver is judged by what it publishes, without commanding it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dextar_control.check_rig.limits import (
    MIN_STATES,
    VELOCITY_FLOOR,
    VELOCITY_MISSES,
    VELOCITY_SHARE,
    VELOCITY_WINDOW,
    Limits,
)
from dextar_control.check_rig.report import (
    CheckLine,
    failed,
    judged,
    noted,
    passed,
    skipped,
)
from dextar_control.check_rig.samples import (
    NANOSECOND,
    Array,
    Endpoint,
    Graph,
    JointSample,
    by_name,
    joint_angles,
    times,
)
from dextar_control.contract.errors import GeometryError
from dextar_control.contract.robot import JOINT_NAMES, RobotParameters
from dextar_control.control.stream import StateStream
from dextar_control.model.model import Model
from dextar_control.planning.checks import beyond_range

STREAM_LINES = (
    "joint names",
    "array sizes",
    "finite numbers",
    "rate",
    "jitter",
    "longest gap",
    "stamps rise",
    "stamp age",
    "stamp period",
    "closes",
    "mode and range",
    "velocity",
    "effort feedback",
)
# rad, by which the joints of the robot's working mode may miss the measured ones: the
# controller's
SAME_JOINTS = 1.0e-6
POSES = 200  # of a watch, at which the working mode is looked at
# Hz from which states that bear one stamp are a driver's that does not stamp them, not
# a waiting plant's
QUICK = 10.0


def judge_graph(graph: Graph) -> list[CheckLine]:
    """Return the lines on topics, types, QoS, and who else commands."""
    drivers, readers = graph.drivers, graph.readers
    found = (
        f"{graph.states}: {_who(drivers, 'publisher')}; {graph.commands}:"
        f" {_who(readers, 'subscriber')}"
    )
    if len(drivers) > 1:
        found += (
            ": once both speak the controller takes neither; end all but one (one that"
            " was killed stays for up to 20 s)"
        )
    lines = [
        judged(
            len(drivers) == 1 and bool(readers),
            "topics",
            found,
            "1 publisher; at least 1 subscriber",
        )
    ]
    wanted = "; ".join(dict.fromkeys((graph.state_type, graph.command_type)))
    if not drivers and not readers:
        lines += [skipped(name, "nobody there") for name in ("types", "QoS")]
    else:
        types = [
            f"{graph.states}: {end.type}"
            for end in drivers
            if end.type != graph.state_type
        ]
        types += [
            f"{graph.commands}: {end.type}"
            for end in readers
            if end.type != graph.command_type
        ]
        lines.append(judged(not types, "types", "; ".join(types) or wanted, wanted))
        lines.append(_qos(drivers, readers))
    others = _who(graph.commanders, "other publisher")
    lines.append(
        judged(
            not graph.commanders, "only commander", f"{graph.commands}: {others}", "0"
        )
    )
    return lines


def _qos(drivers: Sequence[Endpoint], readers: Sequence[Endpoint]) -> CheckLine:
    limit = "states reliable; commands match a reliable, volatile publisher"
    troubles = [
        f"{end.node}: {end.mismatch}" for end in (*drivers, *readers) if end.mismatch
    ]
    if troubles:
        return failed("QoS", "; ".join(troubles), limit)
    unreliable = ", ".join(end.node for end in drivers if not end.reliable)
    if unreliable:
        lost = (
            "a real-time controller reads them so; a recorder needs"
            " topics.reliable:=false"
        )
        return noted(
            "QoS", f"{unreliable} offers its states best effort: {lost}", limit
        )
    return passed(
        "QoS", f"states {'reliable' if drivers else 'no'}, commands match", limit
    )


def _who(ends: Sequence[Endpoint], role: str) -> str:
    counts = Counter(end.node for end in ends)
    nodes = ", ".join(
        node if count == 1 else f"{count} x {node}"
        for node, count in sorted(counts.items())
    )
    return f"{len(ends)} {role}{'' if len(ends) == 1 else 's'}" + (
        f" ({nodes})" if ends else ""
    )


def judge_stream(
    samples: Sequence[JointSample],
    robot: RobotParameters,
    limits: Limits,
    duration: float,
) -> list[CheckLine]:
    """Return all lines that states alone give, except the velocity, which a movement
    tells better (``judge_velocity``).

    Args:
        samples: in the order of their arrival.
        robot: whose links must close.
        limits: what is allowed.
        duration: of the watch, s.
    """
    new = len({sample.stamp for sample in samples})
    if new < MIN_STATES:
        return [
            _no_stream(samples, new, duration),
            *(skipped(name, "no stream of states") for name in STREAM_LINES),
        ]
    text, limit = f"{len(samples)} in {duration:.1f} s", f"at least {MIN_STATES}"
    return [
        passed("states", text, limit, states=len(samples)),
        _names(samples),
        _sizes(samples),
        _numbers(samples),
        *_pace(samples, limits),
        *_stamps(samples, limits),
        _closes(samples, robot, limits),
        _mode_and_range(samples, robot, limits),
        _effort(samples),
    ]


def _no_stream(samples: Sequence[JointSample], new: int, duration: float) -> CheckLine:
    limit = f"at least {MIN_STATES} new ones"
    if not samples:
        return failed("states", f"none in {duration:.1f} s", limit, states=0)
    text = f"{len(samples)} in {duration:.1f} s, {new} with a stamp of their own"
    if new < len(samples) and len(samples) > QUICK * duration:
        text += (
            ": the driver does not stamp each state; the controller takes none twice"
        )
    elif new < len(samples) or new == 1:
        text += (
            ": they stop without answers, as a plant in lockstep does; only real-time"
            " rigs can be checked"
        )
    return failed("states", text, limit, states=new)


def _names(samples: Sequence[JointSample]) -> CheckLine:
    limit = " and ".join(JOINT_NAMES)
    wrong = [
        sample.names
        for sample in samples
        if any(name not in sample.names for name in JOINT_NAMES)
    ]
    if wrong:
        kinds = Counter(sample.names for sample in samples)
        text = (
            f"{len(wrong)} of {len(samples)} states without both, e.g. {list(wrong[0])}"
        )
        if all(any(name in names for names in kinds) for name in JOINT_NAMES):
            text += (
                ": each state must have both (two publishers with some of the joints"
                " each?)"
            )
        return failed("joint names", text, limit, wrong=len(wrong))
    seen = {sample.names for sample in samples}
    shown = f"{list(samples[0].names)}"
    twice = [
        name for name in JOINT_NAMES if any(names.count(name) > 1 for names in seen)
    ]
    if twice:
        shown += f": the controller takes the first {' and '.join(twice)}"
        return noted("joint names", shown, limit)
    orders = {tuple(name for name in names if name in JOINT_NAMES) for names in seen}
    if orders != {JOINT_NAMES}:
        shown += ": another order, which is taken by name"
    return passed("joint names", shown, limit)


def _sizes(samples: Sequence[JointSample]) -> CheckLine:
    wrong = [sample for sample in samples if len(sample.position) != len(sample.names)]
    odd = [
        sample
        for sample in samples
        if not {len(sample.velocity), len(sample.effort)} <= {0, len(sample.names)}
    ]
    shown = (wrong or odd or samples)[0]
    sizes = "{} names, {} positions, {} velocities, {} efforts".format(
        *map(len, shown[2:])
    )
    limit = "as many as names"
    if wrong:
        text = f"{sizes} in {len(wrong)} of {len(samples)} states"
        return failed("array sizes", text, limit, wrong=len(wrong))
    if odd:
        text = (
            f"{sizes} in {len(odd)} of {len(samples)} states; the controller uses the"
            " positions alone"
        )
        return noted("array sizes", text, limit, wrong=0)
    return passed("array sizes", sizes, limit, wrong=0)


def _numbers(samples: Sequence[JointSample]) -> CheckLine:
    """Judge the positions of both joints, which the controller needs; what else is not
    finite is a remark.
    """
    wrong = len(_measured(samples)) - len(by_name(samples, "position")[0])
    if wrong:
        text = f"{wrong} of {len(samples)} states with a position that is not"
        return failed("finite numbers", text, "0", wrong=wrong)
    others = [
        f"{words} in {count}"
        for field, words in (
            ("position", "other joints' positions"),
            ("velocity", "velocities"),
            ("effort", "efforts"),
        )
        if (
            count := sum(
                not np.isfinite(getattr(sample, field)).all() for sample in samples
            )
        )
    ]
    if others:
        text = (
            f"not finite: {', '.join(others)} of {len(samples)} states; the controller"
            " uses none of that"
        )
        return noted("finite numbers", text, "0", wrong=0)
    return passed(
        "finite numbers",
        f"0 of {len(samples)} states with a number that is not",
        "0",
        wrong=0,
    )


def _measured(samples: Sequence[JointSample]) -> list[JointSample]:
    """Return the states with a position of both joints, finite or not."""
    return [
        s
        for s in samples
        if len(s.position) == len(s.names)
        and all(name in s.names for name in JOINT_NAMES)
    ]


def _pace(samples: Sequence[JointSample], limits: Limits) -> list[CheckLine]:
    intervals = NANOSECOND * np.diff([sample.arrival for sample in samples])
    rate = 1.0 / max(float(intervals.mean()), NANOSECOND)
    jitter = float(np.percentile(np.abs(intervals - limits.period), 99))
    gap = float(intervals.max())
    # A step back is refused.
    stamps = np.array([sample.stamp for sample in samples], dtype=np.int64)
    taken = np.maximum.accumulate(stamps)
    stamp_gap = NANOSECOND * int(np.diff(taken).max())
    gaps = f"{1e3 * gap:.1f} ms, by their stamps {1e3 * stamp_gap:.1f} ms"
    low, high = (limits.rate * (1.0 + sign * limits.rate_tolerance) for sign in (-1, 1))
    return [
        judged(
            low <= rate <= high,
            "rate",
            f"{rate:.1f} Hz",
            f"{low:.1f} to {high:.1f} Hz",
            rate=rate,
        ),
        judged(
            jitter <= limits.jitter,
            "jitter",
            f"{1e3 * jitter:.2f} ms",
            f"{1e3 * limits.jitter:g} ms",
            p99=jitter,
        ),
        judged(
            max(gap, stamp_gap) <= limits.max_gap,
            "longest gap",
            gaps,
            f"{1e3 * limits.max_gap:g} ms",
            gap=gap,
            stamp_gap=stamp_gap,
        ),
    ]


def _stamps(samples: Sequence[JointSample], limits: Limits) -> list[CheckLine]:
    stamps = np.array([sample.stamp for sample in samples], dtype=np.int64)
    arrivals = np.array([sample.arrival for sample in samples], dtype=np.int64)
    ages = NANOSECOND * (arrivals - stamps)
    age, youngest = float(np.median(ages)), float(ages.min())
    interval = NANOSECOND * int(stamps[-1] - stamps[0]) / (len(stamps) - 1)
    pace = NANOSECOND * int(arrivals[-1] - arrivals[0]) / (len(arrivals) - 1)
    share = interval / max(pace, NANOSECOND)
    return [
        _rise(samples, limits),
        judged(
            -limits.ahead <= youngest and age <= limits.max_age,
            "stamp age",
            f"median {_ms(age)}, least {_ms(youngest)}",
            f"{_ms(-limits.ahead)} to {_ms(limits.max_age)}",
            median=age,
            least=youngest,
        ),
        judged(
            abs(share - 1.0) <= limits.rate_tolerance,
            "stamp period",
            f"{1e3 * interval:.4f} ms, {share:.3f} x the arrivals'",
            f"1 ± {limits.rate_tolerance:g}",
            period=interval,
            ratio=share,
        ),
    ]


def _rise(samples: Sequence[JointSample], limits: Limits) -> CheckLine:
    """Judge whether stamps rise: a step back is a fault of the controller, a repetition
    only begins its healthy time anew.
    """
    stream, last = StateStream(), samples[0].stamp - 1
    back, repeated, healthy = 0, 0, 0.0
    for sample in samples:
        if sample.stamp > last:
            last = sample.stamp
            stream.take(sample.stamp, limits.max_gap, NANOSECOND * sample.arrival)
            healthy = max(
                healthy, stream.healthy_for(limits.max_gap, NANOSECOND * sample.arrival)
            )
            continue
        back, repeated = back + (sample.stamp < last), repeated + (sample.stamp == last)
        stream.spoil("")
    text = f"{back + repeated} of {len(samples) - 1} do not"
    if back or not repeated:
        return judged(back == 0, "stamps rise", text, "0", back=back, repeated=repeated)
    if healthy < limits.healthy_time:
        text += (
            f": repeated; never {limits.healthy_time:g} s without, which the controller"
            " needs before it enables"
        )
        return failed("stamps rise", text, "0", back=0, repeated=repeated)
    return noted(
        "stamps rise",
        f"{text}: repeated; the controller answers such a state again",
        "0",
        back=0,
        repeated=repeated,
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms" if abs(seconds) < 10.0 else f"{seconds:.3g} s"


def elbow_distance(robot: RobotParameters, q_a: Array) -> Array:
    """Return the distance between the two elbows, (n,), m.

    Args:
        robot: the five-bar.
        q_a: active joints as the encoders read them, (n, 2), rad.
    """
    length = np.array([leg.proximal_length for leg in robot.legs])
    axes = np.array([leg.axis for leg in robot.legs])
    q_a = q_a - robot.encoder_offset
    links = length[:, None] * np.stack([np.cos(q_a), np.sin(q_a)], axis=-1)
    elbows = links + axes  # (n, 2 legs, 2)
    return np.asarray(np.hypot(*(elbows[:, 1] - elbows[:, 0]).T))


def _closing(robot: RobotParameters) -> tuple[float, float]:
    """Return the least and the largest distance of the elbows at which the distal links
    meet, m.
    """
    lengths = [leg.distal_length for leg in robot.legs]
    return abs(lengths[0] - lengths[1]), sum(lengths)


def _closes(
    samples: Sequence[JointSample], robot: RobotParameters, limits: Limits
) -> CheckLine:
    _, q_a = joint_angles(samples)
    if not len(q_a):
        return skipped("closes", "no state has finite positions of both joints")
    distance = elbow_distance(robot, q_a)
    low, high = _closing(robot)
    least, most = float(distance.min()), float(distance.max())
    ok = low - limits.closing <= least and most <= high + limits.closing
    angles = ", ".join(
        f"{name} {angle:.3f}"
        for name, angle in zip(JOINT_NAMES, q_a[int(np.argmax(distance))], strict=True)
    )
    return judged(
        ok,
        "closes",
        f"elbows {1e3 * least:.1f} to {1e3 * most:.1f} mm apart ({angles} rad)",
        f"{1e3 * low:.1f} to {1e3 * high:.1f} mm, ± {1e3 * limits.closing:g}",
        least=least,
        most=most,
    )


def _mode_and_range(
    samples: Sequence[JointSample], robot: RobotParameters, limits: Limits
) -> CheckLine:
    """Judge by the controller's rules for its first state, and for each one under
    torque.
    """
    _, q_a = joint_angles(samples)
    if not len(q_a):
        return skipped("mode and range", "no state has finite positions of both joints")
    model = Model.of(robot)
    beyond = float(beyond_range(robot, q_a).max())
    wanted = (
        f"working mode {list(robot.working_mode)}; {limits.joint_margin:g} rad outside"
        " the range at most"
    )
    if beyond > limits.joint_margin:
        legs = "; ".join(
            f"{name} {leg.min_angle:.4g} to {leg.max_angle:.4g}"
            for name, leg in zip(JOINT_NAMES, robot.legs, strict=True)
        )
        text = f"{beyond:.3f} rad outside the range ({legs} rad)"
        return failed("mode and range", text, wanted, beyond=beyond)
    low, high = _closing(robot)
    distance = elbow_distance(robot, q_a)
    closed = q_a[(low <= distance) & (distance <= high)]
    if not len(closed):
        if (
            (low - limits.closing <= distance) & (distance <= high + limits.closing)
        ).any():
            text = (
                "the distal links just miss each other: the controller takes no such"
                " state for its first one"
            )
            return failed("mode and range", text, wanted, beyond=beyond)
        return skipped("mode and range", "the distal links do not meet")
    poses = closed[:: max(1, len(closed) // POSES)]
    modes = [
        mode
        for mode in (limits.assembly_mode, -limits.assembly_mode)
        if all(_in_mode(model, pose, mode) for pose in poses)
    ]
    shown = f"({poses[-1, 0]:.3f}, {poses[-1, 1]:.3f}) rad"
    if not modes:
        text = (
            f"at {shown} the legs stand in another working mode (sign or offset of an"
            " encoder?)"
        )
        return failed("mode and range", text, wanted, beyond=beyond)
    if limits.assembly_mode not in modes:
        text = (
            f"{shown} is in the working mode with assembly_mode {modes[0]:+d} alone:"
            " set controller.assembly_mode so"
        )
        return noted("mode and range", text, wanted, beyond=beyond)
    text = f"{shown} is in the working mode with assembly_mode {modes[0]:+d}"
    return passed("mode and range", text, wanted, beyond=beyond)


def _in_mode(model: Model, q_a: Array, assembly_mode: int) -> bool:
    """Return whether the controller takes these joints, (2,), rad, for its
    first state.
    """
    try:
        implied = model.inverse_geometric_model(model.close(q_a, assembly_mode))
    except GeometryError:
        return False
    off = np.remainder(implied - q_a + np.pi, 2.0 * np.pi) - np.pi
    return bool(np.hypot(*off) < SAME_JOINTS)


def _effort(samples: Sequence[JointSample]) -> CheckLine:
    without = len(samples) - len(by_name(samples, "effort")[0])
    text = f"{without} of {len(samples)} states without"
    if not without:
        return passed("effort feedback", text, "0", without=0)
    text += (
        ": not sent, or not finite; the controller does not need it, but nobody sees"
        " the torque go"
    )
    return noted("effort feedback", text, "0", without=without)


def judge_velocity(stretches: Sequence[Sequence[JointSample]]) -> CheckLine:
    """Return whether velocities integrate to positions, over windows of
    ``VELOCITY_WINDOW`` without a long gap.

    Args:
        stretches: unbroken runs of samples.
    """
    misses: list[bool] = []
    worst, seen = 0.0, False
    for stretch in stretches:
        both = by_name(joint_angles(stretch)[0], "velocity")[0]
        if len(both) < 3:
            continue
        t, q_a = times(both), joint_angles(both)[1]
        q_a_dot = by_name(both, "velocity")[1]
        steps = 0.5 * (q_a_dot[1:] + q_a_dot[:-1]) * np.diff(t)[:, None]
        travelled = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        marks = np.unique(
            np.searchsorted(
                t, np.arange(0.0, t[-1] + VELOCITY_WINDOW, VELOCITY_WINDOW)
            ).clip(max=len(t) - 1)
        )
        gaps = [np.diff(t[first : last + 1]).max() for first, last in pairwise(marks)]
        whole = np.array(gaps) <= max(
            0.5 * VELOCITY_WINDOW, 2.0 * float(np.median(np.diff(t)))
        )
        change = np.diff(q_a[marks], axis=0)[whole]
        integral = np.diff(travelled[marks], axis=0)[whole]
        miss = np.abs(change - integral)
        moving = np.maximum(np.abs(change), np.abs(integral)) > VELOCITY_FLOOR
        over = miss > np.maximum(VELOCITY_FLOOR, VELOCITY_SHARE * np.abs(change))
        misses += over[moving].tolist()
        worst, seen = max([worst, *miss.ravel().tolist()]), True
    if not seen:
        return skipped(
            "velocity",
            "none published, none finite, or not with positions; the controller does"
            " not need it",
        )
    share = sum(misses) / max(len(misses), 1)
    windows = (
        f"{sum(misses)} of {len(misses)} windows of {1e3 * VELOCITY_WINDOW:.0f} ms with"
        " movement"
    )
    text = f"{windows} miss, by {1e3 * worst:.2f} mrad at most"
    limit = (
        f"{100 * VELOCITY_MISSES:.0f} % by more than {1e3 * VELOCITY_FLOOR:g} mrad or"
        f" {100 * VELOCITY_SHARE:.0f} %"
    )
    if share > VELOCITY_MISSES:
        text += "; the controller does not use it, displays and analyses do"
        return noted("velocity", text, limit, worst=worst, share=share)
    return passed("velocity", text, limit, worst=worst, share=share)
