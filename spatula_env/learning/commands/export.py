"""The command that writes a policy into a file that needs no torch: `spatula export`, or `python -m agents.export`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from spatula_env.files import whole_file
from spatula_env.learning.commands.common import add_overwrite_option, run_command
from spatula_env.learning.configuration import ENGINES, USUAL_ENGINES, to_mapping
from spatula_env.naming import registered_id

PROGRAM = "spatula export"


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Export the policy of a run, with its provenance in a file beside it.

    Args:
        arguments: Arguments after the command's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = argparse.ArgumentParser(prog=program, description="Write a policy that needs no torch.")
    parser.add_argument("run", type=Path, help="folder of a run, or of one of its policies or checkpoints")
    parser.add_argument("output", type=Path, help="file to write, .npz; the provenance goes beside it as .json")
    parser.add_argument(
        "--episodes", type=int, default=0, metavar="N",
        help="evaluate in N episodes in each engine, and write that down too; default: what training found only",
    )  # fmt: skip
    parser.add_argument(
        "--engines", nargs="+", choices=ENGINES, default=list(USUAL_ENGINES), help="default: %(default)s"
    )
    parser.add_argument(
        "--env", metavar="MODULE:ID",
        help="with --episodes: the environment, if it is one of your own that has to be imported",
    )  # fmt: skip
    add_overwrite_option(parser)
    chosen = parser.parse_args(arguments)
    if chosen.output.suffix != ".npz":
        parser.error(f"output must end with .npz, got {chosen.output}")
    if chosen.episodes < 0:
        parser.error(f"--episodes must be 0 or more, got {chosen.episodes}")
    return run_command(program, "exporting", "train", lambda: _export(chosen))


def _export(chosen: argparse.Namespace) -> None:
    from spatula_env.files import check_can_write, check_free

    for file in (chosen.output, chosen.output.with_suffix(".json")):
        check_free(file, chosen.overwrite)
    check_can_write(chosen.output.parent)
    episodes = {engine: chosen.episodes for engine in chosen.engines}
    export_saved(chosen.run, chosen.output, episodes, chosen.env)
    print(f"{chosen.output}: {chosen.output.stat().st_size / 1024:.0f} KiB")


def export_saved(path: Path, output: Path, episodes: Mapping[str, int] | None = None, env: str | None = None) -> None:
    """Write the policy of a run as weights, with its provenance as a JSON file beside it.

    Args:
        path: See `find_saved`.
        output: Ends with .npz.
        episodes: Number of episodes to evaluate it in, by engine; the same as those of `spatula evaluate` with `--seed
            0`.
        env: The environment as the user names it; needed to evaluate if its module has to be imported.
    """
    from spatula_env.learning.evaluation import Plan, evaluate, summarize
    from spatula_env.learning.export import export_policy
    from spatula_env.learning.finding import find_policy
    from spatula_env.learning.saving import (
        EVALUATION,
        definition_of,
        export_metadata,
        find_saved,
        load_model,
        load_normalizer,
        read_saved_config,
        write_json,
    )
    from spatula_env.learning.storage import read_steps

    folder = find_saved(path)
    config = read_saved_config(folder)
    env_id = registered_id(config.environment.id, env) if any((episodes or {}).values()) else config.environment.id
    metadata = export_metadata(config, definition_of(folder))
    exported = export_policy(load_model(folder, config), load_normalizer(folder), metadata)
    run = folder.parent
    evaluation: dict[str, Any] = {}
    if (folder / EVALUATION).exists():
        evaluation["training"] = json.loads((folder / EVALUATION).read_text(encoding="utf-8"))
    # Write both files or none, once everything is known.
    with whole_file(output) as unfinished:
        exported.save(unfinished)
        for engine, count in (episodes or {}).items():
            if count:
                source = find_policy(str(unfinished), env_id)
                results, _ = evaluate(source, Plan(env_id, source.kwargs, engine, count, 0))
                evaluation[engine] = summarize(results)
    origin: dict[str, Any] = {}
    for candidate in (run / "provenance.json", run.parent / "provenance.json"):
        if candidate.exists():
            origin = json.loads(candidate.read_text(encoding="utf-8"))
            break
    write_json(
        output.with_suffix(".json"),
        {
            "steps": read_steps(folder),
            "seed": config.seeds[0],
            "evaluation": evaluation,
            "config": to_mapping(config),
            **origin,
        },
    )
