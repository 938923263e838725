"""The parts of a scene: the scale that turns scene units into SI, ground, organs and tools.

Everything here is a frozen dataclass without behaviour of its own: a scene can be shared, compared and sent to
another process. One scene unit of length is written u; scene masses are written kg and become real ones through
`Scale`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from spatula_env.geometry import Organ, Tool
from spatula_env.geometry.checks import as_tuple_of, check_finite, check_kind, check_not_negative, check_positive
from spatula_env.geometry.transforms import as_quaternion, as_vector3, rotate
from spatula_env.scenes.material import Material

if TYPE_CHECKING:
    from numpy.typing import NDArray

STANDARD_DENSITY = 1040.0
"""Density of brain tissue [kg/m3] (table 2 of PMC7203590)."""

TISSUE_MODULUS = 2010.0
"""Young's modulus of brain tissue [Pa]: three times the shear modulus of 670 Pa that fits how brains move in the living
head (PMC9748497), as tissue is nearly incompressible. Other sources give 1.4 to 9 kPa."""

UNIT_LENGTH = 0.02
"""Metres in a unit of length of the preset scenes."""

ScaleName = Literal["stiffness", "density"]
"""How a preset scene's mass scale is chosen; see `choose_scale`."""


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
        check_finite(self.height, "height")
        check_not_negative(self.friction, "friction")


@dataclass(frozen=True)
class PlacedOrgan:
    """An organ in a scene.

    Attributes:
        organ: Its surface.
        position: Position of the origin of its frame [u].
        mass: Its mass [kg], spread over the nodes by the area around them.
        orientation: Its orientation, quaternion xyzw.
        fixed_nodes: Nodes that do not move.
        material: What it is made of, for an engine that uses materials; None: `Material()`. The engine "tissue" takes
            the mass from its density.
        material_orientation: Orientation instead of `orientation` with such an engine, for an organ of which nothing is
            fixed: its weight flattens it, so that it lies at rest in another orientation. None: the same.
    """

    organ: Organ
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mass: float = 10.0
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    fixed_nodes: tuple[int, ...] = ()
    material: Material | None = None
    material_orientation: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        check_kind(self.organ, "organ", Organ)
        _set_pose(self)
        check_positive(self.mass, "mass")
        for node in self.fixed_nodes:
            if not isinstance(node, int | np.integer) or not 0 <= node < len(self.organ.vertices):
                raise ValueError(f"fixed_nodes must be integers in 0..{len(self.organ.vertices) - 1}, got {node!r}")
        if self.material_orientation is not None:
            turned = as_quaternion(self.material_orientation, "material_orientation")
            object.__setattr__(self, "material_orientation", tuple(turned.tolist()))
        if not isinstance(self.material, Material | None):
            raise ValueError(f"material must be a Material or None, got {self.material!r}")

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
        position: Position at reset [u].
        orientation: Orientation at reset, quaternion xyzw.
        friction: Coulomb coefficient between tool and organ.
    """

    tool: Tool
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    friction: float = 0.2

    def __post_init__(self) -> None:
        """Check the values."""
        check_kind(self.tool, "tool", Tool)
        _set_pose(self)
        check_not_negative(self.friction, "friction")


@dataclass(frozen=True)
class Scene:
    """Everything a simulation needs to know to start.

    Attributes:
        organs: At least one, from any sequence of them.
        tools: At least one, from any sequence; the first is the one that `Simulation.tool_position` refers to.
        ground: The plane under the organs, or None.
        gravity: Downward acceleration [u/s2].
        dt: Length of a physics step [s].
        scale: From scene units to SI.
        name: Name of the scene.
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
        object.__setattr__(self, "organs", as_tuple_of(self.organs, "organs", PlacedOrgan))
        object.__setattr__(self, "tools", as_tuple_of(self.tools, "tools", PlacedTool))
        check_kind(self.ground, "ground", Ground, or_none=True)
        check_kind(self.scale, "scale", Scale)
        if not self.organs:
            raise ValueError("organs must hold at least one organ, got none")
        if not self.tools:
            raise ValueError("tools must hold at least one tool, got none")
        check_finite(self.gravity, "gravity")
        check_positive(self.dt, "dt")


def choose_scale(
    scale: ScaleName | Scale, organ: Organ, mass: float, dt: float, stiffness: float, material: Material | None = None
) -> Scale:
    """Choose the scale of a preset scene.

    The soft bodies have no material of their own: for a given displacement, they resist with a force in proportion to
    mass / dt^2, the mass being that per area. So the kilograms in a scene unit of mass decide how stiff the organ is
    in pascals.

    Args:
        scale: "stiffness": the organ has `TISSUE_MODULUS`. "density": it has `STANDARD_DENSITY`. Or a scale, which is
            returned.
        organ: The organ in the scene.
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        stiffness: Measured stiffness of the scene: effective Young's modulus [kg/(u s2)] x dt^2 x area / mass [u].
        material: What the organ is made of. Whichever name `scale` is, the scale then follows from the material's
            density; the modulus is the material's own.

    Returns:
        The scale.

    Raises:
        ValueError: If an argument is not allowed.
    """
    if isinstance(scale, Scale):
        return scale
    if not isinstance(scale, str) or scale not in get_args(ScaleName):
        raise ValueError(f"scale must be one of {list(get_args(ScaleName))} or a Scale, got {scale!r}")
    check_positive(mass, "mass")
    check_positive(dt, "dt")
    if scale == "density" or material is not None:
        density = STANDARD_DENSITY if material is None else material.density
        return Scale(length=UNIT_LENGTH, mass=density * organ.volume * UNIT_LENGTH**3 / mass)
    modulus = stiffness * mass / (organ.area * dt**2)
    return Scale(length=UNIT_LENGTH, mass=TISSUE_MODULUS * UNIT_LENGTH / modulus)


def with_material(scene: Scene, material: Material) -> Scene:
    """A copy of a scene whose organs are made of a material, for the engine "tissue".

    Args:
        scene: Any scene.
        material: What all its organs are made of.

    Returns:
        The scene. Its scale has the same length, and a mass with which all organs together have the material's density,
        as in presets that are given the material.
    """
    organs = tuple(replace(placed, material=material) for placed in scene.organs)
    volume, mass = sum(placed.organ.volume for placed in organs), sum(placed.mass for placed in organs)
    length = scene.scale.length
    return replace(scene, organs=organs, scale=Scale(length=length, mass=material.density * volume * length**3 / mass))


def lying_as_material(scene: Scene) -> Scene:
    """The scene for an engine that uses materials: organs that lie free in their `material_orientation`."""
    organs = tuple(
        placed
        if placed.material_orientation is None or placed.fixed_nodes
        else replace(placed, orientation=placed.material_orientation)
        for placed in scene.organs
    )
    return scene if organs == scene.organs else replace(scene, organs=organs)


def _set_pose(placed: PlacedOrgan | PlacedTool) -> None:
    """Check and normalise the pose of a frozen dataclass."""
    position = as_vector3(placed.position, "position")
    orientation = as_quaternion(placed.orientation, "orientation")
    object.__setattr__(placed, "position", tuple(position.tolist()))
    object.__setattr__(placed, "orientation", tuple(orientation.tolist()))
