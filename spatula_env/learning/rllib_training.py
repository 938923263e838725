"""Training with RLlib on a Ray cluster: environment runners with a vector environment each, and one learner.

Needs the extra "ray".
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.connectors.env_to_module import MeanStdFilter
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.utils.filter import RunningStat
from ray.rllib.utils.numpy import SMALL_NUMBER
from ray.tune.registry import register_env

from spatula_env.learning.configuration import to_mapping
from spatula_env.learning.evaluation import WORLDS_PER_PROCESS, Plan, run_episodes, summarize
from spatula_env.learning.policies import interface_of, judged_options
from spatula_env.learning.rllib_configuration import RLlibConfig
from spatula_env.learning.saving import (
    checkpoints_in,
    provenance,
    read_curve,
    sweep,
    write_curve,
    write_folder,
    write_json,
)
from spatula_env.learning.threads import numba_threads
from spatula_env.policies import Entry, ExportedPolicy, PartSelection

ENVIRONMENT = "spatula"
"""Name of the environment in Ray, which does not know Gymnasium's registry in other processes."""

KEPT_INFOS = ("is_success", "episode_cost", "diverged")
"""The entries of `info` that leave an environment runner."""

WINDOW = 100
"""Number of training episodes over which success and cost are averaged."""

KEPT_CHECKPOINTS = 2

Say = Callable[[str], None]


class LeanVectorEnv(VectorWrapper):
    """Reduces observations to some parts, and infos to a few entries."""

    def __init__(self, env: VectorEnv[Any, Any, Any], selection: PartSelection | None) -> None:
        """Wrap an environment.

        Args:
            env: Environment whose observations are one vector per world.
            selection: Selected parts; None for all.
        """
        super().__init__(env)
        self._selection = selection
        if selection is not None:
            self.single_observation_space = selection.space(env.single_observation_space)
            self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, env.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes."""
        observation, infos = self.env.reset(seed=seed, options=options)
        return self._selected(observation), _lean(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all worlds."""
        observation, rewards, terminated, truncated, infos = self.env.step(actions)
        return self._selected(observation), rewards, terminated, truncated, _lean(infos)

    def _selected(self, observation: Any) -> Any:
        return observation if self._selection is None else self._selection(observation)


def _lean(infos: Mapping[str, Any]) -> dict[str, Any]:
    return {name: infos[name] for kept in KEPT_INFOS for name in (kept, f"_{kept}") if name in infos}


def make_runner_env(context: Mapping[str, Any]) -> Any:
    """Make the environment of an environment runner; called by RLlib.

    Args:
        context: "id", "parts", "kwargs" and "cpus"; RLlib adds "num_envs" if it wants a vector environment.

    Returns:
        A vector environment, or an environment for one agent.
    """
    if "num_envs" not in context:
        return gymnasium.make(f"spatula_env:{context['id']}", **context["kwargs"])
    with numba_threads(int(context["cpus"])):
        env = gymnasium.make_vec(
            f"spatula_env:{context['id']}",
            num_envs=int(context["num_envs"]),
            vectorization_mode="vector_entry_point",
            # The only autoreset mode that RLlib supports.
            autoreset_mode="next_step",
            **context["kwargs"],
        )
    return LeanVectorEnv(env, PartSelection.of(env, context["parts"]))


def _make_filter(env: Any = None, spaces: Any = None, device: Any = None, *, clip: float) -> MeanStdFilter:
    return MeanStdFilter(clip_by_value=clip)


def _note_episode(*, episode: Any, metrics_logger: Any, **_: Any) -> None:
    """Log the metrics of a training episode."""
    info = episode.get_infos(-1)
    metrics_logger.log_value("success", float(info["is_success"]), reduce="mean", window=WINDOW)
    metrics_logger.log_value("cost", float(info["episode_cost"]), reduce="mean", window=WINDOW)


def algorithm_config(config: RLlibConfig) -> PPOConfig:
    """Convert to RLlib's own configuration."""
    environment, runners, chosen = config.environment, config.env_runners, config.hyperparameters
    register_env(ENVIRONMENT, make_runner_env)
    settings: dict[str, Any] = {}
    if config.normalization.observations:
        clip = config.normalization.clip
        settings["env_to_module_connector"] = lambda env, spaces, device: _make_filter(env, spaces, device, clip=clip)
    return (
        PPOConfig()
        .environment(
            ENVIRONMENT,
            env_config={
                "id": environment.id,
                "parts": environment.parts,
                "kwargs": {**environment.kwargs, "engine": environment.engine},
                "cpus": runners.cpus,
            },
        )
        .env_runners(
            num_env_runners=runners.count,
            num_envs_per_env_runner=environment.num_envs,
            gym_env_vectorize_mode=gymnasium.VectorizeMode.VECTOR_ENTRY_POINT,
            num_cpus_per_env_runner=runners.cpus,
            rollout_fragment_length=runners.fragment,
            sample_timeout_s=runners.sample_seconds,
            batch_mode="truncate_episodes",
            **settings,
        )
        .fault_tolerance(
            restart_failed_env_runners=runners.restart,
            max_num_env_runner_restarts=runners.greatest_restarts,
            delay_between_env_runner_restarts_s=0.0,
            env_runner_health_probe_timeout_s=runners.probe_seconds,
            env_runner_restore_timeout_s=runners.restore_seconds,
        )
        .callbacks(on_episode_end=_note_episode)
        .training(
            lr=chosen.learning_rate,
            gamma=chosen.gamma,
            lambda_=chosen.gae_lambda,
            train_batch_size_per_learner=config.batch_size,
            minibatch_size=min(chosen.minibatch_size, config.batch_size),
            num_epochs=chosen.epochs,
            clip_param=chosen.clip_range,
            vf_clip_param=chosen.value_clip,
            vf_loss_coeff=chosen.vf_coef,
            entropy_coeff=chosen.ent_coef,
            grad_clip=chosen.max_grad_norm,
            use_kl_loss=False,
        )
        .rl_module(
            model_config=DefaultModelConfig(
                fcnet_hiddens=list(config.network.layers),
                fcnet_activation=config.network.activation,
                # The heads are one linear layer, and the actions' standard deviation does not depend on the
                # observation.
                free_log_std=True,
                vf_share_layers=False,
            )
        )
        .debugging(seed=config.seed, log_level="ERROR")
    )


def export_algorithm(algorithm: PPO, config: RLlibConfig) -> ExportedPolicy:
    """Export an algorithm's current policy, to run with NumPy alone."""
    state = algorithm.get_module().get_state()
    encoder = sorted(name for name in state if name.startswith("encoder.actor_encoder.") and name.endswith(".weight"))
    heads = sorted(name for name in state if name.startswith("pi.") and name.endswith(".weight"))
    layers = tuple(
        (np.asarray(state[name], np.float32), np.asarray(state[name.replace(".weight", ".bias")], np.float32))
        for name in (*sorted(encoder, key=_layer_number), *sorted(heads, key=_layer_number))
    )
    size = layers[0][0].shape[1]
    mean, scale = np.zeros(size), np.ones(size)
    if config.normalization.observations:
        mean, scale = _filter_statistics(algorithm, size)
    space = algorithm.env_runner.get_spaces()["__env_single__"][1]
    return ExportedPolicy(
        entries=(Entry("", mean, scale),),
        clip=config.normalization.clip if config.normalization.observations else math.inf,
        layers=layers,
        activation=config.network.activation,
        squash=False,
        low=space.low.astype(np.float32),
        high=space.high.astype(np.float32),
        metadata={
            "env_id": config.environment.id,
            "env_kwargs": interface_of(config.environment.id, config.environment.kwargs),
            "parts": None if config.environment.parts is None else list(config.environment.parts),
        },
    )


def _layer_number(name: str) -> int:
    """Number of a layer in its sequence, from a name such as "pi.net.mlp.0.weight"."""
    return next(int(part) for part in reversed(name.split(".")) if part.isdigit())


def _filter_statistics(algorithm: PPO, size: int) -> tuple[Any, Any]:
    """Mean and standard deviation of the observations of all environment runners."""
    pipeline: Any = algorithm.env_runner._env_to_module
    (connector,) = [each for each in pipeline.connectors if isinstance(each, MeanStdFilter)]
    (filtered,) = connector.get_state().values()
    (statistics,) = filtered["running_stats"]
    running = RunningStat.from_state(statistics)
    if running.n < 2:
        return np.zeros(size), np.ones(size)
    return np.asarray(running.mean, dtype=np.float64), np.asarray(running.std, dtype=np.float64) + SMALL_NUMBER


class RLlibTrainer:
    """Trains, evaluates and saves an agent.

    Attributes:
        algorithm: RLlib's algorithm.
        steps: Number of environment steps so far.
    """

    def __init__(self, config: RLlibConfig, folder: Path, say: Say) -> None:
        """Start the environment runners; resume from the last checkpoint in the folder, if there is one.

        Args:
            config: Training configuration.
            folder: Folder of the run.
            say: Receives progress messages.
        """
        self.config, self.folder, self._say = config, folder, say
        folder.mkdir(parents=True, exist_ok=True)
        for place in (folder, folder / "checkpoints"):
            sweep(place)
        saved = checkpoints_in(folder / "checkpoints")
        self.algorithm: PPO = algorithm_config(config).build_algo()
        self.steps, self._seconds, self._evaluated, self._saved = 0, 0.0, 0, 0
        if saved:
            self.algorithm.restore_from_path(str((saved[-1] / "algorithm").absolute()))
            progress = json.loads((saved[-1] / "progress.json").read_text(encoding="utf-8"))
            self.steps, self._seconds = progress["steps"], progress["seconds"]
            self._evaluated, self._saved = progress["evaluated"], self.steps
        else:
            (folder / "curve.jsonl").unlink(missing_ok=True)
        self._lifetime = self._sampled()
        self._curve = [line for line in read_curve(folder / "curve.jsonl") if line["step"] <= self._evaluated]
        self._start = time.perf_counter()
        self._best = max(((line["success_rate"], line["return"]) for line in self._curve), default=None)
        write_json(folder / "provenance.json", provenance(self.config.environment.id))

    @property
    def seconds(self) -> float:
        """Time spent on this run by all processes that have worked on it [s]."""
        return float(self._seconds) + time.perf_counter() - self._start

    def run(self) -> dict[str, Any]:
        """Train until the end.

        Returns:
            The content of `summary.json`.
        """
        config, reached = self.config, False
        while self.steps < config.total_steps and not reached:
            self.iterate()
            if self.steps // config.evaluation.every > self._evaluated // config.evaluation.every:
                reached = self.evaluate()
            if self.steps // config.checkpoint_every > self._saved // config.checkpoint_every:
                self.save()
        if self._evaluated != self.steps:
            reached = self.evaluate()
        self.save()
        summary = {
            "steps": self.steps,
            "seconds": self.seconds,
            "reached_target": reached,
            "evaluation": self._curve[-1],
            "config": to_mapping(config),
        }
        write_json(self.folder / "summary.json", summary)
        return summary

    def iterate(self) -> dict[str, Any]:
        """Make one update.

        Returns:
            Current metrics: "step", "success", "cost", number of "healthy" environment runners, and "restarts".
        """
        result = self.algorithm.train()
        sampled = self._sampled(result)
        self.steps += max(0, sampled - self._lifetime)
        self._lifetime = sampled
        told, group = result.get("env_runners", {}), self.algorithm.env_runner_group
        line = {
            "step": self.steps,
            "success": _number(told.get("success")),
            "cost": _number(told.get("cost")),
            "healthy": group.num_healthy_remote_workers(),
            "restarts": group.num_remote_worker_restarts(),
        }
        success = "-" if line["success"] is None else f"{100 * line['success']:.0f} %"
        self._say(
            f"{self.steps:>10,} steps {self.seconds:7.1f} s  training: success {success}, "
            f"{line['healthy']} environment runners, {line['restarts']} restarts"
        )
        return line

    def evaluate(self) -> bool:
        """Evaluate the current policy, and save it as the best if no other was better.

        Returns:
            Whether it reached the target.
        """
        evaluation, environment = self.config.evaluation, self.config.environment
        policy = export_algorithm(self.algorithm, self.config)
        plan = Plan(
            environment.id,
            judged_options(environment.id, environment.kwargs),
            evaluation.engine,
            evaluation.episodes,
            evaluation.seed,
        )
        rounds = math.ceil(plan.episodes / WORLDS_PER_PROCESS[plan.engine])
        env = plan.make(math.ceil(plan.episodes / rounds))
        try:
            seeds = [plan.seed + k for k in range(plan.episodes)]
            summary = summarize(run_episodes(env, policy.bound_to(env), seeds, end_at_success=True))
        finally:
            env.close()
        line = {"step": self.steps, "seconds": self.seconds, **summary}
        self._curve.append(line)
        write_curve(self.folder / "curve.jsonl", self._curve)
        self._evaluated = self.steps
        self._say(f"{self.steps:>10,} steps {self.seconds:7.1f} s  success {100 * line['success_rate']:5.1f} %")
        rank = (line["success_rate"], line["return"])
        if self._best is None or rank >= self._best:
            self._best = rank
            policy.save(self.folder / "policy.npz")
            write_json(
                self.folder / "policy.json",
                {
                    "steps": self.steps,
                    "seed": self.config.seed,
                    "evaluation": {"training": line},
                    "config": {**to_mapping(self.config), "algorithm": "ppo"},
                    **provenance(self.config.environment.id),
                },
            )
        target = self.config.success_target
        return target is not None and bool(line["success_rate"] >= target)

    def save(self) -> None:
        """Write a checkpoint; all but the last two are removed."""
        self._saved = self.steps
        progress = {"steps": self.steps, "seconds": self.seconds, "evaluated": self._evaluated}

        def fill(place: Path) -> None:
            self.algorithm.save_to_path(str((place / "algorithm").absolute()))
            write_json(place / "progress.json", progress)

        write_folder(self.folder / "checkpoints" / f"step-{self.steps:012d}", fill)
        for old in checkpoints_in(self.folder / "checkpoints")[:-KEPT_CHECKPOINTS]:
            shutil.rmtree(old, ignore_errors=True)

    def close(self) -> None:
        """Stop the environment runners."""
        self.algorithm.stop()

    def _sampled(self, result: Mapping[str, Any] | None = None) -> int:
        """Environment steps by RLlib's count; steps of an environment runner that died before reporting are lost."""
        told = (result or {}).get("env_runners", {}).get("num_env_steps_sampled_lifetime")
        if told is None:
            told = self.algorithm.metrics.peek(("env_runners", "num_env_steps_sampled_lifetime"), default=0)
        return int(told)


def _number(value: Any) -> float | None:
    if value is None:
        return None
    number = float(value)
    return number if math.isfinite(number) else None
