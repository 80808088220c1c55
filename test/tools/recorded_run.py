"""Bags made by changing another's messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)


Change = Callable[[str, Any], Iterable[tuple[str, Any]]]


def rewrite(
    source: Path | list[Path], target: Path, change: Change, keep_metadata: bool = True
) -> Path:
    """A bag of other bags' messages: ``change`` gives the (topic, message) to write for
    each one read.
    """
    with target.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for file in [source] if isinstance(source, Path) else source:
            with file.open("rb") as old:
                reader = make_reader(old)
                schemas = {
                    schema.name: schema
                    for schema in reader.get_summary().schemas.values()
                }
                for schema, channel, message in reader.iter_messages(
                    log_time_order=False
                ):
                    decoded = TYPES.deserialize_cdr(message.data, schema.name)
                    for topic, other in change(channel.topic, decoded):
                        kind = other.__msgtype__
                        if topic not in channels:
                            known = schemas.get(kind, schema)
                            number = writer.register_schema(kind, "ros2msg", known.data)
                            channels[topic] = writer.register_channel(
                                topic, "cdr", number
                            )
                        data = bytes(TYPES.serialize_cdr(other, kind))
                        writer.add_message(
                            channels[topic],
                            message.log_time,
                            data,
                            message.publish_time,
                        )
                if keep_metadata:
                    for record in reader.iter_metadata():
                        writer.add_metadata(record.name, record.metadata)
        writer.finish()
    return target
