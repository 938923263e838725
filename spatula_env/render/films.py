"""Films: sequences of pictures, written as GIF by Pillow and as MP4 by MoviePy."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatula_env.files import whole_file
from spatula_env.installing import install_hint
from spatula_env.render import palette

if TYPE_CHECKING:
    from PIL import Image

FILMS = (".gif", ".mp4")
"""Endings of the files that can be written."""

RARE_COLORS = tuple(
    tuple(round(255 * shade * part) for part in color)
    for color in (palette.FORCE, palette.GOAL, palette.FEASIBLE, palette.UNFEASIBLE)
    for shade in (0.4, 0.6, 0.8, 1.0)
)
"""Colours that are always in a GIF's palette: arrows and marks are small, and a palette made from the whole picture
would not include their colours."""


def check_film(path: Path) -> None:
    """Check that a film can be encoded, before it is made.

    Args:
        path: Path of its file.

    Raises:
        ImportError: If the package that encodes it is not installed.
        ValueError: If it has another ending.
    """
    if path.suffix not in FILMS:
        raise ValueError(f"a film must end with {' or '.join(FILMS)}, got {path}")
    if path.suffix == ".mp4" and find_spec("moviepy") is None:
        raise ImportError(f"films as .mp4 need MoviePy: {install_hint('video')}", name="moviepy")
    if path.suffix == ".gif" and find_spec("PIL") is None:
        raise ImportError(f"films as .gif need Pillow: {install_hint('demo')}", name="PIL")


def write_film(path: Path, frames: Sequence[NDArray[np.uint8]], rate: float, last_seconds: float = 0.0) -> None:
    """Write a film; the file appears only when it is complete.

    Args:
        path: Path that ends with .gif or .mp4; folders are created.
        frames: (height, width, 3) each, at least one.
        rate: Frames per second.
        last_seconds: How long a GIF shows its last frame, if longer than the others [s].

    Raises:
        ImportError: See `check_film`.
        ValueError: If it has another ending, or there are no frames.
    """
    check_film(path)
    if not frames:
        raise ValueError("there is no picture to write")
    with whole_file(path) as unfinished:
        if path.suffix == ".mp4":
            from moviepy import ImageSequenceClip

            # The encoder requires even numbers of pixels.
            even = [frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2] for frame in frames]
            clip = ImageSequenceClip(even, fps=rate)
            clip.write_videofile(str(unfinished), codec="libx264", audio=False, logger=None)
            clip.close()
        else:
            unfinished.write_bytes(encode_gif(frames, round(1000 / rate), round(1000 * last_seconds)))


def encode_gif(frames: Sequence[Image.Image | NDArray[np.uint8]], duration: int, last_duration: int = 0) -> bytes:
    """Encode a GIF that repeats endlessly.

    Args:
        frames: At least one.
        duration: Duration of a frame [ms].
        last_duration: Duration of the last frame, if longer [ms].

    Returns:
        The file's content.
    """
    from PIL import Image

    pages = [frame if isinstance(frame, Image.Image) else Image.fromarray(frame) for frame in frames]
    # One palette for all frames, and no dithering: parts that do not move then have the same bytes in every frame,
    # which take no space in a GIF.
    samples = pages[:: max(1, len(pages) // 6)]
    sheet = Image.new("RGB", (pages[0].width, sum(page.height for page in samples)))
    top = 0
    for page in samples:
        sheet.paste(page, (0, top))
        top += page.height
    colors = sheet.quantize(256 - len(RARE_COLORS), method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    table = (colors.getpalette() or [])[: 3 * (256 - len(RARE_COLORS))]
    colors.putpalette([*table, *(part for color in RARE_COLORS for part in color)])
    few = [page.quantize(palette=colors, dither=Image.Dither.NONE) for page in pages]
    durations = [duration] * len(few)
    durations[-1] = max(duration, last_duration)
    buffer = io.BytesIO()
    few[0].save(
        buffer, "GIF", save_all=True, append_images=few[1:], duration=durations, loop=0, optimize=False, disposal=1
    )
    return buffer.getvalue()
