"""`spatula record`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import (
    FAILURE,
    Stopped,
    add_environment_options,
    add_json_option,
    add_root_option,
    at_least,
    fail,
    make_environment,
    new_parser,
    note,
    print_json,
)
from spatula_env.cli.devices import (
    SCRIPTED,
    add_device_options,
    check_device,
    opened_device,
    serve_page,
    teleop_options,
)
from spatula_env.cli.play import add_view_options, describe, render_mode
from spatula_env.cli.showing import Film

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers
    from spatula_env.teleop.session import EpisodeSummary

DESCRIPTION = """Record demonstrations as a Minari dataset, episode by episode.

An episode is on the disk before the next begins. However a recording ends, the same command goes
on with it: episodes are added to the dataset, and no seed comes twice. Every episode knows whether
a human or a program did it, with which device, and whether its goal was reached.

examples:
  spatula record press --dataset spatula/press/my-v0 --device gamepad --episodes 10
  spatula record press --dataset spatula/press/my-v0 --device falcon --total 50 --drop-failures
  spatula record press --dataset spatula/press/my-v0 --device web"""


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "record", "record demonstrations as a dataset", DESCRIPTION)
    add_environment_options(parser)
    parser.add_argument("--dataset", required=True, metavar="NAME", help="as spatula/press/my-v0; made, or added to")
    count = parser.add_mutually_exclusive_group()
    count.add_argument("--episodes", metavar="N", type=at_least(1), help="how many to add (default: 1)")
    count.add_argument("--total", metavar="N", type=at_least(1), help="add until the dataset has so many")
    parser.add_argument(
        "--attempts", metavar="N", type=at_least(1), help="end after so many tries, whatever came of them"
    )
    parser.add_argument("--drop-failures", action="store_true", help="keep only episodes that reach their goal")
    parser.add_argument("--end-on-success", action="store_true", help="end an episode when its goal is reached")
    parser.add_argument(
        "--no-states",
        action="store_true",
        help="leave out the organ's nodes: smaller, but replays can be neither checked nor shown without physics",
    )
    parser.add_argument("--author", metavar="NAME", default="unknown", help="who holds the device")
    parser.add_argument("--description", metavar="TEXT", default="", help="of the dataset")
    add_root_option(parser)
    add_device_options(parser)
    add_view_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Record."""
    if chosen.device == "web":
        return serve_page(chosen, chosen.dataset)
    actor = check_device(chosen)
    from spatula_env.data.dataset import require_minari
    from spatula_env.data.recording import record

    require_minari()
    mode = render_mode(chosen)
    wanted, there = _wanted(chosen)
    if wanted == 0:
        note(f"{chosen.dataset} has {there} episodes already")
        if chosen.json:
            print_json({"dataset": chosen.dataset, "recorded": 0, "total_episodes": there})
        return 0
    env = make_environment(chosen, actor.options if actor is not None else None, render_mode=mode)
    film = None if chosen.film is None else Film(chosen.film, env.metadata["render_fps"])
    count = 0

    def tell(fate: str, summary: EpisodeSummary) -> None:
        nonlocal count
        count += fate == "recorded"
        note(f"{fate}: {describe(summary)}")

    def after_step(*_: Any) -> None:
        if film is not None:
            film.take(env)

    try:
        with opened_device(chosen, env, actor, chosen.seed) as device:
            policy = actor.make(env, chosen.seed) if actor is not None and chosen.device not in SCRIPTED else None
            summary = record(
                env,
                device,
                chosen.dataset,
                episodes=wanted,
                seed=chosen.seed,
                root=chosen.root,
                policy=policy,
                keep_failures=not chosen.drop_failures,
                attempts=chosen.attempts,
                end_on_success=chosen.end_on_success,
                states=not chosen.no_states,
                author=chosen.author,
                description=chosen.description,
                progress=tell,
                after_step=after_step,
                **teleop_options(chosen),
            )
    except KeyboardInterrupt:
        raise Stopped(
            f"stopped; {count} episodes were added to {chosen.dataset}, the one that was running was not. "
            "The same command goes on."
        ) from None
    finally:
        env.close()
        if film is not None and film.frames:
            note(f"wrote {film.write()}")
    result = {
        "dataset": summary.dataset_id,
        "path": summary.path,
        "recorded": summary.recorded,
        "discarded": summary.discarded,
        "successes": summary.successes,
        "total_episodes": summary.total_episodes,
        "lost": summary.lost,
    }
    if chosen.json:
        print_json(result)
    else:
        print(
            f"{summary.recorded} episodes added to {summary.dataset_id}, {summary.successes} of them with success; "
            f"it has {summary.total_episodes} now, in {summary.path}"
        )
    if summary.lost is not None:
        return fail(f"{summary.lost}. What was recorded before is safe; the same command goes on.", FAILURE)
    return 0


def _wanted(chosen: argparse.Namespace) -> tuple[int, int]:
    """How many episodes are to be added, and how many there are."""
    from spatula_env.data.dataset import dataset_folder
    from spatula_env.data.index import METADATA_FILE
    from spatula_env.data.replaying import open_dataset

    there = 0
    if (dataset_folder(chosen.dataset, chosen.root) / "data" / METADATA_FILE).exists():
        there = int(open_dataset(chosen.dataset, chosen.root).total_episodes)
    return (int(chosen.episodes or 1) if chosen.total is None else max(0, int(chosen.total) - there)), there
