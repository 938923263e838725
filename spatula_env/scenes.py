"""What stands in a scene: organs, tools, ground, and the scale that turns scene units into SI.

Everything here is a frozen dataclass without behaviour of its own: a scene can be shared, compared and sent to
another process. One scene unit of length is written u; scene masses are written kg and become real ones through
`Scale`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry import Organ, Tool, fissured_block, ridged_block, seed_sphere
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.transforms import as_quaternion, as_vector3, rotate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

STANDARD_DENSITY = 1040.0
"""Density of brain tissue [kg/m3] (table 2 of PMC7203590)."""

RESTING_SPHERE = (-0.0235445, 0.0522466, 0.0003375, 0.9983566)
"""How the seed's sphere lies when it has rolled to rest, quaternion xyzw. It is a polyhedron, and its first node would
stand on the ground like a ball on a needle's point: from there it rolls for many seconds."""

ON_EDGE = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""How a plate stands on edge, quaternion xyzw: its y axis upwards and its thickness, z, along negative y."""

FISSURE_CLEARANCE = 0.3
"""How far the spatula's edge is above the organ at reset [u]."""

JAW_CLEARANCE = 0.2
"""How far each jaw is from the ridge at reset [u]."""


@dataclass(frozen=True)
class Scale:
    """How scene units become SI units. Seconds are seconds.

    Attributes:
        length: Metres in a scene unit of length.
        mass: Kilograms in a scene unit of mass.
    """

    length: float = 0.02
    mass: float = 1.0

    def __post_init__(self) -> None:
        """Check the factors."""
        check_positive(self.length, "length")
        check_positive(self.mass, "mass")

    @property
    def speed(self) -> float:
        """Metres per second in a scene unit of speed."""
        return self.length

    @property
    def force(self) -> float:
        """Newtons in a scene unit of force."""
        return self.mass * self.length

    @property
    def torque(self) -> float:
        """Newton-metres in a scene unit of torque; also joules in a scene unit of energy."""
        return self.mass * self.length**2

    @property
    def pressure(self) -> float:
        """Pascals in a scene unit of pressure."""
        return self.mass / self.length


@dataclass(frozen=True)
class Ground:
    """A horizontal plane that nothing sinks through.

    Attributes:
        height: z of the plane [u].
        friction: Coulomb coefficient between organ and ground.
    """

    height: float = 0.0
    friction: float = 0.5

    def __post_init__(self) -> None:
        """Check the values."""
        if not math.isfinite(self.height):
            raise ValueError(f"height must be finite, got {self.height!r}")
        _check_not_negative(self.friction, "friction")


@dataclass(frozen=True)
class PlacedOrgan:
    """An organ in a scene.

    Attributes:
        organ: Its surface.
        position: Where the origin of its frame is [u].
        mass: Its mass [kg], spread over the nodes by the area around them.
        orientation: How it is turned, quaternion xyzw.
        fixed_nodes: Nodes that do not move.
    """

    organ: Organ
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mass: float = 10.0
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    fixed_nodes: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check the values."""
        _set_pose(self)
        check_positive(self.mass, "mass")
        for node in self.fixed_nodes:
            if not isinstance(node, int | np.integer) or not 0 <= node < len(self.organ.vertices):
                raise ValueError(f"fixed_nodes must be integers in 0..{len(self.organ.vertices) - 1}, got {node!r}")

    @property
    def vertices(self) -> NDArray[np.float64]:
        """(V, 3) of the organ in the scene, undeformed [u]."""
        vertices: NDArray[np.float64] = rotate(np.array(self.orientation), self.organ.vertices) + self.position
        return vertices


@dataclass(frozen=True)
class PlacedTool:
    """A tool in a scene.

    Attributes:
        tool: Its shape and contact nodes.
        position: Where it is at reset [u].
        orientation: How it is turned at reset, quaternion xyzw.
        friction: Coulomb coefficient between tool and organ.
    """

    tool: Tool
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    friction: float = 0.2

    def __post_init__(self) -> None:
        """Check the values."""
        _set_pose(self)
        _check_not_negative(self.friction, "friction")


@dataclass(frozen=True)
class Scene:
    """Everything a simulation needs to know to start.

    Attributes:
        organs: At least one.
        tools: Any number; the first is the one that `Simulation.tool_position` speaks of.
        ground: The plane under the organs, or None.
        gravity: Downward acceleration [u/s2].
        dt: Length of a physics step [s].
        scale: From scene units to SI.
        name: What to call the scene.
    """

    organs: tuple[PlacedOrgan, ...]
    tools: tuple[PlacedTool, ...]
    ground: Ground | None = field(default_factory=Ground)
    gravity: float = 10.0
    dt: float = 1.0 / 240.0
    scale: Scale = field(default_factory=Scale)
    name: str = "scene"

    def __post_init__(self) -> None:
        """Check the values."""
        if not self.organs:
            raise ValueError("organs must hold at least one organ, got none")
        if not self.tools:
            raise ValueError("tools must hold at least one tool, got none")
        if not math.isfinite(self.gravity):
            raise ValueError(f"gravity must be finite, got {self.gravity!r}")
        check_positive(self.dt, "dt")


def seed(
    tool_size: ArrayLike = (1.0, 1.0, 0.125),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    nodes_per_edge: int = 6,
    faces: str = "largest",
    friction: float = 0.2,
) -> Scene:
    """The scene of the seed: a thin spatula over a soft sphere that rests on the ground.

    The sphere has radius 3 u, 328 nodes and 652 triangles; gravity is 10 u/s2. One unit is 20 mm: a 20 x 20 x 2.5 mm
    spatula and an organ of 60 mm radius, which the Falcon's 101.6 mm cube covers one to one.

    Args:
        tool_size: (3,) edges of the box-shaped spatula [u].
        mass: Of the sphere [kg].
        dt: Length of a physics step [s].
        nodes_per_edge: Contact nodes along the longest edge of the spatula's largest faces.
        faces: Which faces carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between spatula and sphere.

    Returns:
        The scene. Its mass scale gives the sphere the density of brain tissue, 1040 kg/m3.
    """
    sphere = seed_sphere()
    tool = Tool.box(size=tool_size, nodes_per_edge=nodes_per_edge, faces=faces)
    return Scene(
        organs=(PlacedOrgan(sphere, position=(0.0, 0.0, 3.0), orientation=RESTING_SPHERE, mass=mass),),
        tools=(PlacedTool(tool, position=(0.0, 0.0, 7.0), friction=friction),),
        dt=dt,
        scale=_brain_scale(sphere, mass),
        name="seed",
    )


def fissure(
    size: ArrayLike = (6.0, 5.0, 3.0),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    depth: float = 1.6,
    length: float = 3.0,
    width: float = 0.25,
    edge_length: float = 0.25,
    base_edge_length: float | None = 0.65,
    fixed_floor: bool = True,
    tool_size: ArrayLike = (1.0, 2.0, 0.06),
    node_spacing: float = 0.2,
    faces: str = "all",
    friction: float = 0.2,
) -> Scene:
    """A fissure in a piece of an organ, and a thin spatula that stands on edge above it.

    One unit is 20 mm, as in :func:`seed`: a fissure 60 mm long, 32 mm deep and 5 mm wide, about as large as the lateral
    fissure of the brain, and a spatula 20 mm wide and 1.2 mm thick. Moving a wall aside by 6 mm takes 1 to 2 N,
    which on the part of the blade in the fissure is 2 to 4 kPa, the pressure of brain retraction.

    The organ is held at its base, which is on the ground. A surface of springs is hollow: a floor that is not held
    hangs between the walls like a hem and follows the wall that is pushed, and the fissure moves sideways more than it
    opens. In an organ the tissue below holds it; here the floor's nodes are fixed.

    Args:
        size: (3,) extents of the organ [u].
        mass: Of the organ [kg].
        dt: Length of a physics step [s].
        depth: Of the fissure [u].
        length: Of the fissure, along x [u].
        width: Distance of the fissure's walls, along y [u].
        edge_length: Of the organ's triangles in and around the fissure [u].
        base_edge_length: Of the organ's triangles at the base [u]; None for that of the others.
        fixed_floor: Whether the floor of the fissure is held too.
        tool_size: (3,) edges of the spatula [u]: its width, along x; its height, upwards; its thickness, along y.
        node_spacing: Greatest distance of contact nodes along an edge of the spatula [u].
        faces: Which faces of the spatula carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between spatula and organ.

    Returns:
        The scene. Its organ is a :class:`~spatula_env.geometry.FissuredBlock`, which names the nodes of walls and floor
        and the target; its mass scale gives the organ the density of brain tissue, 1040 kg/m3.

    Raises:
        ValueError: If a value is not allowed, or the parts do not fit into each other.
    """
    block = fissured_block(size, depth, length, width, edge_length, base_edge_length=base_edge_length)
    tool = Tool.box(tool_size, faces=faces, node_spacing=node_spacing)
    fixed = np.union1d(block.base, block.floor) if fixed_floor else block.base
    top = float(block.bounds[1, 2])
    return Scene(
        organs=(PlacedOrgan(block, mass=mass, fixed_nodes=tuple(fixed.tolist())),),
        tools=(
            PlacedTool(
                tool,
                position=(0.0, 0.0, top + FISSURE_CLEARANCE + 0.5 * float(tool.size[1])),
                orientation=ON_EDGE,
                friction=friction,
            ),
        ),
        dt=dt,
        scale=_brain_scale(block, mass),
        name="fissure",
    )


def clamp(
    size: ArrayLike = (4.0, 3.2, 1.2),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    ridge_height: float = 1.3,
    ridge_length: float = 2.0,
    ridge_width: float = 0.8,
    edge_length: float = 0.25,
    base_edge_length: float | None = 0.5,
    fixed_base: bool = False,
    jaw_size: ArrayLike = (1.2, 0.8, 0.12),
    jaw_tilt: float = 0.0,
    node_spacing: float = 0.2,
    faces: str = "all",
    friction: float = 0.6,
) -> Scene:
    """Two jaws on either side of a ridge on a piece of an organ, which rests on the ground.

    The jaws face each other along y: the first tool is at negative y and closes along +y, the second is its mirror
    image. They are above the ridge's foot. One unit is 20 mm: a ridge 40 mm long, 16 mm wide and 26 mm high, and jaws
    24 mm long. Jaws that take away three tenths of the ridge's width press with about 0.19 N each, and can then lift
    the organ, which weighs a ninth of that.

    Args:
        size: (3,) extents of the organ without the ridge [u].
        mass: Of the organ [kg].
        dt: Length of a physics step [s].
        ridge_height: How far the ridge stands out above the organ's top [u].
        ridge_length: Of the ridge, along x [u].
        ridge_width: Of the ridge, along y, between the jaws [u].
        edge_length: Of the ridge's triangles [u].
        base_edge_length: Of the organ's triangles at the base [u]; None for that of the others.
        fixed_base: Whether the base is held to the ground. Lifting then stretches the organ, which is much stiffer than
            the ridge: jaws that squeeze it by three tenths slip after about 0.1 u.
        jaw_size: (3,) edges of each jaw [u]: its length, along x; its height; its thickness, along y.
        jaw_tilt: By how much each jaw's lower edge is turned towards the ridge [rad].
        node_spacing: Greatest distance of contact nodes along an edge of a jaw [u].
        faces: Which faces of the jaws carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between jaws and organ: that of a toothed jaw rather than of a smooth spatula.

    Returns:
        The scene. Its organ is a :class:`~spatula_env.geometry.RidgedBlock`, which names the nodes of the ridge's
        flanks; its mass scale gives the organ the density of brain tissue, 1040 kg/m3.

    Raises:
        ValueError: If a value is not allowed, or the parts do not fit into each other.
    """
    block = ridged_block(size, ridge_height, ridge_length, ridge_width, edge_length, base_edge_length=base_edge_length)
    jaw = Tool.box(jaw_size, faces=faces, node_spacing=node_spacing, name="jaw")
    if not (math.isfinite(jaw_tilt) and abs(jaw_tilt) < 0.5 * math.pi):
        raise ValueError(f"jaw_tilt must be between -pi/2 and pi/2, got {jaw_tilt!r}")
    half_height, half_thickness = 0.5 * float(jaw.size[1]), 0.5 * float(jaw.size[2])
    reach = half_height * abs(math.sin(jaw_tilt)) + half_thickness * math.cos(jaw_tilt)
    rise = half_height * math.cos(jaw_tilt) + half_thickness * abs(math.sin(jaw_tilt))
    # As high as the flanks reach: above, the crest is round.
    height = max(block.foot_height + ridge_height - 0.25 * ridge_width, block.foot_height + 2.0 * rise) - rise
    tools = []
    for side in (-1.0, 1.0):
        angle = 0.25 * math.pi - 0.5 * side * jaw_tilt
        tools.append(
            PlacedTool(
                jaw,
                position=(0.0, side * (0.5 * ridge_width + JAW_CLEARANCE + reach), height),
                orientation=(math.sin(angle), 0.0, 0.0, math.cos(angle)),
                friction=friction,
            )
        )
    return Scene(
        organs=(PlacedOrgan(block, mass=mass, fixed_nodes=tuple(block.base.tolist()) if fixed_base else ()),),
        tools=tuple(tools),
        dt=dt,
        scale=_brain_scale(block, mass),
        name="clamp",
    )


def _brain_scale(organ: Organ, mass: float) -> Scale:
    """The scale of 20 mm in a unit that gives an organ the density of brain tissue."""
    check_positive(mass, "mass")
    length = 0.02
    return Scale(length=length, mass=STANDARD_DENSITY * organ.volume * length**3 / mass)


def _set_pose(placed: PlacedOrgan | PlacedTool) -> None:
    """Check and normalise the pose of a frozen dataclass."""
    position = as_vector3(placed.position, "position")
    orientation = as_quaternion(placed.orientation, "orientation")
    object.__setattr__(placed, "position", tuple(position.tolist()))
    object.__setattr__(placed, "orientation", tuple(orientation.tolist()))


def _check_not_negative(value: float, name: str) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name} must be zero or more and finite, got {value!r}")
