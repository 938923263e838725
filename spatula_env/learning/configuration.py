"""Reads configurations: YAML files in `configs`, validated before use.

A file describes either an environment (`read_environment`) or a training (`read_training`). `find_config` finds one by
its name.
"""

from __future__ import annotations

import dataclasses
import math
import os
import types
import typing
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import gymnasium
import yaml

import spatula_env
from spatula_env import engines
from spatula_env.changes import with_changes
from spatula_env.learning.ranges import Checked, Count, Natural, NotNegative, Positive, Share, one_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

gymnasium.register_envs(spatula_env)

ENVIRONMENT_KEYS = ("id", "kwargs")

ENGINES = tuple(sorted(engines.ENGINES))
"""Engines in which agents can learn."""

USUAL_ENGINES = tuple(each for each in ENGINES if each not in engines.OF_EXTRAS)
"""Those that need no extra."""

Engine = Annotated[str, one_of(ENGINES)]

ACTIVATIONS = ("relu", "tanh", "elu")
"""Activation functions between the layers of a network."""

CONFIG_FOLDERS = (Path(__file__).parent / "configs", Path(__file__).parents[2] / "configs")
"""Folders of the configurations that come with the package: when installed, and in its repository."""

Config = TypeVar("Config", bound="DataclassInstance")


def find_config(name: str | os.PathLike[str], holds: str = "algorithm") -> Path:
    """Find the file for a path or for a name such as "press_sac".

    Args:
        name: A path, or the name of a configuration that comes with the package, without its extension.
        holds: Key that configurations of the wanted kind have and others do not.

    Raises:
        FileNotFoundError: If there is no such file; the message lists the available names of that kind.
    """
    path = Path(name)
    if path.is_file():
        return path
    folder = next((folder for folder in CONFIG_FOLDERS if (folder / "press_sac.yaml").exists()), None)
    files = {file.stem: file for file in sorted(folder.glob("*.yaml"))} if folder is not None else {}
    if str(name) in files:
        return files[str(name)]
    fitting = [stem for stem, file in files.items() if holds in _top_keys(file)]
    raise FileNotFoundError(f"config must be a file or one of {', '.join(fitting)}: no {name}")


def _top_keys(file: Path) -> Sequence[str]:
    content = load_yaml(file)
    return list(content) if isinstance(content, Mapping) else []


def read_environment(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any]]:
    """Read the arguments of `gymnasium.make` from a file.

    Args:
        path: A YAML file with `id`, and optionally `kwargs`.

    Returns:
        The id and the keyword arguments.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not such a mapping; the message names the file, its content and what is allowed.
    """
    file = Path(path)
    content = load_yaml(file)
    if not isinstance(content, Mapping):
        raise ValueError(f"{file} must hold a mapping with the keys {list(ENVIRONMENT_KEYS)}, got {content!r}")
    unknown = [key for key in content if key not in ENVIRONMENT_KEYS]
    if unknown:
        raise ValueError(f"{file} has unknown keys {unknown}; allowed are {list(ENVIRONMENT_KEYS)}")
    name, kwargs = content.get("id"), content.get("kwargs") or {}
    if not isinstance(name, str):
        raise ValueError(f"{file} must name an environment's id, got {name!r}")
    if not isinstance(kwargs, Mapping) or not all(isinstance(key, str) for key in kwargs):
        raise ValueError(f"{file}: kwargs must be a mapping from names to values, got {kwargs!r}")
    return name, dict(kwargs)


def make_environment(path: str | os.PathLike[str], **overrides: Any) -> gymnasium.Env[Any, Any]:
    """Make the environment that a file describes.

    Args:
        path: See `read_environment`.
        **overrides: Keyword arguments that replace or extend the file's.

    Returns:
        The environment.
    """
    name, kwargs = read_environment(path)
    return gymnasium.make(name, **{**kwargs, **overrides})


@dataclass(frozen=True)
class EnvironmentConfig(Checked):
    """Environment in which an agent learns.

    Attributes:
        id: Id of the environment.
        kwargs: Arguments with which it is made, besides the engine; "max_episode_steps" among them applies to training
            episodes, not to evaluation.
        engine: Engine that simulates the organs in training: "batch", "tissue", "mujoco" or "bullet".
        parts: Names of the observation's parts that the agent gets; None for all of them.
        num_envs: Number of worlds that are stepped together.
    """

    section: ClassVar[str] = "environment"

    id: str
    kwargs: dict[str, Any] = field(default_factory=dict)
    engine: Engine = "batch"
    parts: tuple[str, ...] | None = None
    num_envs: Count = 64

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        if "engine" in self.kwargs:
            raise ValueError("environment.kwargs must not hold engine: it is a key of environment itself")
        if self.parts is not None and not self.parts:
            raise ValueError("environment.parts must be null or name one part at least")


@dataclass(frozen=True)
class NetworkConfig(Checked):
    """Networks of policy and value, which have the same structure.

    Attributes:
        layers: Number of units in each hidden layer.
        activation: "relu", "tanh" or "elu".
    """

    section: ClassVar[str] = "network"

    layers: tuple[Count, ...] = (128, 128)
    activation: Annotated[str, one_of(ACTIVATIONS)] = "relu"


@dataclass(frozen=True)
class NormalizationConfig(Checked):
    """Normalisation to mean 0 and standard deviation 1, by running estimates that are saved with the policy.

    Attributes:
        observations: Whether to normalise observations.
        rewards: Whether to divide rewards by the standard deviation of the discounted return.
        clip: Greatest magnitude of a normalised number.
    """

    section: ClassVar[str] = "normalization"

    observations: bool = True
    rewards: bool = False
    clip: Positive = 10.0


@dataclass(frozen=True)
class EvaluationConfig(Checked):
    """Evaluation of an agent during training, in episodes that it does not learn from.

    Attributes:
        every: Environment steps between evaluations.
        episodes: Number of episodes per evaluation.
        engine: Engine of the evaluation: "batch", "tissue", "mujoco" or "bullet".
        seed: Seed of the first episode; increases by one for each further one.
        from_success: No evaluation is made while the success rate of the last 100 training episodes is lower, except
            for the last evaluation.
    """

    section: ClassVar[str] = "evaluation"

    every: Count = 20_000
    episodes: Count = 64
    engine: Engine = "batch"
    seed: Natural = 1_000_000
    from_success: Share = 0.0


@dataclass(frozen=True)
class PPOConfig(Checked):
    """Hyper-parameters of PPO, under Stable-Baselines3's names.

    Attributes:
        learning_rate: Learning rate of Adam.
        final_learning_rate: Value to which it decreases linearly; None for a constant rate.
        n_steps: Number of steps of each world between updates.
        batch_size: Number of samples per gradient step.
        n_epochs: Number of passes over the samples.
        gamma: Discount factor.
        gae_lambda: Parameter of generalised advantage estimation.
        clip_range: Clipping range of the probability ratio.
        ent_coef: Weight of the entropy in the loss.
        vf_coef: Weight of the value loss.
        max_grad_norm: Greatest norm of a gradient.
        target_kl: An update stops when the divergence exceeds 1.5 times this; None for no limit.
        log_std_init: Initial logarithm of the actions' standard deviation.
    """

    section: ClassVar[str] = "hyperparameters"

    learning_rate: Positive = 3e-4
    final_learning_rate: float | None = None
    n_steps: Count = 64
    batch_size: Count = 512
    n_epochs: Count = 10
    gamma: Share = 0.98
    gae_lambda: Share = 0.95
    clip_range: float = 0.2
    ent_coef: float = 0.0
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    target_kl: float | None = None
    log_std_init: float = 0.0


@dataclass(frozen=True)
class SACConfig(Checked):
    """Hyper-parameters of SAC, under Stable-Baselines3's names.

    Attributes:
        learning_rate: Learning rate of Adam.
        final_learning_rate: Value to which it decreases linearly; None for a constant rate.
        buffer_size: Number of transitions that are kept.
        learning_starts: Number of environment steps with random actions before the first gradient step.
        batch_size: Number of samples per gradient step.
        tau: Share by which the target networks move towards the critics in a gradient step.
        gamma: Discount factor.
        gradient_steps: Number of gradient steps per step of all worlds together.
        ent_coef: Weight of the entropy; "auto" tunes it, "auto_0.1" starts from 0.1.
        target_entropy: Target of "auto"; "auto" here is minus the number of action components.
        n_critics: Number of critics.
    """

    section: ClassVar[str] = "hyperparameters"

    learning_rate: Positive = 1e-3
    final_learning_rate: float | None = None
    buffer_size: Count = 400_000
    learning_starts: Natural = 6_400
    batch_size: Count = 256
    tau: Share = 0.01
    gamma: Share = 0.97
    gradient_steps: Count = 8
    ent_coef: float | str = "auto_0.1"
    target_entropy: float | str = "auto"
    n_critics: Count = 2

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        if isinstance(self.ent_coef, str) and self.ent_coef != "auto":
            first = _number(self.ent_coef.removeprefix("auto_"))
            if not self.ent_coef.startswith("auto_") or first is None or first <= 0.0:
                raise ValueError(
                    "hyperparameters.ent_coef must be a number, 'auto' or 'auto_X' with a positive X, got "
                    f"{self.ent_coef!r}"
                )
        if isinstance(self.target_entropy, str) and self.target_entropy != "auto":
            raise ValueError(f"hyperparameters.target_entropy must be a number or 'auto', got {self.target_entropy!r}")


@dataclass(frozen=True)
class TQCConfig(SACConfig):
    """Hyper-parameters of TQC: those of SAC and two more.

    Attributes:
        n_quantiles: Number of quantiles of the return that each critic estimates.
        top_quantiles_to_drop_per_net: Number of the greatest quantiles that are dropped.
    """

    n_quantiles: int = 25
    top_quantiles_to_drop_per_net: int = 2


@dataclass(frozen=True)
class SACHERConfig(SACConfig):
    """Hyper-parameters of SAC with hindsight replay: those of SAC and two more.

    Attributes:
        n_sampled_goal: Number of transitions with a hindsight goal for each one with the real goal.
        goal_selection_strategy: "future", "final" or "episode".
    """

    n_sampled_goal: Count = 4
    goal_selection_strategy: Annotated[str, one_of(("future", "final", "episode"))] = "future"


ALGORITHMS: Mapping[str, type[PPOConfig] | type[SACConfig]] = types.MappingProxyType(
    {"ppo": PPOConfig, "sac": SACConfig, "tqc": TQCConfig, "sac_her": SACHERConfig}
)
"""Available algorithms, and the classes of their hyper-parameters."""


@dataclass(frozen=True)
class TrainingConfig(Checked):
    """Everything that determines a training run.

    Attributes:
        environment: Environment in which the agent learns.
        algorithm: "ppo", "sac", "tqc" or "sac_her".
        hyperparameters: Hyper-parameters of the algorithm.
        network: Networks of policy and value.
        normalization: Normalisation of observations and rewards.
        total_steps: Number of environment steps, of all worlds together.
        evaluation: Evaluation during training.
        checkpoint_every: Number of environment steps between checkpoints.
        success_target: Training stops when an evaluation reaches this success rate; None to train to the end.
        demonstrations: Number of the scripted expert's episodes that the agent is given before training begins.
        demonstration_noise: Standard deviation of the noise that perturbs the expert; "auto" for the greatest that it
            copes with.
        demonstration_share: Share of demonstrations in each batch throughout training (P. Ball et al., "Efficient
            Online Reinforcement Learning with Offline Data", ICML 2023); 0 to treat them like any other experience.
        clone_steps: Number of gradient steps in which the actor imitates the demonstrations before training begins.
        imitation_weight: Weight of imitation, relative to rewards, in each update of the actor; see
            `hold_to_demonstrations`.
        actor_starts: Number of environment steps during which only the critics learn, while the actor stays a clone.
        overlap: Whether gradient steps run while the worlds are stepped, with the transitions before that step; not for
            PPO.
        torch_threads: Number of threads for torch.
        seeds: Seeds; one agent is trained for each.
    """

    environment: EnvironmentConfig
    algorithm: str
    hyperparameters: PPOConfig | SACConfig
    network: NetworkConfig = field(default_factory=NetworkConfig)
    normalization: NormalizationConfig = field(default_factory=NormalizationConfig)
    total_steps: Count = 500_000
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    checkpoint_every: Count = 50_000
    success_target: Share | None = 0.97
    demonstrations: Natural = 0
    demonstration_noise: float | str = 0.0
    demonstration_share: Share = 0.0
    clone_steps: Natural = 0
    imitation_weight: NotNegative = 0.0
    actor_starts: Natural = 0
    overlap: bool = True
    torch_threads: Count = 1
    seeds: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        """Check the values, and that they are consistent."""
        super().__post_init__()
        self._check_demonstrations()
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise ValueError(f"seeds must be different integers, zero or more, got {list(self.seeds)}")
        sparse = self.environment.kwargs.get("reward") == "sparse"
        if self.algorithm == "sac_her" and not sparse:
            raise ValueError("environment.kwargs.reward must be 'sparse' with algorithm 'sac_her'")

    def _check_demonstrations(self) -> None:
        check_noise(self.demonstration_noise, "demonstration_noise")
        if self.algorithm == "ppo" and self.demonstrations:
            raise ValueError("demonstrations must be 0 with algorithm 'ppo', which has no replay buffer")
        for name in ("demonstration_share", "clone_steps", "imitation_weight", "actor_starts"):
            if getattr(self, name) and not self.demonstrations:
                raise ValueError(f"{name} must be 0 without demonstrations, got {getattr(self, name)!r}")
        if self.algorithm == "sac_her" and self.demonstration_share:
            raise ValueError("demonstration_share must be 0 with algorithm 'sac_her', which makes its own batches")
        if self.imitation_weight and not self.demonstration_share:
            raise ValueError("imitation_weight must be 0 unless demonstration_share keeps demonstrations at hand")


def read_training(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> TrainingConfig:
    """Read a training configuration.

    Args:
        path: A YAML file with the fields of `TrainingConfig`.
        changes: Each "key=value" or "key.sub=value", with the value in YAML; they replace values of the file.

    Returns:
        The configuration.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a key is unknown or missing, or a value is of the wrong kind; the message says which, and what is
            allowed.
    """
    file = Path(path)
    content = load_yaml(file)
    if not isinstance(content, Mapping):
        raise ValueError(f"{file} must hold a mapping, got {content!r}")
    try:
        return training_from_mapping(with_changes(content, changes))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def training_from_mapping(content: Mapping[str, Any]) -> TrainingConfig:
    """Make a configuration from a mapping with the fields of `TrainingConfig`, as read from YAML or JSON.

    Raises:
        ValueError: See `read_training`.
    """
    algorithm = content.get("algorithm")
    if not isinstance(algorithm, str) or algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm must be one of {sorted(ALGORITHMS)}, got {algorithm!r}")
    hyperparameters = from_mapping(ALGORITHMS[algorithm], content.get("hyperparameters") or {}, "hyperparameters")
    return from_mapping(TrainingConfig, {**content, "hyperparameters": hyperparameters}, "")


def to_mapping(config: Any) -> dict[str, Any]:
    """Convert a configuration to plain mappings, lists and numbers, for YAML and JSON."""
    plain: dict[str, Any] = _plain(dataclasses.asdict(config))
    return plain


def write_training(config: TrainingConfig, path: str | os.PathLike[str]) -> None:
    """Write a configuration as YAML for `read_training`."""
    Path(path).write_text(yaml.safe_dump(to_mapping(config), sort_keys=False), encoding="utf-8")


def from_mapping(kind: type[Config], content: Any, name: str) -> Config:
    """Make a dataclass from a mapping of its fields, strictly.

    Args:
        kind: The dataclass; its fields are numbers, texts, mappings, tuples, dataclasses, or one of these or None.
        content: The mapping.
        name: Key of the mapping in the file, for error messages; "" at the top level.

    Raises:
        ValueError: If a key is unknown or missing, or a value is of the wrong kind.
    """
    where = name or "the configuration"
    if not isinstance(content, Mapping):
        raise ValueError(f"{where} must be a mapping, got {content!r}")
    fields = {each.name: each for each in dataclasses.fields(kind)}
    unknown = [str(key) for key in content if key not in fields]
    if unknown:
        raise ValueError(f"{where} has unknown keys {unknown}; allowed are {sorted(fields)}")
    required = [
        each.name
        for each in fields.values()
        if each.default is dataclasses.MISSING and each.default_factory is dataclasses.MISSING
    ]
    missing = [key for key in required if key not in content]
    if missing:
        raise ValueError(f"{where} lacks the keys {missing}")
    hints = typing.get_type_hints(kind)
    values = {key: _as(hints[key], value, f"{name}.{key}" if name else key) for key, value in content.items()}
    return kind(**values)


def _as(kind: Any, value: Any, name: str) -> Any:
    """Convert a value to a type annotation's type."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        problems = []
        for each in inner:
            if each is not type(None):
                try:
                    return _as(each, value, name)
                except ValueError as error:
                    problems.append(error)
        raise problems[0]
    if origin is tuple:
        if not isinstance(value, Sequence) or isinstance(value, str):
            raise ValueError(f"{name} must be a list, got {value!r}")
        return tuple(_as(inner[0], each, name) for each in value)
    if origin is dict:
        if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
            raise ValueError(f"{name} must be a mapping from names to values, got {value!r}")
        return dict(value)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return value if isinstance(value, kind) else from_mapping(kind, value, name)
    if kind is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{name} must be true or false, got {value!r}")
        return value
    if kind is int:
        # YAML reads 5e5 as text, and 5.0e5 as a float.
        number = _number(value)
        if number is None or number != int(number):
            raise ValueError(f"{name} must be an integer, got {value!r}")
        return int(number)
    if kind is float:
        number = _number(value)
        if number is None:
            raise ValueError(f"{name} must be a number, got {value!r}")
        return number
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be a {kind.__name__}, got {value!r}")
    return value


def _number(value: Any) -> float | None:
    """Convert to a finite number, including numbers that YAML reads as text, such as 3e-4; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value


class _StrictLoader(yaml.SafeLoader):
    """A loader that rejects duplicate keys; PyYAML silently keeps the last value."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Make a mapping, checking that each key occurs once."""
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                raise yaml.constructor.ConstructorError(
                    "while constructing a mapping", node.start_mark, f"the key {key!r} is there twice",
                    key_node.start_mark,
                )  # fmt: skip
            if isinstance(key, Hashable):
                seen.add(key)
        return super().construct_mapping(node, deep)


def load_yaml(file: Path) -> Any:
    """Load a YAML file; raises ValueError if it is not YAML, or has a duplicate key."""
    try:
        return yaml.load(file.read_text(encoding="utf-8"), Loader=_StrictLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"
        said = getattr(error, "problem", None) or str(error)
        raise ValueError(f"{file}{where}: this is not YAML: {said}") from error
    except RecursionError as error:
        raise ValueError(f"{file}: this is not YAML of a configuration: it is nested too deeply") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: this is not YAML: it is no text in UTF-8") from error


def check_noise(value: float | str, name: str) -> None:
    """Check a noise level of demonstrations: a number of at least 0, or "auto"."""
    if value != "auto" and (isinstance(value, str) or not 0.0 <= value < math.inf):
        raise ValueError(f"{name} must be a number from 0 on or 'auto', got {value!r}")
