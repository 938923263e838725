"""Text from files on a terminal."""

from __future__ import annotations

import unicodedata

REORDERING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""They change the order in which the text after them is shown."""


def printable(text: str, *, lines: bool = False) -> str:
    """Text whose control characters are shown as Python writes them, so that it tells a terminal nothing.

    Args:
        text: From anywhere.
        lines: Whether it may have several lines.
    """
    return "".join(
        each if (lines and each == "\n") or not _is_control(each) else each.encode("unicode_escape").decode()
        for each in text
    )


def _is_control(character: str) -> bool:
    # Surrogates are what no terminal can be given.
    return unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") or character in REORDERING
