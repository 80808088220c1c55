"""The rig that a campaign file names, and what a campaign asks of it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from dextar_control.contract.plug_in import chosen
from dextar_control.contract.robot import RobotParameters
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array


class RigPose(Protocol):
    """An external measurement of the end effector."""

    @property
    def time(self) -> float:
        """Instant at which it was true, s."""

    @property
    def x(self) -> Array:
        """Measured position, (2,), m."""


class RigSample(Protocol):
    """What reaches the controller in one period."""

    @property
    def time(self) -> float:
        """Instant of the sample as its stamp tells it, s."""

    @property
    def q_a(self) -> Array:
        """Measured active joints, (2,), rad."""

    @property
    def pose(self) -> RigPose | None:
        """External measurement that has arrived; None where there is no new one."""


class RigInterface(Protocol):
    """A simulated robot in a plain loop: each period is one ``read`` and one
    ``write``.
    """

    @property
    def period(self) -> float:
        """Duration of one period, s."""

    @property
    def saturated(self) -> int:
        """Periods in which a command exceeded the drives' limit."""

    def reset_joints(self, q_a: Array, assembly_mode: int) -> object:
        """Put the active joints at q_a, (2,), rad, in an assembly mode, at time 0."""

    def read(self) -> RigSample | None:
        """Give the present sample; None when it was lost."""

    def write(self, torque: Array | None) -> object:
        """Answer the sample with motor torques, (2,), N m, and let a period pass."""

    def truth(self) -> Record:
        """Give the true state; it has the fields joints, x and q_a_dot."""

    def strike(self, impulse: Array) -> None:
        """Strike the end effector with an impulse, (2,), N s, in the next period."""

    def close(self) -> None:
        """Let go of what the rig holds."""


class RigMaker(Protocol):
    """A class of rigs; its module or the class names its plants in ``PLANTS``."""

    def __call__(
        self, robot: RobotParameters, *, plant: str, seed: int, **options: float | str
    ) -> RigInterface:
        """Make the rig of a robot as it was built, with the options of its noise."""


def resolve(name: str) -> RigMaker:
    """Import what ``module:Class`` names.

    Raises:
        ParameterError: there is none.
    """
    ours: dict[str, RigMaker] = {}
    with _quiet():
        return chosen("rig", name, ours)


@contextmanager
def _quiet() -> Iterator[None]:
    """Discard what a compiled library writes to standard error while it is loaded."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
