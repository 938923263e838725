"""`spatula view`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env.cli.acting import POLICY_HELP, find_actor
from spatula_env.cli.common import (
    add_environment_options,
    at_least,
    make_environment,
    new_parser,
    resolve_env,
)
from spatula_env.cli.showing import PICTURES, Film, check_ending, has_window
from spatula_env.naming import task_name
from spatula_env.render.films import FILMS

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers

DESCRIPTION = """Look at an environment: in a window, or, where there is no display or with --output, in a file.

A window shows episodes of a policy until it is closed; drag turns, scrolling comes closer. A picture
(.png, .jpg) shows the end of an episode, a film (.gif, .mp4) all of it.

examples:
  spatula view press
  spatula view clamp --policy pretrained --output clamp.gif
  spatula view fissure --steps 0 --output fissure.png"""


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "view", "look at an environment, in a window or a file", DESCRIPTION)
    add_environment_options(parser)
    parser.add_argument("--policy", default="expert", help=f"what acts: {POLICY_HELP} (default: %(default)s)")
    parser.add_argument("--steps", metavar="N", type=at_least(0), help="control steps to show; an episode if not given")
    parser.add_argument("--output", type=Path, metavar="FILE", help=f"one of {', '.join((*PICTURES, *FILMS))}")
    parser.add_argument(
        "--size",
        metavar="N",
        type=at_least(16),
        default=480,
        help="of the picture's edges, in pixels (default: %(default)s)",
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Show the environment in a window, or write a picture or a film of it."""
    env_id = resolve_env(chosen.env)
    actor = find_actor(chosen.policy, env_id)
    output: Path | None = chosen.output
    if output is None and not has_window():
        output = Path("out/view") / f"{task_name(env_id)}.png"
    if output is not None:
        check_ending(output, (*PICTURES, *FILMS))
    env = make_environment(
        chosen,
        {"width": chosen.size, "height": chosen.size, **actor.options},
        render_mode="human" if output is None else "rgb_array",
    )
    base: Any = env.unwrapped
    try:
        film = None if output is None else Film(output, env.metadata["render_fps"])
        policy = actor.make(env, chosen.seed)
        seed, shown, over = chosen.seed, 0, False
        while not over:
            observation, info = env.reset(seed=seed)
            if film is not None:
                film.take(env)
            ended = False
            while not ended and shown != chosen.steps:
                observation, _, terminated, truncated, info = env.step(policy(observation))
                shown += 1
                ended = terminated or truncated or bool(info["is_success"])
                if film is not None:
                    film.take(env)
                elif base.window_closed:
                    return 0
            seed += 1
            over = film is not None or shown == chosen.steps
    finally:
        env.close()
    if film is not None:
        print(film.write())
    return 0
