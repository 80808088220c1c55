"""Mechanisms: the only place that knows a length, an elbow or a working mode."""

from collections.abc import Mapping
from functools import lru_cache

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plug_in import chosen
from dextar_control.mechanisms.five_bar import DetailedFiveBar, FiveBar
from dextar_control.mechanisms.mechanism import Mechanism
from dextar_control.mechanisms.three_rrr import ThreeRRR

MECHANISMS: dict[str, type[Mechanism]] = {
    mechanism.name: mechanism for mechanism in (FiveBar, ThreeRRR)
}
"""The mechanisms of this package by the names that a robot's file gives."""

DETAILED_FIVE_BAR = DetailedFiveBar()


def five_bar_of(values: Mapping[str, object]) -> Mechanism:
    """Return the five-bar of these values: with friction of its passive joints and
    elastic transmissions where there is some.
    """
    detailed = any(values.get(parameter.name) for parameter in DETAILED_FIVE_BAR.detail)
    return DETAILED_FIVE_BAR if detailed else mechanism_named("five_bar")


@lru_cache
def mechanism_named(name: str) -> Mechanism:
    """Return the mechanism of a name of ``MECHANISMS``, or of ``module:class`` of one's
    own; the same each time, so that its equations are built and compiled once.

    Raises:
        ParameterError: there is none (it says which there are), or it cannot be made.
    """
    kind = chosen("robot.mechanism", name, MECHANISMS)
    try:
        made = kind()
    except TypeError as error:  # a method that every mechanism needs is missing
        raise ParameterError(f"robot.mechanism = {name!r}: {error}") from error
    if not isinstance(made, Mechanism):
        raise ParameterError(
            f"robot.mechanism = {name!r} makes a {type(made).__name__}; it must be a"
            " class derived from mechanisms.mechanism.Mechanism"
        )
    return made
