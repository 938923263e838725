"""Options and error handling shared by the commands."""

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
"""Exit status after Ctrl-C, as shells use it."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C was pressed; the message says what has been saved, and how to continue."""


def run_command(program: str, what: str, extra: str, run: Callable[[], None]) -> int:
    """Run a command, and report errors in one line.

    Args:
        program: The command as the user typed it, such as "spatula train".
        what: Description of the activity, such as "training".
        extra: The package's extra with the dependencies of the command, such as "train".
        run: Does the work.

    Returns:
        Exit status: 0 on success.
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
    """Print an error on standard error.

    Returns:
        The exit status.
    """
    print(printable(f"{program}: {message}".replace("\n", "\n  "), lines=True), file=sys.stderr)
    return status


def warn(program: str, message: str) -> None:
    """Print a warning on standard error."""
    print(f"{program}: note: {message}", file=sys.stderr, flush=True)


def add_overwrite_option(parser: argparse.ArgumentParser) -> None:
    """Add the option --overwrite."""
    parser.add_argument("--overwrite", action="store_true", help="replace what is there already; else it is an error")


def run_parser(program: str, description: str, change: str) -> argparse.ArgumentParser:
    """Make a parser with the options that all training commands share.

    Args:
        program: The command's name.
        description: Description of the command.
        change: Example of a change of the configuration.
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
        chosen: Parsed command line.
        read: Reads a configuration from a file, with changes.
        changes: Changes of the configuration with which a new run begins.
        holds: Key that identifies configurations of the right kind; see `find_config`.

    Raises:
        FileNotFoundError: If there is no such configuration.
        ValueError: If the configuration is invalid, or a new run would be put where another run is.
    """
    if chosen.resume is not None:
        return chosen.resume, read(chosen.resume / "config.yaml", ())
    file = find_config(chosen.config, holds)
    config = read(file, changes)
    output = chosen.output or Path("runs") / file.stem
    if (output / "config.yaml").exists():
        raise ValueError(f"{output} holds a run already: go on with it (--resume) or name another (--output)")
    return output, config
