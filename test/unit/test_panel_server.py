"""The panel's server by itself: who is let in, who drives, what a page gets that is
slow, asleep or gone.
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
from collections.abc import Awaitable, Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.panel import server as server_module
from dextar_control.panel.access import Access
from dextar_control.panel.server import PanelServer, to_json
from dextar_control.panel.words import shown_margins, trouble_and_remedy

MOST_BYTES = 300_000  # of the page


class Robot:
    """Stands behind a server: says yes, and keeps what was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.viewers: list[int] = []
        self.notes: list[str] = []

    def setup(self) -> Mapping[str, Any]:
        return {"robot": "none"}

    def ask(self, name: str, arguments: Mapping[str, Any], answer: Any) -> None:
        if name == "refused":
            raise DextarError("it is 3; the limit is 2")
        if name == "broken":
            raise KeyError("start")
        if name == "unlike":
            arguments["values"].items()
        self.asked.append(name)
        answer(True, f"{name} was asked for", {})

    def watched(self, viewers: int) -> None:
        self.viewers.append(viewers)

    def told(self, text: str) -> None:
        self.notes.append(text)

    def report(self) -> Path | None:
        return None


class Page:
    """One page's end of the stream."""

    def __init__(self, socket: WebSocketClientConnection) -> None:
        self.socket = socket
        self._number = 0

    async def hear(self, kind: str) -> dict[str, Any]:
        """The next message of a kind."""
        while True:
            text = await asyncio.wait_for(self.socket.read_message(), PATIENCE)
            assert text is not None, f"closed: {self.socket.close_reason}"
            message = json.loads(text)
            if message["kind"] == kind:
                return message

    async def ask(self, name: str, **more: Any) -> dict[str, Any]:
        self._number += 1
        await self.socket.write_message(
            json.dumps({**more, "ask": name, "number": self._number})
        )
        answer = await self.hear("answer")
        assert answer["number"] == self._number
        return answer


def served(
    work: Callable[[PanelServer, Robot, str], Awaitable[None]], host: str = "127.0.0.1"
) -> None:
    """A server in a loop of its own, and work with it; its address without scheme and
    query.
    """

    async def run() -> None:
        robot = Robot()
        server = PanelServer(robot, host, 0)
        server.begin()
        try:
            await work(
                server,
                robot,
                f"127.0.0.1:{server.address.rpartition(':')[2].partition('/')[0]}",
            )
        finally:
            server.close()
            await asyncio.sleep(0)

    asyncio.run(run())


async def opened(at: str, query: str = "", **headers: str) -> Page:
    return Page(
        await websocket_connect(
            HTTPRequest(f"ws://{at}/stream{query}", headers=headers)
        )
    )


async def refused(url: str, **headers: str) -> str:
    """The sentence with which a request is refused."""
    with pytest.raises(HTTPClientError) as caught:
        await AsyncHTTPClient().fetch(url, headers=headers)
    assert caught.value.code == 403
    return caught.value.response.body.decode()


@pytest.mark.parametrize(
    ("bound", "host", "origin", "told"),
    [
        ("127.0.0.1", "127.0.0.1:1", "http://127.0.0.1:1", ""),
        ("127.0.0.1", "localhost:1", None, ""),
        ("127.0.0.1", "[::1]:1", "http://[::1]:1", ""),
        (
            "127.0.0.1",
            "localhost:9",
            "http://localhost:9",
            "",
        ),  # by a tunnel to another port
        (
            "127.0.0.1",
            "127.0.0.1:1",
            "http://evil.example",
            "a page of http://evil.example may not ask",
        ),
        (
            "127.0.0.1",
            "127.0.0.1:1",
            "http://127.0.0.1:2",
            "a page of http://127.0.0.1:2 may not ask",
        ),
        ("127.0.0.1", "127.0.0.1:1", "null", "a page of null may not ask"),
        (
            "127.0.0.1",
            "evil.example:1",
            "http://evil.example:1",
            "for this machine alone, not for evil.example:1",
        ),
        ("127.0.0.1", "[::", None, "names no host and port"),
        ("127.0.0.1", "127.0.0.1:1", "http://[", "names no host and port"),
        ("0.0.0.0", "robot:1", "http://robot:1", "the token is missing or wrong"),
    ],
)
def test_only_this_machines_own_page_is_let_in(
    bound: str, host: str, origin: str | None, told: str
) -> None:
    refusal = Access(bound).refusal(host, origin, "guess")
    assert told in refusal and bool(told) == bool(refusal)


def test_opened_to_the_network_it_wants_its_token_and_its_own_page() -> None:
    access, other = Access("0.0.0.0"), Access("0.0.0.0")
    assert len(access.token) >= 20 and access.token != other.token
    assert not access.refusal("robot:1", "http://robot:1", access.token)
    assert access.refusal("robot:1", "http://robot:1", other.token)
    assert access.refusal("robot:1", "http://evil.example", access.token)


def test_a_foreign_page_or_name_is_refused_with_a_sentence_and_it_is_told() -> None:
    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
            for path in ("", "stream", "report", "why", "panel.js"):
                assert "panel" in await refused(f"http://{at}/{path}", **headers)
            with pytest.raises(HTTPClientError):
                await opened(at, **headers)
        assert (
            len(robot.notes) == 12
            and "refused a request of 127.0.0.1" in robot.notes[0]
        )
        assert not robot.viewers

    served(work)


def test_with_a_token_nothing_is_seen_or_asked_without_it() -> None:
    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        token = server.address.partition("?token=")[2]
        assert token == server.access.token
        for path in ("stream", "report", "why"):
            for query in ("", "?token=", f"?token={token[:-1]}"):
                assert "token is missing or wrong" in await refused(
                    f"http://{at}/{path}{query}"
                )
        page = await opened(at, f"?token={token}")
        assert (await page.ask("stop"))["ok"]
        assert (
            await AsyncHTTPClient().fetch(f"http://{at}/")
        ).code == 200  # the page, which says what is missing

    served(work, "0.0.0.0")


def test_one_page_drives_and_the_others_watch_until_one_takes_over() -> None:
    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        first = await opened(at)
        assert (await first.hear("driver"))["driver"] == "you"
        second = await opened(at)
        assert (await second.hear("driver"))["driver"] == "another"
        assert (
            "this page watches, and another page drives: take over first"
            in (await second.ask("go"))["text"]
        )
        assert (await second.ask("stop"))["ok"]  # anybody may
        assert (await second.ask("drive"))["ok"]
        assert not (await first.ask("go"))["ok"] and (await second.ask("go"))["ok"]
        second.socket.close()
        while (await first.hear("driver"))["driver"] != "nobody":
            pass
        assert "nobody drives" in (await first.ask("enable"))["text"]
        watcher = await opened(at, "?drive=0")
        assert (await watcher.hear("driver"))["driver"] == "nobody"
        again = await opened(at)
        assert (await again.hear("driver"))["driver"] == "you"
        assert robot.asked == ["stop", "go"]

    served(work)


def test_what_makes_no_sense_is_answered_in_words() -> None:
    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        page = await opened(at)
        numbers = (
            '{"ask": "go"}',
            '{"ask": "go", "number": "x"}',
            '{"ask": "go", "number": 1e400}',
        )
        for text in ("no json", "[]", "[" * 60000, *numbers):
            await page.socket.write_message(text)
            assert (
                "that is no command of this panel"
                in (await page.hear("answer"))["text"]
            )
        assert (await page.ask("refused"))["text"] == "it is 3; the limit is 2"
        assert "'broken' cannot be done with that" in (await page.ask("broken"))["text"]
        assert (
            "'unlike' cannot be done with that"
            in (await page.ask("unlike", values=[1]))["text"]
        )
        assert (await page.ask("go"))["ok"]

    served(work)


def test_numbers_that_are_none_reach_a_page_as_null() -> None:
    import numpy as np

    text = to_json(
        {
            "x": np.array([1.0, np.nan]),
            "y": (math.inf, {"z": -math.inf}),
            "n": 3,
            "t": "nan",
        }
    )
    assert json.loads(text) == {
        "x": [1.0, None],
        "y": [None, {"z": None}],
        "n": 3,
        "t": "nan",
    }


def test_a_page_that_sleeps_costs_no_memory_and_gets_the_newest_when_it_wakes() -> None:
    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        sleeper, other = await opened(at), await opened(at)
        page = server.pages[0]
        big = "x" * 200_000
        for count in range(300):
            server.send("state", {"count": count, "big": big})
            server.send("status", {"count": count}, keep=True)
            await asyncio.sleep(0)
        assert len(page._owed) <= 2  # the newest status, and no state
        for _ in range(200):
            if page._flight is None or page._flight.done():
                break
            await asyncio.wait_for(sleeper.socket.read_message(), PATIENCE)
        server.send("status", {"count": 300}, keep=True)
        while (await sleeper.hear("status"))["count"] < 299:
            pass
        assert other.socket is not None

    served(work)


def test_twenty_pages_look_on_and_all_leave() -> None:
    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        pages = [await opened(at) for _ in range(20)]
        server.send("status", {"time": 1.0}, keep=True)
        for page in pages:
            assert (await page.hear("status"))["time"] == 1.0
        for page in pages:
            page.socket.close()
        while server.pages:
            await asyncio.sleep(0.01)
        assert (
            max(robot.viewers) == 20
            and robot.viewers[-1] == 0
            and server.driver is None
        )

    served(work)


def test_too_many_pages_are_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "MOST_VIEWERS", 1)

    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        await opened(at)
        second = await opened(at)
        assert await second.socket.read_message() is None
        assert second.socket.close_reason == "1 pages look on already; close one"

    served(work)


def test_a_taken_port_leads_to_the_next_and_a_host_that_is_none_is_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]

        async def work() -> None:
            server = PanelServer(Robot(), "127.0.0.1", port)
            assert server.moved and f":{port}/" not in server.address
            for one in server._sockets:
                one.close()

        asyncio.run(work())
    with pytest.raises(
        ParameterError,
        match=r"parameter 'host' = '192.0.2.1', port \d+ cannot be bound to",
    ):
        PanelServer(Robot(), "192.0.2.1", port)


def test_the_page_is_small_asks_nobody_else_and_may_not_be_framed() -> None:
    parts = [
        entry.read_text(encoding="utf-8")
        for entry in files("dextar_control.panel").joinpath("static").iterdir()
    ]
    assert 0 < sum(len(part.encode()) for part in parts) <= MOST_BYTES
    assert not any("://" in part.replace("http://www.w3.org", "") for part in parts)

    async def work(server: PanelServer, robot: Robot, at: str) -> None:
        answer = await AsyncHTTPClient().fetch(f"http://{at}/")
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert (
            b"--paper:"
            in (await AsyncHTTPClient().fetch(f"http://{at}/panel.css")).body
        )

    served(work)


@pytest.mark.parametrize(
    ("told", "words", "action"),
    [
        ({}, "No controller is heard of", ""),
        ({"lifecycle": "inactive"}, "The controller is inactive", "activate"),
        ({"lifecycle": "active", "phase": "HOLD"}, "", ""),
        ({"lifecycle": "active", "phase": "HOLD", "state_age": "0.01"}, "", ""),
        (
            {"lifecycle": "active", "phase": "HOLD", "state_age": "7.2"},
            "No joint state has come for 7 s",
            "",
        ),
        (
            {"lifecycle": "active", "phase": "IDLE", "enabling": "off"},
            "The torque is switched off.",
            "enable",
        ),
        (
            {
                "lifecycle": "active",
                "phase": "IDLE",
                "enabling": "waiting",
                "healthy": "0.1",
                "last_trouble": "a gap",
            },
            "0.1 s so far (last trouble: a gap)",
            "",
        ),
        (
            {
                "lifecycle": "active",
                "phase": "SAFE_STOP",
                "reason": "stop requested",
                "stopped": "False",
            },
            "The robot is being brought to rest: stop requested.",
            "",
        ),
        (
            {"lifecycle": "active", "phase": "SAFE_STOP", "stopped": "True"},
            "Safe stop. The torque is gone",
            "reset",
        ),
        (
            {"lifecycle": "active", "phase": "FAULT", "reason": "no state for 30 ms"},
            "Fault: no state for 30 ms.",
            "reset",
        ),
    ],
)
def test_why_there_is_no_torque_and_what_mends_it(
    told: dict[str, str], words: str, action: str
) -> None:
    said, mended = trouble_and_remedy("/", told, {})
    assert words in said and bool(words) == bool(said)
    assert mended == action


def test_who_is_heard_of_is_named_where_the_controller_is_not() -> None:
    assert trouble_and_remedy("/left", {}, {"panel": 0, "plant": 0})[0].startswith(
        "No controller is heard of in /left; heard of: plant."
    )
    just_begun = trouble_and_remedy("/left", {}, {}, listening=True)
    assert (
        just_begun[0].startswith("The panel has just begun to listen")
        and not just_begun[1]
    )


def test_the_watch_that_is_nearest_to_its_limit_comes_first() -> None:
    told = {
        "watch_locus": "0.3 of 0.15",
        "watch_tracking_error": "0.019 of 0.02",
        "watch_joint_range": "-1 of 0.05",
        "watch_finite": "0 of 0",
        "watch_estimator": "nan of 0.04",
        "phase": "HOLD",
    }
    shown = shown_margins(told, {"locus": "", "tracking_error": "m"})
    assert {row["name"]: row["unit"] for row in shown}["tracking_error"] == "m"
    rows = {row["name"]: row["used"] for row in shown}
    assert list(rows)[:2] == ["estimator", "tracking_error"]
    assert (
        rows["locus"] == 0.5
        and rows["joint_range"] == 0.0
        and rows["finite"] == 0.0
        and rows["estimator"] == 1.0
    )
