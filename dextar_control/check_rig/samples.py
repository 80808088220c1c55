"""A driver is seen by its place in the graph and by its states, one by one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dextar_control.contract.errors import StateError
from dextar_control.contract.robot import JOINT_NAMES, joint_positions

Array = NDArray[np.float64]
NANOSECOND = 1.0e-9  # s


class JointSample(NamedTuple):
    """One joint state.

    Attributes:
        arrival: when the middleware had it, ns of the system clock as it was at the
            beginning of the check, without a step since.
        stamp: of its header, ns.
        names, position, velocity, effort: as sent, of any size.
    """

    arrival: int
    stamp: int
    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


class Endpoint(NamedTuple):
    """A publisher or a subscriber of a topic.

    Attributes:
        node: its full name.
        type: ROS type.
        reliable: offered or asked for.
        mismatch: why its QoS does not match the contract's other end; empty when it
            does.
    """

    node: str
    type: str
    reliable: bool
    mismatch: str = ""


class Graph(NamedTuple):
    """The publishers and subscribers of the two topics.

    Attributes:
        states, commands: names of the topics.
        state_type, command_type: ROS types they should have.
        drivers: publishers of states.
        readers: subscribers of commands.
        commanders: publishers of commands that are not ours.
    """

    states: str
    commands: str
    state_type: str
    command_type: str
    drivers: tuple[Endpoint, ...]
    readers: tuple[Endpoint, ...]
    commanders: tuple[Endpoint, ...]


def by_name(
    samples: Iterable[JointSample], field: str
) -> tuple[list[JointSample], Array]:
    """Return the samples that have finite numbers for both joints in a field, and these
    numbers, (n, 2), in the contract's order and the field's unit.
    """
    kept, rows = [], []
    for sample in samples:
        values: Sequence[float] = getattr(sample, field)
        if len(values) != len(sample.names) or any(
            name not in sample.names for name in JOINT_NAMES
        ):
            continue
        row = [values[sample.names.index(name)] for name in JOINT_NAMES]
        if np.isfinite(row).all():
            kept.append(sample)
            rows.append(row)
    return kept, np.array(rows, dtype=np.float64).reshape(-1, 2)


def joint_angles(samples: Iterable[JointSample]) -> tuple[list[JointSample], Array]:
    """Return the samples that the controller can use, and their joint angles, (n, 2),
    rad, without the encoders' whole turns.

    The controller takes an angle on any turn: one that wraps has moved as little as it
    can have.
    """
    kept, rows = [], []
    for sample in samples:
        try:
            rows.append(joint_positions(sample.names, sample.position))
        except StateError:
            continue
        kept.append(sample)
    return kept, np.unwrap(np.array(rows, dtype=np.float64).reshape(-1, 2), axis=0)


def times(samples: Sequence[JointSample]) -> Array:
    """Return when the samples were taken, (n,), s from the first: their stamps where
    these rise, else their arrivals.
    """
    stamps = np.array([sample.stamp for sample in samples], dtype=np.int64)
    if not (np.diff(stamps) > 0).all():
        stamps = np.maximum.accumulate(
            np.array([sample.arrival for sample in samples], dtype=np.int64)
        )
    return NANOSECOND * (stamps - stamps[:1]).astype(np.float64)
