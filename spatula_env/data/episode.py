"""One episode in memory, as it is recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import gymnasium

STATE = "state"
"""Where `info` of a recorded step keeps the physics' state."""


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T steps.

    Attributes:
        observations: (T + 1, …) each, in the structure of the observation space.
        actions: (T, A) what was done.
        rewards: (T,).
        terminations: (T,).
        truncations: (T,); the last is set if the operator ended the episode.
        infos: (T + 1, …) each, in the structure of `info`; the first is that of the reset.
        seed: Of the reset.
        options: Of the reset.
        attributes: What else there is to tell: ``operator``, ``device``, ``success`` …; numbers and text.
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
        """T."""
        return len(self.rewards)


class EpisodeRecorder:
    """Collects what happens in an episode.

    `info` has to have the same keys in every step, as that of all Spatula environments has.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], *, states: bool = True) -> None:
        """Prepare.

        Args:
            env: A Spatula environment for one agent, wrapped or not.
            states: Whether to record the state of the physics too: nodes of the organ, poses of the tools.
        """
        self._simulation: Any = getattr(env.unwrapped, "simulation", None) if states else None
        self._action_type = env.action_space.dtype
        self._observations: list[Any] = []
        self._infos: list[dict[str, Any]] = []
        self._actions: list[Any] = []
        self._outcomes: list[tuple[float, bool, bool]] = []
        self._seed: int | None = None
        self._options: Mapping[str, Any] | None = None

    def __len__(self) -> int:
        """How many steps have been recorded."""
        return len(self._actions)

    def begin(
        self,
        observation: Any,
        info: Mapping[str, Any],
        seed: int | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin another episode; what has been recorded before is forgotten.

        Args:
            observation: Of the reset.
            info: Of the reset.
            seed: Given to it.
            options: Given to it.
        """
        self._observations, self._infos = [_copy(observation)], [self._kept(info)]
        self._actions, self._outcomes = [], []
        self._seed, self._options = seed, options

    def add(
        self, action: Any, observation: Any, reward: float, terminated: bool, truncated: bool, info: Mapping[str, Any]
    ) -> None:
        """Add a step.

        Args:
            action: What was done.
            observation: Of the step.
            reward: Of the step.
            terminated: Of the step.
            truncated: Of the step.
            info: Of the step.

        Raises:
            ValueError: If `info` has other keys than that of the reset.
        """
        kept = self._kept(info)
        if kept.keys() != self._infos[0].keys():
            raise ValueError(
                f"info must have the same keys in every step; {sorted(kept.keys() ^ self._infos[0].keys())} vary"
            )
        self._actions.append(np.array(action, dtype=self._action_type))
        self._observations.append(_copy(observation))
        self._infos.append(kept)
        self._outcomes.append((float(reward), bool(terminated), bool(truncated)))

    def finish(self, **attributes: Any) -> Episode:
        """What has been recorded.

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
        # The action is recorded on its own.
        kept = {name: _copy(value) for name, value in info.items() if name != "action"}
        if self._simulation is not None:
            kept[STATE] = physics_state(self._simulation)
        return kept


def physics_state(simulation: Any) -> dict[str, NDArray[np.float64]]:
    """What can be compared when an episode is replayed: "nodes" (V, 3), "tools" (N, 7) places and quaternions [u]."""
    tools = np.concatenate([simulation.tool_positions, simulation.tool_orientations], axis=1)
    return {"nodes": np.array(simulation.nodes), "tools": tools}


def _copy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _copy(each) for name, each in value.items()}
    return np.array(value) if isinstance(value, np.ndarray) else value


def _stack(values: list[Any]) -> Any:
    """Lists of the same structure into a structure of arrays; text stays a list."""
    first = values[0]
    if isinstance(first, Mapping):
        return {name: _stack([value[name] for value in values]) for name in first}
    return list(values) if isinstance(first, str) else np.stack([np.asarray(value) for value in values])
