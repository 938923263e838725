"""Organs with named parts, for tasks whose goals refer to one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from spatula_env.geometry import Organ

if TYPE_CHECKING:
    from spatula_env.tasks.situation import Setting

Named = TypeVar("Named", bound=Organ)


def organ_with_parts(setting: Setting, kind: type[Named], *parts: str) -> Named:
    """Return the organ of a setting, checking that it has the named parts that a task needs.

    Args:
        setting: The setting.
        kind: Kind of `Organ` whose fields hold the nodes of its parts.
        *parts: Names of the parts that the task needs.

    Returns:
        The organ.

    Raises:
        ValueError: If the organ is of another kind; the message says where to find out how to make one.
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
