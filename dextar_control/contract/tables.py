"""Print the contract as the tables of the README: ``python -m
dextar_control.contract.tables``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from dextar_control.contract.resources import node_defaults
from dextar_control.contract.topics import PHASES, SERVICES, TOPICS, TimeOut, Topic


def _markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    header = list(header)
    lines = [header, ["---"] * len(header), *(list(row) for row in rows)]
    return [f"| {' | '.join(line)} |" for line in lines]


def quality(topic: Topic) -> str:
    """Return which QoS is offered, and what the control path asks for where that is
    less.
    """
    offered = "reliable" if topic.reliable else "best effort"
    asked = "" if topic.read_reliable else ", read best effort"
    return f"{'latched, ' if topic.latched else ''}{offered} {topic.depth}{asked}"


def rate(topic: Topic) -> str:
    """Return the nominal rate in words."""
    return topic.rate_text or (f"{topic.rate:g} Hz" if topic.rate else "on change")


def timeout(limit: TimeOut) -> str:
    """Return a time-out's default, its outcome and the parameter that holds it."""
    value = 1e3 * node_defaults(limit.node)[limit.parameter]
    return f"{value:g} ms: {limit.outcome} (`{limit.node}.{limit.parameter}`)"


def topic_rows() -> list[list[str]]:
    """Return the README's rows, in the order of ``TOPICS``."""
    return [
        [
            f"`{topic.name}`{' (optional)' if topic.optional else ''}",
            topic.type,
            f"{topic.publisher} → {topic.subscriber}",
            quality(topic),
            rate(topic),
            topic.unit + (f"; {', '.join(topic.joints)}" if topic.joints else ""),
            topic.stamp,
            "; ".join(timeout(limit) for limit in topic.timeouts) or "-",
        ]
        for topic in TOPICS
    ]


def topic_table() -> list[str]:
    """Return the table of topics as lines of markdown."""
    header = (
        "topic",
        "type",
        "from → to",
        "QoS",
        "rate",
        "unit; joints",
        "stamp",
        "time-out",
    )
    return _markdown(header, topic_rows())


def service_table() -> list[str]:
    """Return the table of services as lines of markdown."""
    return _markdown(
        ("service", "type", "what it does"),
        ([f"`{service.name}`", service.type, service.meaning] for service in SERVICES),
    )


def phase_line() -> str:
    """Return the phases with their numbers, in one line."""
    return ", ".join(f"{number} {name}" for number, name in enumerate(PHASES))


if __name__ == "__main__":
    argparse.ArgumentParser(
        description="Print the contract as the tables of the README."
    ).parse_args()
    print("\n".join([*topic_table(), "", *service_table(), "", phase_line()]))
