"""A bare echo node, the baseline of the round trip: raw state in, one fixed command out."""

from __future__ import annotations

import sys

from rclpy.node import Node
from sensor_msgs.msg import JointState

from dextar_control.contract.node import qos, run_node
from dextar_control.contract.topics import JOINT_COMMANDS, JOINT_STATES
from dextar_control.ros.messages import joint_commands_template


class EchoNode(Node):
    """Publishes its one command's bytes for each state, stamp and all unread."""

    def __init__(self) -> None:
        super().__init__("controller")
        self.exit_code, self.finished = 0, False
        command = joint_commands_template().pack(0, (0.0, 0.0))
        publisher = self.create_publisher(JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS))
        self.create_subscription(
            JointState, JOINT_STATES.name, lambda _: publisher.publish(command), qos(JOINT_STATES, reliable=False), raw=True
        )  # fmt: skip

    def close(self) -> None:
        """Nothing to leave."""


if __name__ == "__main__":
    sys.exit(run_node(EchoNode))
