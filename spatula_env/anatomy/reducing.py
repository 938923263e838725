"""From a mended surface to one of few, even triangles: several ways are tried, and what comes out decides.

Quadric decimation is that of fast-simplification; it keeps furrows, and leaves needles, which the remeshing takes away.
Where the surface still crosses itself, or was no manifold from the beginning, a wrap of voxels takes its place, which
closes furrows step by step.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.libraries import load
from spatula_env.anatomy.options import Step
from spatula_env.anatomy.remeshing import remesh
from spatula_env.anatomy.topology import Surface, angles, count_edges, is_manifold, orient, weld
from spatula_env.anatomy.voxels import wrap
from spatula_env.geometry.crossings import self_crossings
from spatula_env.geometry.surface import connected_components

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FINE = (3, 6, 12)
"""The decimation leaves this many times the wanted nodes to the remeshing: the first of these that gives a manifold
that does not cross itself, or else a manifold. Where furrows are narrow, that may need more nodes."""

GOOD_ANGLE = 15.0
"""A surface whose least angle is greater is taken at once; else the best of all is [deg]."""

CHANGED = 0.2
"""A surface whose volume has changed by no more than this part is taken before others."""

MOST_REMESHED = 40_000
"""Most nodes of a surface that is remeshed, or the least of `FINE` for each wanted node if that is more. One with more
holes through it than the wanted nodes can have, as of a thresholded image, has no decimation that is a manifold, and to
remesh it as it is would take many minutes."""

PITCHES = 4.0
"""Voxels of a wrap along an edge of the wanted length."""

CLOSINGS = (0.0, 0.5, 1.0)
"""Half widths of the furrows that a wrap closes, in edges of the wanted length."""


def reduced(
    surface: Surface, node_count: int, name: str, progress: Callable[[str], None]
) -> tuple[Surface, list[Step]]:
    """Give a surface a number of nodes and even triangles.

    Args:
        surface: The mended surface; edges may be in more than two triangles.
        node_count: Number of nodes.
        name: What to call the surface in errors.
        progress: Called with a line before each step.

    Returns:
        A closed surface that does not cross itself, and what each step gave.

    Raises:
        ValueError: If no way leads to one; the message has the numbers.
    """
    steps: list[Step] = []
    best: tuple[tuple[bool, float], Surface] | None = None
    volume = 1e6 * float(surface.volumes.sum()) if is_manifold(surface) else None
    for way, start in _starts(surface, node_count, steps, progress):
        progress(f"remeshing to {node_count} nodes ({way})")
        candidate = remesh(start, start if way != "decimated" else surface, node_count)
        step = measured(candidate, f"remeshed ({way})")
        steps.append(step)
        if not step.closed or step.crossings:
            continue
        alike = volume is None or abs(step.volume - volume) <= CHANGED * abs(volume)
        rank = alike, step.least_angle
        if best is None or rank > best[0]:
            best = rank, candidate
        if step.least_angle > GOOD_ANGLE:
            break
    if best is None:
        told = "; ".join(
            f"{step.name}: {'closed' if step.closed else 'open'}, {step.crossings} crossings" for step in steps
        )
        told = told or "no decimation of it is a manifold"
        raise ValueError(
            f"{name} cannot be made into a closed surface of {node_count} nodes ({told}); try more nodes, or fewer"
        )
    return best[1], steps


def measured(surface: Surface, name: str) -> Step:
    """Check a surface after a step."""
    corners = angles(surface.vertices, surface.triangles)
    return Step(
        name,
        len(surface.vertices),
        bool((count_edges(surface.triangles)[1] == 2).all()),
        len(self_crossings(surface.vertices, surface.triangles)),
        round(float(corners.min()), 2),
        round(float(np.percentile(corners, 5)), 2),
        round(1e6 * float(surface.volumes.sum()), 4),
    )


def _starts(
    surface: Surface, node_count: int, steps: list[Step], progress: Callable[[str], None]
) -> Iterator[tuple[str, Surface]]:
    """Surfaces with which a remeshing can begin, closed manifolds all with few nodes, and how they were made."""
    most = max(MOST_REMESHED, FINE[0] * node_count)
    if is_manifold(surface):
        progress(f"decimating {len(surface.triangles)} triangles")
        start = _decimated_manifold(surface, node_count)
        if len(start.vertices) <= most:
            steps.append(measured(start, "decimated"))
            yield "decimated", start
    length = math.sqrt(2.0 * surface.area / (math.sqrt(3.0) * node_count))
    # As many voxels as marching cubes of a volume would have, at most.
    pitch = max(length / PITCHES, float(np.ptp(surface.vertices, axis=0).max()) / 160.0)
    for closing in CLOSINGS:
        way = "wrapped" + (f", furrows of {2e3 * closing * length:.3g} mm closed" if closing else "")
        progress(f"wrapping in voxels of {1e3 * pitch:.3g} mm")
        try:
            wrapped = wrap(surface, pitch, closing * length)
        except ValueError:
            if closing == CLOSINGS[-1] and not steps:
                raise
            continue
        wrapped = orient(_largest(weld(wrapped)[0]))[0]
        if is_manifold(wrapped):
            start = _decimated_manifold(wrapped, node_count)
            if len(start.vertices) <= most:
                yield way, start


def _decimated_manifold(surface: Surface, node_count: int) -> Surface:
    """A closed manifold with `FINE` times a number of nodes, see there; the surface as it is if there is none."""
    crossing = None
    for times in FINE:
        if len(surface.vertices) <= times * node_count:
            break
        decimated = _without_flaps(_decimated(surface, times * node_count))
        if not is_manifold(decimated):
            continue
        if not len(self_crossings(decimated.vertices, decimated.triangles)):
            return decimated
        crossing = decimated if crossing is None else crossing
    return surface if crossing is None else crossing


def _without_flaps(surface: Surface) -> Surface:
    """Remove pairs of triangles with the same three vertices, which lie on each other and enclose nothing.

    The decimation leaves some, as it does not check whether a collapse folds the surface, most of all on the flat steps
    of voxels. Each of their edges stays in an even number of triangles.
    """
    _, kind, uses = np.unique(np.sort(surface.triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    return surface.kept(uses[kind.reshape(-1)] != 2)


def _decimated(surface: Surface, node_count: int) -> Surface:
    simplify = load("fast_simplification").simplify
    # In units of the diagonal: the library has absolute tolerances.
    scale, middle = surface.diagonal, surface.vertices.mean(axis=0)
    points, faces = simplify(
        ((surface.vertices - middle) / scale).astype(np.float64),
        surface.triangles.astype(np.int32),
        target_count=2 * node_count,
    )
    return Surface(np.asarray(points, dtype=np.float64) * scale + middle, np.asarray(faces, dtype=np.int64)).kept(
        np.ones(len(faces), dtype=np.bool_)
    )


def _largest(surface: Surface) -> Surface:
    component = connected_components(surface.triangles)
    volumes = np.abs(np.bincount(component, weights=surface.volumes))
    return surface.kept(component == int(np.argmax(volumes)))
