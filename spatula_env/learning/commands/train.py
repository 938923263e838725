"""The command that trains agents: `spatula train`, or `python -m agents.train` in a checkout."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from spatula_env.learning.commands.common import Interrupted, add_overwrite_option, run_command, run_parser, warn

PROGRAM = "spatula train"


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run the command.

    Args:
        arguments: Arguments after the command's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = run_parser(program, "Train agents.", "hyperparameters.gamma=0.9")
    parser.add_argument("--seed", type=int, nargs="+", help="one agent is trained for each; default: those of the file")
    parser.add_argument(
        "--env", metavar="MODULE:ID",
        help="with --resume: the environment, if it is one of your own that has to be imported",
    )  # fmt: skip
    add_overwrite_option(parser)
    chosen = parser.parse_args(arguments)
    if chosen.resume is not None and (chosen.seed or chosen.output or chosen.overwrite):
        parser.error("--resume goes on as the run began: it takes neither --seed, --output nor --overwrite")
    if chosen.env is not None and chosen.resume is None:
        parser.error("--env goes with --resume; a new run is told by --set environment.id=MODULE:ID")
    return run_command(program, "training", "train", lambda: _run(chosen, program))


def _run(chosen: argparse.Namespace, program: str) -> None:
    from spatula_env.learning.checks import check_training
    from spatula_env.learning.folders import clear_place, describe_saved, new_run, occupied, resumed_run
    from spatula_env.learning.progress import ProgressView
    from spatula_env.learning.saving import CHECKPOINTS, SUMMARY, checkpoints_in
    from spatula_env.learning.training import train_place, write_config

    if chosen.resume is not None:
        place = resumed_run(chosen.resume, chosen.changes, chosen.env)
    else:
        seeds = [f"seeds={chosen.seed}"] if chosen.seed else []
        place = new_run(chosen.config, [*chosen.changes, *seeds], chosen.output, overwrite=chosen.overwrite)
    folders = [place.seed_folder(seed) for seed in place.config.seeds]
    if chosen.resume is None or not any(checkpoints_in(folder / CHECKPOINTS) for folder in folders):
        for note in check_training(place.config):
            warn(program, note)
    with occupied(place.folder):
        if chosen.resume is None:
            clear_place(place.folder, chosen.overwrite)
        if not place.alone:
            write_config(place.folder, place.config)
        for folder in folders:
            if (folder / SUMMARY).exists() and chosen.resume is not None and not chosen.changes:
                warn(program, f"{folder} is finished; --set total_steps=N trains it for longer")
        try:
            train_place(place, ProgressView(quiet=chosen.quiet))
        except KeyboardInterrupt:
            more = f" --env {chosen.env or place.config.environment.id}" if ":" in place.config.environment.id else ""
            raise Interrupted(f"{describe_saved(place)}; go on with: {program} --resume {place.folder}{more}") from None
    print(place.folder)
