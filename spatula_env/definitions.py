"""Version numbers of task definitions.

A definition is what is asked, rewarded and counted in a task. Its number is stored with every policy that is trained,
every dataset that is recorded and every result that is measured, so that a later change is noticed. Anything stored
without a number is of the first definition.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

from spatula_env.naming import bare_id

FIRST = 1
"""Number of the definition of anything that is stored without a number."""


class DefinitionWarning(UserWarning):
    """A policy, dataset or result was made with another definition of its task than the present one."""


def definition_number(env_id: str) -> int:
    """The number of the present definition of an environment's task; `FIRST` if it is not known here."""
    return int(getattr(getattr(_definition(env_id), "task", None), "definition", FIRST))


def present_options(env_id: str, number: int, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Translate an environment's options from a former definition to the present one.

    Args:
        env_id: Id of the environment.
        number: Number of the definition under which the options were chosen.
        kwargs: The options as they were then.

    Returns:
        The options as they are now: a value whose meaning has changed is replaced by the one that now means the same.
    """
    options = dict(kwargs)
    former: Mapping[int, Any] = getattr(_definition(env_id), "former_options", {})
    for later in sorted(each for each in former if each >= number):
        for name, (was, values) in former[later].items():
            value = options.get(name, was)
            if value in values:
                options[name] = values[value]
    return options


def level_options(env_id: str, level: Any) -> Mapping[str, Any]:
    """Options that a level of difficulty implies for an environment, by name; none if the environment is not known."""
    levels: Mapping[Any, Any] = getattr(_definition(env_id), "levels", {})
    return levels[level].options if level in levels else {}


def tell_definition(what: str, env_id: str, number: int, stacklevel: int = 2) -> None:
    """Warn if something is of another definition of its task than the present one.

    Args:
        what: What it is, as the subject of the warning's sentence.
        env_id: Id of its environment.
        number: Number of its definition.
        stacklevel: As for `warnings.warn`, counted from the caller of this function.
    """
    present = definition_number(env_id)
    if number != present:
        warnings.warn(
            f"{what} is of definition {number} of {bare_id(env_id)}, which has definition {present} now: what is "
            "asked, rewarded and counted differs, and so do figures (docs/definitions.md)",
            DefinitionWarning,
            stacklevel=stacklevel + 1,
        )


def _definition(env_id: str) -> Any:
    """The definition of a registered environment; None if it is not registered, cannot be imported or has none."""
    spec = gymnasium.registry.get(bare_id(env_id))
    if spec is None or spec.entry_point is None:
        return None
    try:
        maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    except (ImportError, AttributeError):
        return None
    return getattr(maker, "definition", None)
