"""Does anything break when nobody is careful?

Random actions for many control steps in every task: nothing may diverge or become infinite, no tool may come through an
organ, and memory may not grow. After every control step each world is inspected: a tool that is inside the organ with
no contact node flagged was missed, and an organ's surface on the far side of a tool has been tunnelled through.

A surface that slips off a tool goes round its rim within a control step, which looks, seen only before and after, as if
it had gone through. Where a vertex is found on the other side the step is therefore done once more, from the same
state to the same end, and inspected after every physics step.
"""

from __future__ import annotations

import gc
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks.inspection import Inspector
from benchmarks.measure import finish, parser, without_bullet
from spatula_env import TASKS
from spatula_env.sim.worlds import SeparateWorlds

WORLDS = {"batch": 32, "bullet": 2}
"""How many are stepped together."""

STEPS = {"batch": 200_000, "bullet": 20_000}
"""Control steps in all worlds together."""

DEEP = 0.05
"""A part of a tool this deep in the organ, with no flag set, was missed [u]: 1 mm."""

LARGEST_GROWTH = 8.0
"""Memory may grow by so much from the first quarter of a run to its end [MiB]."""

SAME = 1e-2
"""A control step that is done once more came out the same if no node is farther off than this [u]."""

HOLD = 8
"""A random action is held for so many control steps at most: noise alone does not get anywhere."""


@dataclass(frozen=True)
class Endurance:
    """What was seen in a run.

    Attributes:
        steps: Control steps.
        contact_share: Part of them with a contact node flagged at the end.
        diverged: Worlds whose physics broke down.
        non_finite: Control steps with an observation or a reward that is not finite.
        missed: Control steps after which a tool was in an organ with no flag set.
        wrong_side: Control steps after which an organ's surface was on the far side of a tool.
        residual: Greatest depth of a tool in an organ or the other way round after a control step [u].
        peak_pressure: Greatest [Pa].
        memory_growth: From the first quarter of the run to its end [MiB].
        seconds: How long it took, inspections included [s].
    """

    steps: int
    contact_share: float
    diverged: int
    non_finite: int
    missed: int
    wrong_side: int
    residual: float
    peak_pressure: float
    memory_growth: float
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether nothing broke."""
        broken = self.diverged + self.non_finite + self.missed + self.wrong_side
        return broken == 0 and self.memory_growth <= LARGEST_GROWTH


class Retraced:
    """The worlds' last control step, to be gone through once more physics step by physics step.

    Args:
        worlds: They are watched from now on: the state before every `advance` is kept.
    """

    def __init__(self, worlds: Any) -> None:
        self._worlds = worlds
        self._advance = worlds.advance
        self._before: Any = None
        self._motion: tuple[Any, Any, int, Any] = (None, None, 0, None)
        worlds.advance = self._watched

    def _watched(self, linear: Any, angular: Any, steps: int, pressure_limits: Any, force_limits: Any) -> Any:
        self._before, self._motion = self._save(), (linear, angular, steps, force_limits)
        return self._advance(linear, angular, steps, pressure_limits, force_limits)

    def passages(self, world: int, tool: int) -> int:
        """How many of an organ's vertices went through a tool in the last control step of a world."""
        worlds, (linear, angular, steps, force_limits) = self._worlds, self._motion
        after, nodes = self._save(), worlds.nodes[world].copy()
        self._restore(self._before)
        inspector = Inspector(worlds.scene.tools[tool].tool, worlds.triangles)
        count = 0
        for step in range(steps + 1):
            if step > 0:
                self._advance(linear, angular, 1, None, force_limits)
            position, orientation = worlds.tool_positions[world, tool], worlds.tool_orientations[world, tool]
            count += inspector.inspect(position, orientation, worlds.nodes[world]).passages
        same = np.allclose(worlds.nodes[world], nodes, rtol=0.0, atol=SAME)
        self._restore(after)
        # Bullet repeats a step to some 1e-9 u, and a fold that snaps makes much of that. What cannot be followed,
        # counts.
        return count if same else max(count, 1)

    def _save(self) -> Any:
        if isinstance(self._worlds, SeparateWorlds):
            return [simulation.save() for simulation in self._worlds.simulations]
        return self._worlds.save()

    def _restore(self, state: Any) -> None:
        if isinstance(self._worlds, SeparateWorlds):
            for simulation, saved in zip(self._worlds.simulations, state, strict=True):
                simulation.restore(saved)
        else:
            self._worlds.restore(state)


def run(task: str, engine: str, steps: int, seed: int) -> Endurance:
    """Make random control steps in some worlds of a task."""
    count = WORLDS[engine]
    envs: Any = gymnasium.make_vec(f"Spatula/{task}-v0", num_envs=count, engine=engine)
    generator = np.random.default_rng(seed)
    base = envs.unwrapped
    worlds = base.worlds
    tools = worlds.scene.tools
    inspectors = [[Inspector(placed.tool, worlds.triangles) for placed in tools] for _ in range(count)]
    # Farther from every vertex than this, a tool meets no triangle; and it cannot have got far inside unseen.
    longest = max(float(placed.organ.edge_lengths.max()) for placed in worlds.scene.organs)
    reaches = [float(np.linalg.norm(placed.tool.vertices, axis=1).max()) + 1.5 * longest for placed in tools]
    # The observation tells which share of the contact nodes of each face is flagged.
    shares = base.observation_builder.slices["contact_share"]
    of_tool = np.repeat(np.arange(len(tools)), [len(np.unique(placed.tool.face)) for placed in tools])
    size = envs.single_action_space.shape[0]
    envs.reset(seed=seed)
    retraced = Retraced(worlds)
    touching, diverged, non_finite, missed, wrong_side = 0, 0, 0, 0, 0
    residual, peak_pressure = 0.0, 0.0
    rounds = -(-steps // count)
    actions = np.zeros((count, size), dtype=np.float32)
    left = np.zeros(count, dtype=int)
    resting = np.zeros(count, dtype=bool)
    early = None
    start = time.perf_counter()
    for index in range(rounds):
        for world in np.flatnonzero(left == 0):
            actions[world] = generator.uniform(-1.0, 1.0, size)
            left[world] = generator.integers(1, HOLD + 1)
        left -= 1
        observation, rewards, terminated, truncated, infos = envs.step(actions)
        finite = np.isfinite(observation).all(axis=1) & np.isfinite(rewards)
        non_finite += int((~finite).sum())
        diverged += int(infos["diverged"].sum())
        peak_pressure = max(peak_pressure, float(infos["peak_pressure"].max()))
        nodes, positions, orientations = worlds.nodes, worlds.tool_positions, worlds.tool_orientations
        away = np.sqrt(((nodes[:, None] - positions[:, :, None]) ** 2).sum(axis=-1).min(axis=-1))
        flagged = observation[:, shares] > 0.0
        for world in range(count):
            if resting[world] or not finite[world]:
                for inspector in inspectors[world]:
                    inspector.reset()
                continue
            touching += flagged[world].any()
            for tool, inspector in enumerate(inspectors[world]):
                if away[world, tool] > reaches[tool]:
                    inspector.reset()
                    continue
                seen = inspector.inspect(positions[world, tool], orientations[world, tool], nodes[world])
                deepest = max(seen.node_depth, seen.corner_depth)
                missed += deepest > DEEP and not flagged[world, of_tool == tool].any()
                through = seen.passages > 0 and retraced.passages(world, tool) > 0
                wrong_side += seen.centre_inside or seen.enclosed > 0 or through
                residual = max(residual, seen.residual)
        resting = terminated | truncated
        if index == rounds // 4:
            gc.collect()
            early = _memory()
    gc.collect()
    growth = _memory() - early if early is not None else 0.0
    seconds = time.perf_counter() - start
    envs.close()
    total = rounds * count
    return Endurance(
        total, touching / total, diverged, non_finite, missed, wrong_side, residual, peak_pressure, growth, seconds
    )


def _memory() -> float:
    """What this process holds in memory [MiB]; 0 where the system does not tell, as only Linux does."""
    file = Path("/proc/self/status")
    for line in file.read_text(encoding="ascii").splitlines() if file.exists() else ():
        if line.startswith("VmRSS:"):
            return float(line.split()[1]) / 1024.0
    return 0.0


def main() -> None:
    """Run and print."""
    options = parser(__doc__ or "")
    options.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options.add_argument("--engines", nargs="+", choices=tuple(STEPS), default=list(STEPS))
    options.add_argument("--steps", type=int, default=None, help="instead of 200,000 (batch) and 20,000 (bullet)")
    options.add_argument("--seed", type=int, default=0)
    arguments = options.parse_args()
    table: dict[str, dict[str, Any]] = {}
    good = True
    engines = without_bullet(arguments.engines)
    for task in arguments.tasks:
        for engine in engines:
            outcome = run(task, engine, arguments.steps or STEPS[engine], arguments.seed)
            table.setdefault(task, {})[engine] = {**asdict(outcome), "passed": outcome.passed}
            good = good and outcome.passed
            if not arguments.json:
                print(
                    f"{task:8} {engine:6} {outcome.steps:7d} steps, {100 * outcome.contact_share:3.0f} % in contact: "
                    f"{outcome.diverged} diverged, {outcome.non_finite} not finite, {outcome.missed} missed, "
                    f"{outcome.wrong_side} on the wrong side; {outcome.peak_pressure / 1e3:.0f} kPa at most; "
                    f"memory {outcome.memory_growth:+.1f} MiB; {outcome.seconds:.0f} s",
                    flush=True,
                )
    finish({"benchmark": "endurance", "passed": good, "tasks": table})


if __name__ == "__main__":
    main()
