"""Last resort where contact cannot be resolved: the organ keeps its place relative to the tool.

Where an organ is pinned, folded over a blade and stretched at once, the constraints of a query may contradict each
other, and the result of a solve is arbitrary. At the last query, however, the organ was outside of the tool and did not
cross itself. So the part of the organ near the tool moves with it, as if it belonged to the tool, until it is free
again. These are the rigid impact zones of Provot (Graphics Interface 1997), with the tool included.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import inline_kernel
from spatula_env.contact.depth import pair_depth
from spatula_env.contact.features import find_candidates
from spatula_env.contact.flags import fill_local
from spatula_env.contact.structures import NO_PAIR


@inline_kernel
def depth_of_tools(
    world: Any,
    tool_count: int,
    looked_at: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    vertices: np.ndarray,
    known: float,
    is_placed: bool,
) -> float:
    """Measure how deep tools and organs are in each other [u]; see `depth.pair_depth`.

    Args:
        world: `WorldContacts`; its memories' `local` is written.
        tool_count: Number of tools N.
        looked_at: (N O,) which pairs of a tool (outer) and an organ (inner) are measured.
        position: (N, 3) of the tools [u].
        rotation: (N, 9) their rotation matrices, row by row.
        vertices: (V, 3) of the organs [u].
        known: Depth to return if none is greater [u].
        is_placed: Whether the memories' `local` and `Scratch.listed` hold these vertices already.
    """
    depth, organ_count, scratch = known, len(world.surfaces), world.room.scratch
    if not is_placed:
        scratch.listed[0] = NO_PAIR
    for k in range(tool_count):
        for o in range(organ_count):
            pair = k * organ_count + o
            if looked_at[pair]:
                local = world.memories[pair].organ.local
                if not is_placed:
                    fill_local(position[k], rotation[k], vertices, world.first_vertices[o], local)
                depth = pair_depth(world.tools[k].geometry, local, world.surfaces[o], pair, depth, scratch)
    return depth


@inline_kernel
def arrest(
    world: Any,
    tool_count: int,
    looked_at: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    reference: np.ndarray,
    whole: bool,
    vertices: np.ndarray,
) -> None:
    """Put the vertices near the tools where they were at the last query, relative to the tools.

    Args:
        world: `WorldContacts`; its memories hold the organs in the tools' frames at the last query.
        tool_count: Number of tools N.
        looked_at: (N O,) which pairs of a tool (outer) and an organ (inner) are treated.
        position: (N, 3) of the tools [u].
        rotation: (N, 9) their rotation matrices, row by row.
        reference: (V, 3) positions of the vertices at the last query [u].
        whole: Whether the other vertices are put back to these positions.
        vertices: (V, 3) present positions of the vertices; changed [u].
    """
    organ_count, inverse_mass = len(world.surfaces), world.inverse_mass
    near = np.zeros(vertices.shape[0], np.bool_)
    if whole:
        for i in range(vertices.shape[0]):
            for axis in range(3):
                vertices[i, axis] = reference[i, axis]
    for k in range(tool_count):
        for o in range(organ_count):
            if not looked_at[k * organ_count + o]:
                continue
            organ, first = world.memories[k * organ_count + o].organ, world.first_vertices[o]
            triangles, last = world.surfaces[o], organ.last_local
            fill_local(position[k], rotation[k], vertices, first, organ.local)
            near[:] = False
            for m in range(find_candidates(world.tools[k].geometry.extent, organ, triangles)):
                for corner in range(3):
                    near[first + triangles[organ.candidates[m], corner]] = True
            for i in range(last.shape[1]):
                if near[first + i] and inverse_mass[first + i] > 0.0:
                    for axis in range(3):
                        vertices[first + i, axis] = (
                            position[k, axis]
                            + rotation[k, 3 * axis] * last[0, i]
                            + rotation[k, 3 * axis + 1] * last[1, i]
                            + rotation[k, 3 * axis + 2] * last[2, i]
                        )
