"""Requests to the page by other sites' pages, and by programs that are not browsers."""

from __future__ import annotations

import contextlib
import http.server
import os
import socket
import threading
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from browsers import open_browser
from hypothesis import given, settings
from hypothesis import strategies as st
from web_helpers import new_page, until

from spatula_env.teleop.web import WebDevice

pytest.importorskip("viser", reason="pip install 'spatula-env[web]'")

# Tries everything that a page may try at a port of this machine, and tells what it got.
PROBE = """async ([hosts, ports, protocol]) => {
  const line = (address) => new Promise((done) => {
    const socket = new WebSocket(address, [protocol]);
    socket.onopen = () => done("open");
    socket.onerror = () => done("refused");
    setTimeout(() => done("silent"), 20000);
  });
  const read = (address, mode) => fetch(address, { mode, credentials: "include" })
    .then((answer) => `${answer.type} ${answer.status}`, () => "refused");
  const got = {};
  for (const host of hosts) for (const port of ports) {
    const site = `${host}:${port}`;
    got[`line ${site}`] = await line(`ws://${site}/`);
    got[`hand ${site}`] = await line(`ws://${site}/spatula/hand`);
    for (const mode of ["cors", "no-cors"]) got[`${mode} ${site}`] = await read(`http://${site}/`, mode);
  }
  return got;
}"""


def listening_ports() -> set[int]:
    """TCP ports that this process listens on, whatever opened them."""
    folder = Path("/proc/self/fd")
    if not folder.exists():
        psutil = pytest.importorskip("psutil", reason="pip install psutil")
        listening = psutil.Process().net_connections("tcp")
        return {each.laddr.port for each in listening if each.status == psutil.CONN_LISTEN}
    mine = set()
    for each in folder.iterdir():
        with contextlib.suppress(OSError):
            mine.add(os.readlink(each))
    ports = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
            cells = line.split()
            if cells[3] == "0A" and f"socket:[{cells[9]}]" in mine:
                ports.add(int(cells[1].rpartition(":")[2], 16))
    return ports


@pytest.fixture(scope="module")
def before():
    return listening_ports()


@pytest.fixture(scope="module")
def device(before):
    with WebDevice(port=0) as opened:
        yield opened


@pytest.fixture(scope="module")
def locked(before):
    with WebDevice(port=0, token="a long enough token") as opened:
        yield opened


def port_of(device) -> int:
    return urlsplit(device.url).port


@contextlib.contextmanager
def other_site():
    """A server with an empty page."""

    class Empty(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>other</title>")

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Empty)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_nothing_listens_but_the_gate(before):
    taken = listening_ports()
    with WebDevice(port=0) as device:
        assert listening_ports() - taken == {port_of(device)}
    until(lambda: listening_ports() == taken, "an end")


def test_a_server_of_somebody_else_is_left_alone(device):
    from websockets.asyncio import server

    assert isinstance(server.serve, type), "websockets' own name stands for something else"


def test_where_the_gate_has_no_part_there_is_no_page(monkeypatch):
    # As a version of viser would be that listens in another way.
    import viser

    from spatula_env.teleop import DeviceError

    taken = listening_ports()
    made = viser.ViserServer
    monkeypatch.setattr(viser, "ViserServer", lambda host, **options: made(host="127.0.0.1", **options))
    with pytest.raises(DeviceError, match="listens by itself"):
        WebDevice(port=0).open()
    until(lambda: listening_ports() == taken, "an end")


@pytest.mark.browser
@pytest.mark.timeout(600)
def test_a_page_of_another_site_gets_nothing(device, before):
    import viser

    protocol = f"viser-v{viser.__version__}"
    with other_site() as foreign, open_browser("--host-resolver-rules=MAP evil.example 127.0.0.1") as browser:
        ports = sorted(listening_ports() - before - {foreign})
        assert port_of(device) in ports
        hosts = ["127.0.0.1", "localhost"]
        for site in (f"127.0.0.1:{foreign}", f"localhost:{foreign}", f"evil.example:{foreign}"):
            page = browser.new_page()
            page.goto(f"http://{site}/")
            got = page.evaluate(PROBE, [hosts, ports, protocol])
            assert set(got.values()) == {"refused"}, (site, got)
            page.close()
        # Another site's name that points here, as DNS rebinding has it: the page is of that origin.
        page = browser.new_page()
        answer = page.goto(f"http://evil.example:{port_of(device)}/")
        assert answer.status == 403
        got = page.evaluate(PROBE, [["evil.example"], ports, protocol])
        assert {got[name] for name in got if not name.startswith(("cors", "no-cors"))} == {"refused"}
        assert {got[name] for name in got if name.startswith(("cors", "no-cors"))} == {"basic 403"}
        page.close()
        # And the page itself, for comparison: the probe finds what is open.
        page = new_page(browser)
        page.goto(device.url)
        got = page.evaluate(PROBE, [["127.0.0.1"], [port_of(device)], protocol])
        assert set(got.values()) == {"open", "basic 200"}
        until(lambda: page.title() and device.page.server.get_clients(), "the page")
        page.close()


def ask(port: int, request: bytes) -> bytes:
    """The head of the answer, or b"" if the connection is closed without a word."""
    answer = b""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as line:
        with contextlib.suppress(ConnectionError):
            line.sendall(request)
            while b"\r\n\r\n" not in answer and (more := line.recv(65536)):
                answer += more
    return answer


@pytest.mark.parametrize("name", ["device", "locked"])
@pytest.mark.parametrize(
    "lines",
    [
        [b"Host: ["],
        [b"Host: 127.0.0.1:port"],
        [b"Host: 127.0.0.1", b"Host: 127.0.0.1"],
        [b"Host: 127.0.0.1", b"Origin: http://["],
        [b"Host: 127.0.0.1", b"Origin: \xff\xfe"],
        [b"Host: 127.0.0.1", b"Origin: null", b"Origin: null"],
        [],
    ],
)
def test_a_malformed_header_is_a_bad_request(request, name, lines):
    port = port_of(request.getfixturevalue(name))
    for more in ([], [b"Upgrade: websocket", b"Connection: Upgrade"]):
        answer = ask(port, b"\r\n".join([b"GET / HTTP/1.1", *lines, *more, b"", b""]))
        assert answer.startswith(b"HTTP/1.1 400 ")


@pytest.mark.parametrize("path", [b"/", b"/spatula/hand"])
@pytest.mark.parametrize("scheme", [b"https", b"chrome-extension", b"file", b"ws", b""])
def test_an_origin_of_another_scheme_gets_no_line(device, path, scheme):
    host = b"127.0.0.1:%d" % port_of(device)
    lines = [
        b"GET " + path + b" HTTP/1.1", b"Host: " + host, b"Upgrade: websocket", b"Connection: Upgrade",
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", b"Sec-WebSocket-Version: 13",
    ]  # fmt: skip
    for origin, statuses in ((b"http://" + host, (b"101",)), (scheme + b"://" + host, (b"400", b"403"))):
        assert ask(port_of(device), b"\r\n".join([*lines, b"Origin: " + origin, b"", b""]))[9:12] in statuses
    assert ask(port_of(device), b"\r\n".join([*lines, b"Origin: " + scheme + b"://", b"", b""]))[9:12] == b"400"


NAMES = st.sampled_from(
    b"Host Origin Cookie Upgrade Connection Sec-WebSocket-Key Sec-WebSocket-Version Sec-WebSocket-Protocol "
    b"Sec-WebSocket-Extensions Sec-Fetch-Site Sec-Fetch-Mode X".split()
)
USUAL = st.sampled_from(
    [b"127.0.0.1", b"http://127.0.0.1", b"websocket", b"Upgrade", b"13", b"cross-site", b"http://["]
)


@settings(max_examples=200, deadline=None)
@given(
    target=st.binary(max_size=20) | st.sampled_from([b"/", b"/spatula/hand", b"//[", b"/?token=%ff"]),
    headers=st.lists(st.tuples(NAMES, USUAL | st.binary(max_size=20)), max_size=8),
    name=st.sampled_from(["device", "locked"]),
)
def test_no_bytes_break_the_server(device, locked, target, headers, name):
    port = port_of({"device": device, "locked": locked}[name])
    lines = [b"GET " + target + b" HTTP/1.1", *(key + b": " + value for key, value in headers), b"", b""]
    answer = ask(port, b"\r\n".join(lines))
    # What is no HTTP at all is hung up on.
    assert not answer or answer[9:12] in (b"101", b"200") or answer[9:10] == b"4", answer[:200]


def test_guesses_are_limited_at_the_door(before):
    with WebDevice(port=0, token="a long enough token") as device:
        port = port_of(device)
        request = f"GET /?token={{}} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n"
        answers = [ask(port, request.format("wrong").encode())[9:12] for _ in range(6)]
        assert answers == [b"401"] * 5 + [b"429"]
        assert b"\r\nRetry-After: " in ask(port, request.format("a+long+enough+token").encode())


def test_the_token_of_the_environment(monkeypatch):
    monkeypatch.setenv("SPATULA_TOKEN", "out of the environment")
    with WebDevice(port=0) as device:
        assert device.url.endswith("?token=out+of+the+environment")
        port = port_of(device)
        assert ask(port, f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())[9:12] == b"401"
