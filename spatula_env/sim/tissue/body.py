"""Organs of tissue in many worlds: the arrays that kernels work on, and access to them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry.tetrahedra import fill_organ
from spatula_env.geometry.transforms import rotate
from spatula_env.scenes import Material
from spatula_env.sim.follow import follow_surface
from spatula_env.sim.lanes import aligned_zeros
from spatula_env.sim.selection import one_each, refuse, world_indices
from spatula_env.sim.tissue import nodal
from spatula_env.sim.tissue.held import GIVEN_BACK
from spatula_env.sim.tissue.hyperelastic import Hyperelastic
from spatula_env.sim.tissue.kernels import Blocks
from spatula_env.sim.tissue.solid import Solid

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from spatula_env.arrays import BoolArray, FloatArray, IntArray
    from spatula_env.scenes import PlacedOrgan, Scale, Scene

STABILISER = 0.3
"""Modulus of the stabiliser, by the shear modulus. It resists deformations of elements that the averages at their nodes
do not see. With 0 some motions cost no energy; with 1, tissue of few elements is too stiff in shear by a quarter."""

GROWTH = 2.0
"""Factor by which a node's resistance to volume change, |cof F|^2 / 3, may exceed that at rest before it is limited, as
in tissue that is pressed to less than half its thickness. Substeps are short enough for this factor."""

SAFETY = 0.6
"""Length of a substep, by the longest one that is stable where tissue is at rest. Compressed tissue is stiffer: with
0.95 the seed's organ began to oscillate under a plate 10 mm deep, with 0.6 it does not."""

UNDERESTIMATE = 1.05
"""Factor on the greatest eigenvalue, because power iteration approaches it from below."""


@dataclass(frozen=True)
class Lump:
    """An organ of tissue in scene units.

    Attributes:
        placed: The organ.
        material: What it is made of.
        solid: Its tetrahedra, with the nodes in the order in which kernels process them.
        surface: (V,) indices of the nodes that are the organ's vertices.
        law: Coefficients of the energy [kg/(u s2)].
        masses: (N,) of the nodes [kg].
        frequency: Greatest angular frequency of small motions, in the state where stress grows fastest [1/s].
    """

    placed: PlacedOrgan
    material: Material
    solid: Solid
    surface: IntArray
    law: Hyperelastic
    masses: FloatArray
    frequency: float

    @classmethod
    def of(cls, placed: PlacedOrgan, scale: Scale) -> Lump:
        """Fill an organ with tetrahedra, in a scene with that scale."""
        material = Material() if placed.material is None else placed.material
        mesh = fill_organ(placed.organ)
        filled = place_nodes(mesh.nodes, placed)
        vertices = len(placed.organ.vertices)
        order = np.concatenate([along_longest(filled[:vertices]), vertices + along_longest(filled[vertices:])])
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        solid = Solid(filled[order], np.ascontiguousarray(place[mesh.tetrahedra], dtype=np.int32))
        law = Hyperelastic.of(material, scale.pressure)
        density = material.density * scale.length**3 / scale.mass
        fastest = solid.fastest(law.greatest_shear, GROWTH * max(law.lame, law.bulk), STABILISER * law.shear)
        return cls(
            placed=placed,
            material=material,
            solid=solid,
            surface=place[:vertices],
            law=law,
            masses=density * solid.masses,
            frequency=math.sqrt(UNDERESTIMATE * fastest / density),
        )

    @property
    def viscous_time(self) -> float:
        """Viscosity divided by shear modulus [s]."""
        return self.material.viscosity / self.material.shear_modulus

    @property
    def held(self) -> BoolArray:
        """(N,) which nodes do not move."""
        held = np.zeros(len(self.masses), dtype=np.bool_)
        held[self.surface[np.asarray(self.placed.fixed_nodes, dtype=np.int64)]] = True
        return held

    @property
    def wave_speed(self) -> float:
        """Speed of a shear wave [u/s]."""
        return math.sqrt(self.law.shear * float(self.solid.volumes.sum() / self.masses.sum()))

    def substeps(self, dt: float, stiffness: FloatArray) -> IntArray:
        """(n,) number of substeps in a step, with stiffness per mass multiplied by factors (n,)."""
        return np.ceil(dt / longest_substep(self.frequency**2 * stiffness, self.viscous_time)).astype(np.int64)


def longest_substep(squared_frequency: FloatArray, viscous_time: float) -> FloatArray:
    """(n,) longest substeps with which motions of squared angular frequencies (n,) [1/s2] are stable [s].

    They are where w^2 h (h + 2 t) < 4, with the frequency w, the substep h and the viscous time t.
    """
    longest: FloatArray = SAFETY * (np.sqrt(viscous_time**2 + 4.0 / squared_frequency) - viscous_time)
    return longest


def place_nodes(nodes: FloatArray, placed: PlacedOrgan) -> FloatArray:
    """(N, 3) nodes of an organ, transformed from its own frame to the scene."""
    moved: FloatArray = rotate(np.array(placed.orientation), nodes) + placed.position
    return moved


def along_longest(nodes: FloatArray) -> IntArray:
    """(N,) an order of nodes (N, 3) that keeps neighbours close: by layers across the longest axis, then by rows."""
    if not len(nodes):
        return np.zeros(0, dtype=np.int64)
    extents = np.ptp(nodes, axis=0)
    size = float(np.cbrt(extents.prod() / len(nodes))) or 1.0
    axes = np.argsort(extents)
    cells = np.floor((nodes - nodes.min(axis=0)) / (1.5 * size)).astype(np.int64)
    return np.lexsort((nodes[:, axes[0]], cells[:, axes[1]], cells[:, axes[2]]))


class TissueBody:
    """The organs of a scene as tissue in many worlds, which differ in state, gravity, stiffness and mass.

    World w is lane w % lanes of block w // lanes. The last block is padded with unused worlds in which nothing moves.

    Attributes:
        lumps: The organs.
        worlds: Number of worlds W.
        dt: Length of a step [s].
        blocks: The arrays that kernels work on.
    """

    def __init__(self, scene: Scene, worlds: int, *, lanes: int, dtype: DTypeLike = np.float32) -> None:
        """Put the scene's organs into every world, at rest in their initial shape.

        Args:
            scene: The scene with the organs.
            worlds: Number of worlds W.
            lanes: Worlds in a block. Only the speed depends on it.
            dtype: float32 or float64.
        """
        self._real = np.dtype(dtype)
        self.lumps = [Lump.of(placed, scene.scale) for placed in scene.organs]
        self.worlds, self.dt = worlds, scene.dt
        lumps, blocks, terms = self.lumps, -(-worlds // lanes), max(len(x.material.relaxation) for x in self.lumps)
        counts = [len(lump.masses) for lump in lumps]
        first = np.cumsum([0, *counts])
        count, organs = int(first[-1]), len(lumps)
        general = np.array([lump.material.model == "rivlin" or bool(lump.material.relaxation) for lump in lumps])
        pairs = np.cumsum([0, *(len(lump.solid.neighbours) for lump in lumps)])
        starts = [lump.solid.starts[:-1] + start for lump, start in zip(lumps, pairs, strict=False)]
        self.blocks = Blocks(
            lanes=(0,) * lanes,
            positions=self._zeros(blocks, count, 3, lanes),
            velocities=self._zeros(blocks, count, 3, lanes),
            leading=self._zeros(2, blocks, count, 3, lanes),
            stresses=self._zeros(blocks, count, 9, lanes),
            overstresses=self._zeros(blocks, count if general.any() else 0, 6, lanes),
            histories=self._zeros(blocks, count if terms else 0, terms, 6, lanes),
            free_velocities=self._zeros(blocks, count, 3, lanes),
            directions=self._zeros(blocks, count, 3, lanes),
            holds=self._zeros(blocks, count, 3, lanes),
            debts=self._zeros(blocks, count, 3, lanes),
            starts=np.concatenate([*starts, pairs[-1:]]).astype(np.int32),
            neighbours=np.concatenate(
                [lump.solid.neighbours + start for lump, start in zip(lumps, first, strict=False)]
            ).astype(np.int32),
            pairs=self._real_array(np.concatenate([_pair_table(lump.solid) for lump in lumps])),
            nodes=self._real_array(np.concatenate([_node_table(lump) for lump in lumps])),
            surface=np.concatenate([lump.surface + start for lump, start in zip(lumps, first, strict=False)]).astype(
                np.int32
            ),
            surface_ends=first[:-1] + [len(lump.surface) for lump in lumps],
            ends=first[1:].astype(np.int64),
            materials=self._zeros(blocks, organs, nodal.MATERIAL_ROWS, lanes),
            relaxation=self._zeros(blocks, organs, terms, 2, lanes),
            general=general,
            terms=np.array([terms if lump.material.relaxation else 0 for lump in lumps]),
            steps=self._zeros(blocks, organs, 1, nodal.STEP_ROWS, lanes),
            substeps=np.ones((blocks, organs), dtype=np.int64),
            dt=np.array(scene.dt, dtype=self._real)[()],
            finite=self._zeros(blocks, lanes),
        )
        self.rest: FloatArray = np.concatenate([lump.solid.nodes for lump in lumps])
        self._masses = np.concatenate([lump.masses for lump in lumps])
        self._held = np.concatenate([lump.held for lump in lumps])
        self._write_materials()
        self.blocks.positions[:] = self.rest[:, :, None]
        self._gravity, self._stiffness, self._mass_scale = (
            np.full(worlds, scene.gravity),
            np.ones(worlds),
            np.ones(worlds),
        )
        self._write_steps()

    def _zeros(self, *shape: int) -> NDArray[Any]:
        """An array of zeros that begins at a cache line."""
        return aligned_zeros(shape, self._real)

    def _real_array(self, values: FloatArray) -> NDArray[Any]:
        array = self._zeros(*values.shape)
        array[:] = values
        return array

    def _write_materials(self) -> None:
        for organ, lump in enumerate(self.lumps):
            law, rows = lump.law, self.blocks.materials[:, organ]
            for row, value in (
                (nodal.C1, law.c1),
                (nodal.C2, law.c2),
                (nodal.TWICE_C3, 2.0 * law.c3),
                (nodal.GREATEST_SLOPE, law.greatest_slope),
                (nodal.REST_PRESSURE, law.rest_pressure),
                (nodal.BULK, law.bulk),
                (nodal.GROWTH, 3.0 * GROWTH),
                (nodal.STABILISER, STABILISER * law.shear),
                (nodal.VISCOUS_TIME, lump.viscous_time),
            ):
                rows[:, row] = value
            for term, (share, time) in enumerate(lump.material.relaxation):
                self.blocks.relaxation[:, organ, term, 0] = math.exp(-self.dt / time)
                self.blocks.relaxation[:, organ, term, 1] = share

    def _write_steps(self) -> None:
        """Divide the step of each world into substeps, as its stiffness and mass require."""
        lanes, count = len(self.blocks.lanes), len(self.blocks.positions)
        ratio = self._stiffness / self._mass_scale
        parts = np.stack([lump.substeps(self.dt, ratio) for lump in self.lumps], axis=1)
        most = int(parts.max())
        steps = np.zeros((count * lanes, len(self.lumps), most, nodal.STEP_ROWS))
        taken = np.arange(most) < parts[:, :, None]
        length = np.where(taken, self.dt / parts[:, :, None], 0.0)
        rows = steps[: self.worlds]
        rows[..., 0], rows[..., 1] = length, length * ratio[:, None, None]
        rows[..., 2] = length * self._gravity[:, None, None]
        rows[..., 3] = GIVEN_BACK * length / self.dt
        shaped = steps.reshape(count, lanes, *steps.shape[1:])
        substeps = np.ones((count * lanes, len(self.lumps)), dtype=np.int64)
        substeps[: self.worlds] = parts
        self.blocks = self.blocks._replace(
            steps=self._real_array(np.moveaxis(shaped, 1, -1)),
            substeps=substeps.reshape(count, lanes, -1).max(axis=1),
        )

    @property
    def substeps(self) -> IntArray:
        """(B, O) number of substeps in a step, for each block and organ (a copy)."""
        return self.blocks.substeps.copy()

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        mass_scale: ArrayLike | None = None,
        worlds: ArrayLike | None = None,
    ) -> None:
        """Change parameters of some worlds.

        Args:
            gravity: Downward acceleration [u/s2].
            stiffness: Factor on Young's modulus and viscosity, more than zero.
            mass_scale: Factor on density, more than zero.
            worlds: (n,) which, or (W,) a mask; all by default. A parameter is one number for all of them, or (n,).

        Raises:
            ValueError: If a value is not allowed; nothing has then changed.
        """
        indices = world_indices(worlds, self.worlds)
        checked = {
            name: one_each(value, name, indices)
            for name, value in (("gravity", gravity), ("stiffness", stiffness), ("mass_scale", mass_scale))
            if value is not None
        }
        for name in ("stiffness", "mass_scale"):
            if name in checked:
                refuse(checked[name] <= 0.0, indices, name, "more than zero", checked[name])
        for name, values in checked.items():
            getattr(self, f"_{name}")[indices] = values
        self._write_steps()

    @property
    def gravity(self) -> FloatArray:
        """(W,) downward acceleration (a copy) [u/s2]."""
        return self._gravity.copy()

    @property
    def stiffness(self) -> FloatArray:
        """(W,) factor on Young's modulus (a copy)."""
        return self._stiffness.copy()

    @property
    def inverse_masses(self) -> FloatArray:
        """(W, V) of the surface nodes [1/kg]; zero for a node that is held fixed."""
        surface = self.blocks.surface
        inverse: FloatArray = (~self._held / self._masses)[surface] / self._mass_scale[:, None]
        return inverse

    @property
    def finite(self) -> BoolArray:
        """(W,) whether all velocities were finite after the last step."""
        return np.asarray(self.blocks.finite.reshape(-1)[: self.worlds] == 0.0)

    def read(self, array: NDArray[Any], worlds: IntArray) -> FloatArray:
        """(n, ...) values of some worlds, of an array of blocks (B, ..., lanes); in double precision."""
        lanes = len(self.blocks.lanes)
        values: FloatArray = np.moveaxis(array, -1, 1)[worlds // lanes, worlds % lanes].astype(np.float64)
        return values

    def write(self, array: NDArray[Any], worlds: IntArray, values: ArrayLike) -> None:
        """Set the values (n, ...) of some worlds, in an array of blocks (B, ..., lanes)."""
        lanes = len(self.blocks.lanes)
        np.moveaxis(array, -1, 1)[worlds // lanes, worlds % lanes] = values

    def follow(self, surface: FloatArray) -> FloatArray:
        """(n, N, 3) positions of all nodes for surface nodes at (n, V, 3): inner nodes follow as a rigid body."""
        nodes = np.empty((len(surface), len(self.rest), 3))
        first = first_vertex = 0
        for lump in self.lumps:
            end, end_vertex = first + len(lump.masses), first_vertex + len(lump.surface)
            nodes[:, first:end] = follow_surface(
                self.rest[first:end], lump.surface, surface[:, first_vertex:end_vertex]
            )
            first, first_vertex = end, end_vertex
        return nodes


def _pair_table(solid: Solid) -> FloatArray:
    """(K, `nodal.PAIR_COLUMNS`) table of the pairs of neighbours."""
    return np.column_stack([solid.gradients, solid.reversed_gradients, solid.weights])


def _node_table(lump: Lump) -> FloatArray:
    """(N, `nodal.NODE_COLUMNS`) table of the nodes."""
    moves = ~lump.held
    return np.column_stack([moves / lump.masses, moves, lump.solid.shares, lump.solid.own_gradients])
