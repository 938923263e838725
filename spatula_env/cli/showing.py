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
from spatula_env.data.files import check_can_write
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    import gymnasium

PICTURES = (".png", ".jpg")
FILMS = (".gif", ".mp4")

Picture = NDArray[np.uint8]


def has_window() -> bool:
    """Whether a window can be expected to open: there is a display, and what draws on it is installed."""
    display = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    return display and find_spec("pyglet") is not None


def check_ending(path: Path, endings: Sequence[str]) -> None:
    """Check what kind of file is asked for, before anything runs for a minute.

    Raises:
        CommandError: If it cannot be written.
        ImportError: If what writes it is not installed.
    """
    if path.suffix not in endings:
        raise CommandError(f"the file must end with {', '.join(endings)}, got {path}")
    if path.suffix == ".mp4" and find_spec("moviepy") is None:
        raise ImportError(f"films as .mp4 need moviepy: {install_hint('video')}")
    if path.suffix != ".mp4" and find_spec("PIL") is None:
        raise ImportError(f"pictures need Pillow: {install_hint('demo')}")


class Film:
    """Collects pictures of an environment and writes them.

    Attributes:
        frames: What has been seen.
    """

    def __init__(self, path: Path, frames_per_second: float) -> None:
        """Describe it.

        Args:
            path: Of the file, .gif or .mp4; or of a picture, which shows the last frame.
            frames_per_second: How fast it runs.

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
        """Take a picture of an environment with the mode of rendering "rgb_array"."""
        picture: Any = env.render()
        self.add(picture)

    def add(self, picture: Picture) -> None:
        """Add a picture (height, width, 3)."""
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
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # Under another name first: a film that is half written is none.
        unfinished = self._path.with_name(f".new-{self._path.name}")
        try:
            self._encode(unfinished)
            unfinished.replace(self._path)
        finally:
            unfinished.unlink(missing_ok=True)
        return self._path

    def _encode(self, path: Path) -> None:
        if path.suffix == ".mp4":
            from moviepy import ImageSequenceClip

            # The encoder wants even numbers of pixels.
            even = [frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2] for frame in self.frames]
            clip = ImageSequenceClip(even, fps=self._rate)
            clip.write_videofile(str(path), codec="libx264", audio=False, logger=None)
            clip.close()
        elif path.suffix == ".gif":
            from spatula_env.demo.animation import encode_gif

            path.write_bytes(encode_gif(self.frames, round(1000 / self._rate), last_duration=1500))
        else:
            from PIL import Image

            Image.fromarray(self.frames[-1]).save(path)
