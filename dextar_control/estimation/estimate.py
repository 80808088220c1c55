"""The interface of estimators."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from dextar_control.contract.settings import Settings
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array


class ExternalPosition(NamedTuple):
    """An external measurement of the platform."""

    time: float  # of the measurement, in the time of the samples, s
    x: Array  # (n,) m


class Estimator(Protocol):
    """The interface of an estimator.

    Attributes:
        estimate: of the last sample, a record of ``estimation.records.ESTIMATE``.
        tells_side: whether it can tell on which side of the locus a robot is that has
            come near it.
        note: a sentence about the external measurements; empty while they are used.
    """

    estimate: Record
    tells_side: bool
    note: str

    @property
    def modes(self) -> list[tuple[float, float]]:
        """(assembly mode, confidence in it, 0.5 to 1) of each block of A_r; the
        estimate has that of the block with the least confidence.
        """

    @property
    def mode_known(self) -> bool:
        """Whether the assembly mode is known well enough to begin a motion."""

    @property
    def unknown_s(self) -> float:
        """|s| within which the side of a robot at rest counts as unknown, even where
        it was told.
        """

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """Begin at rest at x (n,), m, with joints q_a (n,), rad, in a known assembly
        mode.
        """

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """Take an assembly mode that the operator tells; the robot has joints q_a (n,),
        rad, and may move.
        """

    def rebase(self, q_a: Array) -> None:
        """Take a reference at rest at q_a (n,), rad, to which the robot has
        not moved.
        """

    def release(self, crossing: bool) -> None:
        """Go on without a reference, which ended while crossing or not."""

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
            zone, width: |s| within which the law holds the weak direction, and over
                which it lets it go.
        """

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """Take a sample without a reference: joints q_a (n,), rad, torques tau (n,),
        N m, over dt, s.
        """

    def take_pose(self, pose: ExternalPosition, time: float) -> None:
        """Take an external position that has arrived at ``time``, s; an estimator
        without use for it ignores it.
        """
