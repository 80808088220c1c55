"""What the loop does, and everything about one of its samples."""

from __future__ import annotations

from enum import IntEnum

from dextar_control.symbols.record import Record


class Phase(IntEnum):
    """What the controller does."""

    IDLE = 0  # no torque, by request
    APPROACH = 1  # tracks a trajectory without a crossing
    HOLD = 2  # holds a point
    TRACK = 3  # tracks a crossing trajectory, away from the locus
    CROSSING = 4  # tracks it near the locus
    SAFE_STOP = 5  # coasts, brakes, then no torque: ``control.safe_stop``
    FAULT = 6  # no torque


LIMP = (Phase.IDLE, Phase.FAULT, Phase.SAFE_STOP)  # where the law gives no torque
MOVING = (Phase.APPROACH, Phase.TRACK, Phase.CROSSING)


class Tick:
    """Everything about one sample, in records of its own.

    Attributes:
        time: of the state, s.
        reference_time: since the trajectory's start, s.
        phase: of the loop.
        reference: what the plan asks for (``estimation.records.REFERENCE``).
        estimate: what the estimator believes (``estimation.records.ESTIMATE``).
        output: what the law answers (``control.law.OUTPUT``).
    """

    __slots__ = ("estimate", "output", "phase", "reference", "reference_time", "time")

    def __init__(
        self, time: float, reference_time: float, phase: Phase, reference: Record, estimate: Record, output: Record
    ) -> None:
        self.time, self.reference_time, self.phase = time, reference_time, phase
        self.reference, self.estimate, self.output = reference.copy(), estimate.copy(), output.copy()

    tau = property(lambda self: self.output.tau, doc="(n,) N m.")
    x_ref = property(lambda self: self.reference.x, doc="(n,) m.")
    x_hat = property(lambda self: self.estimate.x, doc="(n,) m.")
    x_hat_dot = property(lambda self: self.estimate.x_dot, doc="(n,) m/s.")
    error = property(lambda self: self.output.error, doc="(n,) x_ref - x_hat, m.")
    s = property(lambda self: self.output.s, doc="Singularity measure at the model's state.")
    residual = property(lambda self: self.output.residual, doc="t_s.w_d that u asks for, N.")
    assembly_mode = property(lambda self: int(self.estimate.assembly_mode), doc="Believed sign of s.")
    confidence = property(lambda self: self.estimate.confidence, doc="In the assembly mode, 0.5 to 1.")
