"""Random plunges of the seed's spatula into the seed's organ: one case of the tunnelling benchmark.

A case is made from two integers, a seed and a number, and from nothing else.
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
"""Least and greatest speed [u/s], thickness [u] and length of a physics step [s]; drawn evenly in their logarithms."""

DEPTHS = (0.2, 2.0)
"""How far beyond the undeformed surface the foremost point of the tool gets [u]."""

TILT = math.pi / 9.0
"""Greatest tilt of the tool [rad]."""

GAP = 0.05
"""Between the organ's surface and the foremost point of the tool at the start [u]. Small, because at 0.1 u/s a wide one
would take seconds."""

HOLD = 0.25
"""How long the tool stays where it has got to [s]."""

FEWEST_HELD = 8
"""Steps of holding at least."""

BACKWARDS = 0.5
"""A face looks back where its normal and the way the tool moves have a cosine below minus this."""

ENTRIES = tuple((x, y, z) for y, x, z in product((-1, 0, 1), repeat=3) if 1 <= np.count_nonzero((x, y, z)) <= 2)
"""What of the box goes first: its 6 faces and 12 edges, as the signs of the axes that look ahead."""


@dataclass(frozen=True)
class Plunge:
    """One case.

    Attributes:
        seed: It was drawn with this seed,
        number: and is the one of this number.
        direction: (3,) from the organ to where the tool comes from, of unit length.
        entry: (3,) which face or edge of the tool goes first, in signs of the tool's axes.
        orientation: (4,) of the tool, quaternion xyzw.
        speed: [u/s].
        thickness: Of the tool [u].
        dt: Length of a physics step [s].
        depth: [u].
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
        """Physics steps until the tool is where it is to get to."""
        return math.ceil((self.depth + GAP) / (self.speed * self.dt) - 1e-9)

    @property
    def held_steps(self) -> int:
        """Physics steps for which it then stays."""
        return max(int(HOLD / self.dt), FEWEST_HELD)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Outcome:
    """What happened in one case. The counts are of inspected steps, and every step is inspected.

    Attributes:
        plunge: The case.
        contact: The contact model.
        missed: In which a contact node was deeper than `ALLOWED` in the organ, or the tool's centre was inside, and no
            flag was set.
        enclosed: In which the tool's centre was inside the organ, or a column of it with both ends; see `Inspection`.
        passages: In which a vertex of the organ had gone right through the tool, the organ's outside ahead.
        turned: In which one had, the organ's inside ahead. Not a failure of contact: the organ turned inside out.
        pairs: In which both nodes of an opposite pair were flagged.
        trailing: How many nodes on faces that look back were flagged when the plunge ended. Not a failure by itself: an
            organ may fold over a tool.
        residual: Greatest depth of a contact node or corner of the tool in the organ, or of a vertex of the organ in
            the tool, over all steps [u].
        final_residual: The same in the last step [u].
        shaking: Root mean square speed of the organ's nodes about their mean velocity in the last step, when the tool
            has been at rest for a while; NaN if it diverged [u/s]. For information.
        non_finite: Whether the simulation diverged.
        steps: Steps made.
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
    """Adds up what the inspected steps of one case show.

    Attributes:
        opposite: (n,) of the tool.
        missed: See `Outcome`; so are the others.
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
            flags: (n,) of the contact nodes.
            seen: What the inspection after the step showed.
        """
        self.missed += bool((seen.node_depth > ALLOWED or seen.centre_inside) and not flags.any())
        self.enclosed += seen.centre_inside or seen.enclosed > 0
        self.passages += seen.passages > 0
        self.turned += seen.turned > 0
        self.pairs += bool((flags & flags[self.opposite]).any())
        self.residual = max(self.residual, seen.residual)
        self.final_residual = seen.residual


def draw(seed: int, number: int) -> Plunge:
    """Make a case.

    Args:
        seed: Of the benchmark.
        number: Of the case.

    Returns:
        The case; always the same for the same two integers.
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
        plunge: What to do.
        contact: The contact model.
        watch: Called after each step with its index, the simulation, its report and the inspection.
        engine: What integrates the organ; None: the default.

    Returns:
        What happened.
    """
    scene = scenes.seed(tool_size=(1.0, 1.0, plunge.thickness), dt=plunge.dt, faces="all")
    tool = scene.tools[0].tool
    with warnings.catch_warnings():
        # At other time steps than the seed's its sphere rolls on, which changes nothing here.
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
    """A number whose logarithm is drawn evenly."""
    low, high = limits
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def _shaking(masses: FloatArray, velocities: FloatArray) -> float:
    """Root mean square speed of masses (V,) with velocities (V, 3) about their mean velocity."""
    about_mean = velocities - masses @ velocities / masses.sum()
    return math.sqrt(float(masses @ (about_mean**2).sum(axis=1) / masses.sum()))
