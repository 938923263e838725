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
        count: How many, on all nodes of the cluster together; 0: the process that learns collects as well.
        cpus: That each needs, and threads that it steps its worlds with.
        fragment: Steps of each world between two updates.
        restart: Whether one that has died is replaced; else training ends with an error.
        greatest_restarts: How often one is replaced at most.
        probe_seconds: How long one may take to answer before it counts as dead [s].
        sample_seconds: How long the steps between two updates may take before what is missing is done without [s].
        restore_seconds: How long a new one may take to be ready [s].
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
        learning_rate: Of Adam.
        minibatch_size: Samples in a gradient step.
        epochs: How often each sample is used.
        gamma: Discount.
        gae_lambda: Of the advantage's estimate.
        clip_range: Of the ratio of probabilities.
        value_clip: Greatest squared error of a value that counts.
        ent_coef: Weight of the entropy.
        vf_coef: Weight of the value's loss.
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
    """All that decides how training goes.

    Attributes:
        environment: Where the agent learns; `num_envs` is the number of worlds in each environment runner.
        env_runners: The processes that collect experience.
        hyperparameters: Of PPO.
        network: Of policy and value, one for each; "relu" or "tanh".
        normalization: Of observations.
        total_steps: Environment steps, of all worlds together.
        evaluation: While it learns; `from_success` does not count.
        checkpoint_every: Environment steps between checkpoints.
        success_target: Training stops when an evaluation's success rate is no lower; None: never before the end.
        seed: Of everything that is random.
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
        """Check the values, and how they go together."""
        super().__post_init__()
        if self.network.activation not in ("relu", "tanh"):
            raise ValueError(f"network.activation must be 'relu' or 'tanh' with RLlib, got {self.network.activation!r}")
        if self.normalization.rewards:
            raise ValueError("normalization.rewards must be false with RLlib")
        if self.environment.kwargs.get("reward") == "sparse":
            raise ValueError("environment.kwargs.reward must not be 'sparse' with RLlib's PPO")

    @property
    def batch_size(self) -> int:
        """Environment steps between two updates."""
        return max(1, self.env_runners.count) * self.environment.num_envs * self.env_runners.fragment


def read_rllib(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> RLlibConfig:
    """Read how to train with RLlib.

    Args:
        path: A YAML file with the fields of `RLlibConfig`.
        changes: Each "key=value" or "key.sub=value", the value in YAML; they replace what the file says.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a key is unknown, one is missing, or a value is not allowed.
    """
    file = Path(path)
    content = load_yaml(file)
    if not isinstance(content, Mapping):
        raise ValueError(f"{file} must hold a mapping, got {content!r}")
    try:
        return from_mapping(RLlibConfig, with_changes(content, changes), "")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
