"""The command ``dextar recover``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from dextar_control.cli.arguments import add_bag

SUMMARY = "rebuild a readable, indexed bag from one that is damaged or breaks off"
DESCRIPTION = (
    "Copies every intact message of a damaged or cut-off recording, or of a folder"
    " whose metadata.yaml is missing or wrong, into a new bag folder beside it"
    " (NAME-recovered), with index and metadata.yaml, so that ros2 bag, Foxglove and"
    " PlotJuggler open it. The original stays as it is. Exit code 0 when it was"
    " recovered, 2 when it is whole, was recovered before, or holds nothing."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own arguments."""
    add_bag(parser, "bag")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from datetime import datetime, timezone

    from rich.progress import BarColumn, TaskProgressColumn, TimeRemainingColumn
    from rich.table import Column, Table

    from dextar_control.bags.damage import hole_in_words
    from dextar_control.bags.recover import recover
    from dextar_control.contract.terminal import Steps, Terminal, TextColumn, title
    from dextar_control.contract.words import counted

    console = Terminal()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Steps(*columns, console=Terminal(stderr=True), transient=True) as bars:
        seen: set[Path] = set()

        def watch(file: Path) -> Callable[[int, int], None]:
            task = bars.add_task(
                f"{'copying' if file in seen else 'checking'} {file.name}"
            )
            seen.add(file)
            return lambda done, total: bars.update(task, completed=done, total=total)

        result = recover(arguments.bag, watch)
    table = Table(
        Column("topic", overflow="fold"),
        "messages",
        title=title(result.folder),
        title_justify="left",
    )
    for name, count in sorted(result.counts.items()):
        table.add_row(name, str(count))
    console.print(table)
    until = datetime.fromtimestamp(result.last / 1e9, timezone.utc).isoformat(
        timespec="milliseconds"
    )
    span = (result.last - result.first) / 1e9
    lines = [f"{sum(result.counts.values())} messages over {span:.3f} s, until {until}"]
    if result.metadata:
        lines.append(f"{result.metadata}; a new one was written")
    if result.lost_bytes:
        lines.append(f"{result.lost_bytes} bytes at the end are no complete record")
    lines += map(hole_in_words, result.holes)
    if result.unpacked:
        lines.append(
            f"{counted(result.unpacked, 'message')} that the recorder had compressed"
            " one by one are written plain"
        )
    for (name, why), count in result.left_out.items():
        lines.append(f"{counted(count, 'message')} of {name} left out: {why}")
    console.print("\n".join(lines), soft_wrap=True)
    return 0
