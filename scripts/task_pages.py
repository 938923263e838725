"""Writes the pages in docs/tasks: `python scripts/task_pages.py`, in the repository's root.

There is a page for each task, and one for what all environments have in common. The text is the docstring of the
environment's class, which is Markdown already, and the picture is the task's part of docs/images/tasks.png. With
`--check` nothing is written, and the exit status is 1 if a file is not current.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from task_pictures import GAP, SEEDS, SIDE

from spatula_env import TASKS
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]

PAGES = ROOT / "docs" / "tasks"

SHEET = ROOT / "docs" / "images" / "tasks.png"
"""The pictures of all tasks, side by side, which scripts/task_pictures.py draws."""

COMMON = "common"
"""Name of the page about what all environments have in common."""

COMMAND = "python scripts/task_pages.py"

HEAD = """This page is for you if you train, test or operate in this task: what is asked, with the tables of its action,
observation, reward and information."""

COMMON_HEAD = """This page is for you if you use any of the environments: the options, observations and information that
all of them have."""

PAGE = """# {title}

{head}

*Written by `{command}` from the docstring of [`{cls}`](../../{source}): change it there. [All tasks](../tasks.md).*
{picture}
{body}
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or check all files; returns the exit status, 1 if `--check` finds a file that is not current."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; the exit status is 1 if a file is old")
    options = parser.parse_args(arguments)
    names = [*(task.lower() for task in TASKS), COMMON]
    if options.check:
        old = [path for name in names for path in outdated(name)]
        for path in old:
            print(f"{path.relative_to(ROOT)} is not current: run `{COMMAND}`", file=sys.stderr)
        return int(bool(old))
    PAGES.mkdir(parents=True, exist_ok=True)
    for name in names:
        page_path(name).write_text(page(name), encoding="utf-8")
        if name != COMMON:
            write_picture(name)
    return 0


def outdated(name: str) -> list[Path]:
    """Files of a page, its text and its picture, that are missing or differ from what would be written now."""
    text, picture = page_path(name), picture_path(name)
    old = []
    if not text.is_file() or text.read_text(encoding="utf-8") != page(name):
        old.append(text)
    if name != COMMON and (not picture.is_file() or not np.array_equal(pixels(picture), part_of_sheet(name))):
        old.append(picture)
    return old


def page_path(name: str) -> Path:
    """Path of the page of a task, such as "press", or of `COMMON`."""
    return PAGES / f"{name}.md"


def picture_path(name: str) -> Path:
    """Path of the picture of a task."""
    return SHEET.with_name(f"{name}.png")


def page(name: str) -> str:
    """The text of a page: that of a task, such as "press", or `COMMON`."""
    task = name.capitalize()
    cls = f"{task}Env" if name != COMMON else "SpatulaEnv"
    module = f"spatula_env.envs.{name if name != COMMON else 'spatula_env'}"
    body = as_markdown(getattr(import_module(module), cls).__doc__ or "")
    picture = ""
    if name != COMMON:
        body = body.replace("`SpatulaEnv`", f"[`SpatulaEnv`]({COMMON}.md)")
        picture = (
            f"\n![The moment in which the task is solved: the goal in green, forces as arrows, "
            f"contact pressure in colour](../images/{name}.png)\n"
        )
    return PAGE.format(
        head=HEAD if name != COMMON else COMMON_HEAD,
        title=f"Spatula/{task}-v0" if name != COMMON else "What all environments have in common",
        command=COMMAND,
        cls=cls,
        source=f"{module.replace('.', '/')}.py",
        picture=picture,
        body=body,
    )


def as_markdown(docstring: str) -> str:
    """Convert a docstring: removes indentation and the list of attributes at its end, and protects formulas."""
    text = inspect.cleandoc(docstring).partition("\nAttributes:\n")[0].rstrip()
    # Between plain dollar signs, Markdown removes the backslash of TeX's \, before the formula is rendered.
    return re.sub(r"\$([^$`\n]+)\$", r"$`\1`$", text)


def part_of_sheet(name: str) -> NDArray[np.uint8]:
    """(SIDE, SIDE, 3) the picture of a task, such as "press"."""
    left = list(SEEDS).index(name.capitalize()) * (SIDE + GAP)
    return pixels(SHEET)[:SIDE, left : left + SIDE]


def pixels(path: Path) -> NDArray[np.uint8]:
    """(height, width, 3) pixels of a file."""
    with imaging().open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def write_picture(name: str) -> None:
    """Write the picture of a task, as a palette image if it has at most 256 colours."""
    part = imaging().fromarray(np.ascontiguousarray(part_of_sheet(name)))
    few = part.quantize(256, dither=0) if part.getcolors(256) else part
    few.save(picture_path(name), "PNG", optimize=True)


def imaging() -> Any:
    """The module of Pillow that reads and writes pictures."""
    try:
        return import_module("PIL.Image")
    except ImportError as error:
        raise ImportError(f"pictures are cut out with Pillow: {install_hint('demo')}") from error


if __name__ == "__main__":
    sys.exit(main())
