"""Names that devices give to the buttons that end an episode."""

from __future__ import annotations

FINISH = "finish"
DISCARD = "discard"
QUIT = "quit"
"""Ends the episode where it stands, so that it does not count, and ends the session too."""
