"""The page has its own name and icon."""

from __future__ import annotations

from importlib.resources import files
from urllib.parse import unquote
from xml.etree import ElementTree

import pytest

from spatula_env.teleop.web.document import ICON, dressed

pytest.importorskip("viser", reason="the extra web is not installed")


def test_the_page_of_viser_gets_a_name_an_icon_and_the_script():
    document = files("viser").joinpath("client", "build", "index.html").read_bytes()
    page = dressed(document, "/script.js")
    head = page.partition(b"<title>")
    assert head[2].startswith(b"Spatula</title>") and b"Viser</title>" not in page
    assert page.count(b'rel="icon"') == document.count(b'rel="icon"') == 1
    assert ICON in unquote(page[page.index(b'rel="icon"') :][:2000].decode())
    ElementTree.fromstring(ICON)
    # Before everything else of the page's.
    assert page.index(b'src="/script.js"') < page.index(b"<meta")
    # Nothing else is changed.
    assert page.endswith(document[-1000:])


def test_a_page_of_another_make_keeps_what_it_has():
    assert dressed(b"<html><head></head>", "/s.js") == b'<html><head><script src="/s.js"></script></head>'
    with pytest.raises(ValueError, match="no head"):
        dressed(b"<html>", "/s.js")
