"""Scenes with an organ of one's own, from `spatula organ prepare`, and a tool above the part that it reaches best."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry import Tool
from spatula_env.geometry.surface import triangle_areas, triangle_normals
from spatula_env.scenes.base import STANDARD_DENSITY, PlacedOrgan, PlacedTool, Scale, Scene
from spatula_env.scenes.retract import UPRIGHT

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry.prepared import PreparedOrgan
    from spatula_env.scenes.material import Material

CLEARANCE = 0.02
"""Height of the tool above the organ's top at reset [m]."""

REACH_ASIDE = 0.04
"""How far from its middle, along either horizontal axis, the workspace is used [m]."""

GRID = 0.005
"""Distance of the middles of workspaces that are tried [m]."""

LEVEL, STEEP = 0.7, 0.35
"""Vertical component of the normal above which a surface is pressed from above, and below which from the side."""


def organ_from_above(organ: PreparedOrgan, **options: Any) -> Scene:
    """A spatula, 20 x 20 x 2.5 mm, over an organ of one's own; see `own_organ`."""
    options = {"tool": Tool.box(in_units((0.02, 0.02, 0.0025), organ), nodes_per_edge=6), **options}
    return own_organ(organ, **options)


def organ_from_aside(organ: PreparedOrgan, **options: Any) -> Scene:
    """An upright blade, 20 mm wide, 40 mm high and 1.8 mm thick, over an organ of one's own; see `own_organ`."""
    size = in_units((0.02, 0.04, 0.0018), organ)
    blade = Tool.box(size, faces="all", node_spacing=0.004 / organ.unit_length, name="blade")
    return own_organ(
        organ,
        **{
            "tool": blade,
            "orientation": UPRIGHT,
            "friction": 0.4,
            "steepness": (0.0, STEEP),
            "reach_down": 0.04,
            **options,
        },
    )


def own_organ(
    organ: PreparedOrgan,
    tool: Tool,
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    friction: float = 0.2,
    steepness: tuple[float, float] = (LEVEL, 1.0),
    reach_down: float = 0.02,
    material: Material | None = None,
) -> Scene:
    """A tool above the highest point of an organ of one's own, which stands on the ground.

    The origin, over which tasks place the workspace, is where most of the surface that the tool is meant for is within
    reach. Forces of the engines of springs are those of an organ of this density, which says nothing about its
    stiffness: `sim.calibrated` measures that and changes the scale.

    Args:
        organ: The organ; its held nodes do not move.
        tool: The tool [u].
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        orientation: Orientation of the tool, quaternion xyzw.
        friction: Coulomb coefficient between tool and organ.
        steepness: Least and greatest vertical component of the normal, without its sign, of surface that the tool is
            meant for.
        reach_down: How far below the organ's top such surface is of use [m].
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene.
    """
    length = organ.unit_length
    x, y = _best_middle(organ, steepness, reach_down)
    organ = organ.moved((-x, -y, -organ.bounds[0, 2]))
    top = organ.vertices[organ.vertices[:, 2].argmax()]
    height = float(top[2]) + CLEARANCE / length + 0.5 * float(np.max(tool.size))
    placed = PlacedTool(
        tool,
        position=(float(top[0]), float(top[1]), height),
        orientation=tuple(np.asarray(orientation, dtype=np.float64).tolist()),
        friction=friction,
    )
    return scene_on_ground(organ, (placed,), mass, dt, material, organ.held)


def scene_on_ground(
    organ: PreparedOrgan,
    tools: tuple[PlacedTool, ...],
    mass: float,
    dt: float,
    material: Material | None,
    fixed_nodes: tuple[int, ...],
) -> Scene:
    """A scene of an organ that stands on the ground, and tools; see `own_organ`.

    Args:
        organ: The organ, as it stands.
        tools: The tools, placed.
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        material: What the organ is made of; None for none.
        fixed_nodes: Nodes that do not move.

    Returns:
        The scene. Its scale gives the organ its density.
    """
    density, length = STANDARD_DENSITY if material is None else material.density, organ.unit_length
    return Scene(
        organs=(PlacedOrgan(organ, mass=mass, fixed_nodes=fixed_nodes, material=material),),
        tools=tools,
        dt=dt,
        scale=Scale(length=length, mass=density * organ.volume * length**3 / mass),
        name="own_organ",
    )


def in_units(lengths: tuple[float, ...], organ: PreparedOrgan) -> NDArray[np.float64]:
    """Lengths [m] in the scene units of an organ [u]."""
    return np.array(lengths) / organ.unit_length


def _best_middle(organ: PreparedOrgan, steepness: tuple[float, float], reach_down: float) -> tuple[float, float]:
    """X and y around which most of the surface of some steepness is within reach; the nearest to the organ's middle."""
    vertices, triangles, length = organ.vertices, organ.triangles, organ.unit_length
    low, high = organ.bounds
    middles, areas = vertices[triangles].mean(axis=1), triangle_areas(vertices, triangles)
    up = np.abs(triangle_normals(vertices, triangles)[:, 2])
    wanted = (up >= steepness[0]) & (up <= steepness[1]) & (middles[:, 2] > high[2] - reach_down / length)
    middle = 0.5 * (low[:2] + high[:2])
    count = np.ceil((high[:2] - middle) * length / GRID)
    spots = [middle[axis] + np.arange(-count[axis], count[axis] + 1.0) * GRID / length for axis in range(2)]
    grid = np.stack(np.meshgrid(*spots, indexing="ij"), axis=-1).reshape(-1, 2)
    within = (np.abs(middles[wanted, :2] - grid[:, None]) <= REACH_ASIDE / length).all(axis=2)
    # Rounded, so that what is equal but for rounding is, and the nearest is taken.
    reached = np.round((within * areas[wanted]).sum(axis=1), 6)
    best = grid[reached >= reached.max()]
    x, y = best[((best - middle) ** 2).sum(axis=1).argmin()].tolist()
    return x, y
