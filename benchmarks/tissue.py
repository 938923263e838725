"""Is tissue the material that it claims to be? Errors of the engine "tissue", each with its limit.

kernels        Forces of the compiled kernels against those of NumPy, for a bent organ in double precision.
patch          Patch test, an affine displacement of the seed's mesh: forces on inner nodes, relative to the greatest.
bar            A block pulled and pressed by up to 20 %, with free sides: nominal stress against the slope of the
               documented energy, for neo-Hookean tissue and brain.
shear          A block in simple shear of 0.1 and 0.2: shear stress, likewise.
block          A block pressed by 10 % between plates that it is glued to: force against felupe, another code.
plates         A sphere of 60 mm radius pressed between two frictionless plates: force against felupe.
hertz          The same, by 0.6 mm a side: felupe against Hertz's formula, the limit of small strain.
plate_meshes   The same with the second finest uniform mesh, against the finest.
refinement     The spatula pressed 10 mm into spheres of 362, 1,212 and 2,562 nodes, held at their base, with steps that
               are short enough for each: force of the second against the third.
coarse_mesh    The same, of the first against the third.
time_step      The same with half the time step.
modulus        The same with twice the modulus, which doubles the force, and twice the density, which keeps it.
volume         Loss of volume of a sphere pressed by 20 mm between the plates, at Poisson's ratio 0.49.
relaxation     Force of a sheared organ over 2.5 s against its Prony series.
momentum       Momentum that a free, swinging organ gains, relative to the sum of its nodes' momenta, in single
               precision.
energy         Energy that an elastic, swinging organ gains or loses in half a second.
steadiness     The organ of the palpation scene under its plate, 10 mm deep: variation of the force in half a second.
mujoco         The spatula pressed 2 and 5 mm into the seed's sphere, which is held at its base, at Poisson's ratio 0.3:
               force and nodes of the engine "mujoco" against the same linear tetrahedra in NumPy. How far the engine
               "tissue" is from it, whose elements are others, is for information.

"block", "plates" and "hertz" need felupe (`pip install felupe`). "plates", "plate_meshes", "refinement", "coarse_mesh",
"time_step", "modulus" and "volume" need Netgen (the extra `tissue`), and "mujoco" MuJoCo (the extra `mujoco`). "bar",
"shear" and "block" need SciPy.
Checks that cannot be made are reported, and the benchmark then does not pass.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks import elements, flexes, solids
from benchmarks.fidelity import Check
from benchmarks.measure import finish, parser
from spatula_env import scenes
from spatula_env.envs.scenery import with_short_steps
from spatula_env.geometry import Organ, Tool
from spatula_env.scenes import Material, PlacedOrgan, PlacedTool, Scale, Scene
from spatula_env.sim.mujoco.loading import import_mujoco
from spatula_env.sim.tissue.body import STABILISER, TissueBody
from spatula_env.sim.tissue.hyperelastic import Hyperelastic
from spatula_env.sim.tissue.kernels import advance_blocks
from spatula_env.sim.worlds import Worlds

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray

MATERIALS = {
    "neo_hookean 0.45": Material(),
    "neo_hookean 0.49": Material(poisson_ratio=0.49),
    "cortex": Material.brain("cortex"),
}
"""Materials of most checks of deformed solids, by name."""

STRETCHES, SHEARS = (0.8, 0.9, 1.1, 1.2), (0.1, 0.2)
CELLS = 4
"""Cells along each edge of a block under homogeneous strain."""

GLUED_CELLS = (4, 6, 8)
"""Cells along each edge of a block under inhomogeneous strain; the last number is judged."""

RADIUS = 3.0
"""Radius of the sphere [u], which is 60 mm."""

LENGTH = 0.02
"""Length of a scene unit [m]."""

SQUEEZES = (0.03, 0.1, 0.2, 0.3)
"""How far each side of the sphere is pressed in, each in a world of its own [u]."""

MESHES = {"162 nodes": (4, 0.0), "642": (8, 0.0), "642 graded": (8, 0.3), "2,562": (16, 0.0)}
"""Frequency and grading of spheres, the finest last; see `solids.graded_sphere`."""

REFINED = {"362 nodes": 6, "1,212": 11, "2,562": 16}
"""Frequencies of the spheres that the spatula is pressed into, the finest last."""

REFINED_DEPTH = 0.5
"""How deep [u]: 10 mm."""

USUAL = "642"
"""The mesh with which time step, modulus and density are varied."""

APPROACH, SETTLE, MEASURE = 1.0, 0.5, 0.4
"""Duration of a press, of the wait after it, and of the time over which the force is averaged [s]."""

CALMING = 2.0
"""Viscosity of the tissue between plates, so that it comes to rest [Pa s]. It does not change forces at rest."""

PRESSES = (0.1, 0.25)
"""How deep the spatula is pressed into the seed's sphere [u]."""

PRESSED = Material(poisson_ratio=0.3, viscosity=CALMING)
"""Material of that sphere. Linear tetrahedra lock at greater ratios."""

PRONY = ((0.3, 0.05), (0.2, 0.4))
"""Terms of a Prony series: share, and relaxation time [s]."""


@dataclass(frozen=True)
class Squeeze:
    """A sphere between two plates, at rest.

    Attributes:
        forces: (n,) mean force on a plate at each depth [N].
        ripple: (n,) standard deviation of the force over the averaging time [N].
        volumes: (n,) volume relative to that at rest.
    """

    forces: FloatArray
    ripple: FloatArray
    volumes: FloatArray


def squeeze(organ: Organ, material: Material, dt: float, squeezes: tuple[float, ...] = SQUEEZES) -> Squeeze:
    """Press a sphere between two frictionless plates that move symmetrically, so that it does not bounce between them.

    Args:
        organ: The sphere.
        material: Its material.
        dt: Length of a physics step [s].
        squeezes: How far each side is pressed in [u].

    Raises:
        ImportError: If Netgen is not installed; the message says what to install.
    """
    plate = Tool.box((8.0, 8.0, 0.5), 6)
    scene = Scene(
        organs=(PlacedOrgan(organ, position=(0.0, 0.0, RADIUS), material=material),),
        tools=tuple(
            PlacedTool(plate, position=(0.0, 0.0, height), friction=0.0) for height in (-1.0, 2.0 * RADIUS + 1.0)
        ),
        ground=None,
        gravity=0.0,
        dt=dt,
        scale=Scale(length=LENGTH, mass=0.1),
    )
    count = len(squeezes)
    worlds = Worlds(scene, count, engine="tissue", parallel=False)
    # The plates start at the highest and lowest nodes: the poles of the sphere need not be nodes.
    heights = worlds.nodes[0, :, 2]
    touching = np.array([[0.0, 0.0, heights.min() - 0.25], [0.0, 0.0, heights.max() + 0.25]])
    worlds.place_tools(np.tile(touching, (count, 1, 1)))
    steps = round(APPROACH / dt)
    ways = np.array(squeezes)[:, None, None] * [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]
    for step in range(steps):
        # A smooth profile: the speed rises from zero and falls to zero again.
        part = (1.0 - math.cos(2.0 * math.pi * (step + 0.5) / steps)) / (steps * dt)
        worlds.advance(ways * part)
    still = np.zeros((count, 2, 3))
    worlds.advance(still, steps=round(SETTLE / dt))
    forces = [worlds.advance(still).forces[:, 1, 2] * scene.scale.force for _ in range(round(MEASURE / dt))]
    found = Squeeze(np.mean(forces, axis=0), np.std(forces, axis=0), worlds.volumes[:, 0] / organ.volume)
    worlds.close()
    return found


def difference(found: FloatArray, expected: FloatArray) -> float:
    """Greatest difference, relative to the expected value."""
    return float(np.abs(np.asarray(found) / expected - 1.0).max())


def of_seed(material: Material, dt: float = 1e-4, dtype: type = np.float64) -> TissueBody:
    """The seed's organ in one world, free and without gravity."""
    return TissueBody(replace(scenes.seed(material=material, dt=dt), gravity=0.0), 1, lanes=1, dtype=dtype)


def read(body: TissueBody, name: str) -> FloatArray:
    """Read an array of the body's only world, with nodes or elements as its first axis."""
    found: FloatArray = body.read(getattr(body.blocks, name), np.array([0]))[0]
    return found


def put(body: TissueBody, nodes: FloatArray) -> None:
    """Set the nodes (N, 3) of the body's only world, with zero velocities."""
    body.write(body.blocks.positions, np.array([0]), nodes[None])
    body.write(body.blocks.velocities, np.array([0]), 0.0)


def kernel_forces(body: TissueBody, nodes: FloatArray) -> FloatArray:
    """(N, 3) forces on the nodes, from the momenta that one step of the kernels from rest gives them.

    The step must not be divided into substeps.
    """
    put(body, nodes)
    advance_blocks(0, 1, body.blocks)
    return np.asarray(read(body, "velocities") * body.lumps[0].masses[:, None] / body.dt)


def bent(body: TissueBody, amount: float) -> FloatArray:
    """(N, 3) the body's nodes at rest, displaced by a smooth bending field."""
    x, y, z = body.rest.T
    return np.asarray(body.rest + amount * np.column_stack([y * z, np.sin(x) + z, x * y - 0.3 * z**2]))


def check_kernels() -> Check:
    """Compare the kernels' forces with NumPy's."""
    details = {}
    for name, material in MATERIALS.items():
        body = of_seed(replace(material, viscosity=0.0))
        lump, nodes = body.lumps[0], bent(body, 0.02)
        expected = lump.solid.forces(
            lump.law.stress(lump.solid.deformations(nodes)), nodes, STABILISER * lump.law.shear
        )
        details[name] = float(np.abs(kernel_forces(body, nodes) - expected).max() / np.abs(expected).max())
    return Check(max(details.values()), 1e-9, details=details)


def check_patch() -> Check:
    """Patch test: under an affine displacement, forces on inner nodes vanish."""
    f, details = np.array([[1.1, 0.05, 0.0], [-0.04, 0.95, 0.1], [0.02, 0.0, 0.97]]), {}
    for name, material in MATERIALS.items():
        body = of_seed(replace(material, viscosity=0.0))
        forces = kernel_forces(body, body.rest @ f.T)
        inner = np.setdiff1d(np.arange(len(forces)), body.lumps[0].surface)
        details[name] = float(np.abs(forces[inner]).max() / np.abs(forces).max())
    return Check(max(details.values()), 1e-9, details=details)


def check_bar() -> Check:
    """Compare the stress of a block whose ends slide on plates with the slope of the minimised energy."""
    solid, details = solids.block(np.ones(3), (CELLS,) * 3), {}
    x, y, z = solid.nodes.T
    free = np.column_stack([x > 0.0, y > 0.0, (z > 0.0) & (z < 1.0)])
    for name, material in MATERIALS.items():
        law = Hyperelastic.of(material)
        for stretch in STRETCHES:
            _, forces = solids.equilibrium(solid, law, solid.nodes * [1.0, 1.0, stretch], free)
            found = float(-forces[z == 1.0, 2].sum())
            details[f"{name}, {stretch:g}"] = abs(found / solids.uniaxial_stress(material, stretch) - 1.0)
    return Check(max(details.values()), 0.01, details=details)


def check_shear() -> Check:
    """Compare the stress of a block whose surface is displaced as in simple shear with the slope of the energy."""
    solid, details = solids.block(np.ones(3), (CELLS,) * 3), {}
    inner = np.asarray(((solid.nodes > 0.0) & (solid.nodes < 1.0)).all(axis=1))
    for name, material in MATERIALS.items():
        law = Hyperelastic.of(material)
        for amount in SHEARS:
            start = solid.nodes + amount * solid.nodes[:, [2]] * [1.0, 0.0, 0.0]
            nodes, forces = solids.equilibrium(solid, law, start, np.repeat(inner[:, None], 3, axis=1))
            # The mean stress is the first moment of the surface's reactions over the volume, which is one.
            found = float(-(forces[:, 0] * solid.nodes[:, 2]).sum())
            apart = float(np.abs(nodes - start).max())
            expected = solids.shear_stress(material, amount)
            details[f"{name}, {amount:g}"] = max(abs(found / expected - 1.0), apart)
    return Check(max(details.values()), 0.01, details=details)


def check_block() -> Check:
    """Compare blocks glued to plates with felupe's elements of second order on the finest of their meshes."""
    details: dict[str, Any] = {}
    worst = 0.0
    for ratio in (0.45, 0.49):
        material = Material(young_modulus=1.0, poisson_ratio=ratio)
        law = Hyperelastic.of(material)
        found = {}
        for cells in GLUED_CELLS:
            solid = solids.block(np.ones(3), (cells,) * 3)
            z = solid.nodes[:, 2]
            free = np.repeat(((z > 0.0) & (z < 1.0))[:, None], 3, axis=1)
            _, forces = solids.equilibrium(solid, law, solid.nodes * [1.0, 1.0, 0.9], free)
            found[cells] = float(forces[z == 1.0, 2].sum())
        given = {(node, axis): 0.0 for node in np.flatnonzero((z == 0.0) | (z == 1.0)).tolist() for axis in range(3)}
        given |= {(node, 2): -0.1 for node in np.flatnonzero(z == 1.0).tolist()}
        _, total = elements.solve_tetrahedra(solid.nodes, solid.tetrahedra, law.shear, law.lame, given, 1)
        expected = float(-total[2])
        details[f"{ratio:g}"] = {
            "felupe": expected,
            **{f"{cells} cells": force / expected - 1.0 for cells, force in found.items()},
        }
        worst = max(worst, abs(found[GLUED_CELLS[-1]] / expected - 1.0))
    return Check(worst, 0.03, details=details)


def reference_forces(material: Material) -> FloatArray:
    """(n,) forces on the sphere between plates by felupe [N]."""
    law = Hyperelastic.of(material)
    return elements.press_sphere(law.shear, law.lame, [depth / RADIUS for depth in SQUEEZES]) * (RADIUS * LENGTH) ** 2


def hertz_forces(material: Material) -> FloatArray:
    """(n,) forces on the sphere between plates by Hertz's formula, for small strain [N]."""
    plane = material.young_modulus / (1.0 - material.poisson_ratio**2)
    depths = np.array(SQUEEZES) * LENGTH
    return np.asarray(4.0 / 3.0 * plane * np.sqrt(RADIUS * LENGTH) * depths**1.5)


def check_hertz() -> Check:
    """Compare felupe with Hertz's formula at the smallest depth; greater depths are for information."""
    ratios = reference_forces(MATERIALS["neo_hookean 0.45"]) / hertz_forces(MATERIALS["neo_hookean 0.45"])
    told = {f"{depth:g} u": float(ratio - 1.0) for depth, ratio in zip(SQUEEZES, ratios, strict=True)}
    return Check(abs(float(ratios[0]) - 1.0), 0.05, details=told)


class Spheres:
    """A cache of presses of spheres, which several checks share."""

    def __init__(self) -> None:
        """Start with an empty cache."""
        self._made: dict[tuple[str, Material, float], Squeeze] = {}

    def __call__(self, mesh: str, dt: float = 1.0 / 240.0, **changes: Any) -> Squeeze:
        """The press of one of `MESHES`, with some changes of the default material."""
        material = replace(Material(viscosity=CALMING), **changes)
        key = mesh, material, dt
        if key not in self._made:
            self._made[key] = squeeze(solids.graded_sphere(RADIUS, *MESHES[mesh]), material, dt)
        return self._made[key]


def check_plates(spheres: Spheres) -> Check:
    """Compare all meshes with felupe; judge the finest, at depths where the contact area is large beside its facets."""
    expected = reference_forces(MATERIALS["neo_hookean 0.45"])
    details: dict[str, Any] = {"felupe_newtons": expected.tolist()}
    for mesh in MESHES:
        made = spheres(mesh)
        details[mesh] = {"difference": (made.forces / expected - 1.0).tolist(), "ripple": made.ripple.tolist()}
    return Check(difference(spheres(list(MESHES)[-1]).forces[2:], expected[2:]), 0.05, details=details)


def check_plate_meshes(spheres: Spheres) -> Check:
    """Compare the second finest uniform mesh with the finest, at the greatest depth."""
    finest = spheres(list(MESHES)[-1]).forces[-1]
    told = {mesh: float(spheres(mesh).forces[-1] / finest - 1.0) for mesh in MESHES}
    return Check(abs(told[USUAL]), 0.05, details=told)


@cache
def refined_forces() -> dict[str, float]:
    """Forces on the spatula in each of `REFINED` [N]."""
    material = Material(viscosity=CALMING)
    forces = {}
    for mesh, frequency in REFINED.items():
        scene = with_short_steps(flexes.held_sphere(material, solids.geodesic_sphere(RADIUS, frequency)))
        forces[mesh] = flexes.press(scene, "tissue", REFINED_DEPTH).force
    return forces


def check_refined(index: int, limit: float) -> Check:
    """Compare the force on the spatula in one of the refined spheres with that in the finest."""
    forces = list(refined_forces().values())
    return Check(abs(forces[index] / forces[-1] - 1.0), limit, details=refined_forces())


def check_time_step(spheres: Spheres) -> Check:
    """Compare with half the time step."""
    usual, halved = (spheres(USUAL, dt).forces[1:] for dt in (1.0 / 240.0, 1.0 / 480.0))
    return Check(difference(usual, halved), 0.02, details={"newtons": usual.tolist(), "halved": halved.tolist()})


def check_modulus(spheres: Spheres) -> Check:
    """Twice the modulus doubles the force, and twice the density does not change it."""
    usual = spheres(USUAL).forces[1:]
    twice = spheres(USUAL, young_modulus=2.0 * Material().young_modulus, viscosity=2.0 * CALMING).forces[1:]
    heavy = spheres(USUAL, density=2.0 * Material().density).forces[1:]
    told = {"modulus": difference(twice, 2.0 * usual), "density": difference(heavy, usual)}
    return Check(max(told.values()), 0.01, details=told)


def check_volume() -> Check:
    """Loss of volume in a deep press of nearly incompressible tissue."""
    material = Material(poisson_ratio=0.49, viscosity=CALMING)
    organ = solids.graded_sphere(RADIUS, *MESHES[USUAL])
    lost = 1.0 - squeeze(organ, material, 1.0 / 240.0, (0.5,)).volumes
    return Check(float(np.abs(lost).max()), 0.02)


def check_relaxation() -> Check:
    """Compare the force that remains while an organ is held in shear with the Prony series."""
    body = of_seed(Material(viscosity=0.0, relaxation=PRONY), 1.0 / 240.0)
    nodes, lump = body.rest + [0.05, 0.0, 0.0] * body.rest[:, [2]], body.lumps[0]
    top = body.rest[:, 2] > body.rest[:, 2].mean()
    short = of_seed(Material(viscosity=0.0, relaxation=PRONY))
    whole = kernel_forces(short, nodes)[top, 0].sum()
    worst, told = 0.0, {}
    for step in range(1, 601):
        put(body, nodes)
        advance_blocks(0, 1, body.blocks)
        if step not in (12, 60, 240, 600):
            continue
        # The relaxed part of the stress is stored in the reference frame; forces come from the remaining stress.
        relaxed = read(body, "overstresses")
        symmetric = relaxed[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
        deformations = lump.solid.deformations(nodes)
        stress = lump.law.stress(deformations) - deformations @ symmetric
        left = lump.solid.forces(stress, nodes, STABILISER * lump.law.shear)[top, 0].sum() / whole
        time = step * body.dt
        expected = 1.0 - sum(share * (1.0 - math.exp(-time / tau)) for share, tau in PRONY)
        told[f"{time:g} s"] = {"left": float(left), "series": expected}
        worst = max(worst, abs(float(left) / expected - 1.0))
    return Check(worst, 0.03, details=told)


def _swing(viscosity: float, dtype: type) -> tuple[FloatArray, FloatArray]:
    """Momenta (s, 3) and energies (s,) of a free, swinging organ.

    Momenta are relative to the greatest sum, over time, of the magnitudes of the nodes' momenta.
    """
    body = of_seed(Material(viscosity=viscosity), 1.0 / 240.0, dtype)
    lump = body.lumps[0]
    put(body, bent(body, 0.005))
    nothing = np.zeros((len(lump.masses), 3, 3))
    momenta, sizes, energies = [], [], []
    for _ in range(120):
        before = read(body, "velocities")
        nodes = read(body, "positions")
        advance_blocks(0, 1, body.blocks)
        # Velocities are half a substep before and after the positions: their mean is at the same time.
        velocities = 0.5 * (before + read(body, "velocities"))
        stored = (lump.solid.shares * lump.law.energy(lump.solid.deformations(nodes))).sum()
        stored -= 0.5 * (lump.solid.forces(nothing, nodes, STABILISER * lump.law.shear) * nodes).sum()
        energies.append(stored + 0.5 * (lump.masses[:, None] * velocities**2).sum())
        momenta.append(lump.masses @ velocities)
        sizes.append(lump.masses @ np.linalg.norm(velocities, axis=1))
    return np.array(momenta) / max(sizes), np.array(energies)


def check_momentum() -> Check:
    """Momentum that a swinging organ gains, in single precision, the engine's default."""
    momenta, _ = _swing(0.0, np.float32)
    return Check(float(np.abs(momenta).max()), 1e-4)


def check_energy() -> Check:
    """Energy of a swinging organ without viscosity: mean over the last sixth of the time against the first.

    The same with viscosity is for information.
    """
    _, energies = _swing(0.0, np.float64)
    _, viscous = _swing(0.5, np.float64)
    kept = float(energies[-20:].mean() / energies[:20].mean())
    told = {"kept": kept, "viscous": float(viscous[-20:].mean() / viscous[:20].mean())}
    return Check(abs(kept - 1.0), 0.05, details=told)


def check_steadiness() -> Check:
    """Variation of the force on a plate that has been pressed 10 mm deep and stands still."""
    told: dict[str, Any] = {}
    for name in MATERIALS:
        scene = scenes.palpate(material=MATERIALS[name])
        worlds = Worlds(scene, 1, engine="tissue", parallel=False)
        top = float(worlds.nodes[0, :, 2].max()) + 0.0625
        worlds.place_tools(np.array([[[0.0, 0.0, top]]]))
        steps = round(1.0 / worlds.dt)
        worlds.advance(np.array([[[0.0, 0.0, -0.5]]]), steps=steps)
        still = np.zeros((1, 1, 3))
        worlds.advance(still, steps=steps)
        forces = [worlds.advance(still).forces[0, 0, 2] * scene.scale.force for _ in range(steps // 2)]
        told[name] = {"newtons": float(np.mean(forces)), "varies": float(np.std(forces) / np.mean(forces))}
        worlds.close()
    return Check(max(each["varies"] for each in told.values()), 0.03, details=told)


def check_mujoco() -> Check:
    """Compare a press with the engine "mujoco" with the same elements in NumPy: the greater of both differences.

    Raises:
        ImportError: If MuJoCo is not installed; the message says what to install.
    """
    import_mujoco()
    scene, worst = flexes.held_sphere(PRESSED), 0.0
    told: dict[str, Any] = {}
    for depth in PRESSES:
        found = flexes.press(scene, "mujoco", depth)
        with flexes.linear_engine() as name:
            differences = found.differs(flexes.press(scene, name, depth))
        tissue = flexes.press(scene, "tissue", depth)
        told[f"{depth * LENGTH * 1e3:g} mm"] = {
            "newtons": found.force,
            "varies": found.ripple,
            "force": differences[0],
            "nodes": differences[1],
            "newtons_of_tissue": tissue.force,
            "nodes_of_tissue": found.differs(tissue)[1],
        }
        worst = max(worst, *differences)
    return Check(worst, 0.03, details=told)


def checks() -> dict[str, Callable[[], Check]]:
    """All checks, by name."""
    spheres = Spheres()
    return {
        "kernels": check_kernels,
        "patch": check_patch,
        "bar": check_bar,
        "shear": check_shear,
        "block": check_block,
        "hertz": check_hertz,
        "plates": partial(check_plates, spheres),
        "plate_meshes": partial(check_plate_meshes, spheres),
        "refinement": partial(check_refined, 1, 0.05),
        "coarse_mesh": partial(check_refined, 0, 0.12),
        "time_step": partial(check_time_step, spheres),
        "modulus": partial(check_modulus, spheres),
        "volume": check_volume,
        "relaxation": check_relaxation,
        "momentum": check_momentum,
        "energy": check_energy,
        "steadiness": check_steadiness,
        "mujoco": check_mujoco,
    }


def main() -> None:
    """Measure and print."""
    available = checks()
    options = parser(__doc__ or "")
    options.add_argument("--checks", nargs="+", choices=tuple(available), default=list(available))
    arguments = options.parse_args()
    made: dict[str, Check] = {}
    missing: dict[str, str] = {}
    for name in arguments.checks:
        try:
            made[name] = available[name]()
        except ImportError as error:
            missing[name] = str(error)
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        if not arguments.json:
            check = made[name]
            verdict = "ok" if check.passed else "FAILS"
            print(
                f"{name:12} {check.value:10.3g} at most {check.threshold:g}   {verdict}   {check.details}", flush=True
            )
    finish(
        {
            "benchmark": "tissue",
            "passed": not missing and all(check.passed for check in made.values()),
            "felupe": elements.felupe_version(),
            "checks": {name: check.as_dict() for name, check in made.items()},
            "left_out": missing,
        }
    )


if __name__ == "__main__":
    main()
