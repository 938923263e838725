"""`spatula demo`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from spatula_env.cli.common import CommandError, new_parser
from spatula_env.engines import DEFAULT, ENGINES

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(
        commands,
        "demo",
        "compare the contact models, draw the figures and run an episode",
        "Press a thin spatula into a soft sphere with all contact models of an engine at seven speeds, and\n"
        "say what came of it in a table, a data file, pictures and a film; then run an episode of a task.",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("out/demo"), metavar="DIR", help="where to write (default: %(default)s)"
    )
    parser.add_argument("--engine", choices=tuple(ENGINES), help=f"of the presses (default: {DEFAULT})")
    parser.add_argument("--quick", action="store_true", help="two speeds only, shorter runs and smaller pictures")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Run the demonstration."""
    from spatula_env.demo import require_extra

    require_extra()
    from rich.console import Console

    from spatula_env.demo.runner import OutputError, run_demo

    try:
        run_demo(chosen.output, Console(), engine=chosen.engine, quick=chosen.quick)
    except (OutputError, ImportError) as error:
        raise CommandError(str(error)) from error
    return 0
