"""The watches at every sample while a law acts: the table ``WATCHES``, with the reason
of each limit.

A watch compares a value with its limit. A watch with a time lets the value pass the
limit for that long: the time counts up while it does, and down at RECOVERY of that pace
otherwise, so that a value that swings about the limit is noticed too. The first watch
of the table that trips ends the motion in a safe stop (``control.safe_stop``) with one
sentence.

The estimator's belief about the assembly mode is watched by ``control.verdicts``, and
what needs a clock or the network (age of the states, a second commander) by the node.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from dextar_control.contract.plug_in import short_name
from dextar_control.contract.settings import Settings
from dextar_control.control.law import LAWS, OUTPUT, law_of
from dextar_control.estimation.estimate import Estimator
from dextar_control.estimation.records import ESTIMATE
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.planar import wrapped
from dextar_control.model.model import Model
from dextar_control.model.robot import AnyRobot
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.smooth import is_finite
from dextar_control.symbols.types import Array, Symbol

RECOVERY = 0.25  # pace at which a watch's time counts down, over that of counting up
LONG_STEP = 5e-3  # s since the last sample, beyond which no joint position is expected


class Watch(NamedTuple):
    """One watch.

    Attributes:
        name: of the watch.
        value: in words.
        unit: of the value.
        limit: the parameters that make it.
        time: the parameter that is the time for which the limit may be passed; empty
            for none.
        reason: of the defaults; "good runs" are those of the campaign that succeed.
        sentence: that is told when it trips; J is the joints' unit, T that of their
            torque.
    """

    name: str
    value: str
    unit: str
    limit: str
    time: str
    reason: str
    sentence: str


WATCHES = (
    Watch(
        "joint_jump",
        "a joint's distance from where the last sample expected it",
        "rad",
        "watch.max_joint_jump",
        "",
        "0.0012 in good runs, 0.015 when struck at the locus; an encoder that slips by"
        " more is seen at once",
        "a joint jumped by {value:.4f} {J} in one sample; the limit is {limit:.4g} {J}",
    ),
    Watch(
        "finite",
        "numbers of estimate and law that are not finite",
        "",
        "none",
        "",
        "such a number is never commanded",
        "the estimate or the law gave a number that is not finite; at the sample before"
        " it a leg was {type1:.3f} from Type 1, where its reach ends (a plan keeps"
        " {kept:g})",
    ),
    Watch(
        "tracking_error",
        "distance between reference and estimate",
        "m",
        "watch.max_tracking_error",
        "",
        "2.4 mm in good runs with consistent and observer, and 5 mm is a failure; at"
        " 20 mm the plan cannot be followed",
        "tracking error {value:.4f} m; the limit is {limit} m",
    ),
    Watch(
        "joint_speed",
        "a joint's change from one sample to the next, over the time between",
        "rad/s",
        "robot.max_joint_speed x watch.speed_margin",
        "watch.speed_time",
        "a plan may use the robot's limit entirely, and an error adds to it",
        "joint speed {value:.1f} {J}/s for {lasted:.0f} ms; the limit is {limit:.4g}"
        " {J}/s for {time:.0f} ms",
    ),
    Watch(
        "platform_speed",
        "speed of the estimate",
        "m/s",
        "robot.max_platform_speed x watch.speed_margin",
        "watch.speed_time",
        "as the joints'; the time is for the direct model, whose speed has no bound on"
        " the locus",
        "platform speed {value:.2f} m/s for {lasted:.0f} ms; the limit is {limit:.4g}"
        " m/s for {time:.0f} ms",
    ),
    Watch(
        "joint_range",
        "a joint's distance outside its range",
        "rad",
        "watch.joint_margin",
        "",
        "a plan may go to the end of the range; an error of 5 mm is 0.05 rad",
        "the {side} joint is {value:.3f} {J} outside its range of {low:.4g} to"
        " {high:.4g} {J}; the limit is {limit:.4g} {J}",
    ),
    Watch(
        "estimator",
        "a joint's distance from that of the estimated platform",
        "rad",
        "watch.max_joint_misfit",
        "watch.joint_misfit_time",
        "0.0048 in good runs with a geometry 0.2 mm off, 0.03 with 0.5 mm; a wrong"
        " estimate passes 0.06",
        "the joints are {value:.4f} {J} from the estimate's for {lasted:.0f} ms; the"
        " limit is {limit:.4g} {J} for {time:.0f} ms",
    ),
    Watch(
        "locus",
        "|s| of the estimate outside phase CROSSING",
        "",
        "watch.min_abs_s (at least)",
        "",
        "plans keep 0.4 there, approaches 0.2; the robots of good runs kept 0.36. A"
        " robot that comes nearer was pushed, or its estimate is wrong",
        "the robot is at |s| = {value:.3f} of the locus without a planned crossing; the"
        " limit is {limit:.4g}",
    ),
    Watch(
        "saturation",
        "the larger torque, except where the side is known and the error shrinks",
        "N m",
        "the torque limit of the law",
        "torque_limit.time",
        "42 ms in runs that recover from a push of 0.5 N; a robot on the other side, or"
        " against an obstacle, stays there",
        "torque {value:.3f} {T} for {lasted:.0f} ms; the limit is {limit:.3f} {T} for"
        " {time:.0f} ms",
    ),
    Watch(
        "torque_rate",
        "change of a torque since the last sample, over the time between",
        "N m/s",
        "robot.max_torque x watch.max_torque_rate",
        "watch.torque_rate_time",
        "65 N m/s for 3 ms in good runs; a loop that swings between its limits passes"
        " it at each sample",
        "the torque changes by {value:.0f} {T}/s for {lasted:.0f} ms; the limit is"
        " {limit:.4g} {T}/s for {time:.0f} ms",
    ),
)
SENTENCES = {watch.name: watch.sentence for watch in WATCHES}
NAMES = [*SENTENCES]
VALUES = tuple(Field(watch.name, watch.unit or "1", watch.value) for watch in WATCHES)
BOUNDS = (
    Field("middle", "rad", "of the joints' ranges", "n"),
    Field("half", "rad", "of the ranges' widths", "n"),
    Field("limits", "SI", "of the watches, but for saturation's", len(WATCHES)),
)
LAST = (
    Field("known", "1", "1 where there was a sample before"),
    Field("q_meas", "rad", "joints of the last sample", "n"),
    Field("q_a", "rad", "joints of its estimate", "n"),
    Field("q_a_dot", "rad/s", "their velocities", "n"),
    Field("tau", "N m", "torques of its answer", "n"),
    Field("type1", "1", "distance to Type 1 of the last finite estimate"),
)
# watches that show that the estimate is wrong
ESTIMATE_LOST = ("finite", "joint_jump", "estimator")


def watch_of(mechanism: Mechanism) -> ca.Function:
    """Return the function ``watch``: (p, bounds, last, estimate, output, q_meas, dt,
    limit, crossing) -> values, limits, passed, told, last_next.
    """
    n, watched = mechanism.n, Layout("watched", mechanism.n, VALUES)
    vector, p = mechanism.symbols()
    bounds_vector, bounds = Layout("bounds", n, BOUNDS).symbols()
    last_vector, last = Layout("last", n, LAST).symbols()
    hat_vector, hat = Layout("estimate", n, ESTIMATE).symbols()
    out_vector, out = Layout("output", n, OUTPUT).symbols()
    q_meas = ca.SX.sym("q_meas", n)
    # the range of an angle holds on any turn
    turns = ca.DM([joint.unit == "rad" for joint in mechanism.joints])
    dt, limit, crossing = (ca.SX.sym(name) for name in ("dt", "limit", "crossing"))
    known = last["known"] > 0.0
    finite = ca.if_else(is_finite(hat_vector) * out["finite"] > 0.0, 1.0, 0.0)

    def largest(values: Symbol, when: Symbol) -> Symbol:
        """Return the largest size, 0 where it is not finite, which "finite" watches."""
        return ca.if_else(when, ca.fmax(ca.mmax(ca.fabs(values)), 0.0), 0.0)

    q_hat = mechanism.inverse_geometric_model(hat["x"], p)
    type1 = ca.mmin(ca.fabs(mechanism.type1_sines(q_hat, hat["x"], p)))
    expected = last["q_a"] + dt * last["q_a_dot"]
    recent, answered = ca.logic_and(known, dt <= LONG_STEP), ca.logic_and(known, finite)
    off = q_meas - bounds["middle"]
    off = ca.if_else(turns, wrapped(off), off)
    values = {
        "joint_jump": largest(wrapped(q_meas - expected), recent),
        "finite": 1.0 - finite,
        "tracking_error": ca.if_else(finite, ca.norm_2(out["error"]), 0.0),
        "joint_speed": largest(wrapped(q_meas - last["q_meas"]), known) / dt,
        "platform_speed": ca.if_else(finite, ca.norm_2(hat["x_dot"]), 0.0),
        "joint_range": ca.mmax(ca.fabs(off) - bounds["half"]),
        "estimator": largest(wrapped(q_meas - q_hat), finite),
        "locus": ca.if_else(finite, ca.fabs(out["s"]), 0.0),
        "saturation": largest(out["tau"], finite),
        "torque_rate": largest(out["tau"] - last["tau"], answered) / dt,
    }
    limits = watched.split(bounds["limits"])
    limits |= {
        "locus": ca.if_else(crossing > 0.0, 0.0, limits["locus"]),
        "saturation": limit,
    }
    passed = {
        name: ca.logic_not(value <= limits[name]) for name, value in values.items()
    } | {
        "locus": values["locus"] < limits["locus"],
        "saturation": values["saturation"] >= limit,
    }
    before = ca.if_else(known, last["type1"], 1.0)
    now = {
        "known": ca.SX(1.0),
        "q_meas": q_meas,
        "q_a": hat["q_a"],
        "q_a_dot": hat["q_a_dot"],
        "tau": out["tau"],
        "type1": ca.if_else(is_finite(q_hat) > 0.0, type1, before),
    }
    arguments = {
        "p": vector,
        "bounds": bounds_vector,
        "last": last_vector,
        "estimate": hat_vector,
        "output": out_vector,
        "q_meas": q_meas,
        "dt": dt,
        "limit": limit,
        "crossing": crossing,
    }
    return named(
        "watch",
        arguments,
        {
            "values": watched.join(values),
            "limits": watched.join(limits),
            "passed": watched.join(passed),
            "told": ca.vertcat(
                ca.mmax(ca.vertcat(*passed.values())), passed["saturation"]
            ),
            "last_next": Layout("last", n, LAST).join(now),
        },
    )


def timer_after(timer: float, dt: float, passed: bool) -> float:
    """Return the time, s, of a watch that was ``timer`` dt, s, ago."""
    return timer + dt if passed else max(timer - RECOVERY * dt, 0.0)


@lru_cache
def acts_of(mechanism: Mechanism, laws: tuple[str, ...] = tuple(LAWS)) -> Library:
    """Return the functions ``act_NAME``, one for each law: its tick and the watches of
    its output.

    Raises:
        ParameterError: there is no law of a name, or its equations cannot be built.
    """
    watch, acts = watch_of(mechanism), []
    for law in laws:
        tick = law_of(mechanism, law)
        sizes = {
            name: function.size1_in(name)
            for function in (tick, watch)
            for name in function.name_in()
            if name != "output"
        }
        given = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
        own = {name: given[name] for name in tick.name_in()}
        answered = tick.call(own, False, True)
        known = given | answered
        watched = {name: known[name] for name in watch.name_in()}
        found = answered | watch.call(watched, False, True)
        places = [*given.values()], [*found.values()], [*given], [*found]
        acts.append(ca.Function(f"act_{short_name(law)}", *places))
    return Library(acts, cache_folder())


class Supervisor:
    """The watches of one robot under a law.

    Args:
        robot: the controller's model of it.
        model: the same, with its functions.

    Attributes:
        places: arrays that the functions of ``acts_of`` share with it.
        times: of each watch, for which its limit may be passed, s; negative for none.
        saturated: whether a torque was at its limit at the last sample.
        tripped: name of the watch that tripped at the last sample; empty for none.
    """

    def __init__(self, robot: AnyRobot, model: Model) -> None:
        self._robot, self._joint = robot, model.mechanism.joints[0]
        low, high = (np.array(bounds) for bounds in robot.joint_range)
        watched = Layout("watched", model.n, VALUES)
        self._values, self._limits, self._passed = (watched.make() for _ in range(3))
        self._last = Layout("last", model.n, LAST).make()
        self._bounds = Layout("bounds", model.n, BOUNDS).make(
            middle=0.5 * (low + high), half=0.5 * (high - low)
        )
        self._told = np.zeros(2)
        self.places = {
            "bounds": self._bounds.numbers,
            "last": self._last.numbers,
            "last_next": self._last.numbers,
            "told": self._told,
            "values": self._values.numbers,
            "limits": self._limits.numbers,
            "passed": self._passed.numbers,
        }
        self.times = dict.fromkeys(NAMES, -1.0)
        self._timers = dict.fromkeys(NAMES, 0.0)
        self._counting = False
        self._error = 0.0
        self.saturated = False
        self.tripped = ""

    def configure(self, settings: Settings) -> None:
        """Take the limits, also while running."""
        watch, robot = settings.watch, self._robot
        self.times |= {
            "joint_speed": watch.speed_time,
            "platform_speed": watch.speed_time,
            "estimator": watch.joint_misfit_time,
            "torque_rate": watch.torque_rate_time,
            "saturation": settings.torque_limit.time,
        }
        limits = self._limits.layout.make(
            tracking_error=watch.max_tracking_error,
            joint_speed=watch.speed_margin * robot.max_joint_speed,
            platform_speed=watch.speed_margin * robot.max_platform_speed,
            joint_range=watch.joint_margin,
            joint_jump=watch.max_joint_jump,
            estimator=watch.max_joint_misfit,
            torque_rate=watch.max_torque_rate * robot.max_torque,
            locus=watch.min_abs_s,
        )
        self._bounds.limits = limits.numbers

    def begin(self) -> None:
        """Begin a trajectory: the times count anew."""
        self._timers = dict.fromkeys(NAMES, 0.0)
        self._counting = False

    def forget(self) -> None:
        """Forget the last sample, as the law stops acting."""
        self.begin()
        self._values.numbers[:] = 0.0
        self._last.numbers[:] = 0.0

    def check(self, q_a: Array, dt: float, estimator: Estimator) -> str:
        """Return the sentence, with value and limit, of the watch that trips at the
        sample that was just answered; "" for none.

        Args:
            q_a: measured joints, (n,), rad.
            dt: since the last sample, s.
            estimator: which knows the side of the locus or not.
        """
        trips, saturated = self._told.tolist()
        self.saturated, self.tripped = saturated > 0.0, ""
        if self._counting or trips > 0.0:
            before, self._error = self._error, self.error
            recovers = estimator.mode_known and self._error < before
            self._count(self._passed.numbers.tolist(), dt, recovers)
        return self._sentence(self.tripped, q_a) if self.tripped else ""

    def _count(self, passed: list[float], dt: float, recovers: bool) -> None:
        """Count the times of the watches that have one, and find the first watch that
        trips.
        """
        self._counting = False
        for name, over in zip(NAMES, passed, strict=True):
            trips = over > 0.0 and not (recovers and name == "saturation")
            time = self.times[name]
            if time >= 0.0:
                self._timers[name] = timer = timer_after(self._timers[name], dt, trips)
                trips = timer > time
                self._counting = self._counting or timer > 0.0
            if trips and not self.tripped:
                self.tripped = name

    @property
    def error(self) -> float:
        """The distance between reference and estimate at the last sample, m."""
        return float(self._values.tracking_error)

    @property
    def estimate_lost(self) -> bool:
        """Whether the watch that tripped at the last sample shows that the estimate is
        wrong.
        """
        return self.tripped in ESTIMATE_LOST

    @property
    def watches(self) -> dict[str, tuple[float, float]]:
        """(last value, limit) of each watch by its name; a limit of 0 does not bind."""
        pairs = zip(
            self._values.numbers.tolist(), self._limits.numbers.tolist(), strict=True
        )
        return dict(zip(NAMES, pairs, strict=True))

    def _sentence(self, name: str, q_a: Array) -> str:
        lows, highs = self._robot.joint_range
        beyond = [
            abs(math.remainder(q - 0.5 * (low + high), 2.0 * math.pi))
            - 0.5 * (high - low)
            for q, low, high in zip(q_a.tolist(), lows, highs, strict=True)
        ]
        leg = int(np.argmax(beyond))
        return SENTENCES[name].format(
            value=getattr(self._values, name),
            limit=getattr(self._limits, name),
            J=self._joint.unit,
            T=self._joint.effort_unit,
            lasted=1e3 * self._timers[name],
            time=1e3 * self.times[name],
            type1=self._last.type1,
            kept=self._robot.min_type1_distance,
            side=self._robot.sides[leg],
            low=lows[leg],
            high=highs[leg],
        )
