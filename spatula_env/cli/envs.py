"""`spatula envs`."""

from __future__ import annotations

import argparse
import ast
from importlib.util import find_spec
from typing import TYPE_CHECKING

import gymnasium

from spatula_env.cli.common import add_json_option, new_parser, print_json
from spatula_env.naming import env_ids

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

    from spatula_env.cli.common import Parsers


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "envs", "list the environments", "List the ids that gymnasium.make takes.")
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """List the environments."""
    told = {env_id: _summary(gymnasium.spec(env_id)) for env_id in env_ids()}
    if chosen.json:
        print_json(told)
        return 0
    width = max(map(len, told))
    for env_id, summary in told.items():
        print(f"{env_id:{width}}  {summary}")
    return 0


def _summary(spec: EnvSpec) -> str:
    """The first line of an environment's docstring, read from its source because importing it takes far longer."""
    found = _documentation(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point.__doc__
    return (found or "").strip().partition("\n")[0]


def _documentation(entry_point: str) -> str | None:
    module, _, name = entry_point.partition(":")
    found = find_spec(module)
    source = getattr(found.loader, "get_source", lambda _: None)(module) if found is not None else None
    for node in ast.parse(source or "").body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return ast.get_docstring(node)
    return None
