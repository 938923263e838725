"""One page: viser, and the server that takes the place of its own."""

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
"""Held while a name in another package stands for something else."""


class Page:
    """A page that any number of browsers open; all see the same.

    Attributes:
        server: viser's, to put things on the page.
        operator_input: What is done on it by keys and mouse.
        messages: What visitors may do on it otherwise.
        url: What to open in a browser on this machine, with the token.
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
        """Serve it.

        Args:
            host: The address to listen at.
            port: Where; 0 for any that is free.
            token: What has to be known to open it; None: what the environment variable SPATULA_TOKEN says, or nothing,
                which is allowed on a loopback address only.
            keys: Further keys to tell of, beside those that move the tool.
            on_key: Called with the code of a key that is pressed, by a thread of the page's.

        Raises:
            ImportError: If viser is missing.
            ValueError: If there is no token where there has to be one.
            DeviceBusy: If the port is taken.
        """
        viser = require_viser()
        # Needs what comes with viser.
        from spatula_env.teleop.web.messages import MessageFilter

        doorkeeper = Doorkeeper(host, find_token(token))
        self.operator_input = OperatorInput()
        self.messages = MessageFilter()
        self._page_server = PageServer(
            doorkeeper, port, self.operator_input, self.messages, (*KEYS, *SLOW_KEYS, *keys), on_key
        )
        # It tells everybody the address that nobody is to use.
        with _served_by(self._page_server) as host, contextlib.redirect_stdout(io.StringIO()):
            self.server: Any = viser.ViserServer(host=host, port=0, verbose=False)
        # A page may ask for the scene to be shown to the whole world; not here.
        self.server.request_share_url = _do_not_share
        self.messages.server = self.server
        try:
            self._page_server.check()
        except BaseException:
            self._stop_server()
            raise
        self.url = doorkeeper.address(self._page_server.port)

    def take_focus(self) -> None:
        """Have the keys go to the tool again, and to no part of the panel."""
        self._page_server.tell({"blur": True})

    def notify(self, title: str, text: str, *, color: Any = None) -> None:
        """Say something on all pages, for a few seconds."""
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
    """An address that is known again by its identity; a loopback one, should viser take it for what it is."""


@contextlib.contextmanager
def _served_by(page_server: PageServer) -> Iterator[str]:
    """Have the page server serve what viser would.

    viser's constructor starts `websockets.asyncio.server.serve` with the address that it is given, and offers no other
    way to say who may connect. So that name stands for the page server meanwhile, if it is called with the address that
    this yields; for all others it stays what it is.
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
        ImportError: If it is missing; says what to install.
    """
    try:
        import viser
    except ImportError as error:
        raise ImportError(f"the web device needs viser: {install_hint('web')}") from error
    return viser


def _do_not_share(*_: Any, **__: Any) -> None:
    return None
