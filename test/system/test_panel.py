"""The panel in a real browser, on a real robot in lockstep: a crossing, a refusal, a
stop, a lost connection, a second driver.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import WIDTHS, Page
from no_robot import Nothing
from patience import PATIENCE
from rig import start, stop
from tornado.websocket import websocket_connect

from dextar_control.cli.pdf import find_browser
from dextar_control.nodes.panel import ros_arguments
from dextar_control.panel.server import PanelServer

CHROMIUM = find_browser()
PICTURE = os.environ.get(
    "DEXTAR_PICTURE", ""
)  # the file of the documentation's picture, where it is to be made anew
NODES = {
    "plant": (
        "dextar_sim.node",
        ("mode:=lockstep", f"simulation.real_time_factor:={0.1 if PICTURE else 1.0}"),
    ),  # a picture takes a while
    "controller": ("dextar_control.nodes.controller", ("lockstep:=true",)),
    "trajectory_server": (
        "dextar_control.nodes.trajectory_server",
        ("task.dwell:=0.05",),
    ),
    "recorder": ("dextar_control.nodes.recorder", ("record_from_start:=false",)),
}
CUT = """(() => {
  const found = [];
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page is wider than the window");
  const words = (one) => one.id || one.textContent.trim().slice(0, 40), seen = (one) => one.offsetParent !== null;
  const texts = document.querySelectorAll("h1, h2, dt, dd, td, th, figcaption, button, label, li, p, output, small, b");
  for (const one of [...texts].filter(seen)) {
    const box = one.getBoundingClientRect();
    if (box.left < -0.5 || box.right > innerWidth + 0.5) found.push(`outside: ${words(one)}`);
    if (one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).display !== "inline") found.push(`cut: ${words(one)}`);
  }
  const all = "section, header > *, dt, dd, td, figcaption, canvas, main button, main input, main select";
  const boxes = [...document.querySelectorAll(all)].filter((one) => seen(one) && !one.closest("#parameters"))
    .map((one) => [one, one.getBoundingClientRect()]);
  boxes.forEach(([one, a], index) => boxes.slice(index + 1).forEach(([other, b]) => {
    if (one.contains(other) || other.contains(one) || one.id === "stop" || other.id === "stop") return;
    const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (wide > 1 && high > 1) found.push(`over each other: ${words(one)} and ${words(other)}`);
  }));
  return found;
})()"""  # what is cut or lies over something else


class Robot:
    """Nodes in lockstep, with the panel among them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: dict[str, subprocess.Popen[str]] = {}
        for name in NODES:
            self.start(name)
        self.port = 0
        self.panel()

    def start(self, name: str) -> None:
        module, values = NODES[name]
        values = (
            (*values, f"output:={self.folder}/{{stamp}}/run.mcap")
            if name == "recorder"
            else values
        )
        self.processes[name] = start(
            module, *(part for value in values for part in ("-p", value))
        )

    def panel(self) -> None:
        """Start the panel, at its port of before where it had one."""
        self.processes["panel"] = start(
            "dextar_control.nodes.panel", "-p", f"port:={self.port}"
        )
        output = self.processes["panel"].stdout
        assert output is not None
        while (line := output.readline()) and "the panel is at" not in line:
            pass
        self.port = int(re.search(r"127\.0\.0\.1:(\d+)/", line)[1])

    def end(self, name: str) -> None:
        code, output = stop(self.processes.pop(name))
        assert code == 0, output
        assert "Traceback" not in output, output

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def ask(self, *names: str) -> list[dict[str, object]]:
        """What another page, without a browser, is answered."""

        async def run() -> list[dict[str, object]]:
            answers = []
            stream = await websocket_connect(
                f"ws://127.0.0.1:{self.port}/stream?drive=0"
            )
            for number, name in enumerate(names):
                await stream.write_message(json.dumps({"ask": name, "number": number}))
                while (message := json.loads(await stream.read_message()))[
                    "kind"
                ] != "answer":
                    pass
                answers.append(message)
            stream.close()
            return answers

        return asyncio.run(run())


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    robot = Robot(tmp_path_factory.mktemp("runs"))
    try:
        yield robot
    finally:
        for name in list(robot.processes):
            robot.end(name)


@pytest.fixture(scope="module")
def page(robot: Robot) -> Iterator[Page]:
    if CHROMIUM is None:
        pytest.skip("no Chromium here: apt install chromium to look at the panel")
    with Page(CHROMIUM, robot.address) as page:
        yield page


@pytest.fixture(autouse=True)
def no_word_on_the_console(page: Page) -> Iterator[None]:
    yield
    assert page.errors == []


def text(name: str) -> str:
    return f"document.getElementById('{name}').textContent"


def says(page: Page, name: str, words: str) -> None:
    try:
        page.wait(f"{text(name)}.includes({json.dumps(words)})")
    except AssertionError as error:
        raise AssertionError(
            f"{error}; the page says: {page.evaluate('document.body.innerText')}"
        ) from error


def put(page: Page, **fields: object) -> None:
    """Type into fields of the task, an underscore for a hyphen."""
    for name, value in fields.items():
        page.evaluate(
            f"document.getElementById('{name.replace('_', '-')}').value = '{value}'"
        )
    page.evaluate("document.getElementById('task').dispatchEvent(new Event('input'))")


def in_plane(page: Page, x: float, y: float) -> tuple[float, float]:
    """Where a place, m, lies on the canvas, in shares of it: that of the robot's first
    motor and scale tell.
    """
    width, height = page.evaluate(
        "[document.getElementById('plane').clientWidth,"
        " document.getElementById('plane').clientHeight]"
    )
    scale = min(
        width / (0.242 + 0.024), height / (0.36 + 0.024)
    )  # px/m, of the DexTAR's workspace and a border of 12 mm
    return 0.5 + x * scale / width, 0.5 - y * scale / height


def ready(page: Page) -> None:
    says(page, "phase-name", "HOLD")
    page.wait("!document.getElementById('go').disabled")


def goes(page: Page) -> None:
    """Click Go until the robot moves: a plan that is made anew takes no click
    meanwhile.
    """
    deadline = time.monotonic() + PATIENCE
    while not page.evaluate(f"['TRACK', 'CROSSING'].includes({text('phase-name')})"):
        assert time.monotonic() < deadline, page.evaluate("document.body.innerText")
        if page.evaluate("!document.getElementById('go').disabled"):
            page.click("#go")
        time.sleep(0.05)


@pytest.mark.skipif(
    not PICTURE,
    reason=(
        "makes the documentation's picture: DEXTAR_PICTURE=docs/panel.png, -k picture"
    ),
)
def test_the_documentations_picture_is_taken_in_a_crossing(
    page: Page, robot: Robot
) -> None:
    page.resize(1280)
    ready(page)
    page.evaluate(
        "document.getElementById('go').scrollIntoView = () => {}"
    )  # the picture begins at the top
    page.click("#go")
    page.wait(
        "Math.abs(document.querySelector('#now dd').textContent.replace('\\u2212',"
        " '-')) < 0.12"
    )
    page.screenshot(Path(PICTURE))
    ready(page)


def test_a_whole_crossing_is_clicked_through_and_recorded(
    page: Page, robot: Robot
) -> None:
    says(page, "phase-name", "HOLD")
    says(page, "driver", "This page drives.")
    page.click("#plane", in_plane(page, 0.01, 0.06))  # B
    x, y = (
        float(page.evaluate(f"document.getElementById('goal-{axis}').value"))
        for axis in "xy"
    )
    assert math.hypot(x - 0.01, y - 0.06) < 2e-3
    says(page, "plan-words", "Peak torque")
    says(page, "plan-words", "2 crossings")
    page.evaluate("document.getElementById('name').value = 'clicked'")
    page.wait("!document.getElementById('record-on').disabled")
    page.click("#record-on")
    says(page, "recorded", "Recording to")
    ready(page)
    goes(page)
    says(page, "lines", "crossing 2 of 2: CROSSED")
    says(page, "lines", "done: crossed 2 of 2 planned")
    page.wait(
        "[...document.querySelectorAll('#now dd')].some((one) =>"
        " one.textContent.includes('2 of 2: crossed, crossed'))"
    )
    says(page, "health", "trajectory_server: planned")


def test_the_report_of_that_run_is_one_click_away(page: Page, robot: Robot) -> None:
    page.click("#record-off")
    says(page, "recorded", "Not recording. The last bag is")
    page.click("#report")
    page.wait("!document.getElementById('report-link').hidden")
    report = page.evaluate(
        "fetch(document.querySelector('#report-link a').href).then((answer) =>"
        " answer.text())"
    )
    assert "clicked" in report and "crossed" in report


def test_a_point_of_the_locus_is_clicked_and_gone_through(
    page: Page, robot: Robot
) -> None:
    page.click("input[value=point]")
    page.click("#plane", in_plane(page, 0.01, 0.09))
    page.wait("document.getElementById('kind').value === 'point'")
    says(page, "plan-words", "Peak torque")
    ready(page)
    before = page.evaluate(
        f"({text('lines')}.match(/done: crossed 2 of 2/g) || []).length"
    )
    goes(page)
    page.wait(
        f"({text('lines')}.match(/done: crossed 2 of 2/g) || []).length > {before}"
    )
    page.click("input[value=goal]")


def test_what_cannot_be_driven_is_refused_with_what_would_do(
    page: Page, robot: Robot
) -> None:
    put(page, kind="trip", goal_x=0.01, goal_y=0.06, duration=0.15)
    says(page, "plan-words", "the nearest duration that works is")
    assert page.evaluate("document.getElementById('go').disabled")
    page.wait("!document.getElementById('instead').hidden")
    page.click("#instead button")
    says(page, "plan-words", "Peak torque")
    put(page, goal_x=-0.02, goal_y=0.12)
    says(page, "plan-words", "the same side of the Type 2 locus")
    page.click("#plane", (0.5, 0.01))
    says(page, "notice", "lies outside of what the robot reaches")
    put(page, goal_x=0.01, goal_y=0.06, duration=0.33)
    says(page, "plan-words", "Peak torque")


def test_a_parameter_out_of_its_range_is_refused_and_one_within_is_set(
    page: Page, robot: Robot
) -> None:
    row = "document.querySelector('[data-name=\"feedback.damping_ratio\"] input')"
    page.wait(f"{row}.value === '1'")
    for value, told in (
        (40, "'feedback.damping_ratio' = 40; it must be <= 5"),
        (1.2, ""),
    ):
        page.evaluate(
            f"{row}.value = '{value}'; {row}.dispatchEvent(new Event('change'))"
        )
        says(
            page,
            "notice" if told else "lines",
            told or "'feedback.damping_ratio' is 1.2.",
        )
    page.wait(
        "document.querySelector('[data-name=\"feedback.damping_ratio\"]').classList.contains('changed')"
    )
    page.evaluate("document.getElementById('law-law').value = 'projected'")
    page.click("#law button")
    page.wait("document.getElementById('law-law').dataset.now === 'projected'")
    says(page, "phase-name", "HOLD")


def test_the_space_bar_stops_and_what_mends_it_is_one_click_away(
    page: Page, robot: Robot
) -> None:
    put(page, kind="trip", goal_x=0.01, goal_y=0.06, duration=5)
    says(page, "plan-words", "Peak torque")
    ready(page)
    goes(page)
    page.press("Space", " ")
    says(page, "phase-name", "SAFE STOP")
    says(page, "why", "Safe stop: stop requested")
    says(page, "lines", "not done: crossed")
    page.wait("document.querySelector('#why button').textContent === 'Reset'")
    page.click("#why button")
    says(page, "why", "The torque is switched off.")
    page.wait("document.querySelector('#why button').textContent === 'Torque on'")
    page.click("#why button")
    says(page, "phase-name", "HOLD")
    put(page, duration=0.33)


def test_a_second_driver_takes_over_and_the_first_watches(
    page: Page, robot: Robot
) -> None:
    assert (
        robot.ask("go")[0]["text"]
        == "this page watches, and another page drives: take over first"
    )
    assert [answer["ok"] for answer in robot.ask("stop", "drive")] == [True, True]
    says(page, "driver", "Nobody drives.")  # the other has left
    page.wait("document.getElementById('go').disabled")
    page.click("#take")
    says(page, "driver", "This page drives.")
    ready(page)


def test_it_comes_back_by_itself_when_controller_or_panel_end_and_begin_again(
    page: Page, robot: Robot
) -> None:
    robot.end("controller")
    says(page, "why", "No controller is heard of")
    robot.start("controller")
    says(page, "phase-name", "HOLD")
    robot.end("panel")
    says(page, "notice", "The connection to the panel is lost.")
    page.click("#stop")
    says(page, "notice", "STOP did not reach the robot")
    page.errors.clear()  # what a browser says of connections that nobody answers
    robot.panel()
    says(page, "link", "connected")
    page.errors.clear()
    says(page, "driver", "This page drives.")
    ready(page)


def test_numbers_that_are_none_and_a_browser_without_streams_are_told() -> None:
    """Of a server with nothing behind it."""
    loop, nan = asyncio.new_event_loop(), math.nan
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    server = PanelServer(Nothing(), "127.0.0.1", 0)
    pair = [nan, nan]
    state = {
        "time": 1.0,
        "stale": False,
        "phase": "hold",
        "links": [pair] * 5,
        "x": pair,
        "reference": pair,
        "t_s": pair,
        "s": nan,
        "torque": pair,
        "limit": nan,
        "error": nan,
        "residual": nan,
        "confidence": nan,
        "mode": nan,
    }
    told = {"lifecycle": "active", "phase": "HOLD", "rate": "nan"}
    status = {
        "controller": told,
        "why": "",
        "action": "",
        "nodes": {},
        "plant": {},
        "margins": [
            {"name": "locus", "value": "nan", "limit": "nan", "unit": "", "used": nan}
        ],
        "recorder": {},
        "values": {},
        "lines": [],
        "progress": None,
        "complaint": "",
        "bag": "",
        "reported": False,
    }

    def begin() -> None:
        server.begin()
        for kind, value in (
            ("state", state),
            ("status", status),
            ("path", {"path": [pair], "crossings": [pair]}),
        ):
            server.send(kind, value, keep=True)

    loop.call_soon_threadsafe(begin)
    try:
        with Page(str(CHROMIUM), server.address) as page:
            says(page, "phase-name", "HOLD")
            page.wait("document.querySelector('#now dd')?.textContent === '\u2013'")
            page.click("#here")
            page.click("#plane")
            page.open(server.address, "delete window.WebSocket;")
            says(page, "notice", "This browser has no WebSocket")
            assert page.errors == []
    finally:
        loop.call_soon_threadsafe(server.close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut_or_lies_over_something_else(
    page: Page, robot: Robot, width: int, tmp_path: Path
) -> None:
    ready(page)
    page.resize(width)
    page.wait(f"innerWidth === {width}")
    assert page.evaluate(CUT) == []
    for scheme in ("light", "dark"):
        page.prefers(scheme)
        page.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(()"
            " => setTimeout(done, 100))))"
        )
        page.screenshot(tmp_path / f"panel_{width}_{scheme}.png")


def test_host_port_and_namespace_are_short_for_ros_arguments() -> None:
    told = [
        "--host",
        "0.0.0.0",
        "--port",
        "0",
        "--namespace",
        "/left",
        "--ros-args",
        "-p",
        "rate:=10.0",
    ]
    assert ros_arguments(told) == [
        "--ros-args",
        "-p",
        "panel:host:=0.0.0.0",
        "-p",
        "panel:port:=0",
        "-r",
        "__ns:=/left",
        "--",
        "--ros-args",
        "-p",
        "rate:=10.0",
    ]
    assert ros_arguments(["--help"]) == ["--help"]
