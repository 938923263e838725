"""Access control: who may open the page, and from where.

On a loopback address, every user of this machine may connect, but no page of another site may: a browser with such a
page open would otherwise connect to this machine on its behalf. On other addresses a token is required once; from then
on a cookie proves that it was known. Wrong guesses are rate-limited.
"""

from __future__ import annotations

import hmac
import ipaddress
import math
import os
import re
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from urllib.parse import parse_qs, urlencode

SHORTEST_TOKEN = 8
"""Least number of characters in a token."""

TOKEN = "token"
"""Name of the token in a URL's query."""
TOKEN_VARIABLE = "SPATULA_TOKEN"
"""Environment variable that holds the token, if none is given."""

_AUTHORITY = r"(?P<name>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_~-]+(?:\.[A-Za-z0-9_~-]+)*\.?)(?::(?P<port>[0-9]{1,5}))?"
_HOST = re.compile(_AUTHORITY)
_ORIGIN = re.compile(rf"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*)://(?P<authority>{_AUTHORITY})")


class MalformedHeader(ValueError):
    """A header that no browser would send; the message names it."""


class GuessLimit:
    """Rate limit for guessing a token: a few guesses at once, then one from time to time.

    A token bucket: every wrong guess takes from a store that refills; one store for each address, and one for all
    together.
    """

    EACH = (5, 30.0)
    """Number of guesses of one address, and the time in which one is regained [s]."""
    ALL = (50, 3.0)
    """The same for all addresses together."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start with full stores.

        Args:
            clock: Returns the time [s].
        """
        self._clock = clock
        self._full: dict[str, float] = {}

    def wait(self, address: str) -> float:
        """Time that an address has to wait before it may guess [s]; 0 if it need not."""
        now = self._clock()
        return max(
            0.0,
            *(
                self._full.get(who, now) - now - (most - 1) * seconds
                for who, (most, seconds) in ((_network(address), self.EACH), ("", self.ALL))
            ),
        )

    def count(self, address: str) -> None:
        """Count a wrong guess of an address."""
        now = self._clock()
        # A full store equals a new one, so only addresses with recent guesses are kept.
        self._full = {who: when for who, when in self._full.items() if when > now}
        for who, (_, seconds) in ((_network(address), self.EACH), ("", self.ALL)):
            self._full[who] = max(now, self._full.get(who, now)) + seconds


@dataclass(frozen=True)
class Verdict:
    """Decision on a request.

    Attributes:
        status: OK to admit it; SEE_OTHER if the token was right; anything else is a refusal: BAD_REQUEST, FORBIDDEN,
            UNAUTHORIZED, TOO_MANY_REQUESTS.
        headers: Headers of the answer.
        reason: Explanation for a refusal.
    """

    status: HTTPStatus
    headers: Mapping[str, str] = field(default_factory=dict)
    reason: str = ""


class Doorkeeper:
    """Decides which requests to admit.

    Attributes:
        host: Address at which the page is served.
        token: Token that is required; None for none.
    """

    def __init__(self, host: str, token: str | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """Set the rules.

        Args:
            host: Address at which the page is served.
            token: Token that is required; None for none, which is allowed on a loopback address only.
            clock: Returns the time [s].

        Raises:
            ValueError: If a token is required and missing, or it is too short.
        """
        if token is None and not is_loopback(host):
            raise ValueError(
                f"token must be given where others can connect, got none for host={host!r}; "
                f"any secret will do, such as secrets.token_urlsafe(), in {TOKEN_VARIABLE}, in a file or as an option; "
                "or take host='127.0.0.1'"
            )
        if token is not None and len(token) < SHORTEST_TOKEN:
            raise ValueError(f"token must have {SHORTEST_TOKEN} characters or more, got {len(token)}")
        self.host, self.token = host, token
        self._secret = secrets.token_urlsafe(32)
        self._guesses = GuessLimit(clock)

    def address(self, port: int) -> str:
        """URL to open in a browser on this machine, with the token."""
        host = "127.0.0.1" if self.host in ("", "0.0.0.0") else "::1" if self.host == "::" else self.host
        shown = f"[{host}]" if ":" in host else host
        query = "" if self.token is None else "?" + urlencode({TOKEN: self.token})
        return f"http://{shown}:{port}/{query}"

    def judge(self, target: str, headers: Mapping[str, Sequence[str]], address: str = "") -> Verdict:
        """Decide about a request.

        Args:
            target: Path and query of the request.
            headers: All values of each header, by its name in lower case.
            address: Address of the client.
        """
        try:
            name, port, own = _site(headers)
        except MalformedHeader as error:
            return Verdict(HTTPStatus.BAD_REQUEST, reason=str(error))
        if not own:
            return Verdict(HTTPStatus.FORBIDDEN, reason="a page of another site may not connect")
        if self.token is None:
            # Without this check, the name of another site could be made to resolve to this machine (DNS rebinding).
            if is_loopback(name) or name == self.host.lower():
                return Verdict(HTTPStatus.OK)
            return Verdict(HTTPStatus.FORBIDDEN, reason="open the page by the name localhost, or serve it with a token")
        # A cookie is shared by all ports of a host, so its name contains the port.
        cookie = f"spatula_{port}"
        if any(_equal(given, self._secret) for given in _cookies(headers, cookie)):
            return Verdict(HTTPStatus.OK)
        given = parse_qs(target.partition("?")[2]).get(TOKEN, [""])[0]
        if given:
            seconds = math.ceil(self._guesses.wait(address))
            if seconds > 0:
                return Verdict(
                    HTTPStatus.TOO_MANY_REQUESTS,
                    {"Retry-After": str(seconds)},
                    f"too many wrong tokens: wait {seconds} s",
                )
            if _equal(given, self.token):
                # Redirect to remove the token from the address bar. With SameSite=Lax, a link to the page works, but a
                # connection from another site does not.
                crumb = f"{cookie}={self._secret}; Path=/; HttpOnly; SameSite=Lax"
                return Verdict(HTTPStatus.SEE_OTHER, {"Location": "/", "Set-Cookie": crumb})
            self._guesses.count(address)
        return Verdict(HTTPStatus.UNAUTHORIZED, reason="this page needs its token")


def find_token(token: str | None = None, file: str | Path | None = None) -> str | None:
    """Determine the token that the page requires.

    A token on the command line is visible to all users of the machine; an environment variable and a file are not.

    Args:
        token: The token itself.
        file: File that holds the token; surrounding white space is ignored.

    Returns:
        The given token, or the file's, or that of the environment variable SPATULA_TOKEN; None if there is none.

    Raises:
        ValueError: If both are given, or the file is empty or can be read by others.
        OSError: If the file cannot be read.
    """
    if token is not None and file is not None:
        raise ValueError("token must be given as it is or in a file, got both")
    if file is None:
        return token if token is not None else os.environ.get(TOKEN_VARIABLE) or None
    place = Path(file)
    if os.name == "posix" and place.stat().st_mode & 0o077:
        raise ValueError(f"{place} must be readable by you alone: chmod 600 {place}")
    found = place.read_text(encoding="utf-8").strip()
    if not found:
        raise ValueError(f"{place} must hold the token, got an empty file")
    return found


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to an address.

    Args:
        host: A name or an address; an empty one stands for all addresses.
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _site(headers: Mapping[str, Sequence[str]]) -> tuple[str, int, bool]:
    """Name and port of the host that a request is for, and whether it comes from no page of another site.

    Raises:
        MalformedHeader: If the headers do not tell.
    """
    asked = _single(headers, "host")
    host = None if asked is None else _HOST.fullmatch(asked)
    if asked is None or host is None or int(host["port"] or 80) > 65535:
        raise MalformedHeader("the header Host must name a host, as browsers do")
    origin = _single(headers, "origin")
    own = True
    if origin is not None:
        found = _ORIGIN.fullmatch(origin)
        if found is None and origin != "null":
            raise MalformedHeader("the header Origin must name a site, as browsers do")
        # A TLS proxy in front sets this header; a page of another site cannot.
        scheme = (_single(headers, "x-forwarded-proto") or "http").strip().lower()
        own = (
            found is not None
            and scheme in ("http", "https")
            and found["scheme"].lower() == scheme
            and found["authority"].lower() == asked.lower()
        )
    # Embedded resources come without Origin; a navigation by a link may come from any site.
    fetched = _single(headers, "sec-fetch-site") in ("cross-site", "same-site")
    if fetched and _single(headers, "sec-fetch-mode") != "navigate":
        own = False
    return host["name"].strip("[]").lower(), int(host["port"] or 80), own


def _single(headers: Mapping[str, Sequence[str]], name: str) -> str | None:
    values = headers.get(name, ())
    if len(values) > 1:
        raise MalformedHeader(f"the header {name.title()} must be there once, got {len(values)}")
    return values[0] if values else None


def _cookies(headers: Mapping[str, Sequence[str]], name: str) -> list[str]:
    pairs = (pair.partition("=") for value in headers.get("cookie", ()) for pair in value.split(";"))
    return [value.strip() for key, _, value in pairs if key.strip() == name]


def _equal(given: str, wanted: str) -> bool:
    """Compare two texts in a time that does not reveal where they differ."""
    return hmac.compare_digest(given.encode(errors="surrogatepass"), wanted.encode(errors="surrogatepass"))


def _network(address: str) -> str:
    """Network that counts as one client: for IPv6 the /64 prefix, as one client has 2^64 addresses there."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address or "unknown"
    if found.version == 4:
        return str(found)
    return str(found.ipv4_mapped or ipaddress.ip_network((found, 64), strict=False))
