"""`spatula datasets`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env import engines
from spatula_env.cli.common import (
    FAILURE,
    LARGEST_SEED,
    CommandError,
    Stopped,
    add_json_option,
    add_root_option,
    at_least,
    count_of,
    engine_option,
    fail,
    new_parser,
    note,
    print_json,
    print_table,
    resolve_env,
    say,
)
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers
    from spatula_env.data.catalog import DatasetSummary
    from spatula_env.data.statistics import DatasetStatistics
    from spatula_env.teleop.session import EpisodeSummary

EPISODE_NAMES = ("operator", "device", "success", "engine", "author")
"""Attributes of each episode that `inspect` shows."""

DESCRIPTION = """Look after datasets of demonstrations: see what is there, join and clean them, draw their
statistics, make scripted ones, export them.

examples:
  spatula datasets list
  spatula datasets inspect spatula/press/my-v0
  spatula datasets merge spatula/press/monday-v0 spatula/press/tuesday-v0 --into spatula/press/both-v0
  spatula datasets drop-failures spatula/press/both-v0 --into spatula/press/good-v0
  spatula datasets statistics spatula/press/good-v0 --plot press.png
  spatula datasets make press clamp --episodes 50
  spatula datasets export-lerobot spatula/press/good-v0 --output press-lerobot"""


def add_parser(commands: Parsers) -> None:
    """Add the command and its subcommands."""
    parser = new_parser(commands, "datasets", "list, join, draw, make and export datasets", DESCRIPTION)
    inner = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    each = new_parser(inner, "list", "what datasets there are", "List all datasets, and how large they are.")
    each.set_defaults(run=_list)
    _add_common(each)

    each = new_parser(inner, "inspect", "what is in a dataset", "Tell what is in a dataset, episode by episode.")
    each.add_argument("dataset", metavar="DATASET")
    each.set_defaults(run=_inspect)
    _add_common(each)

    each = new_parser(
        inner, "merge", "several in one", "Copy the episodes of several datasets into a new one; they stay as they are."
    )
    each.add_argument("sources", nargs="+", metavar="DATASET")
    each.add_argument("--into", required=True, metavar="NAME", help="the new dataset")
    each.set_defaults(run=_merge)
    _add_common(each)

    each = new_parser(
        inner,
        "drop-failures",
        "a copy without failures",
        "Copy the episodes that reached their goal into a new dataset; the old one stays as it is.",
    )
    each.add_argument("dataset", metavar="DATASET")
    each.add_argument("--into", required=True, metavar="NAME", help="the new dataset")
    each.set_defaults(run=_drop_failures)
    _add_common(each)

    each = new_parser(
        inner,
        "statistics",
        "returns, lengths, forces; with a picture",
        "Tell what the episodes of a dataset are like; with --plot also as a picture: returns, lengths, share of\n"
        "successes, force and pressure over time, and where in its workspace the tool has been.",
    )
    each.add_argument("dataset", metavar="DATASET")
    each.add_argument("--plot", type=Path, metavar="FILE", help="draw them, .png, .svg or .pdf")
    each.set_defaults(run=_statistics)
    _add_common(each)

    _add_make(inner)
    _add_export(inner)


def _add_make(inner: Parsers) -> None:
    parser = new_parser(
        inner,
        "make",
        "scripted demonstrations of the tasks",
        "Make datasets of scripted demonstrations: spatula/press/scripted-v0 and so on. A scripted expert, late and\n"
        "with a tremor, moves the grip of a Novint Falcon in software: no human has done them, and every episode\n"
        'says so (operator "scripted"). Episodes that fail are kept and labelled. What is there already is not\n'
        "made again.",
    )
    parser.add_argument("tasks", nargs="*", metavar="ID", help="such as press; all if none is given")
    parser.add_argument(
        "--episodes", metavar="N", type=at_least(1), default=50, help="of each dataset (default: %(default)s)"
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=at_least(0, LARGEST_SEED),
        default=0,
        help="of the first episode (default: %(default)s)",
    )
    parser.add_argument("--engine", choices=engines.ENGINES, help=f"(default: {engines.DEFAULT})")
    parser.add_argument("--no-states", action="store_true", help="leave out the organ's nodes")
    parser.set_defaults(run=_make)
    _add_common(parser)


def _add_export(inner: Parsers) -> None:
    parser = new_parser(
        inner,
        "export-lerobot",
        "in the layout of LeRobot's datasets",
        "Write a dataset in the layout of LeRobot's datasets, version 3. LeRobot itself writes it, so it has to be\n"
        "installed: it needs Python 3.12 or later and a torch of its own choice, so make an environment for it and,\n"
        "there,\n"
        f"  {install_hint('lerobot')}\n"
        "What has no place in that layout (seeds, operators, devices) is in meta/spatula_env.json.",
    )
    parser.add_argument("dataset", metavar="DATASET")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="must not exist yet")
    parser.add_argument("--repo-id", metavar="NAME", help="by which LeRobot is to know it")
    parser.add_argument("--successes-only", action="store_true", help="leave failures out")
    parser.add_argument("--images", action="store_true", help="store pictures as PNG, not as lossy videos")
    parser.add_argument(
        "--camera",
        nargs=2,
        type=at_least(16),
        metavar=("HEIGHT", "WIDTH"),
        help="draw pictures from the recorded states, for datasets that have none [pixels]",
    )
    parser.set_defaults(run=_export)
    _add_common(parser)


def _add_common(parser: argparse.ArgumentParser) -> None:
    add_root_option(parser)
    add_json_option(parser)


def _list(chosen: argparse.Namespace) -> int:
    from spatula_env.data.catalog import list_datasets, summarize
    from spatula_env.data.dataset import dataset_folder

    summaries: list[DatasetSummary] = []
    damaged: dict[str, str] = {}
    for name in list_datasets(chosen.root):
        try:
            summaries.append(summarize(name, chosen.root))
        except (OSError, ValueError) as error:
            # The other datasets are still listed.
            damaged[name] = str(error)
    if chosen.json:
        print_json(
            {
                "datasets": [asdict(summary) for summary in summaries],
                "damaged": [{"dataset": name, "error": why} for name, why in damaged.items()],
            }
        )
    elif summaries:
        _print_list(summaries)
    else:
        say(f"no {'whole ' if damaged else ''}datasets in {dataset_folder('', chosen.root)}")
    for name, why in damaged.items():
        fail(f"{name} is damaged: {why}", command=chosen.command)
    return FAILURE if damaged else 0


def _print_list(summaries: Sequence[DatasetSummary]) -> None:
    rows = [["dataset", "environment", "episodes", "successes", "steps", "MB", "operators"]]
    for each in summaries:
        rows.append(
            [
                each.dataset_id,
                each.env_id,
                str(each.episodes),
                str(each.successes),
                str(each.steps),
                f"{each.megabytes:.1f}",
                _counts(each.operators),
            ]
        )
    print_table(rows, right=(2, 3, 4, 5))


def _inspect(chosen: argparse.Namespace) -> int:
    from spatula_env.data.catalog import summarize
    from spatula_env.data.dataset import read_layout
    from spatula_env.data.replaying import open_dataset, read_entries, recorded_specs
    from spatula_env.data.specs import differences

    summary = summarize(chosen.dataset, chosen.root)
    dataset = open_dataset(chosen.dataset, chosen.root)
    specs = recorded_specs(chosen.dataset, chosen.root)
    episodes = [
        {
            "episode": number,
            "steps": entry.steps,
            "seed": entry.seed,
            **{name: entry.attributes[name] for name in EPISODE_NAMES if name in entry.attributes},
            # The column is left out if all episodes were recorded with the same options.
            **({"spec": entry.spec} if len(specs) > 1 else {}),
        }
        for number, entry in enumerate(read_entries(chosen.dataset, chosen.root))
    ]
    layout = read_layout(chosen.dataset, chosen.root)
    metadata = dataset.storage.metadata
    if chosen.json:
        print_json(
            {
                **asdict(summary),
                "author": sorted(metadata.get("author", [])),
                "description": metadata.get("description", ""),
                "env_kwargs": dict(specs[0].kwargs),
                "specs": [json.loads(spec.to_json()) for spec in specs],
                "layout": layout.as_record(),
                "list": episodes,
            }
        )
        return 0
    _tell(summary, str(metadata.get("description", "")))
    say(f"  observations  {_describe_space(dataset.observation_space)}")
    acted = f": {', '.join(layout.action_names)}" if layout.action_names else ""
    say(f"  actions       {_describe_space(dataset.action_space)}{acted}")
    if episodes:
        print()
        names = list(dict.fromkeys(name for each in episodes for name in each))
        print_table([names, *([_cell(each.get(name)) for name in names] for each in episodes)], right=(0, 1, 2))
        for number, spec in enumerate(specs[1:], start=1):
            apart = differences(spec, specs[0], ("there", "in spec 0"))
            say(
                f"spec {number} "
                + (f"differs from spec 0 in {'; '.join(apart)}" if apart else "means the same as spec 0")
            )
    return 0


def _merge(chosen: argparse.Namespace) -> int:
    from spatula_env.data.catalog import copy_episodes

    with _nothing_half_made(chosen):
        summary = copy_episodes(chosen.sources, chosen.into, root=chosen.root)
    return _copied(chosen, summary)


def _drop_failures(chosen: argparse.Namespace) -> int:
    from spatula_env.data.catalog import copy_episodes, summarize

    before = summarize(chosen.dataset, chosen.root)
    if before.successes == 0:
        raise CommandError(f"no episode of {chosen.dataset!r} has reached its goal; nothing would be left")
    with _nothing_half_made(chosen):
        summary = copy_episodes(
            [chosen.dataset], chosen.into, root=chosen.root, keep=lambda episode: bool(episode.get("success", False))
        )
    note(f"{before.episodes - summary.episodes} of {before.episodes} episodes were left out")
    return _copied(chosen, summary)


@contextmanager
def _nothing_half_made(chosen: argparse.Namespace) -> Iterator[None]:
    """Turn Ctrl-C into the message that nothing of the target was made."""
    try:
        yield
    except KeyboardInterrupt:
        raise Stopped(f"stopped; nothing of {getattr(chosen, 'into', None) or chosen.output} was made") from None


def _copied(chosen: argparse.Namespace, summary: DatasetSummary) -> int:
    if chosen.json:
        print_json(asdict(summary))
    else:
        say(f"{summary.dataset_id} has {summary.episodes} episodes, {summary.steps} steps, in {summary.path}")
    return 0


def _statistics(chosen: argparse.Namespace) -> int:
    from spatula_env.data.plots import check_plot, plot_statistics
    from spatula_env.data.statistics import statistics

    if chosen.plot is not None:
        # Checked before all episodes are read.
        check_plot(chosen.plot)
    found = statistics(chosen.dataset, chosen.root)
    if chosen.plot is not None:
        plot_statistics(found, chosen.plot)
        note(f"drew {chosen.plot}")
    if chosen.json:
        print_json(found.as_record())
    else:
        _tell_statistics(found)
    return 0


def _tell_statistics(found: DatasetStatistics) -> None:
    record = found.as_record()
    if not record["episodes"]:
        say(f"{record['dataset']} has no episodes")
        return
    low, high = record["success_interval"]
    say(f"{record['dataset']}: {record['episodes']} episodes in {record['env']} ({_counts(record['operators'])})")
    say(f"  success        {100 * record['success_rate']:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f})")
    for name, label, factor, unit in (
        ("return", "return", 1.0, ""),
        ("length", "length", 1.0, "steps"),
        ("peak_force", "greatest force", 1.0, "N"),
        ("peak_pressure", "pressure", 1e-3, "kPa"),
        ("dose", "dose", 1.0, "Pa s"),
    ):
        spread = record[name]
        if spread is not None:
            numbers = {key: f"{factor * value:.4g}" for key, value in spread.items()}
            say(
                f"  {label:14} {numbers['mean']} {unit}".rstrip()
                + f" (mean), {numbers['least']} to {numbers['greatest']}, median {numbers['median']}"
            )
    if record["violation_rate"] is not None:
        say(f"  violations     in {100 * record['violation_rate']:.0f} % of the episodes")
    if record["coverage"] is not None:
        say(f"  coverage       {100 * record['coverage']:.1f} % of the workspace's cells of a tenth of its edges")


def _make(chosen: argparse.Namespace) -> int:
    from spatula_env.learning.policies import make_expert
    from spatula_env.teleop.scripted_dataset import make_scripted, scripted_ids

    known = scripted_ids()
    wanted = [resolve_env(name) for name in chosen.tasks] or list(known)
    results: dict[str, Any] = {}
    for env_id in dict.fromkeys(wanted):
        name = known[env_id]
        note(f"{name}: scripted expert, its hand on a Falcon in software")

        made_now = 0

        def tell(_: str, summary: EpisodeSummary, seconds: float) -> None:
            nonlocal made_now
            made_now += 1
            fate = "success" if summary.success else "NO SUCCESS, kept and labelled"
            note(f"  seed {summary.seed}: {fate}, {summary.steps} steps, {seconds:.1f} s")

        try:
            made = make_scripted(
                env_id,
                make_expert,
                episodes=chosen.episodes,
                seed=chosen.seed,
                options=engine_option(chosen),
                states=not chosen.no_states,
                root=chosen.root,
                progress=tell,
            )
        except KeyboardInterrupt:
            raise Stopped(
                f"stopped; {count_of(made_now, 'new episode')} of {name} {'is' if made_now == 1 else 'are'} there. "
                "The same command goes on."
            ) from None
        recording, seconds = made.recording, made.episode_seconds
        results[name] = {
            "env": env_id,
            "episodes": recording.total_episodes,
            "new": recording.recorded,
            "new_successes": recording.successes,
            "seconds_per_episode": sum(seconds) / len(seconds) if seconds else None,
            "path": recording.path,
        }
        if not chosen.json:
            took = f", {sum(seconds) / len(seconds):.1f} s each" if seconds else ""
            say(
                f"{name}: {recording.total_episodes} episodes, {recording.recorded} of them new "
                f"({recording.successes} with success{took})",
                flush=True,
            )
    if chosen.json:
        print_json(results)
    return 0


def _export(chosen: argparse.Namespace) -> int:
    from spatula_env.data.lerobot_export import export_lerobot

    with _nothing_half_made(chosen):
        made = export_lerobot(
            chosen.dataset,
            chosen.output,
            root=chosen.root,
            repo_id=chosen.repo_id,
            successes_only=chosen.successes_only,
            videos=not chosen.images,
            camera=None if chosen.camera is None else tuple(chosen.camera),
        )
    if chosen.json:
        print_json(asdict(made))
    else:
        say(f"{made.repo_id}: {made.episodes} episodes, {made.frames} frames, in {made.path}")
        say(f"  {', '.join(made.features)}")
    return 0


def _tell(summary: DatasetSummary, description: str) -> None:
    print(summary.dataset_id)
    if description:
        say(f"  {description}")
    share = f"{100 * summary.successes / summary.episodes:.0f} %" if summary.episodes else "none"
    for name, value in (
        ("environment", summary.env_id),
        ("episodes", f"{summary.episodes} ({_counts(summary.operators)})"),
        ("devices", _counts(summary.devices)),
        ("authors", _counts(summary.authors)),
        ("steps", f"{summary.steps}, {summary.mean_length:.1f} in an episode"),
        ("successes", f"{summary.successes} ({share})"),
        ("return", f"{summary.mean_return:.2f} in an episode"),
        ("peak force", f"{summary.mean_peak_force:.2f} N, mean of the episodes' greatest"),
        ("size", f"{summary.megabytes:.1f} MB in {summary.path}"),
    ):
        say(f"  {name:13} {value}")


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items()) or "none"


def _describe_space(space: Any) -> str:
    """Describe a space in a few words, without its bounds, which would fill a page."""
    inner = getattr(space, "spaces", None)
    if isinstance(inner, Mapping):
        return ", ".join(f"{name}: {_describe_space(each)}" for name, each in inner.items())
    shape = " x ".join(map(str, space.shape or ()))
    return f"{shape} {space.dtype}"


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else str(value)
