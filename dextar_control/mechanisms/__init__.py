"""Mechanisms: the only place that knows a length, an elbow or a working mode."""

from collections.abc import Mapping
from typing import Any

from dextar_control.contract.errors import ParameterError
from dextar_control.mechanisms.five_bar import DetailedFiveBar, FiveBar
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.three_rrr import ThreeRRR

MECHANISMS: dict[str, Mechanism] = {
    mechanism.name: mechanism for mechanism in (FiveBar(), ThreeRRR())
}
"""Those that a robot's file can name."""


DETAILED_FIVE_BAR = DetailedFiveBar()


def five_bar_of(values: Mapping[str, Any]) -> Mechanism:
    """The five-bar of these values: with friction of its passive joints and elastic
    transmissions where there is some.
    """
    detailed = any(values.get(parameter.name) for parameter in DETAILED_FIVE_BAR.detail)
    return DETAILED_FIVE_BAR if detailed else MECHANISMS["five_bar"]


def mechanism_named(name: str) -> Mechanism:
    """The mechanism of that name.

    Raises:
        ParameterError: there is none; names those there are.
    """
    if name not in MECHANISMS:
        raise ParameterError(
            f"robot.mechanism = {name!r}; it must be one of {', '.join(MECHANISMS)}"
        )
    return MECHANISMS[name]
