"""What TorchRL is to read from info, in every autoreset mode. Needs `pip install torchrl`.

TorchRL takes the environments as they are, `GymEnv(id)` and `GymWrapper(gymnasium.make_vec(...))`; it refuses the
autoreset mode "next_step".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spatula_env.envs.episode_sums import values_of_step

try:
    import torch
    from torchrl.data import Unbounded
    from torchrl.envs import default_info_dict_reader
except ImportError as error:
    raise ImportError(
        "spatula_env.envs.adapters.torchrl needs TorchRL: pip install torchrl", name=error.name
    ) from error


class InfoReader(default_info_dict_reader):  # type: ignore[misc]
    """Reads numbers of info, those of the step that was taken even where it ended an episode.

    TorchRL's own reader takes `infos["cost"]`, which with same-step autoreset is of the next episode's beginning.

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from torchrl.envs import GymWrapper
        >>> from spatula_env.envs.adapters.torchrl import InfoReader
        >>> envs = GymWrapper(gym.make_vec("Spatula/Press-v0", num_envs=4, autoreset_mode="same_step"))
        >>> envs = envs.set_info_dict_reader(InfoReader(["cost"], num_envs=4))
    """

    def __init__(self, keys: Sequence[str] = ("cost",), num_envs: int | None = None) -> None:
        """Choose what to read.

        Args:
            keys: Names in info; each becomes an entry of the same name, float32.
            num_envs: How many worlds a vector environment has; None: an environment for one agent.
        """
        shape = () if num_envs is None else (num_envs,)
        super().__init__(list(keys), spec={key: Unbounded(shape, dtype=torch.float32) for key in keys})

    def __call__(self, info_dict: Mapping[str, Any], tensordict: Any) -> Any:
        """Put the numbers of a reset or a step into a TensorDict."""
        for key in self.keys:
            tensordict.set(key, torch.as_tensor(np.asarray(values_of_step(info_dict, key), dtype=np.float32)))
        return tensordict
