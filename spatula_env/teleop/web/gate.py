"""The gate in front of viser's server: it lets in whom the doorkeeper does, and has a line to the pages of its own.

viser's server listens on a loopback port that nobody is told. The gate hands its page out, with a script for the keys,
and passes its messages on in both directions. Its own line, ``/spatula/hand``, is what `hands` is fed by.
"""

from __future__ import annotations

import asyncio
import html
import json
import logging
import socket
import threading
import urllib.request
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from itertools import count
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from spatula_env.teleop.device import DeviceBusy, DeviceError
from spatula_env.teleop.web.access import TOKEN, Doorkeeper
from spatula_env.teleop.web.hands import Hands

if TYPE_CHECKING:
    from websockets.asyncio.client import ClientConnection
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

HAND = "/spatula/hand"
SCRIPT = "/spatula/page.js"

LARGEST_MESSAGE = 50 * 2**20
"""That viser's pages may send [bytes]."""
LARGEST_WORD = 4096
"""That the script may send [bytes]."""
BUFFER = 2**18
"""Kept for a page that is slow [bytes]. What is on the way is old: viser leaves out what is outdated, if it is let."""
STARTING = 20.0
"""How long the gate may take to open [s]."""

ASK = """<!doctype html><meta charset="utf-8"><title>spatula</title>
<style>body{{font:16px system-ui;display:grid;place-content:center;height:90vh;gap:1em;text-align:center}}</style>
<p>{reason}.</p><form><input name="{token}" type="password" autofocus placeholder="token"> <button>Open</button></form>
"""


class Gate:
    """Serves the page at one address, from another thread."""

    def __init__(
        self,
        doorkeeper: Doorkeeper,
        port: int,
        inner_port: int,
        hands: Hands,
        keys: tuple[str, ...],
        on_key: Callable[[str], None],
    ) -> None:
        """Open the gate.

        Args:
            doorkeeper: Who comes in, and at which address.
            port: Where; 0 for any that is free.
            inner_port: Where viser's server is, on 127.0.0.1.
            hands: Fed with what the pages say.
            keys: Codes of the keys that pages tell of.
            on_key: Called with the code of each key when it is pressed, by the gate's thread.

        Raises:
            DeviceBusy: If the port is taken.
            DeviceError: If the address cannot be served at.
        """
        self._doorkeeper, self._hands = doorkeeper, hands
        self._keys, self._on_key = keys, on_key
        self._inner_port = inner_port
        self._document = _with_script(inner_port)
        self._script = files(__package__).joinpath("page.js").read_bytes()
        self._numbers = count()
        self._lines: set[ServerConnection] = set()
        self._loop = asyncio.new_event_loop()
        self._server: Server | None = None
        self._thread = threading.Thread(target=self._run, name="web gate", daemon=True)
        self._thread.start()
        opening = self._call(self._open(port))
        try:
            self.port = opening.result(STARTING)
        except BaseException as error:
            self._stop()
            if isinstance(error, OSError):
                where = f"port {port} of host {doorkeeper.host!r}"
                if error.errno is not None and "in use" in str(error).lower():
                    raise DeviceBusy(f"{where} is in use: choose another with port=, or port=0 for any") from error
                raise DeviceError(f"the page cannot be served at {where}: {error}") from error
            raise

    def tell(self, message: dict[str, Any]) -> None:
        """Send something to the scripts of all pages."""
        text = json.dumps(message)

        async def send() -> None:
            for line in list(self._lines):
                with suppress(Exception):
                    await line.send(text)

        if not self._loop.is_closed():
            self._call(send())

    def close(self) -> None:
        """Close it, and all connections. Closing twice is allowed."""
        if self._server is None:
            return
        server, self._server = self._server, None

        async def shut() -> None:
            server.close()
            await server.wait_closed()

        # Not the built-in one in Python 3.10.
        with suppress(FutureTimeoutError):
            self._call(shut()).result(5.0)
        self._stop()

    # The gate's thread.

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0))
        self._loop.close()

    def _call(self, work: Any) -> Future[Any]:
        return asyncio.run_coroutine_threadsafe(work, self._loop)

    def _stop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)

    async def _open(self, port: int) -> int:
        from websockets.asyncio.server import serve

        logger = logging.getLogger(__name__)
        # Somebody who does not finish what he began to say is no error of ours.
        logger.setLevel(logging.CRITICAL)
        self._server = await serve(
            self._handle,
            self._doorkeeper.host or None,
            port,
            process_request=self._answer,
            select_subprotocol=lambda _, offered: offered[0] if offered else None,
            compression=None,
            max_size=LARGEST_MESSAGE,
            write_limit=BUFFER,
            logger=logger,
        )
        sockets = list(self._server.sockets)
        for one in sockets:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        return int(sockets[0].getsockname()[1])

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        verdict = self._doorkeeper.judge(request.path, request.headers)
        path = urlsplit(request.path).path
        if verdict.status is HTTPStatus.SEE_OTHER:
            return _response(HTTPStatus.SEE_OTHER, b"", "text/plain", **verdict.headers)
        if verdict.status is not HTTPStatus.OK:
            return _response(verdict.status, _refusal(verdict.status, verdict.reason), "text/html")
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return None if path in ("/", HAND) else _response(HTTPStatus.NOT_FOUND, b"not found", "text/plain")
        if path == SCRIPT:
            return _response(HTTPStatus.OK, self._script, "text/javascript")
        if path == "/":
            return _response(HTTPStatus.OK, self._document, "text/html")
        return _response(HTTPStatus.NOT_FOUND, b"not found", "text/plain")

    async def _handle(self, connection: ServerConnection) -> None:
        assert connection.request is not None
        if urlsplit(connection.request.path).path == HAND:
            await self._listen(connection)
        else:
            await self._pass_on(connection)

    async def _listen(self, connection: ServerConnection) -> None:
        """What a page's script says."""
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
                for key in sorted(self._hands.hear(page, *heard)):
                    self._on_key(key)
        except ConnectionClosed:
            pass
        finally:
            self._lines.discard(connection)
            self._hands.leave(page)

    async def _pass_on(self, connection: ServerConnection) -> None:
        """Between a page and viser's server."""
        from websockets.asyncio.client import connect

        line = socket.socket()
        line.setblocking(False)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        await self._loop.sock_connect(line, ("127.0.0.1", self._inner_port))
        protocols: Any = None if connection.subprotocol is None else [connection.subprotocol]
        async with connect(
            f"ws://127.0.0.1:{self._inner_port}/",
            sock=line,
            subprotocols=protocols,
            compression=None,
            max_size=None,
            max_queue=2,
            write_limit=BUFFER,
            ping_interval=None,
            proxy=None,
        ) as inner:
            ways = [asyncio.ensure_future(_pump(*way)) for way in ((connection, inner), (inner, connection))]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)


async def _pump(source: ServerConnection | ClientConnection, sink: ServerConnection | ClientConnection) -> None:
    from websockets.exceptions import ConnectionClosed

    try:
        async for message in source:
            await sink.send(message)
    except ConnectionClosed as error:
        if error.rcvd is not None:
            await sink.close(error.rcvd.code, error.rcvd.reason)
    else:
        # A version of viser that does not suit the page says so when it closes.
        if source.close_code is not None:
            with suppress(Exception):
                await sink.close(source.close_code, source.close_reason or "")


def read_word(word: str | bytes, known: tuple[str, ...]) -> tuple[frozenset[str], bool, int | None] | None:
    """What a page's script has said.

    Args:
        word: The message.
        known: Codes of keys that it may tell of; others are left out.

    Returns:
        The keys that are held, whether the page is hidden, and how many pictures it has drawn, None if it does not say;
        None if that is no message of the script.
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
    return held.intersection(known), bool(said.get("hidden")), frames if isinstance(frames, int) else None


def _with_script(inner_port: int) -> bytes:
    """The page that viser serves, with the script before everything else."""
    with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(
        f"http://127.0.0.1:{inner_port}/", timeout=STARTING
    ) as answer:
        document: bytes = answer.read()
    head, found, rest = document.partition(b"<head>")
    if not found:
        raise DeviceError("the page of this version of viser has no head; take another one")
    return b"".join([head, found, f'<script src="{SCRIPT}"></script>'.encode(), rest])


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
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "X-Frame-Options": "DENY",
                **headers,
            }
        ),
        body,
    )
