"""The contact nodes of a tool, arranged as columns of parallel rays.

A contact node casts its rays along its face's normal, inwards and outwards, so both lie on one line. Opposite nodes
on parallel faces share that line. All lines with one direction form a *group*; in the group's frame (u, v, w), with w
along the direction, a line is a point (u, v), and asking which triangles it meets is a point-in-triangle test in the
plane. Points are sorted into rows of equal u, and by v within a row, so that the points under a triangle are found by
two range searches.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry.tools import Tool

PARALLEL_TOLERANCE = 1e-9
"""Directions whose cross product is shorter than this count as parallel."""

SAME_LINE_TOLERANCE = 1e-9
"""Lines of one direction closer than this times the tool's size count as one line."""


class RayColumns:
    """The lines on which a tool's contact nodes cast their rays, sorted for the search in `raycast`.

    Attributes:
        frames: (G, 3, 3) rows u, v, w of each group's right-handed frame, in the tool's frame.
        bounds: (G, 4) least u, greatest u, least v, greatest v of the group's lines [u].
        group_rows: (G + 1,) first row of each group, and the number of rows.
        row_u: (R,) the rows' u, ascending within a group [u].
        row_columns: (R + 1,) first column of each row, and the number of columns.
        column_v: (C,) the columns' v, ascending within a row [u].
        column_nodes: (C, 2) the node whose outward normal is +w, and the one with -w; -1 where there is none.
        node_height: (n,) each node's w in its group's frame [u].
    """

    def __init__(self, tool: Tool) -> None:
        """Sort the nodes of `tool`."""
        directions = _distinct_directions(tool.face_normals)
        frames, bounds, group_rows = [], [], [0]
        row_u: list[float] = []
        row_columns: list[int] = [0]
        column_v: list[float] = []
        column_nodes: list[tuple[int, int]] = []
        node_height = np.zeros(len(tool.nodes))
        tolerance = SAME_LINE_TOLERANCE * float(np.max(tool.size))
        node_directions = tool.face_normals[tool.face]
        for direction in directions:
            frame = frame_along(direction)
            members = np.flatnonzero(np.linalg.norm(np.cross(node_directions, direction), axis=1) < PARALLEL_TOLERANCE)
            local = tool.nodes[members] @ frame.T
            node_height[members] = local[:, 2]
            u, v = _merge(local[:, 0], tolerance), _merge(local[:, 1], tolerance)
            is_plus = node_directions[members] @ direction > 0
            for u_value in np.unique(u):
                in_row = u == u_value
                for v_value in np.unique(v[in_row]):
                    here = in_row & (v == v_value)
                    plus, minus = members[here & is_plus], members[here & ~is_plus]
                    # More than two nodes share a line where faces of one direction lie behind one another.
                    for k in range(max(len(plus), len(minus))):
                        pair = (
                            int(plus[k]) if k < len(plus) else -1,
                            int(minus[k]) if k < len(minus) else -1,
                        )
                        column_v.append(float(v_value))
                        column_nodes.append(pair)
                row_u.append(float(u_value))
                row_columns.append(len(column_v))
            frames.append(frame)
            bounds.append([u.min(), u.max(), v.min(), v.max()])
            group_rows.append(len(row_u))
        self.frames: NDArray[np.float64] = np.ascontiguousarray(frames, dtype=np.float64)
        self.bounds: NDArray[np.float64] = np.ascontiguousarray(bounds, dtype=np.float64)
        self.group_rows: NDArray[np.int32] = np.array(group_rows, dtype=np.int32)
        self.row_u: NDArray[np.float64] = np.array(row_u)
        self.row_columns: NDArray[np.int32] = np.array(row_columns, dtype=np.int32)
        self.column_v: NDArray[np.float64] = np.array(column_v)
        self.column_nodes: NDArray[np.int32] = np.array(column_nodes, dtype=np.int32)
        self.node_height: NDArray[np.float64] = node_height


def _distinct_directions(face_normals: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The face normals' directions, opposite ones counted once, in order of first appearance."""
    directions: list[NDArray[np.float64]] = []
    for normal in face_normals:
        if all(np.linalg.norm(np.cross(normal, known)) >= PARALLEL_TOLERANCE for known in directions):
            # The sign is chosen so that the frames of a box are along its axes, without rounding.
            largest = int(np.argmax(np.abs(normal)))
            directions.append(normal if normal[largest] > 0 else -normal)
    return directions


def frame_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """A right-handed frame with rows u, v, w and w = direction; exact for the coordinate axes."""
    least = int(np.argmin(np.abs(direction)))
    helper = np.zeros(3)
    helper[least] = 1.0
    v = np.cross(direction, helper)
    v /= np.linalg.norm(v)
    u = np.cross(v, direction)
    return np.stack([u, v, direction]) + 0.0


def _merge(values: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Give values that differ by no more than `tolerance` from their neighbour the same, exact value."""
    order = np.argsort(values, kind="stable")
    merged = values.copy()
    start = values[order[0]]
    previous = start
    for index in order:
        if values[index] - previous > tolerance:
            start = values[index]
        previous = values[index]
        merged[index] = start
    return merged
