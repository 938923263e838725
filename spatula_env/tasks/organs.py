"""Organs whose parts have names, for tasks that ask for something at one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from spatula_env.geometry import Organ

if TYPE_CHECKING:
    from spatula_env.tasks.situation import Setting

Named = TypeVar("Named", bound=Organ)


def organ_with_parts(setting: Setting, kind: type[Named], *parts: str) -> Named:
    """The organ of a setting, if it is of the kind that names the parts a task needs.

    Args:
        setting: Whose.
        kind: A kind of `Organ` with fields that hold the nodes of its parts.
        *parts: Names of those that the task needs.

    Returns:
        The organ.

    Raises:
        ValueError: If the organ is of another kind; says where it is told how to make one.
    """
    organ: Any = setting.organ
    if isinstance(organ, kind):
        return organ
    got = "no organ" if organ is None else f"the {type(organ).__name__} {organ.name!r}"
    raise ValueError(
        f"organ must be a {kind.__name__}, because the task needs the nodes of its {' and '.join(parts)}, which a "
        f"bare surface does not name; got {got}. docs/extending.md tells under 'What a task needs of an organ' how a "
        "surface of one's own becomes one"
    )
