"""`spatula envs`."""

from __future__ import annotations

import argparse
import inspect
from typing import TYPE_CHECKING, Any

import gymnasium

from spatula_env.cli.common import add_json_option, new_parser, print_json
from spatula_env.naming import env_ids

if TYPE_CHECKING:
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


def _summary(spec: Any) -> str:
    """The first line of an environment's documentation."""
    from gymnasium.envs.registration import load_env_creator

    maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    return (inspect.getdoc(maker) or "").partition("\n")[0]
