"""Windows, pictures and films."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.cli.common import CommandError
from spatula_env.files import check_can_write, whole_file
from spatula_env.installing import install_hint
from spatula_env.render.films import FILMS, check_film, write_film

if TYPE_CHECKING:
    import gymnasium

PICTURES = (".png", ".jpg")

Picture = NDArray[np.uint8]


def has_window() -> bool:
    """Whether a window can be expected to open: there is a display, and pyglet is installed."""
    display = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    return display and find_spec("pyglet") is not None


def check_ending(path: Path, endings: Sequence[str]) -> None:
    """Check a file's ending before anything is computed.

    Raises:
        CommandError: If a file with this ending cannot be written.
        ImportError: If the package that writes it is not installed.
    """
    if path.suffix not in endings:
        raise CommandError(f"the file must end with {', '.join(endings)}, got {path}")
    if path.suffix in FILMS:
        check_film(path)
    elif find_spec("PIL") is None:
        raise ImportError(f"pictures need Pillow: {install_hint('demo')}")


class Film:
    """Collects pictures of an environment and writes them.

    Attributes:
        frames: The pictures so far.
    """

    def __init__(self, path: Path, frames_per_second: float) -> None:
        """Begin a film without pictures.

        Args:
            path: Path of the film, .gif or .mp4; or of a picture, .png or .jpg, which shows the last frame.
            frames_per_second: Pictures per second.

        Raises:
            CommandError: If it has another ending.
            OSError: If no file can be written there.
        """
        check_ending(path, (*PICTURES, *FILMS))
        check_can_write(path.parent)
        self.frames: list[Picture] = []
        self._path = path
        self._rate = frames_per_second

    def take(self, env: gymnasium.Env[Any, Any]) -> None:
        """Add a picture of an environment with the render mode "rgb_array"."""
        picture: Any = env.render()
        self.add(picture)

    def add(self, picture: Picture) -> None:
        """Add a picture (height, width, 3); if the file is a picture, it replaces the last one."""
        if self._path.suffix in PICTURES:
            self.frames.clear()
        self.frames.append(np.array(picture))

    def write(self) -> Path:
        """Write the file.

        Returns:
            Its path.

        Raises:
            CommandError: If there is nothing to write.
        """
        if not self.frames:
            raise CommandError("there is no picture to write")
        if self._path.suffix in FILMS:
            write_film(self._path, self.frames, self._rate, last_seconds=1.5)
            return self._path
        from PIL import Image

        with whole_file(self._path) as unfinished:
            Image.fromarray(self.frames[-1]).save(unfinished)
        return self._path
