"""What users typed is printed as they typed it, and what is under way is told in lines
where there is no terminal.
"""

from __future__ import annotations

import ast
import contextlib
import io
import math
import os
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.progress import BarColumn
from rich.table import Table
from synthetic_run import write_run

from dextar_control.analysis import report
from dextar_control.analysis.compare import Comparison, summary_table
from dextar_control.cli import main as cli
from dextar_control.contract import terminal
from dextar_control.contract.terminal import Steps, Terminal, TextColumn, plain
from dextar_control.experiments import demo

NASTY = "runs [friday] [/y] [bold]x[/bold] :smile: [link=a]b %s {0} \\[c]"
PACKAGE = Path(__file__).resolve().parents[2] / "dextar_control"


def shown(what: Any, **options: Any) -> str:
    file = io.StringIO()
    Terminal(file=file, **options).print(what, soft_wrap=isinstance(what, str))
    return file.getvalue()


def table(name: str) -> Table:
    grid = Table(name, title=name, caption=name)
    grid.add_row(name)
    return grid


def test_a_text_is_no_markup() -> None:
    assert shown(NASTY) == f"{NASTY}\n"
    assert shown(table(NASTY)).count(NASTY) == 4


@pytest.mark.parametrize("interactive", [True, False])
def test_a_terminal_is_not_commanded_by_what_a_name_holds(interactive: bool) -> None:
    name = "a\x1b[31mb\x1b]0;title\x07\rc\x7f\x9b2Jd"
    for what in (name, table(name)):
        text = shown(what, force_terminal=interactive, color_system=None, width=200)
        text = (
            text.replace("\x1b[1m", "").replace("\x1b[3m", "").replace("\x1b[0m", "")
        )  # rich's own bold and italic
        assert not set(text) & set(
            map(chr, [*range(10), *range(11, 32), *range(0x7F, 0xA0)])
        ), repr(text)
        assert "a␛[31mb␛]0;title" in text
    assert plain(f"{name}\n{name}").count("␛") == 4 and "\n" not in plain(
        f"{name}\n{name}"
    )


def test_no_name_is_cut_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    name = f"/{'x' * 300}/topic"
    assert name in shown(table(name))
    assert shown(f"{name} {name}") == f"{name} {name}\n"


def test_the_runs_of_a_comparison_may_have_any_name() -> None:
    comparison = Comparison(["a [/b]", "[red]c"], [], [], [], [], [], [], [])
    text = shown(summary_table(comparison, 100))
    assert "1: a [/b]" in text and "2: [red]c" in text


def progress(
    file: io.StringIO, interactive: bool = False, transient: bool = False
) -> Steps:
    console = Terminal(
        file=file, force_terminal=interactive, color_system=None, width=100
    )
    return Steps(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        console=console,
        transient=transient,
    )


def test_progress_is_a_line_now_and_then_and_one_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    file = io.StringIO()
    with progress(file) as steps:
        task = steps.add_task(NASTY, total=100)
        for _ in range(100):
            now += 0.25
            steps.advance(task)
    assert file.getvalue().splitlines() == [
        f"{NASTY}  {count}/100" for count in (40, 80, 100)
    ]


def test_progress_that_leaves_nothing_says_nothing_in_a_short_time() -> None:
    file = io.StringIO()
    with progress(file, transient=True) as steps:
        steps.update(steps.add_task("reading", total=1), completed=1)
    assert not file.getvalue()


def test_progress_on_a_terminal_shows_a_bar_and_no_markup() -> None:
    file = io.StringIO()
    with progress(file, interactive=True) as steps:
        steps.advance(steps.add_task("a [/b] \x1b[31m", total=1))
    assert "a [/b] ␛[31m" in file.getvalue() and "━" in file.getvalue()


def test_what_is_done_now_is_told_again_when_it_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    file = io.StringIO()
    with Terminal(file=file).working("starting") as working:
        for tick in range(400):
            now = 0.1 * tick
            working.now("starting" if tick < 250 else "planning [/x]")
    assert file.getvalue().splitlines() == ["starting", "planning [/x]"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag in a folder whose name is markup, holds an escape and is not UTF-8."""
    folder = tmp_path_factory.mktemp("bags") / os.fsdecode(
        b"[friday] [bold] \x1b[31m caf\xe9"
    )
    folder.mkdir()
    write_run(folder / "run [x].mcap")
    return folder / "run [x].mcap"


COMMANDS = (
    ["analyze"],
    ["compare", "BAG"],
    ["export", "--format", "csv", "--format", "parquet"],
    ["recover"],
)


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_a_bag_may_lie_in_a_folder_of_any_name(
    bag: Path, tmp_path: Path, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands print to pipes of their own; the whole name stands there, the escape
    as its picture.
    """
    output, errors = (
        io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2)
    )
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setattr(sys, "stderr", errors)
    # A busy machine tells of no progress meanwhile.
    monkeypatch.setattr(terminal, "LINE_PERIOD", math.inf)
    into = bag.parent / "out"
    if words == ["recover"]:
        cut = bag.parent / "cut.mcap"
        cut.write_bytes(bag.read_bytes()[:-3000])
        given = [str(cut)]
    else:
        given = [
            str(bag),
            *(str(bag) for word in words if word == "BAG"),
            "--output",
            str(into),
        ]
    assert (
        cli.main([words[0], *given, *(word for word in words[1:] if word != "BAG")])
        == 0
    )
    for stream in (output, errors):
        stream.flush()
    said = output.buffer.getvalue().decode()
    assert "[friday] [bold] ␛[31m caf?" in said and "\x1b" not in said
    assert not errors.buffer.getvalue()


def test_nothing_prints_past_the_one_way() -> None:
    """Consoles, progress displays and status lines of rich take markup; those of
    ``terminal`` do not.
    """
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = (
                {alias.name for alias in node.names}
                if isinstance(node, ast.ImportFrom)
                else set()
            )
            module = getattr(node, "module", "") or ""
            if module.startswith("rich") and path.name != "terminal.py":
                assert not names & {
                    "Console",
                    "Progress",
                    "TextColumn",
                    "track",
                    "print",
                    "Status",
                }, f"{path}: {names}"


def test_an_output_that_takes_nothing_is_told_in_one_line(
    bag: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with contextlib.suppress(OSError), open("/dev/full", "w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert (
            cli.main(
                [
                    "export",
                    str(bag),
                    "--format",
                    "csv",
                    "--output",
                    str(bag.parent / "full"),
                ]
            )
            == 2
        )
    said = capsys.readouterr().err
    assert "No space left on device" in said and said.count("\n") == 1


def test_a_reader_that_has_enough_does_not_make_a_run_a_failure() -> None:
    class Left(io.StringIO):
        def write(self, _: str) -> int:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        Terminal(file=Left()).print("x")


def test_the_demo_tells_what_the_analysis_warns_of_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def analyze(_: Path, judged: object) -> SimpleNamespace:
        for _ in range(2):
            warnings.warn("the bag breaks off", stacklevel=1)
        return SimpleNamespace(success=True)

    for name in ("_wait_until_ready", "_follow"):
        monkeypatch.setattr(demo, name, lambda *_: None)
    monkeypatch.setattr(
        demo,
        "monitoring",
        lambda _: contextlib.nullcontext(
            SimpleNamespace(call=lambda *_, **__: SimpleNamespace(success=True))
        ),
    )
    monkeypatch.setattr(demo.Processes, "start", lambda *_: None)
    monkeypatch.setattr(report, "analyze", analyze)
    assert cli.main(["demo", "--output", str(tmp_path)]) == 0
    assert capsys.readouterr().err == "dextar demo: the bag breaks off\n"
