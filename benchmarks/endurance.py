"""Does anything break under many steps of careless actions?

Every task is run with random actions for many control steps. Nothing may diverge or become infinite, no tool may be
inside an organ or the other way round, no organ may stay folded through itself without being reported as tangled, and
memory may not grow. Every physics step of every world is inspected by `benchmarks.inspection`, which shares no code
with the contact model that it judges.

There are two kinds of random actions, both as made by learners: independent ones, drawn anew in every control step,
under which the tool hardly moves on, and kept ones, held for a while and down more often than up, under which it
ploughs. With `--policy`, trained policies act instead, still exploring: noise that is held for a while is added to
their actions.

With `--output` each run is added to a file as soon as it is over, and runs that the file holds already are not
repeated.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from contextlib import closing
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks.inspection import ALLOWED, WorldsInspector
from benchmarks.measure import finish, installed, parser, resident_megabytes
from benchmarks.parallel import results
from benchmarks.physics_steps import look_after_every_step
from benchmarks.recordings import Recorder
from spatula_env import TASKS
from spatula_env.engines import OF_EXTRAS
from spatula_env.policies import load_pretrained

WORLDS = {"batch": 32, "tissue": 32, "mujoco": 2, "bullet": 2}
"""Number of worlds stepped together, by engine."""

STEPS = {"batch": 200_000, "tissue": 200_000, "mujoco": 10_000, "bullet": 20_000}
"""Control steps of a run, summed over all worlds, by engine."""

LARGEST_GROWTH = 8.0
"""Greatest allowed growth of memory from the first quarter of a run to its end [MB]."""

LONGEST_CROSSED = 0.1
"""How long organs may cross themselves or each other before they must be reported as tangled [s]."""

SELDOM = {"Retract": 1e-4}
"""Share of the physics steps in contact that may be deep or on the wrong side, in tasks where it is not 0."""

ACTIONS = ("independent", "kept")
"""Kinds of random actions."""

POLICY = "policy"
"""Kind of the actions of a trained policy that explores."""

EPISODES = 100
"""Episodes of a run with a trained policy."""

NOISE = 0.6
"""Standard deviation of the noise that is added to the actions of a trained policy."""

HOLD = 6
"""Longest time for which a kept action, or kept noise, stays the same [control steps]."""

LEVELS = (0.5, 1.0)
"""Possible magnitudes of the components of a kept action."""

DOWN = 0.7
"""Probability that a kept action goes down."""

VERTICAL = 2
"""Index of the vertical component of an action."""


RECORDED = ("deep", "crossed", "wrong_side")
"""Kinds of faults of which the worst stretch of each run is recorded."""

PARTS = 10
"""How often a run reports its progress."""


@dataclass(frozen=True)
class Job:
    """One run to be made.

    Attributes:
        task: Name of the task.
        engine: Name of the engine.
        actions: One of `ACTIONS`, or `POLICY`.
        seed: Seed of the environment and of the actions.
        length: Control steps summed over all worlds; number of episodes if a policy acts.
        folder: Folder for recordings of the worst stretches; "" to record nothing.
    """

    task: str
    engine: str
    actions: str
    seed: int
    length: int
    folder: str = ""

    @property
    def name(self) -> str:
        """Name of the run, for files and messages."""
        return f"{self.task.lower()}-{self.engine}-{self.actions}-{self.seed}"


@dataclass(frozen=True)
class Endurance:
    """What was observed in a run. Steps are physics steps of one world, except in `control_steps` and `non_finite`.

    Attributes:
        task: Name of the task.
        control_steps: Control steps, summed over all worlds.
        episodes: Episodes that ended.
        steps: Steps that were inspected.
        touching: Steps in which a tool felt a force.
        diverged: How often the physics of a world diverged.
        non_finite: Control steps of a world with an observation or a reward that is not finite.
        deep: Steps in which a tool was deeper than `inspection.ALLOWED` in an organ, or an organ's surface in a tool.
        deep_uncrossed: Deep steps in which organs did not cross.
        longest_deep: Longest uninterrupted sequence of deep steps [s].
        depth: Greatest depth [u].
        unreported: Deep steps whose reported residual did not exceed the allowed depth.
        residual: Greatest reported residual [u].
        wrong_side: Steps in which an organ's surface was on the far side of a tool.
        crossed: Steps in which organs crossed themselves or each other.
        stretches: How often organs began to cross.
        tangles: How many of these stretches lasted longer than `LONGEST_CROSSED`.
        tangled: Steps in which organs were reported as tangled.
        untold: Steps in which organs had crossed for longer than `LONGEST_CROSSED` and were not reported as tangled.
        longest_crossed: Longest uninterrupted sequence of steps with crossings [s].
        most_crossings: Greatest number of crossings, pairs of an edge and a triangle, in a step.
        peak_pressure: Greatest contact pressure [Pa].
        memory_growth: Growth of memory from the first quarter of the run to its end [MB].
        seconds: Duration of the run, inspections included [s].
    """

    task: str
    control_steps: int
    episodes: int
    steps: int
    touching: int
    diverged: int
    non_finite: int
    deep: int
    deep_uncrossed: int
    longest_deep: float
    depth: float
    unreported: int
    residual: float
    wrong_side: int
    crossed: int
    stretches: int
    tangles: int
    tangled: int
    untold: int
    longest_crossed: float
    most_crossings: int
    peak_pressure: float
    memory_growth: float
    seconds: float

    @property
    def deep_in_ten_thousand(self) -> float:
        """Deep steps per ten thousand steps in contact."""
        return 1e4 * self.deep / max(self.touching, 1)

    @property
    def passed(self) -> bool:
        """Whether nothing broke, depths, wrong sides and memory are within limits, and tangles were reported."""
        allowed = SELDOM.get(self.task, 0.0) * self.touching
        broken = self.diverged + self.non_finite + self.untold
        return broken == 0 and max(self.deep, self.wrong_side) <= allowed and self.memory_growth <= LARGEST_GROWTH

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "deep_in_ten_thousand": self.deep_in_ten_thousand, "passed": self.passed}


class Watch:
    """Inspects some worlds after each physics step, and counts what it finds.

    Args:
        worlds: The worlds; they are watched from now on.

    Attributes:
        depths: (W,) greatest depth in each world since the last `begin_control_step` [u].
        wrong_sides: (W,) number of steps since then with some surface on the far side of a tool, in each world.
        crossed_for: (W,) number of physics steps for which organs have crossed without a break, in each world.
    """

    def __init__(self, worlds: Any) -> None:
        self._worlds = worlds
        count = worlds.count
        self._inspector = WorldsInspector(worlds.scene, count)
        # The addend absorbs rounding: the last digits of a reported time, a sum of time steps, are uncertain.
        self._patience = int(LONGEST_CROSSED / worlds.scene.dt + 1e-6)
        self._deep_for, self.crossed_for, self.depths = np.zeros(count, int), np.zeros(count, int), np.zeros(count)
        self.wrong_sides = np.zeros(count, int)
        self.steps = self.touching = self.deep = self.deep_uncrossed = self.unreported = self.wrong_side = 0
        self.crossed = self.stretches = self.tangles = self.tangled = self.untold = 0
        self.most_crossings = self.longest_deep = self.longest_crossed = 0
        self.depth = self.residual = 0.0
        look_after_every_step(worlds, self._look)

    def forget(self, worlds: Any) -> None:
        """Start afresh in worlds (n,) that have been reset."""
        self._inspector.reset(worlds)
        self._deep_for[worlds] = self.crossed_for[worlds] = 0

    def begin_control_step(self) -> None:
        """Clear `depths` and `wrong_sides`."""
        self.depths[:] = self.wrong_sides[:] = 0

    def _look(self, loads: Any) -> None:
        worlds, active = self._worlds, ~loads.diverged
        self.residual = max(self.residual, float(loads.residuals.max()))
        self.touching += int((loads.peak_forces > 0.0).any(axis=1).sum())
        seen = self._inspector.inspect(worlds.tool_positions, worlds.tool_orientations, worlds.nodes, active)
        depths, crossings = seen.residuals, seen.own + seen.between
        deep, crossed = depths > ALLOWED, crossings > 0
        self.depths = np.maximum(self.depths, depths)
        self._deep_for[active] = np.where(deep, self._deep_for + 1, 0)[active]
        self.crossed_for[active] = np.where(crossed, self.crossed_for + 1, 0)[active]
        late = active & (self.crossed_for > self._patience)
        self.steps += int(active.sum())
        self.deep += int(deep.sum())
        self.deep_uncrossed += int((deep & ~crossed).sum())
        self.unreported += int((deep & (loads.residuals <= ALLOWED)).sum())
        self.depth = max(self.depth, float(depths.max()))
        self.wrong_sides += seen.wrong_side
        self.wrong_side += int(seen.wrong_side.sum())
        self.crossed += int(crossed.sum())
        self.stretches += int((active & (self.crossed_for == 1)).sum())
        self.tangles += int((active & (self.crossed_for == self._patience + 1)).sum())
        self.tangled += int((active & loads.tangled).sum())
        self.untold += int((late & ~loads.tangled).sum())
        self.most_crossings = max(self.most_crossings, int(crossings.max()))
        self.longest_deep = max(self.longest_deep, int(self._deep_for.max()))
        self.longest_crossed = max(self.longest_crossed, int(self.crossed_for.max()))


class RandomActions:
    """Draws actions for some worlds, control step after control step.

    Args:
        kind: One of `ACTIONS`.
        shape: Number of worlds, and number of components of an action.
        generator: Source of random numbers.
    """

    def __init__(self, kind: str, shape: tuple[int, int], generator: np.random.Generator) -> None:
        self._kind, self._generator = kind, generator
        self._actions = np.zeros(shape, dtype=np.float32)
        self._left = np.zeros(shape[0], dtype=int)

    def draw(self) -> Any:
        """The next actions, of all worlds."""
        if self._kind == "independent":
            return self._generator.uniform(-1.0, 1.0, self._actions.shape).astype(np.float32)
        for world in np.flatnonzero(self._left == 0):
            size = self._actions.shape[1]
            action = self._generator.choice(LEVELS, size) * self._generator.choice((-1.0, 1.0), size)
            action[VERTICAL] = abs(action[VERTICAL]) * (-1.0 if self._generator.random() < DOWN else 1.0)
            self._actions[world], self._left[world] = action, self._generator.integers(1, HOLD + 1)
        self._left -= 1
        return self._actions.copy()


class ExploringPolicy:
    """A trained policy whose actions get additive noise that is kept for a while.

    Args:
        task: Task of the pretrained policy.
        envs: Vector environment in which it acts.
        generator: Source of random numbers for the noise.
    """

    def __init__(self, task: str, envs: Any, generator: np.random.Generator) -> None:
        self._policy, self._generator = load_pretrained(f"Spatula/{task}-v0").bound_to(envs), generator
        self._noise = np.zeros((envs.num_envs, *envs.single_action_space.shape), dtype=np.float32)
        self._left = np.zeros(envs.num_envs, dtype=int)

    def act(self, observation: Any) -> Any:
        """The next actions, of all worlds."""
        anew = np.flatnonzero(self._left == 0)
        self._noise[anew] = self._generator.normal(scale=NOISE, size=(len(anew), self._noise.shape[1]))
        self._left[anew] = self._generator.integers(1, HOLD + 1, len(anew))
        self._left -= 1
        return np.clip(self._policy(observation) + self._noise, -1.0, 1.0)


def run(job: Job, *, tell: bool = False) -> Endurance:
    """Make control steps in some worlds of a task, and inspect them.

    Args:
        job: The run to make.
        tell: Whether to report progress on standard error.

    Returns:
        What was observed.
    """
    count = WORLDS[job.engine]
    envs: Any = gymnasium.make_vec(f"Spatula/{job.task}-v0", num_envs=count, engine=job.engine)
    generator = np.random.default_rng(job.seed)
    if job.actions == POLICY:
        act = ExploringPolicy(job.task, envs, generator).act
    else:
        drawn = RandomActions(job.actions, (count, envs.single_action_space.shape[0]), generator)

        def act(observation: Any) -> Any:
            return drawn.draw()

    worlds = envs.unwrapped.worlds
    observation, _ = envs.reset(seed=job.seed)
    recorders = []
    if job.folder:
        # Made before the watch, whose single physics steps then pass through the recorders.
        recorders = [Recorder(worlds, Path(job.folder) / f"{job.name}-{kind}.npz") for kind in RECORDED]
    watch = Watch(worlds)
    diverged, non_finite, peak_pressure = 0, 0, 0.0
    episodes, rounds, done = 0, 0, 0.0
    early, told = None, 0
    start = time.perf_counter()
    while done < 1.0:
        watch.begin_control_step()
        for recorder in recorders:
            recorder.begin_control_step()
        observation, rewards, terminated, truncated, infos = envs.step(act(observation))
        finite = np.isfinite(observation).all(axis=1) & np.isfinite(rewards)
        non_finite += int((~finite).sum())
        diverged += int(infos["diverged"].sum())
        peak_pressure = max(peak_pressure, float(infos["peak_pressure"].max()))
        # Finished worlds are reset in the next step, before their physics goes on.
        over = np.flatnonzero(terminated | truncated).tolist()
        for recorder, badness in zip(
            recorders,
            (np.where(watch.depths > ALLOWED, watch.depths, 0.0), watch.crossed_for, watch.wrong_sides),
            strict=False,
        ):
            recorder.end_control_step(badness)
            recorder.forget(over)
        watch.forget(over)
        episodes, rounds = episodes + len(over), rounds + 1
        done = episodes / job.length if job.actions == POLICY else rounds * count / job.length
        if early is None and done >= 0.25:
            gc.collect()
            early = resident_megabytes()
        if tell and int(done * PARTS) > told:
            told = int(done * PARTS)
            so_far = f"{100.0 * done:.0f} % in {(time.perf_counter() - start) / 60.0:.1f} minutes"
            print(f"{job.name}: {so_far}, {watch.deep} deep, {watch.crossed} crossed", file=sys.stderr, flush=True)
    for recorder in recorders:
        recorder.forget(range(count))
    gc.collect()
    growth = resident_megabytes() - early if early is not None else 0.0
    seconds = time.perf_counter() - start
    envs.close()
    return Endurance(
        task=job.task,
        control_steps=rounds * count,
        episodes=episodes,
        steps=watch.steps,
        touching=watch.touching,
        diverged=diverged,
        non_finite=non_finite,
        deep=watch.deep,
        deep_uncrossed=watch.deep_uncrossed,
        longest_deep=watch.longest_deep * worlds.scene.dt,
        depth=watch.depth,
        unreported=watch.unreported,
        residual=watch.residual,
        wrong_side=watch.wrong_side,
        crossed=watch.crossed,
        stretches=watch.stretches,
        tangles=watch.tangles,
        tangled=watch.tangled,
        untold=watch.untold,
        longest_crossed=watch.longest_crossed * worlds.scene.dt,
        most_crossings=watch.most_crossings,
        peak_pressure=peak_pressure,
        memory_growth=growth,
        seconds=seconds,
    )


def run_job(job: Job) -> Endurance:
    """Run a job, and report its progress on standard error."""
    return run(job, tell=True)


def read_output(path: Path | None) -> dict[Job, Endurance]:
    """Read earlier runs from a file with a JSON object in each line; empty if there is no file.

    A line that is incomplete because its process was killed counts as not run.
    """
    known: dict[Job, Endurance] = {}
    if path is None or not path.exists():
        return known
    names = [each.name for each in fields(Endurance)]
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        known[Job(**entry["job"])] = Endurance(**{name: entry["outcome"][name] for name in names})
    return known


def add_output(path: Path, job: Job, outcome: Endurance) -> None:
    """Add a run to the file that `read_output` reads."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # If the last line is incomplete, end it first, so that the new one is not appended to it.
    with path.open("a+", encoding="utf-8") as file:
        file.seek(max(file.seek(0, 2) - 1, 0))
        cut_off = file.read() not in ("", "\n")
        file.write("\n" * cut_off + json.dumps({"job": asdict(job), "outcome": outcome.as_dict()}) + "\n")


def main() -> None:
    """Run and print."""
    options = parser(__doc__ or "")
    options.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options.add_argument(
        "--engines", nargs="+", choices=tuple(STEPS), default=[each for each in STEPS if each not in OF_EXTRAS]
    )
    options.add_argument("--actions", nargs="+", choices=ACTIONS, default=list(ACTIONS))
    options.add_argument("--policy", action="store_true", help="trained policies that explore, instead of --actions")
    options.add_argument("--steps", type=int, default=None, help="instead of 200,000, and 20,000 with bullet")
    options.add_argument("--episodes", type=int, default=EPISODES, help="with --policy (default: %(default)s)")
    options.add_argument("--seed", type=int, default=0, help="of the only run of each kind (default: %(default)s)")
    options.add_argument("--seeds", type=int, nargs="+", help="of one run of each kind after the other")
    options.add_argument(
        "--processes",
        type=int,
        default=1,
        help="runs at a time (default: %(default)s, so that nothing else is there when memory is looked at)",
    )
    options.add_argument("--output", type=Path, help="a file of JSON lines; what is in it is not run again")
    options.add_argument("--save", type=Path, help="a folder for recordings of the worst stretches")
    arguments = options.parse_args()
    for name in ("steps", "episodes", "processes"):
        if (value := getattr(arguments, name)) is not None and value < 1:
            options.error(f"--{name} must be at least 1, got {value}")
    jobs = [
        Job(
            task=task,
            engine=engine,
            actions=actions,
            seed=seed,
            length=arguments.episodes if arguments.policy else arguments.steps or STEPS[engine],
            folder=str(arguments.save or ""),
        )
        for task in arguments.tasks
        for engine in installed(arguments.engines)
        for actions in ([POLICY] if arguments.policy else arguments.actions)
        for seed in arguments.seeds or [arguments.seed]
    ]
    try:
        known = read_output(arguments.output)
    except (OSError, KeyError, TypeError) as error:
        options.error(f"--output must be a file that this command has written, or a new one: {error!r}")
    outcomes = {job: known[job] for job in jobs if job in known}
    for job, outcome in outcomes.items():
        if not arguments.json:
            print(describe(job, outcome) + " (as run before)", flush=True)
    left = [job for job in jobs if job not in outcomes]
    with closing(results(run_job, left, arguments.processes, "endurance")) as stream:
        for job, outcome in stream:
            outcomes[job] = outcome
            if arguments.output is not None:
                add_output(arguments.output, job, outcome)
            if not arguments.json:
                print(describe(job, outcome), flush=True)
    table: dict[str, Any] = {}
    for job in jobs:
        by_actions = table.setdefault(job.task, {}).setdefault(job.engine, {}).setdefault(job.actions, {})
        by_actions[str(job.seed)] = outcomes[job].as_dict()
    passed = all(outcome.passed for outcome in outcomes.values())
    finish({"benchmark": "endurance", "passed": passed, "allowed_depth": ALLOWED, "tasks": table})


def describe(job: Job, outcome: Endurance) -> str:
    """Describe a run in one line."""
    share = 100 * outcome.touching / max(outcome.steps, 1)
    return (
        f"{job.task:8} {job.engine:6} {job.actions:11} seed {job.seed}: {'passed' if outcome.passed else 'FAILED'}; "
        f"{outcome.control_steps} control steps, {outcome.episodes} episodes, {share:.0f} % in contact: "
        f"{outcome.deep} deep, {outcome.deep_in_ten_thousand:.2f} of ten thousand in contact "
        f"({outcome.deep_uncrossed} uncrossed, {outcome.unreported} not reported, "
        f"{outcome.longest_deep:.2f} s and {outcome.depth:.4f} u at most), {outcome.wrong_side} on the wrong side, "
        f"{outcome.crossed} crossed, {outcome.stretches} times ({outcome.longest_crossed:.2f} s at most), of which "
        f"{outcome.tangles} for longer than {LONGEST_CROSSED} s, {outcome.untold} steps untold; "
        f"{outcome.diverged} diverged, {outcome.non_finite} not finite; {outcome.peak_pressure / 1e3:.0f} kPa at most; "
        f"memory {outcome.memory_growth:+.1f} MB; {outcome.seconds:.0f} s"
    )


if __name__ == "__main__":
    main()
