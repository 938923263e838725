"""Gymnasium environments, put together from a simulation, a control, a task and an observation.

Make them by id, with `gymnasium.make("Spatula/Press-v0")`; `import spatula_env` registers the ids.
"""

from __future__ import annotations

from spatula_env.envs.press import PressEnv
from spatula_env.envs.spatula_env import SpatulaEnv

__all__ = ["PressEnv", "SpatulaEnv"]
