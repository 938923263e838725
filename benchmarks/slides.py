"""Does contact hold while a tool slides, ploughs and turns? Random slides, inspected after every physics step.

Each case presses the spatula into the seed's organ or into that of the palpation scene, 0.1 to 0.9 u deep (2 to 18 mm),
slides it horizontally for 2.5 u (50 mm) in a random direction and, in two of three cases, turns it meanwhile about a
random axis, at up to 50 rad/s. Then the tool is held. Friction is between 0 and 2. The tool's motion is prescribed: no
force slows it down. A case can be repeated from its number. Faults are found by `benchmarks.inspection`, not by the
contact model that is judged.
"""

from __future__ import annotations

import math
import time
import warnings
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.inspection import ALLOWED, Tally, watch_motion
from benchmarks.measure import finish, parser
from benchmarks.motions import clearance
from benchmarks.parallel import available_cores, results
from spatula_env import Simulation, scenes
from spatula_env.engines import ENGINES
from spatula_env.sim import SceneWarning

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

SEED = 20261128
"""Default seed of the cases."""

SCENES = ("seed", "palpate")
DEPTHS = (0.1, 0.9)
WAY = 2.5
SPEEDS = (0.5, 12.5)
TURNING = (0.5, 50.0)
FRICTION = (0.0, 2.0)
"""Scenes; range of depths [u]; length of a slide [u]; ranges of speeds [u/s], of angular speeds [rad/s] and of
coefficients of friction."""

TURNED = 2.0 / 3.0
"""Share of the cases in which the tool turns."""

PRESS_SPEED = 2.5
"""Speed of the press before the slide [u/s]."""

HOLD = 0.25
"""How long the tool is held at the end of the slide [s]."""

LONGEST_CROSSED = 0.1
"""Longest time for which an organ may cross itself [s]."""

WORST = 10
"""Number of the worst cases that are listed."""


@dataclass(frozen=True)
class Slide:
    """One case.

    Attributes:
        seed: Seed that the case was drawn with.
        number: Number of the case.
        scene: Name of the preset scene.
        depth: Depth of the press [u].
        direction: Angle of the slide in the horizontal plane [rad].
        speed: Speed of the slide [u/s].
        turning: (3,) angular velocity while sliding [rad/s].
        friction: Coefficient of friction between tool and organ.
    """

    seed: int
    number: int
    scene: str
    depth: float
    direction: float
    speed: float
    turning: tuple[float, float, float]
    friction: float


@dataclass(frozen=True)
class Outcome:
    """Result of one case.

    Attributes:
        slide: The case.
        seen: Counts over all of its physics steps.
        crossed_at_end: Whether an organ crossed itself in the last step.
        dt: Length of a physics step [s].
    """

    slide: Slide
    seen: Tally
    crossed_at_end: bool
    dt: float

    @property
    def tangled(self) -> bool:
        """Whether an organ crossed itself for longer than it may."""
        return self.seen.longest_crossed * self.dt > LONGEST_CROSSED

    @property
    def failed(self) -> bool:
        """Whether contact was lost, an organ tangled, or the simulation diverged."""
        return bool(self.seen.deep or self.seen.wrong_side or self.seen.diverged or self.tangled)


def draw(seed: int, number: int) -> Slide:
    """Draw a case, which is always the same for the same two integers.

    Args:
        seed: Seed of the benchmark.
        number: Number of the case.
    """
    generator = np.random.default_rng([seed, number])
    axis = generator.normal(size=3)
    rate = _draw_logarithmic(generator, TURNING)
    x, y, z = (rate / np.linalg.norm(axis) * axis * (generator.random() < TURNED)).tolist()
    return Slide(
        seed=seed,
        number=number,
        scene=SCENES[generator.integers(len(SCENES))],
        depth=generator.uniform(*DEPTHS),
        direction=generator.uniform(0.0, 2.0 * math.pi),
        speed=_draw_logarithmic(generator, SPEEDS),
        turning=(x, y, z),
        friction=generator.uniform(*FRICTION),
    )


def motion(slide: Slide, simulation: Simulation) -> tuple[FloatArray, FloatArray]:
    """Velocities of the tool in each physics step of a case.

    Args:
        slide: The case.
        simulation: The simulation in its initial state.

    Returns:
        Linear [u/s] and angular [rad/s] velocities, (S, 1, 3) each.
    """
    dt = simulation.dt
    down = math.ceil((clearance(simulation) + slide.depth) / (PRESS_SPEED * dt))
    along = math.ceil(WAY / (slide.speed * dt))
    linear = np.zeros((down + along + math.ceil(HOLD / dt), 1, 3))
    angular = np.zeros_like(linear)
    linear[:down, 0, 2] = -PRESS_SPEED
    linear[down : down + along, 0, :2] = slide.speed * np.array([math.cos(slide.direction), math.sin(slide.direction)])
    angular[down : down + along] = slide.turning
    return linear, angular


def run(slide: Slide, engine: str = "batch", *, show: bool = False) -> Outcome:
    """Make one slide, and inspect after every physics step.

    Args:
        slide: The case.
        engine: Engine that integrates the organ.
        show: Whether to print a line for each step.

    Returns:
        The result.
    """
    scene = getattr(scenes, slide.scene)()
    scene = replace(scene, tools=(replace(scene.tools[0], friction=slide.friction),))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        simulation = Simulation(scene, engine=engine)
    try:
        seen = watch_motion(simulation, *motion(slide, simulation), show=show)
    finally:
        simulation.close()
    return Outcome(slide, seen, seen.crossed_now > 0, scene.dt)


def summarise(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Summarise the outcomes of cases, at least one."""
    worst = sorted((outcome for outcome in outcomes if outcome.failed), key=lambda each: -each.seen.depth)[:WORST]
    depths = [outcome.seen.depth for outcome in outcomes]
    return {
        "cases": len(outcomes),
        "failed": sum(outcome.failed for outcome in outcomes),
        "deep": sum(outcome.seen.deep > 0 for outcome in outcomes),
        "deep_steps": sum(outcome.seen.deep for outcome in outcomes),
        "deep_steps_uncrossed": sum(outcome.seen.deep_uncrossed for outcome in outcomes),
        "unreported_steps": sum(outcome.seen.unreported for outcome in outcomes),
        "wrong_side": sum(outcome.seen.wrong_side > 0 for outcome in outcomes),
        "tangled": sum(outcome.tangled for outcome in outcomes),
        "crossed_at_end": sum(outcome.crossed_at_end for outcome in outcomes),
        "diverged": sum(outcome.seen.diverged for outcome in outcomes),
        "steps": sum(outcome.seen.steps for outcome in outcomes),
        "depth": dict(zip(("p50", "p95", "max"), np.percentile(depths, (50, 95, 100)).tolist(), strict=True)),
        "failed_cases": sorted(outcome.slide.number for outcome in outcomes if outcome.failed),
        "worst": [{"slide": asdict(outcome.slide), **outcome.seen.as_dict()} for outcome in worst],
    }


@dataclass(frozen=True)
class Job:
    """A case to run.

    Attributes:
        seed: Seed of the benchmark.
        number: Number of the case.
        engine: Engine that integrates the organ.
    """

    seed: int
    number: int
    engine: str


def run_job(job: Job) -> Outcome:
    """Run one case; errors name the case."""
    try:
        return run(draw(job.seed, job.number), job.engine)
    except Exception as error:
        raise RuntimeError(f"case {job.number} of seed {job.seed}: {error}") from error


def _draw_logarithmic(generator: np.random.Generator, limits: tuple[float, float]) -> float:
    """Draw a number between two limits whose logarithm is uniformly distributed."""
    low, high = limits
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--cases", type=int, default=1000, help="how many slides")
    options.add_argument("--first", type=int, default=0, help="number of the first")
    options.add_argument("--seed", type=int, default=SEED, help="other seeds give other cases")
    options.add_argument("--engine", choices=ENGINES, default="batch")
    options.add_argument("--workers", type=int, default=available_cores(), help="processes")
    options.add_argument("--case", type=int, help="run only the case of this number, and print every step")
    arguments = options.parse_args()
    for name, least in (("cases", 1), ("workers", 1), ("first", 0), ("seed", 0)):
        if getattr(arguments, name) < least:
            options.error(f"--{name} must be at least {least}, got {getattr(arguments, name)}")
    if arguments.case is not None:
        slide = draw(arguments.seed, arguments.case)
        print(slide)
        outcome = run(slide, arguments.engine, show=True)
        finish({"benchmark": "slides", "failed": outcome.failed, "slide": asdict(slide), **outcome.seen.as_dict()})
        return
    numbers = range(arguments.first, arguments.first + arguments.cases)
    jobs = [Job(arguments.seed, number, arguments.engine) for number in numbers]
    start = time.perf_counter()
    with closing(results(run_job, jobs, arguments.workers, "slides")) as stream:
        outcomes = [outcome for _, outcome in stream]
    summary = summarise(outcomes)
    if not arguments.json:
        print(describe(summary))
    finish(
        {
            "benchmark": "slides",
            "seed": arguments.seed,
            "first": arguments.first,
            "engine": arguments.engine,
            "passed": summary["failed"] == 0,
            "allowed_depth": ALLOWED,
            "seconds": time.perf_counter() - start,
            **summary,
        }
    )


def describe(summary: dict[str, Any]) -> str:
    """A summary in words."""
    depth = summary["depth"]
    lines = [
        f"{summary['failed']} of {summary['cases']} slides failed: {summary['deep']} deeper than {ALLOWED} u,"
        f" {summary['wrong_side']} on the wrong side, {summary['tangled']} tangled, {summary['diverged']} diverged",
        f"  of {summary['steps']} steps {summary['deep_steps']} deep, {summary['deep_steps_uncrossed']} of them without"
        f" a crossing, {summary['unreported_steps']} not reported",
        f"  greatest depth of a case {depth['p50']:.4f} (median) {depth['p95']:.4f} (95 %) {depth['max']:.4f} u",
    ]
    for case in summary["worst"]:
        slide = case["slide"]
        rate = float(np.linalg.norm(slide["turning"]))
        lines.append(
            f"  {slide['number']:5d} {slide['scene']:8} {slide['depth']:.2f} u pressed, {slide['speed']:5.2f} u/s,"
            f" {rate:4.1f} rad/s, friction {slide['friction']:.2f}: {case['depth']:.4f} u, {case['deep']} steps deep,"
            f" {case['deep_uncrossed']} without a crossing; {case['crossed']} crossed"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
