"""The nodes as processes: what they say of themselves, what they refuse, how they begin
and end.
"""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from patience import PATIENCE
from rclpy.signals import SignalHandlerOptions
from rig import Rig, matched, start, stop

from dextar_control import executables
from dextar_control.cli import main as cli
from dextar_control.contract import signals
from dextar_control.contract.clocks import UnsteppedClock
from dextar_control.contract.errors import ParameterError
from dextar_control.contract.help import node_help
from dextar_control.contract.resources import ROBOT_FILE, config_file, node_defaults
from dextar_control.contract.robot import load_robot
from dextar_control.contract.topics import NODES, SERVICES
from dextar_control.experiments.echo import EchoNode
from dextar_control.model.model import Model
from dextar_control.nodekit import node as node_module
from dextar_control.nodekit.node import DextarNode, run_node
from dextar_control.nodes.controller import ControllerNode
from dextar_control.nodes.markers import MarkerNode
from dextar_control.nodes.panel import PanelNode
from dextar_control.nodes.recorder import RecorderNode
from dextar_control.nodes.trajectory_server import TrajectoryServer
from dextar_sim.node import PlantNode

ROOT = Path(__file__).resolve().parents[2]
KINDS = (
    PlantNode,
    ControllerNode,
    TrajectoryServer,
    RecorderNode,
    MarkerNode,
    PanelNode,
)
ENDING = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]
MODULES_WITH_MAIN = sorted(
    str(path.relative_to(ROOT).with_suffix("")).replace("/", ".")
    for room in ("dextar_control", "dextar_sim")
    for path in (ROOT / room).rglob("*.py")
    if "__main__" in path.read_text(encoding="utf-8")
)


@pytest.fixture
def unstarted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither ROS nor a node may be started."""

    def fail(*_: Any, **__: Any) -> None:
        raise AssertionError("started")

    monkeypatch.setattr(rclpy, "init", fail)
    monkeypatch.setattr(node_module.DextarNode, "__init__", fail)


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """As they were before: run_node takes them for its process."""
    before = {number: signal.getsignal(number) for number in signals.ENDING}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.NAME)
@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["-h", "--ros-args", "-p", "x:=1"],
        ["--ros-args", "-r", "__ns:=/a", "--", "-h"],
    ],
)
def test_help_says_what_a_node_is_and_starts_nothing(
    kind: Any, words: list[str], unstarted: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_node(kind, words) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    assert max(map(len, lines)) < 80
    assert lines[0].startswith(f"usage: ros2 run dextar {kind.NAME} ")
    assert " ".join((kind.__doc__ or "").split())[:30].replace("``", "") in text
    for topic in (*NODES[kind.NAME].publishes, *NODES[kind.NAME].reads):
        assert f"  {topic.name} " in text
        assert topic.type in text
    for service in SERVICES:
        assert (
            f"  ~/{service.name.partition('/')[2]}" in lines
            or service.node != kind.NAME
            or f"  ~/{service.name.partition('/')[2]} " in text
        )
    assert "--ros-args -p NAME:=VALUE" in " ".join(text.split())
    for spec in kind.PARAMETERS:
        assert any(line.startswith(f"  {spec.name} = ") for line in lines)


def test_help_tells_default_unit_range_and_whether_a_parameter_is_live() -> None:
    text = node_help(ControllerNode)
    assert "\n  joint_states.healthy_time = 0.5 s (0 to 60; live)\n" in text
    assert "\n  lockstep = false\n" in text
    assert "It is one of classic, projected, consistent" in " ".join(text.split())
    assert "\n  bag.max_size = 0 bytes (>= 0)\n" in node_help(RecorderNode)
    assert "\n  task.start = [-0.025, 0.115] m (2 numbers)\n" in node_help(PlantNode)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.NAME)
def test_every_number_that_measures_something_has_a_unit(kind: Any) -> None:
    defaults = node_defaults(kind.NAME)
    for spec in kind.PARAMETERS:
        default = defaults[spec.name]
        if isinstance(default, float) or (isinstance(default, list) and default):
            assert spec.unit, spec.name


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.NAME)
def test_the_contract_says_what_a_node_publishes_reads_and_offers(kind: Any) -> None:
    wanted = {
        "plant": [
            "external_pose.rate:=100.0",
            "simulation.start_paused:=true",
            "mode:=lockstep",
        ],
        "recorder": ["record_from_start:=false"],
        "controller": ["publish.effort_array:=true", "estimator:=external"],
    }.get(kind.NAME, [])
    rclpy.init(
        args=["--ros-args", *(part for value in wanted for part in ("-p", value))],
        signal_handler_options=SignalHandlerOptions.NO,
    )
    node = kind()
    try:
        if kind is PanelNode:
            node.watched(1)
        published = {pub.topic_name for pub in node.publishers}
        read = {sub.topic_name for sub in node._subscriptions}
        offered = {service.service_name for service in node._services}
        own = f"/{kind.NAME}/"
        ends, absolute = NODES[kind.NAME], node.resolve_topic_name
        assert {absolute(t.name) for t in ends.publishes} == {
            name
            for name in published
            if name not in ("/rosout", "/parameter_events") and not name.startswith(own)
        }
        reads = {absolute(t.name) for t in ends.reads}
        if kind is PlantNode:  # command_interface chooses one of the two
            reads -= {absolute("effort_commands")}
        assert reads <= read
        assert read - reads <= {"/parameter_events", "/rosout"}
        assert {
            f"/{service.name}" for service in SERVICES if service.node == kind.NAME
        } == {
            name
            for name in offered
            if name.startswith(own)
            and "parameter" not in name
            and "type_description" not in name
        }
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["frobnicate"], "argument 'frobnicate' is not known"),
        (
            ["--ros-args", "-p", "a:=1", "--", "--verbose"],
            "argument '--verbose' is not known",
        ),
        (["law:=classic"], "write --ros-args -p law:=classic"),
        (["--ros-args", "--frob"], "unknown ROS argument '--frob'"),
        (["--ros-args", "-p", "law"], "'-p law'. It must be NAME:=VALUE."),
        (["--ros-args", "-r", "law"], "'-r law'. It must be OLD:=NEW."),
        (
            ["--ros-args", "--params-file", "/no/such.yaml"],
            "parameter file /no/such.yaml: No such file or directory",
        ),
    ],
)
@pytest.mark.parametrize("kind", [ControllerNode, EchoNode], ids=["controller", "echo"])
def test_what_is_not_known_is_one_line_before_anything_is_started(
    kind: Any,
    words: list[str],
    message: str,
    unstarted: None,
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert run_node(kind, words) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert message in err


def test_parameters_that_come_through_a_pipe_reach_the_node(
    capfd: pytest.CaptureFixture[str],
) -> None:
    reading, writing = os.pipe()
    os.write(writing, b"/**/recorder:\n  ros__parameters:\n    sync_period: -7.0\n")
    os.close(writing)
    try:
        assert (
            run_node(
                RecorderNode, ["--ros-args", "--params-file", f"/dev/fd/{reading}"]
            )
            == 2
        )
    finally:
        os.close(reading)
    assert "parameter 'bag.sync_period' = -7.0" in capfd.readouterr().err


@pytest.mark.parametrize("words", [["--frob"], ["-p", "law"]])
def test_what_is_not_known_beside_a_pipe_is_one_line_too(
    words: list[str], unstarted: None, capfd: pytest.CaptureFixture[str]
) -> None:
    reading, writing = os.pipe()
    os.close(writing)
    try:
        assert (
            run_node(
                RecorderNode,
                ["--ros-args", "--params-file", f"/dev/fd/{reading}", *words],
            )
            == 2
        )
    finally:
        os.close(reading)
    assert len(capfd.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("name", ["plant", "warmup"])
def test_an_executable_helps_without_compiler_and_physics(
    name: str, tmp_path: Path
) -> None:
    code = (
        f"import atexit, sys; from dextar_control.executables import {name};"
        " atexit.register(lambda: print('pybullet' in sys.modules));"
        f" sys.exit({name}())"
    )
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }
    answer = subprocess.run(
        [sys.executable, "-c", code, "--help"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith("usage: ")
    assert answer.stdout.endswith("False\n")
    assert list(tmp_path.iterdir()) in ([], [tmp_path / "cache"])
    assert not list(tmp_path.rglob("*.nbi"))


@pytest.mark.parametrize("module", MODULES_WITH_MAIN)
def test_every_module_that_can_be_started_reads_its_command_line(module: str) -> None:
    text = (ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
    called = {
        ast.unparse(call.func).rpartition(".")[2]
        for call in ast.walk(ast.parse(text))
        if isinstance(call, ast.Call)
    }
    assert called & {"parse_args", "run_node"}, module


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["demo", "--excite", "0"], "0 s; it must be > 0"),
        (["go", "--excite", "-1"], "-1 s; it must be > 0"),
        (
            ["demo", "--real-time-factor", "-1"],
            "'simulation.real_time_factor' = -1.0; it must be >= 0",
        ),
        (["identify", "run.mcap", "."], ". is given twice"),
        (["calibrate", "run.mcap", "--check", "run.mcap"], "run.mcap is given twice"),
    ],
)
def test_what_a_command_cannot_take_is_refused_before_it_begins(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").touch()  # no bag: it is not read either
    try:
        code = cli.main(words)
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]


def test_every_executable_is_one_function() -> None:
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    for name in (*NODES, "warmup", "dextar"):
        assert f'"{name}"' in text
        assert callable(getattr(executables, name))


def raising(kind: int) -> Callable[[], int]:
    def work() -> int:
        os.kill(os.getpid(), kind)
        time.sleep(PATIENCE)
        return 0

    return work


@pytest.mark.parametrize("number", ENDING)
def test_a_command_that_a_signal_ends_says_one_line(
    number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert signals.run_command("name", raising(number)) == 128 + number
    assert capsys.readouterr().err == "name: interrupted\n"


def test_a_further_signal_does_not_break_the_end_that_is_under_way() -> None:
    done = []

    def work() -> int:
        try:
            return raising(signal.SIGHUP)()
        finally:
            for number in ENDING:
                os.kill(os.getpid(), number)
            done.append(True)

    assert signals.run_command("name", work) == 128 + signal.SIGHUP
    assert done == [True]


def test_an_interrupt_that_was_swallowed_is_raised_again() -> None:
    def work() -> int:
        try:
            raising(signal.SIGTERM)()
        except KeyboardInterrupt:
            pass  # as a callback of compiled code does
        time.sleep(PATIENCE)
        return 0

    assert signals.run_command("name", work) == 128 + signal.SIGTERM


def test_what_became_of_an_interrupt_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        try:
            return raising(signal.SIGINT)()
        except KeyboardInterrupt as interrupt:
            raise ParameterError("a child process was interrupted too") from interrupt

    assert signals.run_command("name", work) == 130
    assert capsys.readouterr().err == "name: interrupted\n"


def test_a_signal_that_the_parent_ignores_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    before = signals.install(lambda *_: None)
    assert set(before) == set(ENDING) - {signal.SIGHUP}
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    signals.restore(before)
    stop_signal = signals.StopSignal()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not stop_signal
    stop_signal.restore()


@pytest.mark.parametrize("number", ENDING)
def test_a_running_node_takes_every_signal_as_a_flag(number: int) -> None:
    stop_signal = signals.StopSignal()
    stop_signal.starting = False
    for each in (number, *ENDING):
        os.kill(os.getpid(), each)
    assert stop_signal
    assert stop_signal.number == number
    stop_signal.restore()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize("name", ["controller", "dextar"])
def test_a_signal_while_modules_load_ends_without_a_traceback(
    name: str, number: int, tmp_path: Path
) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from"
        f" dextar_control.executables import {name}; {name}()"
    )
    for slow in ("rclpy", "argparse"):  # stand for what takes long to load
        (tmp_path / f"{slow}.py").write_text(
            "print('loading', flush=True)\nimport time\ntime.sleep(60)\n"
        )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "loading\n"
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE)
    assert output == ""
    assert process.returncode == (128 + number if name == "dextar" else 0)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT])
def test_a_terminal_that_closes_leaves_no_torque(number: int) -> None:
    robot = load_robot(config_file(ROBOT_FILE))
    q_a = Model.of(robot).inverse_geometric_model(
        np.array(node_defaults("controller")["task.start"]) + 1e-4
    )
    rig = Rig()
    process = start(
        "dextar_control.nodes.controller",
        "-p",
        "controller:lockstep:=true",
        "-p",
        "controller:joint_states.healthy_time:=0.0",
    )
    try:
        rig.until(
            lambda: rig.controller("lifecycle") == "active",
            "the controller did not start",
        )
        matched(rig)
        for tick in range(1, 6):
            rig.answer(tick * 1_000_000, q_a + 1e-4 * tick)
        assert np.abs(rig.commands[-1].effort).max() > 0.0
        process.send_signal(number)
        process.send_signal(signal.SIGTERM)
        rig.until(
            lambda: not np.any(rig.commands[-1].effort),
            "the last torque is still commanded",
        )
    finally:
        code, output = stop(process)
        rig.close()
    assert code == 0, output
    assert "Traceback" not in output


def test_a_clock_that_is_set_changes_neither_order_nor_age() -> None:
    system, steady = [1_000_000], [50]
    clock = UnsteppedClock(lambda: system[0], lambda: steady[0])
    assert clock.now() == 1_000_000
    steady[0], system[0] = 150, 1_000_100
    assert (clock.now(), clock.arrival(1_000_090), clock.arrival(0)) == (
        1_000_100,
        1_000_090,
        1_000_100,
    )
    system[0] -= 60_000  # set back
    assert (clock.now(), clock.arrival(system[0] - 10)) == (1_000_100, 1_000_090)
    assert (
        clock.arrival(1_000_090) <= 1_000_090
    )  # it waited while the clock was set: never younger
    system[0] += 120_000
    assert (clock.now(), clock.arrival(system[0] - 10)) == (1_000_100, 1_000_090)


def test_the_command_is_ended_by_a_hang_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        cli.COMMANDS["bench"], "run", lambda _: raising(signal.SIGHUP)()
    )
    assert cli.main(["bench"]) == 129
    assert capsys.readouterr().err == "dextar bench: interrupted\n"


ENDS = """
import atexit, os, sys, time, types
from dextar_control import executables
from dextar_control.contract import signals

sys.modules["fake"] = types.SimpleNamespace(main=lambda: 7)
atexit.register(lambda: [(os.kill(os.getpid(), number), time.sleep(0.01)) for number in signals.ENDING])
sys.exit(executables._node("fake"))
"""


def test_a_signal_after_the_end_changes_nothing() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, "-c", ENDS], env=environment, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (7, "")


def test_a_node_that_the_system_does_not_let_start_says_why(
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Starved(DextarNode):
        def __init__(self) -> None:
            raise OSError(24, "Too many open files", "METADATA")

    assert run_node(Starved, []) == 2
    assert (
        capsys.readouterr().err
        == "error: the node cannot be started: [Errno 24] Too many open files:"
        " 'METADATA'\n"
    )
