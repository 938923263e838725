"""Selection of the parts of an observation that an agent gets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

ENTRY = "observation"
"""Key of the vector in observations with the goal interface."""


@dataclass(frozen=True, eq=False)
class PartSelection:
    """A selection of columns of an observation's vector.

    Attributes:
        parts: Names of the parts that are kept.
        columns: (k,) indices of their numbers in the vector of all parts.
    """

    parts: tuple[str, ...]
    columns: NDArray[np.int64]

    @classmethod
    def of(cls, env: Any, parts: Sequence[str] | None) -> PartSelection | None:
        """The selection of some parts of an environment's observations.

        Args:
            env: For one agent or for many, wrapped or not, with `obs_mode="state"`.
            parts: Names of the parts; None for all.

        Returns:
            The selection, or None if all parts are wanted.

        Raises:
            ValueError: If a part does not exist, or observations have another layout.
        """
        if parts is None:
            return None
        made = env.unwrapped
        shown = made.settings.observation
        if made.settings.obs_mode != "state" or shown.history != 1 or shown.parts == "grouped":
            raise ValueError(
                "parts can be chosen with obs_mode='state', history=1 and observation.parts 'all' or 'sensors' only, "
                f"and must be null otherwise; they are {made.settings.obs_mode!r}, {shown.history} and {shown.parts!r}"
            )
        slices = made.observation_builder.slices
        unknown = [name for name in parts if name not in slices]
        if unknown:
            raise ValueError(f"observations have no parts {unknown}; there are {list(slices)}")
        # Keep the order of the vector, whatever the order of the names.
        kept = tuple(name for name in slices if name in parts)
        return cls(kept, np.concatenate([np.arange(slices[name].start, slices[name].stop) for name in kept]))

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Space of the selected parts of one world's observations."""
        if isinstance(space, spaces.Dict):
            return spaces.Dict({**space.spaces, ENTRY: self.space(space.spaces[ENTRY])})
        assert isinstance(space, spaces.Box)
        return spaces.Box(space.low[self.columns], space.high[self.columns], dtype=np.float32)

    def __call__(self, observation: Any) -> Any:
        """The selected parts of one or many observations."""
        if isinstance(observation, Mapping):
            return {**observation, ENTRY: observation[ENTRY][..., self.columns]}
        return observation[..., self.columns]
