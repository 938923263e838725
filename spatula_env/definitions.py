"""Numbers of tasks' definitions: what was asked, rewarded and counted when a policy was trained or a dataset recorded.

A number is written with what is trained, recorded or measured. What has none is of the first definition.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

from spatula_env.naming import bare_id

FIRST = 1
"""The definition of what has no number."""


class DefinitionWarning(UserWarning):
    """Something is of another definition of its task than the present one."""


def definition_number(env_id: str) -> int:
    """The number of the present definition of an environment's task; the first where it is not known here."""
    return int(getattr(getattr(_definition(env_id), "task", None), "definition", FIRST))


def present_options(env_id: str, number: int, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """An environment's options in which what was done with a former definition can be done again.

    Args:
        env_id: Of the environment.
        number: Of the definition.
        kwargs: The options, as they were called then.

    Returns:
        As they are called now: an option whose value means something else by now has the value that means the same.
    """
    options = dict(kwargs)
    former: Mapping[int, Any] = getattr(_definition(env_id), "former_options", {})
    for later in sorted(each for each in former if each >= number):
        for name, (was, values) in former[later].items():
            value = options.get(name, was)
            if value in values:
                options[name] = values[value]
    return options


def tell_definition(what: str, env_id: str, number: int, stacklevel: int = 2) -> None:
    """Warn if something is of another definition of its task than the present one.

    Args:
        what: It is, for the warning.
        env_id: Of its environment.
        number: Of its definition.
        stacklevel: Of whom the warning is told, as `warnings.warn` has it.
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
    """That of a registered environment; None if there is none, or nobody has imported what makes it."""
    spec = gymnasium.registry.get(bare_id(env_id))
    if spec is None or spec.entry_point is None:
        return None
    try:
        maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    except (ImportError, AttributeError):
        return None
    return getattr(maker, "definition", None)
