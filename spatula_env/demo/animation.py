"""Moving pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.demo.episode import Episode
from spatula_env.demo.pictures import FAINT_INK, FILM_VIEW, INK, PAPER, RULE, PressPainter, _font
from spatula_env.demo.press import PressFilm
from spatula_env.render import palette

if TYPE_CHECKING:
    from PIL import Image

CURVE = tuple(round(255 * part) for part in palette.FORCE)


def film_frames(film: PressFilm, width: int = 480) -> list[Image.Image]:
    """The film with the force drawn as an arrow and, in a strip below, over time.

    Args:
        film: What to show.
        width: Of the pictures [pixels].
    """
    from PIL import Image

    height = round(0.72 * width)
    strip = _ForceStrip(film, width, round(0.21 * width))
    painter = PressPainter(width, height, view=FILM_VIEW)
    frames = []
    for snapshot in film.snapshots:
        page = Image.new("RGB", (width, height + strip.height), PAPER)
        page.paste(Image.fromarray(painter.draw(snapshot, arrow=True, nodes=False)), (0, 0))
        page.paste(strip.draw(snapshot.time), (0, height))
        frames.append(page)
    return frames


def episode_frames(episode: Episode) -> list[Image.Image]:
    """The pictures of an episode, each with a strip below it that says who acts and how far it has got.

    Args:
        episode: With at least one frame.
    """
    from PIL import Image, ImageDraw

    height, width = episode.frames[0].picture.shape[:2]
    size = max(8.0, width / 28.0)
    strip = round(4.4 * size)
    pages = []
    for frame in episode.frames:
        page = Image.new("RGB", (width, height + strip), PAPER)
        page.paste(Image.fromarray(frame.picture), (0, 0))
        draw = ImageDraw.Draw(page)
        now = (
            f"{frame.time:.2f} s, {1000 * frame.depth:.1f} of {1000 * episode.goal_depth:.1f} mm deep, "
            f"{frame.force:.2f} N"
        )
        for line, (text, ink) in enumerate(((episode.policy, INK), (episode.origin, FAINT_INK), (now, FAINT_INK))):
            # A long line is written in smaller letters.
            wide = _font(size).getlength(text) / (width - size)
            draw.text((size / 2, height + (0.4 + 1.3 * line) * size), text, fill=ink, font=_font(size / max(wide, 1.0)))
        pages.append(page)
    return pages


class _ForceStrip:
    """A plot of the force that grows with time."""

    def __init__(self, film: PressFilm, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._title = f"press at {film.speed:g} u/s, hold, release"
        self._forces = film.forces
        self._times = film.dt * np.arange(1, len(film.forces) + 1)
        self._left, self._right = round(0.095 * width), width - round(0.03 * width)
        self._top, self._bottom = round(0.2 * height), height - round(0.2 * height)
        self._highest = float(np.ceil(max(float(film.forces.max()), 1e-3) / 2.0) * 2.0)
        self._size = max(9, round(0.027 * width))

    def draw(self, time: float) -> Image.Image:
        from PIL import Image, ImageDraw

        # Drawn twice as large and reduced, because Pillow's lines have steps.
        fine = Image.new("RGB", (2 * self.width, 2 * self.height), PAPER)
        draw = ImageDraw.Draw(fine)
        size, faint = 2 * self._size, FAINT_INK
        font = _font(size)
        for value in (0.0, 0.5 * self._highest, self._highest):
            y = 2 * self._y(value)
            draw.line([(2 * self._left, y), (2 * self._right, y)], fill=RULE, width=2)
            draw.text((2 * self._left - size // 2, y), f"{value:g}", fill=faint, font=font, anchor="rm")
        draw.text(
            (2 * self._left, size // 4), f"{self._title}: force on the spatula [N]", fill=faint, font=font, anchor="lt"
        )
        draw.text((2 * self._right, size // 4), f"t = {time:.2f} s", fill=INK, font=font, anchor="rt")
        last = float(self._times[-1])
        for second in np.arange(0.0, last + 1e-9, 0.25):
            x = 2 * self._x(float(second))
            draw.text((x, 2 * self._bottom + size // 3), f"{second:g}", fill=faint, font=font, anchor="mt")
        shown = self._times <= time + 1e-9
        points = [
            (2 * self._x(float(t)), 2 * self._y(float(f)))
            for t, f in zip(self._times[shown], self._forces[shown], strict=True)
        ]
        if len(points) > 1:
            draw.line(points, fill=CURVE, width=5, joint="curve")
        if points:
            x, y = points[-1]
            draw.ellipse([x - 8, y - 8, x + 8, y + 8], fill=CURVE)
        return fine.resize((self.width, self.height), Image.Resampling.LANCZOS)

    def _x(self, time: float) -> float:
        return self._left + (self._right - self._left) * time / float(self._times[-1])

    def _y(self, force: float) -> float:
        return self._bottom - (self._bottom - self._top) * force / self._highest
