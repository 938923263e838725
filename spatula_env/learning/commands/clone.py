"""The command that imitates demonstrations: `spatula clone`, or `python -m agents.clone` in a checkout."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.learning.commands.common import Interrupted, add_overwrite_option, run_command, warn
from spatula_env.learning.configuration import (
    ALGORITHMS,
    ENGINES,
    EnvironmentConfig,
    TrainingConfig,
    find_config,
    read_training,
)
from spatula_env.naming import find_environment, task_name

if TYPE_CHECKING:
    from spatula_env.learning.demonstrations import Demonstration
    from spatula_env.learning.evaluation import Plan
    from spatula_env.learning.imitation import CloneConfig

PROGRAM = "spatula clone"

GRADIENT_STEPS = 6_000
"""Default number of gradient steps."""


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run the command.

    Args:
        arguments: Arguments after the command's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = argparse.ArgumentParser(prog=program, description="Imitate demonstrations.")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--dataset", metavar="ID", help="demonstrations of a Minari data set")
    source.add_argument("--expert", type=int, metavar="N", help="N demonstrations of the scripted expert")
    parser.add_argument(
        "--config", metavar="NAME",
        help="environment, algorithm, network and normalisation: a YAML file, or the name of one in configs",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes", help="a change of it"
    )
    parser.add_argument(
        "--env", metavar="ID", help="environment, without --config; with --dataset if it is one of your own: MODULE:ID"
    )
    parser.add_argument("--algorithm", choices=("sac", "ppo"), help="whose actor, without --config; default: sac")
    parser.add_argument("--engine", choices=ENGINES, default="batch", help="that the expert demonstrates in")
    parser.add_argument(
        "--noise", type=_noise, default="auto", metavar="S",
        help="standard deviation of what leads the expert astray; default: the greatest that it copes with",
    )  # fmt: skip
    parser.add_argument("--gradient-steps", type=int, default=GRADIENT_STEPS, help="default: %(default)s")
    parser.add_argument(
        "--rounds", type=int, default=0, metavar="N",
        help="with --expert: how often the policy acts and is corrected, in as many episodes; default: %(default)s",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument("--output", type=Path, metavar="DIR", help="default: runs/ and the task's name")
    add_overwrite_option(parser)
    chosen = parser.parse_args(arguments)
    for name, least in (("expert", 1), ("rounds", 0), ("gradient_steps", 1), ("seed", 0)):
        value = getattr(chosen, name)
        if value is not None and value < least:
            parser.error(f"--{name.replace('_', '-')} must be {least} or more, got {value}")
    if chosen.rounds and chosen.expert is None:
        parser.error("--rounds needs --expert: a data set corrects nobody")
    if chosen.noise != "auto" and not 0.0 <= chosen.noise < np.inf:
        parser.error(f"--noise must be a number from 0 on or 'auto', got {chosen.noise}")
    if chosen.expert is not None and chosen.config is None and chosen.env is None:
        parser.error("--expert needs --config or --env")
    if chosen.changes and chosen.config is None:
        parser.error("--set needs --config")
    if chosen.config is not None and (chosen.env or chosen.algorithm):
        parser.error("--config says which environment and algorithm: leave --env and --algorithm out")
    return run_command(program, "cloning", "train", lambda: print(_run(chosen, program)))


def _run(chosen: argparse.Namespace, program: str) -> Path:
    """Clone as the command line asks; return the folder of the policy."""
    from spatula_env.learning.checks import rehearse_clone
    from spatula_env.learning.folders import check_place, occupied
    from spatula_env.learning.imitation import CloneConfig

    config = read_training(find_config(chosen.config), chosen.changes) if chosen.config is not None else None
    plan = _planned(chosen, config)
    output: Path = chosen.output or Path("runs") / f"{task_name(plan.env_id)}_clone"
    check_place(output, chosen.overwrite)
    if config is None:
        algorithm = chosen.algorithm or "sac"
        more = {"n_steps": 2, "batch_size": 2} if algorithm == "ppo" else {}
        config = TrainingConfig(
            EnvironmentConfig(plan.env_id, dict(plan.kwargs)), algorithm, ALGORITHMS[algorithm](**more)
        )
    environment = dataclasses.replace(config.environment, id=plan.env_id)
    config = dataclasses.replace(config, environment=environment, seeds=(chosen.seed,))
    how = CloneConfig(gradient_steps=chosen.gradient_steps, seed=chosen.seed)
    rehearse_clone(config)
    saved: list[str] = []
    try:
        demonstrations, source, made_steps = _demonstrate(chosen, plan, config)
        successes = sum(each.success for each in demonstrations)
        if demonstrations and not successes:
            warn(program, f"none of the {len(demonstrations)} demonstrations of {source} succeeded")
        with occupied(output):
            _learn(output, plan, config, how, (demonstrations, source, made_steps), chosen, saved)
    except KeyboardInterrupt:
        told = f"{saved[-1]} is in {output}; --overwrite begins anew" if saved else "nothing has been saved"
        raise Interrupted(told) from None
    return output


def _learn(
    output: Path,
    plan: Plan,
    config: TrainingConfig,
    how: CloneConfig,
    shown: tuple[list[Demonstration], str, int],
    chosen: argparse.Namespace,
    saved: list[str],
) -> None:
    """Imitate, run the rounds of corrections, and save the results.

    Args:
        output: Folder of the policy.
        plan: Plan of the demonstrations.
        config: Training configuration.
        how: Settings of cloning.
        shown: The demonstrations, a description of their source, and the number of control steps made for them.
        chosen: Command line, with the number of rounds and whether to overwrite.
        saved: Called with a description of what has been saved.
    """
    from spatula_env.learning.cloning import clone, correct
    from spatula_env.learning.demonstrations import steps_of
    from spatula_env.learning.folders import clear_place
    from spatula_env.learning.saving import POLICY, PROVENANCE, provenance, save_policy, write_json

    demonstrations, source, made_steps = shown
    model, normalizer, losses = clone(config, demonstrations, how)
    origin = {
        **provenance(config.environment.id),
        "demonstrations": {
            "source": source,
            "episodes": len(demonstrations),
            "steps": steps_of(demonstrations),
            "steps_made": made_steps,
            "success_rate": float(np.mean([each.success for each in demonstrations])),
        },
        "clone": dataclasses.asdict(how),
        "losses": losses,
        "rounds": [],
    }
    print(
        f"{len(demonstrations)} demonstrations, {100 * origin['demonstrations']['success_rate']:.0f} % successful;"
        f" mean squared difference of actions {losses[0]:.4f} at first, {losses[-1]:.4f} at last"
    )
    clear_place(output, chosen.overwrite)
    save_policy(output / POLICY, model, normalizer, config)
    write_json(output / PROVENANCE, origin)
    saved.append("the clone")
    for number in range(1, chosen.rounds + 1):
        before = steps_of(demonstrations)
        success, losses = correct(output, number, plan, config, demonstrations, (model, normalizer, how))
        made = steps_of(demonstrations) - before
        origin["rounds"].append({"episodes": plan.episodes, "steps": made, "success_rate": success, "losses": losses})
        print(
            f"round {number}: before it {100 * success:.0f} % successful; difference then {losses[-1]:.4f}", flush=True
        )
        save_policy(output / POLICY, model, normalizer, config)
        write_json(output / PROVENANCE, origin)
        saved.append(f"what round {number} of {chosen.rounds} has come to")


def _planned(chosen: argparse.Namespace, config: TrainingConfig | None) -> Plan:
    """Plan of the episodes to demonstrate; demonstrates nothing yet."""
    from spatula_env.learning.demonstrations import recorded_in
    from spatula_env.learning.evaluation import Plan

    named = config.environment.id if config is not None else chosen.env
    if chosen.dataset is not None:
        env_id, kwargs, count = recorded_in(chosen.dataset, named)
        return Plan(env_id, kwargs, chosen.engine, count, 0)
    kwargs = dict(config.environment.kwargs) if config is not None else {}
    for limit in ("max_episode_steps", "episode_time"):
        kwargs.pop(limit, None)
    return Plan(find_environment(named), kwargs, chosen.engine, chosen.expert, 2_000_000 + chosen.seed)


def _demonstrate(
    chosen: argparse.Namespace, plan: Plan, config: TrainingConfig
) -> tuple[list[Demonstration], str, int]:
    """The requested demonstrations, a description of their source, and the number of control steps made for them."""
    from spatula_env.learning.demonstrations import collect_successes, read_minari, steps_of

    parts = config.environment.parts
    if chosen.dataset is not None:
        demonstrations, _, _ = read_minari(chosen.dataset, parts, plan.env_id)
        return demonstrations, chosen.dataset, steps_of(demonstrations)
    demonstrations, sigma, made_steps = collect_successes(plan, noise=chosen.noise, parts=parts)
    return demonstrations, f"scripted expert, {chosen.engine} engine, noise {sigma:g}", made_steps


def _noise(text: str) -> float | str:
    """Parse a number or "auto"."""
    return text if text == "auto" else float(text)
