"""What the commands share: errors, options, printing of results."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

from spatula_env import engines
from spatula_env.changes import with_changes
from spatula_env.naming import find_environment
from spatula_env.printing import printable

if TYPE_CHECKING:
    Parsers = argparse._SubParsersAction[argparse.ArgumentParser]

FAILURE = 1
INTERRUPTED = 130
LARGEST_SEED = 2**63 - 1
"""Greatest seed that a dataset can store."""


class CommandError(Exception):
    """An error that the user can fix; the message says how."""


class Stopped(Exception):
    """The user has stopped a command; the message says what was done, and how to continue if that is possible."""


def fail(message: str, status: int = FAILURE, command: str = "spatula") -> int:
    """Print an error message to standard error.

    Args:
        message: A sentence.
        status: The exit status.
        command: The command, such as "spatula record".

    Returns:
        The exit status.
    """
    # Further lines are indented, so that text from a file does not look like another message.
    note(f"{command}: {message}".replace("\n", "\n  "))
    return status


def note(message: str) -> None:
    """Print a message that is not a result to standard error, so that results can be piped."""
    # The terminal may have been closed, and the work that was done must be saved nevertheless.
    with suppress(OSError):
        print(printable(message, lines=True), file=sys.stderr, flush=True)


def say(line: str, *, flush: bool = False) -> None:
    """Print a line of a result, which may contain text from a file; at once if `flush`."""
    print(printable(line), flush=flush)


def new_parser(commands: Parsers, name: str, help_text: str, description: str) -> argparse.ArgumentParser:
    """Add a parser for a command.

    Args:
        commands: The parsers to which it is added.
        name: Name of the command.
        help_text: A few words about the command.
        description: What the command does; paragraphs are kept.
    """
    parser = commands.add_parser(
        name, help=help_text, description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.set_defaults(command=parser.prog)
    return parser


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="end with the result as one JSON object")


def add_root_option(parser: argparse.ArgumentParser) -> None:
    """Add --root."""
    parser.add_argument(
        "--root",
        type=Path,
        metavar="DIR",
        help="folder of all datasets (default: MINARI_DATASETS_PATH, or .minari/datasets in the home folder)",
    )


def add_environment_options(parser: argparse.ArgumentParser) -> None:
    """Add an environment's id and options."""
    parser.add_argument(
        "env",
        metavar="ID",
        help="environment, such as Spatula/Press-v0, press for short, or MODULE:ID for one of your own",
    )
    parser.add_argument(
        "--engine", choices=engines.ENGINES, help=f"what integrates the organ (default: {engines.DEFAULT})"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="changes",
        help="an option of the environment, such as randomization=default or max_episode_steps=100; values are YAML",
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=at_least(0, LARGEST_SEED),
        default=0,
        help="of the first episode (default: %(default)s)",
    )


def engine_option(chosen: argparse.Namespace) -> dict[str, str]:
    """The engine as an option of an environment, if the command line names one."""
    return {} if chosen.engine is None else {"engine": chosen.engine}


def count_of(number: int, noun: str) -> str:
    """A number with its noun in the singular or plural: "1 episode", "2 episodes"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def at_least(least: int, greatest: int | None = None) -> Any:
    """A type of argument for `argparse`: an integer with a lower limit, and an upper one if given."""

    def integer(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be an integer, got {text!r}") from None
        if value < least:
            raise argparse.ArgumentTypeError(f"must be {least} or more, got {value}")
        if greatest is not None and value > greatest:
            raise argparse.ArgumentTypeError(f"must be from {least} to {greatest}, got {value}")
        return value

    return integer


def resolve_env(text: str) -> str:
    """Find the environment that the command line names.

    Args:
        text: See `spatula_env.naming.find_environment`.

    Raises:
        CommandError: If there is no such environment; lists those that exist.
    """
    try:
        return find_environment(text)
    except (ImportError, ValueError) as error:
        raise CommandError(str(error)) from error


def make_environment(
    chosen: argparse.Namespace, options: Mapping[str, Any] | None = None, **more: Any
) -> gymnasium.Env[Any, Any]:
    """Make the environment that the command line asks for.

    Args:
        chosen: Arguments of `add_environment_options`.
        options: Options that the command line can override, of a policy that acts; None if none does.
        **more: Options that it cannot override, such as the render mode.

    Raises:
        CommandError: If there is no such environment or option.
    """
    env_id = resolve_env(chosen.env)
    wanted = {**engine_option(chosen), **(options or {}), **with_changes({}, chosen.changes), **more}
    if options is not None:
        from spatula_env.learning.policies import with_all_parts

        wanted = with_all_parts(env_id, wanted)
    try:
        return gymnasium.make(env_id, **wanted)
    except (TypeError, ValueError) as error:
        # Gymnasium appends where the error was raised, which is always here.
        reason = str(error).partition(" was raised from the environment creator")[0]
        raise CommandError(f"{env_id} cannot be made so: {reason}") from error


def print_json(result: Mapping[str, Any]) -> None:
    """Print a result as one line of strict JSON: numbers that are not finite become null."""
    print(json.dumps(_strict(result), allow_nan=False))


def print_table(rows: Sequence[Sequence[str]], right: Iterable[int] = ()) -> None:
    """Print rows in columns.

    Args:
        rows: The first is the heading.
        right: Columns that are aligned to the right.
    """
    rows = [[printable(cell) for cell in row] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    aligned = set(right)
    for row in rows:
        cells = [
            text.rjust(width) if column in aligned else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  ".join(cells).rstrip())


def _strict(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _strict(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
