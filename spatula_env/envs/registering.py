"""`register_task`, which makes and registers the environments of a scene and a task, for one agent and for many."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium
from gymnasium.envs.registration import parse_env_id

import spatula_env
from spatula_env import EPISODE_TIME
from spatula_env.envs.settings import Definition
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.tasks.base import Task


def register_task(
    env_id: str,
    *,
    task: type[Task],
    episode_time: float | None = EPISODE_TIME,
    module: str | None = None,
    **fields: Any,
) -> tuple[type[SpatulaEnv], type[SpatulaVectorEnv]]:
    """Make the environments of a task, for one agent and for many, and register both with Gymnasium under one id.

    The two classes become attributes of a module, where Gymnasium and other processes find them: for the id
    "Spatula/Touch-v0", `TouchEnv` and `TouchVectorEnv`. Their docstring is that of the task.

    Args:
        env_id: Id as Gymnasium takes it, such as "Spatula/Touch-v0".
        task: Class of the task.
        episode_time: Time after which episodes are truncated [s]; None for no limit.
        module: Name of a module that calls this function when it is imported. By default, the module that defines the
            task; a task of this package needs ``module=__name__``.
        **fields: Fields of the `Definition`: `scene`, `config` and `workspace_height`; and, to override their defaults,
            `stop_height`, `controls`, `defaults`, `randomization`, `levels`, `observed`. Its `name` is by default the
            id's name in lower case.

    Returns:
        The environment class for one agent, and that for many.

    Raises:
        TypeError: If a field is missing or unknown.
        ValueError: If the module has something else under the name of one of the classes, or belongs to this package.
        gymnasium.error.Error: If the id is malformed.
    """
    name = parse_env_id(env_id)[1]
    definition = Definition(task=task, **{"name": name.lower(), **fields})
    module = task.__module__ if module is None else module
    if module.partition(".")[0] == spatula_env.__name__:
        raise ValueError(f"module must be given for a task of this package: module=__name__; got {task.__name__}")
    namespace = sys.modules[module]
    # An id may contain dashes.
    stem = name.replace("-", "_")
    entry_point = f"{module}:{stem}Env"
    before = gymnasium.registry.get(env_id)
    classes: list[Any] = []
    for base, class_name in ((SpatulaEnv, f"{stem}Env"), (SpatulaVectorEnv, f"{stem}VectorEnv")):
        # Allow registering the same again, as when a notebook cell is run twice.
        if hasattr(namespace, class_name) and (before is None or before.entry_point != entry_point):
            raise ValueError(
                f"env_id needs the name {class_name} in the module {module}, where it stands for something else; "
                f"got {env_id!r}"
            )
        about = {"__module__": module, "__doc__": task.__doc__, "definition": definition}
        classes.append(type(class_name, (base,), about))
    one, many = classes
    for made in classes:
        setattr(namespace, made.__name__, made)
    gymnasium.register(
        id=env_id,
        entry_point=entry_point,
        vector_entry_point=f"{module}:{many.__name__}",
        kwargs={"episode_time": episode_time},
    )
    return one, many
