"""Access to the page: which requests are accepted."""

from __future__ import annotations

import os
from http import HTTPStatus

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop.web.access import Doorkeeper, GuessLimit, find_token, is_loopback

TOKEN = "open sesame & shut?"


def head(**more):
    return {name.lower(): [value] for name, value in {"Host": "127.0.0.1:8080", **more}.items()}


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
    assert door.judge("/", head(Host=name)).status is HTTPStatus.OK
    assert door.judge("/", head(Host=name, Origin=f"http://{name}")).status is HTTPStatus.OK


@pytest.mark.parametrize(
    "headers",
    [
        head(Origin="http://evil.example"),
        head(Origin="http://127.0.0.1:8081"),
        head(Origin="null"),
        # The right host, and not by what it is served by.
        head(Origin="https://127.0.0.1:8080"),
        head(Origin="chrome-extension://127.0.0.1:8080"),
        head(Origin="ws://127.0.0.1:8080"),
        head(Origin="http://127.0.0.1:8080", **{"X-Forwarded-Proto": "https"}),
        head(Origin="ftp://127.0.0.1:8080", **{"X-Forwarded-Proto": "ftp"}),
        # A name that somebody else owns, and points here.
        head(Host="evil.example:8080", Origin="http://evil.example:8080"),
        head(Host="evil.example"),
        head(Host="127.0.0.1.evil.example"),
        # What is embedded in a page comes without Origin.
        head(**{"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}),
        head(**{"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"}),
    ],
)
def test_no_page_of_another_site_comes_in(headers):
    assert Doorkeeper("127.0.0.1").judge("/", headers).status is HTTPStatus.FORBIDDEN


def test_a_server_with_tls_in_front_says_so():
    headers = head(Host="tools.example", Origin="https://tools.example", **{"X-Forwarded-Proto": "https"})
    assert Doorkeeper("tools.example", TOKEN).judge("/", headers).status is HTTPStatus.UNAUTHORIZED
    assert (
        Doorkeeper("127.0.0.1")
        .judge("/", head(Origin="https://127.0.0.1:8080", **{"X-Forwarded-Proto": "https"}))
        .status
        is HTTPStatus.OK
    )


def test_a_link_from_another_page_may_be_followed():
    headers = head(**{"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"})
    assert Doorkeeper("127.0.0.1").judge("/", headers).status is HTTPStatus.OK


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"host": []},
        {"host": ["127.0.0.1:8080", "127.0.0.1:8080"]},
        head(Host=""),
        head(Host="["),
        head(Host="[::1"),
        head(Host="127.0.0.1:port"),
        head(Host="127.0.0.1:99999"),
        head(Host="127.0.0.1:8080/"),
        head(Host="a@127.0.0.1:8080"),
        head(Host="127.0.0.1:8080\udcff"),
        head(Origin=""),
        head(Origin="https://"),
        head(Origin="http://"),
        head(Origin="chrome-extension://"),
        head(Origin="http://:8080"),
        head(Host=":8080"),
        head(Origin="http://["),
        head(Origin="127.0.0.1:8080"),
        head(Origin="http://127.0.0.1:8080/path"),
        {**head(), "origin": ["http://127.0.0.1:8080", "http://evil.example"]},
    ],
)
@pytest.mark.parametrize("token", [None, TOKEN])
def test_what_no_browser_sends_is_a_bad_request(headers, token):
    assert Doorkeeper("127.0.0.1", token).judge("/", headers).status is HTTPStatus.BAD_REQUEST


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


ANYTHING = st.text(st.characters(codec="ascii") | st.characters(min_codepoint=0xDC80, max_codepoint=0xDCFF))
"""As servers read headers: bytes beyond ASCII are lone surrogates."""


@given(
    target=ANYTHING,
    headers=st.dictionaries(
        st.sampled_from(["host", "origin", "cookie", "sec-fetch-site", "sec-fetch-mode", "upgrade"]),
        st.lists(ANYTHING | st.sampled_from(["127.0.0.1", "http://127.0.0.1", "http://["]), max_size=2),
    ),
    token=st.sampled_from([None, TOKEN]),
)
def test_there_is_an_answer_to_everything(target, headers, token):
    verdict = Doorkeeper("127.0.0.1", token).judge(target, headers)
    assert verdict.status is HTTPStatus.OK or 400 <= verdict.status < 500


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def guess(door, token, address):
    return door.judge(f"/?token={token}", head(), address).status


def test_who_guesses_has_to_wait():
    clock = Clock()
    door = Doorkeeper("0.0.0.0", "a-long-token", clock)
    assert [guess(door, "wrong", "10.0.0.1") for _ in range(5)] == [HTTPStatus.UNAUTHORIZED] * 5
    refused = door.judge("/?token=wrong", head(), "10.0.0.1")
    assert refused.status is HTTPStatus.TOO_MANY_REQUESTS
    assert refused.headers == {"Retry-After": "30"}
    # Else the answer would still tell which guess is right.
    assert guess(door, "a-long-token", "10.0.0.1") is HTTPStatus.TOO_MANY_REQUESTS
    assert guess(door, "a-long-token", "10.0.0.2") is HTTPStatus.SEE_OTHER
    # Looking at the page is no guess.
    assert door.judge("/", head(), "10.0.0.1").status is HTTPStatus.UNAUTHORIZED
    clock.now = 30.0
    assert guess(door, "wrong", "10.0.0.1") is HTTPStatus.UNAUTHORIZED
    assert guess(door, "wrong", "10.0.0.1") is HTTPStatus.TOO_MANY_REQUESTS
    clock.now = 60.0
    assert guess(door, "a-long-token", "10.0.0.1") is HTTPStatus.SEE_OTHER


@pytest.mark.parametrize("address", ["10.0.{}.1", "2001:db8:{}::1", "nobody knows {}"])
def test_nor_do_many_addresses_help(address):
    clock = Clock()
    door = Doorkeeper("0.0.0.0", "a-long-token", clock)
    answers = [guess(door, "wrong", address.format(number)) for number in range(60)]
    assert answers == [HTTPStatus.UNAUTHORIZED] * 50 + [HTTPStatus.TOO_MANY_REQUESTS] * 10
    crumb = door.judge("/?token=a-long-token", head(), "10.9.9.9")
    assert crumb.status is HTTPStatus.TOO_MANY_REQUESTS
    clock.now = 3.0
    assert guess(door, "a-long-token", "10.9.9.9") is HTTPStatus.SEE_OTHER


def test_all_addresses_of_a_network_of_version_6_are_one():
    door = Doorkeeper("0.0.0.0", "a-long-token", Clock())
    answers = [guess(door, "wrong", f"2001:db8::{number:x}") for number in range(6)]
    assert answers[-1] is HTTPStatus.TOO_MANY_REQUESTS
    answers = [guess(door, "wrong", address) for address in ["::ffff:10.0.0.1", "10.0.0.1"] * 3]
    assert answers[-1] is HTTPStatus.TOO_MANY_REQUESTS


@given(st.lists(st.tuples(st.integers(0, 5), st.floats(0.0, 10.0)), max_size=80))
def test_guesses_are_no_more_than_allowed(guesses):
    clock = Clock()
    limit = GuessLimit(clock)
    counted = dict.fromkeys(range(6), 0)
    for who, passed in guesses:
        clock.now += passed
        if limit.wait(f"10.0.0.{who}") <= 0.0:
            limit.count(f"10.0.0.{who}")
            counted[who] += 1
        assert all(count <= 5 + clock.now / 30.0 + 1e-6 for count in counted.values())
        assert sum(counted.values()) <= 50 + clock.now / 3.0 + 1e-6


def test_where_the_token_comes_from(tmp_path, monkeypatch):
    monkeypatch.delenv("SPATULA_TOKEN", raising=False)
    assert find_token() is None
    assert find_token("as it is") == "as it is"
    file = tmp_path / "token"
    file.write_text("from a file\n")
    file.chmod(0o600)
    assert find_token(file=file) == "from a file"
    monkeypatch.setenv("SPATULA_TOKEN", "from a variable")
    assert find_token() == "from a variable"
    assert find_token("as it is") == "as it is"
    assert find_token(file=file) == "from a file"
    with pytest.raises(ValueError, match="got both"):
        find_token("as it is", file)
    file.write_text("\n")
    with pytest.raises(ValueError, match="got an empty file"):
        find_token(file=file)


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_token_that_others_can_read_is_none(tmp_path):
    file = tmp_path / "token"
    file.write_text("from a file")
    file.chmod(0o644)
    with pytest.raises(ValueError, match="must be readable by you alone: chmod 600"):
        find_token(file=file)
