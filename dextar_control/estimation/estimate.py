"""The interface of estimators."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from dextar_control.contract.settings import Settings
from dextar_control.estimation.records import ESTIMATE
from dextar_control.model.model import Model
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array


class ExternalPosition(NamedTuple):
    """An external measurement of the platform."""

    time: float  # of the measurement, in the time of the samples, s
    x: Array  # (n,) m


class Estimator(ABC):
    """The interface of an estimator; one of one's own has to write ``start`` and
    ``observe``.

    This class cannot tell on which side of the locus the robot is: it takes the plan's
    side for the robot's, with a confidence of 0.5 behind a crossing.

    Args:
        model: of the robot, as the controller knows it.
        settings: of the controller.
        min_type1: the robot's least distance to Type 1.
        estimate: the record of ``estimation.records.ESTIMATE`` that it keeps; one of
            its own when None.

    Attributes:
        tells_side: whether it can tell on which side of the locus a robot is that has
            come near it.
        takes_poses: whether it uses external measurements.
        estimate: of the last sample.
        unknown_s: |s| within which the side of a robot at rest counts as unknown, even
            where it was told.
        note: a sentence about the external measurements; empty while they are used.
    """

    tells_side = False
    takes_poses = False

    def __init__(
        self,
        model: Model,
        settings: Settings,
        min_type1: float,
        estimate: Record | None = None,
    ) -> None:
        self.model, self.note, self._known = model, "", True
        self.estimate = estimate or Layout("estimate", model.n, ESTIMATE).make()
        self.estimate.s = np.nan
        self.configure(settings)

    @property
    def modes(self) -> list[tuple[float, float]]:
        """(assembly mode, confidence in it, 0.5 to 1) of each block of A_r; the
        estimate has that of the block with the least confidence.
        """
        mode = self.estimate.assembly_mode, self.estimate.confidence
        return [mode] * len(self.model.blocks)

    @property
    def mode_known(self) -> bool:
        """Whether the assembly mode is known well enough to begin a motion."""
        return self._known

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""
        self.unknown_s = settings.dgm.hold_below_abs_s

    @abstractmethod
    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """Begin at rest at x (n,), m, with joints q_a (n,), rad, in a known assembly
        mode: ``believe`` it, then ``show`` it.
        """

    @abstractmethod
    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """Take a sample: joints q_a (n,) as measured, rad, and torques tau (n,), N m,
        since the last sample, dt, s, ago; ``show`` it.
        """

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """Take an assembly mode that the operator tells; the robot has joints q_a (n,),
        rad, and may move.
        """
        near = np.array(self.estimate.x)
        x = self.model.direct_geometric_model(q_a, assembly_mode, near)
        self.start(x, q_a, assembly_mode)

    def rebase(self, q_a: Array) -> None:  # noqa: B027  most have no use for it
        """Take a reference at rest at q_a (n,), rad, to which the robot has
        not moved.
        """

    def release(self, crossing: bool) -> None:
        """Go on without a reference, which ended while crossing or not."""
        self._known = self._known and not crossing

    def track(
        self,
        dt: float,
        q_a: Array,
        tau: Array,
        reference: Record,
        zone: float,
        width: float,
    ) -> None:
        """Take a sample while a law acts.

        Args:
            dt: since the last sample, s.
            q_a: measured joints, (n,), rad.
            tau: torques since the last sample, (n,), N m.
            reference: record of ``estimation.records.REFERENCE``.
            zone, width: |s| of the reference within which the direct geometric model is
                not used, and over which it fades in.
        """
        if reference.s * self.estimate.assembly_mode < 0.0:  # the reference has crossed
            self.believe(-self.estimate.assembly_mode, 0.5)
        self.observe(dt, q_a, tau)

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """Take a sample without a reference: joints q_a (n,), rad, torques tau (n,),
        N m, over dt, s.
        """
        self.observe(dt, q_a, tau)
        if not abs(self.estimate.s) >= self.unknown_s:
            self._known, self.estimate.confidence = False, 0.5

    def take_pose(self, pose: ExternalPosition, time: float) -> None:  # noqa: B027  likewise
        """Take an external position that has arrived at ``time``, s; an estimator
        without use for it ignores it.
        """

    def believe(self, assembly_mode: float, confidence: float) -> None:
        """Set the assembly mode and the confidence in it, 0.5 to 1."""
        self.estimate.assembly_mode = assembly_mode
        self.estimate.confidence = confidence

    def show(self, x: Array, x_dot: Array) -> None:
        """Write the platform's position (n,), m, and velocity (n,), m/s, into the
        estimate, with the joints and s that follow.
        """
        now, place = self.estimate, self.model.place(x)
        now.x, now.x_dot, now.q_a, now.s = x, x_dot, place.q_a, place.s[0]
        now.q_a_dot = self.model.state(place.q_a, x, x_dot).q_a_dot
