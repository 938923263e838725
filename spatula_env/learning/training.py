"""Training of one agent, from the start or from where it was interrupted.

Needs the extra "train".
"""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from spatula_env.files import whole_file
from spatula_env.learning.acting import acting_policy
from spatula_env.learning.configuration import SACConfig, TrainingConfig, read_training, to_mapping, write_training
from spatula_env.learning.demonstrations import collect_successes, fill_buffer, joined_observations
from spatula_env.learning.evaluation import WORLDS_PER_PROCESS, Plan, run_episodes, summarize
from spatula_env.learning.folders import RunPlace, is_over
from spatula_env.learning.imitation import CloneConfig, calm_down, hold_to_demonstrations, imitate
from spatula_env.learning.models import make_model
from spatula_env.learning.policies import judged_options
from spatula_env.learning.progress import ProgressView
from spatula_env.learning.replay import DemonstrationReplayBuffer
from spatula_env.learning.saving import (
    BEST,
    CHECKPOINTS,
    CONFIG,
    CURVE,
    POLICY,
    PROVENANCE,
    SUMMARY,
    checkpoints_in,
    export_metadata,
    load_model,
    load_normalizer,
    provenance,
    read_curve,
    restore_checkpoint,
    save_checkpoint,
    save_policy,
    sweep,
    write_curve,
    write_json,
)
from spatula_env.learning.worlds import OverlappedVecEnv, make_training_env

DEMONSTRATION_SEED = 2_000_000
"""Seed of the first demonstration, distinct from those of training and evaluation."""

RECENT = 100
"""Number of training episodes over which success and cost are averaged."""


class Trainer(BaseCallback):
    """Evaluates, saves and reports between updates of the model.

    All of this happens at the beginning of a rollout: at that time the replay buffer contains everything seen so far,
    and no step is half done.

    Attributes:
        progress: Values that a checkpoint keeps besides the model.
        reached: Whether an evaluation reached the target.
    """

    def __init__(self, config: TrainingConfig, folder: Path, view: ProgressView, progress: dict[str, Any]) -> None:
        """Set up the callback.

        Args:
            config: Training configuration.
            folder: Folder of the seed.
            view: Shows the progress.
            progress: Values from a checkpoint, or empty.
        """
        super().__init__()
        self.config, self.folder, self.view = config, folder, view
        self.progress = {
            "seconds": 0.0, "evaluated": 0, "saved": 0, "best": None, "demonstration_steps": 0, **progress
        }  # fmt: skip
        self.reached = False
        self._costs: deque[float] = deque(maxlen=RECENT)
        self._successes: deque[float] = deque(maxlen=RECENT)
        self._curve = [line for line in read_curve(folder / CURVE) if line["step"] <= self.progress["evaluated"]]
        write_curve(folder / CURVE, self._curve)
        self._start = time.perf_counter()
        evaluation = config.evaluation
        self._plan = Plan(
            config.environment.id,
            judged_options(config.environment.id, config.environment.kwargs),
            evaluation.engine,
            evaluation.episodes,
            evaluation.seed,
        )
        self._env: Any = None

    @property
    def normalizer(self) -> VecNormalize | None:
        """Normalisation of observations; None for none."""
        return self.model.get_vec_normalize_env()

    @property
    def seconds(self) -> float:
        """Time spent on this run by all processes that have worked on it [s]."""
        return float(self.progress["seconds"]) + time.perf_counter() - self._start

    def close(self) -> None:
        """Close the environment of the evaluations."""
        if self._env is not None:
            self._env.close()

    def _on_rollout_start(self) -> None:
        steps = self.model.num_timesteps
        if self.config.actor_starts:
            # An optimiser skips parameters without gradients.
            self.model.policy.actor.requires_grad_(steps >= self.config.actor_starts)
        warming = isinstance(self.config.hyperparameters, SACConfig) and (
            steps <= self.config.hyperparameters.learning_starts
        )
        if steps == 0 and self.config.clone_steps and not self._curve:
            self.look()
        evaluation = self.config.evaluation
        due = steps // evaluation.every > self.progress["evaluated"] // evaluation.every
        if due and not warming and (self._success() or 0.0) >= evaluation.from_success:
            self.evaluate()
        if steps // self.config.checkpoint_every > self.progress["saved"] // self.config.checkpoint_every:
            self.save()

    def _on_step(self) -> bool:
        for done, info in zip(self.locals["dones"], self.locals["infos"], strict=True):
            if done:
                self._costs.append(info["episode_cost"])
                self._successes.append(float(info["is_success"]))
        cost = float(np.mean(self._costs)) if self._costs else None
        self.view.update(self.model.num_timesteps, self._success(), cost)
        if cost is not None:
            self.logger.record("rollout/cost", cost)
        return not self.reached

    def look(self) -> dict[str, Any]:
        """Evaluate the current policy, and add the result to the curve.

        For an agent that begins as a clone, this is also called before it learns: the result of the demonstrations
        alone is on the curve, but is neither saved as the best policy nor counted as reaching the target.

        Returns:
            The new line of the curve.
        """
        steps = self.model.num_timesteps
        start = time.perf_counter()
        policy = acting_policy(self.model, self.normalizer, export_metadata(self.config))
        if self._env is None:
            rounds = math.ceil(self._plan.episodes / WORLDS_PER_PROCESS[self._plan.engine])
            self._env = self._plan.make(math.ceil(self._plan.episodes / rounds))
        seeds = [self._plan.seed + k for k in range(self._plan.episodes)]
        summary = summarize(run_episodes(self._env, policy.bound_to(self._env), seeds, end_at_success=True))
        line = {
            "step": steps,
            "demonstration_steps": self.progress["demonstration_steps"],
            "seconds": self.seconds,
            "training_success": self._success(),
            "steps_per_second": steps / self.seconds,
            "evaluation_seconds": time.perf_counter() - start,
            **{name: value for name, value in summary.items() if name != "steps"},
        }
        self._curve.append(line)
        write_curve(self.folder / CURVE, self._curve)
        self.progress["evaluated"] = steps
        for name, value in line.items():
            if isinstance(value, int | float):
                self.logger.record(f"evaluation/{name}", value)
        self.logger.dump(steps)
        self.view.evaluated(line)
        return line

    def evaluate(self) -> None:
        """Evaluate the current policy, and save it as the best if no other was better."""
        line = self.look()
        # Of two with equal success the faster is better, although its return may be smaller because its episodes are
        # shorter.
        needed = line["time_to_success"]
        rank = [line["success_rate"], line["return"] if needed is None else -needed]
        if self.progress["best"] is None or rank >= self.progress["best"]:
            self.progress["best"] = rank
            save_policy(self.folder / BEST, self.model, self.normalizer, self.config, line)
        target = self.config.success_target
        self.reached = target is not None and line["success_rate"] >= target

    def save(self) -> None:
        """Write a checkpoint."""
        self.progress["saved"] = self.model.num_timesteps
        progress = {**self.progress, "seconds": self.seconds}
        save_checkpoint(self.folder / CHECKPOINTS, self.model, self.normalizer, self.config, progress)

    def _success(self) -> float | None:
        return float(np.mean(self._successes)) if self._successes else None


def train_seed(config: TrainingConfig, seed: int, folder: Path, view: ProgressView) -> dict[str, Any]:
    """Train one agent; resume if its folder holds a checkpoint.

    Args:
        config: Training configuration.
        seed: Seed of all randomness.
        folder: Folder of this seed.
        view: Shows the progress.

    Returns:
        The content of `summary.json`. A finished run is not touched.
    """
    summary_file = folder / SUMMARY
    if summary_file.exists():
        done: dict[str, Any] = json.loads(summary_file.read_text(encoding="utf-8"))
        if is_over(done, config):
            return done
    config = dataclasses.replace(config, seeds=(seed,))
    torch.set_num_threads(config.torch_threads)
    folder.mkdir(parents=True, exist_ok=True)
    for place in (folder, folder / CHECKPOINTS):
        sweep(place)
    saved = checkpoints_in(folder / CHECKPOINTS)
    checkpoint = saved[-1] if saved else None
    # The run may be continued beyond its original length.
    write_config(folder, config)
    summary_file.unlink(missing_ok=True)
    if checkpoint is None:
        for stale in (BEST, POLICY, "tensorboard"):
            shutil.rmtree(folder / stale, ignore_errors=True)
        (folder / CURVE).unlink(missing_ok=True)
    write_json(folder / PROVENANCE, provenance(config.environment.id))

    steps = int(checkpoint.name.partition("-")[2]) if checkpoint is not None else 0
    # Avoid repeating the same episodes after an interruption.
    env_seed = int(np.random.SeedSequence([seed, steps]).generate_state(1)[0])
    env, overlap = make_training_env(config, env_seed, config.hyperparameters.gamma)
    trainer: Trainer | None = None
    try:
        progress: dict[str, Any] = {}
        if checkpoint is None:
            model = make_model(config, env, seed)
            if config.demonstrations:
                progress["demonstration_steps"] = demonstrate(config, seed, model, env)
        else:
            if isinstance(env, VecNormalize):
                load_normalizer(checkpoint, env)
            model = load_model(checkpoint, config, env)
            progress = restore_checkpoint(checkpoint, model)
        # Stable-Baselines3 has seeded the worlds with its own seed.
        env.seed(env_seed)
        model.set_logger(Logger(str(folder), [_TensorBoard(folder / "tensorboard", steps)]))
        trainer = Trainer(config, folder, view, progress)
        if config.overlap and isinstance(config.hyperparameters, SACConfig):
            _overlap_gradients(model, overlap, config)
        if config.imitation_weight and isinstance(config.hyperparameters, SACConfig):
            buffer: Any = getattr(model, "replay_buffer", None)
            hold_to_demonstrations(
                model,
                buffer.imitated,
                weight=config.imitation_weight,
                batch_size=config.hyperparameters.batch_size,
            )
        # `learn` counts from the model's present number of steps.
        remaining = config.total_steps - model.num_timesteps
        with view.run(f"seed {seed}", config.total_steps, model.num_timesteps):
            if remaining > 0:
                model.learn(remaining, callback=trainer, reset_num_timesteps=checkpoint is None, log_interval=20)
            else:
                trainer.init_callback(model)
            if trainer.progress["evaluated"] != model.num_timesteps and not trainer.reached:
                trainer.evaluate()
        if trainer.progress["saved"] != model.num_timesteps:
            # So that training can be continued later.
            trainer.save()
        save_policy(folder / POLICY, model, trainer.normalizer, config, read_curve(folder / CURVE)[-1])
        summary = {
            "seed": seed,
            "steps": int(model.num_timesteps),
            "demonstration_steps": trainer.progress["demonstration_steps"],
            "seconds": trainer.seconds,
            "reached_target": trainer.reached,
            "evaluation": read_curve(folder / CURVE)[-1],
            "best": trainer.progress["best"],
        }
        write_json(summary_file, summary)
        return summary
    finally:
        if trainer is not None:
            trainer.close()
        env.close()


def train(config: TrainingConfig, output: Path, view: ProgressView) -> dict[str, Any]:
    """Train an agent for each seed in turn.

    Args:
        config: Training configuration.
        output: Folder of the run; existing seeds are resumed.
        view: Shows the progress.

    Returns:
        The content of the run's `summary.json`.
    """
    results = [train_seed(config, seed, output / f"seed-{seed}", view) for seed in config.seeds]
    return write_summary(config, output, results)


def train_place(place: RunPlace, view: ProgressView) -> None:
    """Train the run, or the single seed, of a folder.

    Args:
        place: Location of the run; existing seeds are resumed.
        view: Shows the progress.
    """
    if not place.alone:
        train(place.config, place.folder, view)
        return
    train_seed(place.config, place.config.seeds[0], place.folder, view)
    run = place.folder.resolve().parent
    if not (run / CONFIG).exists():
        return
    # The last seed of a run completes it.
    whole = read_training(run / CONFIG)
    summaries = [run / f"seed-{seed}" / SUMMARY for seed in whole.seeds]
    if all(file.exists() for file in summaries):
        write_summary(whole, run, [json.loads(file.read_text(encoding="utf-8")) for file in summaries])


def write_summary(config: TrainingConfig, output: Path, results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Write the summary of all seeds of a run.

    Args:
        config: Configuration of the run.
        output: Folder of the run.
        results: Content of each seed's summary.

    Returns:
        The summary.
    """
    rates = [result["evaluation"]["success_rate"] for result in results]
    summary = {
        "env": config.environment.id,
        "algorithm": config.algorithm,
        "seeds": list(config.seeds),
        "success_rate_mean": float(np.mean(rates)),
        "success_rates": rates,
        "steps": [result["steps"] for result in results],
        "demonstration_steps": [result.get("demonstration_steps", 0) for result in results],
        "seconds": [result["seconds"] for result in results],
        "reached_target": [result["reached_target"] for result in results],
        "config": to_mapping(config),
    }
    write_json(output / SUMMARY, summary)
    return summary


def write_config(folder: Path, config: TrainingConfig) -> None:
    """Write the configuration of a run into its folder atomically."""
    with whole_file(folder / CONFIG) as unfinished:
        write_training(config, unfinished)


def _overlap_gradients(model: Any, overlap: VecEnv, config: TrainingConfig) -> None:
    """Make gradient steps run while worlds are stepped."""
    chosen = config.hyperparameters
    assert isinstance(overlap, OverlappedVecEnv) and isinstance(chosen, SACConfig)

    def meanwhile() -> None:
        if model.num_timesteps <= chosen.learning_starts:
            return
        model.train(gradient_steps=chosen.gradient_steps, batch_size=chosen.batch_size)
        model.policy.set_training_mode(False)

    overlap.meanwhile = meanwhile


def demonstrate(config: TrainingConfig, seed: int, model: Any, env: VecEnv) -> int:
    """Give the agent episodes of the scripted expert before it learns from rewards.

    Args:
        config: Says how many, and how they are used.
        seed: Seed of batches.
        model: Model with an empty replay buffer.
        env: Training environment, whose normalisation is updated with the demonstrations.

    Returns:
        Number of control steps made for the demonstrations.
    """
    environment = config.environment
    assert isinstance(model, OffPolicyAlgorithm)
    rounds = math.ceil(config.demonstrations / environment.num_envs)
    kwargs = dict(environment.kwargs)
    steps = kwargs.pop("max_episode_steps", None)
    plan = Plan(environment.id, kwargs, environment.engine, rounds * environment.num_envs, DEMONSTRATION_SEED)
    demonstrations, _, made_steps = collect_successes(
        plan,
        num_envs=environment.num_envs,
        noise=config.demonstration_noise,
        parts=environment.parts,
        steps=steps,
    )
    buffer = model.replay_buffer
    assert buffer is not None
    target = buffer
    if isinstance(buffer, DemonstrationReplayBuffer):
        target = buffer.make_room(sum(len(each.actions) for each in demonstrations))
        buffer.imitated = (
            joined_observations(demonstrations),
            np.concatenate([each.actions for each in demonstrations]),
        )
    fill_buffer(target, env, demonstrations)
    if config.clone_steps:
        observations = joined_observations(demonstrations)
        if isinstance(env, VecNormalize):
            observations = env.normalize_obs(observations)
        actions = np.concatenate([each.actions for each in demonstrations])
        imitate(model, observations, actions, CloneConfig(gradient_steps=config.clone_steps, seed=seed))
        calm_down(model)
    return made_steps


class _TensorBoard(KVWriter):
    """Writes numbers for TensorBoard; drops those that an interrupted run wrote after its last checkpoint."""

    def __init__(self, folder: Path, first_step: int) -> None:
        from torch.utils.tensorboard.writer import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=first_step)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        for key, value in key_values.items():
            if "tensorboard" in (key_excluded.get(key) or ()):
                continue
            if isinstance(value, int | float | np.number) and not isinstance(value, bool):
                self._writer.add_scalar(key, float(value), step)
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()
