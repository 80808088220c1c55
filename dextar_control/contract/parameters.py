"""A parameter of a node is described here, with the names and values that it takes.
Needs no ROS.

The parameters themselves stand in ``node_parameters``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from dextar_control.contract import resources
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.plug_in import is_own, one_of
from dextar_control.contract.robot import PREFIX, ROBOT_KEYS


@dataclass(frozen=True)
class Parameter:
    """One node parameter; its default stands in ``config/crossing.yaml``.

    Attributes:
        name: plain, or the name of its group, a dot and its own.
        description: one sentence, which a stranger understands without the name beside
            it.
        bounds: inclusive, of a number (or of each of an array); the upper one may be
            None.
        choices: the allowed words of a string.
        size: length of an array; 0 is any. An array whose default is empty may be
            empty.
        live: may be changed while the node runs.
        unit: of a number, SI; 1 where it has no dimension.
        own: whether a string may also be ``module:attribute`` of the user's own code,
            beside the choices.
        formerly: the name that it had in the release before, which is still taken in
            files and at a node's start.
    """

    name: str
    description: str
    bounds: tuple[float, float | None] | None = None
    choices: tuple[str, ...] = ()
    size: int = 0
    live: bool = False
    unit: str = ""
    own: bool = False
    formerly: str = ""

    @property
    def group(self) -> str:
        """What stands before the dot of its name; it is empty of a plain name."""
        return self.name.rpartition(".")[0]

    @property
    def allowed(self) -> str:
        """Which strings it takes, in words; empty where it takes any."""
        if self.own:
            return one_of(self.choices)
        return f"one of {', '.join(self.choices)}" if self.choices else ""

    @property
    def measured(self) -> str:
        """The description with its unit, as ``ros2 param describe`` shows it."""
        return (
            self.description
            if self.unit in ("", "1")
            else f"{self.description} Unit: {self.unit}."
        )


SCHEDULING = (
    Parameter(
        "thread_priority",
        "The kernel schedules all threads by SCHED_FIFO at this priority; 0 leaves its"
        " usual scheduling.",
        (0, 99),
        unit="1",
    ),
    Parameter(
        "cpu_affinity",
        "The threads run on the processors with these numbers; [] allows any.",
        unit="1",
    ),
    Parameter("lock_memory", "The process keeps its memory out of the swap."),
)
"""Parameters of nodes with a loop that must be on time, named as ros2_control's; see
``scheduling.ask_kernel``.
"""


def nearest_in_words(
    name: str, specs: Sequence[Parameter], others: Sequence[str] = ()
) -> str:
    """Return a question for what may have been meant by a name that is not known; it is
    empty where nothing looks like it.

    Args:
        name: as given.
        specs: of the parameters that there are.
        others: further names.
    """
    names = [*(spec.name for spec in specs), *others]
    meant = {
        **{known.rpartition(".")[2]: known for known in names},
        **{spec.formerly: spec.name for spec in specs if spec.formerly},
        **{known: known for known in names},
    }
    close = get_close_matches(name, meant, n=1) or get_close_matches(
        name.rpartition(".")[2], meant, n=1
    )
    return f"; did you mean '{meant[close[0]]}'?" if close else ""


def check_value(
    spec: Parameter, value: ParameterValue, default: ParameterValue
) -> ParameterValue:
    """The value in the type of its default.

    Raises:
        ParameterError: another type, not finite or out of bounds; names the value and
            the limit.
    """

    def fail(limit: str) -> ParameterError:
        # ROS hands over arrays.
        shown = value.tolist() if hasattr(value, "tolist") else value
        return ParameterError(
            f"parameter '{spec.name}' = {shown!r}; it must be {limit}"
        )

    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise fail("true or false")
        return value
    if isinstance(default, str):
        if not isinstance(value, str):
            raise fail("a string")
        known = value in spec.choices or (spec.own and is_own(value))
        if spec.choices and not known:
            raise fail(spec.allowed)
        return value
    array = isinstance(default, (list, tuple))
    optional = array and not default
    if optional and value is None:  # how a parameter file's [] arrives
        return []
    numbers = (
        list(value)
        if isinstance(value, (list, tuple)) or hasattr(value, "tolist")
        else [value]
    )
    fits = len(numbers) == spec.size or not spec.size or (optional and not numbers)
    if array != (not isinstance(value, (int, float))) or (array and not fits):
        raise fail(
            f"{spec.size or 'any number of'} numbers{' or []' if optional else ''}"
            if array
            else "a number"
        )
    if any(isinstance(number, (bool, str)) for number in numbers):
        raise fail("numeric")
    integer = not optional and isinstance(default[0] if array else default, int)
    for number in numbers:
        if number != number or abs(number) == float("inf"):
            raise fail("finite")
        if integer and int(number) != number:
            raise fail("an integer")
        low, high = spec.bounds or (None, None)
        if low is not None and number < low:
            raise fail(f">= {low:g}")
        if high is not None and number > high:
            raise fail(f"<= {high:g}")
    cast = [int(number) if integer else float(number) for number in numbers]
    return cast if array else cast[0]


def settled(
    node: str,
    specs: Sequence[Parameter],
    overrides: Mapping[str, ParameterValue],
    *,
    robot: bool,
) -> dict[str, ParameterValue]:
    """The values of a node's parameters, as the node itself takes them at its start.

    Args:
        node: its name.
        specs: of its parameters.
        overrides: of the defaults in ``config/crossing.yaml``, by present names.
        robot: whether the node takes the robot description.

    Raises:
        ParameterError: an override is unknown, of another type or out of its bounds.
    """
    defaults = resources.node_defaults(node)
    names = [spec.name for spec in specs]
    described = [f"{PREFIX}{key}" for key in ROBOT_KEYS] if robot else []
    known = {
        *names,
        *defaults,
        *described,
        "use_sim_time",
        "start_type_description_service",
    }
    for key in overrides:
        others = key.startswith("qos_overrides.") or (
            key.startswith("robot.") and not robot
        )
        if key not in known and not others:
            raise ParameterError(
                f"unknown parameter '{key}' for node {node}"
                + (
                    nearest_in_words(key, specs, described)
                    or f"; known are: {', '.join([*names, *described])}"
                )
            )
    for name in names:
        if name not in defaults:
            raise ParameterError(
                f"config/{resources.NODES_FILE} has no '{name}' for node {node}"
            )
    return {
        spec.name: check_value(
            spec, overrides.get(spec.name, defaults[spec.name]), defaults[spec.name]
        )
        for spec in specs
    }
