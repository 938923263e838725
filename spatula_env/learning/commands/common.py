"""Options, errors and refusals that the commands share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import gymnasium
import yaml

from spatula_env.installing import install_hint
from spatula_env.learning.configuration import find_config
from spatula_env.printing import printable

Config = TypeVar("Config")

INTERRUPTED = 130
"""The exit status after Ctrl-C, as the shell has it."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C; the message says what has been saved, and how to go on."""


def run_command(program: str, what: str, extra: str, run: Callable[[], None]) -> int:
    """Run a command, and tell in a line what went wrong.

    Args:
        program: The command as it was typed, such as "spatula train".
        what: What it does, such as "training".
        extra: That what it needs is part of, such as "train".
        run: Does it.

    Returns:
        The exit status: 0 if all went well.
    """
    try:
        run()
    except KeyboardInterrupt as error:
        return fail(program, f"interrupted{f'; {error}' if isinstance(error, Interrupted) else ''}", INTERRUPTED)
    except ImportError as error:
        told = "pip install" in str(error) or error.name is None or error.name.partition(".")[0] in _OURS
        return fail(program, str(error) if told else f"{what} needs {error.name}: {install_hint(extra)}")
    except (OSError, TypeError, ValueError, gymnasium.error.Error, yaml.YAMLError) as error:
        return fail(program, str(error))
    return 0


_OURS = ("spatula_env",)


def fail(program: str, message: str, status: int = 1) -> int:
    """Say on standard error what is wrong.

    Returns:
        The exit status.
    """
    print(printable(f"{program}: {message}".replace("\n", "\n  "), lines=True), file=sys.stderr)
    return status


def warn(program: str, message: str) -> None:
    """Say on standard error what may not be as it is meant."""
    print(f"{program}: note: {message}", file=sys.stderr, flush=True)


def add_overwrite_option(parser: argparse.ArgumentParser) -> None:
    """Add --overwrite."""
    parser.add_argument("--overwrite", action="store_true", help="replace what is there already; else it is an error")


def check_free(path: Path, overwrite: bool) -> None:
    """Check that a file can be written without the loss of another, before anything is done for it.

    Args:
        path: Of the file.
        overwrite: Whether it may replace one.

    Raises:
        FileExistsError: If there is one, and it may not.
        IsADirectoryError: If it is a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already: name another file, or replace it with --overwrite")


def run_parser(program: str, description: str, change: str) -> argparse.ArgumentParser:
    """A parser of what every command that trains is told.

    Args:
        program: The command's name.
        description: What it does.
        change: An example of a change of the configuration.
    """
    parser = argparse.ArgumentParser(prog=program, description=description)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--config", metavar="NAME", help="how to train: a YAML file, or the name of one in configs")
    what.add_argument("--resume", type=Path, metavar="DIR", help="go on with a run, or with one of its seeds")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
        help=f"a change of the configuration, such as {change}",
    )  # fmt: skip
    parser.add_argument("--output", type=Path, metavar="DIR", help="default: runs/ and the file's name")
    parser.add_argument("--quiet", action="store_true", help="show nothing but where the run is")
    return parser


def choose_run(
    chosen: argparse.Namespace, read: Callable[[Path, Sequence[str]], Config], changes: Sequence[str], holds: str
) -> tuple[Path, Config]:
    """Find the folder and the configuration of a run.

    Args:
        chosen: What the command was told.
        read: Reads a configuration from a file, with changes.
        changes: Of the configuration that a new run begins with.
        holds: A key that its configurations have; see `find_config`.

    Raises:
        FileNotFoundError: If there is no such configuration.
        ValueError: If the configuration is not valid, or a run is already where a new one would be.
    """
    if chosen.resume is not None:
        return chosen.resume, read(chosen.resume / "config.yaml", ())
    file = find_config(chosen.config, holds)
    config = read(file, changes)
    output = chosen.output or Path("runs") / file.stem
    if (output / "config.yaml").exists():
        raise ValueError(f"{output} holds a run already: go on with it (--resume) or name another (--output)")
    return output, config
