"""Random plunges of the seed's spatula into the seed's organ: the cases of the tunnelling benchmark.

A case depends on two integers only, a seed and a number, and can be repeated from them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.inspection import ALLOWED, Inspection, Inspector
from spatula_env import Simulation, scenes
from spatula_env.geometry.transforms import (
    quaternion_from_axis_angle,
    quaternion_from_two_vectors,
    quaternion_multiply,
    rotate,
)
from spatula_env.sim import Report, SceneWarning, SimulationDiverged

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.sim.simulation import ContactName


SPEEDS = (0.1, 2000.0)
THICKNESSES = (0.02, 0.5)
STEPS = (1.0 / 480.0, 1.0 / 60.0)
"""Least and greatest speed [u/s], thickness [u] and length of a physics step [s]; their logarithms are drawn
uniformly."""

DEPTHS = (0.2, 2.0)
"""Least and greatest depth of the foremost point of the tool beyond the undeformed surface [u]."""

TILT = math.pi / 9.0
"""Greatest tilt of the tool [rad]."""

GAP = 0.05
"""Gap between the organ's surface and the foremost point of the tool at the start [u]. Small, because at 0.1 u/s a wide
one would take seconds."""

HOLD = 0.25
"""How long the tool is held at the end of its way [s]."""

FEWEST_HELD = 8
"""Least number of steps for which it is held."""

BACKWARDS = 0.5
"""A face is on the trailing side if the cosine of the angle between its normal and the tool's motion is below minus
this."""

ENTRIES = tuple((x, y, z) for y, x, z in product((-1, 0, 1), repeat=3) if 1 <= np.count_nonzero((x, y, z)) <= 2)
"""The parts of the box that may go first: its 6 faces and 12 edges, as signs of the tool's axes that point ahead."""


@dataclass(frozen=True)
class Plunge:
    """One case.

    Attributes:
        seed: Seed that the case was drawn with.
        number: Number of the case.
        direction: (3,) unit vector from the organ to where the tool comes from.
        entry: (3,) face or edge of the tool that goes first, as signs of the tool's axes.
        orientation: (4,) of the tool, quaternion xyzw.
        speed: Speed of the tool [u/s].
        thickness: Thickness of the tool [u].
        dt: Length of a physics step [s].
        depth: Depth of the foremost point of the tool beyond the undeformed surface at the end [u].
    """

    seed: int
    number: int
    direction: tuple[float, float, float]
    entry: tuple[int, int, int]
    orientation: tuple[float, float, float, float]
    speed: float
    thickness: float
    dt: float
    depth: float

    @property
    def moving_steps(self) -> int:
        """Number of physics steps until the tool has reached its depth."""
        return math.ceil((self.depth + GAP) / (self.speed * self.dt) - 1e-9)

    @property
    def held_steps(self) -> int:
        """Number of physics steps for which it is then held."""
        return max(int(HOLD / self.dt), FEWEST_HELD)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Outcome:
    """Result of one case. Counts are numbers of steps, all of which are inspected.

    Attributes:
        plunge: The case.
        contact: The contact model.
        missed: Steps in which a contact node was deeper than `ALLOWED` in the organ, or the tool's centre was inside,
            and no flag was set.
        enclosed: Steps in which the tool's centre or a whole column of it was inside the organ; see `Inspection`.
        passages: Steps in which a vertex of the organ went right through the tool, with the organ's outside ahead.
        turned: Steps in which one did with the organ's inside ahead. Not a failure of contact: the organ turned inside
            out.
        pairs: Steps in which both nodes of an opposite pair were flagged.
        trailing: Number of flagged nodes on trailing faces when the tool reached its depth. Not a failure by itself: an
            organ may fold over a tool.
        residual: Greatest of the inspection's depths of the tool in the organ and of the organ in the tool, over all
            steps [u].
        final_residual: The same in the last step [u].
        shaking: Root mean square speed of the organ's nodes about their mean velocity in the last step, after the tool
            has been at rest for a while; NaN if the simulation diverged [u/s]. For information.
        non_finite: Whether the simulation diverged.
        steps: Number of steps made.
    """

    plunge: Plunge
    contact: str
    missed: int
    enclosed: int
    passages: int
    turned: int
    pairs: int
    trailing: int
    residual: float
    final_residual: float
    shaking: float
    non_finite: bool
    steps: int

    @property
    def wrong_side(self) -> bool:
        """Whether some of the organ's surface was, or came to be, on the far side of the tool in any step."""
        return self.enclosed > 0 or self.passages > 0

    @property
    def failed(self) -> bool:
        """Whether contact was missed, doubled or lost in any step, or the simulation diverged."""
        return bool(self.missed or self.wrong_side or self.pairs or self.non_finite or self.residual > ALLOWED)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        shaking = None if self.non_finite else self.shaking
        return {**asdict(self), "shaking": shaking, "wrong_side": self.wrong_side, "failed": self.failed}


@dataclass
class Tally:
    """Accumulates the inspections of one case.

    Attributes:
        opposite: (n,) index of the opposite of each contact node of the tool.
        missed: See `Outcome`, as for the other attributes.
    """

    opposite: NDArray[np.int32]
    missed: int = 0
    enclosed: int = 0
    passages: int = 0
    turned: int = 0
    pairs: int = 0
    residual: float = 0.0
    final_residual: float = 0.0

    def add(self, flags: NDArray[np.bool_], seen: Inspection) -> None:
        """Count one step.

        Args:
            flags: (n,) flags of the contact nodes.
            seen: Inspection after the step.
        """
        self.missed += bool((seen.node_depth > ALLOWED or seen.centre_inside) and not flags.any())
        self.enclosed += seen.centre_inside or seen.enclosed > 0
        self.passages += seen.passages > 0
        self.turned += seen.turned > 0
        self.pairs += bool((flags & flags[self.opposite]).any())
        self.residual = max(self.residual, seen.residual)
        self.final_residual = seen.residual


def draw(seed: int, number: int) -> Plunge:
    """Draw a case.

    Args:
        seed: Seed of the benchmark.
        number: Number of the case.

    Returns:
        The case, which is always the same for the same two integers.
    """
    generator = np.random.default_rng([seed, number])
    direction = generator.normal(size=3)
    direction /= np.linalg.norm(direction)
    thickness = _draw_logarithmic(generator, THICKNESSES)
    speed = _draw_logarithmic(generator, SPEEDS)
    dt = _draw_logarithmic(generator, STEPS)
    depth = generator.uniform(*DEPTHS)
    entry = ENTRIES[generator.integers(len(ENTRIES))]
    tilt = generator.uniform(0.0, TILT)
    tilt_axis = generator.normal(size=3)
    turn = quaternion_from_axis_angle(direction, generator.uniform(0.0, 2.0 * math.pi))
    orientation = quaternion_multiply(turn, quaternion_from_two_vectors(entry, -direction))
    orientation = quaternion_multiply(quaternion_from_axis_angle(tilt_axis, tilt), orientation)
    x, y, z = direction.tolist()
    qx, qy, qz, qw = orientation.tolist()
    return Plunge(
        seed=seed,
        number=number,
        direction=(x, y, z),
        entry=entry,
        orientation=(qx, qy, qz, qw),
        speed=speed,
        thickness=thickness,
        dt=dt,
        depth=depth,
    )


def run(
    plunge: Plunge,
    contact: ContactName = "flags",
    watch: Callable[[int, Simulation, Report, Inspection], None] | None = None,
    engine: str | None = None,
) -> Outcome:
    """Drive the tool into the organ, hold it there, and inspect every step.

    The tool comes from anywhere, also from below: the ground holds the organ and lets the tool through. The organ is
    free, so a slow tool may push it away before it gets deep. No case is cut short: the longest takes 20 s of simulated
    time, the mean less than two.

    Args:
        plunge: The case.
        contact: The contact model.
        watch: Called after each step with its index, the simulation, its report and the inspection.
        engine: Engine that integrates the organ; None for the default.

    Returns:
        The result.
    """
    scene = scenes.seed(tool_size=(1.0, 1.0, plunge.thickness), dt=plunge.dt, faces="all")
    tool = scene.tools[0].tool
    with warnings.catch_warnings():
        # With other time steps than the seed's the sphere keeps rolling, which triggers a warning but is harmless here.
        warnings.simplefilter("ignore", SceneWarning)
        simulation = Simulation(scene, engine=engine, contact=contact, precision="double")
    inspector = Inspector(tool, simulation.triangles)
    tally = Tally(tool.opposite)
    direction, orientation = np.array(plunge.direction), np.array(plunge.orientation)
    nodes = simulation.nodes
    middle = nodes.mean(axis=0)
    surface = float(((nodes - middle) @ direction).max())
    foremost = float((rotate(orientation, tool.vertices) @ -direction).max())
    looks_back = rotate(orientation, tool.normals) @ direction > BACKWARDS
    trailing, shaking, non_finite = 0, math.nan, False
    step = 0
    left = plunge.depth + GAP
    try:
        simulation.place_tool(middle + (surface + foremost + GAP) * direction, orientation)
        inspector.inspect(simulation.tool_position, orientation, nodes)
        for step in range(plunge.moving_steps + plunge.held_steps):
            speed = min(plunge.speed, left / plunge.dt) if step < plunge.moving_steps else 0.0
            left -= speed * plunge.dt
            report = simulation.step(-speed * direction)
            nodes, flags = simulation.nodes, report.contacts.flags
            if not (np.isfinite(nodes).all() and np.isfinite(report.force).all()):
                non_finite = True
                break
            seen = inspector.inspect(simulation.tool_position, simulation.tool_orientation, nodes)
            tally.add(flags, seen)
            if step == plunge.moving_steps - 1:
                trailing = int((flags & looks_back).sum())
            if watch is not None:
                watch(step, simulation, report, seen)
        shaking = _shaking(simulation.node_masses, simulation.node_velocities)
    except SimulationDiverged:
        non_finite = True
    finally:
        simulation.close()
    return Outcome(
        plunge=plunge,
        contact=contact,
        missed=tally.missed,
        enclosed=tally.enclosed,
        passages=tally.passages,
        turned=tally.turned,
        pairs=tally.pairs,
        trailing=trailing,
        residual=tally.residual,
        final_residual=tally.final_residual,
        shaking=shaking,
        non_finite=non_finite,
        steps=step + 1,
    )


def _draw_logarithmic(generator: np.random.Generator, limits: tuple[float, float]) -> float:
    """Draw a number between two limits whose logarithm is uniformly distributed."""
    low, high = limits
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def _shaking(masses: FloatArray, velocities: FloatArray) -> float:
    """Root mean square speed of masses (V,) with velocities (V, 3) about their mean velocity."""
    about_mean = velocities - masses @ velocities / masses.sum()
    return math.sqrt(float(masses @ (about_mean**2).sum(axis=1) / masses.sum()))
