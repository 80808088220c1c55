"""The recorder on disks that fill, refuse or lose their power: real file systems in a
mount namespace of their own.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from patience import PATIENCE
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from std_msgs.msg import String
from synthetic_run import TYPES

from dextar_control.bags.reader import read_bag
from dextar_control.bags.recover import recover
from dextar_control.contract import topics
from dextar_control.nodekit.node import qos

RECORDER = (
    "import sys; from dextar_control.nodes.recorder import main;"
    " sys.exit(main(sys.argv[1:]))"
)
UNSHARE = ["unshare", "--mount", "--propagation", "private"]
# Runs the recorder on the mounted folder $1, copies what it left to $2; the rest are
# its arguments.
ON_MOUNT = """
disk=$1; out=$2; shift 2
"$@"
code=$?
cp -r "$disk" "$out"
exit $code
"""
# Mounts the image $1 on $2, runs the recorder there until a line comes, shuts the file
# system down without flushing its
# journal (EXT4_IOC_SHUTDOWN, NOLOGFLUSH: as if the power were gone), mounts it again
# and copies the bag to $3.
POWER_CUT = """
import fcntl, os, shutil, struct, subprocess, sys
image, disk, out, *command = sys.argv[1:]
subprocess.run(["mount", "-o", "loop,commit=300", image, disk], check=True)
try:
    recorder = subprocess.Popen(command)
    sys.stdin.readline()
    handle = os.open(disk, os.O_RDONLY)
    fcntl.ioctl(handle, 0x8004587D, struct.pack("I", 2))
    recorder.kill()
    recorder.wait()
    os.close(handle)
    subprocess.run(["umount", disk], check=True)
    subprocess.run(["mount", "-o", "loop", image, disk], check=True)
    shutil.copytree(f"{disk}/bag", out)
finally:
    subprocess.run(["umount", disk])
"""


def can(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=30).returncode == 0
    except OSError:
        return False


def namespace() -> list[str]:
    """How this user gets a mount namespace, or a skip."""
    for way in (UNSHARE, [*UNSHARE, "--user", "--map-root-user"]):
        if can(*way, "sh", "-c", "mount -t tmpfs -o size=64k tmpfs /mnt"):
            return way
    pytest.skip("no private mount namespace for this user")


@pytest.fixture
def plant() -> Iterator[Node]:
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node("plant", context=context)
    yield node
    node.destroy_node()
    rclpy.try_shutdown(context=context)


class Talker:
    """Publishes numbered strings and hears the recorder's diagnostics."""

    def __init__(self, node: Node, size: int) -> None:
        self.count = 0
        self.status: dict[str, str] = {}
        self.levels: list[tuple[int, str]] = []
        self._filling = os.urandom(size // 2).hex()
        self.publisher = node.create_publisher(String, "numbers", 200)
        node.create_subscription(
            DiagnosticArray,
            topics.DIAGNOSTICS.name,
            self._on_diagnostics,
            qos(topics.DIAGNOSTICS),
        )
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def say(self) -> None:
        self.publisher.publish(String(data=f"{self.count} {self._filling}"))
        self.count += 1

    def hear(self) -> None:
        self._executor.spin_once(timeout_sec=0.01)

    def until(
        self, condition: Callable[[], Any], act: Callable[[], Any] = lambda: None
    ) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, (
                f"waited in vain; the recorder said {self.levels[-3:]}"
            )
            act()
            self.hear()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.status = {entry.key: entry.value for entry in status.values}
            self.levels.append((status.level[0], status.message))


def arguments(output: Path, *parameters: str) -> list[str]:
    always = (
        "topics.extra:=numbers",
        "bag.parameters_of:=''",
        "bag.compression:=none",
        "topics.reliable:=true",
    )
    settings = (f"output:={output}", *always, *parameters)
    return [
        sys.executable,
        "-c",
        RECORDER,
        "--ros-args",
        *(part for text in settings for part in ("-p", text)),
    ]


def numbers(bag: Path) -> list[int]:
    with Reader(bag) as reader:
        return [
            int(TYPES.deserialize_cdr(raw, c.msgtype).data.split()[0])
            for c, _, raw in reader.messages()
            if c.topic == "/numbers"
        ]


def on_tmpfs(
    options: str, disk: Path, out: Path, command: list[str]
) -> subprocess.Popen[str]:
    script = f"mount -t tmpfs -o {options} tmpfs $1 && {{ {ON_MOUNT} }}"
    return subprocess.Popen(
        [*namespace(), "sh", "-c", script, "sh", str(disk), str(out), *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_on_a_full_disk_the_bag_ends_whole_and_it_is_said(
    plant: Node, tmp_path: Path
) -> None:
    disk, out = tmp_path / "disk", tmp_path / "out"
    disk.mkdir()
    talker = Talker(plant, 50_000)
    process = on_tmpfs("size=12m", disk, out, arguments(disk / "run.mcap"))
    talker.until(
        lambda: (
            talker.publisher.get_subscription_count() > 0 or process.poll() is not None
        )
    )

    def speak() -> None:
        talker.say()
        time.sleep(0.005)

    talker.until(lambda: process.poll() is not None, speak)
    for _ in range(20):
        talker.hear()
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    told = [
        line
        for line in errors.splitlines()
        if "run.mcap stopped: No space left on device; the bag is whole" in line
    ]
    assert len(told) == 1
    assert "Traceback" not in errors
    assert any(
        level == 2 and "No space left on device" in words
        for level, words in talker.levels
    )
    kept = numbers(out)
    assert kept == list(range(kept[0], kept[0] + len(kept)))
    assert len(kept) > 100
    with (out / "run.mcap").open("rb") as stream:
        record = [
            entry.metadata
            for entry in make_reader(stream).iter_metadata()
            if entry.name == "dextar"
        ][-1]
    counts = json.loads(record["topics"])["/numbers"]
    assert counts["received"] == len(kept) + counts["dropped"]
    assert record["ended"]


def test_a_disk_without_room_to_end_a_bag_is_refused_at_the_start(
    tmp_path: Path,
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    process = on_tmpfs("size=2m", disk, tmp_path / "out", arguments(disk / "run.mcap"))
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert (
        "run.mcap: No space left on device (4 MiB are kept free to end the bag)"
        in errors
    )
    assert list((tmp_path / "out").iterdir()) == []


def test_a_folder_that_cannot_be_written_is_refused_at_the_start(
    tmp_path: Path,
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    process = on_tmpfs(
        "size=64m,ro", disk, tmp_path / "out", arguments(disk / "deep" / "run.mcap")
    )
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert [
        line
        for line in errors.splitlines()
        if "run.mcap: Read-only file system" in line
    ]
    assert "Traceback" not in errors


def test_a_power_cut_costs_no_more_than_what_the_disk_had_not_confirmed(
    plant: Node, tmp_path: Path
) -> None:
    image, disk, out = tmp_path / "image", tmp_path / "disk", tmp_path / "out"
    disk.mkdir()
    with image.open("wb") as file:
        file.truncate(64 << 20)
    if not shutil.which("mkfs.ext4") or not can("mkfs.ext4", "-q", str(image)):
        pytest.skip("no mkfs.ext4")
    if not can(*UNSHARE, "sh", "-c", f"mount -o loop {image} {disk}"):
        pytest.skip("this user cannot mount a file")
    talker = Talker(plant, 1000)
    command = [
        *UNSHARE,
        sys.executable,
        "-c",
        POWER_CUT,
        str(image),
        str(disk),
        str(out),
    ]
    process = subprocess.Popen(
        [*command, *arguments(disk / "bag" / "run.mcap", "bag.sync_period:=0.1")],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    talker.until(
        lambda: (
            talker.publisher.get_subscription_count() > 0 or process.poll() is not None
        )
    )
    for _ in range(150):
        talker.say()
    talker.until(
        lambda: (
            talker.status.get("/numbers received") == "150"
            and talker.status["pending"] == "0"
        )
    )
    for _ in range(
        2
    ):  # the second confirmation that is told of was asked for after the first
        before = talker.status["bytes_on_disk"]
        talker.until(lambda before=before: talker.status["bytes_on_disk"] != before)
    for _ in range(50):
        talker.say()
    _, errors = process.communicate("cut\n", timeout=PATIENCE)
    assert process.returncode == 0, errors
    with pytest.warns(UserWarning, match="last complete chunk"):
        assert len(read_bag(out / "run.mcap").messages["/numbers"]) >= 150
    assert numbers(recover(out / "run.mcap").folder)[:150] == list(range(150))
