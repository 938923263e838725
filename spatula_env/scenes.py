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

from spatula_env.geometry import Organ, Tool, seed_sphere
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.transforms import as_quaternion, as_vector3, rotate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

STANDARD_DENSITY = 1040.0
"""Density of brain tissue [kg/m3] (table 2 of PMC7203590)."""

RESTING_SPHERE = (-0.0235445, 0.0522466, 0.0003375, 0.9983566)
"""How the seed's sphere lies when it has rolled to rest, quaternion xyzw. It is a polyhedron, and its first node would
stand on the ground like a ball on a needle's point: from there it rolls for many seconds."""


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
    length = 0.02
    density_scale = STANDARD_DENSITY * sphere.volume * length**3 / mass if mass > 0 else 1.0
    return Scene(
        organs=(PlacedOrgan(sphere, position=(0.0, 0.0, 3.0), orientation=RESTING_SPHERE, mass=mass),),
        tools=(PlacedTool(tool, position=(0.0, 0.0, 7.0), friction=friction),),
        dt=dt,
        scale=Scale(length=length, mass=density_scale),
        name="seed",
    )


def _set_pose(placed: PlacedOrgan | PlacedTool) -> None:
    """Check and normalise the pose of a frozen dataclass."""
    position = as_vector3(placed.position, "position")
    orientation = as_quaternion(placed.orientation, "orientation")
    object.__setattr__(placed, "position", tuple(position.tolist()))
    object.__setattr__(placed, "orientation", tuple(orientation.tolist()))


def _check_not_negative(value: float, name: str) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name} must be zero or more and finite, got {value!r}")
