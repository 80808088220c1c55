"""What the loop does, and everything about one of its samples."""

from __future__ import annotations

from enum import IntEnum

from dextar_control.core.law import CONFIDENCE, ERROR, FORCE, MODE_HAT, SCALARS, TAU, X_HAT, X_REF, U
from dextar_control.core.model import Array


class Phase(IntEnum):
    """What the controller does."""

    IDLE = 0  # no torque, by request
    APPROACH = 1  # tracks a trajectory without a crossing
    HOLD = 2  # holds a point
    TRACK = 3  # tracks a crossing trajectory, away from the locus
    CROSSING = 4  # tracks it near the locus
    SAFE_STOP = 5  # coasts, brakes, then no torque: ``core.safe_stop``
    FAULT = 6  # no torque


LIMP = (Phase.IDLE, Phase.FAULT, Phase.SAFE_STOP)  # where the law gives no torque
MOVING = (Phase.APPROACH, Phase.TRACK, Phase.CROSSING)


class Tick:
    """Everything about one sample; arrays are (2,), copies of their own.

    Attributes:
        time: of the state, s.
        reference_time: since the trajectory's start, s.
        phase: of the loop.
    """

    __slots__ = ("_estimate", "_output", "_reference", "phase", "reference_time", "time")

    def __init__(
        self, time: float, reference_time: float, phase: Phase, reference: Array, estimate: Array, output: Array
    ) -> None:
        self.time, self.reference_time, self.phase = time, reference_time, phase
        self._reference, self._estimate, self._output = reference, estimate, output

    tau = property(lambda self: self._output[TAU : TAU + 2], doc="N m.")
    x_ref = property(lambda self: self._reference[X_REF : X_REF + 2], doc="m.")
    x_ref_dot = property(lambda self: self._reference[X_REF + 2 : X_REF + 4], doc="m/s.")
    x_ref_ddot = property(lambda self: self._reference[X_REF + 4 : X_REF + 6], doc="m/s^2.")
    x_hat = property(lambda self: self._estimate[X_HAT : X_HAT + 2], doc="m.")
    x_hat_dot = property(lambda self: self._estimate[X_HAT + 2 : X_HAT + 4], doc="m/s.")
    error = property(lambda self: self._output[ERROR : ERROR + 2], doc="x_ref - x_hat, m.")
    error_dot = property(lambda self: self._output[ERROR + 2 : ERROR + 4], doc="m/s.")
    u = property(lambda self: self._output[U : U + 2], doc="Auxiliary acceleration, m/s^2.")
    force = property(lambda self: self._output[FORCE : FORCE + 2], doc="J_inv^T tau, N.")
    residual = property(lambda self: float(self._output[SCALARS]), doc="t_s.w_d that u asks for, N.")
    s = property(lambda self: float(self._output[SCALARS + 1]), doc="Singularity measure at the model's state.")
    sigma_min = property(lambda self: float(self._output[SCALARS + 2]), doc="Of A_r over the distal length.")
    weight = property(lambda self: float(self._output[SCALARS + 3]), doc="Of the feedback along the weak direction.")
    assembly_mode = property(lambda self: int(self._estimate[MODE_HAT]), doc="Believed sign of s.")
    confidence = property(lambda self: float(self._estimate[CONFIDENCE]), doc="In the assembly mode, 0.5 to 1.")
    rows = property(
        lambda self: (self._reference, self._estimate, self._output), doc="Reference, estimate, output; see ``law``."
    )
