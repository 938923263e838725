"""The command that evaluates a policy: `spatula evaluate`, or `python -m agents.evaluate` in a checkout."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spatula_env.changes import with_changes
from spatula_env.definitions import definition_number
from spatula_env.envs.levels import LEVELS, SPLITS
from spatula_env.files import check_can_write, check_free
from spatula_env.learning.commands.common import add_overwrite_option, run_command
from spatula_env.learning.configuration import ENGINES
from spatula_env.naming import find_environment
from spatula_env.render.films import FILMS, check_film

PROGRAM = "spatula evaluate"


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run the command.

    Args:
        arguments: Arguments after the command's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = argparse.ArgumentParser(prog=program, description="Evaluate a policy.")
    parser.add_argument(
        "--env", required=True, metavar="ID",
        help="environment, such as Spatula/Press-v0, press for short, or MODULE:ID for one of your own",
    )  # fmt: skip
    parser.add_argument(
        "--policy",
        required=True,
        help="expert, proportional, random, pretrained, or the path of a run or of exported weights",
    )
    parser.add_argument("--engine", choices=ENGINES, default="batch", help="default: %(default)s")
    parser.add_argument("--level", choices=LEVELS, help="of difficulty; default: easy")
    parser.add_argument("--split", choices=SPLITS, help="test: on organs that are not drawn for training")
    parser.add_argument("--episodes", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode; default: %(default)s")
    parser.add_argument(
        "--horizon", choices=("success", "episode"), default="success",
        help="until when cost, dose, forces and the way are counted: until success, or for whole episodes; "
        "default: %(default)s",
    )  # fmt: skip
    parser.add_argument("--processes", type=int, help="default: one in the batch engine, one for each core in Bullet")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
        help="an option of the environment; values are YAML",
    )  # fmt: skip
    parser.add_argument("--video", type=Path, metavar="FILE", help="write a film of some episodes, .mp4 or .gif")
    parser.add_argument("--json", action="store_true", help="end with one JSON object")
    add_overwrite_option(parser)
    chosen = parser.parse_args(arguments)
    for name, least in (("episodes", 1), ("seed", 0), ("processes", 1)):
        value = getattr(chosen, name)
        if value is not None and value < least:
            parser.error(f"--{name} must be {least} or more, got {value}")
    if chosen.video is not None and chosen.video.suffix not in FILMS:
        parser.error(f"--video must end with .mp4 or .gif, got {chosen.video}")

    def report() -> None:
        found = run(chosen)
        print(json.dumps(found) if chosen.json else describe(found))

    return run_command(program, "evaluating", "train", report)


def run(chosen: argparse.Namespace) -> dict[str, Any]:
    """Evaluate as the command line asks; return the report."""
    from spatula_env.learning.evaluation import Plan, evaluate, film, summarize
    from spatula_env.learning.finding import find_policy
    from spatula_env.learning.policies import with_all_parts

    env_id = find_environment(chosen.env)
    if chosen.video is not None:
        check_free(chosen.video, chosen.overwrite)
        check_film(chosen.video)
        check_can_write(chosen.video.parent)
    level = {name: getattr(chosen, name) for name in ("level", "split") if getattr(chosen, name) is not None}
    changes = [*(f"{name}={value}" for name, value in level.items()), *chosen.changes]
    source = find_policy(chosen.policy, env_id)
    kwargs = with_all_parts(env_id, with_changes(source.kwargs, changes))
    plan = Plan(env_id, kwargs, chosen.engine, chosen.episodes, chosen.seed)
    episodes, rate = evaluate(source, plan, processes=chosen.processes, end_at_success=chosen.horizon == "success")
    if chosen.video is not None:
        film(source, plan, chosen.video)
    return {
        "env": env_id,
        "policy": chosen.policy,
        "engine": chosen.engine,
        "level": kwargs.get("level", LEVELS[0]),
        "split": kwargs.get("split", SPLITS[0]),
        "seed": chosen.seed,
        "kwargs": kwargs,
        "definition": definition_number(env_id),
        "horizon": chosen.horizon,
        **summarize(episodes),
        "steps_per_second": rate,
        **({"provenance": dict(source.provenance)} if source.provenance else {}),
    }


def describe(report: dict[str, Any]) -> str:
    """Format a report for reading."""
    low, high = report["success_interval"]
    took = report["time_to_success"]
    lines = [
        f"{report['policy']} in {report['env']}, {report['engine']} engine, {report['episodes']} episodes",
        f"  success          {100 * report['success_rate']:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f})",
        f"  return           {report['return']:.1f} ± {report['return_deviation']:.1f}",
        f"  within budget    {100 * report['safe_success_rate']:.1f} %",
        f"  cost             {1e3 * report['cost']:.1f} ms",
        f"  dose             {report['dose']:.1f} Pa s",
        f"  violations       in {100 * report['violation_rate']:.0f} % of episodes",
        f"  greatest force   {report['peak_force']:.2f} N (mean), {report['peak_force_max']:.2f} N (most)",
        f"  pressure         {report['peak_pressure']:.0f} Pa (mean), {report['peak_pressure_max']:.0f} Pa (most)",
        f"  time to success  {'never' if took is None else f'{took:.2f} s'}",
        f"  path             {1e3 * report['path_length']:.0f} mm",
        f"  speed            {report['steps_per_second']:.0f} steps/s",
    ]
    if report["diverged"]:
        lines.append(f"  physics broke down in {report['diverged']} episodes")
    return "\n".join(lines)
