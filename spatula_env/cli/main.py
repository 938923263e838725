"""The `spatula` command: runs the chosen command, and prints its errors as one line."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module

import gymnasium

from spatula_env import __version__
from spatula_env.cli import forward
from spatula_env.cli.common import FAILURE, INTERRUPTED, CommandError, Stopped, fail
from spatula_env.cli.interrupting import endings_like_ctrl_c
from spatula_env.printing import printable

MODULES = (
    "demo",
    "envs",
    "play",
    "record",
    "replay",
    "datasets",
    "organ",
    "falcon",
    "view",
    "forward",
    "bench",
    "compile",
)
"""Modules of the commands, in the order in which help lists them; all but `forward` have the name of their command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        arguments: The arguments after "spatula"; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    # These commands parse their options themselves.
    if given and given[0] in forward.TARGETS:
        return _run(lambda: forward.run(given[0], given[1:]))
    parser = make_parser(given[0] if given else None)
    chosen = parser.parse_args(given)
    run: Callable[[argparse.Namespace], int] = chosen.run
    with endings_like_ctrl_c():
        return _run(lambda: run(chosen), getattr(chosen, "command", "spatula"))


def make_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Make the parser of the command line.

    Args:
        command: The chosen command; no other is imported. If there is no such command, all are.
    """
    parser = argparse.ArgumentParser(
        prog="spatula",
        description="Learning tool-tissue manipulation with a thin rigid spatula.",
        epilog="spatula COMMAND --help tells about a command.",
    )
    parser.add_argument("--version", action="version", version=f"spatula_env {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in MODULES if command not in MODULES else [command]:
        import_module(f"spatula_env.cli.{name}").add_parser(commands)
    return parser


def _run(run: Callable[[], int], command: str = "spatula") -> int:
    # Imported here because it loads NumPy, which `spatula --version` does not need.
    from spatula_env.teleop.device import DeviceError

    usual = warnings.formatwarning
    # The line of code that issues a warning does not help the user of a command.
    warnings.formatwarning = lambda message, *_: f"spatula: {printable(str(message), lines=True)}\n"
    try:
        return run()
    except Stopped as stopped:
        return fail(str(stopped), getattr(stopped.__context__, "status", INTERRUPTED), command)
    except KeyboardInterrupt as interrupt:
        return fail(str(interrupt) or "interrupted", getattr(interrupt, "status", INTERRUPTED), command)
    except BrokenPipeError:
        # The reader of the output, `head` for example, has closed the pipe. Without this, the interpreter would print
        # an error when it exits.
        sys.stdout = None
        return FAILURE
    except (CommandError, DeviceError, gymnasium.error.Error, ImportError, OSError, ValueError) as error:
        return fail(str(error), FAILURE, command)
    finally:
        warnings.formatwarning = usual
