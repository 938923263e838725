"""Configurations of training with RLlib: read from YAML, and checked before Ray is started."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from spatula_env.changes import with_changes
from spatula_env.learning.configuration import (
    EnvironmentConfig,
    EvaluationConfig,
    NetworkConfig,
    NormalizationConfig,
    from_mapping,
    load_yaml,
)
from spatula_env.learning.ranges import Checked, Count, Natural, Positive, Share


@dataclass(frozen=True)
class EnvRunnersConfig(Checked):
    """The processes that collect experience; each holds a vector environment of `environment.num_envs` worlds.

    Attributes:
        count: Number of processes on all nodes of the cluster together; 0 if the learner's process collects as well.
        cpus: Number of CPUs that each needs, and of threads with which it steps its worlds.
        fragment: Number of steps of each world between two updates.
        restart: Whether to replace a process that has died; otherwise training ends with an error.
        greatest_restarts: Greatest number of replacements of one process.
        probe_seconds: Time in which a process has to answer before it counts as dead [s].
        sample_seconds: Time that the steps between two updates may take; after it, missing samples are left out [s].
        restore_seconds: Time in which a new process has to be ready [s].
    """

    section: ClassVar[str] = "env_runners"

    count: Natural = 2
    cpus: Count = 1
    fragment: Count = 32
    restart: bool = True
    greatest_restarts: Natural = 100
    probe_seconds: Positive = 30.0
    sample_seconds: Positive = 120.0
    restore_seconds: Positive = 300.0


@dataclass(frozen=True)
class RLlibPPOConfig(Checked):
    """Hyper-parameters of RLlib's PPO.

    Attributes:
        learning_rate: Learning rate of Adam.
        minibatch_size: Number of samples per gradient step.
        epochs: Number of passes over the samples.
        gamma: Discount factor.
        gae_lambda: Parameter of generalised advantage estimation.
        clip_range: Clipping range of the probability ratio.
        value_clip: Bound on the squared error of a value; larger errors are clipped.
        ent_coef: Weight of the entropy in the loss.
        vf_coef: Weight of the value loss.
        max_grad_norm: Greatest norm of a gradient.
    """

    section: ClassVar[str] = "hyperparameters"

    learning_rate: Positive = 1e-3
    minibatch_size: Count = 512
    epochs: Count = 10
    gamma: Share = 0.95
    gae_lambda: Share = 0.9
    clip_range: float = 0.2
    value_clip: float = 100.0
    ent_coef: float = 0.0
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5


@dataclass(frozen=True)
class RLlibConfig(Checked):
    """Everything that determines a training run.

    Attributes:
        environment: Environment in which the agent learns; `num_envs` is the number of worlds in each environment
            runner.
        env_runners: The processes that collect experience.
        hyperparameters: Hyper-parameters of PPO.
        network: Separate networks of policy and value; activation "relu" or "tanh".
        normalization: Normalisation of observations.
        total_steps: Number of environment steps, of all worlds together.
        evaluation: Evaluation during training; `from_success` is ignored.
        checkpoint_every: Number of environment steps between checkpoints.
        success_target: Training stops when an evaluation reaches this success rate; None to train to the end.
        seed: Seed of all randomness.
    """

    environment: EnvironmentConfig
    env_runners: EnvRunnersConfig = field(default_factory=EnvRunnersConfig)
    hyperparameters: RLlibPPOConfig = field(default_factory=RLlibPPOConfig)
    network: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64), "tanh"))
    normalization: NormalizationConfig = field(default_factory=NormalizationConfig)
    total_steps: Count = 1_000_000
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    checkpoint_every: Count = 100_000
    success_target: Share | None = 0.97
    seed: Natural = 0

    def __post_init__(self) -> None:
        """Check the values, and that they are consistent."""
        super().__post_init__()
        if self.network.activation not in ("relu", "tanh"):
            raise ValueError(f"network.activation must be 'relu' or 'tanh' with RLlib, got {self.network.activation!r}")
        if self.normalization.rewards:
            raise ValueError("normalization.rewards must be false with RLlib")
        if self.environment.kwargs.get("reward") == "sparse":
            raise ValueError("environment.kwargs.reward must not be 'sparse' with RLlib's PPO")

    @property
    def batch_size(self) -> int:
        """Number of environment steps between two updates."""
        return max(1, self.env_runners.count) * self.environment.num_envs * self.env_runners.fragment


def read_rllib(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> RLlibConfig:
    """Read a configuration of training with RLlib.

    Args:
        path: A YAML file with the fields of `RLlibConfig`.
        changes: Each "key=value" or "key.sub=value", with the value in YAML; they replace values of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a key is unknown or missing, or a value is not allowed.
    """
    file = Path(path)
    content = load_yaml(file)
    if not isinstance(content, Mapping):
        raise ValueError(f"{file} must hold a mapping, got {content!r}")
    try:
        return from_mapping(RLlibConfig, with_changes(content, changes), "")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
