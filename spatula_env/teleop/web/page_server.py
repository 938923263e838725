"""The only listening server; it admits the requests that the doorkeeper admits.

viser has no access control, so it does not listen at all: `PageServer.serve` takes the place of the server that viser
would start, in viser's own thread, and passes admitted connections on to viser. It also serves viser's page with an
additional script for the keys, whose messages over ``/spatula/hand`` go to `operator_input`.
"""

from __future__ import annotations

import asyncio
import html
import json
import logging
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import asynccontextmanager, suppress
from http import HTTPStatus
from importlib.resources import files
from itertools import count
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from spatula_env.teleop.device import DeviceBusy, DeviceError
from spatula_env.teleop.web.access import TOKEN, Doorkeeper
from spatula_env.teleop.web.document import dressed
from spatula_env.teleop.web.operator_input import OperatorInput

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

    from spatula_env.teleop.web.messages import MessageFilter

HAND = "/spatula/hand"
SCRIPT = "/spatula/page.js"

LARGEST_MESSAGE = 2**14
"""Greatest size of a message from viser's pages [bytes]. Permitted messages are short; see `messages`."""
LARGEST_WORD = 4096
"""Greatest size of a message from the script [bytes]."""
MOST_FRAMES = 2**53
"""Greatest number of frames that a page may report."""
BUFFER = 2**18
"""Buffer for a slow page [bytes]. Small, as buffered data are old and viser can only skip what is not yet sent."""
ENDING = 5.0
"""Longest time that closing connections may take [s]."""

ASK = """<!doctype html><meta charset="utf-8"><title>spatula</title>
<style>body{{font:16px system-ui;display:grid;place-content:center;height:90vh;gap:1em;text-align:center}}</style>
<p>{reason}.</p><form><input name="{token}" type="password" autofocus placeholder="token"> <button>Open</button></form>
"""


class PageServer:
    """Serves the page at one address, in viser's thread.

    Attributes:
        port: Port on which it listens; 0 while it does not.
    """

    def __init__(
        self,
        doorkeeper: Doorkeeper,
        port: int,
        operator_input: OperatorInput,
        messages: MessageFilter,
        keys: tuple[str, ...],
        on_key: Callable[[str], None],
    ) -> None:
        """Store the settings of the server.

        Args:
            doorkeeper: Decides about requests, and holds the address to serve at.
            port: Port to listen on; 0 for any that is free.
            operator_input: Receives the reports of the pages' scripts.
            messages: Filters the pages' messages to viser.
            keys: Codes of the keys that pages report.
            on_key: Called with the code of each key when it is pressed, in viser's thread.
        """
        self.port = 0
        self._wanted = port
        self._doorkeeper, self._operator_input, self._messages = doorkeeper, operator_input, messages
        self._keys, self._on_key = keys, on_key
        self._document = _with_script()
        self._script = files(__package__).joinpath("page.js").read_bytes()
        self._numbers = count()
        self._lines: set[ServerConnection] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: Server | None = None
        self._failure: Exception | None = None
        self._draw: Callable[[ServerConnection], Awaitable[None]] | None = None

    @asynccontextmanager
    async def serve(self, draw: Callable[[ServerConnection], Awaitable[None]], **options: Any) -> AsyncIterator[Any]:
        """Listen while this context is active, instead of `websockets.asyncio.server.serve`.

        Errors are kept for `check`, as viser would wait for its server for ever.

        Args:
            draw: viser's connection handler.
            options: viser's options, of which only the choice of a protocol is used.
        """
        from websockets.asyncio.server import serve

        logger = logging.getLogger(__name__)
        # Ignore incomplete handshakes.
        logger.setLevel(logging.CRITICAL)
        self._loop, self._draw = asyncio.get_running_loop(), draw
        try:
            server = await serve(
                self._handle,
                self._doorkeeper.host or None,
                self._wanted,
                process_request=self._answer,
                select_subprotocol=options.get("select_subprotocol"),
                compression=None,
                max_size=LARGEST_MESSAGE,
                write_limit=BUFFER,
                logger=logger,
            )
        except Exception as error:
            self._failure = error
            yield SimpleNamespace(server=SimpleNamespace(sockets=()))
            return
        sockets = list(server.sockets)
        for one in sockets:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        self._server, self.port = server, int(sockets[0].getsockname()[1])
        async with server:
            yield server

    def check(self) -> None:
        """Check that the server listens.

        Raises:
            DeviceBusy: If the port is taken.
            DeviceError: If the address cannot be served, or viser has not started the server.
        """
        error = self._failure
        if error is not None:
            where = f"port {self._wanted} of host {self._doorkeeper.host!r}"
            if isinstance(error, OSError) and error.errno is not None and "in use" in str(error).lower():
                raise DeviceBusy(f"{where} is in use: choose another with port=, or port=0 for any") from error
            raise DeviceError(f"the page cannot be served at {where}: {error}") from error
        if self._server is None:
            raise DeviceError("this version of viser listens by itself, so nobody can guard it; take viser 1.1.1")

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message to the scripts of all pages."""
        text = json.dumps(message)

        async def send() -> None:
            for line in list(self._lines):
                with suppress(Exception):
                    await line.send(text)

        self._call(send())

    def close(self) -> None:
        """Close the server and all connections. Closing twice is allowed."""
        server, self._server = self._server, None
        if server is None:
            return

        async def shut() -> None:
            server.close()
            await server.wait_closed()

        ended = self._call(shut())
        if ended is not None:
            # Not the built-in one in Python 3.10.
            with suppress(FutureTimeoutError):
                ended.result(ENDING)

    def _call(self, work: Any) -> Future[Any] | None:
        """Run work in viser's thread; None if that thread has ended."""
        if self._loop is not None and not self._loop.is_closed():
            with suppress(RuntimeError):
                return asyncio.run_coroutine_threadsafe(work, self._loop)
        work.close()
        return None

    # The following run in viser's thread.

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        address = str(connection.remote_address[0]) if connection.remote_address else ""
        verdict = self._doorkeeper.judge(request.path, _unfolded(request), address)
        path = request.path.partition("?")[0]
        if verdict.status is HTTPStatus.SEE_OTHER:
            return _response(HTTPStatus.SEE_OTHER, b"", "text/plain", **verdict.headers)
        if verdict.status is not HTTPStatus.OK:
            refusal = _refusal(verdict.status, verdict.reason)
            return _response(verdict.status, refusal, "text/html", **verdict.headers)
        if any("websocket" in value.lower() for value in request.headers.get_all("Upgrade")):
            return None if path in ("/", HAND) else _response(HTTPStatus.NOT_FOUND, b"not found", "text/plain")
        if path == SCRIPT:
            return _response(HTTPStatus.OK, self._script, "text/javascript")
        if path == "/":
            return _response(HTTPStatus.OK, self._document, "text/html")
        return _response(HTTPStatus.NOT_FOUND, b"not found", "text/plain")

    async def _handle(self, connection: ServerConnection) -> None:
        assert connection.request is not None and self._draw is not None
        if connection.request.path.partition("?")[0] == HAND:
            await self._listen(connection)
        else:
            # viser only uses attributes that the guard provides or forwards.
            await self._draw(cast("ServerConnection", self._messages.guard(connection)))

    async def _listen(self, connection: ServerConnection) -> None:
        """Process the messages of a page's script."""
        from websockets.exceptions import ConnectionClosed

        page = next(self._numbers)
        self._lines.add(connection)
        try:
            await connection.send(json.dumps({"keys": self._keys}))
            async for word in connection:
                heard = read_word(word, self._keys)
                if heard is None:
                    await connection.close(1008, "not understood")
                    break
                for key in sorted(self._operator_input.hear(page, *heard)):
                    self._on_key(key)
        except ConnectionClosed:
            pass
        finally:
            self._lines.discard(connection)
            self._operator_input.leave(page)


def read_word(word: str | bytes, known: tuple[str, ...]) -> tuple[frozenset[str], bool, int | None] | None:
    """Decode a message of a page's script.

    Args:
        word: The message.
        known: Codes of keys that it may report; others are ignored.

    Returns:
        The keys that are held, whether the page is hidden, and the number of frames that it has drawn (None if it does
        not say); None instead of all if this is not a message of the script.
    """
    if not isinstance(word, str) or len(word) > LARGEST_WORD:
        return None
    try:
        said = json.loads(word)
    except (ValueError, RecursionError):
        return None
    if not isinstance(said, dict) or not isinstance(said.get("keys"), list):
        return None
    held = frozenset(key for key in said["keys"] if isinstance(key, str))
    frames = said.get("frames")
    counted = type(frames) is int and 0 <= frames <= MOST_FRAMES
    return held.intersection(known), bool(said.get("hidden")), frames if counted else None


def _with_script() -> bytes:
    """The page of viser with the script before everything else."""
    try:
        document = files("viser").joinpath("client", "build", "index.html").read_bytes()
    except FileNotFoundError as error:
        raise DeviceError("this version of viser comes without its page; take viser 1.1.1") from error
    try:
        return dressed(document, SCRIPT)
    except ValueError as error:
        raise DeviceError("the page of this version of viser has no head; take viser 1.1.1") from error


def _unfolded(request: Request) -> dict[str, list[str]]:
    """All values of each header by its lower-case name. A header may occur twice; the caller decides about that."""
    values: dict[str, list[str]] = {}
    for name, value in request.headers.raw_items():
        values.setdefault(name.lower(), []).append(value)
    return values


def _refusal(status: HTTPStatus, reason: str) -> bytes:
    reason = html.escape(reason[:1].upper() + reason[1:])
    if status is HTTPStatus.UNAUTHORIZED:
        return ASK.format(reason=reason, token=TOKEN).encode()
    return f"<!doctype html><meta charset=utf-8><title>spatula</title><p>{reason}.".encode()


def _response(status: HTTPStatus, body: bytes, kind: str, **headers: str) -> Response:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    return Response(
        status.value,
        status.phrase,
        Headers(
            {
                "Content-Type": f"{kind}; charset=utf-8",
                "Content-Length": str(len(body)),
                "Cache-Control": "no-store",
                "Connection": "close",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "X-Frame-Options": "DENY",
                **headers,
            }
        ),
        body,
    )
