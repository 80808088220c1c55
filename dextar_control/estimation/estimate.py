"""What the loop asks of an estimator: where the platform is, in which assembly mode,
and how sure that is.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from dextar_control.contract.settings import Settings
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array


class Pose(NamedTuple):
    """An external measurement of the platform."""

    time: float  # when it was true, in the time of the samples, s
    x: Array  # (n,) m


class Estimator(Protocol):
    """What the loop asks of an estimator.

    Attributes:
        estimate: of the last sample, a record of ``estimation.records.ESTIMATE``.
        tells_side: whether it can tell on which side a robot is that has passed the
            locus.
        note: what there is to say of the external measurements; empty when they are
            taken as they come.
    """

    estimate: Record
    tells_side: bool
    note: str

    @property
    def modes(self) -> list[tuple[float, float]]:
        """(assembly mode, confidence in it, 0.5 to 1) of each block of A_r; the
        estimate has the least sure one's.
        """

    @property
    def mode_known(self) -> bool:
        """Whether the assembly mode is known well enough to begin a motion from."""

    @property
    def unknown_s(self) -> float:
        """|s| of the locus within which a robot at rest is on no known side, whatever
        was told.
        """

    def configure(self, settings: Settings) -> None:
        """Take the settings that concern it, also while running."""

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """The robot rests at x (n,) with joints q_a (n,), in a known assembly mode."""

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """Somebody looked: the robot is in this assembly mode, with joints q_a (n,); it
        may move.
        """

    def rebase(self, q_a: Array) -> None:
        """The reference is at rest at q_a (n,) from now on, without the robot having
        moved.
        """

    def release(self, crossing: bool) -> None:
        """There is no reference from now on; it ends while crossing or not."""

    def track(
        self,
        dt: float,
        q_a: Array,
        tau: Array,
        reference: Record,
        zone: float,
        width: float,
    ) -> None:
        """One sample while a law acts: joints q_a measured, tau acted since the last
        one, dt ago.
        """

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """One sample without a reference."""

    def take_pose(self, pose: Pose, time: float) -> None:
        """An external measurement that has arrived at ``time``; ignored by estimators
        without use for it.
        """
