"""The launch file's arguments: their meaning and what they may be, checked before
anything is compiled or started.
"""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.node_parameters import PARAMETERS
from dextar_control.contract.parameters import Parameter, check_value
from dextar_control.contract.plug_in import is_own, one_of
from dextar_control.contract.resources import node_defaults
from dextar_control.contract.topics import INTERFACES
from dextar_control.contract.yaml_text import load_parameters
from dextar_control.experiments.start_check import check_start
from dextar_control.nodes import task

Value = bool | float | str
# In any case; launch's own conditions take the first two of each.
TRUE, FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")
SPECS = {
    (node, spec.name): spec for node, specs in PARAMETERS.items() for spec in specs
}
TASK = {
    name: SPECS["trajectory_server", f"{task.GROUP}{name}"]
    for name in ("tour", "excite", "duration")
}
LAW, ESTIMATOR = SPECS["controller", "law"], SPECS["controller", "estimator"]
PACE = SPECS["plant", "simulation.real_time_factor"]


class Argument(NamedTuple):
    """One launch argument.

    Attributes:
        default: as it would be typed; empty leaves it to the parameter files.
        description: for ``--show-args``.
        kind: switch, word, number, parameter file, bag, or namespace.
        choices: of a word.
        own: whether a word may also be ``module:attribute`` of the user's own code.
    """

    default: str
    description: str
    kind: str = "switch"
    choices: tuple[str, ...] = ()
    own: bool = False

    @property
    def allowed(self) -> str:
        """What may be given, in words; empty where that is no choice."""
        choices = ("true", "false") if self.kind == "switch" else self.choices
        if self.own:
            return one_of(choices)
        return f"one of {', '.join(choices)}" if choices else ""

    @property
    def told(self) -> str:
        """The description with what may be given."""
        allowed = f" It is {self.allowed}." if self.allowed else ""
        return f"{self.description}{allowed}"


LEFT = "Empty leaves it to params_file."
# Every argument of the launch file; where its default depends on the installation the
# launch file sets it.
ARGUMENTS = {
    **{
        spec.name: Argument(
            "", f"{spec.description} {LEFT}", "word", spec.choices, own=True
        )
        for spec in (LAW, ESTIMATOR)
    },
    **{
        name: Argument("", f"{spec.measured} {LEFT}", "number")
        for name, spec in TASK.items()
    },
    "real_time": Argument(
        "false",
        "The plant runs on whether or not a command came, as a rig does; if false, each"
        " simulated step waits for its command.",
    ),
    "real_time_factor": Argument("", f"{PACE.description} {LEFT}", "number"),
    "window": Argument("false", "The plant opens PyBullet's own window."),
    "record": Argument("true", "The recorder is started."),
    "markers": Argument(
        "false", "The node that draws for RViz and Foxglove is started."
    ),
    "panel": Argument(
        "false",
        "A page that watches and drives the robot is served at an address that is"
        " printed.",
    ),
    "output": Argument(
        "", f"The recording is written to this .mcap file. {LEFT}", "bag"
    ),
    "autostart": Argument("true", "The trip is served as soon as it is planned."),
    "activate": Argument(
        "true",
        "The controller activates itself at its start; if false, ros2 lifecycle set"
        " does.",
    ),
    "plant": Argument(
        "true",
        "The simulated rig is started; false is for a real one that publishes the joint"
        " states.",
    ),
    "namespace": Argument(
        "/",
        "All nodes run in this namespace, e.g. /left for one of two robots in a"
        " domain.",
        "namespace",
    ),
    "robot_file": Argument(
        "", "This parameter file describes the robot.", "parameter file"
    ),
    "params_file": Argument(
        "", "This parameter file sets the parameters of the nodes.", "parameter file"
    ),
    "enclaves": Argument(
        "false",
        "Each node runs in its enclave of config/sros2/policy.xml (with"
        " ROS_SECURITY_ENABLE=true).",
    ),
    "discovery_range": Argument(
        "",
        "Machines in this range may see and command the nodes; LOCALHOST is this one"
        " only.",
        "word",
        ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"),
    ),
}


def read(given: Mapping[str, str]) -> dict[str, Value]:
    """Return the arguments' values in their types; an empty text stands for what is
    left to the parameter files.

    Args:
        given: as typed; others than ``ARGUMENTS`` are passed over.

    Raises:
        ParameterError: one cannot be used; names the argument, its value and what it
            may be.
    """
    values = {
        name: _value(name, argument, given[name])
        for name, argument in ARGUMENTS.items()
    }
    numbers = {
        spec.name: values[name] for name, spec in TASK.items() if values[name] != ""
    }
    if numbers:
        try:
            task.Task.from_values({**node_defaults("trajectory_server"), **numbers})
        except ParameterError as error:
            shown = ", ".join(
                f"{name}:={given[name]}" for name in TASK if values[name] != ""
            )
            raise ParameterError(
                f"launch argument {shown} cannot be used: {error}"
            ) from error
    return values


def changes(values: Mapping[str, Value]) -> dict[str, dict[str, Value]]:
    """Return the nodes that are to be started, and what the arguments change of their
    parameters.

    Args:
        values: from ``read``.
    """
    lockstep = values["plant"] and not values["real_time"]  # a rig waits for nobody
    own: dict[str, dict[str, Value]] = {
        "plant": {
            "mode": "lockstep" if lockstep else "realtime",
            "window": values["window"],
        },
        "controller": {"lockstep": lockstep, "autostart": values["activate"]},
        "trajectory_server": {"autostart": values["autostart"]},
        "recorder": {},
        "markers": {},
        "go_server": {},
        "panel": {},
    }
    for node, arguments in (
        ("plant", {"real_time_factor": PACE.name}),
        ("controller", {"law": LAW.name, "estimator": ESTIMATOR.name}),
        ("trajectory_server", {name: spec.name for name, spec in TASK.items()}),
        ("recorder", {"output": "output"}),
    ):
        own[node] |= {
            parameter: values[argument]
            for argument, parameter in arguments.items()
            if values[argument] != ""
        }
    if values["law"] == "multi_model":
        own["trajectory_server"]["task.criterion"] = "zero_wrench"
    unwanted = {
        "plant": not values["plant"],
        "recorder": not values["record"],
        "markers": not values["markers"],
        "panel": not values["panel"],
        "go_server": importlib.util.find_spec(INTERFACES) is None,
    }
    return {
        name: parameters for name, parameters in own.items() if not unwanted.get(name)
    }


def check_nodes(values: Mapping[str, Value]) -> None:
    """Refuse, before anything is started, parameters that a node would refuse.

    Args:
        values: from ``read``.

    Raises:
        ParameterError: a parameter is unknown or cannot be used; names the files, the
            node and the parameter.
    """
    files = [Path(str(values[name])) for name in ("robot_file", "params_file")]
    for node, parameters in changes(values).items():
        try:
            check_start(node, parameters, *files, namespace=str(values["namespace"]))
        except ParameterError as error:
            raise ParameterError(
                f"the nodes refuse robot_file:={files[0]} params_file:={files[1]}:"
                f" {error}"
            ) from error


def misspelt(given: Iterable[str]) -> list[str]:
    """Write sentences about names that are no arguments and look like one; launch
    itself says nothing about them.
    """
    told = []
    for name in given:
        close = difflib.get_close_matches(name, ARGUMENTS, n=1)
        if name not in ARGUMENTS and close:
            told.append(
                f"launch argument '{name}' is unknown and has no effect; did you mean"
                f" '{close[0]}'?"
            )
    return told


def _value(name: str, argument: Argument, text: str) -> Value:
    def fail(limit: str) -> ParameterError:
        return ParameterError(
            f"launch argument '{name}' = '{text}'; it must be {limit}"
        )

    plain, kind = text.strip(), argument.kind
    if kind == "switch":
        if plain.lower() not in TRUE + FALSE:
            raise fail("true or false")
        return plain.lower() in TRUE
    if kind == "parameter file":
        return _checked_file(plain, fail)
    if kind == "namespace":
        try:
            validate_namespace(f"/{plain.strip('/')}")
        except InvalidNamespaceException as error:
            why = " ".join(str(error).partition(":")[2].replace("^", "").split())
            raise fail(f"a ROS namespace such as /left: {why}") from error
        return plain
    if not plain and argument.default == "":
        return ""
    if kind == "word":
        if argument.own and is_own(plain):
            return plain
        words = {choice.lower(): choice for choice in argument.choices}
        if plain.lower() not in words:
            raise fail(argument.allowed)
        return words[plain.lower()]
    if kind == "number":
        return _number(TASK.get(name, PACE), plain, fail)
    if Path(plain).suffix != ".mcap":
        raise fail("a name that ends in .mcap")
    return plain


def _number(spec: Parameter, text: str, fail: Callable[[str], ParameterError]) -> float:
    node = "plant" if spec is PACE else "trajectory_server"
    try:
        number = float(text)
    except ValueError:
        raise fail("a number") from None
    try:
        value: float = check_value(spec, number, node_defaults(node)[spec.name])
        return value
    except ParameterError as error:
        raise fail(str(error).rpartition("it must be ")[2]) from error


def _checked_file(text: str, fail: Callable[[str], ParameterError]) -> str:
    """Return the path, or raise where no node could take it: launch finds that out only
    when the nodes start.
    """
    try:
        path = Path(text).expanduser()
    except RuntimeError as error:  # no such user's home
        raise fail(f"a file that can be found: {error}") from error
    try:
        sections = load_parameters(path)
    except ParameterError as error:
        why = str(error).removeprefix(f"parameter file {path}").lstrip(":, ")
        raise fail(f"a parameter file that nodes take: {why}") from error
    if not sections:
        raise fail("a parameter file with sections such as '/**/controller:'")
    return str(path)
