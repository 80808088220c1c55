"""Every node of the package has its parameters, QoS, signals, diagnostics and exit code
alike.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import ClassVar, TypeVar, cast

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args, try_shutdown

from dextar_control.contract import resources
from dextar_control.contract.caches import prepare_environment
from dextar_control.contract.clocks import UnsteppedClock
from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.former_names import (
    former_names,
    present_arguments,
    present_names,
    renamed_in_words,
)
from dextar_control.contract.help import node_help
from dextar_control.contract.parameters import (
    Parameter,
    check_value,
    nearest_in_words,
    settled,
)
from dextar_control.contract.plain_data import ParameterValue
from dextar_control.contract.robot import (
    PREFIX,
    ROBOT_KEYS,
    RobotParameters,
    changed,
    from_flat,
)
from dextar_control.contract.signals import (
    EXIT_USAGE,
    StopSignal,
    caused_by_interrupt,
    tell,
)
from dextar_control.contract.topics import DIAGNOSTICS, Topic
from dextar_control.contract.yaml_text import check_parameter_files
from dextar_control.nodekit.services import PolledServices

LAST_SAMPLES = 1.0  # s given to readers that want every sample, when a node ends
COMPLAINT_PERIOD = 1.0  # s between two lines about services that failed
N = TypeVar("N", bound="RunnableNode")
Take = Callable[[type[object], bool], "tuple[bytes, dict[str, int]] | None"]
"""``take_message`` of a subscription to raw messages: bytes, and what the middleware
says of them.
"""


def _robot_defaults(node: str) -> dict[str, ParameterValue]:
    """Return the shipped description, by its keys."""
    shipped = resources.node_defaults(node, resources.config_file(resources.ROBOT_FILE))
    return {
        key.removeprefix(PREFIX): value
        for key, value in shipped.items()
        if key.startswith(PREFIX)
    }


def qos(topic: Topic, *, reliable: bool = True, depth: int | None = None) -> QoSProfile:
    """Return the profile of a contract topic.

    Args:
        topic: of the contract.
        reliable: False for a subscriber on the control path.
        depth: of its history; the topic's own where None.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or topic.depth,
        reliability=(
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL
            if topic.latched
            else DurabilityPolicy.VOLATILE
        ),
    )


class RunnableNode(Node):
    """A node that ``run_node`` can run: with an exit code, and an end of its own.

    Each kind of node says of itself:
        NAME: node name, and its section in ``config/crossing.yaml``.
        PARAMETERS: the node's parameters.
        ROBOT: whether the node takes the robot description.

    Attributes:
        exit_code: of the process, once the node has ended.
        finished: whether the node wants to end.
    """

    NAME: ClassVar[str] = ""
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()
    ROBOT: ClassVar[bool] = False
    exit_code = 0
    finished = False

    def destroy_node(self) -> None:
        """Leave the graph."""
        Node.destroy_node(self)

    def tell_renamed(self, renamed: Mapping[str, str]) -> None:
        """Warn of parameters that were given by former names, where there are any.

        Args:
            renamed: present names by former ones.
        """
        if renamed:
            self.get_logger().warning(renamed_in_words(renamed))

    def finish(self, exit_code: int = 0) -> None:
        """Leave the spin loop with this exit code."""
        self.exit_code = exit_code
        self.finished = True

    def close(self) -> None:
        """Leave the outside world as it should be left; called once, before the node is
        destroyed.
        """


class DextarNode(RunnableNode):
    """A node with checked parameters, a diagnostics publisher and an exit code.

    Args:
        served: whether the executor serves the services, those of parameters too;
            otherwise the node calls ``polled_services.poll`` when it has time for some.
        cli_args: ROS arguments of this node alone.

    Raises:
        ParameterError: an override is unknown, of another type or out of its bounds.
    """

    ROBOT = True

    def __init__(
        self, *, served: bool = True, cli_args: list[str] | None = None
    ) -> None:
        name, robot = self.NAME, self.ROBOT
        self._polled: set[int] = set()
        self._waits: rclpy_implementation.WaitSet | None = None
        self._served_by_executor = served
        super().__init__(name, cli_args=cli_args)
        self._specs = {spec.name: spec for spec in self.PARAMETERS}
        self._defaults = resources.node_defaults(name)
        overrides, renamed = present_names(
            self.PARAMETERS,
            {key: given.value for key, given in self._parameter_overrides.items()},
        )
        self.tell_renamed(renamed)
        self.values = settled(name, self.PARAMETERS, overrides, robot=robot)
        for spec in self._specs.values():
            value = self.values[spec.name]
            self.declare_parameter(
                spec.name, value, _descriptor(spec, value), ignore_override=True
            )
        if robot:
            told = {
                key.removeprefix(PREFIX): value
                for key, value in overrides.items()
                if key.startswith(PREFIX)
            }
            whole = "name" in told  # a description, not a change of the shipped one
            flat = told if whole else changed(_robot_defaults(name), told)
            self.robot: RobotParameters = from_flat(flat)
            for key, value in flat.items():
                plain = (
                    list(value)
                    if hasattr(value, "__len__") and not isinstance(value, str)
                    else value
                )
                self.declare_parameter(
                    f"{PREFIX}{key}",
                    plain,
                    ParameterDescriptor(description=ROBOT_KEYS[key], read_only=True),
                    ignore_override=True,
                )
        self.add_on_set_parameters_callback(self._on_set)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, DIAGNOSTICS.name, qos(DIAGNOSTICS)
        )
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.unstepped_clock = UnsteppedClock()
        self.polled_services = PolledServices(
            lambda: self._services,
            lambda text: self.get_logger().error(
                text, throttle_duration_sec=COMPLAINT_PERIOD
            ),
            self.unstepped_clock,
        )

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that the executor serves, without the polled ones."""
        return (
            entity for entity in super().subscriptions if id(entity) not in self._polled
        )

    def create_polled_subscription(
        self,
        message_type: type[object],
        name: str,
        profile: QoSProfile,
        *,
        raw: bool = False,
    ) -> Subscription:
        """Create a subscription that no executor serves.

        ``subscription.handle.take_message(message_type, raw)`` gives (message, info) or
        None. The events executor of rclpy 7.1 fails on callbacks that want the info.
        """
        subscription = self.create_subscription(
            message_type, name, lambda _: None, profile, raw=raw
        )
        self._polled.add(id(subscription))
        return subscription

    @property
    def services(self) -> Iterator[Service]:
        """The services that the executor serves, without the polled ones."""
        return (
            entity
            for entity in super().services
            if self._served_by_executor and id(entity) not in self._polled
        )

    def create_polled_service(self, service_type: type[object], name: str) -> Service:
        """Create a service that no executor serves, so that it may answer later than it
        is asked.

        ``service.handle.service_take_request(service_type.Request)`` gives (request,
        header), both None without a request; ``service.send_response(response,
        header)`` answers it.
        """
        service = self.create_service(service_type, name, lambda _, response: response)
        self._polled.add(id(service))
        return service

    def wait_for(self, subscription: Subscription, seconds: float) -> None:
        """Sleep until a polled subscription holds a message, at most this many seconds;
        it takes about 0.02 ms of processor time.
        """
        if self._waits is None:
            self._waits = rclpy_implementation.WaitSet(
                1, 0, 0, 0, 0, 0, self.context.handle
            )
        with subscription.handle:
            self._waits.clear_entities()
            self._waits.add_subscription(subscription.handle)
            self._waits.wait(max(0, round(1.0e9 * seconds)))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription, polled or not; another one may get its identity."""
        self._polled.discard(id(subscription))
        return bool(super().destroy_subscription(subscription))

    def set_parameters_atomically(
        self, parameter_list: list[RosParameter]
    ) -> SetParametersResult:
        """Set parameters as rclpy does; a name that is not declared is refused with the
        one that may be meant.

        Former names are refused here, not taken as at the start: what is set must be
        what ``ros2 param get`` and the events tell, under one name.
        """
        names = former_names(self.PARAMETERS)
        for parameter in parameter_list:
            name = parameter.name
            if name in names:
                reason = f"'{name}' is now called '{names[name]}'; set that"
            elif not self.has_parameter(name):
                near = nearest_in_words(name, self.PARAMETERS)
                reason = f"unknown parameter '{name}'{near}"
            else:
                continue
            return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def _on_set(self, parameters: list[RosParameter]) -> SetParametersResult:
        changes: dict[str, ParameterValue] = {}
        before = dict(self.values)
        try:
            for parameter in parameters:
                spec = self._specs.get(parameter.name)
                if spec is None:
                    continue
                if not spec.live and (reason := self.why_fixed()):
                    raise ParameterError(f"'{spec.name}' is fixed {reason}")
                changes[spec.name] = check_value(
                    spec, parameter.value, self._defaults[spec.name]
                )
            self.values.update(changes)
            self.on_parameters(changes)
        except DextarError as error:
            self.values = before
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def why_fixed(self) -> str:
        """Return why parameters that are not live cannot be changed now; empty when
        they can.
        """
        return "while the node runs"

    def on_parameters(self, changes: Mapping[str, ParameterValue]) -> None:
        """Use live changes, which already stand in ``values``; raise a DextarError to
        refuse them all.
        """

    def too_many_publishers(self, topic: str) -> str:
        """Return which nodes publish a topic that may have one publisher, in words,
        where it has more; empty otherwise.

        The graph keeps a publisher that was killed for some time (Fast DDS: up to 20
        s), and knows it before its node's name.

        Args:
            topic: its full name.
        """
        with self.handle:
            count = self.handle.get_count_publishers(topic)
        if count <= 1:
            return ""
        infos = [
            info
            for info in self.get_publishers_info_by_topic(topic)
            if "UNKNOWN" not in info.node_name
        ]
        named = Counter(
            f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos
        )
        names = ", ".join(
            name if many == 1 else f"{many} x {name}"
            for name, many in sorted(named.items())
        )
        return (
            f"{count} publishers on {topic}; the limit is 1: end all but"
            f" one{f' ({names})' if names else ''}"
        )

    def publish_diagnostics(
        self, level: bytes, message: str, values: Mapping[str, object]
    ) -> None:
        """Publish one DiagnosticStatus on ``/diagnostics``, with numbers as their
        shortest exact text.

        Args:
            level: of DiagnosticStatus.
            message: a summary of the node's state.
            values: by key.
        """
        status = DiagnosticStatus(
            level=level,
            name=self.get_fully_qualified_name(),
            message=message,
            hardware_id="dextar",
        )
        status.values = [
            KeyValue(key=key, value=str(value)) for key, value in values.items()
        ]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def _descriptor(spec: Parameter, value: ParameterValue) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=spec.measured, dynamic_typing=True)
    descriptor.additional_constraints = spec.allowed
    if spec.bounds is None:
        return descriptor
    low, high = spec.bounds
    if isinstance(value, float):
        most = 1.0e308 if high is None else float(high)
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(low), to_value=most)
        ]
    elif isinstance(value, int) and not isinstance(value, bool):
        last = 2**62 if high is None else int(high)
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=last)]
    return descriptor


def make_executor() -> Executor:
    """Return the events executor where this rclpy has it, else the
    single-threaded one.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor as Chosen
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor as Chosen
    executor: Executor = Chosen()
    return executor


def prepare_middleware() -> None:
    """Name ``config/fastdds.xml`` to Fast DDS, unless the user has a file of profiles;
    other middleware does not read it.
    """
    names = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
    if (
        not any(os.environ.get(name) for name in names)
        and not Path("DEFAULT_FASTRTPS_PROFILES.xml").exists()
    ):
        os.environ[names[0]] = str(resources.config_file(resources.MIDDLEWARE_FILE))


def run_node(
    make: type[N],
    args: list[str] | None = None,
    spin: Callable[[N, Executor, StopSignal], None] | None = None,
) -> int:
    """Run one node until a signal or its own end; return the process's exit code.

    ``--help`` and anything else that is not ROS's own are answered before a node, or
    ROS itself, is started.

    Args:
        make: the node's class.
        args: command line without the program's name, ``sys.argv``'s when None.
        spin: the node's own loop ``spin(node, executor, stop)``; the default hands
            events to callbacks.
    """
    prepare_environment()
    stop = StopSignal()
    node: N | None = None
    try:
        words = sys.argv[1:] if args is None else args
        if (code := _answer(make, words)) is not None:
            return code
        prepare_middleware()
        with contextlib.ExitStack() as stack:
            words, renamed = present_arguments(
                make.NAME,
                words,
                lambda: Path(stack.enter_context(tempfile.TemporaryDirectory())),
            )
            rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        node = cast(Callable[[], N], make)()
        node.tell_renamed(renamed)
        stop.starting = False
        executor = make_executor()
        executor.add_node(node)
        try:
            (spin or _spin)(node, executor, stop)
        finally:
            node.close()
            _wait_for_readers(node)
            executor.remove_node(node)
            executor.shutdown()
        return node.exit_code
    except DextarError as error:
        return _refuse(str(error))
    except BaseException as error:
        # The compiler may have made another error of an interrupt.
        interrupted = stop and stop.starting and not isinstance(error, SystemExit)
        if interrupted or caused_by_interrupt(error):
            return 0
        # E.g. security is asked for and not there.
        if node is None and type(error).__module__.startswith("rclpy._rclpy"):
            return _refuse(_in_one_line(error))
        if node is None and isinstance(error, OSError):  # e.g. too many open files
            return _refuse(f"the node cannot be started: {error}")
        raise
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown()


def _wait_for_readers(node: Node) -> None:
    """Wait until readers that want every sample, such as the recorder, have the last
    ones, which are lost with their publisher.
    """
    deadline = time.monotonic() + LAST_SAMPLES
    for publisher in node.publishers:
        publisher.wait_for_all_acked(
            Duration(seconds=max(deadline - time.monotonic(), 0.0))
        )


def _answer(make: type[RunnableNode], words: list[str]) -> int | None:
    """Print the help, or refuse what neither the node nor rcl takes; return the exit
    code, None where the node is to be started.
    """
    own = _own(words)
    if not {"-h", "--help"}.isdisjoint(own):
        tell(node_help(make), sys.stdout)
        return 0
    if own:
        instead = "--help says what there is"
        if ":=" in own[0]:
            instead = f"write --ros-args -p {own[0]}"
        return _refuse(
            f"argument '{own[0]}' is not known: a node takes --help, and what stands"
            f" behind --ros-args; {instead}"
        )
    files_and_more = check_parameter_files(words)
    try:
        remove_ros_args(files_and_more)
    except Exception as error:  # rcl raises types of its own for a bad --ros-args
        return _refuse(_in_one_line(error))
    return None


def _own(words: list[str]) -> list[str]:
    """Return the words that stand outside of ``--ros-args ... [--]``; rcl itself would
    still take a remapping there, in the way of ROS 1.
    """
    own, theirs = [], False
    for word in words:
        if theirs:
            theirs = word != "--"
        elif word == "--ros-args":
            theirs = True
        elif word != "--":
            own.append(word)
    return own


def _refuse(text: str) -> int:
    tell(f"error: {text}", sys.stderr)
    return EXIT_USAGE


def _in_one_line(error: BaseException) -> str:
    """Return what rcl says, without the places in its own sources."""
    if type(error).__name__ == "UnknownROSArgsError":
        return (
            f"unknown ROS argument {str(error).strip('[]')}; --help says what there is"
        )
    lines = re.sub(
        r",? at \S+:\d+", "", str(error).removeprefix("Failed to parse ROS arguments: ")
    ).splitlines()
    text = lines[0] if lines else type(error).__name__
    for rule, form in (
        ("parameter override rule", "NAME:=VALUE"),
        ("remap rule", "OLD:=NEW"),
    ):
        if rule in text:
            return text.partition(" Error: ")[0] + f" It must be {form}."
    return text


def _spin(node: RunnableNode, executor: Executor, stop: StopSignal) -> None:
    while not stop and not node.finished:
        executor.spin_once(timeout_sec=0.05)
