"""The recorder as its own process, over DDS, read back by independent readers."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from patience import PATIENCE, until
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from synthetic_run import TYPES
from trajectory_msgs.msg import MultiDOFJointTrajectory

from dextar_control.contract import topics
from dextar_control.nodekit.node import qos

# fewer than the publisher holds: a reliable reader that matches late still gets them
# all
COUNT = 150
PROGRAM = (
    "import sys; from dextar_control.nodes.recorder import main;"
    " sys.exit(main(sys.argv[1:]))"
)


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
def spin(plant: Node) -> Iterator[Callable[[], None]]:
    """Lets the plant hear for a moment."""
    executor = SingleThreadedExecutor(context=plant.context)
    executor.add_node(plant)
    yield lambda: executor.spin_once(timeout_sec=0.02)
    executor.remove_node(plant)


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    running: list[subprocess.Popen[str]] = []

    def run(output: Path, *parameters: str, prefix: str = "") -> subprocess.Popen[str]:
        arguments = [
            part
            for text in (f"output:={output}", "topics.reliable:=true", *parameters)
            for part in ("-p", text)
        ]
        process = subprocess.Popen(
            [sys.executable, "-c", prefix + PROGRAM, "--ros-args", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ.copy(),
        )
        running.append(process)
        return process

    yield run
    for process in running:
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stderr is not None:
            process.stderr.close()


def read_states(node: Node, process: subprocess.Popen[str]) -> Publisher:
    """A publisher of joint states, once the recorder listens."""
    publisher = node.create_publisher(
        JointState, topics.JOINT_STATES.name, qos(topics.JOINT_STATES)
    )
    until(
        lambda: publisher.get_subscription_count() > 0 or process.poll() is not None,
        "the recorder to read the states",
    )
    return publisher


def states(node: Node, process: subprocess.Popen[str]) -> list[JointState]:
    """Publish COUNT joint states once the recorder listens; what was sent."""
    publisher = read_states(node, process)
    sent = []
    for k in range(COUNT):
        message = JointState(
            name=["q11", "q21"], position=[k * 0.1, -1.0], effort=[0.0, float(k)]
        )
        message.header.stamp.sec = k
        publisher.publish(message)
        sent.append(message)
        if k % 50 == 49:
            time.sleep(0.02)
    return sent


def call(
    node: Node, spin: Callable[[], None], kind: Any, name: str, **fields: Any
) -> Any:
    """A service's answer."""
    client = node.create_client(kind, name)
    until(client.service_is_ready, f"service {name}")
    future = client.call_async(kind.Request(**fields))
    until(future.done, f"the answer of {name}", spin)
    node.destroy_client(client)
    return future.result()


def metadata(file: Path) -> dict[str, str]:
    """The last record of the run."""
    with file.open("rb") as stream:
        return [
            entry.metadata
            for entry in make_reader(stream).iter_metadata()
            if entry.name == "dextar"
        ][-1]


def recorded(file: Path, topic: str) -> list[Any]:
    """The messages on a topic, in order."""
    with AnyReader([file]) as reader:
        return [
            reader.deserialize(raw, c.msgtype)
            for c, _, raw in reader.messages()
            if c.topic == topic
        ]


def texts(file: Path, topic: str) -> list[str]:
    """Data of the strings on a topic, in order."""
    return [message.data for message in recorded(file, topic)]


def stop(
    process: subprocess.Popen[str], number: int = signal.SIGTERM
) -> tuple[int, str]:
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    return process.returncode, errors


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_every_sample_and_the_run_itself_are_in_the_bag(
    plant: Node,
    spin: Callable[[], None],
    start: Callable[..., Any],
    tmp_path: Path,
    number: int,
) -> None:
    file = tmp_path / "deep" / "run.mcap"
    latched = plant.create_publisher(
        MultiDOFJointTrajectory, topics.TRAJECTORY.name, qos(topics.TRAJECTORY)
    )
    latched.publish(MultiDOFJointTrajectory(joint_names=["end_effector"]))
    extra = plant.create_publisher(String, "remarks", 10)
    process = start(
        file, "topics.extra:=remarks ghosts", "bag.parameters_of:=plant nobody"
    )
    sent = states(plant, process)
    until(
        lambda: extra.get_subscription_count() > 0,
        "the recorder to read the remarks",
        spin,
    )
    extra.publish(String(data="here"))

    def parameters_are_there() -> bool:
        return file.exists() and b"parameters.plant" in file.read_bytes()

    until(
        parameters_are_there,
        "the plant's parameters in the bag",
        spin,
    )
    code, errors = stop(process, number)
    assert code == 0, errors
    assert f"recording to {file}" in errors
    assert "no parameters of nobody" in errors
    assert "not recorded: ghosts: nobody published there" in errors

    read = recorded(file, "/joint_states")
    assert [(m.header.stamp.sec, m.name, *m.position, *m.effort) for m in read] == [
        (m.header.stamp.sec, list(m.name), *m.position, *m.effort) for m in sent
    ]
    (served,) = recorded(file, "/trajectory")
    assert served.joint_names == ["end_effector"]
    assert texts(file, "/remarks") == ["here"]
    assert recorded(file, "/diagnostics")
    record = metadata(file)
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        by_topic = {channel.topic: channel for channel in summary.channels.values()}
    offered = yaml.safe_load(by_topic["/trajectory"].metadata["offered_qos_profiles"])
    assert offered[0]["durability"] == "transient_local"
    assert offered[0]["deadline"] == {"sec": 9223372036, "nsec": 854775807}
    assert json.loads(record["topics"])["/joint_states"] == {
        "received": COUNT,
        "lost": 0,
        "dropped": 0,
    }
    assert json.loads(record["parameters_missing"]) == ["nobody"]
    parameters = yaml.safe_load(record["parameters.plant"])
    assert parameters["geometry.left"] == [0.09, 0.08]
    assert parameters["mode"] == "lockstep"
    assert yaml.safe_load(record["parameters.recorder"])["output"] == str(file)
    assert record["started"] < record["ended"]


def test_a_killed_recorder_leaves_a_readable_bag(
    plant: Node, start: Callable[..., Any], tmp_path: Path
) -> None:
    from dextar_control.bags.reader import read_bag

    file = tmp_path / "run.mcap"
    process = start(file, "bag.compression:=none")
    states(plant, process)
    until(lambda: file.exists() and b"q21" in file.read_bytes(), "a state in the bag")
    process.kill()
    process.wait()
    with pytest.warns(UserWarning, match="last complete chunk"):
        bag = read_bag(file)
    assert bag.truncated
    assert bag.metadata["dextar"]["ended"] == ""


def test_an_unusable_output_is_one_line_and_an_exit_code(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "taken.mcap").write_text("")
    for output, words in (
        (tmp_path / "taken.mcap", "exists already"),
        (Path("/proc/none/run.mcap"), "No such file"),
    ):
        process = start(output)
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 2
        assert "Traceback" not in errors
        assert [
            line
            for line in errors.splitlines()
            if str(output) in line and words in line
        ]


def test_recordings_begin_and_end_on_call_and_each_is_a_bag_of_its_own(
    plant: Node, spin: Callable[[], None], start: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "run" / "run.mcap"
    latched = plant.create_publisher(
        MultiDOFJointTrajectory, topics.TRAJECTORY.name, qos(topics.TRAJECTORY)
    )
    description = plant.create_publisher(
        String, "robot_description", qos(topics.TRAJECTORY)
    )
    description.publish(String(data="<robot/>"))
    remarks = plant.create_publisher(String, "remarks", 10)
    process = start(
        file,
        "record_from_start:=false",
        "topics.extra:=remarks",
        "run.name:=tuning",
        "bag.parameters_of:=plant",
    )
    seen: dict[str, str] = {}

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            seen.update(
                {entry.key: entry.value for entry in status.values},
                message=status.message,
            )

    plant.create_subscription(
        DiagnosticArray,
        topics.DIAGNOSTICS.name,
        on_diagnostics,
        qos(topics.DIAGNOSTICS),
    )

    def service(verb: str) -> Any:
        return call(plant, spin, Trigger, f"recorder/{verb}")

    def put(*values: Parameter) -> list[tuple[bool, str]]:
        asked = [value.to_parameter_msg() for value in values]
        answer = call(
            plant, spin, SetParameters, "recorder/set_parameters", parameters=asked
        )
        return [(result.successful, result.reason) for result in answer.results]

    def say(text: str) -> None:
        remarks.publish(String(data=text))
        time.sleep(0.1)

    until(
        lambda: (
            remarks.get_subscription_count() > 0
            and latched.get_subscription_count() > 0
        ),
        "the recorder to read remarks and trajectories",
        spin,
    )
    latched.publish(MultiDOFJointTrajectory(joint_names=["end_effector"]))
    say("before")
    until(
        lambda: seen.get("recording") == "False",
        lambda: f"the recorder to say that it stopped; it says {seen}",
        spin,
    )
    assert not file.exists()
    refused = service("stop")
    assert (refused.success, refused.message) == (
        False,
        "not recording; call /recorder/start first",
    )
    begun = service("start")
    assert (begun.success, begun.message) == (True, f"recording to {file}")
    again = service("start")
    assert (again.success, again.message) == (
        False,
        f"already recording to {file}; call /recorder/stop first",
    )
    say("first")
    until(
        lambda: (
            seen.get("recording") == "True" and seen["parameters_missing"] == "none"
        ),
        lambda: f"the recorder to say that it records; it says {seen}",
        spin,
    )
    assert put(
        Parameter("run.notes", value="brake later"), Parameter("run.tags", value="a b")
    ) == [(True, ""), (True, "")]
    assert put(Parameter("output", value="elsewhere.mcap")) == [
        (False, "'output' is fixed while the node runs")
    ]
    plant.set_parameters([Parameter("mode", value="realtime")])
    say("last of the first")
    ended = service("stop")
    assert ended.success, ended.message
    assert ended.message.endswith(f"messages in {file}, 0 lost")
    say("between")
    assert (
        service("start").message
        == f"recording to {tmp_path / 'run' / 'run-2' / 'run.mcap'}"
    )
    say("second")
    code, errors = stop(process)
    assert code == 0, errors
    assert texts(file, "/remarks") == ["first", "last of the first"]
    second = file.parent / "run-2" / "run.mcap"
    assert texts(second, "/remarks") == ["second"]
    for bag in (file, second):  # the trajectory was published once, before either
        with Reader(bag.parent) as reader:
            assert [
                c.msgcount for c in reader.connections if c.topic == "/trajectory"
            ] == [1]
        assert texts(bag, "/robot_description") == ["<robot/>"]
    record = metadata(file)
    assert (record["name"], record["notes"], record["tags"]) == (
        "tuning",
        "brake later",
        "a b",
    )
    assert metadata(second)["notes"] == "brake later"
    changed = {
        (entry["node"], entry["name"]): entry["value"]
        for entry in json.loads(record["parameter_changes"])
    }
    assert changed == {
        ("/recorder", "run.notes"): "brake later",
        ("/recorder", "run.tags"): "a b",
        ("/plant", "mode"): "realtime",
    }
    assert yaml.safe_load(record["parameters.plant"])["mode"] == "lockstep"
    assert json.loads(metadata(second)["parameter_changes"]) == []
    assert json.loads(record["topics"])["/remarks"] == {
        "received": 2,
        "lost": 0,
        "dropped": 0,
    }
    assert ("/plant", ["mode"]) in [
        (event.node, [entry.name for entry in event.changed_parameters])
        for event in recorded(file, "/parameter_events")
    ]


def away(node: Node, process: subprocess.Popen[str], file: Path, count: int) -> int:
    """Publish some, then ``count`` more while the recorder gets no processor time, then
    some until one is there; how many.
    """
    publisher, sent = read_states(node, process), 0

    def publish(numbers: int, frame: str = "") -> None:
        nonlocal sent
        for _ in range(numbers):
            message = JointState(name=["q11", "q21"], position=[0.0, -1.0])
            message.header.stamp.sec, message.header.frame_id = sent, frame
            publisher.publish(message)
            sent += 1

    def repeat(frame: str) -> None:
        """Until a sample is there: a best-effort reader may have matched on one side
        only, or have no room yet.
        """

        def more() -> None:
            publish(1, frame)
            time.sleep(0.1)

        until(
            lambda: file.exists() and frame.encode() in file.read_bytes(),
            f"a state of frame {frame} in the bag",
            more,
        )

    repeat("#begin")
    process.send_signal(signal.SIGSTOP)
    publish(count)
    process.send_signal(signal.SIGCONT)
    repeat("#end")
    return sent


def test_a_recorder_that_was_away_is_given_all_it_missed(
    plant: Node, start: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "run.mcap"
    process = start(file, "bag.compression:=none", "bag.sync_period:=0.1")
    sent = away(plant, process, file, 900)
    code, errors = stop(process)
    assert code == 0, errors
    stamps = [state.header.stamp.sec for state in recorded(file, "/joint_states")]
    assert stamps == list(range(sent))
    assert json.loads(metadata(file)["topics"])["/joint_states"] == {
        "received": sent,
        "lost": 0,
        "dropped": 0,
    }


def test_what_is_lost_on_the_way_is_counted_and_told(
    plant: Node, start: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "run.mcap"
    process = start(
        file, "topics.reliable:=false", "bag.compression:=none", "bag.sync_period:=0.1"
    )
    away(plant, process, file, 5000)
    code, errors = stop(process)
    assert code == 0, errors
    with file.open("rb") as stream:
        numbers = [
            m.sequence
            for _, _, m in make_reader(stream).iter_messages(topics=["/joint_states"])
        ]
    missing = max(numbers) - min(numbers) + 1 - len(numbers)
    assert missing > 0  # the middleware holds some hundreds
    counts = json.loads(metadata(file)["topics"])["/joint_states"]
    assert counts == {"received": len(numbers), "lost": missing, "dropped": 0}
    assert f"/joint_states: {missing} samples lost, {len(numbers)} recorded" in errors
    told = [
        status.message
        for array in recorded(file, "/diagnostics")
        for status in array.status
    ]
    assert f"{missing} samples lost" in told


def test_a_recording_is_split_while_it_runs(
    plant: Node, start: Callable[..., Any], tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    process = start(
        folder / "run.mcap",
        "bag.max_size:=70000",
        "bag.compression:=none",
        "bag.sync_period:=0.1",
    )
    publisher = read_states(plant, process)
    sent = 0

    def publish() -> None:
        nonlocal sent
        for _ in range(50):
            message = JointState(name=["q11", "q21"], position=[0.0, -1.0])
            message.header.stamp.sec = sent
            publisher.publish(message)
            sent += 1
        time.sleep(0.02)

    until(lambda: len(list(folder.glob("run_*.mcap"))) >= 3, "a third file", publish)
    code, errors = stop(process)
    assert code == 0, errors
    with Reader(folder) as reader:
        stamps = [
            TYPES.deserialize_cdr(raw, c.msgtype).header.stamp.sec
            for c, _, raw in reader.messages()
            if c.topic == "/joint_states"
        ]
    assert stamps == list(range(sent))
    assert all(metadata(file)["version"] for file in folder.glob("run_*.mcap"))


@pytest.mark.parametrize(
    ("output", "parameter", "words"),
    [
        ("run.bag", "run.name:=x", "run.bag: the name must end in .mcap"),
        (
            "run.mcap",
            "bag.max_size:=10",
            "'bag.max_size' = 10; it must be 0 or >= 65536 bytes",
        ),
        (
            "run.mcap",
            "bag.max_duration:=-1.0",
            "'bag.max_duration' = -1.0; it must be >= 0",
        ),
        (
            "run.mcap",
            "bag.sync_period:=0.0",
            "'bag.sync_period' = 0.0; it must be >= 0.1",
        ),
        (
            "run.mcap",
            "bag.compression:=lz5",
            "'bag.compression' = 'lz5'; it must be one of zstd, none",
        ),
    ],
)
def test_a_bad_parameter_is_one_line_and_an_exit_code(
    start: Callable[..., Any], tmp_path: Path, output: str, parameter: str, words: str
) -> None:
    process = start(tmp_path / output, parameter)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert [line for line in errors.splitlines() if words in line]
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_the_bags_folder_follows_the_stamp(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    process = start(tmp_path / "{stamp}" / "run.mcap")
    until(
        lambda: list(tmp_path.glob("*/run.mcap")), "a bag"
    )  # a signal before that ends a node that is still being made
    assert stop(process)[0] == 0
    [folder] = tmp_path.iterdir()
    begun = datetime.strptime(folder.name, "%Y%m%dT%H%M%SZ").replace(
        tzinfo=timezone.utc
    )
    assert (
        abs(
            (
                datetime.fromisoformat(metadata(folder / "run.mcap")["started"]) - begun
            ).total_seconds()
        )
        < PATIENCE
    )
    with Reader(folder):
        pass


def test_a_bag_that_is_deleted_under_the_recorder_ends_the_recording_aloud(
    plant: Node, start: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "run" / "run.mcap"
    process = start(file, "bag.sync_period:=0.1")
    states(plant, process)
    until(file.exists, "a bag")
    shutil.rmtree(file.parent)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "run.mcap stopped: the file was deleted" in errors
    assert "Traceback" not in errors


def test_a_disk_that_fills_ends_the_recording_aloud(
    plant: Node, start: Callable[..., Any], tmp_path: Path
) -> None:
    limit = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000)); "
    )
    process = start(tmp_path / "run.mcap", "bag.compression:=none", prefix=limit)
    states(plant, process)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "run.mcap stopped: File too large" in errors
    assert "Traceback" not in errors
