"""The `spatula` command: finds the command that is meant, and turns its errors into a line."""

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

MODULES = ("demo", "envs", "play", "record", "replay", "datasets", "falcon", "view", "forward", "bench", "compile")
"""Of the commands, in the order in which help lists them; all but `forward` are called like their command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        arguments: What follows the command's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Their options are none of this parser's business.
    if given and given[0] in forward.TARGETS:
        return _run(lambda: forward.run(given[0], given[1:]))
    parser = make_parser(given[0] if given else None)
    chosen = parser.parse_args(given)
    run: Callable[[argparse.Namespace], int] = chosen.run
    with endings_like_ctrl_c():
        return _run(lambda: run(chosen), getattr(chosen, "command", "spatula"))


def make_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser of the command line.

    Args:
        command: The one that is meant: no other is imported. If it is none of them, all are.
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
    # Looked up here: importing it brings NumPy, which `spatula --version` can do without.
    from spatula_env.teleop.device import DeviceError

    usual = warnings.formatwarning
    # People who type a command are not helped by the line of code that warns.
    warnings.formatwarning = lambda message, *_: f"spatula: {printable(str(message), lines=True)}\n"
    try:
        return run()
    except Stopped as stopped:
        return fail(str(stopped), getattr(stopped.__context__, "status", INTERRUPTED), command)
    except KeyboardInterrupt as interrupt:
        return fail(str(interrupt) or "interrupted", getattr(interrupt, "status", INTERRUPTED), command)
    except BrokenPipeError:
        # Whoever read the output, `head` for example, has seen enough. The interpreter would complain at its end.
        sys.stdout = None
        return FAILURE
    except (CommandError, DeviceError, gymnasium.error.Error, ImportError, OSError, ValueError) as error:
        return fail(str(error), FAILURE, command)
    finally:
        warnings.formatwarning = usual
