"""The pages in a real browser: they draw, they zoom, no word is cut or lies on another;
they complain of and ask for nothing.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import WIDTHS, Page, is_legible
from synthetic_run import write_run

from dextar_control.analysis import compute_metrics, load_run
from dextar_control.analysis.compare import compare_bags, write_comparison
from dextar_control.analysis.page import render_report
from dextar_control.analysis.report import analyze
from dextar_control.cli.pdf import find_browser, write_pdf

CHROMIUM = find_browser()
pytestmark = pytest.mark.skipif(
    CHROMIUM is None,
    reason="no Chromium here: apt install chromium to look at the pages",
)

CURVES = (
    "[...document.querySelectorAll('figure svg[role=img]')].map((svg) =>"
    " svg.querySelectorAll('path, line').length)"
)


def opened(file: Path) -> Page:
    assert CHROMIUM is not None
    return Page(CHROMIUM, file.as_uri())


def is_drawn(page: Page) -> None:
    """Each figure has axes, and at least one of its curves or marks."""
    counts = page.evaluate(CURVES)
    assert counts and min(counts) > 5, counts


@pytest.fixture(scope="module")
def report(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    analyze(demo / "run.mcap", folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def page(report: Path) -> Iterator[Page]:
    """One browser for the tests that only look."""
    with opened(report) as found:
        yield found


def test_the_report_draws_every_figure_without_a_word_on_the_console(
    page: Page,
) -> None:
    assert len(page.evaluate(CURVES)) in (
        11,
        12,
    )  # plane, four panels, observer, its innovation, two histograms, phases
    is_drawn(page)
    assert page.errors == []
    assert page.requests and all(
        address.startswith(("file:", "data:", "blob:")) for address in page.requests
    )


@pytest.mark.parametrize("width", WIDTHS)
def test_no_word_of_the_report_is_cut_or_lies_on_another(
    page: Page, width: int
) -> None:
    page.evaluate(
        "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
    )
    is_legible(page, width)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_has_the_readers_background(page: Page, scheme: str) -> None:
    page.prefers(scheme)
    light = (
        page.evaluate("getComputedStyle(document.body).backgroundColor")
        == "rgb(255, 255, 255)"
    )
    assert light == (scheme == "light")
    assert (
        page.evaluate(
            "new Set([...document.querySelectorAll('.curve')].map((one) =>"
            " getComputedStyle(one).stroke)).size"
        )
        > 2
    )


def test_its_panels_zoom_together_and_back(page: Page) -> None:
    page.resize(1280)
    ranges = (
        "drawings.filter((one) => one.figure.group === 'time').map((one) => one.x.low)"
    )
    box = json.loads(
        page.evaluate("JSON.stringify(drawings[1].svg.getBoundingClientRect())")
    )
    middle = box["top"] + 0.5 * box["height"]
    page.drag((box["left"] + 200.0, middle), (box["left"] + 300.0, middle))
    page.wait(f"({ranges})[0] > 0.1")
    zoomed = page.evaluate(ranges)
    assert len(set(zoomed)) == 1 < len(zoomed) and zoomed[0] > 0.1
    page.evaluate("document.querySelector('button.all:not([hidden])').click()")
    assert set(page.evaluate(ranges)) == {0.0}
    assert page.errors == []


def test_pointing_at_a_curve_tells_its_value_and_a_key_hides_it(page: Page) -> None:
    page.evaluate("drawings[2].tell(200, 60)")
    assert (
        page.evaluate("drawings[2].said.innerText").count("\n") == 2
    )  # the time, estimated, true
    page.evaluate("drawings[2].root.querySelector('button.key').click()")
    page.evaluate("drawings[2].tell(200, 60)")
    assert page.evaluate("drawings[2].said.innerText").count("\n") == 1
    page.evaluate("drawings[2].root.querySelector('button.key').click()")


@pytest.mark.parametrize(
    "options",
    [{"truth": False}, {"phase": 2}, {"bounce": True, "says": (2, 1)}, {"says": None}],
)
def test_reports_of_runs_that_lack_something_draw_too(
    tmp_path: Path, options: dict[str, object]
) -> None:
    write_run(tmp_path / "run.mcap", **options)  # type: ignore[arg-type]
    analyze(tmp_path / "run.mcap")
    with opened(tmp_path / "report.html") as page:
        is_drawn(page)
        is_legible(page, 420)
        assert page.errors == []


def test_many_crossings_and_what_is_no_number_draw_too(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", bounce=True)
    run = load_run(tmp_path / "run.mcap")
    run.criterion.s[200:] = run.commands.effort[300:400] = np.nan
    metrics = compute_metrics(run)
    many = dataclasses.replace(metrics, crossings=metrics.crossings * 12)
    (tmp_path / "report.html").write_text(render_report(run, many), encoding="utf-8")
    with opened(tmp_path / "report.html") as page:
        is_drawn(page)
        for width in (420, 1280):
            is_legible(page, width)
        assert page.errors == []


def test_the_comparison_draws_too(demo: Path, tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    write_comparison(compare_bags([demo / "run.mcap", tmp_path / "rig.mcap"]), tmp_path)
    with opened(tmp_path / "comparison.html") as page:
        assert len(page.evaluate(CURVES)) == 6
        is_drawn(page)
        for width in WIDTHS:
            is_legible(page, width)
        assert page.errors == []


def test_a_page_is_printed_beside_itself(report: Path) -> None:
    content = write_pdf(report).read_bytes()
    assert content.startswith(b"%PDF") and content.count(b"/Type /Page\n") > 2
    assert len(content) > 100_000  # with its figures


def test_this_test_sees_errors_requests_and_words_that_collide(tmp_path: Path) -> None:
    file = tmp_path / "bad.html"
    lines = "".join(f"<p>{number}</p>" for number in range(30))
    file.write_text(
        "<script>console.error('words'); nothing.at.all</script><img"
        " src='http://127.0.0.1:9/none.png'><p style='margin-bottom: -1.6em'>over the"
        f" next</p>{lines}<svg><text x='-30' y='10'>cut at the left</text></svg>"
    )
    with opened(file) as page:
        page.evaluate("new Promise((done) => setTimeout(done, 200))")
        assert any("words" in error for error in page.errors)
        assert any("nothing is not defined" in error for error in page.errors)
        assert any(address.startswith("http:") for address in page.requests)
        with pytest.raises(AssertionError, match="over the next"):
            is_legible(page, 420)
        page.evaluate("document.querySelector('p').remove()")
        with pytest.raises(AssertionError, match="cut at the left"):
            is_legible(page, 420)
