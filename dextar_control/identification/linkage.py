"""The elbows of a five-bar as functions of the numbers that a calibration looks for."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np

from dextar_control.mechanisms.five_bar import FiveBar
from dextar_control.mechanisms.planar import direction
from dextar_control.symbols.functions import Batch, named
from dextar_control.symbols.types import Array

NAMES = (
    "left.proximal_length", "right.proximal_length", "left.distal_length", "right.distal_length",
    "left.axis.x", "left.axis.y", "right.axis.x", "right.axis.y", "left.encoder_offset", "right.encoder_offset",
)
DISTAL = (2, 3)


class Linkage:
    """Elbows and their derivatives by the numbers of ``NAMES``; not for two threads at once."""

    def __init__(self) -> None:
        g, q = ca.SX.sym("numbers", len(NAMES)), ca.SX.sym("reading", 2)
        five_bar = FiveBar()
        p = SimpleNamespace(base_distance=0.0, left=SimpleNamespace(proximal_length=g[0]),
                            right=SimpleNamespace(proximal_length=g[1]))
        elbows = [five_bar.elbow(leg, q[leg] - g[8 + leg], p) + g[4 + 2 * leg : 6 + 2 * leg] for leg in range(2)]
        between = elbows[1] - elbows[0]
        self._between = Batch(named("between", {"numbers": g, "reading": q},
                                    {"between": between, "slopes": ca.jacobian(between, g)}))
        x = ca.SX.sym("x", 2)
        gaps = ca.vertcat(*(ca.norm_2(x - elbow) - g[2 + leg] for leg, elbow in enumerate(elbows)))
        self._closure = Batch(named("closure", {"numbers": g, "reading": q, "x": x},
                                    {"gaps": gaps, "slopes": ca.jacobian(gaps, g), "rods": ca.jacobian(gaps, x), "turns": ca.jacobian(gaps, q)}))

    def between(self, numbers: Array, readings: Array) -> tuple[Array, Array]:
        """((n, 2) from the left elbow to the right one, m, (n, 2, 10) its derivatives)."""
        found = self._between(numbers, np.ascontiguousarray(readings))
        return found.between, found.slopes

    def closure(self, numbers: Array, readings: Array, x: Array):
        """Gaps."""
        return self._closure(numbers, np.ascontiguousarray(readings), np.ascontiguousarray(x))

    def proximal(self, numbers: Array, reading: Array) -> Array:
        """(2,) direction of the left proximal link."""
        return np.array(direction(float(reading[0] - numbers[8]))).ravel()
