"""A headless Chromium spoken to over its DevTools pipe: what a page says on its
console, asks for, and draws.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from patience import PATIENCE

from dextar_control.cli.pdf import find_browser

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--window-size=1400,1200",
    "--remote-debugging-pipe",
)


WIDTHS = (420, 768, 1280, 1920)
# Each line of text: its box, px, its words, whether its container scrolls, the page's
# width.
WORDS = """(() => {
  const found = [], wide = document.documentElement.clientWidth;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const parent = node.parentElement;
    if (!node.data.trim() || parent.closest("script, style, noscript, .readout") || !parent.checkVisibility()) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    const scrolled = parent.closest(".scroll, .drawn");
    for (const box of range.getClientRects())
      if (box.width > 1)
        found.push([box.left, box.top, box.right, box.bottom, node.data.trim().slice(0, 30), scrolled !== null, wide]);
  }
  return found;
})()"""
SLACK = 2.0  # px: a font's box is taller than its letters
SIDEWAYS = "document.documentElement.scrollWidth > document.documentElement.clientWidth"


class Page:
    """One page of a browser of its own.

    Attributes:
        errors: console errors, warnings of the log, uncaught exceptions.
        requests: addresses asked for.
    """

    def __init__(self, program: str, url: str) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._number, self._rest, self._loaded = 0, b"", False
        self._profile = tempfile.mkdtemp(prefix="chromium_")
        to_browser, self._in = os.pipe()
        self._out, from_browser = os.pipe()
        command = f'exec "$0" "$@" 3<&{to_browser} 4>&{from_browser}'
        self._process = subprocess.Popen(
            [
                "bash",
                "-c",
                command,
                program,
                *FLAGS,
                f"--user-data-dir={self._profile}",
                "about:blank",
            ],
            pass_fds=(to_browser, from_browser),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        targets = self._call("Target.getTargets")["targetInfos"]
        page = next(
            target["targetId"] for target in targets if target["type"] == "page"
        )
        self._session = self._call(
            "Target.attachToTarget", targetId=page, flatten=True
        )["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self._call(f"{domain}.enable")
        self.open(url)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        os.close(self._in)
        os.close(self._out)
        shutil.rmtree(self._profile, ignore_errors=True)

    def open(self, url: str, first: str = "") -> None:
        """Go to an address; ``first`` is run before any script of its page."""
        self._loaded = False
        self._call("Page.addScriptToEvaluateOnNewDocument", source=first)
        self._call("Page.navigate", url=url)
        self._until(lambda: self._loaded)

    def evaluate(self, script: str) -> Any:
        """The value of an expression, promises awaited."""
        answer = self._call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def resize(self, width: int) -> None:
        """A window of this width, px, in which the page has been laid out."""
        self._call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=1000,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(()"
            " => setTimeout(done, 0))))"
        )

    def click(self, selector: str, at: tuple[float, float] = (0.5, 0.5)) -> None:
        """With the mouse, on an element, at these shares of its width and height."""
        box = self.evaluate(
            f"(() => {{ const one = document.querySelector({json.dumps(selector)});"
            " one.scrollIntoView({block: 'center'}); const box ="
            " one.getBoundingClientRect(); return [box.left, box.top, box.width,"
            " box.height]; })()"
        )
        x, y = (box[axis] + at[axis] * box[2 + axis] for axis in range(2))
        for kind in ("mousePressed", "mouseReleased"):
            self._call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x,
                y=y,
                button="left",
                clickCount=1,
            )

    def press(self, code: str, key: str) -> None:
        """A key, on what has the focus."""
        for kind in ("keyDown", "keyUp"):
            self._call(
                "Input.dispatchKeyEvent",
                type=kind,
                code=code,
                key=key,
                windowsVirtualKeyCode=ord(key),
            )

    def prefers(self, scheme: str) -> None:
        """A reader whose system is light or dark."""
        self._call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": scheme}],
        )

    def drag(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """With the pointer, px."""
        middle = 0.5 * (begin[0] + end[0]), 0.5 * (begin[1] + end[1])
        for kind, (x, y), held in (
            ("mousePressed", begin, 1),
            ("mouseMoved", middle, 1),
            ("mouseMoved", end, 1),
            ("mouseReleased", end, 0),
        ):
            self._call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x,
                y=y,
                button="left",
                buttons=held,
                clickCount=1,
            )

    def screenshot(self, file: Path) -> None:
        self._call("Emulation.setScrollbarsHidden", hidden=True)
        width, height = self.evaluate(
            "[innerWidth, document.documentElement.scrollHeight]"
        )
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        taken = self._call(
            "Page.captureScreenshot", captureBeyondViewport=True, clip=clip
        )
        file.write_bytes(base64.b64decode(taken["data"]))

    def wait(self, condition: str) -> None:
        """Until an expression is true."""
        deadline = time.monotonic() + PATIENCE
        while not self.evaluate(condition):
            assert time.monotonic() < deadline, (
                f"never came true: {condition}; errors: {self.errors}"
            )
            time.sleep(0.05)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {
            "id": self._number,
            "method": method,
            "params": parameters,
        }
        if hasattr(self, "_session"):
            message["sessionId"] = self._session
        os.write(self._in, json.dumps(message).encode() + b"\0")
        found: list[dict[str, Any]] = []
        number = self._number
        self._until(
            lambda: bool(found),
            lambda answer: found.append(answer) if answer.get("id") == number else None,
        )
        assert "error" not in found[0], found[0]
        return found[0]["result"]

    def _until(self, done: Any, see: Any = lambda answer: None) -> None:
        deadline = time.monotonic() + PATIENCE
        while not done():
            left = deadline - time.monotonic()
            assert left > 0 and select.select([self._out], [], [], left)[0], (
                "the browser does not answer"
            )
            data = os.read(self._out, 1 << 20)
            assert data, "the browser has gone"
            *messages, self._rest = (self._rest + data).split(b"\0")
            for text in messages:
                answer = json.loads(text)
                self._note(answer)
                see(answer)

    def _note(self, answer: dict[str, Any]) -> None:
        method, parameters = answer.get("method"), answer.get("params", {})
        if method == "Runtime.consoleAPICalled" and parameters["type"] in (
            "error",
            "warning",
            "assert",
        ):
            self.errors.append(
                str(
                    [
                        entry.get("value", entry.get("description"))
                        for entry in parameters["args"]
                    ]
                )
            )
        elif method == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.errors.append(
                details.get("exception", {}).get("description", details["text"])
            )
        elif method == "Log.entryAdded" and parameters["entry"]["level"] in (
            "error",
            "warning",
        ):
            self.errors.append(parameters["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif method == "Page.loadEventFired":
            self._loaded = True


def is_legible(page: Page, width: int) -> None:
    """No word is cut by the page's edge, and no two lie on each other."""
    page.resize(width)
    page.evaluate(
        "new Promise((done) => requestAnimationFrame(() =>"
        " requestAnimationFrame(done)))"
    )
    assert not page.evaluate(SIDEWAYS), width
    boxes = sorted(page.evaluate(WORDS), key=lambda box: box[1])
    assert len(boxes) > 20
    for index, (left, top, right, bottom, words, scrolls, wide) in enumerate(boxes):
        assert scrolls or (left >= 0.0 and right <= wide), (width, words, left, right)
        for other in boxes[index + 1 :]:
            if other[1] >= bottom - SLACK:
                break
            apart = (
                other[0] >= right - SLACK
                or other[2] <= left + SLACK
                or other[3] <= top + SLACK
            )
            assert apart or scrolls != other[5], (
                width,
                words,
                other[4],
                (left, top, right, bottom),
                other[:4],
            )


def looks_right(file: Path) -> None:
    """A page is legible at every width, without a word on the console or a request;
    not looked at where there is no Chromium.
    """
    program = find_browser()
    if program is None:
        return
    with Page(program, file.as_uri()) as page:
        for width in WIDTHS:
            is_legible(page, width)
        assert page.errors == []
        assert all(one.startswith(("file:", "data:", "blob:")) for one in page.requests)
