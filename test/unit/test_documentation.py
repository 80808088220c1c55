"""What README and documentation say is what the package has: links, commands, messages."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_lines import check
from documents import DOCS, PAGES, ROOT, anchors, links, shell, spans

from dextar_control.cli import main as cli
from dextar_control.contract.topics import PHASES
from dextar_control.control.supervisor import WATCHES

NAMED = [pytest.param(page, id=page.stem) for page in PAGES]


@pytest.mark.parametrize("page", NAMED)
def test_every_link_leads_somewhere(page: Path) -> None:
    for link in links(page):
        if link.startswith(("https://", "http://")):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", NAMED)
def test_every_command_exists_as_it_is_written(page: Path) -> None:
    for line in shell(page):
        check(line)
    for span in spans(page):
        if (
            re.match(
                r"(make|dextar|\.venv/bin/dextar|(\.venv/bin/)?python|ros2) ", span
            )
            and "NAME" not in span
        ):
            check(span, whole=False)


@pytest.mark.parametrize("page", NAMED)
def test_a_page_with_tables_that_are_built_says_so_where_it_is_not_built(
    page: Path,
) -> None:
    text = page.read_text(encoding="utf-8")
    told = re.search(r"^% .*`make docs`", text, re.MULTILINE)  # a comment of MyST
    assert bool(told) == bool(re.search(r"\{\{ \w+ \}\}", text))


OF_ROS2_CONTROL = {
    "joint_states_topic",
    "joint_commands_topic",
    "trigger_joint_command_threshold",
}


def words_of_the_code() -> set[str]:
    """Every name in the package, its settings and its tests."""
    places = (
        "dextar_control",
        "dextar_sim",
        "config",
        "launch",
        "interfaces",
        "test",
        "examples",
    )
    files = [
        file for place in places for file in (ROOT / place).rglob("*") if file.is_file()
    ]
    kinds = {".py", ".yaml", ".msg", ".action", ".html", ".js"}
    texts = (file.read_text(encoding="utf-8") for file in files if file.suffix in kinds)
    return {word for text in texts for word in re.findall(r"\w+", text)}


def test_names_and_files_of_the_code_are_what_they_are_called() -> None:
    known, unknown = words_of_the_code() | OF_ROS2_CONTROL, []
    for page in PAGES:
        for span in spans(page):
            if re.fullmatch(r"[a-z]+(?:_[a-z0-9]+)+", span) and span not in known:
                unknown.append(f"{page.name}: {span}")
            if re.fullmatch(r"\w+/[\w/]+\.(?:py|yaml|xml|json)", span):
                rooms = ROOT, ROOT / "dextar_control"
                if not any((room / span).exists() for room in rooms):
                    unknown.append(f"{page.name}: {span}")
    assert not unknown


# Where a user meets refusals, and what says one beside the errors that are raised.
MET = "control", "planning", "nodes", "nodekit/client.py", "experiments/demo.py"
CALLED = "fault", "spoil", "refuse"
SAYS_SOMETHING = 9  # characters


def refusals() -> Iterator[tuple[str, str]]:
    """Where one is raised, and the longest of its words that no number interrupts."""
    for place in MET:
        room = ROOT / "dextar_control" / place
        for file in [room] if room.suffix else sorted(room.glob("*.py")):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if not isinstance(node, ast.Call) or not node.args:
                    continue
                name = getattr(node.func, "id", getattr(node.func, "attr", ""))
                text = node.args[0]
                if not (name.endswith("Error") or name in CALLED):
                    continue
                parts = text.values if isinstance(text, ast.JoinedStr) else [text]
                said = [part.value for part in parts if isinstance(part, ast.Constant)]
                longest = max((str(one).strip() for one in said), key=len, default="")
                if len(longest) >= SAYS_SOMETHING:
                    yield f"{file.relative_to(ROOT)}:{node.lineno}", longest


def test_troubleshooting_has_every_phase_watch_and_refusal() -> None:
    told = spans(DOCS / "troubleshooting.md")
    assert {*PHASES, *(watch.name for watch in WATCHES)} <= set(told)
    missing = {
        where: words
        for where, words in refusals()
        if not any(words in one for one in told)
    }
    assert not missing, "docs/troubleshooting.md lacks these messages"


def test_the_readme_is_read_to_its_end() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.parametrize("page", NAMED)
def test_no_figure_is_missing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"@[A-Z]+@|TODO|TBD|@@|\(table of", text)


def test_ci_calls_the_readmes_own_commands() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "make test" in script
    assert "make demo" in script
    assert "pip install" not in script


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_helps(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.parser().parse_args([command, "--help"])
    assert not end.value.code
    assert f"usage: dextar {command}" in capsys.readouterr().out
