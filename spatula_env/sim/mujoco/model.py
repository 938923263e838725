"""A scene's organs in MuJoCo: a flex for each organ, and a body with three sliding joints for each of its nodes."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.sim.mujoco.flex import FlexOrgan
from spatula_env.sim.mujoco.loading import import_mujoco
from spatula_env.sim.mujoco.tools import ORGAN_GROUP, RADIUS, TOOL_GROUP, add_tools

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.scenes import Scene

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Axes of the joints of a node."""

NEO_HOOKEAN = 1
"""MuJoCo's number of the "simplified stable Neo-Hookean" solid, whose energy is that of `Material`'s "neo_hookean"."""

INERTIA = 1e-3
"""Rotational inertia of a node's body, by its mass [u2]: MuJoCo wants one, and nothing rotates."""


@dataclass(frozen=True, eq=False)
class FlexModel:
    """The organs of a scene in MuJoCo.

    Coordinates are positions of the nodes that move: those of all organs' surfaces first, then the inner ones.

    Attributes:
        organs: The organs.
        model: MuJoCo's `MjModel`; its time step is a substep.
        substeps: Number of substeps in a step.
        viscous_times: (3 (S + I),) for each coordinate, how long later its velocity brings it to where forces are taken
            [s].
        moving: (S,) which of the V surface nodes have the first S coordinates.
        inner: (I,) which of all N nodes have the other coordinates.
        surface: (V,) which of all N nodes are the organs' vertices.
        collides: Whether MuJoCo resolves contact with tools, which then are the last bodies.
    """

    organs: tuple[FlexOrgan, ...]
    model: Any
    substeps: int
    viscous_times: FloatArray
    moving: IntArray
    inner: IntArray
    surface: IntArray
    collides: bool

    @classmethod
    def of(cls, scene: Scene, *, collides: bool = False) -> FlexModel:
        """Build the model of a scene's organs.

        Args:
            scene: The scene.
            collides: Whether to add the tools, for contact by MuJoCo's own algorithm.

        Raises:
            ImportError: If MuJoCo is not installed, or Netgen where it is needed; says what to install.
            ValueError: If MuJoCo has no counterpart of a material, or an organ cannot be filled.
        """
        mujoco = import_mujoco()
        organs = tuple(FlexOrgan.of(placed, scene.scale) for placed in scene.organs)
        substeps = 1 if collides else max(organ.substeps(scene.dt) for organ in organs)
        first = np.cumsum([0, *(len(organ.nodes) for organ in organs)])
        surface = np.concatenate(
            [np.arange(len(organ.placed.organ.vertices)) + start for organ, start in zip(organs, first, strict=False)]
        )
        fixed = np.concatenate([organ.fixed for organ in organs])
        moving = np.flatnonzero(~fixed[surface])
        inner = np.setdiff1d(np.arange(first[-1]), surface)
        spec = _empty_spec(mujoco, scene.dt / substeps, scene.gravity, collides=collides)
        nodes, masses = (np.concatenate([getattr(organ, name) for organ in organs]) for name in ("nodes", "masses"))
        # The order of bodies is that of coordinates.
        for node in [*surface[moving].tolist(), *inner.tolist(), *np.flatnonzero(fixed).tolist()]:
            _add_node(mujoco, spec, node, nodes[node], float(masses[node]), moves=not fixed[node])
        for index, (organ, start) in enumerate(zip(organs, first.tolist(), strict=False)):
            _add_flex(mujoco, spec, index, organ, range(start, start + len(organ.nodes)), collides=collides)
        if collides:
            add_tools(mujoco, spec, scene)
        with warnings.catch_warnings():
            # Said of flexes without damping.
            warnings.filterwarnings("ignore", "flex .* has no equality constraints or passive forces", UserWarning)
            model = spec.compile()
        if not collides:
            # The model is compiled for another integrator, which its elements ask for; see `advance`.
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        times = np.repeat([organ.viscous_time for organ in organs], [len(organ.nodes) for organ in organs])
        coordinates = np.repeat(times[np.concatenate([surface[moving], inner])], 3)
        return cls(organs, model, substeps, coordinates, moving, inner, surface, collides)

    def advance(self, mujoco: Any, data: Any) -> None:
        """Advance a state of MuJoCo by a substep, by the semi-implicit Euler method.

        These are the stages of `mj_step` without constraints, which there are none of. `mj_step` itself has Neo-Hookean
        elements with implicit steps alone; contact needs forces as they are, see `docs/engines.md`. And it would write
        warnings of states that are not finite into a file.

        Forces are those at the positions that the nodes will have a viscous time later, as with the engine "tissue".
        With MuJoCo's own damping, which decomposes the stiffness of every element, a substep takes four times as long.

        Args:
            mujoco: The module.
            data: MuJoCo's `MjData`; written.
        """
        positions = data.qpos.copy()
        data.qpos += self.viscous_times * data.qvel
        mujoco.mj_fwdPosition(self.model, data)
        mujoco.mj_fwdVelocity(self.model, data)
        mujoco.mj_fwdAcceleration(self.model, data)
        data.qpos[:], data.qacc[:] = positions, data.qacc_smooth
        mujoco.mj_Euler(self.model, data)

    @property
    def rest(self) -> FloatArray:
        """(N, 3) all nodes at rest [u]."""
        nodes: FloatArray = np.concatenate([organ.nodes for organ in self.organs])
        return nodes

    @property
    def inverse_masses(self) -> FloatArray:
        """(V,) of the surface nodes [1/kg]; zero for a node that is fixed."""
        masses = np.concatenate([organ.masses for organ in self.organs])[self.surface]
        inverse = np.zeros(len(masses))
        inverse[self.moving] = 1.0 / masses[self.moving]
        return inverse


def _empty_spec(mujoco: Any, timestep: float, gravity: float, *, collides: bool) -> Any:
    """A model without bodies, in which diverged states are not reset, and that makes no contacts unless asked to."""
    spec, disable = mujoco.MjSpec(), mujoco.mjtDisableBit
    spec.option.timestep, spec.option.gravity = timestep, [0.0, 0.0, -gravity]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    # Without a warm start, a step depends on positions and velocities alone.
    own = disable.mjDSBL_WARMSTART if collides else disable.mjDSBL_CONSTRAINT | disable.mjDSBL_CONTACT
    spec.option.disableflags = int(own | disable.mjDSBL_SENSOR | disable.mjDSBL_AUTORESET)
    return spec


def _add_node(mujoco: Any, spec: Any, node: int, position: FloatArray, mass: float, *, moves: bool) -> None:
    """Add the body of a node, whose coordinates are its position."""
    body = spec.worldbody.add_body(
        name=f"node {node}", pos=position, mass=mass, inertia=[INERTIA * mass] * 3, explicitinertial=True
    )
    if moves:
        for axis, place in zip(AXES, position.tolist(), strict=True):
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, ref=place)


def _add_flex(mujoco: Any, spec: Any, index: int, organ: FlexOrgan, nodes: Sequence[int], *, collides: bool) -> None:
    """Add the elements of an organ, on the bodies of its nodes."""
    spec.add_flex(
        name=f"organ {index}",
        dim=3,
        vertbody=[f"node {node}" for node in nodes],
        elem=organ.tetrahedra.ravel().tolist(),
        young=organ.young_modulus,
        poisson=organ.material.poisson_ratio,
        elastic3d=NEO_HOOKEAN,
        # MuJoCo's own damping is that of the implicit step, by which its own contact comes.
        damping=organ.viscous_time if collides else 0.0,
        contype=ORGAN_GROUP if collides else 0,
        conaffinity=ORGAN_GROUP | TOOL_GROUP if collides else 0,
        radius=RADIUS,
        selfcollide=mujoco.mjtFlexSelf.mjFLEXSELF_NONE,
    )
