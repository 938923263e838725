"""`spatula train`, `evaluate`, `clone` and `export`: what `python -m agents.NAME` does, with the same options."""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from spatula_env.cli.common import Parsers

TARGETS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "train": ("agents.train", "train agents"),
        "evaluate": ("agents.evaluate", "evaluate a policy"),
        "clone": ("agents.clone", "fit a policy to demonstrations"),
        "export": ("agents.export", "write a policy into a file that needs no torch"),
    }
)
"""Modules and what they do, by commands."""


def add_parser(commands: Parsers) -> None:
    """List the commands; `run` gets their options, whatever they are."""
    for name, (_, help_text) in TARGETS.items():
        commands.add_parser(name, help=help_text, add_help=False)


def run(name: str, arguments: Sequence[str]) -> int:
    """Do what ``python -m agents.NAME`` does.

    Args:
        name: One of `TARGETS`.
        arguments: What follows it.

    Returns:
        The exit status.
    """
    module = import_module(TARGETS[name][0])
    status = module.main(list(arguments), program=f"spatula {name}")
    return 0 if status is None else int(status)
