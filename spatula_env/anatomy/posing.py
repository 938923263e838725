"""Where a prepared organ stands, and what holds it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.options import in_half_spaces

if TYPE_CHECKING:
    from spatula_env.anatomy.options import PrepareOptions
    from spatula_env.arrays import FloatArray


def posed(vertices: FloatArray, up: str, place: str) -> FloatArray:
    """Turn an organ and move it.

    Args:
        vertices: (V, 3) positions in the file's frame [m].
        up: The file's axis that will point up.
        place: See `PrepareOptions`.

    Returns:
        (V, 3) positions [m]; the organ is never mirrored.
    """
    axis, sign = "xyz".index(up[-1]), -1.0 if up.startswith("-") else 1.0
    rows = np.zeros((3, 3))
    rows[2, axis] = sign
    # The next axis stays as it is, and the one after it follows for a rotation.
    rows[0, (axis + 1) % 3] = 1.0
    rows[1, (axis + 2) % 3] = sign
    turned: FloatArray = vertices @ rows.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    if place == "keep":
        return turned
    origin: FloatArray = 0.5 * (low + high)
    if place == "ground":
        origin[2] = low[2]
    moved: FloatArray = turned - origin
    return moved


def held_nodes(vertices: FloatArray, options: PrepareOptions) -> tuple[int, ...]:
    """The nodes that are held.

    Args:
        vertices: (V, 3) positions, as posed [m].
        options: Half spaces, boxes and indices.

    Raises:
        ValueError: If an option names no node.
    """
    held = np.zeros(len(vertices), dtype=np.bool_)
    span = " to ".join(str([round(value, 4) for value in corner.tolist()]) for corner in _bounds(vertices))
    for text in options.hold:
        chosen = in_half_spaces(vertices, text)
        if not chosen.any():
            raise ValueError(f"hold must name nodes, {text!r} has none: the organ spans {span} m")
        held |= chosen
    for box in options.hold_boxes:
        chosen = np.all((vertices >= box[:3]) & (vertices <= box[3:]), axis=1)
        if not chosen.any():
            raise ValueError(f"hold_boxes must have nodes in them, {list(box)} has none: the organ spans {span} m")
        held |= chosen
    for node in options.hold_nodes:
        if not 0 <= node < len(vertices):
            raise ValueError(f"hold_nodes must be nodes in 0..{len(vertices) - 1}, got {node}")
        held[node] = True
    if held.all():
        raise ValueError(f"all {len(vertices)} nodes are held: nothing could move; the organ spans {span} m")
    return tuple(np.flatnonzero(held).tolist())


def _bounds(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    return vertices.min(axis=0), vertices.max(axis=0)
