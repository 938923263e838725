"""Films for tests, read and closed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def opened_film(path: Path) -> Iterator[Any]:
    """A film as MoviePy reads it, which leaves the pipes from FFmpeg to the garbage collector, and that warns."""
    from moviepy import VideoFileClip

    with VideoFileClip(str(path)) as clip:
        process = clip.reader.proc
        yield clip
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()
