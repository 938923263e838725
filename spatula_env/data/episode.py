"""One episode in memory, as it is recorded."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spatula_env.data.checking import check_seed

if TYPE_CHECKING:
    import gymnasium

STATE = "state"
"""Key of the physics' state in the `info` of a recorded step."""
StateType: TypeAlias = Literal["float32", "float64"]
STATE_TYPES = ("float32", "float64")
"""Types in which states can be recorded. Single precision is 5e-7 of a scene unit on an organ of the presets."""


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T steps.

    Attributes:
        observations: (T + 1, …) each, in the structure of the observation space.
        actions: (T, A).
        rewards: (T,).
        terminations: (T,).
        truncations: (T,); the last is set if the operator ended the episode.
        infos: (T + 1, …) each, in the structure of `info`; the first is that of the reset.
        seed: Seed of the reset.
        options: Options of the reset.
        attributes: Further information: ``operator``, ``device``, ``success`` …; numbers and text.
    """

    observations: Any
    actions: NDArray[Any]
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    infos: Mapping[str, Any]
    seed: int | None = None
    options: Mapping[str, Any] | None = None
    attributes: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of steps T."""
        return len(self.rewards)


class EpisodeRecorder:
    """Collects the steps of an episode.

    Keys of `info` may appear late or vanish: a missing number is recorded as NaN, 0 or False, a missing text as "", and
    a key ``_name`` records where ``name`` was there, as in Gymnasium's vector environments. Values that cannot be
    stacked into an array, because their shapes or types vary, are stored as text in JSON.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], *, states: bool = True, state_dtype: StateType = "float32"
    ) -> None:
        """Create a recorder for an environment.

        Args:
            env: A Spatula environment for one agent, wrapped or not.
            states: Whether to record the state of the physics too: nodes of the organ, poses of the tools.
            state_dtype: Type of recorded states, "float32" or "float64"; a replay is checked with that precision.

        Raises:
            ValueError: If `state_dtype` is another one.
        """
        if state_dtype not in STATE_TYPES:
            raise ValueError(f"state_dtype must be one of {list(STATE_TYPES)}, got {state_dtype!r}")
        self._simulation: Any = getattr(env.unwrapped, "simulation", None) if states else None
        self._state_type = np.dtype(state_dtype)
        self._action_type = env.action_space.dtype
        self._observations: list[Any] = []
        self._infos: list[dict[str, Any]] = []
        self._actions: list[Any] = []
        self._outcomes: list[tuple[float, bool, bool]] = []
        self._seed: int | None = None
        self._options: Mapping[str, Any] | None = None

    def __len__(self) -> int:
        """Number of recorded steps."""
        return len(self._actions)

    def begin(
        self,
        observation: Any,
        info: Mapping[str, Any],
        seed: int | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin another episode and discard what has been recorded before.

        Args:
            observation: Observation of the reset.
            info: Info of the reset.
            seed: Seed given to the reset.
            options: Options given to the reset.

        Raises:
            ValueError: If no dataset can store the seed.
        """
        check_seed(seed)
        self._observations, self._infos = [_copy(observation)], [self._kept(info)]
        self._actions, self._outcomes = [], []
        self._seed, self._options = seed, options

    def add(
        self, action: Any, observation: Any, reward: float, terminated: bool, truncated: bool, info: Mapping[str, Any]
    ) -> None:
        """Add a step.

        Args:
            action: The action.
            observation: Observation after the step.
            reward: Reward of the step.
            terminated: Whether the step terminated the episode.
            truncated: Whether the step truncated the episode.
            info: Info of the step.
        """
        kept = self._kept(info)
        self._actions.append(np.array(action, dtype=self._action_type))
        self._observations.append(_copy(observation))
        self._infos.append(kept)
        self._outcomes.append((float(reward), bool(terminated), bool(truncated)))

    def finish(self, **attributes: Any) -> Episode:
        """The recorded episode. Unless it terminated, its last step counts as truncated.

        Args:
            **attributes: See `Episode.attributes`.

        Raises:
            ValueError: If there has been no step.
        """
        if not self._actions:
            raise ValueError("an episode must have a step at least")
        rewards, terminations, truncations = zip(*self._outcomes, strict=True)
        cut = np.array(truncations, dtype=np.bool_)
        cut[-1] |= not terminations[-1]
        return Episode(
            observations=_stack(self._observations),
            actions=np.stack(self._actions),
            rewards=np.array(rewards, dtype=np.float64),
            terminations=np.array(terminations, dtype=np.bool_),
            truncations=cut,
            infos=_stack(self._infos),
            seed=self._seed,
            options=self._options,
            attributes=attributes,
        )

    def _kept(self, info: Mapping[str, Any]) -> dict[str, Any]:
        # The action is recorded separately.
        kept = {name: _copy(value) for name, value in info.items() if name != "action"}
        if self._simulation is not None:
            state = physics_state(self._simulation)
            kept[STATE] = {name: values.astype(self._state_type) for name, values in state.items()}
        return kept


def physics_state(simulation: Any) -> dict[str, NDArray[np.float64]]:
    """The state to compare in a replay: "nodes" (V, 3), and "tools" (N, 7), positions and quaternions [u]."""
    tools = np.concatenate([simulation.tool_positions, simulation.tool_orientations], axis=1)
    return {"nodes": np.array(simulation.nodes), "tools": tools}


def _copy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _copy(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        return np.array(value)
    if isinstance(value, list | tuple | set):
        # A value that cannot be copied is recorded as it is at the end of the episode.
        with suppress(Exception):
            return copy.deepcopy(value)
    return value


class _Absent:
    """Placeholder for a value that is missing in a step."""


ABSENT = _Absent()


def _stack(values: list[Any]) -> Any:
    """Stack the values of steps into arrays of T + 1 rows; text into a list."""
    there = [value for value in values if value is not ABSENT]
    if all(isinstance(value, Mapping) for value in there):
        return _stack_mappings(values)
    if all(isinstance(value, str) for value in there):
        return ["" if value is ABSENT else str(value) for value in values]
    try:
        arrays = [np.asarray(value) for value in there]
        fits = len({array.shape for array in arrays}) == 1 and all(array.dtype.kind in "biufc" for array in arrays)
    except ValueError:
        # Lists whose inner lengths vary.
        fits = False
    if not fits:
        return [json.dumps(None if value is ABSENT else value, default=_in_json) for value in values]
    kind = np.result_type(*arrays)
    nothing = np.full(arrays[0].shape, np.nan if kind.kind in "fc" else 0, dtype=kind)
    rows = iter(arrays)
    return np.stack([nothing if value is ABSENT else next(rows).astype(kind) for value in values])


def _stack_mappings(values: list[Any]) -> dict[str, Any]:
    stacked: dict[str, Any] = {}
    names = dict.fromkeys(name for value in values if value is not ABSENT for name in value)
    for name in names:
        column = [ABSENT if value is ABSENT else value.get(name, ABSENT) for value in values]
        stacked[name] = _stack(column)
        # Where the whole mapping is missing, the mapping's own mask says so.
        if any(each is ABSENT and value is not ABSENT for each, value in zip(column, values, strict=True)):
            stacked.setdefault(f"_{name}", np.array([each is not ABSENT for each in column]))
    return stacked


def _in_json(value: Any) -> Any:
    """Represent a value of a type that JSON does not support as well as possible."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return sorted(map(str, value)) if isinstance(value, set | frozenset) else repr(value)
