"""Gymnasium environments, put together from worlds, a control, a task and an observation.

Make them by id, with `gymnasium.make("Spatula/Press-v0")` for one agent and `gymnasium.make_vec` for many;
`import spatula_env` registers the ids. `spatula_env.envs.sb3` makes them for Stable-Baselines3.
"""

from __future__ import annotations

from spatula_env.envs.clamp import ClampEnv, ClampVectorEnv
from spatula_env.envs.fissure import FissureEnv, FissureVectorEnv
from spatula_env.envs.observations import lerobot_keys
from spatula_env.envs.palpate import PalpateEnv, PalpateVectorEnv
from spatula_env.envs.press import PressEnv, PressVectorEnv
from spatula_env.envs.retract import RetractEnv, RetractVectorEnv
from spatula_env.envs.settings import Definition, EnvSettings, ObservationSettings
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv

__all__ = [
    "ClampEnv",
    "ClampVectorEnv",
    "Definition",
    "EnvSettings",
    "FissureEnv",
    "FissureVectorEnv",
    "ObservationSettings",
    "PalpateEnv",
    "PalpateVectorEnv",
    "PressEnv",
    "PressVectorEnv",
    "RetractEnv",
    "RetractVectorEnv",
    "SpatulaEnv",
    "SpatulaVectorEnv",
    "lerobot_keys",
]
