"""`spatula record`."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import (
    Stopped,
    add_environment_options,
    add_json_option,
    add_root_option,
    at_least,
    count_of,
    fail,
    make_environment,
    new_parser,
    note,
    print_json,
    say,
)
from spatula_env.cli.devices import (
    SCRIPTED,
    add_device_options,
    check_device,
    check_page,
    opened_device,
    serve_page,
    teleop_options,
)
from spatula_env.cli.play import add_view_options, describe, render_mode
from spatula_env.cli.showing import Film

if TYPE_CHECKING:
    from spatula_env.cli.acting import Actor
    from spatula_env.cli.common import Parsers
    from spatula_env.teleop.recording import RecordingSummary
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
    count.add_argument(
        "--episodes", metavar="N", type=at_least(1), help="how many to add (default: 1; on the page: until Ctrl-C)"
    )
    count.add_argument("--total", metavar="N", type=at_least(1), help="add until the dataset has so many")
    parser.add_argument("--attempts", metavar="N", type=at_least(1), help="end after so many tries, kept or not")
    parser.add_argument("--drop-failures", action="store_true", help="keep only episodes that reach their goal")
    parser.add_argument("--end-on-success", action="store_true", help="end an episode when its goal is reached")
    parser.add_argument(
        "--no-states",
        action="store_true",
        help="leave out the organ's nodes: smaller, but replays can be neither checked nor shown without physics",
    )
    parser.add_argument(
        "--state-dtype",
        choices=("float32", "float64"),
        default="float32",
        help="how precisely the organ's nodes are kept, and so replays are checked (default: %(default)s)",
    )
    parser.add_argument(
        "--haptics",
        action="store_true",
        help="record grip and forces at the haptic loop's rate too, in the folder haptics of the dataset",
    )
    parser.add_argument(
        "--author", metavar="NAME", default="unknown", help="who holds the device; kept with each episode"
    )
    parser.add_argument("--description", metavar="TEXT", default="", help="of the dataset")
    add_root_option(parser)
    add_device_options(parser)
    add_view_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Record."""
    from spatula_env.data.dataset import check_dataset_id, dataset_folder, require_minari
    from spatula_env.files import check_can_write

    on_page = chosen.device == "web"
    if on_page:
        check_page(chosen)
    actor = None if on_page else check_device(chosen)
    # With the page, the name may contain {task}, for a dataset of each task.
    check_dataset_id(chosen.dataset.replace("{task}", "task") if on_page else chosen.dataset)
    require_minari()
    check_can_write(dataset_folder(chosen.dataset, chosen.root))
    there = _total(chosen)
    if chosen.total is not None and there >= chosen.total:
        note(f"{chosen.dataset} has {count_of(there, 'episode')} already")
        if chosen.json:
            print_json({"dataset": chosen.dataset, "recorded": 0, "total_episodes": there})
        return 0
    try:
        return _report(chosen, _on_page(chosen) if on_page else _with_device(chosen, actor))
    except KeyboardInterrupt:
        # Counted on the disk, because the interrupt may have come between an episode and its count.
        added = _total(chosen) - there
        were = "was" if added == 1 else "were"
        raise Stopped(
            f"stopped; {count_of(added, 'episode')} {were} added to {chosen.dataset}, the one that was running was "
            "not. The same command goes on."
        ) from None


def _with_device(chosen: argparse.Namespace, actor: Actor | None) -> RecordingSummary:
    """Record with a device."""
    from spatula_env.data.dataset import check_target
    from spatula_env.teleop.recording import record

    env = make_environment(chosen, actor.options if actor is not None else None, render_mode=render_mode(chosen))
    film = None

    def tell(fate: str, summary: EpisodeSummary) -> None:
        note(f"{fate}: {describe(summary)}")

    def after_step(*_: Any) -> None:
        if film is not None:
            film.take(env)

    try:
        film = None if chosen.film is None else Film(chosen.film, env.metadata["render_fps"])
        # Checked before the operator takes hold of the device.
        check_target(chosen.dataset, env, chosen.root)
        with opened_device(chosen, env, actor, chosen.seed) as device:
            policy = actor.make(env, chosen.seed) if actor is not None and chosen.device not in SCRIPTED else None
            return record(
                env,
                device,
                chosen.dataset,
                episodes=chosen.episodes or 1,
                total=chosen.total,
                seed=chosen.seed,
                root=chosen.root,
                policy=policy,
                keep_failures=not chosen.drop_failures,
                attempts=chosen.attempts,
                end_on_success=chosen.end_on_success,
                states=not chosen.no_states,
                state_dtype=chosen.state_dtype,
                author=chosen.author,
                description=chosen.description,
                haptics=chosen.haptics,
                progress=tell,
                after_step=after_step,
                **teleop_options(chosen),
            )
    finally:
        env.close()
        if film is not None and film.frames:
            note(f"wrote {film.write()}")


def _on_page(chosen: argparse.Namespace) -> RecordingSummary:
    """Record on the web page until Ctrl-C, which saves the current episode as far as it has come."""
    from spatula_env.teleop.web.recording import RecordingOptions

    options = RecordingOptions(
        exclusive=True,
        author=chosen.author,
        description=chosen.description,
        # Without any of these, recording does not end by itself.
        episodes=chosen.episodes,
        total=chosen.total,
        attempts=chosen.attempts,
        keep_failures=not chosen.drop_failures,
        end_on_success=chosen.end_on_success,
        states=not chosen.no_states,
        state_dtype=chosen.state_dtype,
    )

    def tell(fate: str, summary: EpisodeSummary) -> None:
        if fate != "practice":
            note(f"{fate}: {describe(summary)}")

    return serve_page(chosen, options, tell, chosen.dataset)


def _report(chosen: argparse.Namespace, summary: RecordingSummary) -> int:
    """Print the result and return the exit status."""
    if chosen.json:
        result = asdict(summary)
        print_json({"dataset": result.pop("dataset_id"), **result})
    else:
        say(
            f"{count_of(summary.recorded, 'episode')} added to {summary.dataset_id}, {summary.successes} of them with "
            f"success; it has {summary.total_episodes} now, in {summary.path}"
        )
    if summary.lost is not None:
        return fail(
            f"{summary.lost}. What was recorded before is safe; the same command goes on.", command=chosen.command
        )
    return 0


def _total(chosen: argparse.Namespace) -> int:
    """Number of episodes in the dataset; 0 if it does not exist."""
    from spatula_env.data.dataset import dataset_folder
    from spatula_env.data.index import read_metadata

    try:
        return int(read_metadata(dataset_folder(chosen.dataset, chosen.root) / "data")["total_episodes"])
    except FileNotFoundError:
        return 0
