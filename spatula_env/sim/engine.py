"""Interfaces of engines. An engine integrates the organs of W worlds of a scene; `worlds.Worlds` does everything else.

An engine does not deal with the ground, the tools or contact between organs, unless it has a contact algorithm of its
own. Its surface nodes are the organs' vertices, numbered consecutively through all organs: V in all. Any further nodes
are internal to the engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import BoolArray, FloatArray, IntArray
    from spatula_env.scenes import PlacedTool, Scene

ContactName = Literal["flags", "second_step", "bullet", "mujoco"]
"""What resolves contact between tools and organs; see `Simulation`."""

OWN_CONTACTS: tuple[ContactName, ...] = ("bullet", "mujoco")
"""The methods that are an engine's own, each named like the engine."""

Precision = Literal["single", "double"]
"""Precision in which an engine that offers both integrates the organs."""

PRECISIONS = {"single": np.float32, "double": np.float64}
"""NumPy types by the name of the precision."""


@dataclass(frozen=True)
class EngineOptions:
    """Options of an engine besides the scene.

    Attributes:
        contact: The method that resolves contact, one of the engine's `Abilities.contacts`.
        precision: Precision of an engine that offers both.
        threads: Number of threads over which worlds are distributed.
    """

    contact: ContactName = "flags"
    precision: Precision = "single"
    threads: int = 1


@dataclass(frozen=True)
class Abilities:
    """What an engine can do.

    Attributes:
        contacts: The methods that can resolve contact with it. An engine with one of `OWN_CONTACTS` is a
            `CollidingEngine`.
        restores_exactly: Whether a restored state continues exactly as the original would have. If not, an environment
            that is saved is itself restored from the saved state, so that both continue alike.
        springs: Whether organs are networks of springs, which have no modulus; `calibrated` gives a scene the forces of
            a material.
        varies: Whether worlds can differ in gravity, stiffness and mass; it is then a `VaryingEngine`.
        strains: Whether it reports how tissue is strained; it is then a `StrainedEngine`.
        materials: Whether organs are made of their `scenes.Material`.
        sweeps: Number of solver sweeps over an organ's links in a step. A pull travels that many edges per step, and a
            warning is issued for organs that are more edges across; None: there is no such limit.
    """

    contacts: tuple[ContactName, ...] = ("flags", "second_step")
    restores_exactly: bool = True
    springs: bool = False
    varies: bool = False
    strains: bool = False
    materials: bool = False
    sweeps: int | None = None


class Engine(Protocol):
    """Soft organs that fall, stretch and swing, in W worlds of a scene."""

    abilities: ClassVar[Abilities]

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        """Put the scene's organs into W worlds, at rest in their initial shape."""

    @property
    def inverse_masses(self) -> FloatArray:
        """(W, V) of the surface nodes [1/kg]; zero for a node that is held fixed."""

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: BoolArray) -> None:
        """Advance all worlds by one physics step, from the state in which contact left them after the last one.

        Args:
            positions: (W, V, 3) of the surface nodes at the start of the step; written, at its end [u].
            velocities: (W, V, 3) of them; written [u/s].
            diverged: (W,) worlds to leave alone; written, true where positions or velocities are no longer finite.
        """

    def halt(self, positions: FloatArray, worlds: IntArray) -> None:
        """Set the velocities of all nodes of some worlds to zero, inner nodes included.

        Args:
            positions: (n, V, 3) of the surface nodes [u].
            worlds: (n,) which worlds.
        """

    def save(self, worlds: IntArray) -> tuple[Any, ...]:
        """(n,) the part of the state of some worlds (n,) that surface nodes do not contain, such as inner nodes.

        Copies, which can be pickled; None where the surface nodes are the whole state.
        """

    def restore(self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: IntArray) -> None:
        """Put some worlds into a state; what follows does not depend on the previous state.

        Args:
            positions: (n, V, 3) of the surface nodes [u].
            velocities: (n, V, 3) of them [u/s].
            inner: (n,) what `save` returned; None: the inner state that fits these surface nodes at rest.
            worlds: (n,) which worlds.
        """

    def close(self) -> None:
        """Free what the engine holds. Closing twice is allowed."""


@runtime_checkable
class BlockEngine(Protocol):
    """An engine that takes blocks of worlds through several physics steps, contact included, all in compiled code.

    Attributes:
        lanes: Worlds in a block.
    """

    lanes: int

    def run_block(self, block: int, coupling: Any, steps: int, share: float) -> None:
        """Take the worlds of a block through physics steps. Other blocks may be taken at the same time.

        Args:
            block: Index of the block.
            coupling: `step.Coupling` of the worlds, for `step.couple_worlds`, which follows each step of the engine.
            steps: Number of physics steps.
            share: Length of one of them as a fraction of the control step.
        """


class VaryingEngine(Engine, Protocol):
    """An engine whose worlds can differ in gravity, stiffness and mass."""

    @property
    def gravity(self) -> FloatArray:
        """(W,) downward acceleration [u/s2]."""

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None,
        stiffness: ArrayLike | None,
        mass_scale: ArrayLike | None,
        worlds: IntArray,
    ) -> None:
        """Change parameters of some worlds; see `Worlds.set_parameters`."""


class Strains(NamedTuple):
    """How the O organs of n worlds are strained and stressed, in scene units.

    A peak is the value at a single node of a mesh; a high value is exceeded in a twentieth of an organ's volume.

    Attributes:
        peak_strains: (n, O) peak of the greatest principal Green-Lagrange strain, half of (squared stretch less one).
        high_strains: (n, O) high value of the same.
        peak_stresses: (n, O) peak of the greatest principal Cauchy stress, tension positive [kg/(u s2)].
        high_stresses: (n, O) high value of the same.
        strained_shares: (n, O) share of the volume that is strained beyond a threshold.
    """

    peak_strains: FloatArray
    high_strains: FloatArray
    peak_stresses: FloatArray
    high_stresses: FloatArray
    strained_shares: FloatArray


class StrainedEngine(Engine, Protocol):
    """An engine that reports how tissue is strained."""

    def strains(self, worlds: IntArray, threshold: float) -> Strains:
        """How organs are strained now.

        Args:
            worlds: (n,) which worlds.
            threshold: Strain beyond which volume counts in `Strains.strained_shares`.
        """


class CollidingEngine(Engine, Protocol):
    """An engine that can resolve the contact of tools by an algorithm of its own."""

    def set_tools(self, tools: Sequence[PlacedTool], world: int) -> None:
        """Exchange the tools of a world. The state of its organs is lost: `restore` must follow."""

    def place_tools(self, positions: FloatArray, orientations: FloatArray, world: int) -> None:
        """Set the poses of a world's tools, at rest: positions (N, 3) [u] and orientations (N, 4)."""

    def move_tools(
        self, positions: FloatArray, orientations: FloatArray, linear: FloatArray, angular: FloatArray, world: int
    ) -> None:
        """Give the tools of a world the poses (N, 3) [u], (N, 4) of the end of the coming step, and their velocities.

        Args:
            positions: (N, 3) [u].
            orientations: (N, 4).
            linear: (N, 3) [u/s].
            angular: (N, 3) [rad/s].
            world: Which world.
        """

    def tool_impulses(self, linear: FloatArray, angular: FloatArray, world: int) -> FloatArray:
        """(N, 6) impulses of the organs on tools with these velocities in the last step [kg u/s, kg u2/s2]."""
