"""A page: viser's server, with the page server in place of viser's own listener."""

from __future__ import annotations

import contextlib
import io
import threading
from collections.abc import Callable, Iterator
from typing import Any

from spatula_env.installing import install_hint
from spatula_env.teleop.web.access import Doorkeeper, find_token
from spatula_env.teleop.web.operator_input import KEYS, SLOW_KEYS, OperatorInput
from spatula_env.teleop.web.page_server import PageServer

_REPLACING = threading.Lock()
"""Held while a name in another package is replaced."""


class Page:
    """A page that any number of browsers can open; all show the same.

    Attributes:
        server: viser's server, for adding things to the page.
        operator_input: Keys and mouse input of the page.
        messages: Filter of all other input of the page.
        url: URL to open in a browser on this machine, with the token.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 8080,
        token: str | None = None,
        *,
        keys: tuple[str, ...] = (),
        on_key: Callable[[str], None] = lambda key: None,
    ) -> None:
        """Serve the page.

        Args:
            host: Address to listen on.
            port: Port to listen on; 0 for any that is free.
            token: Token required to open it; None for the value of the environment variable SPATULA_TOKEN, or for none,
                which is allowed on a loopback address only.
            keys: Codes of further keys to report, in addition to those that move the tool.
            on_key: Called with the code of a key that is pressed, in the page's thread.

        Raises:
            ImportError: If viser is missing.
            ValueError: If a token is required and missing.
            DeviceBusy: If the port is taken.
        """
        viser = require_viser()
        # Imported here because it needs viser's dependencies.
        from spatula_env.teleop.web.messages import MessageFilter

        doorkeeper = Doorkeeper(host, find_token(token))
        self.operator_input = OperatorInput()
        self.messages = MessageFilter()
        self._page_server = PageServer(
            doorkeeper, port, self.operator_input, self.messages, (*KEYS, *SLOW_KEYS, *keys), on_key
        )
        # viser prints an address that is not to be used, so redirect its output.
        with _served_by(self._page_server) as host, contextlib.redirect_stdout(io.StringIO()):
            self.server: Any = viser.ViserServer(host=host, port=0, verbose=False)
        # A page may ask viser to share the scene on the internet; refuse.
        self.server.request_share_url = _do_not_share
        self.messages.server = self.server
        try:
            self._page_server.check()
        except BaseException:
            self._stop_server()
            raise
        self.url = doorkeeper.address(self._page_server.port)

    def take_focus(self) -> None:
        """Return the keyboard focus from the panel to the tool."""
        self._page_server.tell({"blur": True})

    def notify(self, title: str, text: str, *, color: Any = None) -> None:
        """Show a notification on all pages for a few seconds."""
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=5.0, color=color)

    def close(self) -> None:
        """Close all connections. Closing twice is allowed."""
        self._page_server.close()
        self._stop_server()

    def _stop_server(self) -> None:
        if self.server is not None:
            server, self.server = self.server, None
            with contextlib.redirect_stdout(io.StringIO()):
                server.stop()


class _Marked(str):
    """An address recognised by its identity; its value is a loopback address, in case viser uses it literally."""


@contextlib.contextmanager
def _served_by(page_server: PageServer) -> Iterator[str]:
    """Make viser's constructor use the page server instead of its own.

    viser's constructor starts `websockets.asyncio.server.serve` with the address that it is given, and offers no other
    way to restrict connections. So while this context is active, that function starts the page server when called with
    the address that this yields; all other calls are unaffected.
    """
    from websockets.asyncio import server

    host = _Marked("127.0.0.1")
    with _REPLACING:
        original: Any = server.serve

        def serve(handler: Any, given: Any = None, *arguments: Any, **options: Any) -> Any:
            if given is host:
                return page_server.serve(handler, **options)
            return original(handler, given, *arguments, **options)

        server.serve = serve  # type: ignore[assignment, misc]
        try:
            yield host
        finally:
            server.serve = original  # type: ignore[misc]


def require_viser() -> Any:
    """Import viser.

    Raises:
        ImportError: If it is missing; the message says what to install.
    """
    try:
        import viser
    except ImportError as error:
        raise ImportError(f"the web device needs viser: {install_hint('web')}") from error
    return viser


def _do_not_share(*_: Any, **__: Any) -> None:
    return None
