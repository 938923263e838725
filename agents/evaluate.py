"""Evaluates a policy, and says how well it does.

    python -m agents.evaluate --env Spatula/Press-v0 --policy expert --engine batch --episodes 100 --seed 0 --json

The last line of the output is one JSON object with `--json`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import yaml

from agents.configuration import ENGINES, changed
from agents.evaluation import Plan, evaluate, film, summarize
from agents.policies import find_policy


def main(arguments: Sequence[str] | None = None) -> int:
    """Evaluate.

    Args:
        arguments: What follows the module's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    parser = argparse.ArgumentParser(prog="python -m agents.evaluate", description="Evaluate a policy.")
    parser.add_argument("--env", required=True, metavar="ID", help="environment, such as Spatula/Press-v0")
    parser.add_argument(
        "--policy", required=True, help="expert, random, pretrained, or the path of a run or of exported weights"
    )
    parser.add_argument("--engine", choices=ENGINES, default="batch", help="default: %(default)s")
    parser.add_argument("--episodes", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode; default: %(default)s")
    parser.add_argument("--processes", type=int, help="default: one in the batch engine, one for each core in Bullet")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
        help="an option of the environment; values are YAML",
    )  # fmt: skip
    parser.add_argument("--video", type=Path, metavar="FILE", help="write a film of some episodes, .mp4 or .gif")
    parser.add_argument("--json", action="store_true", help="end with one JSON object")
    chosen = parser.parse_args(arguments)
    for name, least in (("episodes", 1), ("seed", 0), ("processes", 1)):
        value = getattr(chosen, name)
        if value is not None and value < least:
            parser.error(f"--{name} must be {least} or more, got {value}")
    if chosen.video is not None and chosen.video.suffix not in (".mp4", ".gif"):
        parser.error(f"--video must end with .mp4 or .gif, got {chosen.video}")
    try:
        report = run(chosen)
    except (FileNotFoundError, ValueError, TypeError, ImportError, gymnasium.error.Error, yaml.YAMLError) as error:
        print(f"agents.evaluate: {error}", file=sys.stderr)
        return 1
    if not chosen.json:
        print(describe(report))
    else:
        print(json.dumps(report))
    return 0


def run(chosen: argparse.Namespace) -> dict[str, Any]:
    """Evaluate as the command line says; returns what there is to report."""
    source = find_policy(chosen.policy, chosen.env)
    kwargs = changed(source.kwargs, chosen.changes)
    plan = Plan(chosen.env, kwargs, chosen.engine, chosen.episodes, chosen.seed)
    episodes, rate = evaluate(source, plan, processes=chosen.processes)
    if chosen.video is not None:
        film(source, plan, chosen.video)
    return {
        "env": chosen.env,
        "policy": chosen.policy,
        "engine": chosen.engine,
        "seed": chosen.seed,
        "kwargs": kwargs,
        **summarize(episodes),
        "steps_per_second": rate,
        **({"provenance": dict(source.provenance)} if source.provenance else {}),
    }


def describe(report: dict[str, Any]) -> str:
    """A report for people."""
    low, high = report["success_interval"]
    took = report["time_to_success"]
    lines = [
        f"{report['policy']} in {report['env']}, {report['engine']} engine, {report['episodes']} episodes",
        f"  success          {100 * report['success_rate']:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f})",
        f"  return           {report['return']:.1f} ± {report['return_deviation']:.1f}",
        f"  cost             {report['cost']:.1f} Pa s",
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


if __name__ == "__main__":
    sys.exit(main())
