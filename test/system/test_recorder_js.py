"""The recorder's files in the JavaScript readers that Foxglove uses: every field of
every type, bit by bit.
"""

from __future__ import annotations

from pathlib import Path

import foxglove
import numpy as np
import pytest
from bag_messages import TYPES, difference, random_message

from dextar_control.bags.writer import BagWriter, SerializedMessage
from dextar_control.contract.topics import TOPICS
from dextar_control.nodes.recorded_topics import ALONGSIDE

EACH = 40  # messages of each topic


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_foxglove_reads_every_field_of_every_topic_that_is_recorded(
    tmp_path: Path, compression: str
) -> None:
    rng = np.random.default_rng(5)
    file = tmp_path / "run.mcap"
    writer = BagWriter(file, compression)
    sent: dict[tuple[str, int], tuple[int, str, object]] = {}
    for topic in (*TOPICS, *ALONGSIDE):
        name = topic.name if topic.name.startswith("/") else f"/{topic.name}"
        writer.add_topic(name, topic.type, [])
        for number in range(EACH):
            message = random_message(topic.type, rng)
            time = 1_795_544_112_476_479_520 + len(sent)
            writer.add(
                SerializedMessage(
                    time,
                    name,
                    time - 7,
                    number,
                    bytes(TYPES.serialize_cdr(message, topic.type)),
                )
            )
            sent[name, number] = time, topic.type, message
    writer.close()
    read = list(foxglove.read(file))
    assert len(read) == len(sent)
    for line in read:
        time, type_name, message = sent.pop((line["topic"], line["sequence"]))
        assert (line["type"], int(line["log"]), int(line["publish"])) == (
            type_name,
            time,
            time - 7,
        )
        assert difference(message, line["message"], line["topic"]) == ""
    assert sent == {}
