"""The pages in a real browser: they draw, they zoom, they complain of nothing and ask for nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import Page
from recorded_run import lockstep_bag
from synthetic_run import write_run

from dextar_control.analysis.compare import compare_bags, write_comparison
from dextar_control.analysis.report import analyze
from dextar_control.commands.pdf import find_browser, write_pdf

CHROMIUM = find_browser()
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt install chromium to look at the pages")

IDLE = "window.Bokeh !== undefined && Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle"
INK = """(() => {
  const found = [];
  const look = (node) => {
    let ink = 0, size = 0;
    for (const inner of node.querySelectorAll("*")) {
      if (inner.tagName === "CANVAS" && inner.width > 0 && inner.height > 0) {
        const copy = document.createElement("canvas");
        copy.width = inner.width;
        copy.height = inner.height;
        const context = copy.getContext("2d", {willReadFrequently: true});
        context.drawImage(inner, 0, 0);
        const data = context.getImageData(0, 0, copy.width, copy.height).data;
        for (let k = 0; k < data.length; k += 4) if (data[k + 3] > 128 && data[k] < 128) ink += 1;
        size += 1;
      }
      if (inner.shadowRoot) look(inner.shadowRoot);
    }
    if (size > 0 && node.host && node.host.classList.contains("bk-Canvas")) found.push(ink);
  };
  look(document);
  return found;
})()"""  # dark pixels of each figure
LEAST_INK = 200  # dark pixels: axes and numbers alone have about 500, an empty canvas none
FIGURES = "Bokeh.documents[0].roots().filter((one) => one.type === 'Figure')"


def opened(file: Path) -> Page:
    assert CHROMIUM is not None
    page = Page(CHROMIUM, file.as_uri())
    page.wait(IDLE)
    return page


def drawn(page: Page) -> None:
    """Wait until each figure has something on its canvas."""
    count = page.evaluate(f"{FIGURES}.length")
    page.wait(f"(() => {{ const ink = {INK}; return ink.length === {count} && ink.every((dark) => dark > {LEAST_INK}); }})()")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    analyze(lockstep_bag(), folder)
    return folder / "report.html"


def test_the_report_draws_every_figure_without_a_word_on_the_console(report: Path) -> None:
    with opened(report) as page:
        assert page.evaluate(f"{FIGURES}.length") in (10, 11)  # plane, four panels, observer, two histograms, phases
        drawn(page)
        assert page.errors == []
        assert page.requests and all(address.startswith(("file:", "data:", "blob:")) for address in page.requests)


def test_its_panels_zoom_together(report: Path) -> None:
    with opened(report) as page:
        page.evaluate(
            "Bokeh.documents[0].roots().find((one) => one.y_range.end === 1.05).x_range.setv({start: 0.3, end: 0.4})"
        )
        page.wait(IDLE)
        ranges = page.evaluate(f"{FIGURES}.map((one) => one.x_range.start).filter((start) => start === 0.3).length")
        tools = page.evaluate(f"{FIGURES}.filter((one) => one.toolbar.tools.some((tool) => tool.type === 'BoxZoomTool')).length")
        assert ranges == 4
        assert tools in (8, 9)
        assert page.errors == []


@pytest.mark.parametrize("width", [420, 768, 1280])
def test_a_page_needs_no_sideways_scrolling(report: Path, width: int) -> None:
    with opened(report) as page:
        page.resize(width)
        page.wait("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


@pytest.mark.parametrize("options", [{"truth": False}, {"phase": 2}, {"bounce": True, "says": (2, 1)}])
def test_reports_of_runs_that_lack_something_draw_too(tmp_path: Path, options: dict[str, object]) -> None:
    write_run(tmp_path / "run.mcap", **options)  # type: ignore[arg-type]
    analyze(tmp_path / "run.mcap")
    with opened(tmp_path / "report.html") as page:
        drawn(page)
        assert page.errors == []


def test_the_comparison_draws_too(tmp_path: Path) -> None:
    write_run(tmp_path / "rig.mcap", truth=False)
    write_comparison(compare_bags([lockstep_bag(), tmp_path / "rig.mcap"]), tmp_path)
    with opened(tmp_path / "comparison.html") as page:
        assert page.evaluate(f"{FIGURES}.length") == 6
        drawn(page)
        assert page.errors == []


def test_a_page_is_printed_beside_itself(report: Path) -> None:
    content = write_pdf(report).read_bytes()
    assert content.startswith(b"%PDF") and content.count(b"/Type /Page\n") > 2
    assert len(content) > 100_000  # with its figures


def test_this_test_sees_errors_and_requests(tmp_path: Path) -> None:
    file = tmp_path / "bad.html"
    file.write_text("<script>console.error('words'); nothing.at.all</script><img src='http://127.0.0.1:9/none.png'>")
    assert CHROMIUM is not None
    with Page(CHROMIUM, file.as_uri()) as page:
        page.evaluate("new Promise((done) => setTimeout(done, 200))")
        assert any("words" in error for error in page.errors)
        assert any("nothing is not defined" in error for error in page.errors)
        assert any(address.startswith("http:") for address in page.requests)
