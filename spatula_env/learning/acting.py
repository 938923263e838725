"""Trained models as policies: exported to arrays if they consist of dense layers only, otherwise run by torch.

Needs the extra "train".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from spatula_env.learning.export import export_policy, is_dense
from spatula_env.policies import ExportedPolicy, PartSelection
from spatula_env.policies.exported import warn_of_definition

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize


@dataclass(frozen=True, eq=False)
class TorchPolicy:
    """A model run by torch, together with the normalisation of its observations.

    Attributes:
        model: Model of Stable-Baselines3.
        normalizer: Normalisation of its observations; None for none.
        metadata: Metadata as of `ExportedPolicy`.
        selection: Selection of the observation's parts, once an environment is known; None for all.
    """

    model: BaseAlgorithm
    normalizer: VecNormalize | None
    metadata: Mapping[str, Any]
    selection: PartSelection | None = None

    def begin(self, seeds: Sequence[int]) -> None:
        """Nothing to do at the beginning of episodes."""

    def bound_to(self, env: Any) -> TorchPolicy:
        """Bind the policy to an environment.

        Args:
            env: For one agent or for many, wrapped or not.

        Raises:
            ValueError: If its observations or actions differ from those of training.
        """
        warn_of_definition(self.metadata)
        selection = PartSelection.of(env, self.metadata.get("parts"))
        given: Any = getattr(env, "single_observation_space", env.observation_space)
        if selection is not None:
            given = selection.space(given)
        actions = getattr(env, "single_action_space", env.action_space)
        wanted = self.model.observation_space
        for what, one, other in (("observations", _shapes(given), _shapes(wanted)),
                                 ("actions", actions.shape, self.model.action_space.shape)):  # fmt: skip
            if one != other:
                raise ValueError(f"{what} must have the shapes {other} for this policy, got {one}")
        return replace(self, selection=selection)

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The action (A,) for an observation, or the actions (W, A) for those of W worlds."""
        if self.selection is not None:
            observation = self.selection(observation)
        if self.normalizer is not None:
            observation = self.normalizer.normalize_obs(observation)
        actions, _ = self.model.predict(observation, deterministic=True)
        return np.asarray(actions, dtype=np.float32)


def acting_policy(
    model: BaseAlgorithm, normalizer: VecNormalize | None, metadata: Mapping[str, Any]
) -> ExportedPolicy | TorchPolicy:
    """Make a policy of a model, to be bound to an environment by `bound_to`.

    Args:
        model: PPO, SAC or TQC.
        normalizer: Normalisation of its observations; None for none.
        metadata: See `ExportedPolicy`.
    """
    if is_dense(model):
        return export_policy(model, normalizer, metadata)
    return TorchPolicy(model, normalizer, dict(metadata))


def _shapes(space: Any) -> Any:
    if isinstance(space, spaces.Dict):
        return {name: one.shape for name, one in space.spaces.items()}
    return space.shape
