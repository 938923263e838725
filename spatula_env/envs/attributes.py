"""Access to attributes of single worlds in a vector environment: Gymnasium's `call`, `get_attr` and `set_attr`."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

Worlds: TypeAlias = Any
"""A `SpatulaVectorEnv`; not named because its module imports this one."""

ABOUT_ALL = frozenset(
    {
        "call",
        "close",
        "close_extras",
        "closed",
        "get_attr",
        "goals",
        "max_episode_steps",
        "num_envs",
        "reset",
        "set_attr",
        "single_action_space",
        "single_observation_space",
        "step",
        "worlds",
    }
)
"""Attributes of the vector environment as a whole that no single world has."""

READ: dict[str, Callable[[Worlds], Iterable[Any]]] = {
    "_max_episode_steps": lambda env: [env.max_episode_steps] * env.num_envs,
    "action_space": lambda env: [env.single_action_space] * env.num_envs,
    "goal": lambda env: env.goals,
    "grip": lambda env: env.grips,
    "np_random": lambda env: env.np_random,
    "np_random_seed": lambda env: env.np_random_seed,
    "observation_space": lambda env: [env.single_observation_space] * env.num_envs,
    "render": lambda env: env.render() or [None] * env.num_envs,
}
"""Attributes that differ from world to world, or have another name in the environment for one agent."""


def call_worlds(env: Worlds, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
    """Call a method of every world, or read an attribute, as `gymnasium.vector.SyncVectorEnv.call` does.

    Args:
        env: Environment with W worlds.
        name: Name of a method or an attribute of the environment for one agent.
        *args: Arguments of the method.
        **kwargs: Keyword arguments of the method.

    Returns:
        (W,) result of the method, or value of the attribute, in each world.

    Raises:
        AttributeError: If worlds have no such attribute, or it is one that a single world cannot have alone.
    """
    if name == "save":
        return tuple(env.save([world], *args, **kwargs) for world in range(env.num_envs))
    if name == "restore":
        raise AttributeError(f"worlds are restored together: call restore() of the {type(env).__name__}")
    values = read_in_worlds(env, name)
    if name not in READ and callable(values[0]) and not isinstance(values[0], type):
        return tuple(value(*args, **kwargs) for value in values)
    return values


def read_in_worlds(env: Worlds, name: str) -> tuple[Any, ...]:
    """Read an attribute of every world; methods are not called.

    Args:
        env: Environment with W worlds.
        name: Name of an attribute or a method of the environment for one agent.

    Returns:
        (W,) values.

    Raises:
        AttributeError: If worlds have no such attribute, or it is one that a single world does not have alone.
    """
    if name in READ:
        return tuple(READ[name](env))
    if name in ABOUT_ALL:
        raise AttributeError(_missing(env, name))
    try:
        value = getattr(env, name)
    except AttributeError:
        if hasattr(type(env), name):
            # A property that raises its own error, which says why it is not available.
            raise
        raise AttributeError(_missing(env, name)) from None
    worlds: int = env.num_envs
    return (value,) * worlds


def set_in_worlds(env: Worlds, name: str, values: Any) -> None:
    """Set an attribute in all worlds, as `gymnasium.vector.SyncVectorEnv.set_attr` does.

    Args:
        env: Environment with W worlds.
        name: "_max_episode_steps", a property with a setter, or an attribute that a subclass has added.
        values: One value, or a list or tuple of W values, which must be equal because worlds share their attributes.

    Raises:
        AttributeError: If there is no such attribute, or setting it would have no effect.
        ValueError: If there are not W values, or they differ.
    """
    if isinstance(values, list | tuple):
        if len(values) != env.num_envs:
            raise ValueError(f"values must be {env.num_envs}, one for each world, got {len(values)}")
        if any(not _same(value, values[0]) for value in values[1:]):
            raise ValueError(f"values must be the same for all worlds, which share {name!r}; got {values!r}")
        values = values[0]
    declared = getattr(type(env), name, None)
    if isinstance(declared, property):
        if declared.fset is None:
            raise AttributeError(f"{name!r} of {type(env).__name__} can be read only: setting it has no effect")
    elif name in READ:
        raise AttributeError(f"{name!r} of {type(env).__name__} can be read only: setting it has no effect")
    elif not hasattr(env, name):
        raise AttributeError(_missing(env, name))
    elif name in env.constructed_names or callable(declared):
        raise AttributeError(
            f"{name!r} of {type(env).__name__} cannot be set: it is decided when the environment is made, and setting "
            "it later has no effect"
        )
    setattr(env, name, values)


def _same(one: Any, other: Any) -> bool:
    return one is other or bool(np.all(one == other))


def _missing(env: Worlds, name: str) -> str:
    """Error message for an attribute that a world does not have, with suggestions."""
    known = sorted({*READ, *(each for each in dir(env) if not each.startswith("_"))} - ABOUT_ALL)
    near = difflib.get_close_matches(name, known, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    whole = ", only the environment as a whole has" if name in ABOUT_ALL else ""
    return f"a world of {type(env).__name__} has no attribute {name!r}{whole}{hint}"
