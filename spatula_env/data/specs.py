"""Specifications of environments: storing them in a dataset, comparing them, and making the environments again."""

from __future__ import annotations

import copy
import inspect
import json
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec, WrapperSpec, load_env_creator

from spatula_env.data.checking import check_spec, read_json
from spatula_env.data.files import DatasetDamaged
from spatula_env.data.wrappers import allowed_wrapper, is_of_gymnasium
from spatula_env.definitions import present_options
from spatula_env.naming import bare_id, registered_id

UNSEEN = ("render_mode",)
"""Options of an environment that do not affect an episode."""
UNSEEN_WITHOUT_PICTURES = ("width", "height")
"""Options that do not affect an episode unless observations or a wrapper use the pictures from `render`."""
ONLOOKERS = ("HumanRendering", "RecordVideo")
"""Gymnasium's wrappers that only show or film an episode. They are not stored, as neither windows nor films are wanted
when the environment is made again."""
MAKERS = ("GymV21Environment-v0", "GymV26Environment-v0")
"""Gymnasium's environments that make another one, from Gym, whose id is one of their options."""
UNTOLD = "unspecified"


def storable_spec(env: gymnasium.Env[Any, Any]) -> EnvSpec:
    """The specification of an environment in the form in which a dataset stores it.

    The render mode is stored unless it is "human": wrappers may need pictures, but windows are not needed. The engine
    is stored by name, as the default may be another one elsewhere.

    Args:
        env: An environment from `gymnasium.make`, wrapped or not.

    Raises:
        ValueError: If it has none, or one that JSON cannot store; says which argument of which wrapper.
    """
    if env.spec is None:
        raise ValueError("env must have a spec: make it with gymnasium.make")
    found = env.spec
    wrappers = []
    for each in found.additional_wrappers:
        if _only_looks_on(each):
            continue
        if each.kwargs is None:
            raise ValueError(
                f"env cannot be recorded in the wrapper {each.name}, which does not tell its arguments, so that nobody "
                "could make the environment again: derive it from gymnasium.utils.RecordConstructorArgs too"
            )
        wrappers.append(WrapperSpec(each.name, each.entry_point, _plain(each.kwargs, f"the wrapper {each.name}")))
    # Shallow, because a deep copy would copy arguments that cannot be stored.
    kept = copy.copy(found)
    kwargs = {name: value for name, value in found.kwargs.items() if (name, value) != ("render_mode", "human")}
    made = getattr(env, "unwrapped", None)
    engine = getattr(getattr(made, "settings", None), "engine", None)
    if isinstance(engine, str):
        kwargs["engine"] = engine
    kept.kwargs = _plain(kwargs, found.id)
    kept.additional_wrappers = tuple(wrappers)
    for name in ("entry_point", "vector_entry_point"):
        point = getattr(kept, name)
        if point is not None and not isinstance(point, str):
            setattr(kept, name, f"{point.__module__}:{point.__qualname__}")
    return kept


def spec_from_json(text: Any) -> EnvSpec:
    """Parse a specification that a dataset stores; nothing is imported or made. The render mode "human" is dropped.

    Raises:
        DatasetDamaged: If it is not valid.
    """
    what = "the specification of the environment"
    if not isinstance(text, str):
        raise DatasetDamaged(f"{what} must be text, got {text!r}")
    told = check_spec(read_json(text, what), what)
    kwargs = told.get("kwargs", {})
    if kwargs.get("render_mode") == "human":
        kwargs = {name: value for name, value in kwargs.items() if name != "render_mode"}
    try:
        return EnvSpec.from_json(json.dumps({**told, "kwargs": kwargs}))
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise DatasetDamaged(f"{what} is none: {text[:200]!r}") from error


def differences(first: EnvSpec, second: EnvSpec, names: tuple[str, str] = ("here", "there")) -> list[str]:
    """Describe the differences of two specifications that affect an episode.

    Args:
        first: One of them.
        second: The other.
        names: Names for the two.

    Returns:
        A few words for each difference, as "control_frequency (10.0 here, 20.0 there)"; empty if there is none.
    """
    values = [_options(spec) for spec in (first, second)]
    found = []
    for name in sorted({*values[0], *values[1]}):
        pair = [each.get(name, UNTOLD) for each in values]
        # Older datasets do not name the engine.
        if pair[0] != pair[1] and not (name == "engine" and None in pair):
            told = ", ".join(f"{_told(value)} {where}" for value, where in zip(pair, names, strict=True))
            found.append(f"{name} ({told})")
    return found


def make_recorded(
    spec: EnvSpec,
    render_mode: str | None = None,
    env_id: str | None = None,
    wrappers: Sequence[type[gymnasium.Wrapper[Any, Any, Any, Any]]] = (),
    definition: int | None = None,
) -> gymnasium.Env[Any, Any]:
    """Make the environment of a dataset again.

    A dataset may come from an untrusted source, so no module is imported because it names one: the environment is the
    one that is registered here under its id. Wrappers get the arguments that the dataset gives, with which some would
    write files; so only those of Gymnasium and of this package that do not, and those that the caller names, are
    allowed.

    Args:
        spec: The specification from the dataset.
        render_mode: Render mode; None: the recorded one, if that was needed.
        env_id: The same environment as "module:id", if it is not registered yet.
        wrappers: Further wrappers that are allowed, whatever their arguments.
        definition: Number of the task's definition with which it was recorded; None: the present one.

    Raises:
        ImportError: If the module of `env_id` cannot be imported, or the engine is missing.
        ValueError: If there is no such environment here, a wrapper is not allowed, or the environment cannot be made
            with these options.
    """
    found = copy.copy(spec)
    found.id = bare_id(registered_id(spec.id, env_id))
    registered = gymnasium.registry[found.id]
    if found.id in MAKERS:
        raise ValueError(f"the dataset was recorded in {found.id}, which makes whatever environment it is told to")
    found.entry_point, found.vector_entry_point = registered.entry_point, registered.vector_entry_point
    if definition is not None:
        found.kwargs = present_options(found.id, definition, spec.kwargs)
    found.additional_wrappers = tuple(
        WrapperSpec(each.name, allowed_wrapper(each.entry_point, wrappers), each.kwargs)
        for each in spec.additional_wrappers
        if not _only_looks_on(each)
    )
    try:
        return gymnasium.make(found) if render_mode is None else gymnasium.make(found, render_mode=render_mode)
    except ImportError:
        raise
    # Exceptions that a wrapper or an environment may raise for arguments that make no sense.
    except (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = str(error).partition(" was raised from the environment creator")[0]
        raise ValueError(f"{found.id} cannot be made as the dataset says: {reason}") from error


def _only_looks_on(wrapper: WrapperSpec) -> bool:
    # Identified by the entry point, because the name may be anything.
    return wrapper.entry_point.partition(":")[2] in ONLOOKERS and is_of_gymnasium(wrapper.entry_point)


def _options(spec: EnvSpec) -> dict[str, Any]:
    """The options that affect an episode, by name, including defaults."""
    kwargs = {**_defaults(spec), **spec.kwargs}
    unseen = UNSEEN if spec.additional_wrappers else (*UNSEEN, *UNSEEN_WITHOUT_PICTURES)
    for name in unseen:
        kwargs.pop(name, None)
    told: dict[str, Any] = {
        "environment": spec.id,
        "max_episode_steps": spec.max_episode_steps,
        **_plain(kwargs, spec.id),
    }
    for number, each in enumerate(spec.additional_wrappers, start=1):
        told[f"wrapper {number}"] = f"{each.name}({json.dumps(each.kwargs, sort_keys=True)})"
    return told


def _defaults(spec: EnvSpec) -> dict[str, Any]:
    """Defaults of an environment's options, if it is registered here."""
    registered = gymnasium.registry.get(spec.id)
    if registered is None or registered.entry_point is None:
        return {}
    try:
        point = registered.entry_point
        maker = load_env_creator(point) if isinstance(point, str) else point
        parameters = inspect.signature(maker).parameters.values()
    except (ImportError, AttributeError, TypeError, ValueError):
        return {}
    told = {each.name: each.default for each in parameters if each.default is not inspect.Parameter.empty}
    return {name: value for name, value in told.items() if _is_plain(value)}


def _told(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _is_plain(value: Any) -> bool:
    try:
        _plain(value, "")
    except ValueError:
        return False
    return True


def _plain(value: Any, owner: str, name: str = "") -> Any:
    """Convert a value to what JSON would read back; NumPy's numbers and arrays become plain ones.

    Raises:
        ValueError: If JSON cannot store it.
    """
    if isinstance(value, Mapping):
        return {str(key): _plain(each, owner, f"{name}.{key}" if name else str(key)) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each, owner, f"{name}[{number}]") for number, each in enumerate(value)]
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist(), owner, name)
    if isinstance(value, PurePath):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ValueError(
        f"env cannot be recorded: the argument {name} of {owner} is {value!r}, which JSON cannot keep, so that nobody "
        "could make the environment again; use a wrapper of your own without such an argument, derived from "
        "gymnasium.utils.RecordConstructorArgs"
    )
