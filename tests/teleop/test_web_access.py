"""Who may open the page."""

from __future__ import annotations

from http import HTTPStatus

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop.web.access import Doorkeeper, is_loopback

TOKEN = "open sesame & shut?"


def head(**more):
    return {"Host": "127.0.0.1:8080", **more}


@pytest.mark.parametrize("host", ["127.0.0.1", "127.3.4.5", "::1", "localhost", "LOCALHOST"])
def test_loopback_addresses(host):
    assert is_loopback(host)
    Doorkeeper(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.1.5", "example.org", "127.0.0.1.example.org"])
def test_elsewhere_there_has_to_be_a_token(host):
    assert not is_loopback(host)
    with pytest.raises(ValueError, match="token must be given where others can connect"):
        Doorkeeper(host)
    Doorkeeper(host, TOKEN)


def test_a_token_has_to_be_long():
    with pytest.raises(ValueError, match="8 characters or more, got 7"):
        Doorkeeper("0.0.0.0", "x" * 7)


@pytest.mark.parametrize(
    ("host", "address"),
    [
        ("127.0.0.1", "http://127.0.0.1:80/"),
        ("::1", "http://[::1]:80/"),
        ("localhost", "http://localhost:80/"),
    ],
)
def test_address(host, address):
    assert Doorkeeper(host).address(80) == address


def test_address_with_a_token_for_this_machine():
    assert Doorkeeper("0.0.0.0", "a b/c&d=eé").address(81) == "http://127.0.0.1:81/?token=a+b%2Fc%26d%3De%C3%A9"


@pytest.mark.parametrize("name", ["127.0.0.1:8080", "localhost:9", "[::1]:1"])
def test_on_loopback_everybody_of_this_machine_comes_in(name):
    door = Doorkeeper("127.0.0.1")
    assert door.judge("/", {"Host": name}).status is HTTPStatus.OK
    assert door.judge("/", {"Host": name, "Origin": f"http://{name}"}).status is HTTPStatus.OK


@pytest.mark.parametrize(
    "headers",
    [
        head(Origin="http://evil.example"),
        head(Origin="http://127.0.0.1:8081"),
        head(Origin="null"),
        # A name that somebody else owns, and points here.
        {"Host": "evil.example:8080", "Origin": "http://evil.example:8080"},
        {"Host": "evil.example"},
        {},
    ],
)
def test_no_page_of_another_site_comes_in(headers):
    assert Doorkeeper("127.0.0.1").judge("/", headers).status is HTTPStatus.FORBIDDEN


def test_the_token_is_asked_for_once():
    door = Doorkeeper("0.0.0.0", TOKEN)
    assert door.judge("/", head()).status is HTTPStatus.UNAUTHORIZED
    address = door.address(8080)
    welcome = door.judge(address[address.index("/", 8) :], head())
    assert welcome.status is HTTPStatus.SEE_OTHER
    assert welcome.headers["Location"] == "/"
    assert TOKEN not in str(welcome.headers)
    crumb = welcome.headers["Set-Cookie"]
    assert "HttpOnly" in crumb and "SameSite=Lax" in crumb
    cookie = "other=1; " + crumb.partition(";")[0]
    assert door.judge("/", head(Cookie=cookie)).status is HTTPStatus.OK
    # Not from another page, and not with another run's cookie.
    assert door.judge("/", head(Cookie=cookie, Origin="http://evil.example")).status is HTTPStatus.FORBIDDEN
    assert Doorkeeper("0.0.0.0", TOKEN).judge("/", head(Cookie=cookie)).status is HTTPStatus.UNAUTHORIZED


def test_a_token_counts_on_loopback_too():
    assert Doorkeeper("127.0.0.1", TOKEN).judge("/", head()).status is HTTPStatus.UNAUTHORIZED


@given(st.text(), st.text())
def test_nothing_else_opens(query, cookie):
    door = Doorkeeper("0.0.0.0", TOKEN)
    for target in (f"/?{query}", f"/?token={query}", query):
        if "open" not in query:
            verdict = door.judge(target, head(Cookie=cookie))
            assert verdict.status is HTTPStatus.UNAUTHORIZED
            assert not verdict.headers
