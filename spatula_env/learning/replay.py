"""A replay buffer that keeps demonstrations separate: never overwritten, and part of every batch.

Needs the extra "train".
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

BATCH_PARTS = ("observations", "actions", "next_observations", "dones", "rewards")


class DemonstrationReplayBuffer(ReplayBuffer):
    """Draws a fixed share of each batch from demonstrations and the rest from experience.

    P. Ball et al., "Efficient Online Reinforcement Learning with Offline Data", ICML 2023, use one half.

    Attributes:
        share: Share of demonstrations in a batch.
        demonstrations: Buffer of the demonstrated transitions; None if there are none yet.
        imitated: (N, ...) the demonstrators' observations, not normalised, and (N, A) their wanted actions.
    """

    def __init__(self, *arguments: Any, share: float, **more: Any) -> None:
        """Allocate the buffer.

        Args:
            *arguments: Arguments of `ReplayBuffer`.
            share: Share of demonstrations in a batch, in [0, 1].
            **more: Keyword arguments of `ReplayBuffer`.
        """
        super().__init__(*arguments, **more)
        self.share = share
        self.demonstrations: ReplayBuffer | None = None
        self.imitated: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None

    def make_room(self, transitions: int) -> ReplayBuffer:
        """Make an empty buffer for demonstrations, to be filled by the caller.

        Args:
            transitions: Number of transitions, of all worlds together.
        """
        self.demonstrations = ReplayBuffer(
            transitions, self.observation_space, self.action_space, self.device, n_envs=self.n_envs
        )
        return self.demonstrations

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        """Sample a batch, with the demonstrations first."""
        if self.demonstrations is None or self.share == 0.0:
            return super().sample(batch_size, env)
        shown = round(self.share * batch_size) if self.size() > 0 else batch_size
        if shown == batch_size:
            return self.demonstrations.sample(batch_size, env)
        first, second = self.demonstrations.sample(shown, env), super().sample(batch_size - shown, env)
        joined = [torch.cat([getattr(first, name), getattr(second, name)]) for name in BATCH_PARTS]
        return ReplayBufferSamples(*joined)
