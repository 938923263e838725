"""Names of environments: short names, ids, and ids with the module that registers them.

A module is imported only if a person has named it, on a command line or in a configuration. An environment that a file
of a run or of a dataset names is only looked up among those that are registered already.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

import spatula_env

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

PACKAGE = spatula_env.__name__


def env_ids() -> list[str]:
    """Ids of the registered environments in the namespace of this package."""
    return sorted(key for key, spec in gymnasium.registry.items() if spec.namespace == "Spatula")


def find_environment(text: str) -> str:
    """Find the environment that a person has named.

    Args:
        text: An id in any case, such as "Spatula/Press-v0"; the task's name alone, "press"; the id of a registered
            environment of the user's own; or "module:id" with the module that registers it, which is imported, if need
            be from the working directory.

    Returns:
        The id, as gymnasium.make takes it; with its module if `text` has one.

    Raises:
        ImportError: If the module cannot be imported.
        ValueError: If there is no such environment, or it is not one of this package or built on it.
    """
    module, colon, name = text.rpartition(":")
    foreign = bool(colon) and module != PACKAGE
    if foreign:
        _import_module(module, text)
    found = _known(name)
    if found is None:
        where = f"{module} registers no {name!r}" if foreign else f"there is no environment {text!r}"
        raise ValueError(f"{where}; there are {', '.join(env_ids())}, and MODULE:ID for one of your own")
    check_built_on(found)
    return f"{module}:{found}" if foreign else found


def registered_id(stored: str, named: str | None = None) -> str:
    """Find the environment that a file of a run or of a dataset names. No module is imported because a file names it.

    Args:
        stored: The id in the file, with or without a module.
        named: The environment that the reader of the file has named, if any, in a form that `find_environment` takes.

    Returns:
        An id, as gymnasium.make takes it.

    Raises:
        ImportError: See `find_environment`.
        ValueError: If no such environment is registered, or another one is named.
    """
    if named is not None:
        found = find_environment(named)
        if not same_environment(found, stored):
            raise ValueError(f"the environment is {bare_id(stored)}, not {bare_id(found)}")
        return found
    bare = bare_id(stored)
    if bare not in gymnasium.registry:
        raise ValueError(
            f"{bare} is not registered, and no module is imported because a file names it; "
            f"name it yourself, as {stored if ':' in stored else f'MODULE:{stored}'}"
        )
    return bare


def bare_id(env_id: str) -> str:
    """An id without the module before its colon."""
    return env_id.rpartition(":")[2]


def same_environment(one: str, other: str) -> bool:
    """Whether two ids, with modules or without, mean the same environment."""
    return bare_id(one) == bare_id(other)


def task_name(env_id: str) -> str:
    """A short name in lower case, for files: "press" for "Spatula/Press-v0"."""
    return bare_id(env_id).rpartition("/")[2].rpartition("-v")[0].lower() or bare_id(env_id).lower()


def find_spec(env_id: str) -> EnvSpec:
    """The specification registered under an id whose module has been imported.

    Raises:
        gymnasium.error.Error: If nothing is registered under that id.
    """
    return gymnasium.spec(bare_id(env_id))


def vector_spec(env_id: str) -> EnvSpec:
    """The specification that gymnasium.make_vec takes, for an environment of this package or one built on it.

    Args:
        env_id: An id whose module has been imported.

    Returns:
        The registered spec; if it has no vector environment, a copy with a class that is made for the same definition.

    Raises:
        gymnasium.error.Error: If there is no such environment.
        ValueError: If it is not built on this package, or has no vector environment and does more than its definition
            says.
    """
    from spatula_env.envs.spatula_env import SpatulaEnv
    from spatula_env.envs.vector import SpatulaVectorEnv

    check_built_on(env_id)
    spec = find_spec(env_id)
    if spec.vector_entry_point is not None:
        maker = _load(spec.vector_entry_point, env_id)
        if isinstance(maker, type) and not issubclass(maker, SpatulaVectorEnv):
            raise ValueError(f"{env_id} must have a vector environment that is a SpatulaVectorEnv, got {maker}")
        return spec
    maker = None if spec.entry_point is None else _load(spec.entry_point, env_id)
    if not (isinstance(maker, type) and issubclass(maker, SpatulaEnv)):
        raise ValueError(f"{env_id} must be an environment of this package or built on it, a SpatulaEnv, got {maker}")
    # Attributes that Python itself adds to a class do not count, but an __init__ of its own does.
    own = [
        name
        for kind in maker.__mro__[: maker.__mro__.index(SpatulaEnv)]
        for name in vars(kind)
        if name == "__init__" or not (name.startswith("__") or name == "definition")
    ]
    if own:
        raise ValueError(
            f"{env_id} has no vector environment, and {maker.__name__} does more than its definition says "
            f"({', '.join(own)}): register a SpatulaVectorEnv that does the same as its vector_entry_point"
        )
    derived: Any = type(f"{maker.__name__}Worlds", (SpatulaVectorEnv,), {"definition": maker.definition})
    return _replaced(spec, derived)


def check_built_on(env_id: str) -> None:
    """Check that an environment is one of this package, or built on it.

    Args:
        env_id: A registered id.

    Raises:
        ImportError: If its entry point cannot be imported.
        ValueError: If it is neither.
    """
    spec = find_spec(env_id)
    if str(spec.entry_point).startswith(f"{PACKAGE}."):
        return
    from spatula_env.envs.spatula_env import SpatulaEnv

    maker = None if spec.entry_point is None else _load(spec.entry_point, env_id)
    # An entry point that is not a class, such as a function, may still create one; that shows when it is called.
    if maker is None or (isinstance(maker, type) and not issubclass(maker, SpatulaEnv)):
        raise ValueError(f"{env_id} must be an environment of this package or built on it, a SpatulaEnv, got {maker}")


def _known(name: str) -> str | None:
    if name in gymnasium.registry:
        return name
    names: dict[str, str] = {}
    for each in env_ids():
        short = each.partition("/")[2]
        names |= {each.lower(): each, short.lower(): each, short.rpartition("-v")[0].lower(): each}
    return names.get(name.lower())


def _import_module(module: str, text: str) -> None:
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        # An installed command does not search the working directory, as `python -m` does.
        here = os.getcwd()
        if error.name != module.partition(".")[0] or here in sys.path or "" in sys.path:
            # Raised without `name`: this is not a package of an extra that the user could be told to install.
            raise ImportError(f"{text!r} names a module that cannot be imported: {error}") from error
        sys.path.append(here)
        _import_module(module, text)
    except (TypeError, ValueError) as error:
        raise ValueError(f"an environment must be ID or MODULE:ID, got {text!r}") from error


def _load(entry_point: Any, env_id: str) -> Any:
    try:
        return load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    except (AttributeError, ModuleNotFoundError) as error:
        raise ImportError(f"{env_id} is registered with {entry_point!r}, which cannot be imported: {error}") from error


def _replaced(spec: EnvSpec, vector_entry_point: Any) -> EnvSpec:
    import copy

    changed = copy.deepcopy(spec)
    changed.vector_entry_point = vector_entry_point
    return changed
