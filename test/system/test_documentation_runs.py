"""The commands and the Python of README and documentation do what they say, and the site
that is built of them opens offline.
"""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from browser import SIDEWAYS, Page
from documents import DOCS, PAGES, ROOT, code, shell
from test_faulty_link import REFUSAL

from dextar_control.cli import main as cli
from dextar_control.cli.pdf import find_browser
from dextar_control.contract.former_names import former_names
from dextar_control.contract.topics import SERVICES, TOPICS
from dextar_control.control.supervisor import WATCHES
from dextar_control.experiments.start_check import KINDS

CHROMIUM = find_browser()
CHEAP = "analyze", "compare", "export", "recover"
PYTHON = [pytest.param(page, id=page.stem) for page in PAGES if code(page, "python")]
BUILDS = all(
    map(importlib.util.find_spec, ("sphinx", "myst_parser", "furo", "ziamath"))
)


@pytest.fixture
def folder(good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder as a reader's, with three runs and the shipped files; one works in it."""
    for name in ("runs/latest", "A", "B", "C"):
        (tmp_path / name).mkdir(parents=True)
        shutil.copy(good, tmp_path / name / "run.mcap")
    (tmp_path / "config").symlink_to(ROOT / "config")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def cheap(line: str) -> list[str]:
    """The arguments of a ``dextar`` that takes no robot and little time; else none."""
    words = shlex.split(line, comments=True)
    called = words[:1] in (["dextar"], [".venv/bin/dextar"])
    slow = {"--pdf", "--window", "$BAG"} & set(words)
    return (
        words[1:]
        if called and len(words) > 1 and words[1] in CHEAP and not slow
        else []
    )


TYPED = sorted({" ".join(cheap(line)) for page in PAGES for line in shell(page)} - {""})
TYPED = [
    one for one in TYPED if not any(other.startswith(f"{one} ") for other in TYPED)
]


@pytest.mark.parametrize("typed", TYPED)
def test_the_commands_on_a_bag_do_what_they_say(typed: str, folder: Path) -> None:
    if "parquet" in typed:
        pytest.importorskip("pyarrow")
    before = set(folder.rglob("*"))
    assert cli.main(typed.split()) in (0, 1)  # 1 of a run that is judged a failure
    assert set(folder.rglob("*")) - before


@pytest.mark.parametrize("page", PYTHON)
def test_the_python_of_a_page_runs_from_top_to_bottom(
    page: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names: dict[str, object] = {"__name__": page.stem}
    for number, block in enumerate(code(page, "python")):
        if "FaultyLink" in block and REFUSAL:
            pytest.skip(REFUSAL)
        exec(compile(block, f"{page.name}, block {number}", "exec"), names)
    if page.name == "README.md":
        said = re.search(
            r"HOLD, largest true error ([0-9.]+) mm", capsys.readouterr().out
        )
        assert said and float(said[1]) < 0.3


class Asked(HTMLParser):
    """What a page asks for when it is opened, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in ("script", "img", "iframe", "source", "video", "object"):
            self.addresses.append(given.get("src") or given.get("data") or "")
        elif tag == "link":
            self.addresses.append(given.get("href") or "")

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation as ``make docs`` builds it; warnings are errors."""
    if not BUILDS:
        pytest.skip("the extra docs is not installed: make setup EXTRAS=docs")
    folder = tmp_path_factory.mktemp("site")
    options = ["-q", "-W", "--keep-going", "-b", "html"]
    command = [sys.executable, "-m", "sphinx", *options, str(DOCS), str(folder)]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return folder


def read(page: Path) -> Asked:
    reader = Asked()
    reader.feed(page.read_text(encoding="utf-8"))
    return reader


def test_the_site_asks_nobody_for_anything(site: Path) -> None:
    outside = re.compile(r"(?:[a-z]+:)?//")
    for page in site.glob("*.html"):
        asked = [one for one in read(page).addresses if outside.match(one)]
        assert not asked, page.name
        assert all(
            (site / one.split("?")[0]).exists()
            for one in read(page).addresses
            if one.strip("#")
        ), page.name
    for sheet in site.rglob("*.css"):
        named = re.findall(
            r"(?:url\(|@import)\s*[\"']?(?!data:)([^\"')]+)", sheet.read_text()
        )
        assert not [one for one in named if outside.match(one)], sheet.name


def test_the_site_has_a_page_for_each_document_and_finds_words(site: Path) -> None:
    assert {page.stem for page in DOCS.glob("*.md")} <= {
        page.stem for page in site.glob("*.html")
    }
    assert "troubleshooting" in (site / "searchindex.js").read_text(encoding="utf-8")


def test_the_site_has_the_contracts_tables(site: Path) -> None:
    nodes, parameters, safety = (
        set("".join(f" {word} " for word in read(site / f"{name}.html").words).split())
        for name in ("nodes", "parameters", "safety")
    )
    assert {one.name for one in (*TOPICS, *SERVICES)} <= nodes
    assert {
        spec.name for kind in KINDS.values() for spec in kind.PARAMETERS
    } <= parameters
    assert {
        name for kind in KINDS.values() for name in former_names(kind.PARAMETERS)
    } <= parameters
    assert "module:attribute" in parameters and "braces," not in safety
    assert {watch.name for watch in WATCHES} <= safety


@pytest.mark.skipif(CHROMIUM is None, reason="there is neither Chromium nor Chrome")
def test_the_site_opens_from_a_disk_and_fits_every_screen(site: Path) -> None:
    assert CHROMIUM is not None
    with Page(CHROMIUM, (site / "index.html").as_uri()) as page:
        for width in (420, 1280):
            page.resize(width)
            for file in sorted(site.glob("*.html")):
                page.open(file.as_uri())
                assert not page.evaluate(SIDEWAYS), (file.name, width)
        page.open((site / "search.html").as_uri() + "?q=bounced")
        page.wait("document.querySelectorAll('#search-results li').length > 0")
        assert not page.errors
        assert all(one.startswith(("file:", "data:")) for one in page.requests)
