"""The panel's server gives out the page and a stream of what is seen, and takes
commands from one driver at a time.
"""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import socket
from collections.abc import Callable, Mapping
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Protocol

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, Finish, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from dextar_control.contract import style
from dextar_control.contract.errors import DextarError, ParameterError
from dextar_control.contract.plain_data import ParameterValue, as_plain
from dextar_control.panel.access import Access

Reply = Callable[[bool, str, Mapping[str, object]], None]
PORTS_TRIED = 10  # from the wanted one on
PING = 6.0  # s between questions to a page whether it is there
PATIENCE = 6.0  # s until a page that is silent counts as gone
LONGEST_MESSAGE = 65536  # bytes of a command
MOST_VIEWERS = 100
MOST_OWED = 200  # messages that a page has not taken yet
FOR_ALL = ("stop", "drive")  # what a page may ask that does not drive
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:;"
    " connect-src 'self'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Backend(Protocol):
    """What the server shows and asks; its methods are called in the server's thread and
    do not wait.
    """

    def setup(self) -> Mapping[str, object]:
        """Return what a page needs once."""

    def ask(
        self, name: str, arguments: Mapping[str, ParameterValue], answer: Reply
    ) -> None:
        """Do what the driver asks, or stop for anybody; ``answer`` is called in the
        server's thread.
        """

    def watched(self, viewers: int) -> None:
        """Take note of how many pages look on."""

    def told(self, text: str) -> None:
        """Tell the operator something."""

    def report(self) -> Path | None:
        """Return the last run's page; None where none has been made."""


def to_json(value: object) -> str:
    """Return JSON that every browser reads: a number that is not finite is null."""
    return json.dumps(as_plain(value), separators=(",", ":"), allow_nan=False)


class PanelServer:
    """Serves the page on the first free port from the wanted one on.

    Args:
        backend: what it shows and asks.
        host: address that it binds to.
        port: 0 is any free one.

    Attributes:
        address: of the page, with the token where one is needed.

    Raises:
        ParameterError: the address cannot be bound to.
    """

    def __init__(self, backend: Backend, host: str, port: int) -> None:
        self.backend, self.access = backend, Access(host)
        self.pages: list[StreamHandler] = []
        self.driver: StreamHandler | None = None
        # The last message of each kind that a page needs which comes later.
        self.kept: dict[str, str] = {}
        logging.getLogger("tornado.access").setLevel(logging.ERROR)
        application = Application(
            [
                (r"/", PageHandler, {"server": self, "file": "panel.html"}),
                (r"/(panel\.js|panel\.css)", PageHandler, {"server": self}),
                (r"/stream", StreamHandler, {"server": self}),
                (r"/report", ReportHandler, {"server": self}),
                (r"/why", WhyHandler, {"server": self}),
            ],
            websocket_ping_interval=PING,
            websocket_ping_timeout=PATIENCE,
            websocket_max_message_size=LONGEST_MESSAGE,
        )
        self._sockets, self.moved = _bound(host, port)
        self._http = HTTPServer(application)
        number = self._sockets[0].getsockname()[1]
        name = socket.gethostname() if host in ("0.0.0.0", "::", "") else host
        query = f"?token={self.access.token}" if self.access.token else ""
        self.address = f"http://{f'[{name}]' if ':' in name else name}:{number}/{query}"

    def begin(self) -> None:
        """Answer requests, in the loop that runs."""
        self._http.add_sockets(self._sockets)

    def send(
        self, kind: str, value: Mapping[str, object], *, keep: bool = False
    ) -> None:
        """Send to every page; one that is still busy with the last message is passed
        over, unless this one is kept for it.

        Args:
            kind: of the message.
            value: its fields.
            keep: whether pages that are busy, or come later, get it too.
        """
        text = to_json({"kind": kind, **value})
        if keep:
            self.kept[kind] = text
        for page in self.pages:
            page.push(kind, text, keep)

    def joined(self, page: StreamHandler, wants: bool) -> None:
        """Take a page in; it drives where it wants to and nobody else does."""
        self.pages.append(page)
        self.backend.watched(len(self.pages))
        page.say("setup", self.backend.setup())
        for kind, text in self.kept.items():
            page.push(kind, text, True)
        self.take_over(page if wants and self.driver is None else self.driver)

    def left(self, page: StreamHandler) -> None:
        """Let a page go: nothing is asked of the robot, which stays to the controller's
        own rules.
        """
        if page in self.pages:
            self.pages.remove(page)
            self.backend.watched(len(self.pages))
            self.take_over(None if page is self.driver else self.driver)

    def take_over(self, page: StreamHandler | None) -> None:
        """Let this page drive from now on, and all others watch; None lets nobody
        drive.
        """
        self.driver = page
        for one in self.pages:
            one.say(
                "driver",
                {
                    "driver": "you" if one is page else "another" if page else "nobody",
                    "viewers": len(self.pages),
                },
            )

    def close(self) -> None:
        """Let go of the port and the pages."""
        self._http.stop()
        for page in list(self.pages):
            page.close(1001, "the panel ends")


def _bound(host: str, port: int) -> tuple[list[socket.socket], bool]:
    """Return sockets on the first free port, and whether that is another than the
    wanted one.
    """
    last = port + (PORTS_TRIED if port else 1)
    for number in range(port, min(last, 65536)):
        try:
            sockets = bind_sockets(number, host)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                continue
            why = error.strerror or error
            raise ParameterError(
                f"parameter 'host' = {host!r}, port {number} cannot be bound to: {why}"
            ) from error
        if number:
            return sockets, number != port
        for extra in sockets[1:]:  # localhost is two addresses, each with its free port
            extra.close()
        return sockets[:1], False
    others = last - port - 1
    raise ParameterError(
        f"parameter 'port' = {port}; it and the {others} after it are taken on {host}:"
        " name another, 0 is any"
    )


class _GuardedHandler(RequestHandler):
    """Lets a request in, or refuses it with a sentence."""

    def initialize(self, server: PanelServer) -> None:
        """Take the server."""
        self.server = server

    def prepare(self) -> None:
        """Refuse what is not let in."""
        headers = self.request.headers
        origin = headers.get("Origin") or headers.get("Sec-Websocket-Origin")
        why = self.server.access.refusal(
            self.request.host, origin, self.get_query_argument("token", "")
        )
        if why:
            self.server.backend.told(
                f"refused a request of {self.request.remote_ip}: {why}"
            )
            self.set_status(403)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            raise Finish(f"{why}\n")

    def set_default_headers(self) -> None:
        """Tell a browser what it may do with the page."""
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")


class PageHandler(_GuardedHandler):
    """Gives out the page's files."""

    def initialize(self, server: PanelServer, file: str = "") -> None:
        """Take the server, and the file unless the address names it."""
        super().initialize(server)
        self._file = file

    def prepare(self) -> None:
        """Let style and script out without a token, which they do not carry; the page
        itself explains what is missing.
        """
        if self.server.access.token:
            return
        super().prepare()

    def get(self, name: str = "") -> None:
        """Send a file of ``static``; the style begins with the package's own."""
        name = self._file or name
        folder = files("dextar_control.panel").joinpath("static")
        text = folder.joinpath(name).read_text(encoding="utf-8")
        suffix = name.rpartition(".")[2]
        kind = "javascript" if suffix == "js" else suffix
        self.set_header("Content-Type", f"text/{kind}; charset=utf-8")
        self.finish(f"{style.css()}\n{text}" if name.endswith(".css") else text)


class WhyHandler(_GuardedHandler):
    """Tells the page why a stream would be refused, which a browser does not; nothing
    where it would not be.
    """

    def get(self) -> None:
        """Answer nothing: the request is let in."""


class ReportHandler(_GuardedHandler):
    """Gives out the page of the last run."""

    async def get(self) -> None:
        """Send it as it was made; its scripts may draw, but not ask the panel."""
        page = self.server.backend.report()
        if page is None:
            self.set_status(404)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish("no report has been made yet: ask the panel for one\n")
            return
        self.set_header("Content-Security-Policy", "sandbox allow-scripts allow-popups")
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(await asyncio.to_thread(page.read_bytes))


class StreamHandler(_GuardedHandler, WebSocketHandler):
    """Sends one page what it shows and takes its commands."""

    def initialize(self, server: PanelServer) -> None:
        """Take the server."""
        super().initialize(server)
        self._flight: asyncio.Future[None] | None = None
        self._owed: dict[str, str] = {}

    def check_origin(self, origin: str) -> bool:
        """Allow every origin that ``prepare`` has let in."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """Show everything from now on."""
        self.set_nodelay(True)
        if len(self.server.pages) >= MOST_VIEWERS:
            self.close(1013, f"{MOST_VIEWERS} pages look on already; close one")
            return
        self.server.joined(self, self.get_query_argument("drive", "1") == "1")

    def on_close(self) -> None:
        """Take note that the page is gone, or asleep for too long."""
        self.server.left(self)

    def say(self, kind: str, value: Mapping[str, object]) -> None:
        """Send to this page alone."""
        number = value.get("number", "")  # answers are all of them kept
        self.push(f"{kind}{number}", to_json({"kind": kind, **value}), True)

    def push(self, kind: str, text: str, keep: bool) -> None:
        """Send a text, unless the last one is still under way: then the newest of what
        is kept is sent after it.
        """
        if self._flight is not None and not self._flight.done():
            if keep:
                self._owed[kind] = text
            if len(self._owed) > MOST_OWED:
                self.close(1008, "the page does not read what it asks for")
            return
        self._flight = asyncio.ensure_future(self._write([text]))

    async def _write(self, texts: list[str]) -> None:
        try:
            while texts:
                for text in texts:
                    await self.write_message(text)
                texts, self._owed = list(self._owed.values()), {}
        except WebSocketClosedError:
            self._owed = {}

    def on_message(self, message: str | bytes) -> None:
        """Take a command ``{"ask": name, "number": n, ...}``, which is answered with
        its number.
        """
        try:
            asked = json.loads(message)
            name, number = str(asked["ask"]), int(asked["number"])
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            self.say(
                "answer",
                {
                    "number": 0,
                    "ok": False,
                    "text": "that is no command of this panel: load the page again",
                },
            )
            return
        answer = partial(self._answer, number)
        if name == "drive":
            self.server.take_over(self)
            answer(True, "this page drives", {})
        elif name not in FOR_ALL and self.server.driver is not self:
            who = "another page drives" if self.server.driver else "nobody drives"
            answer(False, f"this page watches, and {who}: take over first", {})
        else:
            try:
                self.server.backend.ask(name, asked, answer)
            except DextarError as error:
                answer(False, str(error), {})
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                answer(False, f"'{name}' cannot be done with that: {error!r}", {})

    def _answer(
        self, number: int, ok: bool, text: str, more: Mapping[str, object]
    ) -> None:
        self.say("answer", {"number": number, "ok": ok, "text": text, **more})
