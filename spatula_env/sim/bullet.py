"""PyBullet's classic soft world, as an engine.

Facts about PyBullet 3.2.7 that shape this file. In the classic world (`resetSimulation(0)`) an external force on a
node acts on it alone, in the next step; `resetMeshData` sets positions and leaves velocities; there is no call that
reads or sets a velocity, but after a step a node's velocity is exactly its displacement over the time step. Meshes
are read from a file in single precision, so positions are set again after loading. `saveState` ignores soft bodies;
`resetMeshData` never releases its references to the sequences it is given.

A soft body whose triangles are not all connected by edges never gets through its first step: Bullet builds a tree by
joining neighbours (`buildTreeBottomUp`) until one is left, which then never happens. So each part of an organ is a
separate body. A simulated surface is loaded together with one for rendering, and `extrapolateBarycentricWeights`
searches the nearest triangle of the first for every vertex of the second, which takes minutes for ten thousand of them.
So the surface for rendering, which is never rendered here, is a single triangle.
"""

from __future__ import annotations

import ctypes
import operator
import struct
import sys
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain, combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.engines import import_bullet
from spatula_env.geometry.parts import Part, describe_parts, organ_parts
from spatula_env.geometry.transforms import rotate
from spatula_env.sim.engine import Abilities
from spatula_env.sim.exchange import forces_of_changes, velocities_of_positions
from spatula_env.sim.soft_body import SWEEPS, node_masses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry.meshes import Organ
    from spatula_env.scenes import PlacedTool, Scene
    from spatula_env.sim.engine import EngineOptions

    FloatArray = NDArray[np.float64]

SCRUB_SHIFT = float(2**20)
"""Distance at which the product of a rounding error of a velocity and a time step vanishes beside a position [u]."""

TOOL_TO_ORGAN_MASS = 1e6
"""Mass of a tool that Bullet itself collides with, in organ masses: its velocity then changes only by rounding."""

MOST_NODES = 46_340
"""Largest number of nodes in a soft body: Bullet keeps a table of all pairs of nodes, and counts them in 32 bits."""

DRAWN = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
"""The triangle that Bullet is given for rendering, as an OBJ file."""


class BulletWorld:
    """Soft bodies in one PyBullet world.

    Bullet integrates the organs: gravity, links, bending. Ground and, except with `contact="bullet"`, tools are absent
    from Bullet's world: contact with them is resolved by `spatula_env.contact`.
    """

    def __init__(self, scene: Scene, *, with_tools: bool = False) -> None:
        """Load the scene's organs, at rest in their initial shape.

        Args:
            scene: What to load.
            with_tools: Whether the tools are in Bullet's world, so that Bullet's own algorithm resolves their contact.

        Raises:
            ImportError: If PyBullet is not installed; says what to install.
            RuntimeError: If PyBullet offers no further physics server.
            ValueError: If an organ is one that Bullet cannot simulate.
        """
        pybullet = import_bullet("Bullet's soft body")
        parts = [_check_parts(placed.organ) for placed in scene.organs]
        self._bullet: Any = pybullet
        self._client: int = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet could not start another physics server; close() simulations no longer needed")
        # A client takes some 30 MB: they are freed with this object, even if it is never closed.
        self._disconnect = weakref.finalize(self, pybullet.disconnect, self._client)
        # Bullet integrates soft bodies, though not rigid ones, with the time step in single precision.
        self._dt = float(np.float32(scene.dt))
        self._gravity = scene.gravity
        bullet, client = pybullet, self._client
        bullet.resetSimulation(0, physicsClientId=client)
        bullet.setTimeStep(scene.dt, physicsClientId=client)
        bullet.setGravity(0.0, 0.0, -scene.gravity, physicsClientId=client)
        self._bodies: list[int] = []
        self._slices: list[slice] = []
        masses: list[FloatArray] = []
        order: list[NDArray[np.int64]] = []
        start = first = 0
        for placed, pieces in zip(scene.organs, parts, strict=True):
            # Masses as Bullet computes them: otherwise forces that should cancel a velocity would leave a part of it.
            organ_masses = node_masses(placed.organ, placed.mass)
            for part in pieces:
                # An organ of one part gets exactly the mass that is requested: a sum would be rounded.
                mass = placed.mass if len(pieces) == 1 else float(organ_masses[part.nodes].sum())
                self._bodies.append(self._load(placed.organ, part, mass))
                self._slices.append(slice(start, start + len(part.nodes)))
                start += len(part.nodes)
                masses.append(organ_masses[part.nodes])
                order.append(first + part.nodes)
            first += len(placed.organ.vertices)
        # The nodes of a part need not be consecutive in the organ, but they are within this object.
        node_order = np.concatenate(order)
        in_order = bool((node_order == np.arange(start)).all())
        self._order: NDArray[np.int64] | None = None if in_order else node_order
        self._back: NDArray[np.int64] | None = None if in_order else np.argsort(node_order)
        self._masses: FloatArray = np.concatenate(masses)
        inverse_masses: FloatArray = 1.0 / self._masses
        places, first = np.arange(start) if self._back is None else self._back, 0
        for placed in scene.organs:
            for node in placed.fixed_nodes:
                place = int(places[first + node])
                index = self._body_of(place)
                bullet.createSoftBodyAnchor(
                    self._bodies[index], place - self._slices[index].start, -1, -1, physicsClientId=client
                )
                inverse_masses[place] = 0.0
            first += len(placed.organ.vertices)
        self._inverse_masses = self._to_scene(inverse_masses)
        self._unpack = [struct.Struct(f"{3 * (part.stop - part.start)}d") for part in self._slices]
        self._positions: FloatArray = self._from_scene(np.concatenate([placed.vertices for placed in scene.organs]))
        self._velocities: FloatArray = np.zeros_like(self._positions)
        self._displacements: FloatArray = np.zeros_like(self._positions)
        self._pushed = np.zeros(start, dtype=np.int64)
        self._forces = np.zeros((start, 3))
        self._initial = self._positions.copy()
        # This package resolves contact between organs, as it does with tools, unless Bullet's own algorithm is used.
        for first, second in combinations(self._bodies, 2) if not with_tools else ():
            bullet.setCollisionFilterPair(first, second, -1, -1, 0, physicsClientId=client)
        self.tools = BulletTools(bullet, client, scene) if with_tools else None
        self._set_state(self._positions)

    def _load(self, organ: Organ, part: Part, mass: float) -> int:
        """Hand a part of a surface to PyBullet through a file, the only way it takes one."""
        with tempfile.TemporaryDirectory(prefix="spatula_env-") as folder:
            drawn, simulated = Path(folder, "drawn.obj"), Path(folder, "simulated.obj")
            drawn.write_text(DRAWN, encoding="ascii")
            with simulated.open("w", encoding="ascii") as file:
                file.writelines(f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in organ.vertices[part.nodes])
                file.writelines(f"f {a} {b} {c}\n" for a, b, c in part.triangles + 1)
            body: int = self._bullet.loadSoftBody(
                str(drawn),
                simFileName=str(simulated),
                mass=mass,
                useMassSpring=1,
                useBendingSprings=1,
                physicsClientId=self._client,
            )
        count, _ = self._bullet.getMeshData(
            body, -1, flags=self._bullet.MESH_DATA_SIMULATION_MESH, physicsClientId=self._client
        )
        if count != len(part.nodes):
            raise RuntimeError(f"PyBullet made {count} nodes of the {len(part.nodes)} of organ {organ.name!r}")
        return body

    def _body_of(self, place: int) -> int:
        """Index of the body that has the node at a place in the order of this object."""
        return next(k for k, part in enumerate(self._slices) if place < part.stop)

    def _from_scene(self, values: FloatArray) -> FloatArray:
        """Values of the nodes (V, ...) in the order of this object, from that of the scene."""
        return values if self._order is None else values[self._order]

    def _to_scene(self, values: FloatArray) -> FloatArray:
        """Values of the nodes (V, ...) in the scene's order, from that of this object."""
        return values if self._back is None else values[self._back]

    @property
    def inverse_masses(self) -> FloatArray:
        """(V,) of the nodes [1/kg]; zero for a node that is held fixed."""
        return self._inverse_masses

    def step(self, positions: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Advance by one time step, from where the last step or `set_state` ended or close to that.

        Args:
            positions: (V, 3) of the nodes at the start of the step [u].
            velocities: (V, 3) [u/s].

        Returns:
            Positions (V, 3) [u] and velocities (V, 3) [u/s] at the end of the step; not to be written to.

        Raises:
            FloatingPointError: If they are not finite.
        """
        bullet, client = self._bullet, self._client
        positions, velocities = self._from_scene(positions), self._from_scene(velocities)
        displacements, velocity_changes = positions - self._positions, velocities - self._velocities
        # Displacing a node by a force leaves its velocity wrong by the displacement over the time step, until the
        # next forces. It costs a third of what resetMeshData does, and Bullet looks at positions only in between.
        count = forces_of_changes(
            velocity_changes, displacements, self._displacements, self._masses, self._dt, self._pushed, self._forces
        )
        self._push(count)
        bullet.stepSimulation(client)
        positions, velocities = np.empty_like(positions), np.empty_like(positions)
        self._read(positions)
        if not velocities_of_positions(self._positions, displacements, positions, self._dt, velocities):
            raise FloatingPointError("Bullet's nodes are not finite")
        self._positions, self._velocities = positions, velocities
        self._displacements = displacements
        return self._to_scene(positions), self._to_scene(velocities)

    def _read(self, positions: FloatArray) -> None:
        """Get the positions of all nodes."""
        bullet, client = self._bullet, self._client
        for body, part, unpack in zip(self._bodies, self._slices, self._unpack, strict=True):
            rows = bullet.getMeshData(body, -1, flags=bullet.MESH_DATA_SIMULATION_MESH, physicsClientId=client)[1]
            # struct is the fastest way from nested tuples to an array: a third of the time of numpy.array.
            unpack.pack_into(positions[part].data, 0, *chain.from_iterable(rows))

    def _push(self, count: int) -> None:
        """Apply the first `count` forces."""
        push, client, frame = self._bullet.applyExternalForce, self._client, self._bullet.WORLD_FRAME
        nodes, forces, origin = self._pushed[:count].tolist(), self._forces[:count].tolist(), (0.0, 0.0, 0.0)
        body, part = self._bodies[0], self._slices[0]
        for node, force in zip(nodes, forces, strict=True):
            if node >= part.stop:
                index = self._body_of(node)
                body, part = self._bodies[index], self._slices[index]
            push(body, node - part.start, force, origin, frame, client)

    def _write(self, positions: FloatArray) -> None:
        """Set the positions of all nodes."""
        for body, part in zip(self._bodies, self._slices, strict=True):
            rows = positions[part].tolist()
            with _given_back([rows, *rows]):
                self._bullet.resetMeshData(body, rows, physicsClientId=self._client)

    def set_state(self, positions: FloatArray) -> None:
        """Set the positions (V, 3) of the nodes, at rest [u]; what follows does not depend on the previous state."""
        self._set_state(self._from_scene(positions))

    def _set_state(self, positions: FloatArray) -> None:
        """Set all positions, in the order of this object, and erase the velocities.

        Bullet's velocities cannot be set, only changed by forces, and a velocity that is changed to the wanted one
        keeps a rounding error that depends on its previous value. So the bodies first make one step far away, without
        gravity and with their velocities cancelled: there the remaining velocity times the time step is too small to
        change a position, so the step's outcome, and the velocity after it, are the same whatever was before.
        """
        bullet, client = self._bullet, self._client
        far = self._initial + SCRUB_SHIFT
        nothing = np.zeros_like(far)
        self._push(
            forces_of_changes(
                -self._velocities, nothing, self._displacements, self._masses, self._dt, self._pushed, self._forces
            )
        )
        self._write(far)
        bullet.setGravity(0.0, 0.0, 0.0, physicsClientId=client)
        bullet.stepSimulation(client)
        bullet.setGravity(0.0, 0.0, -self._gravity, physicsClientId=client)
        velocities_left = np.empty_like(far)
        self._read(velocities_left)
        velocities_left = (velocities_left - far) / self._dt
        self._write(positions)
        self._positions = np.array(positions)
        self._displacements = nothing
        self._velocities = velocities_left

    def close(self) -> None:
        """Free Bullet's world. Closing twice is allowed."""
        self._disconnect()
        self._client = -1


def _check_parts(organ: Organ) -> tuple[Part, ...]:
    """The parts of an organ, after a check that Bullet can simulate each of them."""
    parts = organ_parts(organ)
    for part in parts:
        if part.sheets > 1:
            raise ValueError(
                f"organ {organ.name!r} must not have parts that meet in a vertex, or engine 'bullet' would never come "
                f"through a step, but one with {len(part.nodes)} nodes, node {part.nodes[0]} among them, consists of "
                f"{part.sheets} such parts; move them apart, or use engine 'batch'"
            )
        if len(part.nodes) > MOST_NODES:
            raise ValueError(
                f"organ {organ.name!r} must have at most {MOST_NODES} nodes in a part with engine 'bullet', got "
                f"{describe_parts([part])}; use a coarser surface, or engine 'batch'"
            )
    return parts


@contextmanager
def _given_back(objects: Sequence[object]) -> Iterator[None]:
    """Release the references to objects that a call in the ``with`` block acquires and never releases.

    Args:
        objects: The objects, each listed once.
    """
    # Counted in the same way both times, so that the references held by the counting itself cancel out.
    before = list(map(sys.getrefcount, objects))
    try:
        yield
    finally:
        after = list(map(sys.getrefcount, objects))
        for one, kept in zip(objects, map(operator.sub, after, before), strict=True):
            for _ in range(kept):
                ctypes.pythonapi.Py_DecRef(ctypes.py_object(one))


class BulletEngine:
    """One PyBullet world for each world, stepped one after the other; see `engine.CollidingEngine`.

    Attributes:
        loaded: (W,) the PyBullet worlds.
    """

    abilities = Abilities(
        contacts=("flags", "second_step", "bullet"), restores_exactly=False, springs=True, sweeps=SWEEPS
    )

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        """See `engine.Engine`; for what this raises, see `BulletWorld`."""
        self._scene, self._with_tools = scene, options.contact == "bullet"
        self.loaded: list[BulletWorld] = []
        try:
            for _ in range(worlds):
                self.loaded.append(self._load(scene))
        except BaseException:
            self.close()
            raise

    def _load(self, scene: Scene) -> BulletWorld:
        return BulletWorld(scene, with_tools=self._with_tools)

    @property
    def inverse_masses(self) -> FloatArray:
        """See `engine.Engine`."""
        return np.stack([world.inverse_masses for world in self.loaded])

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: NDArray[np.bool_]) -> None:
        """See `engine.Engine`."""
        for w in np.flatnonzero(~diverged).tolist():
            try:
                positions[w], velocities[w] = self.loaded[w].step(positions[w], velocities[w])
            except FloatingPointError:
                diverged[w] = True

    def halt(self, positions: FloatArray, worlds: NDArray[np.int64]) -> None:
        """See `engine.Engine`."""
        for row, w in enumerate(worlds.tolist()):
            self.loaded[w].set_state(positions[row])

    def save(self, worlds: NDArray[np.int64]) -> tuple[None, ...]:
        """See `engine.Engine`: all nodes are surface nodes, so there is nothing else to save."""
        return (None,) * len(worlds)

    def restore(
        self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: NDArray[np.int64]
    ) -> None:
        """See `engine.Engine`; the next step gives the nodes their velocities, by forces."""
        self.halt(positions, worlds)

    def close(self) -> None:
        """See `engine.Engine`."""
        for world in self.loaded:
            world.close()

    def set_tools(self, tools: Sequence[PlacedTool], world: int) -> None:
        """See `engine.CollidingEngine`: Bullet cannot exchange the shape of a body, so the world is loaded anew."""
        self.loaded[world].close()
        self.loaded[world] = self._load(replace(self._scene, tools=tuple(tools)))

    def place_tools(self, positions: FloatArray, orientations: FloatArray, world: int) -> None:
        """See `engine.CollidingEngine`."""
        self._tools(world).place(positions, orientations)

    def move_tools(
        self, positions: FloatArray, orientations: FloatArray, linear: FloatArray, angular: FloatArray, world: int
    ) -> None:
        """See `engine.CollidingEngine`."""
        self._tools(world).move(positions, orientations, linear, angular)

    def tool_impulses(self, linear: FloatArray, angular: FloatArray, world: int) -> FloatArray:
        """See `engine.CollidingEngine`."""
        return self._tools(world).impulses(linear, angular)

    def _tools(self, world: int) -> BulletTools:
        tools = self.loaded[world].tools
        assert tools is not None
        return tools


class BulletTools:
    """The scene's tools as rigid bodies in Bullet's world, for `contact="bullet"`.

    A tool is a free body far heavier than the organs, whose pose and velocity are set before each step. Bullet's
    contacts then treat it like a kinematic body, and the slight change of its velocity gives the impulse, which Bullet
    does not report.
    """

    def __init__(self, bullet: Any, client: int, scene: Scene) -> None:
        """Create the scene's tools."""
        self._bullet, self._client = bullet, client
        self._dt, self._gravity = scene.dt, np.array([0.0, 0.0, -scene.gravity])
        self._mass = TOOL_TO_ORGAN_MASS * sum(placed.mass for placed in scene.organs)
        self._bodies = [self._create(placed) for placed in scene.tools]
        self._inertia = [np.array(bullet.getDynamicsInfo(body, -1, client)[2]) for body in self._bodies]

    def _create(self, placed: PlacedTool) -> int:
        bullet, client, tool = self._bullet, self._client, placed.tool
        half = 0.5 * tool.size
        if len(tool.vertices) == 8 and np.allclose(np.abs(tool.vertices), half, rtol=0.0, atol=1e-12):
            shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half.tolist(), physicsClientId=client)
        else:
            shape = bullet.createCollisionShape(
                bullet.GEOM_MESH, vertices=tool.vertices.tolist(), physicsClientId=client
            )
        body: int = bullet.createMultiBody(self._mass, shape, useMaximalCoordinates=1, physicsClientId=client)
        bullet.changeDynamics(
            body,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            lateralFriction=placed.friction,
            physicsClientId=client,
        )
        return body

    def place(self, positions: FloatArray, orientations: FloatArray) -> None:
        """Set the poses of the tools, at rest."""
        for body, position, orientation in zip(self._bodies, positions.tolist(), orientations.tolist(), strict=True):
            self._bullet.resetBasePositionAndOrientation(body, position, orientation, physicsClientId=self._client)

    def move(self, positions: FloatArray, orientations: FloatArray, linear: FloatArray, angular: FloatArray) -> None:
        """Give the tools the poses that they have at the end of the coming step, and their velocities."""
        self.place(positions, orientations)
        # Gravity acts on tools too; the velocity that it will add is subtracted beforehand.
        linear = linear - self._gravity * self._dt
        for body, speed, rate in zip(self._bodies, linear.tolist(), angular.tolist(), strict=True):
            self._bullet.resetBaseVelocity(body, speed, rate, physicsClientId=self._client)

    def impulses(self, linear: FloatArray, angular: FloatArray) -> FloatArray:
        """(N, 6) linear [kg u/s] and angular [kg u2/s2] impulses that contacts gave the tools in the last step."""
        impulses, inverse = np.empty((len(self._bodies), 6)), np.array([-1.0, -1.0, -1.0, 1.0])
        for k, body in enumerate(self._bodies):
            after_linear, after_angular = self._bullet.getBaseVelocity(body, physicsClientId=self._client)
            orientation = np.array(self._bullet.getBasePositionAndOrientation(body, physicsClientId=self._client)[1])
            turned = rotate(orientation * inverse, np.subtract(after_angular, angular[k]))
            impulses[k, :3] = self._mass * np.subtract(after_linear, linear[k])
            impulses[k, 3:] = rotate(orientation, self._inertia[k] * turned)
        return impulses
