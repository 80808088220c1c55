"""The five-bar's Type 2 locus in closed form: both families, in every working mode.

The distal links are aligned on the locus: r_1 = l2_1 d and r_2 = -+l2_2 d with a unit
vector d, so that P_2 - P_1 = (l2_1 +- l2_2) d. Opposite links (stretched) give the
coupler curve of the four-bar e_1 P_1 P_2 e_2; links that point the same way (folded)
give, for equal distal links, the circle about the elbows' common point, where the
direct model is undefined, and else the coupler curve of a four-bar with a short
coupler.

At a stretched point s changes along t_s (by 2/l2 for equal links). At a folded one with
equal distal links t_s is tangent to the locus: s changes only along v_1, radially.
"""

from __future__ import annotations

from enum import Enum

import casadi as ca
import numpy as np

from dextar_control.mechanisms.mechanism import Values
from dextar_control.mechanisms.planar import (
    TwoLinkLegs,
    circles,
    direction,
    overlap,
)
from dextar_control.symbols.types import Array, Symbol

SIDES = ("left", "right")
# m^2, of half the common chord of circles that do not touch: its root has a derivative
LEAST_CHORD = 1e-24


class Family(Enum):
    """How the distal links align: the value is the sign in l2_1 +- l2_2."""

    STRETCHED = 1
    FOLDED = -1


class FiveBarLocus(TwoLinkLegs):
    """What planning asks of a five-bar: its locus, its working modes and how large it
    is.

    Attributes:
        working_modes: all there are.
    """

    legs = SIDES
    working_modes = ((1, -1), (1, 1), (-1, 1), (-1, -1))

    def base(self, leg: int, p: Values) -> Symbol:
        """Return e_i (2,), m, a motor's axis."""
        return p[SIDES[leg]].axis

    def tip(self, leg: int, x: Symbol, p: Values) -> Symbol:
        """Return x (2,), m: both legs end in the end effector."""
        return x

    def type2_locus(
        self, family: Symbol, branch: Symbol, angle: Symbol, p: Values
    ) -> tuple[Symbol, Symbol, Symbol]:
        """Return a point of the locus.

        Args:
            family: value of the ``Family``.
            branch: +1 or -1: which of the two closures of the four-bar.
            angle: tracing angle, rad: of the left motor (stretched) or of d (folded).
            p: symbols.

        Returns:
            (q_a (2,), rad, x (2,), m, closing, 1): the four-bar closes where closing is
            not below zero; where it is, the point is the nearest to closing.
        """
        stretched = family > 0.0
        left, right = (p[side] for side in SIDES)
        first, second, turn = self.base(0, p), self.base(1, p), direction(angle)
        coupler = left.distal_length + family * right.distal_length
        center = first + ca.if_else(stretched, left.proximal_length, coupler) * turn
        radius = ca.if_else(stretched, coupler, left.proximal_length)
        circle = center, radius, second, right.proximal_length
        P_2 = circles(*circle, branch, LEAST_CHORD)
        P_1 = ca.if_else(stretched, center, P_2 - coupler * turn)
        d = ca.if_else(
            stretched, (P_2 - P_1) / (left.distal_length + right.distal_length), turn
        )
        elbows = P_1 - first, P_2 - second
        q_a = ca.vertcat(*(ca.atan2(elbow[1], elbow[0]) for elbow in elbows))
        return (
            q_a,
            P_1 + left.distal_length * d,
            overlap(*circle) / (left.proximal_length * right.proximal_length),
        )

    def family(self, A_r: Array) -> Family:
        """Return the family that a point of the locus belongs to, by A_r (2, 2), m,
        whose rows are r_1 and r_2.
        """
        return Family.STRETCHED if A_r[0] @ A_r[1] < 0.0 else Family.FOLDED

    def family_name(self, A_r: Array) -> str:
        """Return the name of ``family`` for A_r (2, 2), m, in lower case."""
        return self.family(A_r).name.lower()

    def modes(self, type1_sines: Array) -> Array:
        """Return the working modes (m, 2), 1, of the sines (m, 2), 1, of the elbows'
        angles: +1 where the elbow is on the left, which makes the sine negative.
        """
        return np.where(type1_sines < 0.0, 1, -1)

    def workspace(self, p: Values) -> tuple[Array, Array]:
        """Return the corners (2,), m, of a box that holds every place it reaches; ``p``
        has numbers.
        """
        reach = np.array(
            [
                float((p[side].proximal_length + p[side].distal_length)[0])
                for side in SIDES
            ]
        )
        axes = np.array([np.array(self.base(leg, p)).ravel() for leg in range(2)])
        return (axes - reach[:, None]).max(axis=0), (axes + reach[:, None]).min(axis=0)

    def length(self, p: Values) -> float:
        """Return the mean distal length, m, by which distances are measured; ``p`` has
        numbers.
        """
        return float(np.mean([p[side].distal_length[0] for side in SIDES]))
