"""Checks of a scene: errors, warnings about what is probably not intended, and likely causes of failures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env._warnings import warn
from spatula_env.geometry.crossings import self_crossings
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.parts import describe_parts, organ_parts
from spatula_env.geometry.transforms import rotate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from spatula_env.geometry.meshes import Organ
    from spatula_env.scenes import PlacedOrgan, PlacedTool, Scene

    BoolArray = NDArray[np.bool_]
    FloatArray = NDArray[np.float64]

LARGEST_ORGAN = 1.0
"""An organ larger than this, ten times the cube that the Falcon reaches, is probably given in another unit [m]."""

LEAST_VOLUME = 0.95
"""An organ that at rest has a smaller share of its volume than this does not bear its own weight."""

GREATEST_DEFORMATION = 0.05
"""An organ whose nodes at rest are displaced in it by more than this share of its extent, as a root mean square, does
not bear its own weight either."""


BURIED = 0.01
"""An organ is below the ground if a free node is deeper in the ground than this share of the organ's extent."""

GREATEST_CREEP = 0.01
"""Greatest speed of nodes when settling was ended, in extents of the organ per second: slower, it sways in its place
for a while, which is not worth a warning."""

LONGEST_PASSAGE = 0.5
"""Longest way of a shear wave in a step, by the mean edge of a surface. Contact is resolved once in a step: at 0.25 the
force on the seed's plate, held 10 mm deep, varies by less than 1 %, at 0.38 by 3 %, and at 0.5 by 6 to 20 %."""


def check_surfaces(scene: Scene) -> None:
    """Check that no organ's surface crosses itself. Crossings between organs are not checked.

    Args:
        scene: The scene.

    Raises:
        ValueError: If a surface crosses itself; names the organ, and the vertices of the first crossing.
    """
    for placed in scene.organs:
        organ = placed.organ
        crossings = self_crossings(organ.vertices, organ.triangles)
        if len(crossings):
            first = crossings[0].tolist()
            raise ValueError(
                f"organs: the surface of organ {organ.name!r} must not cross or touch itself, got edges that go "
                f"through triangles in {len(crossings)} places, first the edge between vertices {first[0]} and "
                f"{first[1]} through the triangle of vertices {first[2]}, {first[3]} and {first[4]}"
            )


def organs_below_ground(scene: Scene) -> str:
    """Describe in words which organs of a scene have free nodes in the ground; empty if none has."""
    if scene.ground is None:
        return ""
    height, told = scene.ground.height, []
    for placed in scene.organs:
        free = np.ones(len(placed.organ.vertices), dtype=np.bool_)
        free[list(placed.fixed_nodes)] = False
        vertices = placed.vertices
        heights = vertices[free, 2]
        buried = heights < height - BURIED * np.ptp(vertices, axis=0).max()
        if buried.any():
            told.append(
                f"organ {placed.organ.name!r} starts with {buried.sum()} of {len(buried)} free nodes below the ground, "
                f"which is at {height:g} u, down to {heights.min():.4g} u: place it higher, or lower the ground"
            )
    return "; ".join(told)


def tools_in_organs(
    organs: Sequence[PlacedOrgan],
    nodes: FloatArray,
    tools: Sequence[PlacedTool],
    positions: FloatArray,
    orientations: FloatArray,
) -> str:
    """Describe in words which tools reach into which organs; empty if none does.

    Args:
        organs: The organs.
        nodes: (V, 3) of all organs [u].
        tools: (N,) the tools' shapes.
        positions: (N, 3) of the tools [u]; a tool whose position is not finite is skipped.
        orientations: (N, 4) of the tools.
    """
    told, start = [], 0
    for placed in organs:
        own = nodes[start : start + len(placed.organ.vertices)]
        start += len(own)
        for index, tool in enumerate(tools):
            if not np.isfinite(positions[index]).all():
                continue
            corners = rotate(orientations[index], tool.tool.vertices) + positions[index]
            if overlaps(own, placed.organ.triangles, corners, tool.tool.triangles):
                told.append(
                    f"tool {index} was in organ {placed.organ.name!r} at the start, at {positions[index].tolist()} u: "
                    "place it outside"
                )
    return "; ".join(told)


def warn_of_scene(scene: Scene, sweeps: int | None = None) -> None:
    """Warn about problems of a scene that can be seen before anything moves.

    Args:
        scene: The scene.
        sweeps: Number of sweeps in a step of the engine; see `engine.Abilities`.

    Warns:
        SceneWarning: About parts of an organ that nothing holds, organs that are far too large or smaller than every
            tool, and surfaces that are too fine for the springs.
    """
    for placed in scene.organs:
        for told in _doubts(scene, placed, sweeps):
            warn(f"organ {placed.organ.name!r} {told}")


def _doubts(scene: Scene, placed: PlacedOrgan, sweeps: int | None) -> Iterator[str]:
    organ, length = placed.organ, scene.scale.length
    parts = organ_parts(organ)
    held = set(placed.fixed_nodes)
    loose = [part for part in parts if held.isdisjoint(part.nodes.tolist())]
    if len(parts) > 1 and loose:
        yield (
            f"consists of {len(parts)} parts that nothing connects ({describe_parts(parts)}); "
            f"{len(loose)} of them {'is' if len(loose) == 1 else 'are'} held by no fixed node and will fall, through "
            "each other as well: join them in the surface, fix nodes of each, or make them organs of their own"
        )
    extent = float(np.ptp(organ.vertices, axis=0).max())
    tool = min(float(np.ptp(placed_tool.tool.vertices, axis=0).max()) for placed_tool in scene.tools)
    if extent * length > LARGEST_ORGAN:
        yield (
            f"is {extent * length:.3g} m across ({extent:.3g} u of {length:g} m), far larger than the workspace of a "
            "hand: is it in another unit?"
        )
    if extent < tool:
        yield (
            f"is {extent * length * 1e3:.3g} mm across ({extent:.3g} u of {length:g} m), smaller than any tool, "
            f"of {tool * length * 1e3:.3g} mm: is it in another unit?"
        )
    edges = organ.edge_lengths
    across = extent / float(np.median(edges))
    if sweeps is not None and across > sweeps:
        yield (
            f"has a surface too fine for springs: it is {across:.0f} edges of {np.median(edges):.3g} u across, and the "
            f"{sweeps} sweeps of a step carry a pull over {sweeps} of them, so it is far softer than the scene's scale "
            f"says; edges of at least {extent / sweeps:.2g} u are borne"
        )


def wave_passage(organ: Organ, wave_speed: float, dt: float) -> float:
    """How far a shear wave gets in a step, by the mean edge of an organ's surface.

    Args:
        organ: The organ.
        wave_speed: Speed of a shear wave in it [u/s].
        dt: Length of a step [s].
    """
    return dt * wave_speed / float(organ.edge_lengths.mean())


def warn_of_long_steps(organ: Organ, wave_speed: float, dt: float) -> None:
    """Warn if physics steps are too long for contact with an organ of a material; see `LONGEST_PASSAGE`.

    Args:
        organ: The organ.
        wave_speed: Speed of a shear wave in it [u/s].
        dt: Length of a step [s].

    Warns:
        SceneWarning: If so.
    """
    passage = wave_passage(organ, wave_speed, dt)
    if passage > LONGEST_PASSAGE:
        warn(
            f"organ {organ.name!r} is so stiff, and its surface so fine, that forces of contact will shake with steps "
            f"of {dt:.5f} s: a shear wave gets {passage:.2f} edges far in one. Take dt of "
            f"{dt * LONGEST_PASSAGE / passage:.5f} s or less, a softer material or a coarser surface"
        )


def warn_of_rest(
    scene: Scene, nodes: FloatArray, volumes: FloatArray, initial: FloatArray, speeds: FloatArray | None
) -> None:
    """Warn about organs that have lost their shape in settling, or have not come to rest.

    Args:
        scene: The scene.
        nodes: (V, 3) of all organs, settled [u].
        volumes: (O,) of the O organs, settled [u3].
        initial: (O,) volumes before settling [u3].
        speeds: (V,) of the nodes when settling was ended [u/s]; None if they had come to rest.

    Warns:
        SceneWarning: About each such organ.
    """
    start = 0
    for placed, volume, before in zip(scene.organs, volumes.tolist(), initial.tolist(), strict=True):
        shape = placed.vertices
        own = slice(start, start + len(shape))
        start = own.stop
        share, deformation = volume / before, deformation_of(shape, nodes[own])
        extent = float(np.ptp(shape, axis=0).max())
        sag = float(shape[:, 2].max() - nodes[own, 2].max())
        told = (
            f"(its top has sunk by {sag:.2g} of {np.ptp(shape[:, 2]):.3g} u, it has {100.0 * share:.3g} % of its "
            f"volume, and its nodes are {deformation:.2g} u from their places in it)"
        )
        if speeds is not None and speeds[own].max() > _greatest_creep(placed):
            warn(
                f"organ {placed.organ.name!r} has not come to rest: it still moved at {speeds[own].max():.2g} u/s when "
                f"settling was ended {told}. It rolls or sags on; hold some of its nodes, put it on more of them, or "
                "use a coarser surface"
            )
        elif share < LEAST_VOLUME or deformation > GREATEST_DEFORMATION * extent:
            warn(
                f"organ {placed.organ.name!r} does not keep its shape under its own weight {told}. With less "
                "gravity, a smaller dt or a coarser surface it bears more of it"
            )


def _greatest_creep(placed: PlacedOrgan) -> float:
    """Greatest speed of an organ's nodes that is no motion worth a warning [u/s]."""
    return GREATEST_CREEP * float(np.ptp(placed.vertices, axis=0).max())


def is_creeping(scene: Scene, speeds: FloatArray) -> BoolArray:
    """(n,) whether any organ of worlds moves faster than `GREATEST_CREEP`, given speeds (n, V) of its nodes [u/s]."""
    creeping, start = np.zeros(len(speeds), dtype=np.bool_), 0
    for placed in scene.organs:
        own = slice(start, start + len(placed.vertices))
        start = own.stop
        creeping |= speeds[:, own].max(axis=1) > _greatest_creep(placed)
    return creeping


def deformation_of(before: FloatArray, after: FloatArray) -> float:
    """How much a body has changed its shape, regardless of how it has moved or rolled.

    The rigid motion that fits best is undone first (W. Kabsch, Acta Crystallographica A 32, 1976).

    Args:
        before: (V, 3) its nodes [u].
        after: (V, 3) the same nodes later [u].

    Returns:
        Root mean square of the distances that remain [u].
    """
    a, b = before - before.mean(axis=0), after - after.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return float(np.sqrt(((a @ turn - b) ** 2).sum(axis=1).mean()))
