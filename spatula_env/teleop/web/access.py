"""Who may open the page, and from where.

On a loopback address everybody on this machine may come in, but no page of another site may: a browser that has such a
page open would connect to this machine on its behalf. Elsewhere a token is asked for, once; from then on a cookie shows
that it was known. Whoever guesses has to wait.
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
"""Characters in a token, at least."""

TOKEN = "token"
"""The name of the token in an address."""
TOKEN_VARIABLE = "SPATULA_TOKEN"
"""The environment variable that the token is taken from, if it is not given."""

_AUTHORITY = r"(?P<name>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_~-]+(?:\.[A-Za-z0-9_~-]+)*\.?)(?::(?P<port>[0-9]{1,5}))?"
_HOST = re.compile(_AUTHORITY)
_ORIGIN = re.compile(rf"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*)://(?P<authority>{_AUTHORITY})")


class MalformedHeader(ValueError):
    """A header that no browser sends; the message names it."""


class GuessLimit:
    """How often a token may be guessed: a few times at once, then once in a while.

    Every wrong guess is taken from a store that fills up again; one store for each address, and one for all.
    """

    EACH = (5, 30.0)
    """Guesses of one address, and how long one takes to come back [s]."""
    ALL = (50, 3.0)
    """The same for all addresses together."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Nobody has guessed yet.

        Args:
            clock: What time it is [s].
        """
        self._clock = clock
        self._full: dict[str, float] = {}

    def wait(self, address: str) -> float:
        """How long an address has to wait before it may guess; 0: not at all [s]."""
        now = self._clock()
        return max(
            0.0,
            *(
                self._full.get(who, now) - now - (most - 1) * seconds
                for who, (most, seconds) in ((_network(address), self.EACH), ("", self.ALL))
            ),
        )

    def count(self, address: str) -> None:
        """An address has guessed wrong."""
        now = self._clock()
        # Whose store is full again is as good as new: no more are kept than have guessed lately.
        self._full = {who: when for who, when in self._full.items() if when > now}
        for who, (_, seconds) in ((_network(address), self.EACH), ("", self.ALL)):
            self._full[who] = max(now, self._full.get(who, now)) + seconds


@dataclass(frozen=True)
class Verdict:
    """The verdict on a request.

    Attributes:
        status: OK to let it in, SEE_OTHER for the token was right, anything else is a refusal: BAD_REQUEST, FORBIDDEN,
            UNAUTHORIZED, TOO_MANY_REQUESTS.
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

    def __init__(self, host: str, token: str | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """Say who may come in.

        Args:
            host: The address that the page is served at.
            token: What has to be known; None: nothing, which is allowed on a loopback address only.
            clock: What time it is [s].

        Raises:
            ValueError: If there is no token where there has to be one, or it is too short.
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
            target: Path and query.
            headers: All values of each, by its name in lower case.
            address: Who asks.
        """
        try:
            name, port, own = _site(headers)
        except MalformedHeader as error:
            return Verdict(HTTPStatus.BAD_REQUEST, reason=str(error))
        if not own:
            return Verdict(HTTPStatus.FORBIDDEN, reason="a page of another site may not connect")
        if self.token is None:
            # Without this, another site's name could be made to point here.
            if is_loopback(name) or name == self.host.lower():
                return Verdict(HTTPStatus.OK)
            return Verdict(HTTPStatus.FORBIDDEN, reason="open the page by the name localhost, or serve it with a token")
        # Cookies are the same for all ports of a host.
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
                # Away with the token from the address bar. Lax: a link to the page works, a connection from elsewhere
                # not.
                crumb = f"{cookie}={self._secret}; Path=/; HttpOnly; SameSite=Lax"
                return Verdict(HTTPStatus.SEE_OTHER, {"Location": "/", "Set-Cookie": crumb})
            self._guesses.count(address)
        return Verdict(HTTPStatus.UNAUTHORIZED, reason="this page needs its token")


def find_token(token: str | None = None, file: str | Path | None = None) -> str | None:
    """The token that the page is to ask for.

    What is given on a command line is seen by all who use the machine; a variable and a file are not.

    Args:
        token: As it is.
        file: One that holds it; space around it does not count.

    Returns:
        The token: the one given, or the file's, or that of the variable SPATULA_TOKEN; None if there is none.

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
        host: A name or an address; an empty one stands for all there are.
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _site(headers: Mapping[str, Sequence[str]]) -> tuple[str, int, bool]:
    """The host's name and port that a request is for, and whether no page of another site has sent it.

    Raises:
        MalformedHeader: If that cannot be told.
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
        # A server with TLS in front says so, and no page of another site can.
        scheme = (_single(headers, "x-forwarded-proto") or "http").strip().lower()
        own = (
            found is not None
            and scheme in ("http", "https")
            and found["scheme"].lower() == scheme
            and found["authority"].lower() == asked.lower()
        )
    # What a page embeds comes without Origin; what somebody follows a link to may come from anywhere.
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
    """Whether two texts are equal, in a time that does not tell where they differ."""
    return hmac.compare_digest(given.encode(errors="surrogatepass"), wanted.encode(errors="surrogatepass"))


def _network(address: str) -> str:
    """Whom an address belongs to: one who has an address of version 6 has 2^64 of them."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address or "unknown"
    if found.version == 4:
        return str(found)
    return str(found.ipv4_mapped or ipaddress.ip_network((found, 64), strict=False))
