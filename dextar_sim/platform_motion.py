"""Equations of motion of the five-bar in platform coordinates, and their steps of
fourth order, on symbols.

Principle of virtual power with the end effector's position x as the coordinates. Each
leg's links turn at theta_1 (proximal) and theta_2 (distal) from the x axis; u is the
unit vector along a link, n = (-u_y, u_x), delta = theta_2 - theta_1. From x_dot = l1
n_1 theta_1_dot + l2 n_2 theta_2_dot, multiplied by u_2 and u_1:

    theta_1_dot = j_1 . x_dot,  j_1 =  u_2 / (l1 sin delta)
    theta_2_dot = j_2 . x_dot,  j_2 = -u_1 / (l2 sin delta)

and once more for x_ddot, with j_i . x_ddot + g_i for the accelerations. A body of mass
m and inertia I whose centre has the Jacobian J and the velocity-dependent acceleration
b adds J^T m J + I j j^T to the platform's inertia and J^T m (gravity - b) - I j g to
its force; a motor adds j_1 tau. The Jacobians are regular where the distal links are
parallel (Type 2) and grow without bound where a leg is stretched or folded (Type 1).
Around such a pose that leg's theta_1, theta_2 are the coordinates z instead: x = x(z),
x_ddot = G z_ddot + c, and the same sum over the bodies; the leg passes, as a real one
does.
"""

from __future__ import annotations

import math
import struct
from functools import lru_cache, reduce

import casadi as ca
import numpy as np

from dextar_control.contract.robot import RobotParameters
from dextar_control.symbols.functions import Library, cache_folder, named
from dextar_control.symbols.record import Field, Layout
from dextar_control.symbols.types import Array, Numbers, Symbol
from dextar_sim.state import state_layout

# |sin delta| below which a leg's own angles are the coordinates; at 100 rad/s it turns
# by half of that in 1 ms.
_OWN_SINE = 0.2
PLATFORM = -1  # no leg's angles: the end effector's position is the coordinates
CHARTS = {PLATFORM: "platform", 0: "left", 1: "right"}
LEG_NUMBERS = 12
STATE = state_layout(2, 4)


@lru_cache
def drive_layout(torques: int) -> Layout:
    """Return the layout of torques at the two motors, or at all four joints."""
    return Layout(
        "drive",
        2,
        (
            Field("first", "N m", "torques of the first substeps", torques),
            Field("last", "N m", "of the others", torques),
            Field("push", "N", "force on the end effector over the first substep", 2),
            Field("late", "1", "substeps under the first torques"),
        ),
    )


Row = tuple[float, ...]
Term = Symbol  # or a number, which CasADi takes in its place
Terms = list[Term]


def _lesser(least: Term, value: Term) -> Term:
    """Return the lesser of both, and nan where the value is nan."""
    return ca.if_else(value >= least, least, value)


def _elbow(
    x: Term, y: Term, base: Terms, proximal: Term, distal: Term, side: Term
) -> tuple[Term, Term, Term, Term]:
    """Return cos and sin of theta_1 and theta_2 with the elbow on a side of the line
    base -> (x, y); nan out of reach.
    """
    dx, dy = x - base[0], y - base[1]
    square = dx * dx + dy * dy
    along = 0.5 * (proximal * proximal - distal * distal + square) / square
    across = side * ca.sqrt(proximal * proximal / square - along * along)
    ex, ey = along * dx - across * dy, along * dy + across * dx
    return ex / proximal, ey / proximal, (dx - ex) / distal, (dy - ey) / distal


def _acceleration(
    z: Terms,
    z_dot: Terms,
    chart: int,
    sides: Terms,
    motors: Terms,
    push: Terms,
    legs: list[Terms],
    shared: Terms,
) -> tuple[Term, Term, Term]:
    """Return z_ddot and the least |sin delta| of the legs outside the coordinates.

    Args:
        z, z_dot: x and y, m and m/s, or theta_1 and theta_2 of one leg, rad and rad/s.
        chart: that leg, or ``PLATFORM``.
        sides: of the elbows, +1 left of the line base -> end effector.
        motors: torques before friction, N m; four are those at q11, q12, q21, q22.
        push: force on the end effector, N.
        legs: a row for each leg as ``leg_row`` makes it.
        shared: end effector mass, gravity x, gravity y, coulomb speed.
    """
    mass, gx, gy, coulomb_speed = shared
    one, zero = ca.SX(1.0), ca.SX(0.0)
    (x, y), (vx, vy) = z, z_dot
    g_xx, g_xy, g_yx, g_yy, c_x, c_y = one, zero, zero, one, zero, zero
    own: Terms = []
    if chart != PLATFORM:
        l1, l2 = legs[chart][2], legs[chart][6]
        w1, w2 = z_dot
        own = [function(angle) for angle in z for function in (ca.cos, ca.sin)]
        cos_1, sin_1, cos_2, sin_2 = own
        x = legs[chart][0] + l1 * cos_1 + l2 * cos_2
        y = legs[chart][1] + l1 * sin_1 + l2 * sin_2
        g_xx, g_xy, g_yx, g_yy = -l1 * sin_1, -l2 * sin_2, l1 * cos_1, l2 * cos_2
        vx, vy = g_xx * w1 + g_xy * w2, g_yx * w1 + g_yy * w2
        c_x = -l1 * cos_1 * w1 * w1 - l2 * cos_2 * w2 * w2
        c_y = -l1 * sin_1 * w1 * w1 - l2 * sin_2 * w2 * w2
    least = one
    m_11 = mass * (g_xx * g_xx + g_yx * g_yx)
    m_12 = mass * (g_xx * g_xy + g_yx * g_yy)
    m_22 = mass * (g_xy * g_xy + g_yy * g_yy)
    p_x, p_y = push[0] + mass * (gx - c_x), push[1] + mass * (gy - c_y)
    f_1, f_2 = g_xx * p_x + g_yx * p_y, g_xy * p_x + g_yy * p_y
    for i in range(2):
        *base, l1, m1, c1, i1, l2, m2, c2, i2, viscous, coulomb = legs[i]
        if i == chart:
            cos_1, sin_1, cos_2, sin_2 = own
            j11, j12, j21, j22 = one, zero, zero, one
            w1, w2 = z_dot
            inward_1, inward_2 = w1 * w1, w2 * w2
            g1, g2 = zero, zero
        else:
            cos_1, sin_1, cos_2, sin_2 = _elbow(x, y, base, l1, l2, sides[i])
            cos_d, sin_d = cos_1 * cos_2 + sin_1 * sin_2, cos_1 * sin_2 - sin_1 * cos_2
            least = _lesser(least, ca.fabs(sin_d))
            j1x, j1y = cos_2 / (l1 * sin_d), sin_2 / (l1 * sin_d)
            j2x, j2y = -cos_1 / (l2 * sin_d), -sin_1 / (l2 * sin_d)
            w1, w2 = j1x * vx + j1y * vy, j2x * vx + j2y * vy
            inward_1, inward_2 = w1 * w1, w2 * w2
            g1 = (
                (l1 * inward_1 * cos_d + l2 * inward_2) / (l1 * sin_d)
                + j1x * c_x
                + j1y * c_y
            )
            g2 = (
                -(l1 * inward_1 + l2 * inward_2 * cos_d) / (l2 * sin_d)
                + j2x * c_x
                + j2y * c_y
            )
            j11, j12 = j1x * g_xx + j1y * g_yx, j1x * g_xy + j1y * g_yy
            j21, j22 = j2x * g_xx + j2y * g_yx, j2x * g_xy + j2y * g_yy
        torque = (
            motors[i if len(motors) == 2 else 2 * i]
            - viscous * w1
            - coulomb * ca.tanh(w1 / coulomb_speed)
        )
        f_1 += j11 * (torque - i1 * g1) - j21 * i2 * g2
        f_2 += j12 * (torque - i1 * g1) - j22 * i2 * g2
        if len(motors) > 2:
            f_1 += (j21 - j11) * motors[2 * i + 1]
            f_2 += (j22 - j12) * motors[2 * i + 1]
        m_11 += i1 * j11 * j11 + i2 * j21 * j21
        m_12 += i1 * j11 * j12 + i2 * j21 * j22
        m_22 += i1 * j12 * j12 + i2 * j22 * j22
        for m, arm_1, arm_2 in ((m1, c1, zero), (m2, l1, c2)):
            x1 = -arm_1 * sin_1 * j11 - arm_2 * sin_2 * j21
            x2 = -arm_1 * sin_1 * j12 - arm_2 * sin_2 * j22
            y1 = arm_1 * cos_1 * j11 + arm_2 * cos_2 * j21
            y2 = arm_1 * cos_1 * j12 + arm_2 * cos_2 * j22
            b_x = -arm_1 * (sin_1 * g1 + cos_1 * inward_1) - arm_2 * (
                sin_2 * g2 + cos_2 * inward_2
            )
            b_y = arm_1 * (cos_1 * g1 - sin_1 * inward_1) + arm_2 * (
                cos_2 * g2 - sin_2 * inward_2
            )
            m_11 += m * (x1 * x1 + y1 * y1)
            m_12 += m * (x1 * x2 + y1 * y2)
            m_22 += m * (x2 * x2 + y2 * y2)
            f_1 += m * (x1 * (gx - b_x) + y1 * (gy - b_y))
            f_2 += m * (x2 * (gx - b_x) + y2 * (gy - b_y))
    determinant = m_11 * m_22 - m_12 * m_12
    return (
        (m_22 * f_1 - m_12 * f_2) / determinant,
        (m_11 * f_2 - m_12 * f_1) / determinant,
        least,
    )


def _substep(
    z: Terms,
    z_dot: Terms,
    chart: int,
    sides: Terms,
    motors: Terms,
    push: Terms,
    h: Term,
    legs: list[Terms],
    shared: Terms,
) -> tuple[Terms, Terms, Term]:
    """Make one Runge-Kutta step of fourth order; return coordinates, rates, and the
    least |sin delta| met.
    """

    def rate(place: Terms, speed: Terms) -> tuple[Terms, Term]:
        first, second, least = _acceleration(
            place, speed, chart, sides, motors, push, legs, shared
        )
        return [first, second], least

    def moved(start: Terms, slope: Terms, span: Term) -> Terms:
        return [
            begin + span * change for begin, change in zip(start, slope, strict=True)
        ]

    half = 0.5 * h
    a1, sine_1 = rate(z, z_dot)
    v2 = moved(z_dot, a1, half)
    a2, sine_2 = rate(moved(z, z_dot, half), v2)
    v3 = moved(z_dot, a2, half)
    a3, sine_3 = rate(moved(z, v2, half), v3)
    v4 = moved(z_dot, a3, h)
    a4, sine_4 = rate(moved(z, v3, h), v4)
    mean_v = [(z_dot[i] + 2.0 * (v2[i] + v3[i]) + v4[i]) / 6.0 for i in range(2)]
    mean_a = [(a1[i] + 2.0 * (a2[i] + a3[i]) + a4[i]) / 6.0 for i in range(2)]
    least = reduce(_lesser, (sine_1, sine_2, sine_3, sine_4), ca.SX(1.0))
    return moved(z, mean_v, h), moved(z_dot, mean_a, h), least


def _placed(
    z: Terms, z_dot: Terms, chart: int, sides: Terms, joints: Terms, legs: list[Terms]
) -> tuple[Terms, Terms, Terms, Term]:
    """Return the platform (x, y, x_dot, y_dot), the joints beside the turns they had,
    their rates, and the least |sin delta|.
    """
    (a, b), (a_dot, b_dot) = (x, y), (vx, vy) = z, z_dot
    if chart != PLATFORM:
        base_x, base_y, l1, *_, l2 = legs[chart][:7]
        x = base_x + l1 * ca.cos(a) + l2 * ca.cos(b)
        y = base_y + l1 * ca.sin(a) + l2 * ca.sin(b)
        vx = -l1 * ca.sin(a) * a_dot - l2 * ca.sin(b) * b_dot
        vy = l1 * ca.cos(a) * a_dot + l2 * ca.cos(b) * b_dot
    found, rates, least = [], [], ca.SX(1.0)
    for i in range(2):
        if i == chart:
            found += [a, b - a]
            rates += [a_dot, b_dot - a_dot]
            continue
        *base, l1 = legs[i][:3]
        l2 = legs[i][6]
        cos_1, sin_1, cos_2, sin_2 = _elbow(x, y, base, l1, l2, sides[i])
        cos_d, sin_d = cos_1 * cos_2 + sin_1 * sin_2, cos_1 * sin_2 - sin_1 * cos_2
        least = _lesser(least, ca.fabs(sin_d))
        for old, angle in (
            (joints[2 * i], ca.atan2(sin_1, cos_1)),
            (joints[2 * i + 1], ca.atan2(sin_d, cos_d)),
        ):
            turn = angle - old
            found.append(
                old + turn - 2.0 * math.pi * ca.floor(turn / (2.0 * math.pi) + 0.5)
            )
        w1 = (cos_2 * vx + sin_2 * vy) / (l1 * sin_d)
        rates += [w1, -(cos_1 * vx + sin_1 * vy) / (l2 * sin_d) - w1]
    return [x, y, vx, vy], found, rates, least


@lru_cache
def motion(substeps: int, torques: int) -> Library:
    """Return ``period_CHART`` for each chart, and ``acceleration``, compiled where that
    can be done.

    Args:
        substeps: Runge-Kutta steps in one period.
        torques: 2 at the motors or 4 at all joints.
    """
    z, z_dot, sides, push = (
        ca.SX.sym(name, 2) for name in ("z", "z_dot", "sides", "push")
    )
    motors = ca.SX.sym("motors", torques)
    (now_vector, now) = STATE.symbols()
    (drive_vector, drive) = drive_layout(torques).symbols()
    h = ca.SX.sym("h")
    robot, shared = ca.SX.sym("legs", 2 * LEG_NUMBERS), ca.SX.sym("shared", 4)
    vectors = (z, z_dot, sides, motors, push, now["joints"], shared)
    pz, pz_dot, psides, pmotors, ppush, pjoints, pshared = map(ca.vertsplit, vectors)
    legs = [*map(ca.vertsplit, ca.vertsplit(robot, LEG_NUMBERS))]
    state = {"z": z, "z_dot": z_dot, "sides": sides}
    acting = {"motors": motors, "push": push, "legs": robot, "shared": shared}
    functions = []
    for chart, name in CHARTS.items():
        moved, speed, least = _substep(
            pz, pz_dot, chart, psides, pmotors, ppush, h, legs, pshared
        )
        step = named(
            f"step_{name}",
            state | acting | {"h": h},
            {
                "z_next": ca.vertcat(*moved),
                "z_dot_next": ca.vertcat(*speed),
                "least": least,
            },
        )
        begun = named(
            f"begin_{name}",
            {"state": now_vector, "drive": drive_vector},
            _begun(chart, now, drive, substeps),
        )
        platform, found, rates, least = _placed(
            pz, pz_dot, chart, psides, pjoints, legs
        )
        after: dict[str, Term] = now | {
            "joints": ca.vertcat(*found),
            "joints_dot": ca.vertcat(*rates),
            "q_a": ca.vertcat(*found[::2]),
            "q_a_dot": ca.vertcat(*rates[::2]),
            "x": ca.vertcat(*platform[:2]),
            "x_dot": ca.vertcat(*platform[2:]),
        }
        met = ca.SX.sym("met", 1, substeps)
        for k in range(substeps):
            least = _lesser(met[k], least)
        place = named(
            f"place_{name}",
            {
                "z": z,
                "z_dot": z_dot,
                "sides": sides,
                "legs": robot,
                "state": now_vector,
                "met": met,
            },
            {
                "state_next": STATE.join(after),
                "told": ca.vertcat(
                    least, ca.fabs(ca.sin(found[1])), ca.fabs(ca.sin(found[3]))
                ),
            },
        )
        functions.append(_period(f"period_{name}", begun, step, place, substeps))
    first, second, least = _acceleration(
        pz, pz_dot, PLATFORM, psides, pmotors, ppush, legs, pshared
    )
    functions.append(
        named(
            "acceleration",
            state | acting,
            {"z_ddot": ca.vertcat(first, second), "least": least},
        )
    )
    return Library(functions, cache_folder())


def _begun(
    chart: int, now: dict[str, Term], drive: dict[str, Term], substeps: int
) -> dict[str, Term]:
    """Return coordinates, rates and elbows' sides of a state, and motor torques and
    push of each substep, in columns.
    """
    joints, rates = now["joints"], now["joints_dot"]
    z, z_dot = now["x"], now["x_dot"]
    if chart != PLATFORM:
        leg = 2 * chart
        z, z_dot = (
            ca.vertcat(of[leg], of[leg] + of[leg + 1]) for of in (joints, rates)
        )
    motors = [
        ca.if_else(k < drive["late"], drive["first"], drive["last"])
        for k in range(substeps)
    ]
    push = [drive["push"], *[ca.SX.zeros(2)] * (substeps - 1)]
    return {
        "z": z,
        "z_dot": z_dot,
        "sides": _sides(joints),
        "motors": ca.horzcat(*motors),
        "push": ca.horzcat(*push),
    }


def _sides(joints: Term) -> Term:
    """Return the elbows' sides: one lies left of the line base -> end effector (+1)
    where its distal link turns right.
    """
    return ca.vertcat(
        *(ca.if_else(ca.sin(joints[k]) >= 0.0, -1.0, 1.0) for k in (1, 3))
    )


def _period(
    name: str, begun: ca.Function, step: ca.Function, place: ca.Function, substeps: int
) -> ca.Function:
    """Compose the function from state to state: substeps one after the other, then the
    joints.
    """
    drive_size = begun.numel_in("drive")
    sizes = {
        "state": STATE.size,
        "drive": drive_size,
        "h": 1,
        "legs": 2 * LEG_NUMBERS,
        "shared": 4,
    }
    given = {key: ca.MX.sym(key, size) for key, size in sizes.items()}
    begin = begun(state=given["state"], drive=given["drive"])
    steps = step.mapaccum(
        f"{name}_steps", substeps, ["z", "z_dot"], ["z_next", "z_dot_next"]
    )
    same = {
        key: ca.repmat(value, 1, substeps)
        for key, value in {"sides": begin["sides"], **given}.items()
        if key in ("sides", "h", "legs", "shared")
    }
    moved = steps(
        z=begin["z"],
        z_dot=begin["z_dot"],
        motors=begin["motors"],
        push=begin["push"],
        **same,
    )
    found = place(
        z=moved["z_next"][:, -1],
        z_dot=moved["z_dot_next"][:, -1],
        sides=begin["sides"],
        legs=given["legs"],
        state=given["state"],
        met=moved["least"],
    )
    return ca.Function(
        name, list(given.values()), list(found.values()), list(given), list(found)
    )


class PlatformMotion:
    """Steps one robot from joints to joints.

    Args:
        robot: the description.
        substeps: Runge-Kutta steps in one period.
        substep: duration of one, s.
        torques: 2 at the motors or 4 at all joints.

    Attributes:
        state: a record of ``STATE``, but for its time.
    """

    def __init__(
        self, robot: RobotParameters, substeps: int, substep: float, torques: int = 2
    ) -> None:
        self.state, layout = STATE.make(), drive_layout(torques)
        self._numbers = numbers = {
            "legs": np.array([*leg_row(robot, 0), *leg_row(robot, 1)]),
            "shared": np.array(
                [robot.end_effector_mass, *robot.gravity, robot.coulomb_speed]
            ),
        }
        library = motion(substeps, torques)
        drive = np.zeros(layout.size)
        self._told = np.zeros(3)
        places = {
            "state": self.state.numbers,
            "state_next": self.state.numbers,
            "drive": drive,
            "told": self._told,
            "h": np.array([substep]),
        }
        self._pack = struct.Struct(f"{layout.size}d").pack_into
        self._drive = memoryview(drive)  # type: ignore[arg-type]  # numpy's stub
        self._periods = {
            chart: library.fast(f"period_{name}", **numbers, **places)
            for chart, name in CHARTS.items()
        }
        self._acceleration = library.fast("acceleration", **numbers)
        self._sines = (1.0, 1.0)

    def place(
        self, joints: Numbers, joints_dot: Numbers, x: Numbers, x_dot: Numbers
    ) -> None:
        """Begin at these joints, (4,), rad and rad/s, and this end effector, (2,), m
        and m/s.
        """
        now = self.state
        now.joints, now.joints_dot, now.x, now.x_dot = joints, joints_dot, x, x_dot
        now.q_a, now.q_a_dot = joints[::2], joints_dot[::2]
        self._sines = abs(math.sin(joints[1])), abs(math.sin(joints[3]))

    def advance(self, first: Row, last: Row, late: int, blow: Row) -> float:
        """Advance one period; return the least |sin delta| met, nan when the motion is
        lost.

        Args:
            first, last: torques of the first ``late`` substeps and of the others, N m.
            late: substeps.
            blow: force on the end effector over the first substep, N.
        """
        # in the order of drive_layout
        self._pack(self._drive, 0, *first, *last, *blow, late)
        left, right = self._sines
        chart = (
            PLATFORM
            if left >= _OWN_SINE and right >= _OWN_SINE
            else 0
            if left < right
            else 1
        )
        self._periods[chart].run()
        least, *self._sines = self._told.tolist()
        return float(least)

    def carry(self, mass: float) -> None:
        """Let the end effector have this mass, kg, from now on."""
        self._numbers["shared"][0] = mass

    def acceleration(self, motors: Row) -> Array:
        """Return the platform's acceleration now, (2,), m/s^2, off Type 1, under
        torques before friction, (2,), N m.
        """
        found, now = self._acceleration.arguments, self.state
        sines = np.sin(now.joints[1::2])
        found.z[:] = now.x
        found.z_dot[:] = now.x_dot
        found.sides[:] = np.where(sines >= 0.0, -1.0, 1.0)
        found.motors[:] = motors
        self._acceleration.run()
        return np.array(self._acceleration.results.z_ddot)


def leg_row(robot: RobotParameters, index: int) -> Row:
    """List the numbers of a leg that the motion takes.

    Returns:
        Base x and y (m), then of the proximal and the distal link length (m), mass
        (kg), centre (m), inertia about it (kg m^2; the proximal one with the rotor),
        then viscous (N m s/rad) and Coulomb (N m) friction.
    """
    leg = robot.legs[index]
    return (
        *leg.axis,
        leg.proximal_length,
        leg.proximal_mass,
        leg.proximal_center * leg.proximal_length,
        leg.proximal_inertia + leg.rotor_inertia,
        leg.distal_length,
        leg.distal_mass,
        leg.distal_center * leg.distal_length,
        leg.distal_inertia,
        leg.viscous_friction,
        leg.coulomb_friction,
    )
