"""Candidates of a search on symbols: polynomials from a crossing's state, and their
cost.

Each half runs from the state at a crossing (position, velocity, acceleration, jerk) to
a state at its end, by a polynomial of degree 7 per coordinate, bent by two bumps that
vanish at both ends with three derivatives. The two halves of a crossing share its
state, so that the torque has its finite limit there; the two halves of a leg between
crossings share the state at their meeting. The gradient of the cost is its derivative
on the symbols, in reverse mode.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.model.equations import Equations
from dextar_control.symbols.functions import named
from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.types import Symbol

_POWERS = np.arange(4.0, 8.0)
# (4, 4) coefficients of the powers 4 to 7 over what position, velocity, acceleration
# and jerk lack at the end
_END = np.linalg.inv(
    np.array(
        [
            _POWERS**0,
            _POWERS,
            _POWERS * (_POWERS - 1),
            _POWERS * (_POWERS - 1) * (_POWERS - 2),
        ]
    )
)
# (2, 6) coefficients of the bumps, of the powers 4 to 9
_BUMP = 256.0 * np.array(
    [[1.0, -4.0, 6.0, -4.0, 1.0, 0.0], [-1.0, 6.0, -14.0, 16.0, -9.0, 2.0]]
)
ROWS = 10  # coefficients of a half
ARGUMENTS = "p", "limits", "task", "variables"  # of a candidate's functions

HALF_SAMPLES = 24  # of each half while optimising, none of them on the locus
DENSITY = 0.35  # spacing of those samples at the crossing over their mean spacing
NEAR_WIDTH = 0.15  # |s| over which a sample stops counting as near the locus
NEAR_EMPHASIS = 1.0  # how much more a torque on the locus counts than one away from it
EXCESS = 1.0  # how much more a peak torque counts beyond the one that costs one
SOFT_MAXIMUM = 12  # exponent of the mean that stands for the peak torque
UNREACHABLE = 20.0  # cost of a half that a leg does not reach, before how far it misses
UNCLOSED = 1e3  # cost of a place where the locus does not close, over how far it misses
# s in which a leg's torque may change by what costs one, for nothing
TORQUE_RISE = 10e-3
SPEED_SHARE = 0.95  # of the speed limits that costs nothing
SPLIT_LEAST = 0.2  # fraction of the time on either side of the crossing
SPAN_MOST = 2.0  # logarithm of a leg's half over its scale

_SHARES = (np.arange(HALF_SAMPLES) + 0.5) / HALF_SAMPLES
# fractions of a half's time at the samples, the last at its end
_FRACTIONS = np.append(_SHARES * (DENSITY + (1.0 - DENSITY) * _SHARES**2), 1.0)
# share of the time that each sample stands for
_WEIGHTS = (DENSITY + 3.0 * (1.0 - DENSITY) * _SHARES**2) / HALF_SAMPLES
# |s| that a candidate keeps at each sample on its way out of the locus
_FLOORS = np.minimum(0.3 * _FRACTIONS[:-1], 0.1)


class Layouts(NamedTuple):
    """The layouts of a search's records.

    Attributes:
        limits: what costs one, and the limits.
        crossing_task: what is given of a crossing.
        crossing: its variables, lengths over ``length`` and times over ``duration`` of
            the task.
        leg_task: what is given of a leg between two crossings.
        leg: its variables, likewise.
    """

    limits: Layout
    crossing_task: Layout
    crossing: Layout
    leg_task: Layout
    leg: Layout


@lru_cache
def layouts(n: int) -> Layouts:
    """Return the layouts for n degrees of freedom."""
    bends = (
        Field("first_bends", "1", "heights of the bumps of the first half", n, 2),
        Field("second_bends", "1", "and of the second", n, 2),
    )
    times = (
        Field("duration", "s", "of the crossing; the scale of a leg"),
        Field("length", "m", "scale"),
        Field("sign", "1", "of s after the crossing, or during the leg"),
    )
    state = (
        Field("x", "1", "position", n),
        Field("x_dot", "1", "velocity", n),
        Field("x_ddot", "1", "acceleration", n),
    )
    return Layouts(
        Layout(
            "limits",
            n,
            (
                Field("torque", "N m", "peak torque that costs one"),
                Field("near_time", "s", "near the locus, that costs one"),
                Field("time", "s", "of a leg, that costs one"),
                Field("joint_speed", "rad/s", "limit"),
                Field("platform_speed", "m/s", "limit"),
                Field("type1", "1", "distance to Type 1 that is kept"),
                Field("end_s", "1", "|s| at the ends"),
            ),
        ),
        Layout(
            "crossing_task",
            n,
            (
                *times,
                Field("family", "1", "of the locus"),
                Field("branch", "1", "of the family"),
                Field(
                    "point",
                    "m",
                    "of the locus, where the mechanism does not trace it in closed"
                    " form",
                    n,
                ),
                Field(
                    "zero_wrench",
                    "1",
                    "1 for w_d = 0 at the crossing, 0 for its component along t_s"
                    " alone",
                ),
                Field(
                    "directions",
                    "1",
                    "x_dot over the variable velocity: the identity, or a given"
                    " direction alone",
                    n,
                    n,
                ),
            ),
        ),
        Layout(
            "crossing",
            n,
            (
                Field("start", "1", "where it rests before", n),
                Field("goal", "1", "where it rests after", n),
                Field("place", "rad", "tracing angle on the locus"),
                Field("split", "1", "share of the time before the crossing"),
                Field("velocity", "1", "at the crossing", n),
                Field("strong", "1", "acceleration along the strong directions", n - 1),
                Field("jerk", "1", "at the crossing", n),
                *bends,
            ),
        ),
        Layout(
            "leg_task",
            n,
            (
                *times,
                Field(
                    "left",
                    "SI",
                    "columns x, x_dot, x_ddot, jerk at the crossing that it leaves",
                    n,
                    4,
                ),
                Field("reached", "SI", "and at the one that it reaches", n, 4),
            ),
        ),
        Layout(
            "leg",
            n,
            (
                *state,
                Field("jerk", "1", "where the halves meet", n),
                Field("spans", "1", "logarithms of the halves' durations", 2),
                *bends,
            ),
        ),
    )


def half(n: int) -> ca.Function:
    """Return the function that gives the coefficients (n, ROWS) of a half by rising
    power of the share of its span, for n degrees of freedom.

    It takes ``begin`` and ``end``, (n, 4) columns x, x_dot, x_ddot, jerk; ``span``, s,
    which may be < 0; and ``bends``, (n, 2) heights of the bumps, m, one column a bump.
    """
    begin, end = ca.SX.sym("begin", n, 4), ca.SX.sym("end", n, 4)
    bends, span = ca.SX.sym("bends", n, 2), ca.SX.sym("span")
    low = ca.horzcat(
        begin[:, 0],
        begin[:, 1] * span,
        begin[:, 2] * span**2 / 2.0,
        begin[:, 3] * span**3 / 6.0,
    )
    lack = ca.horzcat(
        end[:, 0] - low @ ca.DM([1, 1, 1, 1]),
        end[:, 1] * span - low @ ca.DM([0, 1, 2, 3]),
        end[:, 2] * span**2 - low @ ca.DM([0, 0, 2, 6]),
        end[:, 3] * span**3 - low @ ca.DM([0, 0, 0, 6]),
    )
    coefficients = ca.horzcat(
        low, ca.horzcat(lack @ _END.T, ca.SX.zeros(n, 2)) + bends @ _BUMP
    )
    return named(
        "half",
        {"begin": begin, "end": end, "span": span, "bends": bends},
        {"half": coefficients},
    )


def candidates(mechanism: Mechanism, e: Equations) -> list[ca.Function]:
    """Return the functions ``half``, ``crossing`` and ``leg``: the halves of a
    candidate, and what its variables cost by themselves.
    """
    layout, curve = layouts(mechanism.n), half(mechanism.n)
    parts = _crossing(mechanism, e, layout), _leg(e.p, layout)
    return [
        curve,
        *(
            _joined(name, part, curve)
            for name, part in zip(("crossing", "leg"), parts, strict=True)
        ),
    ]


def _crossing(mechanism: Mechanism, e: Equations, layout: Layouts) -> ca.Function:
    """Return the ends, bends and spans of the halves of a crossing."""
    given, task = layout.crossing_task.symbols("task")
    free, z = layout.crossing.symbols("variables")
    unit, p = task["length"] / task["duration"], mechanism.named(e.p)
    traced = mechanism.type2_locus(task["family"], task["branch"], z["place"], p)
    _, x, closing = (None, task["point"], ca.SX(0.0)) if traced is None else traced
    q_a, _ = mechanism.nearest_joints(x, p)
    x_dot = task["directions"] @ z["velocity"] * unit
    at = e.at(e.p, q_a, x, x_dot, e.x_ddot)  # linear in x_ddot
    t_s, mass = at.singular.v_weak, ca.jacobian(at.w_d, e.x_ddot)
    v_strong = at.singular.v_strong
    strong = v_strong @ z["strong"][: v_strong.shape[1]] * unit / task["duration"]
    residual = ca.substitute(at.criterion, e.x_ddot, strong)
    w_d = ca.substitute(at.w_d, e.x_ddot, ca.SX.zeros(mechanism.n))
    weak = ca.solve(t_s.T @ mass @ t_s, residual)
    reciprocal = strong - t_s @ weak  # Eq. 5: t_s . w_d = 0
    x_ddot = ca.if_else(task["zero_wrench"] > 0.5, -ca.solve(mass, w_d), reciprocal)
    begin = ca.horzcat(x, x_dot, x_ddot, z["jerk"] * unit / task["duration"] ** 2)
    split = ca.fmin(ca.fmax(z["split"], SPLIT_LEAST), 1.0 - SPLIT_LEAST)
    before = split * task["duration"]
    rests = [
        ca.horzcat(z[name] * task["length"], ca.SX.zeros(mechanism.n, 3))
        for name in ("start", "goal")
    ]
    uneven = _excess(ca.fabs(z["split"] - 0.5), 0.5 - SPLIT_LEAST)
    own = 10.0 * uneven + UNCLOSED * _excess(0.0, closing)
    return _parts(
        [e.p, layout.limits.symbols()[0], given, free],
        {
            "first_begin": begin,
            "second_begin": begin,
            "first_end": rests[0],
            "second_end": rests[1],
            "first_bends": z["first_bends"] * task["length"],
            "second_bends": z["second_bends"] * task["length"],
            "spans": ca.vertcat(-before, task["duration"] - before),
            "signs": ca.vertcat(-task["sign"], task["sign"]),
            "own": own,
        },
    )


def _leg(p: Symbol, layout: Layouts) -> ca.Function:
    """Return the ends, bends and spans of the halves of a leg."""
    limits, limit = layout.limits.symbols()
    given, task = layout.leg_task.symbols("task")
    free, z = layout.leg.symbols("variables")
    units = [task["length"] / task["duration"] ** order for order in range(4)]
    meeting = ca.horzcat(
        *(
            z[name] * unit
            for name, unit in zip(("x", "x_dot", "x_ddot", "jerk"), units, strict=True)
        )
    )
    spans = ca.exp(ca.fmin(z["spans"], SPAN_MOST)) * task["duration"]
    own = (
        10.0 * ca.sum1(_excess(ca.fabs(z["spans"]), SPAN_MOST))
        + ca.sum1(spans) / limit["time"]
    )
    return _parts(
        [p, limits, given, free],
        {
            "first_begin": task["left"],
            "second_begin": task["reached"],
            "first_end": meeting,
            "second_end": meeting,
            "first_bends": z["first_bends"] * task["length"],
            "second_bends": z["second_bends"] * task["length"],
            "spans": ca.vertcat(spans[0], -spans[1]),
            "signs": ca.vertcat(task["sign"], task["sign"]),
            "own": own,
        },
    )


def _parts(arguments: list[Symbol], results: dict[str, Symbol]) -> ca.Function:
    """Return the function of these results, differentiable by the variables alone."""
    only = [False] * (len(arguments) - 1) + [True]
    return ca.Function(
        "parts",
        arguments,
        [ca.densify(result) for result in results.values()],
        [*ARGUMENTS],
        [*results],
        {"cse": True, "is_diff_in": only},
    )


def _joined(name: str, parts: ca.Function, curve: ca.Function) -> ca.Function:
    """Return the function that gives a candidate's halves."""
    arguments = [
        ca.MX.sym(given, parts.size1_in(i)) for i, given in enumerate(ARGUMENTS)
    ]
    part = dict(zip(parts.name_out(), parts(*arguments), strict=True))
    halves = [
        curve(
            part[f"{which}_begin"],
            part[f"{which}_end"],
            part["spans"][row],
            part[f"{which}_bends"],
        )
        for row, which in enumerate(("first", "second"))
    ]
    results = [*halves, part["spans"], part["signs"], part["own"]]
    return ca.Function(
        name,
        arguments,
        results,
        [*ARGUMENTS],
        ["first", "second", "spans", "signs", "own"],
    )


def _excess(value: Symbol | float, limit: Symbol | float) -> Symbol:
    return ca.fmax(value - limit, 0.0)


def _instant(mechanism: Mechanism, e: Equations) -> tuple[ca.Function, ca.Function]:
    """Return the functions of what one sample of a candidate costs (load, near, broken,
    reached) and its torque (0 out of reach), and of what its end costs.
    """
    p, layout = mechanism.named(e.p), layouts(mechanism.n).limits
    limits, limit = layout.symbols()
    sign, floor = ca.SX.sym("sign"), ca.SX.sym("floor")
    q_a, extension = mechanism.nearest_joints(e.x, p)
    worst = ca.mmax(ca.fabs(extension))
    missed = 100.0 * _excess(worst, ca.sqrt(_excess(1.0, limit["type1"] ** 2)))
    at = e.at(e.p, q_a, e.x, e.x_dot, e.x_ddot)
    tau = at.inverse_dynamics + at.friction
    s, reached = ca.mmin(sign * at.s_blocks), worst < 1.0
    near = ca.exp(-((s / NEAR_WIDTH) ** 2))
    square = ((1.0 + NEAR_EMPHASIS * near) / limit["torque"] * tau) ** 2
    fourth = square * square
    broken = 10.0 * _excess(floor, s) + _excess(
        ca.norm_2(e.x_dot) / limit["platform_speed"], SPEED_SHARE
    )
    broken += _excess(ca.mmax(ca.fabs(at.q_a_dot)) / limit["joint_speed"], SPEED_SHARE)
    costs = ca.if_else(
        reached,
        ca.vertcat(ca.sum1(fourth * fourth * fourth), near, broken, 1.0),
        ca.vertcat(0.0, 0.0, UNREACHABLE / HALF_SAMPLES, 0.0),
    )
    only = {"is_diff_in": [False, False, False, False, True, True, True]}
    sample = ca.Function(
        "sample",
        [e.p, limits, sign, floor, e.x, e.x_dot, e.x_ddot],
        [
            ca.densify(costs + ca.vertcat(0.0, 0.0, missed, 0.0)),
            ca.if_else(reached, tau, ca.SX.zeros(tau.size1())),
        ],
        {"cse": True, **only},
    )
    end = missed + ca.if_else(
        reached, 20.0 * _excess(limit["end_s"], s), UNREACHABLE / HALF_SAMPLES
    )
    only = {"is_diff_in": [False, False, False, True]}
    return sample, ca.Function(
        "end", [e.p, limits, sign, e.x], [end], {"cse": True, **only}
    )


def _basis(order: int) -> ca.DM:
    """Return the powers of the samples' fractions, (ROWS, samples), differentiated
    ``order`` times.
    """
    rows = [
        np.polyder(np.poly1d([1.0] + [0.0] * power), order)(_FRACTIONS)
        for power in range(ROWS)
    ]
    return ca.DM(np.array(rows))


def costs(
    mechanism: Mechanism, e: Equations, made: list[ca.Function]
) -> list[ca.Function]:
    """Return the functions ``crossing_cost`` and ``leg_cost``: a candidate's cost and
    its gradient over the variables.

    The cost is its peak torque, its time near the locus, and what it breaks. A torque
    counts more near the locus and beyond what costs one: each comes a little late, and
    the error that this leaves grows with it. So does what a torque changes by while it
    is late, which a leg's cost counts as well.
    """
    sample, end = _instant(mechanism, e)
    return [
        _cost(candidate, sample.map(HALF_SAMPLES), end)
        for candidate in made
        if candidate.name() in ("crossing", "leg")
    ]


def _cost(
    candidate: ca.Function, samples: ca.Function, end: ca.Function
) -> ca.Function:
    arguments = p, limits, _, variables = [
        ca.MX.sym(name, candidate.size1_in(i)) for i, name in enumerate(ARGUMENTS)
    ]
    first, second, spans, signs, own = candidate(*arguments)
    place = layouts(candidate.size1_out(0)).limits.places
    peak = near = total = ca.MX(0.0)
    for row, coefficients in enumerate((first, second)):
        span = spans[row]
        x, x_dot, x_ddot = (
            coefficients @ _basis(order) / span**order for order in range(3)
        )
        many = [ca.repmat(part, 1, HALF_SAMPLES) for part in (p, limits, signs[row])]
        found, tau = samples(
            *many, ca.DM(_FLOORS).T, x[:, :-1], x_dot[:, :-1], x_ddot[:, :-1]
        )
        load, close, broken, counted = ca.vertsplit(found)
        weights = ca.fabs(span) * ca.DM(_WEIGHTS)
        peak += load @ weights
        near += close @ weights
        total += counted @ weights
        own += ca.sum2(broken) + end(p, limits, signs[row], x[:, -1])
        if candidate.name() == "leg":
            steps = (tau[:, 1:] - tau[:, :-1]) / limits[place["torque"][0]]
            rates = ca.fabs(steps @ ca.diag(1.0 / np.diff(_FRACTIONS[:-1])) / span)
            steep = ca.sum1(ca.fmax(TORQUE_RISE * rates - 1.0, 0.0))
            own += ca.sum2(counted[1:] * counted[:-1] * steep)
    torque = ca.fmax(peak / ca.fmax(total, 1e-9), 1e-12) ** (1.0 / SOFT_MAXIMUM)
    cost = (
        torque
        + EXCESS * ca.fmax(torque - 1.0, 0.0)
        + near / limits[place["near_time"][0]]
        + own
    )
    return ca.Function(
        f"{candidate.name()}_cost",
        arguments,
        [cost, ca.densify(ca.gradient(cost, variables))],
        [*ARGUMENTS],
        ["cost", "gradient"],
    )
