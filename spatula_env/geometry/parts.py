"""The unconnected parts of an organ: each is a soft body of its own.

A surface may have several components, such as two balls side by side, or an organ and the wall of a cavity inside it.
Links follow the edges, so components that meet in a vertex are connected and form one part.
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
"""Most parts whose sizes a message gives."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an organ.

    Attributes:
        nodes: (n,) indices of its nodes among the organ's, ascending.
        triangles: (t, 3) its triangles as indices into `nodes`, in the organ's order, int32.
        volume: Volume that it encloses [u3]; negative for the wall of a cavity.
        sheets: Number of components of the surface in it: more than one if they meet in a vertex.
    """

    nodes: IntArray
    triangles: NDArray[np.int32]
    volume: float
    sheets: int


class Surface(Protocol):
    """The attributes of an organ that are needed here."""

    @property
    def vertices(self) -> FloatArray:
        """(V, 3) positions of the nodes [u]."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) node indices of the triangles."""


def organ_parts(organ: Surface) -> tuple[Part, ...]:
    """Divide an organ into its unconnected parts.

    Args:
        organ: The organ.

    Returns:
        The parts, in the order of their first nodes; most organs have just one.
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
    """The sizes of parts in words, for a message."""
    sizes = [
        f"{len(part.nodes)} nodes {'around' if part.volume < 0.0 else 'and'} "
        f"{'a cavity of ' if part.volume < 0.0 else ''}{abs(part.volume):.3g} u3"
        for part in parts[:NAMED_PARTS]
    ]
    more = [] if len(parts) <= NAMED_PARTS else [f"{len(parts) - NAMED_PARTS} more"]
    return ", ".join(sizes + more)
