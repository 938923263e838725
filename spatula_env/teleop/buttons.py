"""What devices call the buttons that end an episode."""

from __future__ import annotations

FINISH = "finish"
DISCARD = "discard"
QUIT = "quit"
"""As it is, so that it counts for nothing, and the session with it."""
