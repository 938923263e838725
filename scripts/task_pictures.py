"""Draws docs/images/tasks.png: `python scripts/task_pictures.py`, in the repository's root.

Each picture shows an episode of one task at the moment when its scripted expert has solved it. All random numbers
follow from the seed: the same code draws the same pictures. It takes about half a minute.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

import spatula_env
from spatula_env.engines import ENGINES
from spatula_env.render.palette import HIGHEST_PRESSURE, PRESSURE, PRESSURE_LIMITS

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image

gym.register_envs(spatula_env)

SEEDS = {"Press": 3, "Retract": 1, "Fissure": 7, "Clamp": 3, "Palpate": 2}
"""The tasks in the order in which they are shown, each with the seed of an episode in which nothing important is
hidden."""

SIDE = 300
"""Width and height of a picture [pixels]."""

STRIP = 34
"""Height of each of the two strips below the pictures, for names and for the scale of colours [pixels]."""

MOST_BYTES = 250_000
"""Greatest size of the file [bytes]."""

GAP = 6
"""Gap between two pictures [pixels]."""

INK = (38, 44, 52)
FAINT_INK = (98, 106, 116)
PAPER = (255, 255, 255)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all pictures and write the file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("docs/images/tasks.png"), help="file to write")
    parser.add_argument("--engine", choices=tuple(ENGINES), default="batch")
    options = parser.parse_args(arguments)
    pictures = {task: solve(task, options.engine, seed) for task, seed in SEEDS.items()}
    data = encode(tile(pictures))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_bytes(data)
    print(f"{options.output}: {len(data) / 1000:.0f} kB")


def solve(task: str, engine: str, seed: int) -> NDArray[np.uint8]:
    """Picture (SIDE, SIDE, 3) of an episode at the step in which the scripted expert solves it, or at its end.

    Args:
        task: Name of the task, such as "Press".
        engine: "batch", "tissue", "mujoco" or "bullet".
        seed: Seed of the episode.
    """
    expert_type = getattr(import_module(f"spatula_env.learning.experts.{task.lower()}"), f"{task}Expert")
    env: Any = gym.make(f"Spatula/{task}-v0", engine=engine, render_mode="rgb_array", width=SIDE, height=SIDE)
    try:
        expert = expert_type(env)
        observation, info = env.reset(seed=seed)
        done = False
        while not (done or info["is_success"]):
            observation, _, terminated, truncated, info = env.step(expert(observation))
            done = terminated or truncated
        print(
            f"{task}: {'solved' if info['is_success'] else 'not solved'} after {info['time']:.2f} s, "
            f"force {info['force']:.2f} N, greatest pressure {info['peak_pressure']:.0f} Pa"
        )
        picture: NDArray[np.uint8] = env.render()
        return picture
    finally:
        env.close()


def tile(pictures: dict[str, NDArray[np.uint8]]) -> Image:
    """The pictures side by side, with their names and the colour scale of pressure below."""
    from PIL import Image, ImageDraw, ImageFont

    count = len(pictures)
    width = count * SIDE + (count - 1) * GAP
    sheet = Image.new("RGB", (width, SIDE + 2 * STRIP), PAPER)
    draw = ImageDraw.Draw(sheet)
    font, small = ImageFont.load_default(18), ImageFont.load_default(13)
    for index, (task, picture) in enumerate(pictures.items()):
        left = index * (SIDE + GAP)
        sheet.paste(Image.fromarray(picture), (left, 0))
        draw.text((left + SIDE // 2, SIDE + STRIP // 2), f"Spatula/{task}-v0", fill=INK, font=font, anchor="mm")
    bar_width, bar_height = 420, 12
    left, top = (width - bar_width) // 2, SIDE + STRIP + 2
    values = np.linspace(0.0, HIGHEST_PRESSURE, bar_width)
    bar = np.round(255.0 * PRESSURE(values, 0.0, HIGHEST_PRESSURE)).astype(np.uint8)
    sheet.paste(Image.fromarray(np.repeat(bar[None], bar_height, axis=0)), (left, top))
    draw.text((left - 10, top + bar_height // 2), "contact pressure [kPa]", fill=FAINT_INK, font=small, anchor="rm")
    for value in (0.0, *PRESSURE_LIMITS, HIGHEST_PRESSURE):
        x = left + round((bar_width - 1) * value / HIGHEST_PRESSURE)
        draw.line([(x, top), (x, top + bar_height + 2)], fill=INK)
        draw.text((x, top + bar_height + 9), f"{value / 1000.0:.3g}", fill=FAINT_INK, font=small, anchor="mm")
    return sheet


def encode(sheet: Image) -> bytes:
    """Encode a sheet as a PNG file of at most `MOST_BYTES`, with as many colours as that allows.

    Raises:
        ValueError: If it does not fit even with the fewest colours.
    """
    from PIL import Image

    for colors in (None, 256, 192, 128, 64):
        page = sheet if colors is None else sheet.quantize(colors, dither=Image.Dither.FLOYDSTEINBERG)
        buffer = io.BytesIO()
        page.save(buffer, "PNG", optimize=True)
        if buffer.tell() <= MOST_BYTES:
            return buffer.getvalue()
    raise ValueError(f"the picture does not fit into {MOST_BYTES} bytes")


if __name__ == "__main__":
    main()
