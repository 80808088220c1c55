"""Disturbances of a simulated robot on its way: a payload that it takes up, and a
push.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dextar_control.contract.errors import ParameterError
from dextar_control.symbols.types import Numbers
from dextar_sim.sensors import check_nonnegative

if TYPE_CHECKING:
    from dextar_sim.cartesian import CartesianPlant
    from dextar_sim.plant import Plant


class Disturbances:
    """Applies the disturbances of one run; a reset begins them anew, without the
    payload.

    Args:
        payload: mass at the end effector, kg.
        payload_time: from which on it is there, s.
        push: force on the end effector, (2,) N.
        push_time: at which it begins, s.
        push_duration: for which it acts, s.

    Raises:
        ParameterError: a value is out of its range.
    """

    def __init__(
        self,
        *,
        payload: float = 0.0,
        payload_time: float = 0.0,
        push: Numbers = (0.0, 0.0),
        push_time: float = 0.0,
        push_duration: float = 0.0,
    ) -> None:
        check_nonnegative(
            payload=payload,
            payload_time=payload_time,
            push_time=push_time,
            push_duration=push_duration,
        )
        if not all(map(math.isfinite, push)):
            raise ParameterError(f"push = {list(push)} N; it must be finite")
        self._payload, self._from = payload, payload_time
        self._push = push
        self._begin = push_time
        self._end = push_time + (push_duration if any(push) else 0.0)
        self._carried = 0.0

    def reset(self, plant: Plant | CartesianPlant) -> None:
        """Take the payload off again."""
        if self._carried:
            plant.take_up(-self._carried)
        self._carried = 0.0

    def before(self, time: float, plant: Plant | CartesianPlant) -> None:
        """Apply what begins or goes on in the period after ``time``, s."""
        if self._payload > self._carried and time >= self._from - 0.5 * plant.period:
            plant.take_up(self._payload)
            self._carried = self._payload
        if self._begin - 0.5 * plant.period <= time < self._end - 0.5 * plant.period:
            plant.apply_impulse([plant.period * force for force in self._push])
