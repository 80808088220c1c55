"""``dextar go``, ``stop``, ``status``, ``enable`` and ``reset`` on real nodes in
lockstep, in a namespace.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from patience import PATIENCE
from rig import NODES, start, stop

from dextar_control.cli.main import main
from dextar_control.nodekit import client
from dextar_control.nodekit.domain import own_domain
from dextar_control.nodes import operator

NAMESPACE = ("--namespace", "/left")


class Robot:
    """The commands, and what they print.

    Attributes:
        verdicts: lines on crossings that ``go`` printed.
    """

    def __init__(self, capsys: pytest.CaptureFixture[str], verdicts: list[str]) -> None:
        self._capsys = capsys
        self.printed = ""
        self.verdicts = verdicts

    def __call__(self, *words: str) -> tuple[int, str]:
        """Exit code and output of a command."""
        self._capsys.readouterr()
        code = main([*words, *NAMESPACE])
        printed = self._capsys.readouterr()
        self.note(printed.out)
        return code, printed.out + printed.err

    def note(self, text: str) -> None:
        """Keep the lines on crossings."""
        self.verdicts += re.findall(r"crossing \d+ of \d+: \w+ .*", text)

    def until(self, phases: str, trip: subprocess.Popen[str] | None = None) -> None:
        """Hear the controller until it is active in one of these phases."""

        def there() -> bool:
            assert trip is None or trip.poll() is None, "it has ended"
            told = me.controller
            return told.get("lifecycle") == "active" and bool(
                re.fullmatch(phases, told["phase"])
            )

        with operator.operator(NAMESPACE[1]) as me:
            assert me.until(there, PATIENCE), me.controller

    def all_told(self) -> tuple[int, str]:
        """Exit code and output of a ``status`` that has heard every node."""
        others = [f"\n{node}: " for node in NODES if node != "controller"]
        deadline = time.monotonic() + PATIENCE
        while True:
            code, text = self("status")
            if all(line in text for line in others):
                return code, text
            assert time.monotonic() < deadline, text

    @contextlib.contextmanager
    def trip(self) -> Iterator[subprocess.Popen[str]]:
        """A slow trip, stopped before it crosses, in a process of its own; afterwards
        what it prints is in ``printed``.
        """
        command = [
            sys.executable,
            "-m",
            "dextar_control.cli.main",
            "go",
            "--duration",
            "30",
            *NAMESPACE,
        ]
        trip = subprocess.Popen(
            command,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=Path(__file__).parents[2],
        )
        try:
            self.until("TRACK|CROSSING", trip)
            yield trip
        except BaseException:
            trip.kill()
            raise
        finally:
            self.printed = trip.communicate(timeout=PATIENCE)[0]
            print(self.printed)
            self.note(self.printed)


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """Four nodes of one robot; what was told of crossings must be in the controller's
    log as well.
    """
    bag = tmp_path_factory.mktemp("run") / "run.mcap"
    # At half the pace the robot, which holds most of the time, leaves the commands room.
    own = {
        "plant": ("simulation.real_time_factor:=0.5",),
        "recorder": (f"output:={bag}",),
    }
    processes: dict[str, subprocess.Popen[str]] = {}
    verdicts: list[str] = []
    try:
        for name, (module, values) in NODES.items():
            values = (*values, *own.get(name, ()))
            processes[name] = start(
                module,
                "-r",
                "__ns:=/left",
                *(part for value in values for part in ("-p", value)),
            )
        yield verdicts
    finally:
        ends = {name: stop(process) for name, process in reversed(processes.items())}
    for code, output in ends.values():
        assert code == 0, output
        assert "Traceback" not in output, output
    assert verdicts
    log = ends["controller"][1]
    for line in dict.fromkeys(verdicts):
        assert line in log
        assert log.count(line) == verdicts.count(line), line


@pytest.fixture
def robot(stack: list[str], capsys: pytest.CaptureFixture[str]) -> Robot:
    return Robot(capsys, stack)


def test_one_kind_of_task_switches_the_others_off_and_what_is_not_given_stays() -> None:
    nothing = {
        "tour": None,
        "point": None,
        "excite": None,
        "duration": None,
        "repeat": None,
    }
    assert operator.task_values(nothing) == {}
    assert operator.task_values(nothing | {"repeat": 3}) == {"task.repeat": 3}
    assert operator.task_values(nothing | {"point": [0.0, 0.08], "duration": 2.0}) == {
        "task.tour": 0,
        "task.point": [0.0, 0.08],
        "task.excite": 0.0,
        "task.tour_points": [],
        "task.direction": 0,
        "task.duration": 2.0,
    }


def test_a_stop_reaches_a_trajectory_server_that_is_found_late() -> None:
    class Busy:
        """A client whose time passes only while it waits."""

        now, stopped = 0.0, False

        def client(self, *_: object) -> Busy:
            return self

        def service_is_ready(self) -> bool:
            return self.now >= 3.0

        def call_async(self, _: object) -> Busy:
            self.stopped = True
            return self

        def done(self) -> bool:
            return self.stopped

        def until(
            self, condition: Callable[[], object], seconds: float, *, through: bool
        ) -> bool:
            end = self.now + seconds
            while not condition() and self.now < end:
                self.now += 0.1
            return bool(condition())

    busy = Busy()
    operator.OperatorClient.stop_server(busy)  # type: ignore[arg-type]
    assert busy.stopped


def test_a_trip_is_followed_to_its_end(robot: Robot) -> None:
    robot.until("HOLD")
    robot.all_told()  # the recorder, which begins last, is there
    code, text = robot("go")
    assert code == 0, text
    assert re.findall(
        r"crossing (\d) of 2: CROSSED \(confidence (?:0\.9\d\d|1\.000)\)", text
    ) == ["1", "2"]
    error = float(
        re.search(
            r"^done: crossed 2 of 2 planned, largest error (\S+) mm$",
            text,
            re.MULTILINE,
        )[1]
    )
    assert 0.0 < error < 1.0
    assert re.search(r"^recorded in .*run\.mcap$", text, re.MULTILINE)
    code, text = robot.all_told()
    assert code == 0
    assert (
        f"crossing 2 of 2, crossed 2 of 2 planned, largest error {error:.3f} mm" in text
    )
    assert "law consistent, estimator observer" in text
    assert "side of the locus known" in text


def test_another_task_takes_the_last_ones_place(robot: Robot) -> None:
    code, text = robot("go", "--point", "0.0084", "0.084")
    assert code == 0, text
    assert "done: crossed 2 of 2" in text


def test_a_task_that_cannot_be_is_refused_and_nothing_moves(robot: Robot) -> None:
    for words, told in {
        ("--point", "0.0", "0.05"): "off the Type 2 locus",
        ("--duration", "0.001"): "duration = 0.001 s; it must be 0 or >= 0.02",
    }.items():
        code, text = robot("go", *words)
        assert (code, "done" in text) == (2, False)
        assert told in text
    assert robot("go", "--tour", "0", "--duration", "0.33")[0] == 0


def test_ctrl_c_is_a_safe_stop_and_each_refusal_says_what_to_type(robot: Robot) -> None:
    with robot.trip() as trip:
        code, text = robot("go")
        trip.send_signal(signal.SIGINT)
    assert code == 2
    assert (
        "a trip starts from HOLD: wait until it holds, or type dextar stop --namespace"
        " /left" in text
    )
    output = robot.printed
    assert trip.returncode == 128 + signal.SIGINT, output
    assert re.search(r"^not done: crossed \d+ of 2 planned", output, re.MULTILINE)
    assert re.search(r"^SAFE_STOP \(stop requested; at rest", output, re.MULTILINE)
    code, text = robot("go")
    assert code == 2
    assert "phase SAFE_STOP" in text
    assert text.strip().endswith(
        "type dextar reset --namespace /left, then dextar enable --namespace /left"
    )
    assert robot("enable")[0] == 2
    assert robot("reset") == (0, "IDLE: type dextar enable --namespace /left\n")
    assert robot("enable") == (0, "HOLD\n")
    assert robot("stop") == (0, "HOLD\n")  # holding goes on
    assert robot("enable", "--off") == (
        0,
        "IDLE (disabled on request): type dextar enable --namespace /left\n",
    )
    assert robot("reset")[0] == 0  # nothing is latched
    assert robot("reset", "--plant")[0] == 0
    assert "x -0.0250 m, y 0.1150 m" in robot("status")[1]  # where it began
    assert robot("enable") == (0, "HOLD\n")
    code, text = robot("reset", "--plant")
    assert code == 2
    assert text.endswith("type dextar enable --namespace /left --off first\n")
    assert robot("stop") == (0, "HOLD\n")  # and the robot was not touched


def test_a_stop_ends_the_trip_of_another(robot: Robot) -> None:
    with robot.trip() as trip:
        code, text = robot("stop")
    assert code == 0, text
    assert re.match(r"SAFE_STOP \(stop requested; at rest", text)
    assert trip.returncode == 1, robot.printed
    assert "not done: " in robot.printed
    assert robot("reset", "--plant") == (
        0,
        "IDLE: type dextar enable --namespace /left\n",
    )  # the side is known still


def test_two_nodes_of_one_name_are_told_and_another_namespace_is_named(
    robot: Robot, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    deadline = time.monotonic() + PATIENCE
    with monkeypatch.context() as patch:
        patch.setattr(client, "DISCOVERY", 2.0)
        told = ""
        while (
            "/controller does not run, but there is one in /left: choose by --namespace"
            not in told
        ):
            assert time.monotonic() < deadline, told
            assert main(["go"]) == 2
            told = capsys.readouterr().err
    second = start("dextar_control.nodes.trajectory_server", "-r", "__ns:=/left")
    try:
        while (
            "2 nodes are called /left/trajectory_server: end one"
            not in (found := robot("go"))[1]
        ):
            assert time.monotonic() < deadline, found
        assert found[0] == 2
    finally:
        stop(second)


def test_without_nodes_it_says_how_to_start_some(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "DISCOVERY", 0.5)
    monkeypatch.setattr(operator, "SERVER", 0.1)
    monkeypatch.setitem(os.environ, "ROS_DOMAIN_ID", str(own_domain()))
    for command in ("go", "stop", "status", "enable", "reset"):
        assert main([command]) == 2
        told = capsys.readouterr().err
        domain = os.environ["ROS_DOMAIN_ID"]
        assert told.startswith(
            f"dextar {command}: no word of /controller within 0.5 s (ROS_DOMAIN_ID"
            f" {domain}, "
        )
        assert (
            "start the nodes (ros2 launch dextar crossing.launch.py, or each alone)"
            in told
        )
    assert main(["status", "--namespace", "1 bad"]) == 2
    assert "namespace" in capsys.readouterr().err
