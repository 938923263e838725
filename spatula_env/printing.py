"""Safe printing of text from files on a terminal."""

from __future__ import annotations

import unicodedata

REORDERING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that change the order in which the text after them is displayed."""


def printable(text: str, *, lines: bool = False) -> str:
    """Escape control characters as Python does, so that text cannot control the terminal.

    Args:
        text: Text from any source.
        lines: Whether line feeds are kept.
    """
    return "".join(
        each if (lines and each == "\n") or not _is_control(each) else each.encode("unicode_escape").decode()
        for each in text
    )


def _is_control(character: str) -> bool:
    # Surrogates (Cs) cannot be written to a terminal.
    return unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") or character in REORDERING
