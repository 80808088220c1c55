"""The processes at the two ends of a faulty link, as the tests start them: ``python
link_peer.py ROLE ...``.
"""

from __future__ import annotations

import json
import select
import socket
import sys
import time

PORT = 47011
HEADER = 16  # bytes: number and time of sending
GAP = 2e-4  # s between two datagrams
DRAIN = 0.5  # s for what the relay has sent already


def send(address: str, count: int) -> None:
    """Numbered datagrams with the monotonic clock in them, which is the machine's and
    so the same at both ends.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for number in range(count):
            out.sendto(
                number.to_bytes(8, "big") + time.monotonic_ns().to_bytes(8, "big"),
                (address, PORT),
            )
            time.sleep(GAP)


def receive() -> None:
    """Print (number, delay in ns) of each datagram in the order of arrival, once the
    standard input has ended.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inlet:
        inlet.setsockopt(
            socket.SOL_SOCKET, 33, 8 << 20
        )  # SO_RCVBUFFORCE: nothing may be lost but on the link
        inlet.bind(("", PORT))
        print("ready", flush=True)
        arrived = []
        waiting: list[object] = [inlet, sys.stdin]
        while ready := select.select(
            waiting, [], [], None if sys.stdin in waiting else DRAIN
        )[0]:  # type: ignore[arg-type]
            if inlet in ready:
                data, now = inlet.recv(HEADER), time.monotonic_ns()
                arrived.append(
                    (
                        int.from_bytes(data[:8], "big"),
                        now - int.from_bytes(data[8:], "big"),
                    )
                )
            elif sys.stdin in ready:
                waiting.remove(sys.stdin)
        print(json.dumps(arrived))


def publish(count: int) -> None:
    """Numbered messages, reliable, once somebody reads them; until they are all
    acknowledged.
    """
    import rclpy
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile
    from std_msgs.msg import UInt64

    rclpy.init()
    node = rclpy.create_node("talker")
    publisher = node.create_publisher(UInt64, "numbers", QoSProfile(depth=count))
    while publisher.get_subscription_count() == 0:
        rclpy.spin_once(node, timeout_sec=0.05)
    for number in range(count):
        publisher.publish(UInt64(data=number))
        time.sleep(0.002)
    print(publisher.wait_for_all_acked(Duration(seconds=60.0)), flush=True)
    rclpy.shutdown()


def subscribe(count: int) -> None:
    """Print the numbers in the order of arrival once the last one is there."""
    import rclpy
    from rclpy.qos import QoSProfile
    from std_msgs.msg import UInt64

    rclpy.init()
    node = rclpy.create_node("listener")
    numbers: list[int] = []
    node.create_subscription(
        UInt64,
        "numbers",
        lambda message: numbers.append(message.data),
        QoSProfile(depth=count),
    )
    while not numbers or numbers[-1] != count - 1:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(numbers), flush=True)
    rclpy.shutdown()


def hold() -> None:
    """Own a link until killed."""
    from dextar_control.experiments.faults.netns import FaultyLink

    with FaultyLink() as link:
        print(json.dumps(link.helper_pids()), flush=True)
        time.sleep(1000)


if __name__ == "__main__":
    ROLES = {
        "send": send,
        "receive": receive,
        "publish": publish,
        "subscribe": subscribe,
        "hold": hold,
    }
    ROLES[sys.argv[1]](
        *(int(text) if text.isdigit() else text for text in sys.argv[2:])
    )  # type: ignore[operator]
