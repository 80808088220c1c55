"""What the loop asks of an estimator: where the platform is, in which assembly mode,
and how sure that is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from dextar_control.contract.settings import Settings
from dextar_control.estimation.records import ESTIMATE
from dextar_control.model.model import Model
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array


class Pose(NamedTuple):
    """An external measurement of the platform."""

    time: float  # when it was true, in the time of the samples, s
    x: Array  # (n,) m


class Estimator(ABC):
    """What the loop asks of an estimator; one of one's own has to write ``start`` and
    ``observe``.

    As it stands here it cannot tell on which side of the locus the robot is: it takes
    the plan's side for the robot's, and says so by a confidence of 0.5 behind a
    crossing.

    Args:
        model: of the robot, as the controller knows it.
        settings: of the controller.
        min_type1: the robot's least distance to Type 1.
        estimate: the record of ``estimation.records.ESTIMATE`` that it keeps; one of
            its own when None.

    Attributes:
        tells_side: whether it can tell on which side a robot is that has passed the
            locus.
        takes_poses: whether it has use for external measurements.
        estimate: of the last sample.
        unknown_s: |s| within which the side of a robot at rest cannot be kept, even
            where somebody tells it.
        note: what there is to say of the external measurements; empty when they are
            taken as they come.
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
        estimate has the least sure one's.
        """
        return [(self.estimate.assembly_mode, self.estimate.confidence)] * len(
            self.model.blocks
        )

    @property
    def mode_known(self) -> bool:
        """Whether the assembly mode is known well enough to begin a motion from."""
        return self._known

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""
        self.unknown_s = settings.hold_zone

    @abstractmethod
    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """The robot rests at x (n,), m, with joints q_a (n,), rad, in a known assembly
        mode: ``believe`` it, then ``show`` it.
        """

    @abstractmethod
    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """One sample: joints q_a (n,) measured, rad, torques tau (n,) acted since the
        last one, N m, dt ago, s; ``show`` it.
        """

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """Somebody looked: the robot is in this assembly mode, with joints q_a (n,),
        rad; it may move.
        """
        near = np.array(self.estimate.x)
        x = self.model.direct_geometric_model(q_a, assembly_mode, near)
        self.start(x, q_a, assembly_mode)

    def rebase(self, q_a: Array) -> None:  # noqa: B027  most have no use for it
        """The reference is at rest at q_a (n,), rad, from now on, without the robot
        having moved.
        """

    def release(self, crossing: bool) -> None:
        """There is no reference from now on; it ends while crossing or not."""
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
        """One sample while a law acts, as ``observe``.

        Args:
            dt: since the last sample, s.
            q_a: (n,) measured, rad.
            tau: (n,) that acted since, N m.
            reference: record of ``estimation.records.REFERENCE``.
            zone, width: |s| of the reference within which the direct geometric model
                serves no more, and over which it fades in.
        """
        if reference.s * self.estimate.assembly_mode < 0.0:  # the reference has crossed
            self.believe(-self.estimate.assembly_mode, 0.5)
        self.observe(dt, q_a, tau)

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """One sample without a reference, q_a (n,), rad, and tau (n,), N m, as
        ``observe``.
        """
        self.observe(dt, q_a, tau)
        if not abs(self.estimate.s) >= self.unknown_s:
            self._known, self.estimate.confidence = False, 0.5

    def take_pose(self, pose: Pose, time: float) -> None:  # noqa: B027  likewise
        """An external measurement that has arrived at ``time``, s; ignored by
        estimators without use for it.
        """

    def believe(self, assembly_mode: float, confidence: float) -> None:
        """The assembly mode from now on, and how sure it is, 0.5 to 1."""
        self.estimate.assembly_mode = assembly_mode
        self.estimate.confidence = confidence

    def show(self, x: Array, x_dot: Array) -> None:
        """The platform's place (n,), m, and velocity (n,), m/s, into the estimate, with
        the joints and s that follow.
        """
        now, place = self.estimate, self.model.place(x)
        now.x, now.x_dot, now.q_a, now.s = x, x_dot, place.q_a, place.s[0]
        now.q_a_dot = self.model.state(place.q_a, x, x_dot).q_a_dot
