"""A long bag out of a short one: one tracked trajectory that repeats the recorded one,
from its start to its end.

    python test/studies/long_run.py runs/latest/run.mcap long.mcap 600

writes at least 600 s. For measuring what the analysis of a long recording takes.
"""

from __future__ import annotations

import argparse
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from statistics import median_low

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
STAMPED = {
    "/joint_states",
    "/joint_commands",
    "/controller_state",
    "/criterion",
    "/sim/end_effector",
    "/sim/joint_states",
}
SPACING = 0.02  # s between the points of the long trajectory, which has a most
SECOND = 10**9
TRACKING = (3.0, 4.0)  # the controller's phases TRACK and CROSSING
LONGEST = 86_400.0  # s


def stamp_of(data: bytes) -> int:
    """ns of a serialized message's header: after four bytes of encapsulation, seconds
    and nanoseconds.
    """
    seconds, rest = struct.unpack_from("<iI", data, 4)
    return seconds * SECOND + rest


def start_of(rows: Sequence[tuple[str, object]], kinds: dict[str, object]) -> int:
    """ns, the stamp at which the tracked trajectory began: what comes before, at rest,
    belongs to no copy.
    """
    decoded = {
        topic: [
            TYPES.deserialize_cdr(m.data, kinds[topic].name)
            for t, m in rows
            if t == topic
        ]
        for topic in ("/criterion", "/controller_state")
    }
    busy = {
        (m.header.stamp.sec, m.header.stamp.nanosec)
        for m in decoded["/criterion"]
        if m.position[list(m.name).index("phase")] in TRACKING
    }
    starts = [
        (m.header.stamp.sec - m.points[0].time_from_start.sec) * SECOND
        + m.header.stamp.nanosec
        - m.points[0].time_from_start.nanosec
        for m in decoded["/controller_state"]
        if (m.header.stamp.sec, m.header.stamp.nanosec) in busy
    ]
    if not starts:
        raise SystemExit(
            "the bag holds no tracked trajectory: no tick is in the phases TRACK or"
            " CROSSING"
        )
    return median_low(starts)


def stretched(trajectory: object, copies: int, period: int) -> bytes:
    """The trajectory, ``copies`` times one after the other, with fewer points."""
    points, last = [], -SECOND
    for copy in range(copies):
        for point in trajectory.points:
            time = (
                point.time_from_start.sec * SECOND
                + point.time_from_start.nanosec
                + copy * period
            )
            final = copy == copies - 1 and point is trajectory.points[-1]
            if time - last >= SPACING * SECOND or final:
                last = time
                begun = type(point.time_from_start)(
                    sec=time // SECOND, nanosec=time % SECOND
                )
                points.append(
                    type(point)(
                        transforms=point.transforms,
                        velocities=point.velocities,
                        accelerations=point.accelerations,
                        time_from_start=begun,
                    )
                )
    long = type(trajectory)(
        header=trajectory.header, joint_names=trajectory.joint_names, points=points
    )
    return bytes(TYPES.serialize_cdr(long, long.__msgtype__))


def main(source: Path, target: Path, duration: float) -> None:
    """Write the long bag; duration in s."""
    with source.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        rows = [
            (channel.topic, m)
            for _, channel, m in reader.iter_messages(log_time_order=False)
        ]
        records = list(reader.iter_metadata())
    kinds = {
        channel.topic: summary.schemas[channel.schema_id]
        for channel in summary.channels.values()
    }
    served = next(
        TYPES.deserialize_cdr(m.data, kinds[t].name)
        for t, m in rows
        if t == "/trajectory"
    )
    end = served.points[-1].time_from_start
    period = end.sec * SECOND + end.nanosec
    first = start_of(rows, kinds)
    copies = max(1, -int(-duration * SECOND // period))
    rows = [
        (topic, m)
        for topic, m in rows
        if topic in STAMPED and 0 <= stamp_of(m.data) - first < period
    ]
    span = (
        max(m.log_time for _, m in rows) - min(m.log_time for _, m in rows) + 1_000_000
    )
    with target.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="test")
        channels = {
            topic: writer.register_channel(
                topic, "cdr", writer.register_schema(kind.name, "ros2msg", kind.data)
            )
            for topic, kind in kinds.items()
        }
        first_row = rows[0][1]
        served_long = stretched(served, copies, period)
        writer.add_message(
            channels["/trajectory"],
            first_row.log_time,
            served_long,
            first_row.publish_time,
        )
        for copy in range(copies):
            for topic, message in rows:
                stamp = stamp_of(message.data) + copy * period
                data = bytearray(message.data)
                struct.pack_into("<iI", data, 4, stamp // SECOND, stamp % SECOND)
                if topic == "/controller_state":
                    state = TYPES.deserialize_cdr(bytes(data), kinds[topic].name)
                    for point in state.points:
                        begun = point.time_from_start
                        time = begun.sec * SECOND + begun.nanosec + copy * period
                        begun.__dict__.update(sec=time // SECOND, nanosec=time % SECOND)
                    data = TYPES.serialize_cdr(state, kinds[topic].name)
                later = copy * span
                writer.add_message(
                    channels[topic],
                    message.log_time + later,
                    bytes(data),
                    message.publish_time + later,
                )
        for record in records:
            writer.add_metadata(record.name, record.metadata)
        writer.finish()


def seconds(text: str) -> float:
    """A duration in s."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= LONGEST:
        raise argparse.ArgumentTypeError(
            f"duration = {text}; it must be above 0 and at most {LONGEST:g} s"
        )
    return value


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "source", type=Path, help="the .mcap file of one run with a tracked trajectory"
    )
    parser.add_argument("target", type=Path, help="the .mcap file to write")
    parser.add_argument("duration", type=seconds, help="s, at least")
    given = parser.parse_args()
    if not given.source.is_file():
        parser.error(f"{given.source} is no file")
    main(given.source, given.target, given.duration)
