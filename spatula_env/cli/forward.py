"""`spatula train`, `evaluate`, `clone`, `export` and `convert`: the commands of `spatula_env.learning`."""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from spatula_env.cli.common import Parsers

TARGETS: Mapping[str, str] = MappingProxyType(
    {
        "train": "train agents",
        "evaluate": "evaluate a policy",
        "clone": "fit a policy to demonstrations",
        "export": "write a policy into a file that needs no torch",
        "convert": "rewrite runs of earlier versions, which kept pickles",
    }
)
"""Help texts of the commands; each is a module of `spatula_env.learning.commands`."""


def add_parser(commands: Parsers) -> None:
    """Add the commands to the help; their options are passed to `run` unparsed."""
    for name, help_text in TARGETS.items():
        commands.add_parser(name, help=help_text, add_help=False)


def run(name: str, arguments: Sequence[str]) -> int:
    """Run a command.

    Args:
        name: One of `TARGETS`.
        arguments: The arguments that follow it.

    Returns:
        The exit status.
    """
    module = import_module(f"spatula_env.learning.commands.{name}")
    status = module.main(list(arguments), program=f"spatula {name}")
    return 0 if status is None else int(status)
