"""The whole demonstration, from a folder to write to."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from spatula_env.demo import require_extra
from spatula_env.demo.animation import episode_frames, film_frames
from spatula_env.demo.episode import Actor, Episode, run_episode, trained_actor
from spatula_env.demo.pictures import FIGURE_SPEED, figure
from spatula_env.demo.press import CONTACTS, SPEEDS, PressCase, PressResult, film_press
from spatula_env.demo.report import (
    LEGEND,
    as_document,
    markdown_table,
    terminal_table,
    write_json,
)
from spatula_env.demo.workers import start_workers, submit_cases
from spatula_env.engines import bullet_hint, bullet_is_there, choose_engine, load_engine
from spatula_env.files import write_bytes, write_text
from spatula_env.render.films import encode_gif
from spatula_env.render.renderer import Renderer

if TYPE_CHECKING:
    from PIL import Image
    from rich.console import Console

QUICK_SPEEDS = (5.0, FIGURE_SPEED)
"""The speeds of a quick comparison [u/s]."""

FIGURES = {"bullet": 3, "mujoco": 3, "second_step": 4, "flags": 5}
"""The seed's figure that each contact model answers; its third is of the engine's own contact."""

RESULTS_FILE = "results.json"
TABLE_FILE = "results.md"
FILM_FILE = "press.gif"
EPISODE_FILE = "episode.gif"


class OutputError(RuntimeError):
    """The output folder, or a file in it, cannot be written."""


def comparison_cases(engine: str, quick: bool = False) -> list[PressCase]:
    """What the comparison runs.

    Args:
        engine: Name of the engine.
        quick: Whether to run two speeds and to hold shortly.

    Returns:
        The cases, of all contact models that the engine has.
    """
    speeds, hold_time = (QUICK_SPEEDS, 1.0) if quick else (SPEEDS, 2.0)
    offered = load_engine(engine).abilities.contacts
    return [
        PressCase(contact, speed, hold_time, engine) for contact in CONTACTS if contact in offered for speed in speeds
    ]


def figure_results(results: list[PressResult]) -> list[PressResult]:
    """Those of the results that the figures show, in the figures' order."""
    shown = [result for result in results if result.case.speed == FIGURE_SPEED]
    return sorted(shown, key=lambda result: FIGURES[result.case.contact])


def run_demo(
    output: Path, console: Console, *, engine: str | None = None, actor: Actor | None = None, quick: bool = False
) -> None:
    """Compare the contact models, draw the figures, film a press and an episode.

    Args:
        output: The folder to write to; made if it is missing.
        console: Where to report.
        engine: Name of the engine of the presses and of their film; None: the default.
        actor: Who acts in the episode, in another process; None: the trained policy that comes with the package.
        quick: Whether to do less of everything.

    Raises:
        ImportError: If the extra "demo" is not installed.
        OutputError: If something cannot be written.
    """
    require_extra()
    prepare_folder(output)
    left_out = engine is None and not bullet_is_there()
    named = "batch" if left_out else choose_engine(engine)
    if left_out:
        console.print(
            f"PyBullet is not installed: left out is its own contact, contact='bullet'; all else runs with "
            f"engine='batch'. {bullet_hint()}",
            highlight=False,
        )
    with start_workers() as pool:
        results, episode, film = _compute(pool, named, actor or trained_actor(), console, quick)
    console.print(f"engine: {named}", highlight=False)
    console.print(terminal_table(results, console.width))
    console.print(LEGEND, style="dim", highlight=False)
    console.print()
    _tell_episode(episode, console)

    width = 560 if quick else 960
    pictures: dict[str, bytes] = {}
    for result in figure_results(results):
        pictures[f"figure-{FIGURES[result.case.contact]}-{result.case.contact}.png"] = encode_png(
            figure(result, width=width)
        )
    pictures[FILM_FILE] = film
    pictures[EPISODE_FILE] = encode_gif(episode_frames(episode), round(1000 * episode.frame_time), last_duration=1500)
    with _writing(output):
        for name, content in pictures.items():
            write_bytes(output / name, content)
        write_text(output / TABLE_FILE, markdown_table(results))
        write_json(output / RESULTS_FILE, as_document(results, episode.as_record(), list(pictures)))
    console.print(f"Written to {output}: {', '.join([RESULTS_FILE, TABLE_FILE, *pictures])}", soft_wrap=True)


def prepare_folder(folder: Path) -> None:
    """Make a folder if it is missing, and check that files can be made in it.

    Raises:
        OutputError: If not.
    """
    with _writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass


def encode_png(picture: Image.Image) -> bytes:
    """A picture as the content of a PNG file."""
    import io

    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def film_gif(engine: str, width: int, stride: int) -> bytes:
    """A film of the flags method as the content of a GIF file, about five times slower than life.

    Args:
        engine: Name of the engine.
        width: Of the picture [pixels].
        stride: Physics steps between two frames.
    """
    film = film_press(engine=engine, stride=stride)
    return encode_gif(film_frames(film, width), duration=round(5000 * stride * film.dt / 10) * 10, last_duration=1000)


def _compute(
    pool: ProcessPoolExecutor, engine: str, actor: Actor, console: Console, quick: bool
) -> tuple[list[PressResult], Episode, bytes]:
    """Run everything that takes time, with a progress bar."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    cases = comparison_cases(engine, quick)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        total = sum(case.expected_steps for case in cases)
        bar = progress.add_task(f"{len(cases)} presses", total=total)
        results = submit_cases(pool, cases, lambda case: progress.advance(bar, case.expected_steps))
        # The first renderer compiles its kernels. That is done here, while the others are busy with presses.
        Renderer(8, 8)
        film = pool.submit(film_gif, engine, 320 if quick else 480, 12 if quick else 4)
        episode = pool.submit(run_episode, actor, size=200 if quick else 360, stride=8 if quick else 2)
        done = [future.result() for future in results]
        progress.update(bar, description="film and episode")
        return done, episode.result(), film.result()


def _tell_episode(episode: Episode, console: Console) -> None:
    outcome = "[green]success[/green]" if episode.success else "[red]no success[/red]"
    console.print(
        f"{episode.task}, {episode.policy} ({episode.origin}), seed {episode.seed}: {outcome} after "
        f"{episode.time:.2f} s ({episode.steps} steps); depth {1000 * episode.goal_depth:.1f} mm asked for, "
        f"error {1000 * abs(episode.depth_error):.2f} mm; return {episode.total_reward:.1f}; "
        f"peak force {episode.peak_force:.1f} N",
        highlight=False,
    )


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror or error}") from error
