"""The `spatula` command."""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

from spatula_env import __version__

if TYPE_CHECKING:
    from spatula_env.demo.episode import Policy

FAILURE = 1
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        arguments: What follows the command's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    chosen = _make_parser().parse_args(arguments)
    run: Callable[[argparse.Namespace], int] = chosen.run
    try:
        return run(chosen)
    except KeyboardInterrupt:
        return _fail("interrupted", INTERRUPTED)


def make_expert(env: gymnasium.Env[Any, Any]) -> Policy:
    """The scripted expert of the press. Agents build on environments, so only this command knows both."""
    from agents.experts.press import PressExpert

    return PressExpert(env)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="spatula", description="Learning tool-tissue manipulation with a thin rigid spatula."
    )
    parser.add_argument("--version", action="version", version=f"spatula_env {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    demo = commands.add_parser(
        "demo",
        help="compare the contact models, draw the figures and run an episode",
        description="Press a thin spatula into a soft sphere with three contact models at seven speeds, and say what "
        "came of it in a table, a data file, pictures and a film; then run an episode of a task.",
    )
    demo.add_argument(
        "--output", type=Path, default=Path("out/demo"), metavar="DIR", help="where to write (default: %(default)s)"
    )
    demo.add_argument("--quick", action="store_true", help="two speeds only, shorter runs and smaller pictures")
    demo.set_defaults(run=_demo)

    envs = commands.add_parser(
        "envs", help="list the environments", description="List the ids that gymnasium.make takes."
    )
    envs.set_defaults(run=_envs)
    return parser


def _demo(chosen: argparse.Namespace) -> int:
    from spatula_env.demo import require_extra

    try:
        require_extra()
    except ImportError as error:
        return _fail(str(error))
    from rich.console import Console

    from spatula_env.demo.runner import OutputError, run_demo

    try:
        run_demo(chosen.output, make_expert, Console(), quick=chosen.quick)
    except OutputError as error:
        return _fail(str(error))
    return 0


def _envs(_: argparse.Namespace) -> int:
    specs = [spec for key, spec in sorted(gymnasium.registry.items()) if spec.namespace == "Spatula"]
    width = max(len(spec.id) for spec in specs)
    for spec in specs:
        print(f"{spec.id:{width}}  {_summary(spec)}")
    return 0


def _summary(spec: Any) -> str:
    """The first line of an environment's documentation."""
    from gymnasium.envs.registration import load_env_creator

    maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    return (inspect.getdoc(maker) or "").partition("\n")[0]


def _fail(message: str, status: int = FAILURE) -> int:
    print(f"spatula: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
