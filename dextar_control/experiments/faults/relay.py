"""The process between two network interfaces, which reads Ethernet frames off one and
sends them out of the other.

Started by ``netns.FaultyLink``. One JSON object a line on its standard input, one in
answer on its output: a quality for a direction, or a question for the statistics. It
ends with its input.
"""

from __future__ import annotations

import argparse
import array
import ctypes
import fcntl
import json
import os
import select
import socket
import struct
import sys
import time
from pathlib import Path

from dextar_control.experiments.faults.frames import (
    DIRECTIONS,
    FrameSchedule,
    LinkQuality,
)

ETH_P_ALL = 0x0003  # of linux/if_ether.h
# of linux/if_packet.h
SOL_PACKET, PACKET_STATISTICS, PACKET_IGNORE_OUTGOING = 263, 6, 23
SO_RCVBUFFORCE = 33
SIOCETHTOOL = 0x8946
# commands of ethtool (ETHTOOL_S...)
OFFLOADS = {
    "transmit checksums": 0x17,
    "TCP segmentation": 0x1F,
    "generic segmentation": 0x24,
}
CLONE_NEWNET = 0x40000000
BUFFER = 16 << 20  # bytes the kernel keeps while the relay sleeps
BATCH = 64  # frames read before those due are sent
LARGEST_FRAME = 65536 + 18


def switch_offloads_off(pid: int, interface: str) -> None:
    """Have the kernel write every checksum itself, in the network namespace of the
    process pid.

    A veth leaves the checksum of a datagram to a card that does not exist; a frame read
    off it and sent on would be thrown away as broken.

    Raises:
        OSError: the interface does not take the setting.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    with (
        open("/proc/self/ns/net", "rb") as own,
        Path(f"/proc/{pid}/ns/net").open("rb") as other,
    ):
        if libc.setns(other.fileno(), CLONE_NEWNET):
            raise OSError(
                ctypes.get_errno(), f"setns: {os.strerror(ctypes.get_errno())}"
            )
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
                for setting in OFFLOADS.values():
                    value = array.array("B", struct.pack("II", setting, 0))
                    request = struct.pack(
                        "16sP", interface.encode(), value.buffer_info()[0]
                    )
                    fcntl.ioctl(control, SIOCETHTOOL, request)
        finally:
            libc.setns(own.fileno(), CLONE_NEWNET)


class Relay:
    """Carries frames between two interfaces, through a queue each way."""

    def __init__(
        self, interfaces: tuple[str, str], quality: LinkQuality, seed: int
    ) -> None:
        self._sockets = [_packet_socket(interface) for interface in interfaces]
        self._schedules = {
            name: FrameSchedule(quality, f"{seed} {name}") for name in DIRECTIONS
        }
        self._ways = [
            (self._sockets[0], self._sockets[1], self._schedules["a_to_b"]),
            (self._sockets[1], self._sockets[0], self._schedules["b_to_a"]),
        ]

    def run(self, control: int) -> None:
        """Forward until the file descriptor control ends."""
        waiting: list[socket.socket | int] = [*self._sockets, control]
        pending = b""
        while True:
            due = min(
                schedule.next_departure() for schedule in self._schedules.values()
            )
            timeout = None if due == float("inf") else max(due - time.monotonic(), 0.0)
            ready, _, _ = select.select(waiting, [], [], timeout)
            for source, _, schedule in self._ways:
                if source in ready:
                    _read(source, schedule)
            self._send_due()
            if control in ready:
                data = os.read(control, 65536)
                if not data:
                    return
                *lines, pending = (pending + data).split(b"\n")
                for line in lines:
                    print(json.dumps(self._answer(json.loads(line))), flush=True)

    def _send_due(self) -> None:
        now = time.monotonic()
        for _, target, schedule in self._ways:
            for frame in schedule.leave(now):
                try:
                    target.send(frame)
                except OSError:  # the far end is down, full, or its frames are smaller
                    schedule.statistics.refused += 1

    def _answer(
        self, qualities: dict[str, dict[str, float]]
    ) -> dict[str, dict[str, int]]:
        for way, quality in qualities.items():
            self._schedules[way].quality = LinkQuality(**quality)
        for (
            source,
            _,
            schedule,
        ) in self._ways:  # the kernel's count begins anew each time it is read
            _, lost = struct.unpack(
                "II", source.getsockopt(SOL_PACKET, PACKET_STATISTICS, 8)
            )
            schedule.statistics.overrun += lost
        return {
            name: schedule.statistics.to_dict()
            for name, schedule in self._schedules.items()
        }


def _packet_socket(interface: str) -> socket.socket:
    packets = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    packets.setsockopt(SOL_PACKET, PACKET_IGNORE_OUTGOING, 1)
    packets.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER)
    packets.bind((interface, ETH_P_ALL))
    packets.setblocking(False)
    return packets


def _read(source: socket.socket, schedule: FrameSchedule) -> None:
    for _ in range(BATCH):
        try:
            frame = source.recv(LARGEST_FRAME)
        except OSError:
            return
        schedule.enter(time.monotonic(), frame)


def main() -> int:
    """Run the process, whose argument is one JSON object, see ``FaultyLink``."""
    parser = argparse.ArgumentParser(
        description="Carry frames between two ends, some of them late or never."
    )
    parser.add_argument(
        "settings", type=json.loads, help="a JSON object, see FaultyLink"
    )
    settings = parser.parse_args().settings
    for pid, interface in settings["ends"]:
        switch_offloads_off(pid, interface)
    quality = LinkQuality(**settings["quality"])
    relay = Relay(tuple(settings["interfaces"]), quality, settings["seed"])
    print("ready", flush=True)
    relay.run(sys.stdin.fileno())
    return 0


if __name__ == "__main__":
    sys.exit(main())
