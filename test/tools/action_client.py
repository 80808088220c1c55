"""Sends goals to the action ``go`` in namespace /left, one line of JSON on standard
input each, and prints what became of each.

A goal's own fields, and ``cancel_in``: a phase in which it is cancelled. The first is
sent once the controller holds. Afterwards it reads one message of each readable topic.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from dextar_interfaces.action import Go
from diagnostic_msgs.msg import DiagnosticArray
from patience import PATIENCE
from rclpy.action import ActionClient
from rclpy.node import Node

from dextar_control.contract.topics import (
    DIAGNOSTICS,
    READABLE_CRITERION,
    READABLE_STATE,
)
from dextar_control.nodekit.node import qos


def main() -> None:
    rclpy.init(args=[])
    node = Node("client", namespace="/left")
    client = ActionClient(node, Go, "go")

    def until(condition) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            rclpy.spin_once(node, timeout_sec=0.05)
            assert time.monotonic() < deadline, "it did not come"

    words: set[str] = set()
    node.create_subscription(
        DiagnosticArray,
        DIAGNOSTICS.name,
        lambda m: words.update(item.value for one in m.status for item in one.values),
        10,
    )
    until(lambda: client.server_is_ready() and "HOLD" in words)
    for line in sys.stdin:
        fields = json.loads(line)
        cancel_in = fields.pop("cancel_in", "")
        told: list[Go.Feedback] = []
        sent = client.send_goal_async(
            Go.Goal(**fields),
            feedback_callback=lambda m, told=told: told.append(m.feedback),
        )
        until(sent.done)
        goal = sent.result()
        ended = goal.get_result_async()
        if cancel_in:
            until(lambda told=told, phase=cancel_in: told and told[-1].phase == phase)
            goal.cancel_goal_async()
        until(ended.done)
        result, last = ended.result().result, told[-1] if told else Go.Feedback()
        print(
            json.dumps(
                {
                    "status": ended.result().status,
                    "done": result.done,
                    "verdicts": list(result.verdicts),
                    "confidences": list(result.confidences),
                    "largest_error": result.largest_error,
                    "bag": result.bag,
                    "message": result.message,
                    "phases": list(dict.fromkeys(feedback.phase for feedback in told)),
                    "last": [
                        last.phase,
                        last.crossing,
                        last.crossings,
                        last.s,
                        last.confidence,
                        last.progress,
                    ],
                }
            ),
            flush=True,
        )
    from dextar_interfaces.msg import ControllerState, Criterion

    for topic, kind in (
        (READABLE_STATE, ControllerState),
        (READABLE_CRITERION, Criterion),
    ):
        got: list = []
        node.create_subscription(
            kind, topic.name, got.append, qos(topic, reliable=False)
        )
        until(lambda got=got: got)
        values = {
            name: getattr(got[0], name) for name in kind.get_fields_and_field_types()
        }
        print(
            json.dumps(
                {
                    name: value.tolist() if hasattr(value, "tolist") else value
                    for name, value in values.items()
                    if not hasattr(value, "get_fields_and_field_types")
                }
            )
        )


if __name__ == "__main__":
    main()
