"""Gymnasium environments, each composed of worlds, a control, a task and an observation.

Make them by id, with `gymnasium.make("Spatula/Press-v0")` for one agent and `gymnasium.make_vec` for many;
`import spatula_env` registers the ids. `spatula_env.envs.sb3` makes them for Stable-Baselines3.

The names of this package are imported on first access, so that making one task does not load the others.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spatula_env.envs.clamp import ClampEnv, ClampVectorEnv
    from spatula_env.envs.fissure import FissureEnv, FissureVectorEnv
    from spatula_env.envs.observations import lerobot_keys
    from spatula_env.envs.palpate import PalpateEnv, PalpateVectorEnv
    from spatula_env.envs.press import PressEnv, PressVectorEnv
    from spatula_env.envs.registering import register_task
    from spatula_env.envs.retract import RetractEnv, RetractVectorEnv
    from spatula_env.envs.settings import Definition, EnvSettings, ObservationSettings
    from spatula_env.envs.spatula_env import SpatulaEnv
    from spatula_env.envs.vector import SpatulaVectorEnv

_MODULES = {
    "ClampEnv": "clamp",
    "ClampVectorEnv": "clamp",
    "Definition": "settings",
    "EnvSettings": "settings",
    "FissureEnv": "fissure",
    "FissureVectorEnv": "fissure",
    "ObservationSettings": "settings",
    "PalpateEnv": "palpate",
    "PalpateVectorEnv": "palpate",
    "PressEnv": "press",
    "PressVectorEnv": "press",
    "RetractEnv": "retract",
    "RetractVectorEnv": "retract",
    "SpatulaEnv": "spatula_env",
    "SpatulaVectorEnv": "vector",
    "lerobot_keys": "observations",
    "register_task": "registering",
}

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
    "register_task",
]


def __getattr__(name: str) -> Any:
    """Import a name on first access."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
