"""Behaviour cloning: a policy that imitates demonstrations, without any reward.

    python -m agents.clone --dataset spatula/press/expert-v0
    python -m agents.clone --env Spatula/Press-v0 --expert 50
    python -m agents.clone --config configs/press_sac.yaml --expert 50

What is cloned is the actor of Stable-Baselines3's SAC or PPO. It is saved as training saves policies, so that
`agents.evaluate` and `agents.export` take it. The last line of the output is where it is.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from agents.configuration import (
    ALGORITHMS,
    ENGINES,
    EnvironmentConfig,
    TrainingConfig,
    read_training,
)


@dataclasses.dataclass(frozen=True)
class CloneConfig:
    """How cloning goes.

    Attributes:
        gradient_steps: How many.
        batch_size: Samples in each.
        learning_rate: Of Adam at the beginning; it falls to zero along a half wave.
        seed: Of networks and batches.
    """

    gradient_steps: int = 6_000
    batch_size: int = 256
    learning_rate: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("gradient_steps", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)!r}")
        if not 0.0 < self.learning_rate < np.inf:
            raise ValueError(f"learning_rate must be positive and finite, got {self.learning_rate!r}")


def clone(config: TrainingConfig, demonstrations: Sequence[Any], how: CloneConfig) -> tuple[Any, Any, list[float]]:
    """Imitate demonstrations.

    Args:
        config: Environment, algorithm, network and normalisation.
        demonstrations: See `agents.demonstrations.Demonstration`.
        how: How cloning goes.

    Returns:
        The model, what normalises its observations (None: nothing), and the losses: the mean squared difference between
        actions, averaged over each tenth of the gradient steps.

    Raises:
        ValueError: If there is no demonstration.
    """
    import torch
    from stable_baselines3.common.vec_env import VecNormalize

    from agents.models import make_model
    from agents.worlds import make_training_env

    if not demonstrations:
        raise ValueError("demonstrations must be one at least, got none")
    torch.set_num_threads(config.torch_threads)
    config = dataclasses.replace(config, environment=dataclasses.replace(config.environment, num_envs=1))
    env, _ = make_training_env(config, how.seed, config.hyperparameters.gamma)
    try:
        model: Any = make_model(config, env, how.seed)
        observations = _joined([each.observations for each in demonstrations])
        actions = np.concatenate([each.actions for each in demonstrations]).astype(np.float32)
        normalizer = env if isinstance(env, VecNormalize) else None
        if normalizer is not None and normalizer.norm_obs:
            statistics = normalizer.obs_rms if isinstance(normalizer.obs_rms, dict) else {"": normalizer.obs_rms}
            for key, running in statistics.items():
                running.update(observations[key] if key else observations)
            observations = normalizer.normalize_obs(observations)
        losses = _fit(model, observations, actions, how)
        if normalizer is not None:
            normalizer.training = False
        return model, normalizer, losses
    finally:
        env.close()


def _fit(model: Any, observations: Any, actions: NDArray[np.float32], how: CloneConfig) -> list[float]:
    """Bring the policy's deterministic actions close to those demonstrated."""
    import torch

    tensors = _tensors(observations)
    wanted = torch.as_tensor(actions)
    actor = getattr(model.policy, "actor", None)
    parameters = list((actor if actor is not None else model.policy).parameters())
    optimizer = torch.optim.Adam(parameters, lr=how.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, how.gradient_steps)
    generator = torch.Generator().manual_seed(how.seed)
    model.policy.set_training_mode(True)
    losses = []
    for _ in range(how.gradient_steps):
        rows = torch.randint(len(wanted), (how.batch_size,), generator=generator)
        batch = {key: values[rows] for key, values in tensors.items()} if isinstance(tensors, dict) else tensors[rows]
        if actor is not None:
            done = actor(batch, deterministic=True)
        else:
            done = model.policy.get_distribution(batch).mode()
        loss = torch.nn.functional.mse_loss(done, wanted[rows])
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        losses.append(float(loss.detach()))
    model.policy.set_training_mode(False)
    return [float(part.mean()) for part in np.array_split(np.array(losses), min(10, len(losses)))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Clone.

    Args:
        arguments: What follows the module's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    parser = argparse.ArgumentParser(prog="python -m agents.clone", description="Imitate demonstrations.")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--dataset", metavar="ID", help="demonstrations of a Minari data set")
    source.add_argument("--expert", type=int, metavar="N", help="N demonstrations of the scripted expert")
    parser.add_argument("--config", type=Path, help="environment, algorithm, network and normalisation, a YAML file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes", help="a change of it"
    )
    parser.add_argument("--env", metavar="ID", help="environment, without --config and --dataset")
    parser.add_argument("--algorithm", choices=("sac", "ppo"), help="whose actor, without --config; default: sac")
    parser.add_argument("--engine", choices=ENGINES, default="batch", help="that the expert demonstrates in")
    parser.add_argument(
        "--noise", type=float, default=0.3,
        help="standard deviation of what leads the expert astray; default: %(default)s",
    )  # fmt: skip
    parser.add_argument("--gradient-steps", type=int, default=CloneConfig.gradient_steps, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument("--output", type=Path, metavar="DIR", help="default: runs/ and the task's name")
    chosen = parser.parse_args(arguments)
    if chosen.expert is not None and chosen.expert < 1:
        parser.error(f"--expert must be 1 or more, got {chosen.expert}")
    if chosen.expert is not None and chosen.config is None and chosen.env is None:
        parser.error("--expert needs --config or --env")
    if chosen.changes and chosen.config is None:
        parser.error("--set needs --config")
    if chosen.config is not None and (chosen.env or chosen.algorithm):
        parser.error("--config says which environment and algorithm: leave --env and --algorithm out")
    try:
        output = _run(chosen)
    except (FileNotFoundError, TypeError, ValueError, gymnasium.error.Error) as error:
        print(f"agents.clone: {error}", file=sys.stderr)
        return 1
    except ImportError as error:
        hint = (
            str(error)
            if "pip install" in str(error)
            else f"cloning needs {error.name}: pip install 'spatula-env[train]'"
        )
        print(f"agents.clone: {hint}", file=sys.stderr)
        return 1
    print(output)
    return 0


def _run(chosen: argparse.Namespace) -> Path:
    """Clone as the command line says; returns the folder of the policy."""
    from agents.demonstrations import collect, read_minari
    from agents.evaluation import Plan
    from agents.saving import provenance, save_policy, write_json

    config = read_training(chosen.config, chosen.changes) if chosen.config is not None else None
    parts = config.environment.parts if config is not None else None
    if chosen.dataset is not None:
        demonstrations, env_id, kwargs = read_minari(chosen.dataset, parts)
        if (config is not None and config.environment.id != env_id) or chosen.env not in (None, env_id):
            raise ValueError(f"dataset {chosen.dataset!r} was recorded in {env_id}, not in the environment asked for")
    else:
        env_id = config.environment.id if config is not None else chosen.env
        kwargs = dict(config.environment.kwargs) if config is not None else {}
        kwargs.pop("max_episode_steps", None)
        plan = Plan(env_id, kwargs, chosen.engine, chosen.expert, 2_000_000 + chosen.seed)
        demonstrations = collect(plan, noise=chosen.noise, parts=parts)
    if config is None:
        algorithm = chosen.algorithm or "sac"
        # The buffer stays empty.
        more = {"buffer_size": 1} if algorithm == "sac" else {"n_steps": 2, "batch_size": 2}
        config = TrainingConfig(EnvironmentConfig(env_id, kwargs), algorithm, ALGORITHMS[algorithm](**more))
    how = CloneConfig(gradient_steps=chosen.gradient_steps, seed=chosen.seed)
    model, normalizer, losses = clone(config, demonstrations, how)
    output = chosen.output or Path("runs") / f"{gymnasium.spec(env_id).name.lower()}_clone"
    origin = {
        **provenance(),
        "demonstrations": {
            "source": chosen.dataset or f"scripted expert, {chosen.engine} engine, noise {chosen.noise}",
            "episodes": len(demonstrations),
            "steps": int(sum(len(each.actions) for each in demonstrations)),
            "success_rate": float(np.mean([each.success for each in demonstrations])),
        },
        "clone": dataclasses.asdict(how),
        "losses": losses,
    }
    write_json(output / "provenance.json", origin)
    save_policy(output / "policy", model, normalizer, dataclasses.replace(config, seeds=(chosen.seed,)))
    print(
        f"{len(demonstrations)} demonstrations, {100 * origin['demonstrations']['success_rate']:.0f} % successful;"
        f" mean squared difference of actions {losses[0]:.4f} at first, {losses[-1]:.4f} at last"
    )
    return output


def _joined(observations: list[Any]) -> Any:
    """What was seen before each action, of all demonstrations."""
    if isinstance(observations[0], dict):
        return {key: np.concatenate([each[key][:-1] for each in observations]) for key in observations[0]}
    return np.concatenate([each[:-1] for each in observations])


def _tensors(observations: Any) -> Any:
    import torch

    if isinstance(observations, dict):
        return {key: torch.as_tensor(values, dtype=torch.float32) for key, values in observations.items()}
    return torch.as_tensor(observations, dtype=torch.float32)


if __name__ == "__main__":
    sys.exit(main())
