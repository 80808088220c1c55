"""Recovering cut-off bags: everything intact is there, in a bag that others open;
nothing is overwritten.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader
from synthetic_run import write_run
from test_mcap_writer import numbers_in, write_numbers

from dextar_control.analysis.load import load_run
from dextar_control.bags.recover import recover
from dextar_control.bags.writer import BagWriter
from dextar_control.cli import main as cli
from dextar_control.contract.errors import BagError


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("run") / "run.mcap"
    write_run(file)
    return file


def messages_of(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """By mcap's own indexed reader."""
    with path.open("rb") as stream:
        return sorted(
            (
                channel.topic,
                message.log_time,
                message.publish_time,
                message.sequence,
                message.data,
            )
            for _, channel, message in make_reader(stream).iter_messages()
        )


@pytest.mark.parametrize("share", [0.3, 0.9, 0.9999])
def test_a_recovered_bag_is_indexed_and_holds_every_intact_message_unchanged(
    bag: Path, tmp_path: Path, share: float
) -> None:
    cut = tmp_path / "run.mcap"
    content = bag.read_bytes()[: int(share * bag.stat().st_size)]
    cut.write_bytes(content)
    with pytest.warns(UserWarning, match="last complete chunk"):
        expected = load_run(cut)
    result = recover(cut)
    assert cut.read_bytes() == content
    assert result.folder == tmp_path / "run-recovered"
    recovered = messages_of(result.folder / "run.mcap")
    assert set(recovered) <= set(messages_of(bag))
    with pytest.warns(UserWarning, match="was recovered from a file that breaks off"):
        run = load_run(result.folder)
    assert run.truncated
    assert (
        len(run.states.stamps)
        == len(expected.states.stamps)
        == result.counts["/joint_states"]
    )
    assert run.robot == expected.robot
    with Reader(result.folder) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == result.counts
        assert reader.message_count == len(recovered) == len(list(reader.messages()))
        assert reader.end_time - 1 == result.last


def test_a_damaged_chunk_in_the_middle_costs_its_own_messages_only(
    tmp_path: Path,
) -> None:
    file = tmp_path / "run.mcap"
    writer = BagWriter(file, "none", max_size=0)
    write_numbers(writer, 3000, size=300)
    writer.close()
    content = bytearray(file.read_bytes())
    with file.open("rb") as stream:
        chunks = [
            record
            for record in StreamReader(stream, emit_chunks=True).records
            if isinstance(record, Chunk)
        ]
    assert len(chunks) >= 3
    place = content.index(chunks[1].data) + len(chunks[1].data) // 2
    content[place] ^= 0xFF
    file.write_bytes(content)
    result = recover(file)
    assert [hole.chunks for hole in result.holes] == [1]
    lost = sum(
        1
        for number in range(3000)
        if chunks[1].message_start_time
        <= 10**18 + number * 10**6
        <= chunks[1].message_end_time
    )
    kept = numbers_in(result.folder)
    assert len(kept) == 3000 - lost
    assert sorted(set(kept)) == kept


def test_a_file_that_ends_in_zeros_is_recovered_up_to_them(
    bag: Path, tmp_path: Path
) -> None:
    """What a power cut leaves on some file systems: the length is there, the content is
    not.
    """
    cut = tmp_path / "run.mcap"
    size = int(0.8 * bag.stat().st_size)
    cut.write_bytes(bag.read_bytes()[:size] + bytes(100_000))
    result = recover(cut)
    other = tmp_path / "other" / "run.mcap"
    other.parent.mkdir()
    other.write_bytes(bag.read_bytes()[:size])
    assert result.counts == recover(other).counts


def test_a_split_bag_is_recovered_as_one_bag(tmp_path: Path) -> None:
    folder = tmp_path / "monday"
    writer = BagWriter(folder / "run.mcap", "none", max_size=100_000, folder=True)
    write_numbers(writer, 1000, size=300)
    writer.close()
    (folder / "metadata.yaml").unlink()  # a killed recorder writes none
    last = writer.paths[-1]
    last.write_bytes(last.read_bytes()[:-40])
    result = recover(folder)
    assert result.folder == tmp_path / "monday-recovered"
    assert numbers_in(result.folder) == list(range(1000))
    info = yaml.safe_load((result.folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert info["relative_file_paths"] == [path.name for path in writer.paths]


def test_a_folder_that_only_misses_its_metadata_gets_a_copy_with_it(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "monday"
    writer = BagWriter(folder / "run.mcap")
    write_numbers(writer, 10)
    writer.close()
    result = recover(folder)
    assert numbers_in(result.folder) == list(range(10))
    assert (result.lost_bytes, result.holes) == (0, [])


BAD_LISTINGS = {
    "torn": (
        lambda text: text[: len(text) // 2] + "\n  ]",
        "metadata.yaml is none of rosbag2",
    ),
    "foreign": (lambda text: "[1, 2]", "metadata.yaml is none of rosbag2"),
    "lists a file that is not there": (
        lambda text: text.replace("- run_1.mcap", "- run_1.mcap\n  - run_99.mcap"),
        "lists run_99.mcap, which is not there",
    ),
    "misses one": (
        lambda text: text.replace("  - run_1.mcap\n", ""),
        "does not list run_1.mcap",
    ),
    "lists none": (
        lambda text: "rosbag2_bagfile_information: {relative_file_paths: []}",
        "metadata.yaml lists no file",
    ),
    "counts wrongly": (
        lambda text: text.replace("message_count: 1000", "message_count: 999"),
        "that the bag has 999 messages; there are 1000",
    ),
}


@pytest.mark.parametrize("kind", BAD_LISTINGS)
def test_a_wrong_metadata_file_is_rebuilt(kind: str, tmp_path: Path) -> None:
    change, fault = BAD_LISTINGS[kind]
    folder = tmp_path / "monday"
    writer = BagWriter(folder / "run.mcap", "none", max_size=100_000, folder=True)
    write_numbers(writer, 1000, size=300)
    writer.close()
    with pytest.raises(BagError, match="is whole: there is nothing to recover"):
        recover(folder)
    listing = folder / "metadata.yaml"
    listing.write_text(changed := change(listing.read_text()))
    result = recover(folder)
    assert fault in result.metadata
    assert listing.read_text() == changed
    info = yaml.safe_load((result.folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert (info["message_count"], info["relative_file_paths"]) == (
        1000,
        [path.name for path in writer.paths],
    )
    assert numbers_in(result.folder) == list(range(1000))


def test_what_is_beside_a_listed_bag_is_not_taken_for_a_part_of_it(
    bag: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "monday"
    writer = BagWriter(folder / "run.mcap", folder=True)
    write_numbers(writer, 10)
    writer.close()
    (folder / "noise.mcap").write_bytes(bag.read_bytes())
    with pytest.raises(BagError, match="is whole: there is nothing to recover"):
        recover(folder)


def test_different_bags_in_one_folder_are_not_made_one(
    bag: Path, tmp_path: Path
) -> None:
    for name in ("monday", "tuesday"):
        (tmp_path / f"{name}.mcap").write_bytes(bag.read_bytes())
    with pytest.raises(
        BagError, match=r"holds 2 files of different bags; name one of them"
    ):
        recover(tmp_path)
    assert not tmp_path.with_name(f"{tmp_path.name}-recovered").exists()


def test_a_message_of_a_channel_that_nobody_described_is_one_sentence(
    tmp_path: Path,
) -> None:
    file = tmp_path / "run.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        writer.add_message(7, 0, b"\0\1\0\0", 0)
        writer.finish()
    file.write_bytes(file.read_bytes()[:-20])
    for read in (recover, load_run):
        with pytest.raises(BagError, match="of channel 7, which"):
            read(file)


def test_what_need_not_or_cannot_be_recovered_is_refused_in_one_sentence(
    bag: Path, tmp_path: Path
) -> None:
    with pytest.raises(
        BagError, match=r"run.mcap is whole: there is nothing to recover"
    ):
        recover(bag)
    assert not (bag.parent / "run-recovered").exists()
    cut = tmp_path / "run.mcap"
    cut.write_bytes(bag.read_bytes()[:-40])
    recover(cut)
    with pytest.raises(
        BagError, match=r"was recovered before: .*run-recovered is there"
    ):
        recover(cut)
    for name, content, words in (
        ("empty", b"", "is empty"),
        ("foreign", b"PK\x03\x04 something else", "is not an MCAP file"),
        ("headless", b"\x89MCAP0\r\n", "no complete message: nothing can be recovered"),
        (
            "early",
            bag.read_bytes()[:2000],
            "no complete message: nothing can be recovered",
        ),
    ):
        file = tmp_path / f"{name}.mcap"
        file.write_bytes(content)
        with pytest.raises(BagError, match=words):
            recover(file)
        assert not (tmp_path / f"{name}-recovered").exists()
    (tmp_path / "void").mkdir()
    for path, words in (
        (tmp_path / "none.mcap", "No such file"),
        (tmp_path / "void", "holds no .mcap or .db3 file"),
    ):
        with pytest.raises(BagError, match=words):
            recover(path)
    assert not list(tmp_path.glob(".*"))


def test_the_command_says_how_much_of_what_and_until_when(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "run.mcap"
    cut.write_bytes(bag.read_bytes()[:-40])
    assert cli.main(["recover", str(cut)]) == 0
    printed = capsys.readouterr().out
    assert "/joint_states" in printed
    assert "1001" in printed
    assert "until 2023-11-14T22:13:20.006+00:00" in printed  # START and 6006 us
    assert cli.main(["recover", str(cut)]) == 2
    refused = capsys.readouterr().err
    assert refused.startswith("dextar recover: ")
    assert len(refused.splitlines()) == 1
