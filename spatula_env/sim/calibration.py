"""Calibration of a scene's scale by indentation, so that its tool feels an organ as stiff as a given material.

The organs are networks of springs, whose stiffness depends on how their surface is meshed. So the stiffness is
measured, with the scene's own tool on the scene's own organ, and the scale is chosen accordingly. docs/calibration.md
describes how the presets' constants were measured in the same way.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from spatula_env._warnings import warn
from spatula_env.contact.raycast import cast_ray
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.transforms import rotate
from spatula_env.scenes import TISSUE_MODULUS, Scale, Scene
from spatula_env.sim.batch import BatchSimulation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.scenes import PlacedTool

    FloatArray = NDArray[np.float64]

FLAT_PUNCH = 1.012
"""A square plate on a half-space is this much stiffer than a round one of the same area (R. B. King, International
Journal of Solids and Structures 23(12), 1987)."""

POISSON = 0.5
"""Poisson's ratio: tissue is nearly incompressible."""

DEPTHS = (0.2, 0.3, 0.4, 0.5)
"""Depths below first contact at which the force is measured, in widths of the tool's face: 4 to 10 mm with a spatula of
20 mm. In an organ that is thinner than the face is wide, they are parts of its thickness instead."""

THINNEST = 0.1
"""Least thickness of an organ under the tool, in widths of its face."""

PLACES = ((0.0, 0.0), (0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
"""Offsets in x and y from the requested place, in widths of the tool's face. The force is averaged over them, because
facets of a coarse surface snap through."""

SPEED = 0.5
"""Speed of the tool, in widths of its face per second."""

REST = 0.5
"""Time for which the tool waits at a depth, and then the time over which the force is averaged [s]."""

BENT = 3.0
"""If force over depth varies by more than this factor along the curve, a modulus describes it badly."""


def calibrated(scene: Scene, young_modulus: float = TISSUE_MODULUS, *, place: ArrayLike | None = None) -> Scene:
    """Choose a scene's scale such that forces are those of a material, by pressing the first tool onto the organ.

    This works for any organ. The tool comes down from above, oriented as in the scene, at five places close together,
    and waits at four depths up to half its width, or half of the organ's thickness there. The mean of force over depth
    is compared with that of a flat punch on an elastic half-space that is nearly incompressible (I. N. Sneddon,
    International Journal of Engineering Science 3, 1965): force = modulus x 2a / (1 - ν²) x depth, a being the radius
    of the circle that has the area of the tool's lower face. Masses in scene units do not change; what changes is the
    number of kilograms in a unit of mass, and with it all forces in newtons and pressures in pascals.

    Args:
        scene: A scene with the organ and the tool. The other tools stay where they are.
        young_modulus: Young's modulus that the tool should feel [Pa].
        place: (2,) x and y at which the tool comes down [u]; by default those of its position in the scene.

    Returns:
        The scene, with another scale.

    Raises:
        ValueError: If an argument is not allowed, or there is no organ where the tool comes down, or one that is too
            thin or does not resist.

    Warns:
        SceneWarning: If force and depth are far from proportional, or about the scene itself; see `Simulation`.

    Example:
        >>> from dataclasses import replace
        >>> from spatula_env import scenes
        >>> from spatula_env.geometry import icosphere
        >>> from spatula_env.sim import calibrated
        >>> scene = scenes.palpate()
        >>> ball = replace(scene.organs[0], organ=icosphere(3.0, 2), orientation=(0.0, 0.0, 0.0, 1.0))
        >>> held = tuple((ball.vertices[:, 2] < 2.0).nonzero()[0].tolist())
        >>> scene = calibrated(replace(scene, organs=(replace(ball, fixed_nodes=held),)))
    """
    check_positive(young_modulus, "young_modulus")
    placed = scene.tools[0]
    middle = np.array(placed.position[:2] if place is None else place, dtype=np.float64)
    if middle.shape != (2,) or not np.isfinite(middle).all():
        raise ValueError(f"place must be two finite numbers, got {place!r}")
    width = math.sqrt(lower_face(placed))
    starts, thickness = _first_contacts(scene, middle + np.array(PLACES) * width, width)
    if thickness < THINNEST * width:
        length = 1e3 * scene.scale.length
        raise ValueError(
            f"scene {scene.name!r} must have an organ that is at least {THINNEST * width * length:.2g} mm thick under "
            f"the tool, a tenth of the width of its face, for its stiffness to be measured; at {middle.tolist()} u it "
            f"is {thickness * length:.2g} mm"
        )
    depths = np.array(DEPTHS) * min(width, thickness)
    forces = _forces(scene, starts, depths, width).mean(axis=0)
    stiffness = float(forces @ depths / (depths @ depths))
    if stiffness <= 0.0:
        raise ValueError(f"scene {scene.name!r} does not resist the tool at {middle.tolist()}: {forces.tolist()}")
    secants = forces / depths
    if secants.max() > BENT * secants.min():
        warn(
            f"force and depth are not in proportion in scene {scene.name!r} at {middle.tolist()}: force over depth is "
            f"{np.round(secants / stiffness, 2).tolist()} of its mean at depths of {np.round(depths, 3).tolist()} u"
        )
    radius = width / math.sqrt(math.pi)
    modulus = stiffness / (FLAT_PUNCH * 2.0 * radius / (1.0 - POISSON**2))
    length = scene.scale.length
    return replace(scene, scale=Scale(length=length, mass=young_modulus * length / modulus))


def lower_face(placed: PlacedTool) -> float:
    """Area of a tool's downward-facing surface, oriented as in the scene and projected onto the horizontal [u2]."""
    tool = placed.tool
    corners = rotate(np.array(placed.orientation), tool.vertices)[tool.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # The area as seen from below: only triangles that face downwards count.
    return float(0.5 * np.maximum(-across[:, 2], 0.0).sum())


def _first_contacts(scene: Scene, places: FloatArray, width: float) -> tuple[FloatArray, float]:
    """Find where a tool that comes down at places (p, 2) first meets an organ.

    Returns:
        (m, 3) where its origin is then, at those places at which it does [u], and how thick the organ is below, at the
        thinnest [u].
    """
    worlds = BatchSimulation(scene, len(places))
    nodes = worlds.nodes
    corners = rotate(np.array(scene.tools[0].orientation), scene.tools[0].tool.vertices)
    under = float(corners[:, 2].min())
    low = float(nodes[:, :, 2].min()) if scene.ground is None else scene.ground.height
    start = float(nodes[:, :, 2].max()) - under + 0.02 * width
    _place(worlds, np.column_stack([places, np.full(len(places), start)]))
    met = np.full(len(places), np.nan)
    motion = np.zeros((len(places), len(scene.tools), 3))
    motion[:, 0, 2] = -SPEED * width
    height = start
    while np.isnan(met).any() and height + under > low:
        touched = worlds.advance(motion).peak_forces[:, 0] > 0.0
        met[touched & np.isnan(met)] = height
        # A tool that has met the organ stops.
        motion[touched] = 0.0
        height -= SPEED * width * scene.dt
    worlds.close()
    if np.isnan(met).all():
        middle = places[0].tolist()
        raise ValueError(f"there is no organ under the tool at {middle} in scene {scene.name!r}; choose another place")
    found = ~np.isnan(met)
    return np.column_stack([places[found], met[found]]), min(
        z + under - _lowest_below(scene, nodes[0], place, low)
        for place, z in zip(places[found], met[found].tolist(), strict=True)
    )


def _lowest_below(scene: Scene, nodes: FloatArray, place: FloatArray, low: float) -> float:
    """Height of the lowest point of the organs with nodes (V, 3) on the vertical at a place (2,), or `low` [u]."""
    starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
    triangles = [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=False)]
    below = np.array([*place, nodes[:, 2].min() - 1.0])
    surface = np.concatenate(triangles).astype(np.int32)
    triangle, distance, *_ = cast_ray(below, np.array([0.0, 0.0, 1.0]), np.array(nodes), surface)
    return low if triangle < 0 else float(below[2]) + distance


def _forces(scene: Scene, starts: FloatArray, depths: FloatArray, width: float) -> FloatArray:
    """(p, k) upward force on the tool at depths (k,) below places (p, 3) where it only just touches [kg u/s2]."""
    worlds = BatchSimulation(scene, len(starts) * len(depths))
    _place(worlds, np.repeat(starts, len(depths), axis=0))
    left, motion = np.tile(depths, len(starts)), np.zeros((worlds.count, len(scene.tools), 3))
    steps = max(1, round(0.05 / scene.dt))
    while (left > 1e-9).any():
        speeds = np.clip(left / (steps * scene.dt), 0.0, SPEED * width)
        motion[:, 0, 2] = -speeds
        worlds.advance(motion, steps=steps)
        left -= speeds * steps * scene.dt
    rest = max(1, round(REST / scene.dt))
    worlds.advance(np.zeros_like(motion), steps=rest)
    loads = worlds.advance(np.zeros_like(motion), steps=rest)
    worlds.close()
    if loads.diverged.any():
        raise ValueError(f"scene {scene.name!r} does not bear an indentation of {depths.max():.3g} u")
    forces: FloatArray = loads.forces[:, 0, 2].reshape(len(starts), len(depths))
    return forces


def _place(worlds: BatchSimulation, positions: FloatArray) -> None:
    """Set the position of the first tool in every world (W, 3); the other tools stay."""
    everything = worlds.tool_positions
    everything[:, 0] = positions
    worlds.place_tools(everything)
