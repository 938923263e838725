"""What the commands that train have in common: which run is begun, or gone on with."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from agents.configuration import find_config

Config = TypeVar("Config")


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
    what.add_argument("--resume", type=Path, metavar="DIR", help="go on with an interrupted run")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
        help=f"a change of the configuration, such as {change}",
    )  # fmt: skip
    parser.add_argument("--output", type=Path, metavar="DIR", help="default: runs/ and the file's name")
    parser.add_argument("--quiet", action="store_true", help="show nothing but where the run is")
    return parser


def choose_run(
    chosen: argparse.Namespace, read: Callable[[Path, Sequence[str]], Config], changes: Sequence[str]
) -> tuple[Path, Config]:
    """Find the folder and the configuration of a run.

    Args:
        chosen: What the command was told.
        read: Reads a configuration from a file, with changes.
        changes: Of the configuration that a new run begins with.

    Raises:
        FileNotFoundError: If there is no such configuration.
        ValueError: If the configuration is not valid, or a run is already where a new one would be.
    """
    if chosen.resume is not None:
        return chosen.resume, read(chosen.resume / "config.yaml", ())
    file = find_config(chosen.config)
    config = read(file, changes)
    output = chosen.output or Path("runs") / file.stem
    if (output / "config.yaml").exists():
        raise ValueError(f"{output} holds a run already: go on with it (--resume) or name another (--output)")
    return output, config
