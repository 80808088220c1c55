"""A bare echo node, the baseline of the round trip: it answers each raw state with one
fixed command.
"""

from __future__ import annotations

import sys

from sensor_msgs.msg import JointState

from dextar_control.contract.topics import JOINT_COMMANDS, JOINT_STATES
from dextar_control.nodekit.layouts import template
from dextar_control.nodekit.node import RunnableNode, qos, run_node

# of a message whose first field is a header, behind CDR's own four bytes
STAMP = slice(4, 12)


class EchoNode(RunnableNode):
    """Publishes one command's bytes for each state, with the stamp bytes of that
    state.
    """

    def __init__(self) -> None:
        super().__init__("controller")
        command = template(JOINT_COMMANDS).pack(0, (0.0, 0.0))
        head, tail = command[: STAMP.start], command[STAMP.stop :]
        publisher = self.create_publisher(
            JointState, JOINT_COMMANDS.name, qos(JOINT_COMMANDS)
        )

        def answer(raw: bytes) -> None:
            publisher.publish(head + raw[STAMP] + tail)

        self.create_subscription(
            JointState,
            JOINT_STATES.name,
            answer,
            qos(JOINT_STATES, reliable=False),
            raw=True,
        )


if __name__ == "__main__":
    sys.exit(run_node(EchoNode))
