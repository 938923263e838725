"""Behaviour cloning: a policy that imitates demonstrations, without any reward.

    python -m agents.clone --dataset spatula/press/expert-v0
    python -m agents.clone --env Spatula/Press-v0 --expert 50
    python -m agents.clone --config press_sac --expert 50
    python -m agents.clone --config clamp_sac --expert 64 --rounds 8

What is cloned is the actor of Stable-Baselines3's SAC or PPO. It is saved as training saves policies, so that
`agents.evaluate` and `agents.export` take it. The last line of the output is where it is.

With `--rounds` the policy is corrected: it acts in episodes of its own, the expert says at each step what it would have
done there, and all that has been said so far is imitated (DAgger; S. Ross, G. Gordon and D. Bagnell, "A Reduction of
Imitation Learning and Structured Prediction to No-Regret Online Learning", AISTATS 2011).
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.command_line import Interrupted, add_overwrite_option, run_command, warn
from agents.configuration import (
    ALGORITHMS,
    ENGINES,
    EnvironmentConfig,
    SACConfig,
    TrainingConfig,
    find_config,
    read_training,
)
from spatula_env.naming import find_environment, task_name

if TYPE_CHECKING:
    from agents.demonstrations import Demonstration
    from agents.evaluation import Plan
    from agents.imitation import CloneConfig

PROGRAM = "python -m agents.clone"

GRADIENT_STEPS = 6_000
"""Usual number of gradient steps."""

ROUND_SEEDS = 100_000
"""Seeds of a round of corrections are so much greater than those of the one before."""

WORLDS = 64
"""In which a policy that is corrected acts at once."""


def clone(
    config: TrainingConfig, demonstrations: Sequence[Demonstration], how: CloneConfig
) -> tuple[Any, Any, list[float]]:
    """Imitate demonstrations.

    Args:
        config: Environment, algorithm, network and normalisation.
        demonstrations: Of which observations and wanted actions count.
        how: How cloning goes.

    Returns:
        The model, what normalises its observations (None: nothing), and the losses: the mean squared difference between
        actions, averaged over each tenth of the gradient steps.

    Raises:
        ValueError: If there is no demonstration.
    """
    import torch
    from stable_baselines3.common.vec_env import VecNormalize

    from agents.demonstrations import joined_observations
    from agents.models import make_model
    from agents.worlds import make_training_env

    if not demonstrations:
        raise ValueError("demonstrations must be one at least, got none")
    torch.set_num_threads(config.torch_threads)
    config = dataclasses.replace(config, environment=dataclasses.replace(config.environment, num_envs=1))
    if isinstance(config.hyperparameters, SACConfig):
        # It stays empty.
        config = dataclasses.replace(config, hyperparameters=dataclasses.replace(config.hyperparameters, buffer_size=1))
    env, _ = make_training_env(config, how.seed, config.hyperparameters.gamma)
    try:
        model: Any = make_model(config, env, how.seed)
        normalizer = env if isinstance(env, VecNormalize) else None
        if normalizer is not None and normalizer.norm_obs:
            observations = joined_observations(demonstrations)
            statistics = normalizer.obs_rms if isinstance(normalizer.obs_rms, dict) else {"": normalizer.obs_rms}
            for key, running in statistics.items():
                running.update(observations[key] if key else observations)
        if normalizer is not None:
            normalizer.training = False
        return model, normalizer, _fit(model, normalizer, demonstrations, how)
    finally:
        env.close()


def _fit(model: Any, normalizer: Any, demonstrations: Sequence[Demonstration], how: CloneConfig) -> list[float]:
    """Imitate demonstrations, going on from what a model does now; returns the losses."""
    from agents.demonstrations import joined_observations
    from agents.imitation import imitate

    observations = joined_observations(demonstrations)
    if normalizer is not None:
        observations = normalizer.normalize_obs(observations)
    return imitate(model, observations, np.concatenate([each.actions for each in demonstrations]), how)


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Clone.

    Args:
        arguments: What follows the command's name; None takes them from the command line.
        program: The command as it was typed.

    Returns:
        The exit status: 0 if all went well.
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
    """Clone as the command line says; returns the folder of the policy."""
    from agents.checks import rehearse_clone
    from agents.folders import check_place, occupied
    from agents.imitation import CloneConfig

    config = read_training(find_config(chosen.config), chosen.changes) if chosen.config is not None else None
    plan = _planned(chosen, config)
    output: Path = chosen.output or Path("runs") / f"{task_name(plan.env_id)}_clone"
    check_place(output, chosen.overwrite)
    if config is None:
        algorithm = chosen.algorithm or "sac"
        more = {"n_steps": 2, "batch_size": 2} if algorithm == "ppo" else {}
        config = TrainingConfig(EnvironmentConfig(plan.env_id, plan.kwargs), algorithm, ALGORITHMS[algorithm](**more))
    environment = dataclasses.replace(config.environment, id=plan.env_id)
    config = dataclasses.replace(config, environment=environment, seeds=(chosen.seed,))
    how = CloneConfig(gradient_steps=chosen.gradient_steps, seed=chosen.seed)
    rehearse_clone(config)
    saved: list[str] = []
    try:
        demonstrations, source = _demonstrate(chosen, plan, config)
        successes = sum(each.success for each in demonstrations)
        if demonstrations and not successes:
            warn(program, f"none of the {len(demonstrations)} demonstrations of {source} succeeded")
        with occupied(output):
            _learn(output, plan, config, how, (demonstrations, source), chosen, saved)
    except KeyboardInterrupt:
        told = f"{saved[-1]} is in {output}; --overwrite begins anew" if saved else "nothing has been saved"
        raise Interrupted(told) from None
    return output


def _learn(
    output: Path,
    plan: Plan,
    config: TrainingConfig,
    how: CloneConfig,
    shown: tuple[list[Demonstration], str],
    chosen: argparse.Namespace,
    saved: list[str],
) -> None:
    """Imitate, and be corrected, and save what comes of it.

    Args:
        output: Folder of the policy.
        plan: Of the demonstrations.
        config: What is trained.
        how: How it imitates.
        shown: The demonstrations, and where they are from.
        chosen: Says how often it is corrected, and whether it replaces another.
        saved: Told what has been saved.
    """
    from agents.folders import clear_place
    from agents.saving import POLICY, PROVENANCE, provenance, save_policy, write_json

    demonstrations, source = shown
    model, normalizer, losses = clone(config, demonstrations, how)
    origin = {
        **provenance(),
        "demonstrations": {
            "source": source,
            "episodes": len(demonstrations),
            "steps": int(sum(len(each.actions) for each in demonstrations)),
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
        success, losses = _correct(output, number, plan, config, demonstrations, (model, normalizer, how))
        origin["rounds"].append({"episodes": plan.episodes, "success_rate": success, "losses": losses})
        print(
            f"round {number}: before it {100 * success:.0f} % successful; difference then {losses[-1]:.4f}", flush=True
        )
        save_policy(output / POLICY, model, normalizer, config)
        write_json(output / PROVENANCE, origin)
        saved.append(f"what round {number} of {chosen.rounds} has come to")


def _planned(chosen: argparse.Namespace, config: TrainingConfig | None) -> Plan:
    """In what episodes there are demonstrations; nothing is demonstrated yet."""
    from agents.demonstrations import recorded_in
    from agents.evaluation import Plan

    named = config.environment.id if config is not None else chosen.env
    if chosen.dataset is not None:
        env_id, kwargs, count = recorded_in(chosen.dataset, named)
        return Plan(env_id, kwargs, chosen.engine, count, 0)
    kwargs = dict(config.environment.kwargs) if config is not None else {}
    for limit in ("max_episode_steps", "episode_time"):
        kwargs.pop(limit, None)
    return Plan(find_environment(named), kwargs, chosen.engine, chosen.expert, 2_000_000 + chosen.seed)


def _demonstrate(chosen: argparse.Namespace, plan: Plan, config: TrainingConfig) -> tuple[list[Demonstration], str]:
    """The demonstrations that the command line asks for, and in words where they are from."""
    from agents.demonstrations import collect_successes, read_minari

    parts = config.environment.parts
    if chosen.dataset is not None:
        demonstrations, _, _ = read_minari(chosen.dataset, parts, plan.env_id)
        return demonstrations, chosen.dataset
    demonstrations, sigma = collect_successes(plan, noise=chosen.noise, parts=parts)
    return demonstrations, f"scripted expert, {chosen.engine} engine, noise {sigma:g}"


def _correct(
    folder: Path,
    number: int,
    plan: Plan,
    config: TrainingConfig,
    demonstrations: list[Demonstration],
    learner: tuple[Any, Any, CloneConfig],
) -> tuple[float, list[float]]:
    """One round of corrections, which are added to the demonstrations.

    Args:
        folder: Where the policy is saved that acts.
        number: Of the round, from 1.
        plan: Of the demonstrations.
        config: What is trained.
        demonstrations: So far; lengthened.
        learner: The model, what normalises its observations, and how it imitates.

    Returns:
        The success rate of the policy that acted, and the losses of imitating all anew.
    """
    from agents.demonstrations import collect
    from agents.policies import find_policy

    corrected = collect(
        dataclasses.replace(plan, seed=plan.seed + ROUND_SEEDS * number),
        num_envs=WORLDS,
        parts=config.environment.parts,
        driver=find_policy(str(folder), plan.env_id),
    )
    demonstrations += corrected
    return float(np.mean([each.success for each in corrected])), _fit(*learner[:2], demonstrations, learner[2])


def _noise(text: str) -> float | str:
    """A number, or "auto"."""
    return text if text == "auto" else float(text)


if __name__ == "__main__":
    sys.exit(main())
