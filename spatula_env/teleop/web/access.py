"""Who may open the page, and from where.

viser asks nobody for a name, so a gate in front of it does (`gate`). On a loopback address everybody on this machine
may come in, but no page of another site may: a browser that has such a page open would connect to this machine on its
behalf. Elsewhere a token is asked for, once; from then on a cookie shows that it was known.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlencode, urlsplit

SHORTEST_TOKEN = 8
"""Characters in a token, at least."""

TOKEN = "token"
"""The name of the token in an address."""


@dataclass(frozen=True)
class Verdict:
    """What becomes of a request.

    Attributes:
        status: OK to let it in, SEE_OTHER for the token was right, anything else is a refusal.
        headers: For the answer.
        reason: For whoever is refused.
    """

    status: HTTPStatus
    headers: Mapping[str, str] = field(default_factory=dict)
    reason: str = ""


class Doorkeeper:
    """Decides who comes in.

    Attributes:
        host: The address that the page is served at.
        token: What has to be known; None: nothing.
    """

    def __init__(self, host: str, token: str | None = None) -> None:
        """Say who may come in.

        Args:
            host: The address that the page is served at.
            token: What has to be known; None: nothing, which is allowed on a loopback address only.

        Raises:
            ValueError: If there is no token where there has to be one, or it is too short.
        """
        if token is None and not is_loopback(host):
            raise ValueError(
                f"token must be given where others can connect, got none for host={host!r}; "
                "any secret will do, such as secrets.token_urlsafe(), or take host='127.0.0.1'"
            )
        if token is not None and len(token) < SHORTEST_TOKEN:
            raise ValueError(f"token must have {SHORTEST_TOKEN} characters or more, got {len(token)}")
        self.host, self.token = host, token
        self._secret = secrets.token_urlsafe(32)

    def address(self, port: int) -> str:
        """What to open in a browser on this machine, with the token."""
        host = "127.0.0.1" if self.host in ("", "0.0.0.0") else "::1" if self.host == "::" else self.host
        shown = f"[{host}]" if ":" in host else host
        query = "" if self.token is None else "?" + urlencode({TOKEN: self.token})
        return f"http://{shown}:{port}/{query}"

    def judge(self, target: str, headers: Mapping[str, str]) -> Verdict:
        """Decide about a request.

        Args:
            target: Path and query.
            headers: Names in any case, as `websockets.Headers` has them.
        """
        asked, origin = headers.get("Host", ""), headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != asked.lower():
            return Verdict(HTTPStatus.FORBIDDEN, reason="a page of another site may not connect")
        if self.token is None:
            # Without this, another site's name could be made to point here.
            name = urlsplit(f"//{asked}").hostname or ""
            if is_loopback(name) or name == self.host:
                return Verdict(HTTPStatus.OK)
            return Verdict(HTTPStatus.FORBIDDEN, reason="open the page by the name localhost, or serve it with a token")
        cookie = self._cookie_name(asked)
        if hmac.compare_digest(_cookie(headers, cookie).encode(), self._secret.encode()):
            return Verdict(HTTPStatus.OK)
        given = parse_qs(urlsplit(target).query).get(TOKEN, [""])[0]
        if hmac.compare_digest(given.encode(), self.token.encode()):
            # Away with the token from the address bar. Lax: a link to the page works, a connection from elsewhere not.
            crumb = f"{cookie}={self._secret}; Path=/; HttpOnly; SameSite=Lax"
            return Verdict(HTTPStatus.SEE_OTHER, {"Location": "/", "Set-Cookie": crumb})
        return Verdict(HTTPStatus.UNAUTHORIZED, reason="this page needs its token")

    def _cookie_name(self, asked: str) -> str:
        # Cookies are the same for all ports of a host.
        return f"spatula_{urlsplit(f'//{asked}').port or 80}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to an address.

    Args:
        host: A name or an address; an empty one stands for all there are.
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _cookie(headers: Mapping[str, str], name: str) -> str:
    try:
        morsel = SimpleCookie(headers.get("Cookie", "")).get(name)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value
