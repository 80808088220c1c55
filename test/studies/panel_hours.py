"""What hours in front of the panel cost: ``python test/studies/panel_hours.py 8``.

Sends a page in headless Chromium the pictures and the words of that many hours as fast as
it takes them, from the panel's own server with no robot behind it, and prints what page
and server hold after each tenth: a page that kept anything would grow with every row. It
counts messages, not time: a real page draws one picture for each, this one as many as it
finds the time for.
"""

from __future__ import annotations

import asyncio
import math
import os
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from browser import Page
from no_robot import Nothing

from dextar_control.cli.pdf import find_browser
from dextar_control.panel.server import PanelServer

RATE, STATUS_RATE = 25, 5  # messages of the panel in a second
PARTS = 10
PAGE_SIZE = os.sysconf("SC_PAGE_SIZE")


def state(number: int) -> dict[str, object]:
    """A picture of a robot that swings."""
    angle = 0.02 * number
    x = [0.03 * math.cos(angle), 0.08 + 0.02 * math.sin(angle)]
    return {
        "time": number / RATE,
        "stale": False,
        "phase": "track" if number % 50 else "crossing",
        "links": [[-0.06, 0.0], [-0.07, 0.09], x, [0.07, 0.09], [0.06, 0.0]],
        "x": x,
        "reference": x,
        "t_s": [1.0, 0.0],
        "s": math.sin(angle),
        "torque": [0.05 * math.sin(angle), -0.05 * math.sin(angle)],
        "limit": 0.3,
        "error": 1e-5,
        "residual": 0.01,
        "confidence": 0.99,
        "mode": 1,
    }


def status(number: int) -> dict[str, object]:
    """Words of nodes that have always something new to say."""
    return {
        "controller": {
            "lifecycle": "active",
            "phase": "TRACK",
            "rate": f"{1e3 + number % 7}",
        },
        "why": "",
        "action": "",
        "nodes": {"plant": {"message": f"step {number}", "level": 0}},
        "plant": {"real_time_factor": "1.0", "late_ticks": str(number)},
        "margins": [
            {
                "name": "locus",
                "value": f"{number % 9}",
                "limit": "9",
                "unit": "",
                "used": 0.5,
            }
        ],
        "recorder": {
            "recording": "True",
            "bag": "run.mcap",
            "bytes": 1000 * number,
            "lost": 0,
        },
        "values": {},
        "lines": [[k, f"crossing {k} of {number}"] for k in range(number, number + 20)],
        "progress": [f"crossing {number}", 0.5],
        "complaint": "",
        "bag": "",
        "reported": False,
    }


async def taken(server: PanelServer) -> None:
    """Until a page is there, which connects anew by itself, and has taken all."""
    while not server.pages:
        await asyncio.sleep(0.1)
    page = server.pages[0]
    while page._flight is not None and not page._flight.done():
        await asyncio.sleep(0)


async def feed(server: PanelServer, begin: int, end: int) -> None:
    """Each message as soon as the page has taken the one before."""
    for number in range(begin, end):
        await taken(server)
        server.send("state", state(number))
        if number % (RATE // STATUS_RATE) == 0:
            await taken(server)
            server.send("status", status(number), keep=True)


def resident() -> float:
    """Memory of this process, MB."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * PAGE_SIZE / 1e6


def held(page: Page) -> tuple[float, int]:
    """What the page holds once its garbage is collected: MB of heap, nodes."""
    page._call("HeapProfiler.collectGarbage")
    numbers = {
        one["name"]: one["value"]
        for one in page._call("Performance.getMetrics")["metrics"]
    }
    return numbers["JSHeapUsedSize"] / 1e6, int(numbers["Nodes"])


def main(hours: float) -> None:
    """Print the table."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    server = PanelServer(Nothing(), "127.0.0.1", 0)
    loop.call_soon_threadsafe(server.begin)
    total = round(3600 * RATE * hours)
    print("hours  messages  page, MB  nodes  server, MB")
    try:
        with Page(str(find_browser()), server.address) as page:
            page._call("Performance.enable")
            page.wait("document.getElementById('link').textContent === 'connected'")
            edges = [total * part // PARTS for part in range(PARTS + 1)]
            for begin, end in zip(edges[:-1], edges[1:], strict=True):
                asyncio.run_coroutine_threadsafe(
                    feed(server, begin, end), loop
                ).result()
                time.sleep(1.0)  # the page draws what came last
                heap, nodes = held(page)
                print(
                    f"{end / RATE / 3600:5.1f}  {end:8d}  {heap:8.2f}  {nodes:5d}"
                    f"  {resident():10.1f}",
                    flush=True,
                )
    finally:
        loop.call_soon_threadsafe(server.close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 8.0)
