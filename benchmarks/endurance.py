"""Does anything break when nobody is careful?

Random actions for many control steps in every task: nothing may diverge or become infinite, no tool may be in an organ
or the other way round, no organ may stay folded through itself, and memory may not grow. Every physics step of every
world is looked at by `benchmarks.inspection`, which shares nothing with the contact model that it judges.

Two kinds of random actions, as learners make them: independent in every control step, which gets nowhere, and kept for
a while, down more often than up, which ploughs.
"""

from __future__ import annotations

import gc
import time
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium
import numpy as np

from benchmarks.inspection import ALLOWED, WorldsInspector
from benchmarks.measure import finish, parser, resident_megabytes, without_bullet
from benchmarks.physics_steps import look_after_every_step
from spatula_env import TASKS

WORLDS = {"batch": 32, "bullet": 2}
"""How many are stepped together."""

STEPS = {"batch": 200_000, "bullet": 20_000}
"""Control steps in all worlds together."""

LARGEST_GROWTH = 8.0
"""Memory may grow by so much from the first quarter of a run to its end [MB]."""

LONGEST_CROSSED = 0.1
"""An organ may cross itself for so long [s]."""

ACTIONS = ("independent", "kept")
"""Kinds of random actions."""

HOLD = 6
"""A kept action stays for so many control steps at most."""

LEVELS = (0.5, 1.0)
"""Sizes of a kept action's components."""

DOWN = 0.7
"""How often a kept action goes down."""

VERTICAL = 2
"""The component of an action that does."""


@dataclass(frozen=True)
class Endurance:
    """What was seen in a run. Steps are physics steps of one world, but for `control_steps` and `non_finite`.

    Attributes:
        control_steps: In all worlds together.
        steps: Looked at.
        touching: In which a tool felt a force.
        diverged: Worlds whose physics broke down.
        non_finite: Control steps with an observation or a reward that is not finite.
        deep: In which a tool was deeper than `inspection.ALLOWED` in an organ, or an organ's surface in a tool.
        deep_uncrossed: Deep ones in which no organ crossed itself.
        longest_deep: For how long at most without a break [s].
        depth: Greatest [u].
        unreported: Deep ones whose residual, as reported, is not more than allowed.
        residual: Greatest that was reported [u].
        wrong_side: In which an organ's surface was on the far side of a tool.
        crossed: In which an organ crossed itself.
        longest_crossed: For how long at most without a break [s].
        most_crossings: Greatest number of pairs of an edge and a triangle.
        peak_pressure: Greatest [Pa].
        memory_growth: From the first quarter of the run to its end [MB].
        seconds: How long it took, inspections included [s].
    """

    control_steps: int
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
    longest_crossed: float
    most_crossings: int
    peak_pressure: float
    memory_growth: float
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether nothing broke."""
        broken = self.diverged + self.non_finite + self.deep + self.wrong_side
        held = self.longest_crossed <= LONGEST_CROSSED and self.memory_growth <= LARGEST_GROWTH
        return broken == 0 and held


class Watch:
    """Looks at some worlds after each physics step.

    Args:
        worlds: They are watched from now on.
    """

    def __init__(self, worlds: Any) -> None:
        self._worlds = worlds
        count = worlds.count
        self._inspector = WorldsInspector(worlds.scene, count)
        self._deep_for, self._crossed_for = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.steps = self.touching = self.deep = self.deep_uncrossed = self.unreported = self.wrong_side = (
            self.crossed
        ) = 0
        self.most_crossings = self.longest_deep = self.longest_crossed = 0
        self.depth = self.residual = 0.0
        look_after_every_step(worlds, self._look)

    def forget(self, worlds: Any) -> None:
        """Begin anew in worlds (n,) that have been reset."""
        self._inspector.reset(worlds)
        self._deep_for[worlds] = self._crossed_for[worlds] = 0

    def _look(self, loads: Any) -> None:
        worlds, active = self._worlds, ~loads.diverged
        self.residual = max(self.residual, float(loads.residuals.max()))
        self.touching += int((loads.peak_forces > 0.0).any(axis=1).sum())
        seen = self._inspector.inspect(worlds.tool_positions, worlds.tool_orientations, worlds.nodes, active)
        depths = seen.residuals
        deep, crossed = depths > ALLOWED, seen.own > 0
        self.steps += int(active.sum())
        self.deep += int(deep.sum())
        self.deep_uncrossed += int((deep & ~crossed).sum())
        self.unreported += int((deep & (loads.residuals <= ALLOWED)).sum())
        self.depth = max(self.depth, float(depths.max()))
        self.wrong_side += int(seen.wrong_side.sum())
        self.crossed += int(crossed.sum())
        self.most_crossings = max(self.most_crossings, int(seen.own.max()))
        self._deep_for[active] = np.where(deep, self._deep_for + 1, 0)[active]
        self._crossed_for[active] = np.where(crossed, self._crossed_for + 1, 0)[active]
        self.longest_deep = max(self.longest_deep, int(self._deep_for.max()))
        self.longest_crossed = max(self.longest_crossed, int(self._crossed_for.max()))


class RandomActions:
    """Draws actions for some worlds, control step after control step.

    Args:
        kind: One of `ACTIONS`.
        shape: Worlds, and components of an action.
        generator: What they are drawn with.
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


def run(task: str, engine: str, steps: int, seed: int, actions: str = "kept") -> Endurance:
    """Make random control steps in some worlds of a task.

    Args:
        task: Its name.
        engine: Its engine.
        steps: How many, in all worlds together.
        seed: Of the environment and of the actions.
        actions: One of `ACTIONS`.

    Returns:
        What was seen.
    """
    count = WORLDS[engine]
    envs: Any = gymnasium.make_vec(f"Spatula/{task}-v0", num_envs=count, engine=engine)
    drawn = RandomActions(actions, (count, envs.single_action_space.shape[0]), np.random.default_rng(seed))
    worlds = envs.unwrapped.worlds
    envs.reset(seed=seed)
    watch = Watch(worlds)
    diverged, non_finite, peak_pressure = 0, 0, 0.0
    rounds = -(-steps // count)
    early = None
    start = time.perf_counter()
    for index in range(rounds):
        observation, rewards, terminated, truncated, infos = envs.step(drawn.draw())
        finite = np.isfinite(observation).all(axis=1) & np.isfinite(rewards)
        non_finite += int((~finite).sum())
        diverged += int(infos["diverged"].sum())
        peak_pressure = max(peak_pressure, float(infos["peak_pressure"].max()))
        # They are reset in the next step, before physics goes on.
        watch.forget(np.flatnonzero(terminated | truncated).tolist())
        if index == rounds // 4:
            gc.collect()
            early = resident_megabytes()
    gc.collect()
    growth = resident_megabytes() - early if early is not None else 0.0
    seconds = time.perf_counter() - start
    envs.close()
    return Endurance(
        control_steps=rounds * count,
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
        longest_crossed=watch.longest_crossed * worlds.scene.dt,
        most_crossings=watch.most_crossings,
        peak_pressure=peak_pressure,
        memory_growth=growth,
        seconds=seconds,
    )


def main() -> None:
    """Run and print."""
    options = parser(__doc__ or "")
    options.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options.add_argument("--engines", nargs="+", choices=tuple(STEPS), default=list(STEPS))
    options.add_argument("--actions", nargs="+", choices=ACTIONS, default=list(ACTIONS))
    options.add_argument("--steps", type=int, default=None, help="instead of 200,000 (batch) and 20,000 (bullet)")
    options.add_argument("--seed", type=int, default=0)
    arguments = options.parse_args()
    table: dict[str, dict[str, Any]] = {}
    good = True
    engines = without_bullet(arguments.engines)
    for task in arguments.tasks:
        for engine in engines:
            for actions in arguments.actions:
                outcome = run(task, engine, arguments.steps or STEPS[engine], arguments.seed, actions)
                by_engine = table.setdefault(task, {}).setdefault(engine, {})
                by_engine[actions] = {**asdict(outcome), "passed": outcome.passed}
                good = good and outcome.passed
                if not arguments.json:
                    print(describe(task, engine, actions, outcome), flush=True)
    finish({"benchmark": "endurance", "passed": good, "allowed_depth": ALLOWED, "tasks": table})


def describe(task: str, engine: str, actions: str, outcome: Endurance) -> str:
    """A run in a line."""
    share = 100 * outcome.touching / outcome.steps
    return (
        f"{task:8} {engine:6} {actions:11} {outcome.control_steps:7d} control steps, {share:3.0f} % in contact: "
        f"{outcome.deep} deep ({outcome.deep_uncrossed} uncrossed, {outcome.unreported} not reported, "
        f"{outcome.longest_deep:.2f} s and {outcome.depth:.4f} u at most), {outcome.wrong_side} on the wrong side, "
        f"{outcome.crossed} crossed ({outcome.longest_crossed:.2f} s at most); {outcome.diverged} diverged, "
        f"{outcome.non_finite} not finite; {outcome.peak_pressure / 1e3:.0f} kPa at most; "
        f"memory {outcome.memory_growth:+.1f} MB; {outcome.seconds:.0f} s"
    )


if __name__ == "__main__":
    main()
