"""One page: viser's server, and the gate in front of it."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from typing import Any

from spatula_env.teleop.web.access import Doorkeeper
from spatula_env.teleop.web.gate import Gate
from spatula_env.teleop.web.hands import KEYS, SLOW_KEYS, Hands


class Page:
    """What browsers open; any number of them, and all see the same.

    Attributes:
        server: viser's, to put things on the page.
        hands: What is done on it.
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
            token: What has to be known to open it; None: nothing, which is allowed on a loopback address only.
            keys: Further keys to tell of, beside those that move the tool.
            on_key: Called with the code of a key that is pressed, by a thread of the page's.

        Raises:
            ImportError: If viser is missing.
            ValueError: If there is no token where there has to be one.
            DeviceBusy: If the port is taken.
        """
        viser = require_viser()
        doorkeeper = Doorkeeper(host, token)
        self.hands = Hands()
        # It tells everybody the address that nobody is to use.
        with contextlib.redirect_stdout(io.StringIO()):
            self.server: Any = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        # A page may ask for the scene to be shown to the whole world; not here.
        self.server.request_share_url = _do_not_share
        try:
            all_keys = (*KEYS, *SLOW_KEYS, *keys)
            self._gate = Gate(doorkeeper, port, self.server.get_port(), self.hands, all_keys, on_key)
        except BaseException:
            self._stop_server()
            raise
        self.url = doorkeeper.address(self._gate.port)

    def take_focus(self) -> None:
        """Have the keys go to the tool again, and to no part of the panel."""
        self._gate.tell({"blur": True})

    def notify(self, title: str, text: str, *, color: Any = None) -> None:
        """Say something on all pages, for a few seconds."""
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=5.0, color=color)

    def close(self) -> None:
        """Close all connections. Closing twice is allowed."""
        self._gate.close()
        self._stop_server()

    def _stop_server(self) -> None:
        if self.server is not None:
            server, self.server = self.server, None
            with contextlib.redirect_stdout(io.StringIO()):
                server.stop()


def require_viser() -> Any:
    """Import viser.

    Raises:
        ImportError: If it is missing; says what to install.
    """
    try:
        import viser
    except ImportError as error:
        raise ImportError("the web device needs viser: pip install 'spatula-env[web]'") from error
    return viser


def _do_not_share(*_: Any, **__: Any) -> None:
    return None
