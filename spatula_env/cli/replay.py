"""`spatula replay`."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import gymnasium

from spatula_env.cli.common import (
    FAILURE,
    CommandError,
    Stopped,
    add_json_option,
    add_root_option,
    at_least,
    count_of,
    fail,
    new_parser,
    note,
    print_json,
    print_table,
    say,
)
from spatula_env.cli.play import add_view_options, render_mode
from spatula_env.cli.showing import Film

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers
    from spatula_env.data.replaying import EpisodeReplay
    from spatula_env.render.window import Window

SIZE = 480
"""Width and height of a film's pictures [pixels]."""

DESCRIPTION = """Do the episodes of a dataset again.

--by actions resets the environment with the recorded seeds, does the recorded actions, and compares
the organ's nodes, the tools and the rewards with the recorded ones. With the same engine and version
they agree; the greatest difference is printed, and the exit status is 1 if it is above --tolerance.

--by states shows what was recorded, without physics, and compares nothing.

examples:
  spatula replay spatula/press/my-v0
  spatula replay spatula/press/my-v0 --by states --episodes 3 --film episode.gif"""


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "replay", "do recorded episodes again and compare", DESCRIPTION)
    parser.add_argument("dataset", metavar="DATASET", help="its id, as spatula/press/my-v0")
    parser.add_argument("--by", choices=("actions", "states"), default="actions", help="(default: %(default)s)")
    parser.add_argument("--episodes", type=at_least(0), nargs="+", metavar="N", help="which; all if not given")
    parser.add_argument(
        "--tolerance", type=float, help="greatest difference that counts as the same, scene units (default: 1e-9)"
    )
    parser.add_argument(
        "--mean-actions",
        action="store_true",
        help="do what learners see of an operator who steered by hand, the mean of each control step, and tell how far "
        "that leads away",
    )
    parser.add_argument(
        "--env",
        metavar="MODULE:ID",
        help="the environment, if it is one of your own, with the module that registers it",
    )
    parser.add_argument(
        "--wrapper",
        action="append",
        default=[],
        metavar="MODULE:CLASS",
        help="a wrapper that the dataset may use with whatever arguments it gives; Gymnasium's are known",
    )
    parser.add_argument("--organ", metavar="FILE", help="the organ's file, if it is not where it was when recorded")
    add_root_option(parser)
    add_view_options(parser)
    add_json_option(parser)
    # A replay is run for its numbers; it is shown only on request.
    parser.set_defaults(run=run, view="none", device="replay")


def run(chosen: argparse.Namespace) -> int:
    """Replay."""
    from spatula_env.data.replaying import open_dataset

    dataset = open_dataset(chosen.dataset, chosen.root)
    total = int(dataset.total_episodes)
    numbers = list(range(total)) if chosen.episodes is None else chosen.episodes
    missing = [number for number in numbers if number >= total]
    if missing:
        raise CommandError(f"{chosen.dataset!r} has {total} episodes, there is no {missing[0]}")
    if not numbers:
        raise CommandError(f"{chosen.dataset!r} has no episodes")
    if chosen.mean_actions and chosen.by != "actions":
        raise CommandError("--mean-actions goes with --by actions: states are shown as they were recorded")
    if chosen.organ is not None and chosen.by != "actions":
        raise CommandError("--organ goes with --by actions: states are shown as they were recorded")
    if chosen.by == "states":
        return _by_states(chosen, dataset, numbers)
    return _by_actions(chosen, numbers)


def _by_actions(chosen: argparse.Namespace, numbers: list[int]) -> int:
    from spatula_env.data.replaying import TOLERANCE, replay
    from spatula_env.data.wrappers import import_wrapper

    tolerance = TOLERANCE if chosen.tolerance is None else chosen.tolerance
    film: Film | None = None

    def after_step(env: gymnasium.Env[Any, Any], _: int) -> None:
        nonlocal film
        if chosen.film is not None:
            film = film or Film(chosen.film, env.metadata["render_fps"])
            film.take(env)

    if chosen.film is not None:
        Film(chosen.film, 1.0)  # Raises at once if it cannot be written.
    told: list[EpisodeReplay] = []
    try:
        results = replay(
            chosen.dataset,
            root=chosen.root,
            episodes=numbers,
            tolerance=tolerance,
            render_mode=render_mode(chosen),
            env_id=chosen.env,
            wrappers=[import_wrapper(name) for name in chosen.wrapper],
            organ=chosen.organ,
            steering=not chosen.mean_actions,
            after_step=after_step,
            progress=told.append,
        )
    except KeyboardInterrupt:
        same = sum(each.matches for each in told)
        raise Stopped(
            f"stopped after {count_of(len(told), 'episode')} of {len(numbers)}, {same} of them as recorded"
        ) from None
    finally:
        # The film is also written after an interruption.
        if film is not None and film.frames:
            note(f"wrote {film.write()}")
    differences = [each.difference for each in results if not math.isnan(each.difference)]
    greatest = max(differences, default=math.nan)
    good = all(each.matches for each in results)
    if chosen.json:
        print_json(
            {
                "dataset": chosen.dataset,
                "by": "actions",
                "tolerance": tolerance,
                "difference": greatest,
                "reward_difference": max(each.reward_difference for each in results),
                "matches": good,
                "episodes": [asdict(each) for each in results],
            }
        )
    else:
        # Mean actions give other results, and their difference is what the user wants to know.
        differs = "by means" if chosen.mean_actions else "DIFFERS"
        rows = [["episode", "steps", "difference [u]", "reward", "success", ""]]
        for each in results:
            rows.append(
                [
                    str(each.episode),
                    str(each.steps),
                    "not recorded" if math.isnan(each.difference) else f"{each.difference:.1e}",
                    f"{each.reward_difference:.1e}",
                    "yes" if each.success else "no",
                    "as recorded" if each.matches else differs,
                ]
            )
        print_table(rows, right=(0, 1, 2, 3))
        found = "no states were recorded" if not differences else f"greatest difference {greatest:.3g} u"
        ending = "how far means of the actions lead from it" if chosen.mean_actions else f"tolerance {tolerance:g} u"
        say(f"{found}; {len(results)} episodes, {ending}")
    if chosen.mean_actions:
        return 0
    if not good:
        differing = sum(not each.matches for each in results)
        return fail(f"{differing} of {len(results)} episodes differ", FAILURE, chosen.command)
    return 0


def _by_states(chosen: argparse.Namespace, dataset: Any, numbers: list[int]) -> int:
    from spatula_env.data.dataset import read_layout
    from spatula_env.data.drawing import StatePainter, recorded_moments, recorded_scene, scene_triangles

    layout = read_layout(chosen.dataset, chosen.root)
    rate = layout.control_frequency or 20.0
    film = None if chosen.film is None else Film(chosen.film, rate)
    mode = render_mode(chosen)
    painter = StatePainter(layout, SIZE, SIZE) if mode == "rgb_array" else None
    window: Window | None = None
    if mode == "human":
        from spatula_env.render.window import Window

        scene = recorded_scene(layout)
        window = Window(scene, scene_triangles(scene), frames_per_second=rate)
    told = []
    for number in numbers:
        (episode,) = dataset.iterate_episodes([number])
        states = 0
        for moment in recorded_moments(episode):
            if painter is not None and film is not None:
                film.add(painter.draw(moment))
            if window is not None:
                window.show(moment)
            states += 1
        told.append({"episode": number, "states": states})
        if not chosen.json:
            say(f"episode {number}: {states} states, as they were recorded", flush=True)
    if window is not None:
        window.close()
    if film is not None:
        note(f"wrote {film.write()}")
    if chosen.json:
        print_json({"dataset": chosen.dataset, "by": "states", "episodes": told})
    return 0
