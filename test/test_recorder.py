"""The recorder as its own process, over DDS, read back by independent readers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from mcap.reader import make_reader
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract import topics
from dextar_control.contract.node import qos

PATIENCE = 30.0  # s, for discovery on a busy machine; not a measurement
COUNT = 150  # fewer than the publisher holds: a reliable reader that matches late still gets them all
PROGRAM = "import sys; from dextar_control.ros.recorder_node import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def plant() -> Iterator[Node]:
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node("plant", context=context)
    node.declare_parameter("geometry.left", [0.09, 0.08])
    node.declare_parameter("mode", "lockstep")
    yield node
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    running: list[subprocess.Popen[str]] = []

    def run(output: Path, *parameters: str, prefix: str = "") -> subprocess.Popen[str]:
        arguments = [part for text in (f"output:={output}", "reliable:=true", *parameters) for part in ("-p", text)]
        process = subprocess.Popen(
            [sys.executable, "-c", prefix + PROGRAM, "--ros-args", *arguments],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=os.environ.copy(),
        )  # fmt: skip
        running.append(process)
        return process

    yield run
    for process in running:
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stderr is not None:
            process.stderr.close()


def until(condition: Callable[[], Any], act: Callable[[], Any] = lambda: time.sleep(0.02)) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        act()


def states(node: Node, process: subprocess.Popen[str]) -> list[JointState]:
    """Publish COUNT joint states once the recorder listens; what was sent."""
    publisher = node.create_publisher(JointState, topics.JOINT_STATES.name, qos(topics.JOINT_STATES))
    until(lambda: publisher.get_subscription_count() > 0 or process.poll() is not None)
    sent = []
    for k in range(COUNT):
        message = JointState(name=["q11", "q21"], position=[k * 0.1, -1.0], effort=[0.0, float(k)])
        message.header.stamp.sec = k
        publisher.publish(message)
        sent.append(message)
        if k % 50 == 49:
            time.sleep(0.02)
    return sent


def stop(process: subprocess.Popen[str], number: int = signal.SIGTERM) -> tuple[int, str]:
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    return process.returncode, errors


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_every_sample_and_the_run_itself_are_in_the_bag(
    plant: Node, start: Callable[..., Any], tmp_path: Path, number: int
) -> None:
    file = tmp_path / "deep" / "run.mcap"
    latched = plant.create_publisher(MultiDOFJointTrajectory, topics.TRAJECTORY.name, qos(topics.TRAJECTORY))
    latched.publish(MultiDOFJointTrajectory(joint_names=["end_effector"]))
    extra = plant.create_publisher(String, "remarks", 10)
    process = start(file, "extra_topics:=remarks", "parameters_of:=plant nobody")
    executor = SingleThreadedExecutor(context=plant.context)
    executor.add_node(plant)
    sent = states(plant, process)
    until(lambda: extra.get_subscription_count() > 0, lambda: executor.spin_once(timeout_sec=0.02))
    extra.publish(String(data="here"))

    def parameters_are_there() -> bool:
        return b"parameters.plant" in file.read_bytes()

    until(parameters_are_there, lambda: executor.spin_once(timeout_sec=0.02))
    code, errors = stop(process, number)
    executor.remove_node(plant)
    assert code == 0, errors
    assert f"recording to {file}" in errors
    assert "no parameters of nobody" in errors

    with AnyReader([file]) as reader:
        taken = [
            (connection.topic, reader.deserialize(raw, connection.msgtype))
            for connection, _, raw in reader.messages()
        ]
    recorded = [message for topic, message in taken if topic == "/joint_states"]
    assert [(m.header.stamp.sec, m.name, *m.position, *m.effort) for m in recorded] == [
        (m.header.stamp.sec, list(m.name), *m.position, *m.effort) for m in sent
    ]
    assert [message.joint_names for topic, message in taken if topic == "/trajectory"] == [["end_effector"]]
    assert [message.data for topic, message in taken if topic == "/remarks"] == ["here"]
    assert any(topic == "/diagnostics" for topic, _ in taken)

    with file.open("rb") as stream:
        reader = make_reader(stream)
        record = [entry.metadata for entry in reader.iter_metadata() if entry.name == "dextar"][-1]
        by_topic = {channel.topic: channel for channel in reader.get_summary().channels.values()}
    offered = yaml.safe_load(by_topic["/trajectory"].metadata["offered_qos_profiles"])
    assert offered[0]["durability"] == "transient_local"
    assert offered[0]["deadline"] == {"sec": 9223372036, "nsec": 854775807}
    assert json.loads(record["topics"])["/joint_states"] == {"received": COUNT, "lost": 0, "dropped": 0}
    assert json.loads(record["parameters_missing"]) == ["nobody"]
    parameters = yaml.safe_load(record["parameters.plant"])
    assert parameters["geometry.left"] == [0.09, 0.08]
    assert parameters["mode"] == "lockstep"
    assert yaml.safe_load(record["parameters.recorder"])["output"] == str(file)
    assert record["started"] < record["ended"]


def test_a_killed_recorder_leaves_a_readable_bag(plant: Node, start: Callable[..., Any], tmp_path: Path) -> None:
    from dextar_control.analysis.bag import read_bag

    file = tmp_path / "run.mcap"
    process = start(file, "compression:=none")
    states(plant, process)
    until(lambda: b"q21" in file.read_bytes())
    process.kill()
    process.wait()
    with pytest.warns(UserWarning, match="last complete chunk"):
        bag = read_bag(file)
    assert bag.truncated
    assert bag.metadata["dextar"]["ended"] == ""


def test_an_unusable_output_is_one_line_and_an_exit_code(start: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "taken.mcap").write_text("")
    for output, words in ((tmp_path / "taken.mcap", "exists already"), (Path("/proc/none/run.mcap"), "No such file")):
        process = start(output)
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 2
        assert "Traceback" not in errors
        assert [line for line in errors.splitlines() if str(output) in line and words in line]


def test_a_disk_that_fills_ends_the_recording_aloud(plant: Node, start: Callable[..., Any], tmp_path: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000)); "
    process = start(tmp_path / "run.mcap", "compression:=none", prefix=limit)
    states(plant, process)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "run.mcap stopped: File too large" in errors
    assert "Traceback" not in errors
