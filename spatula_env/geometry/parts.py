"""The parts of an organ that nothing connects: each is a soft body of its own.

A surface may have several components, and so may what links connect: a ball beside a ball, or the wall of a cavity
inside an organ. Links follow edges, so components that meet in a vertex are one part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from spatula_env.geometry.surface import connected_components, edges, label_components, signed_volume

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray, IntArray


NAMED_PARTS = 8
"""Of how many parts a message tells the size."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an organ.

    Attributes:
        nodes: (n,) the organ's nodes in it, ascending.
        triangles: (t, 3) which of these nodes each of its triangles has, in the organ's order, int32.
        volume: What it encloses [u3]; negative for the wall of a cavity.
        sheets: How many components of the surface it has: more than one if they meet in a vertex.
    """

    nodes: IntArray
    triangles: NDArray[np.int32]
    volume: float
    sheets: int


class Surface(Protocol):
    """What an organ has, as far as it matters here."""

    @property
    def vertices(self) -> FloatArray:
        """(V, 3) of the nodes [u]."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) which nodes each has."""


def organ_parts(organ: Surface) -> tuple[Part, ...]:
    """The parts of an organ, by their first nodes.

    Args:
        organ: The organ.

    Returns:
        One part for most organs.
    """
    pairs = edges(organ.triangles)
    label = label_components(len(organ.vertices), pairs[:, 0], pairs[:, 1])
    sheet = connected_components(organ.triangles)
    parts = []
    for index in range(int(label.max()) + 1):
        nodes = np.flatnonzero(label == index)
        own = label[organ.triangles[:, 0]] == index
        triangles = np.searchsorted(nodes, organ.triangles[own]).astype(np.int32)
        parts.append(
            Part(nodes, triangles, signed_volume(organ.vertices[nodes], triangles), len(np.unique(sheet[own])))
        )
    return tuple(parts)


def describe_parts(parts: Sequence[Part]) -> str:
    """How large parts are, in words."""
    sizes = [
        f"{len(part.nodes)} nodes {'around' if part.volume < 0.0 else 'and'} "
        f"{'a cavity of ' if part.volume < 0.0 else ''}{abs(part.volume):.3g} u3"
        for part in parts[:NAMED_PARTS]
    ]
    more = [] if len(parts) <= NAMED_PARTS else [f"{len(parts) - NAMED_PARTS} more"]
    return ", ".join(sizes + more)
