"""How many steps a second? Many worlds in compiled code against PyBullet, in one run on one machine.

body           PyBullet's own `stepSimulation` of the seed's sphere, nothing else, and `BatchBody.step` of the same
               body.
press          A press with ground, contact and report, a quarter of it in the air: `Simulation` with both engines, and
               `BatchSimulation` with its tools at slightly different places.
environment    Control steps of Spatula/Press-v0 in contact: a single environment with PyBullet, one with PyBullet in a
               process per core, a single one with the batch engine, and `make_vec`. In half of the worlds a script
               presses towards the goal; in the others it does so in the first, untimed steps, and actions are random
               from then on.
episodes       The same environments through whole episodes, resets included: under a random policy, which is mostly in
               the air, and under the expert, which goes to the place, presses, and holds until the episode is over.
parts          Where the time of 64 environments on one thread goes.

All sides take turns, and do the same work in every turn; the time of a call is the median over the turns. Sides with
more than 64 worlds have one turn only. Times are for one thread unless stated otherwise. PyBullet computes in double
precision and the batch engine in single; rows of 64 worlds in double precision show the effect. "sim s/s" is simulated
seconds per second, and "spread" the difference between the slowest and the fastest turn, relative to the median.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
import numba
import numpy as np

import spatula_env
from benchmarks.measure import finish, parser, require_bullet
from benchmarks.parallel import available_cores
from benchmarks.parity import DEPTH, HOLD, place_above, press_velocities
from spatula_env import Simulation, scenes
from spatula_env.learning.experts import PressExpert
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.batch_body import BatchBody
from spatula_env.sim.bullet import BulletWorld
from spatula_env.sim.soft_body import soft_body

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.scenes import Scene


gym.register_envs(spatula_env)

ENVIRONMENT = "Spatula/Press-v0"

POLICIES = ("random", "expert")
"""Policies that act in whole episodes."""

CONTROL_STEP = 12
"""Physics steps in a timed call of a body or a press, as in a control step of the environment by default."""

MANY = 64
"""Number of worlds that most limits apply to."""

SHAKE = 0.1
"""Standard deviation of each component of a body's initial nodal velocities [u/s]."""

PRESS_CLEARANCE = 0.5
"""Height above the organ at which a press begins [u]."""

PLACE_RADIUS = 0.5
"""Radius, around the position in the parity benchmark, within which the tools of a press come down [u]."""

GOAL_RADIUS, GOAL_DEPTHS = 0.015, (0.005, 0.018)
"""Greatest distance from the middle, and range of depths, of the environments' goals, as the task draws them [m]."""

START_HEIGHT = 0.004
"""Initial height of the spatula's middle above the organ's top in an episode [m]."""

PLACE_GAIN, DEPTH_GAIN, FREE_SPEED = 8.0, 6.0, 0.06
"""Gains of the script, speed per distance [1/s], sideways and downwards; and its speed of descent in the air [m/s]."""

WARM_UP_CALLS = 2
"""Untimed calls of each side before the first turn, after which everything is compiled and all memory touched."""

LIMITS = {
    "body_64_worlds": 10.0,
    "body_one_world": 1.3,
    "press_64_worlds": 10.0,
    "press_one_world": 1.3,
    "environment_64_worlds": 10.0,
    "random_episodes_64_worlds": 10.0,
    "expert_episodes_64_worlds": 10.0,
    "two_threads": 1.7,
}
"""Least speed-up over PyBullet, or of two threads over one."""

STRETCH = {
    "body_64_worlds": 20.0,
    "press_64_worlds": 20.0,
    "environment_64_worlds": 20.0,
    "random_episodes_64_worlds": 20.0,
    "expert_episodes_64_worlds": 20.0,
    "simulated_seconds": 100.0,
}
"""Targets beyond these limits, which are not required; the last is simulated seconds per second on one core."""

COLD_LIMITS = {"compiling": 60.0, "from_cache": 5.0}
"""Longest time from the start of a process to the end of its first step of 64 environments [s]."""

FIRST_STEP = f"""
import gymnasium, spatula_env
env = gymnasium.make_vec("{ENVIRONMENT}", num_envs=64)
env.reset(seed=0)
env.step(env.action_space.sample())
env.close()
"""


class Side(Protocol):
    """One of the implementations that take turns.

    Attributes:
        worlds: Number of worlds that a call steps.
        threads: Number of threads.
        steps: Number of steps in the timed calls of a turn, summed over all worlds.
    """

    worlds: int
    threads: int
    steps: int

    def turn(self, calls: int | None = None) -> FloatArray:
        """Start afresh and do the work of a turn.

        Args:
            calls: Number of timed calls to make, for a shorter turn; all by default.

        Returns:
            (C,) duration of each timed call [s].
        """

    def close(self) -> None:
        """Free all resources."""


@dataclass(frozen=True)
class Timing:
    """Times of a side's turns.

    Attributes:
        side: The side.
        seconds: (turns, C) duration of each call [s].
    """

    side: Side
    seconds: FloatArray

    @property
    def steps_per_second(self) -> float:
        """Steps per second, summed over worlds, from each call's median over the turns."""
        return float(self.side.steps / np.median(self.seconds, axis=0).sum())

    @property
    def spread(self) -> float:
        """Difference between the slowest and the fastest turn, relative to the median."""
        turns = self.seconds.sum(axis=1)
        return float((turns.max() - turns.min()) / np.median(turns))


@contextmanager
def numba_threads(count: int) -> Iterator[None]:
    """Context manager that sets the number of Numba's threads."""
    before = numba.get_num_threads()
    numba.set_num_threads(count)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def timed(call: Callable[[], object]) -> float:
    """Duration of a call [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


# The body alone ----------------------------------------------------------------------------------------------------


class BulletBody:
    """Side that calls PyBullet's `stepSimulation`, and nothing around it."""

    worlds, threads = 1, 1

    def __init__(self, scene: Scene, calls: int, steps_per_call: int) -> None:
        """Load the organs.

        Args:
            scene: Scene whose organs are stepped, without ground or tools.
            calls: Number of timed calls.
            steps_per_call: Number of steps in each call.
        """
        self._scene, self._world = scene, BulletWorld(scene)
        self._start = shaken(scene)
        self._calls, self._steps_per_call = calls, steps_per_call
        self.steps = calls * steps_per_call

    def turn(self, calls: int | None = None) -> FloatArray:
        """See `Side`."""
        # A world that was stepped through the client, past its own methods, cannot be reset, so a new one is made.
        self._world.close()
        self._world = world = BulletWorld(self._scene)
        world.step(*self._start)
        step, client, count = world._bullet.stepSimulation, world._client, self._steps_per_call

        def call() -> None:
            for _ in range(count):
                step(client)

        return np.array([timed(call) for _ in range(calls or self._calls)])

    def close(self) -> None:
        """See `Side`."""
        self._world.close()


class CompiledBody:
    """Side that calls `BatchBody.step`, and nothing around it."""

    threads = 1

    def __init__(self, scene: Scene, worlds: int, calls: int, steps_per_call: int, dtype: type = np.float32) -> None:
        """Load the organ.

        Args:
            scene: Scene whose first organ is stepped.
            worlds: Number of worlds.
            calls: Number of timed calls.
            steps_per_call: Number of steps in each call.
            dtype: float32 or float64.
        """
        body = soft_body(scene.organs[0])
        self._body = BatchBody(body, worlds, dt=scene.dt, gravity=scene.gravity, dtype=dtype)
        self._start = shaken(scene)
        self._calls, self._steps_per_call = calls, steps_per_call
        self.worlds, self.steps = worlds, worlds * calls * steps_per_call

    def turn(self, calls: int | None = None) -> FloatArray:
        """See `Side`."""
        self._body.set_state(*self._start)
        step, count = self._body.step, self._steps_per_call
        step()

        def call() -> None:
            for _ in range(count):
                step()

        return np.array([timed(call) for _ in range(calls or self._calls)])

    def close(self) -> None:
        """See `Side`."""


def shaken(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """The organs' nodes in their initial shape, and random velocities that make them sway, (V, 3) each."""
    nodes = np.concatenate([placed.vertices for placed in scene.organs])
    return nodes, np.random.default_rng(0).normal(scale=SHAKE, size=nodes.shape)


# A press -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Press:
    """Plan of a press at different places.

    Attributes:
        places: (W, 3) initial positions of the tools [u].
        velocities: (C, 3) velocity of all tools in each control step [u/s].
    """

    places: FloatArray
    velocities: FloatArray


def make_press(scene: Scene, worlds: int, depth: float = DEPTH, hold: float = HOLD) -> Press:
    """Plan a press.

    Args:
        scene: Scene with the organ and the tool.
        worlds: Number of places.
        depth: Depth of the press, rounded to a whole number of control steps [u].
        hold: How long the tool waits there [s].

    Returns:
        The plan; the first places are the same for any number of worlds.
    """
    simulation = Simulation(scene, engine="batch")
    middle = place_above(scene, simulation.nodes, PRESS_CLEARANCE)
    simulation.close()
    generator = np.random.default_rng(0)
    angles, squares = generator.random((worlds, 2)).T
    angles, radii = 2.0 * np.pi * angles, PLACE_RADIUS * np.sqrt(squares)
    aside = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(worlds)])
    return Press(middle + aside, press_velocities(CONTROL_STEP * scene.dt, PRESS_CLEARANCE + depth, hold))


class PressOfOne:
    """Side that makes a press in a `Simulation`, at several places one after the other."""

    worlds, threads = 1, 1

    def __init__(self, scene: Scene, engine: str, plan: Press) -> None:
        """Load the scene.

        Args:
            scene: Scene of the press.
            engine: "bullet" or "batch".
            plan: Plan of the press, made at all of its places in a turn.
        """
        self._simulation = Simulation(scene, engine=engine)
        self._plan = plan
        self.steps = len(plan.places) * len(plan.velocities) * CONTROL_STEP
        self.contact_share = 0.0

    def turn(self, calls: int | None = None) -> FloatArray:
        """See `Side`."""
        simulation, velocities, reports = self._simulation, self._plan.velocities[:calls], []

        def call(velocity: FloatArray) -> None:
            reports.append([simulation.step(velocity) for _ in range(CONTROL_STEP)])

        seconds = []
        for place in self._plan.places if calls is None else self._plan.places[:1]:
            simulation.reset()
            simulation.place_tool(place)
            seconds += [timed(functools.partial(call, velocity)) for velocity in velocities]
        self.contact_share = float(np.mean([any(report.force.any() for report in row) for row in reports]))
        return np.array(seconds)

    def close(self) -> None:
        """See `Side`."""
        self._simulation.close()


class PressOfMany:
    """Side that makes the same press in a `BatchSimulation`, at all places at once."""

    def __init__(self, scene: Scene, plan: Press, threads: int = 1, dtype: type = np.float32) -> None:
        """Load the scene.

        Args:
            scene: Scene of the press.
            plan: Plan of the press, with a place for each world.
            threads: Number of threads.
            dtype: float32 or float64.
        """
        self.worlds, self.threads = len(plan.places), threads
        with numba_threads(threads):
            self._batch = BatchSimulation(scene, self.worlds, dtype=dtype, parallel=threads > 1)
        self._plan = plan
        self.steps = self.worlds * len(plan.velocities) * CONTROL_STEP
        self.contact_share = 0.0

    def turn(self, calls: int | None = None) -> FloatArray:
        """See `Side`."""
        batch, loads = self._batch, []
        batch.reset()
        positions = batch.tool_positions
        positions[:, 0] = self._plan.places
        batch.place_tools(positions)

        def call(velocity: FloatArray) -> None:
            loads.append(batch.advance(np.broadcast_to(velocity, positions.shape), steps=CONTROL_STEP))

        with numba_threads(self.threads):
            seconds = [timed(functools.partial(call, velocity)) for velocity in self._plan.velocities[:calls]]
        self.contact_share = float(np.mean([row.peak_forces[:, 0] > 0.0 for row in loads]))
        return np.array(seconds)

    def close(self) -> None:
        """See `Side`."""
        self._batch.close()


# Environments ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Script:
    """Script of what is done in the environments.

    Attributes:
        down: Number of untimed control steps of pressing towards the goal, before the timed ones.
        calls: Number of timed control steps.
        error: Slice of an observation with the error of place and depth.
        touch: Slice of an observation with the share of contact nodes in contact.
        max_speed: Speed of an action of 1 [m/s].
        start_height: Initial height of the spatula's middle in an episode [m].
        physics_steps: Number of physics steps in a control step.
    """

    down: int
    calls: int
    error: slice
    touch: slice
    max_speed: float
    start_height: float
    physics_steps: int

    def start(self, world: int) -> dict[str, FloatArray]:
        """Options of `reset` for the episodes of a world: a goal, and the spatula above it, near the organ."""
        generator = np.random.default_rng(world)
        angle, radius = 2.0 * np.pi * generator.random(), GOAL_RADIUS * np.sqrt(generator.random())
        place = (radius * np.cos(angle), radius * np.sin(angle))
        return {
            "goal": np.array([*place, generator.uniform(*GOAL_DEPTHS)]),
            "tool_position": np.array([*place, self.start_height]),
        }

    def by_chance(self, worlds: Sequence[int]) -> NDArray[np.float32]:
        """Random actions (W, C, 3) for some worlds, each drawn from its own generator."""
        rows = [np.random.default_rng([world, 1]).uniform(-1.0, 1.0, (self.calls, 3)) for world in worlds]
        return np.array(rows, dtype=np.float32)

    def actions(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Actions (W, 3) that press towards the goal, from observations (W, D)."""
        error, touching = observations[:, self.error], observations[:, self.touch].max(axis=1) > 0.0
        down = np.where(touching, DEPTH_GAIN * error[:, 2], FREE_SPEED)
        velocity = np.column_stack([PLACE_GAIN * error[:, :2], -down])
        return np.clip(velocity / self.max_speed, -1.0, 1.0).astype(np.float32)


def make_script(down: int, calls: int) -> Script:
    """Make a script for the environment with default options."""
    env = gym.make_vec(ENVIRONMENT, num_envs=1)
    base: Any = env.unwrapped
    slices, parts = base.observation_builder.slices, base.observation_builder.parts
    top = base.workspace.from_scene(base.worlds.nodes[0])[:, 2].max()
    speed = next(part.high[0] for part in parts if part.name == "tool_velocity")
    env.close()
    return Script(
        down=down,
        calls=calls,
        error=slices["error"],
        touch=slices["contact_share"],
        max_speed=float(speed),
        start_height=float(top + START_HEIGHT),
        physics_steps=base.steps_per_action,
    )


class StartsByScript(gym.Wrapper[Any, Any, Any, Any]):
    """Wrapper that begins the episodes of a world as the script says; the seed is the number of the world."""

    def __init__(self, env: gym.Env[Any, Any], script: Script) -> None:
        """Wrap an environment."""
        super().__init__(env)
        self._script = script

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.Env.reset`."""
        return super().reset(seed=seed, options=options if seed is None else self._script.start(seed))


def make_single(engine: str, script: Script) -> StartsByScript:
    """Make one environment, without the checks that `gymnasium.make` adds for developers."""
    return StartsByScript(gym.make(ENVIRONMENT, engine=engine, disable_env_checker=True), script)


@dataclass
class Driver:
    """Side that plays the script's episodes.

    Attributes:
        worlds: Number of worlds that play at a time.
        total: Number of worlds in all; they play group by group.
        script: The script.
        reset: Begins episodes of some worlds, and returns their observations (W, D).
        step: Makes a control step with actions (W, 3), and returns observations and forces (W,).
        close: Frees all resources.
        threads: Number of threads.
        contact_share: Share of the timed control steps, over all worlds, in which the tool felt a force.
    """

    worlds: int
    total: int
    script: Script
    reset: Callable[[Sequence[int]], NDArray[np.float32]]
    step: Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], FloatArray]]
    close: Callable[[], None]
    threads: int = 1
    contact_share: float = 0.0
    steps: int = field(init=False)

    def __post_init__(self) -> None:
        """Count."""
        self.steps = self.total * self.script.calls

    def turn(self, calls: int | None = None) -> FloatArray:
        """See `Side`."""
        seconds: list[float] = []
        forces: list[FloatArray] = []
        with numba_threads(self.threads):
            for first in range(0, self.total if calls is None else 1, self.worlds):
                self._play(range(first, first + self.worlds), calls, seconds, forces)
        self.contact_share = float(np.mean(np.array(forces) > 0.0))
        return np.array(seconds)

    def _play(self, worlds: Sequence[int], calls: int | None, seconds: list[float], forces: list[FloatArray]) -> None:
        """Play one episode of some worlds at once; times and forces are appended."""
        script, scripted = self.script, np.array(worlds) % 2 == 0
        observations = self.reset(worlds)
        for _ in range(script.down):
            observations, _ = self.step(script.actions(observations))
        chance = script.by_chance(worlds)
        for index in range(calls or script.calls):
            actions = np.where(scripted[:, None], script.actions(observations), chance[:, index])
            start = time.perf_counter()
            observations, force = self.step(actions)
            seconds.append(time.perf_counter() - start)
            forces.append(force)


def single_driver(engine: str, total: int, script: Script) -> Driver:
    """Driver of one environment that plays the worlds one after the other."""
    env = make_single(engine, script)

    def reset(worlds: Sequence[int]) -> NDArray[np.float32]:
        return np.asarray(env.reset(seed=worlds[0])[0])[None]

    def step(actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], FloatArray]:
        observation, _, _, _, info = env.step(actions[0])
        return np.asarray(observation)[None], np.array([info["force"]])

    return Driver(1, total, script, reset, step, env.close)


def process_driver(engine: str, processes: int, total: int, script: Script) -> Driver:
    """Driver of an environment in each of several processes."""
    # Processes are spawned, not forked: the kernels' threads would not survive a fork.
    make = functools.partial(make_single, engine, script)
    env = gym.vector.AsyncVectorEnv([make] * processes, context="spawn")

    def reset(worlds: Sequence[int]) -> NDArray[np.float32]:
        return np.asarray(env.reset(seed=list(worlds))[0])

    def step(actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], FloatArray]:
        observations, _, _, _, infos = env.step(actions)
        return np.asarray(observations), np.asarray(infos["force"])

    total = max(total // processes, 1) * processes
    return Driver(processes, total, script, reset, step, env.close)


def vector_driver(worlds: int, threads: int, script: Script, env: Any = None) -> Driver:
    """Driver of all worlds at once, in a given vector environment or a new one from `make_vec`."""
    if env is None:
        with numba_threads(threads):
            env = gym.make_vec(ENVIRONMENT, num_envs=worlds)

    def reset(indices: Sequence[int]) -> NDArray[np.float32]:
        starts = [script.start(world) for world in indices]
        options = {name: np.array([start[name] for start in starts]) for name in starts[0]}
        return np.asarray(env.reset(seed=list(indices), options=options)[0])

    def step(actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], FloatArray]:
        observations, _, _, _, infos = env.step(actions)
        return np.asarray(observations), np.asarray(infos["force"])

    return Driver(worlds, worlds, script, reset, step, env.close, threads)


@dataclass
class EpisodeDriver:
    """Side that plays whole episodes under a policy. A reset is a timed call too, but does not count as a step.

    Attributes:
        worlds: Number of worlds that play at a time.
        total: Number of episodes; they are played group by group, and their number is their seed.
        length: Control steps in an episode.
        begin: Makes a policy for some episodes, which maps observations (W, D) to actions (W, 3).
        reset: Begins episodes, and returns their observations (W, D).
        step: Makes a control step with actions (W, 3), and returns observations and forces (W,).
        close: Frees all resources.
        threads: Number of threads.
        contact_share: Share of the control steps, over all worlds, in which the tool felt a force.
    """

    worlds: int
    total: int
    length: int
    begin: Callable[[Sequence[int]], Callable[[NDArray[np.float32]], NDArray[np.float32]]]
    reset: Callable[[Sequence[int]], NDArray[np.float32]]
    step: Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], FloatArray]]
    close: Callable[[], None]
    threads: int = 1
    contact_share: float = 0.0
    steps: int = field(init=False)

    def __post_init__(self) -> None:
        """Count."""
        self.steps = self.total * self.length

    def turn(self, calls: int | None = None) -> FloatArray:
        """See `Side`."""
        seconds: list[float] = []
        forces: list[FloatArray] = []
        with numba_threads(self.threads):
            for first in range(0, self.total if calls is None else 1, self.worlds):
                seeds = range(first, first + self.worlds)
                act = self.begin(seeds)
                start = time.perf_counter()
                observations = self.reset(seeds)
                seconds.append(time.perf_counter() - start)
                for _ in range(self.length if calls is None else calls - 1):
                    actions = act(observations)
                    start = time.perf_counter()
                    observations, force = self.step(actions)
                    seconds.append(time.perf_counter() - start)
                    forces.append(force)
        self.contact_share = float(np.mean(np.array(forces) > 0.0))
        return np.array(seconds)


def policy_of(name: str, env: Any) -> Callable[[Sequence[int]], Callable[[NDArray[np.float32]], NDArray[np.float32]]]:
    """The `EpisodeDriver.begin` of a policy, "random" or "expert", in an environment."""
    if name == "expert":
        expert = PressExpert(env)
        return lambda seeds: expert

    def begin(seeds: Sequence[int]) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
        generators = [np.random.default_rng([seed, 2]) for seed in seeds]
        return lambda _: np.array([generator.uniform(-1.0, 1.0, 3) for generator in generators], dtype=np.float32)

    return begin


def single_episodes(engine: str, policy: str, total: int, length: int) -> EpisodeDriver:
    """Driver of one environment that plays episodes one after the other."""
    env = gym.make(ENVIRONMENT, engine=engine, disable_env_checker=True)

    def reset(seeds: Sequence[int]) -> NDArray[np.float32]:
        return np.asarray(env.reset(seed=seeds[0])[0])[None]

    def step(actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], FloatArray]:
        observation, _, _, _, info = env.step(actions[0])
        return np.asarray(observation)[None], np.array([info["force"]])

    return EpisodeDriver(1, total, length, policy_of(policy, env), reset, step, env.close)


def vector_episodes(worlds: int, policy: str, length: int) -> EpisodeDriver:
    """Driver of one episode in each world of `make_vec`, on one thread."""
    with numba_threads(1):
        env: Any = gym.make_vec(ENVIRONMENT, num_envs=worlds)

    def reset(seeds: Sequence[int]) -> NDArray[np.float32]:
        return np.asarray(env.reset(seed=list(seeds))[0])

    def step(actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], FloatArray]:
        observations, _, _, _, infos = env.step(actions)
        return np.asarray(observations), np.asarray(infos["force"])

    return EpisodeDriver(worlds, worlds, length, policy_of(policy, env), reset, step, env.close)


class Watch:
    """Wraps a function, and adds up the time spent in it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Wrap a function."""
        self._function = function
        self.seconds = 0.0

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call it."""
        start = time.perf_counter()
        result = self._function(*arguments, **named)
        self.seconds += time.perf_counter() - start
        return result


class Parts:
    """A vector environment on one thread whose parts are timed.

    Attributes:
        driver: Driver that plays in it.
        watches: Watches of the parts, by name.
    """

    def __init__(self, worlds: int, script: Script) -> None:
        """Make the environment and insert the watches."""
        with numba_threads(1):
            env = gym.make_vec(ENVIRONMENT, num_envs=worlds)
        base: Any = env.unwrapped
        self.watches: dict[str, Watch] = {}
        for name, owner, method in (
            ("advance", base.worlds, "advance"),
            ("task", base.task, "evaluate"),
            ("observation", base.observation_builder, "build"),
        ):
            self.watches[name] = Watch(getattr(owner, method))
            setattr(owner, method, self.watches[name])
        self.driver = vector_driver(worlds, 1, script, env)
        step = self.driver.step
        self._rows: list[dict[str, float]] = []

        def watched_step(actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], FloatArray]:
            for watch in self.watches.values():
                watch.seconds = 0.0
            result = step(actions)
            self._rows.append({name: watch.seconds for name, watch in self.watches.items()})
            return result

        self.driver.step = watched_step

    def turn(self) -> dict[str, FloatArray]:
        """Play a turn; returns the time of each part in each timed control step (C,), and of the whole, "step" [s]."""
        self._rows.clear()
        seconds = self.driver.turn()
        rows = self._rows[-len(seconds) :]
        return {"step": seconds, **{name: np.array([row[name] for row in rows]) for name in self.watches}}


# All sides in turn -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Size:
    """How much is measured.

    Attributes:
        rounds: Number of turns of each side.
        worlds: Numbers of worlds of the batch engine.
        vectors: Numbers of worlds of the vector environments.
        body_calls: Timed calls in a turn of a body with one world; fewer with more worlds.
        press_depth: Depth of the press [u].
        press_places: Number of places at which a single simulation presses in a turn.
        episodes: Number of scripted episodes of a single environment in a turn.
        whole_episodes: Number of whole episodes of a single environment in a turn, for each policy.
        episode_length: Control steps in a whole episode.
        down: Untimed control steps of a scripted episode.
        calls: Timed control steps of a scripted episode.
    """

    rounds: int = 3
    worlds: tuple[int, ...] = (1, 16, 64, 256)
    vectors: tuple[int, ...] = (64, 256)
    body_calls: int = 40
    press_depth: float = DEPTH
    press_places: int = 2
    episodes: int = 8
    whole_episodes: int = 2
    episode_length: int = 200
    down: int = 6
    calls: int = 16


def measure(size: Size, tell: Callable[[str], None]) -> dict[str, Any]:
    """Let all sides take turns.

    Args:
        size: How much is measured.
        tell: Receives progress messages.

    Returns:
        Rows by part, the shares of the parts of a control step, and the speed-up of two threads.
    """
    cores = available_cores()
    scene = scenes.seed()
    threads = min(cores, numba.get_num_threads())
    tell("loading and compiling")
    sides: dict[tuple[str, str], Side] = {}
    script = make_script(size.down, size.calls)
    parts = Parts(MANY if MANY in size.vectors else size.vectors[0], script)
    try:
        _make_bodies(scene, size, sides)
        _make_presses(scene, size, threads, sides)
        _make_environments(size, script, cores, threads, sides)
        _make_episodes(size, sides)
        tell("warming up")
        for side in (*sides.values(), parts.driver):
            side.turn(WARM_UP_CALLS)
        seconds: dict[tuple[str, str], list[FloatArray]] = {key: [] for key in sides}
        watched: list[dict[str, FloatArray]] = []
        for index in range(size.rounds):
            for key, side in sides.items():
                if side.worlds > MANY and index != size.rounds // 2:
                    continue
                start = time.perf_counter()
                seconds[key].append(side.turn())
                tell(f"round {index + 1} of {size.rounds}: {key[0]}, {key[1]} ({time.perf_counter() - start:.1f} s)")
            watched.append(parts.turn())
        timings = {key: Timing(side, np.array(seconds[key])) for key, side in sides.items()}
        result: dict[str, Any] = {
            part: _rows({name: timing for (owner, name), timing in timings.items() if owner == part})
            for part in ("body", "press", "environment")
        }
        result["episodes"] = {
            policy: _rows({name: timing for (owner, name), timing in timings.items() if owner == f"{policy} episodes"})
            for policy in POLICIES
        }
        period = script.physics_steps * scene.dt
        for rows in (result["environment"], *result["episodes"].values()):
            for row in rows.values():
                row["simulated_seconds_per_second"] = row["steps_per_second"] * period
        for part in ("body", "press"):
            for row in result[part].values():
                row["simulated_seconds_per_second"] = row["steps_per_second"] * scene.dt
        # The speed with ground and contact, relative to PyBullet's step without either.
        bare = result["body"]["bullet"]["steps_per_second"]
        for row in result["press"].values():
            row["ratio_to_bare_bullet"] = row["steps_per_second"] / bare
        result["parts"] = _share_out(watched, parts.driver, result["body"])
        result["two_threads"] = _compare_threads(result, threads)
    finally:
        for side in (*sides.values(), parts.driver):
            side.close()
    return {"dt": scene.dt, "cores": cores, "numba_threads": threads, **result}


def _make_bodies(scene: Scene, size: Size, sides: dict[tuple[str, str], Side]) -> None:
    sides["body", "bullet"] = BulletBody(scene, size.body_calls, CONTROL_STEP)
    for worlds in size.worlds:
        calls = _fewer(size.body_calls, worlds)
        sides["body", f"batch {worlds}"] = CompiledBody(scene, worlds, calls, CONTROL_STEP)
        if worlds == MANY:
            sides["body", f"batch {worlds} double"] = CompiledBody(scene, worlds, calls, CONTROL_STEP, np.float64)


def _fewer(calls: int, worlds: int) -> int:
    """Number of timed calls for a number of worlds; with more worlds calls are longer, and fewer of them suffice."""
    return max(calls // max(worlds // 4, 1), min(calls, 4))


def _make_presses(scene: Scene, size: Size, threads: int, sides: dict[tuple[str, str], Side]) -> None:
    plan = make_press(scene, max(*size.worlds, size.press_places), size.press_depth)
    few = Press(plan.places[: size.press_places], plan.velocities)
    sides["press", "bullet"] = PressOfOne(scene, "bullet", few)
    sides["press", "batch simulation"] = PressOfOne(scene, "batch", few)
    for worlds in size.worlds:
        here = Press(plan.places[:worlds], plan.velocities)
        sides["press", f"batch {worlds}"] = PressOfMany(scene, here)
        if worlds == MANY:
            sides["press", f"batch {worlds} double"] = PressOfMany(scene, here, dtype=np.float64)
            for count in sorted({2, threads}):
                if 1 < count <= threads:
                    sides["press", f"batch {worlds} on {count} threads"] = PressOfMany(scene, here, count)


def _make_environments(
    size: Size, script: Script, cores: int, threads: int, sides: dict[tuple[str, str], Side]
) -> None:
    sides["environment", "bullet"] = single_driver("bullet", size.episodes, script)
    if cores > 1:
        name = f"bullet in {cores} processes"
        sides["environment", name] = process_driver("bullet", cores, size.episodes, script)
    sides["environment", "batch"] = single_driver("batch", size.episodes, script)
    for worlds in size.vectors:
        for count in sorted({1, threads}):
            name = f"batch {worlds}" + ("" if count == 1 else f" on {count} threads")
            sides["environment", name] = vector_driver(worlds, count, script)


def _make_episodes(size: Size, sides: dict[tuple[str, str], Side]) -> None:
    for policy in POLICIES:
        part = f"{policy} episodes"
        for engine in ("bullet", "batch"):
            sides[part, engine] = single_episodes(engine, policy, size.whole_episodes, size.episode_length)
        worlds = MANY if MANY in size.vectors else size.vectors[0]
        sides[part, f"batch {worlds}"] = vector_episodes(worlds, policy, size.episode_length)


def _rows(timings: Mapping[str, Timing]) -> dict[str, dict[str, Any]]:
    """Make a row of figures for each side, with its speed relative to PyBullet's."""
    reference = timings["bullet"].steps_per_second
    rows: dict[str, dict[str, Any]] = {}
    for name, timing in timings.items():
        side, rate = timing.side, timing.steps_per_second
        rows[name] = {
            "worlds": side.worlds,
            "threads": side.threads,
            "steps_per_second": rate,
            "microseconds": 1e6 / rate,
            "ratio": rate / reference,
            "spread": timing.spread,
        }
        if hasattr(side, "contact_share"):
            rows[name]["contact_share"] = side.contact_share
    return rows


def _share_out(watched: Sequence[dict[str, FloatArray]], driver: Driver, bodies: Mapping[str, Any]) -> dict[str, Any]:
    """Where the time of a control step goes, in microseconds per world and as shares."""
    worlds = driver.worlds
    medians = {
        name: 1e6 * float(np.median([turn[name] for turn in watched], axis=0).mean()) / worlds for name in watched[0]
    }
    physics = bodies.get(f"batch {worlds}")
    body = driver.script.physics_steps * physics["microseconds"] if physics is not None else 0.0
    microseconds = {
        "physics": body,
        "contact and ground": medians["advance"] - body,
        "task": medians["task"],
        "observation": medians["observation"],
        "rest": medians["step"] - medians["advance"] - medians["task"] - medians["observation"],
    }
    return {
        "worlds": worlds,
        "control_step_microseconds": medians["step"],
        "microseconds": microseconds,
        "share": {name: value / medians["step"] for name, value in microseconds.items()},
    }


def _compare_threads(result: Mapping[str, Any], threads: int) -> dict[str, Any]:
    """Speed-up of two threads over one, with 64 worlds."""
    if threads < 2:
        return {"ratio": None, "reason": "there is one core only"}
    row: dict[str, Any] = {"ratio": None, "reason": f"{MANY} worlds were not measured"}
    for part, name in (("press", "ratio"), ("environment", "environment_ratio")):
        one, two = (result[part].get(f"batch {MANY}{more}") for more in ("", " on 2 threads"))
        if one is not None and two is not None:
            row[name] = two["steps_per_second"] / one["steps_per_second"]
            row["reason"] = None
    return row


def judge(result: Mapping[str, Any], cold: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Compare the figures with the limits.

    Args:
        result: Result of `measure`.
        cold: Result of `first_steps`.

    Returns:
        Value, limit and verdict of each limit ("thresholds") and each target beyond ("stretch"), and whether all limits
        have "passed". A figure that could not be measured neither passes nor fails.
    """
    many, one = f"batch {MANY}", "batch 1"
    ratios = {
        (part, name): row["ratio"] for part in ("body", "press", "environment") for name, row in result[part].items()
    }
    episodes = {policy: rows.get(many, {}).get("ratio") for policy, rows in result["episodes"].items()}
    speeds = [
        row["simulated_seconds_per_second"]
        for rows in (result["environment"], *result["episodes"].values())
        for name, row in rows.items()
        if name.startswith("batch") and row["threads"] == 1
    ]
    values: dict[str, float | None] = {
        "body_64_worlds": ratios.get(("body", many)),
        "body_one_world": ratios.get(("body", one)),
        "press_64_worlds": ratios.get(("press", many)),
        "press_one_world": ratios.get(("press", "batch simulation")),
        "environment_64_worlds": ratios.get(("environment", many)),
        "random_episodes_64_worlds": episodes["random"],
        "expert_episodes_64_worlds": episodes["expert"],
        "two_threads": result["two_threads"]["ratio"],
        "simulated_seconds": max(speeds, default=None),
    }

    def compare(limits: Mapping[str, float]) -> dict[str, Any]:
        rows: dict[str, Any] = {}
        for name, limit in limits.items():
            value = values[name]
            rows[name] = {"value": value, "limit": limit, "passed": None if value is None else value >= limit}
        return rows

    thresholds = compare(LIMITS)
    for name, value in (cold or {}).items():
        limit = COLD_LIMITS[name]
        thresholds[f"cold_{name}"] = {"value": value, "limit": limit, "passed": value <= limit}
    return {
        "thresholds": thresholds,
        "stretch": compare(STRETCH),
        "passed": all(row["passed"] is not False for row in thresholds.values()),
    }


def first_steps(tell: Callable[[str], None], code: str = FIRST_STEP) -> dict[str, float]:
    """Time two new processes up to the end of their first step: one compiles all kernels, the other finds them cached.

    Args:
        tell: Receives progress messages.
        code: Source code that they run.

    Returns:
        Durations [s], by the names of `COLD_LIMITS`.
    """
    root = str(Path(__file__).parents[1])
    seconds = {}
    with tempfile.TemporaryDirectory() as cache:
        paths = os.pathsep.join(path for path in (root, os.environ.get("PYTHONPATH")) if path)
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": paths}
        for name in COLD_LIMITS:
            tell(f"first step of a new process, {name.replace('_', ' ')}")
            call = functools.partial(
                subprocess.run, [sys.executable, "-c", code], env=environment, check=True, stdout=subprocess.DEVNULL
            )
            seconds[name] = timed(call)
    return seconds


# Printing ----------------------------------------------------------------------------------------------------------


def _print_rows(title: str, rows: Mapping[str, dict[str, Any]]) -> None:
    print(f"\n{title}")
    bare = any("ratio_to_bare_bullet" in row for row in rows.values())
    print(
        f"  {'':26}{'steps/s':>10}{'us':>10}{'x PyBullet':>12}{'x its bare step' if bare else '':>17}{'sim s/s':>9}"
        f"{'contact':>9}{'spread':>8}"
    )
    for name, row in rows.items():
        contact = f"{100 * row['contact_share']:.0f} %" if "contact_share" in row else ""
        to_bare = f"{row['ratio_to_bare_bullet']:.2f}" if bare else ""
        print(
            f"  {name:26}{row['steps_per_second']:10.0f}{row['microseconds']:10.1f}{row['ratio']:12.2f}{to_bare:>17}"
            f"{row['simulated_seconds_per_second']:9.1f}{contact:>9}{100 * row['spread']:6.0f} %"
        )


def show(result: Mapping[str, Any]) -> None:
    """Print tables."""
    _print_rows("body: physics steps of one world; PyBullet's stepSimulation and BatchBody.step", result["body"])
    _print_rows("press: physics steps of one world, with ground, contact and report", result["press"])
    _print_rows(f"environment: control steps of one world of {ENVIRONMENT}, in contact", result["environment"])
    for policy, rows in result["episodes"].items():
        _print_rows(f"episodes: control steps of one world of {ENVIRONMENT}, {policy} policy, resets included", rows)
    parts = result["parts"]
    print(f"\nparts: a control step of one of {parts['worlds']} worlds on one thread")
    for name, value in parts["microseconds"].items():
        print(f"  {name:26}{value:10.1f} us {100 * parts['share'][name]:6.1f} %")
    print(f"  {'all':26}{parts['control_step_microseconds']:10.1f} us")
    threads = result["two_threads"]
    if threads["reason"]:
        print(f"\ntwo threads: not measured, {threads['reason']}")
    print(f"\n{'asked for':40}{'value':>10}{'limit':>10}")
    for title, rows in (("", result["thresholds"]), ("hoped for: ", result["stretch"])):
        for name, row in rows.items():
            value = "-" if row["value"] is None else f"{row['value']:.2f}"
            verdict = {None: "not measured", True: "passed", False: "FAILED" if not title else "not yet"}[row["passed"]]
            print(f"  {title + name.replace('_', ' '):38}{value:>10}{row['limit']:10g}  {verdict}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--rounds", type=int, default=Size.rounds, help="turns of each side")
    options.add_argument("--cold", action="store_true", help="also time the first step of new processes (minutes)")
    given = options.parse_args(arguments)
    require_bullet("throughput")
    start = time.perf_counter()

    def tell(words: str) -> None:
        print(f"{time.perf_counter() - start:6.1f} s  {words}", file=sys.stderr, flush=True)

    cold = first_steps(tell) if given.cold else None
    result = measure(Size(rounds=given.rounds), tell)
    result.update(rounds=given.rounds, cold=cold, **judge(result, cold), seconds=time.perf_counter() - start)
    if not given.json:
        show(result)
    finish({"benchmark": "throughput", **result})


if __name__ == "__main__":
    main()
