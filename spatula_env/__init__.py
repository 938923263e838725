"""Gymnasium environments for learning tool-tissue manipulation with a thin rigid spatula.

Importing this package registers the environments; it loads no physics engine, no compiler and no learning
library.

Example:
    >>> import gymnasium as gym
    >>> import spatula_env
    >>> env = gym.make("Spatula/Press-v0")
    >>> observation, info = env.reset(seed=0)
    >>> env.close()

`gymnasium.make_vec` creates many environments that are stepped together.

`Simulation` and `scenes` are the layer below: the physics, without Gymnasium.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from spatula_env import scenes
    from spatula_env.sim.simulation import Simulation

__version__ = "0.1.0"
"""The version of the package."""

__all__ = ["Simulation", "__version__", "scenes"]


def __getattr__(name: str) -> Any:
    """Import the physics when it is first asked for."""
    if name == "scenes":
        return import_module("spatula_env.scenes")
    if name == "Simulation":
        return import_module("spatula_env.sim.simulation").Simulation
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


TASKS = ("Press", "Retract", "Fissure", "Clamp", "Palpate")
"""Names of the tasks; their ids are Spatula/<name>-v0."""

EPISODE_TIME = 10.0
"""Time after which an episode is truncated [s], converted to a number of control steps, unless `episode_time` or
`max_episode_steps` says otherwise."""


def _register() -> None:
    """Register the environments with Gymnasium, which does not discover those of packages that are not imported."""
    for name in TASKS:
        if f"Spatula/{name}-v0" not in gymnasium.registry:
            module = f"spatula_env.envs.{name.lower()}"
            gymnasium.register(
                id=f"Spatula/{name}-v0",
                entry_point=f"{module}:{name}Env",
                vector_entry_point=f"{module}:{name}VectorEnv",
                kwargs={"episode_time": EPISODE_TIME},
            )


_register()
