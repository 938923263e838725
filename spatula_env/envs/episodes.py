"""What one environment and many at once have in common: worlds, a control, a task and an observation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import create_empty_array
from numpy.typing import NDArray

from spatula_env.envs.control import VelocityControl, Workspace
from spatula_env.envs.frames import Frames
from spatula_env.envs.observations import FrameMemory, Observation, ObservationBuilder
from spatula_env.envs.randomization import NEUTRAL, draw
from spatula_env.envs.settings import Definition, EnvSettings, check_choice
from spatula_env.tasks.base import (
    BoolArray,
    Evaluation,
    FloatArray,
    IntArray,
    Setting,
    Situation,
    Start,
    ToolShape,
    weighted_sum,
)

if TYPE_CHECKING:
    from spatula_env.envs.control import Motion
    from spatula_env.scenes import Scene
    from spatula_env.sim.worlds import Loads, Worlds
    from spatula_env.tasks.marks import Mark

START_OPTIONS = ("goal", "tool_position")
"""What of an episode's beginning can be chosen."""

COST_PRESSURE = 2670.0
"""Pressure from which on cost is counted, 20 mmHg [Pa]. Rats whose brains were retracted with no more for 15 minutes
were spared damage (J. Rosenorn and N. Diemer, J Neurosurg 63:608, 1985): that is a dose, and no limit for a moment."""

VIOLATION_PRESSURE = 4000.0
"""Pressure that is flagged, 30 mmHg [Pa]: with it, for as long, five brains of six had infarcts (the same source)."""

Info = dict[str, NDArray[Any]]
"""What there is to tell of W worlds: (W,) each, under keys that never change."""

Pictures = Callable[[IntArray], Mapping[str, NDArray[Any]]]
"""Makes the pictures of some worlds (n,): "image" (n, height, width, 3), and "depth" (n, height, width, 1) [m]."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a control step led to, beside observation and info.

    Attributes:
        reward: (W,) zero where physics has diverged.
        terminated: (W,) whether the episode ends, by success or by damage.
        diverged: (W,) whether physics has broken down: the episode cannot go on.
    """

    reward: FloatArray
    terminated: BoolArray
    diverged: BoolArray


class Episodes:
    """Runs an episode in each of W worlds.

    It knows neither when an episode is cut nor when a new one begins: environments decide that.

    Attributes:
        worlds: The physics.
        workspace: The cube that the grip is kept in, if nothing is shifted.
        frames: Where it is and in what units, world by world.
        setting: What all episodes have in common, as far as nothing of it is drawn at random.
        task: What is asked.
        control: What an action means.
        observation_builder: How observations are laid out.
        action_space: Of one world.
        steps_per_action: Physics steps in a control step.
        period: Length of a control step [s].
        goals: (W, G) what is asked in each world's episode.
        elapsed: (W,) control steps since each episode began.
        situation: Of all worlds, as it was last looked at; None before anything has begun.
    """

    def __init__(
        self, definition: Definition, settings: EnvSettings, load: Callable[[Scene], Worlds], pictures: Any = None
    ) -> None:
        """Put the parts together.

        Args:
            definition: Scene and task.
            settings: From `Definition.read`.
            load: Makes worlds of the scene in which all is at rest; they are closed by `close`, and if the rest of
                the construction fails.
            pictures: Makes what draws observed pictures, from these episodes; see `Pictures`.

        Raises:
            ValueError: If an option is not one of those allowed, or a number is out of its range.
        """
        self.scene = scene = definition.scene()
        if len(scene.organs) != 1:
            raise ValueError(f"scene must have one organ, got {len(scene.organs)}")
        self.settings = settings
        self.steps_per_action = _count_steps(settings.control_frequency, scene.dt)
        self.period = self.steps_per_action * scene.dt
        self._sparse = settings.reward == "sparse"
        self._shares = [_share_of_face(placed.tool.face) for placed in scene.tools]

        self.worlds = load(scene)
        try:
            self._put_together(definition, scene)
            self._draw_pictures: Pictures | None = None
            if self.observation_builder.needs_picture:
                self._draw_pictures = pictures(self)
        except BaseException:
            self.worlds.close()
            raise

    def _put_together(self, definition: Definition, scene: Scene) -> None:
        settings, count = self.settings, self.worlds.count
        self.workspace = place_workspace(scene, self.worlds.nodes[0], definition.workspace_height)
        self.setting = setting_of(scene, self.workspace, self.worlds.nodes[0], self.worlds.triangles, self.period)
        top = (*self.workspace.center[:2], float(self.worlds.nodes[0, :, 2].max()))
        self._rest = np.array(self.worlds.nodes[0])
        self.frames = Frames(self.workspace, scene.scale, top, count)
        self.task = definition.task(settings.task, self.setting)
        self.control = VelocityControl(
            definition.controls[settings.control],
            self.setting,
            settings.max_speed,
            settings.max_rotation_rate,
            settings.max_jaw_speed,
            definition.stop_height,
        )
        self.observation_builder = ObservationBuilder(
            self.setting,
            self.task,
            self.control,
            settings.obs_mode,
            settings.observation,
            goal_interface=self._sparse,
        )
        self.action_space = spaces.Box(-1.0, 1.0, (self.control.size,), dtype=np.float32)
        self._steps_to_hold = max(1, round(self.task.hold_time / self.period))
        self.goals: FloatArray = np.zeros((count, len(self.task.goal_names)))
        self.elapsed: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self.situation: Situation | None = None
        self._settings = [self.setting] * count
        self._rest_nodes: FloatArray = self.setting.rest_nodes[None]
        self._memory = self.task.new_memory(count)
        self._tool_scale: FloatArray = np.ones(count)
        self._held: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self._succeeded: BoolArray = np.zeros(count, dtype=np.bool_)
        self._safety = Safety(count)
        self._node_pressures = [np.zeros((count, len(tool.nodes))) for tool in self.setting.tools]
        self._drawn = {name: np.full(count, value) for name, value in NEUTRAL.items()}
        self._drawn["sensor_noise"][:] = settings.observation.noise
        self._noise: list[np.random.Generator | None] = [None] * count
        longest = int(settings.randomization.get("action_delay", (0, 0))[1])
        self._asked: FloatArray = np.zeros((count, longest + 1, self.control.size))
        self._frames = FrameMemory(settings.observation)
        self._observation: Observation = create_empty_array(self.observation_builder.space, count)  # type: ignore[assignment]
        self._info: Info = {}

    @property
    def count(self) -> int:
        """W."""
        return len(self.elapsed)

    @property
    def forces(self) -> FloatArray:
        """(W, N, 3) on the tools of each world, averaged over the last control step [N]."""
        shape = (self.count, len(self.setting.tools), 3)
        return np.zeros(shape) if self.situation is None else self.situation.contact_forces

    @property
    def pressures(self) -> tuple[FloatArray, ...]:
        """(W, n) for each tool: on its contact nodes in the last physics step [Pa]."""
        return tuple(pressures.copy() for pressures in self._node_pressures)

    @property
    def observation(self) -> Observation:
        """The observations of all worlds, as Gymnasium batches them; arrays of their own."""
        if isinstance(self._observation, dict):
            return {name: values.copy() for name, values in self._observation.items()}
        return self._observation.copy()

    @property
    def info(self) -> Info:
        """What else there is to tell of all worlds; arrays of their own."""
        return {name: values.copy() for name, values in self._info.items()}

    @property
    def compute_reward(self) -> Callable[[NDArray[Any], NDArray[Any], Any], NDArray[np.float32]]:
        """The sparse reward of goals, of (achieved_goal, desired_goal, info); see `SpatulaEnv.compute_reward`."""
        if not self._sparse:
            raise AttributeError("compute_reward needs the goal interface: make the environment with reward='sparse'")
        task = self.task

        def compute(achieved: NDArray[Any], desired: NDArray[Any], info: Any) -> NDArray[np.float32]:
            return task.compute_reward(achieved, desired)

        return compute

    def to_scene(self, points: FloatArray, world: int) -> FloatArray:
        """Points (K, 3) in the workspace frame of a world [m] in the scene [u]."""
        scene_points: FloatArray = self.frames.points_to_scene(points[None], np.array([world]))[0]
        return scene_points

    def marks(self, world: int) -> tuple[Mark, ...]:
        """What shows the goal of a world in a picture, in its workspace frame [m]."""
        row = np.array([world])
        situation = None if self.situation is None else self.situation.rows(row)
        memory = {name: values[row] for name, values in self._memory.items()}
        return self.task.marks(self.goals[world], situation, memory)

    def choose(self, options: Mapping[str, Any] | None, worlds: IntArray) -> dict[str, FloatArray]:
        """Check what is chosen of an episode's beginning.

        Args:
            options: "goal" (G,) or (W, G), and "tool_position" (3,) or (W, 3) [m].
            worlds: (n,) those in which an episode is to begin; the rows of others are not looked at.

        Returns:
            What there is of the two, (n, G) and (n, 3).

        Raises:
            ValueError: If an option is unknown, malformed or out of its range.
        """
        chosen: dict[str, FloatArray] = {}
        for name, value in (options or {}).items():
            check_choice(name, "options", START_OPTIONS)
            size = self.goals.shape[1] if name == "goal" else 3
            try:
                array = np.array(value, dtype=np.float64)
            except (TypeError, ValueError):
                array = np.zeros(0)
            fits = array.shape in ((size,), (self.count, size))
            rows = np.broadcast_to(array, (self.count, size))[worlds] if fits else array
            if not fits or not np.isfinite(rows).all():
                each = f", or {self.count} times {size}" if self.count > 1 else ""
                raise ValueError(f"options[{name!r}] must be {size} finite numbers{each}, got {value!r}")
            chosen[name] = rows
        for goal in np.unique(chosen.get("goal", self.goals[:0]), axis=0):
            self.task.check_goal(goal)
        low, high = self.workspace.low, self.workspace.high
        for position in chosen.get("tool_position", ()):
            if ((position < low) | (position > high)).any():
                raise ValueError(f"options['tool_position'] must lie in {low} to {high} m, got {position}")
        return chosen

    def begin(
        self, generators: Mapping[int, np.random.Generator], chosen: Mapping[str, FloatArray] | None = None
    ) -> None:
        """Begin an episode in some worlds: the organ at rest, a new goal, the tools at a new place.

        Args:
            generators: The worlds, and where the randomness of each comes from.
            chosen: What is not left to chance, from `choose`.
        """
        worlds = np.fromiter(generators, dtype=np.int64)
        if self.settings.randomization or self.settings.observation.noise > 0.0:
            self._draw(worlds, generators)
        # Drawn in any case, so that choices do not change the episodes after this one; and one by one, so that a
        # world's episodes depend on its own generator only.
        settings = [self._settings[world] for world in worlds.tolist()]
        start = Start.joined(
            [
                self.task.sample(generator, 1, setting)
                for generator, setting in zip(generators.values(), settings, strict=True)
            ]
        )
        start = replace(start, **(chosen or {}))
        self.worlds.reset(worlds)
        scale = self._tool_scale[worlds]
        positions, orientations = self.control.place(start.tool_position, start.tool_orientation, start.control, scale)
        self.worlds.place_tools(
            self.frames.points_to_scene(positions, worlds),
            self.frames.orientations_to_scene(orientations, worlds),
            worlds,
        )
        self.goals[worlds] = start.goal
        self.elapsed[worlds], self._held[worlds], self._succeeded[worlds] = 0, 0, False
        self._asked[worlds] = 0.0
        self._safety.begin(worlds)
        for pressures in self._node_pressures:
            pressures[worlds] = 0.0
        self.task.begin_memory(self._memory, worlds, start, settings)
        count = len(worlds)
        situation = Situation.at_rest(
            self.setting,
            start.tool_position,
            orientations[:, 0],
            action_size=self.control.size,
            tool_positions=positions,
            tool_orientations=orientations,
            tool_scale=scale,
            control=self.control.opening(positions, scale),
            control_rate=np.zeros((count, self.control.coordinates)),
            nodes=self.frames.points_from_scene(self.worlds.nodes[worlds], worlds),
            rest_nodes=self._rest_of(worlds),
        )
        self._show(situation, worlds, first=True)

    def step(self, actions: FloatArray) -> Outcome:
        """Move all tools for one control step.

        Args:
            actions: (W, A) in [-1, 1].

        Returns:
            What that led to. Where physics has diverged, observation and info stay those of the step before, but for
            what info tells of the divergence.
        """
        worlds, frames = self.worlds, self.frames
        every = np.arange(self.count)
        positions = frames.points_from_scene(worlds.tool_positions, every)
        orientations = frames.orientations_from_scene(worlds.tool_orientations, every)
        motion = self.control.motion(
            self._delayed(actions), positions.mean(axis=1), positions, orientations, self.period, self._tool_scale
        )
        loads = worlds.advance(
            frames.velocities_to_scene(motion.linear),
            frames.rates_to_scene(motion.angular),
            self.steps_per_action,
            COST_PRESSURE / frames.pressure,
        )
        lost = loads.diverged
        going = np.flatnonzero(~lost)
        situation = self._situation(motion, actions, loads)
        self.elapsed += 1
        self._node_pressures = [pressures * frames.pressure[:, None] for pressures in loads.node_pressures]
        if lost.any():
            self._info["diverged"][lost] = True
        self._safety.count(situation, motion, loads, frames, self.period, going)
        reward = np.zeros(self.count)
        if len(going) == self.count:
            reward[:] = self._judge(situation, going)
        elif len(going):
            reward[going] = self._judge(situation.rows(going), going)
        terminated = self._succeeded & self.settings.terminate_on_success
        if self.settings.damage_limit is not None:
            terminated |= self._safety.damaged(self.settings.damage_limit)
        return Outcome(reward, terminated, lost)

    def close(self) -> None:
        """Free the engine. Closing twice is allowed."""
        self.worlds.close()

    def _delayed(self, actions: FloatArray) -> FloatArray:
        """What is carried out now (W, A), after what is asked now (W, A)."""
        if self._asked.shape[1] == 1:
            return actions
        self._asked[:, :-1] = self._asked[:, 1:]
        self._asked[:, -1] = actions
        late = self._drawn["action_delay"].astype(np.int64)
        return np.asarray(self._asked[np.arange(self.count), self._asked.shape[1] - 1 - late])

    def _draw(self, worlds: IntArray, generators: Mapping[int, np.random.Generator]) -> None:
        """Draw what differs from episode to episode."""
        ranges = self.settings.randomization
        for world, generator in generators.items():
            # A generator of its own: goals and starts are then those of an environment without all this, and do not
            # depend on how long the episode before was.
            (child,) = generator.spawn(1)
            self._noise[world] = child
            for name, value in draw(ranges, child).items():
                if name in ranges:
                    self._drawn[name][world] = value
        if not ranges:
            return
        drawn = {name: values[worlds] for name, values in self._drawn.items()}
        self.frames.set(
            worlds,
            shift=np.stack([drawn["organ_x"], drawn["organ_y"]], axis=1),
            yaw=drawn["organ_yaw"],
            size=drawn["organ_size"],
            stiffness=drawn["stiffness"],
        )
        self._tool_scale[worlds] = drawn["tool_size"]
        if {"friction", "tool_size", "organ_size"} & set(ranges):
            self.worlds.vary(drawn["friction"], drawn["tool_size"] / drawn["organ_size"], worlds)
        for row, world in enumerate(worlds.tolist()):
            self._settings[world] = self._setting_in(world, float(drawn["tool_size"][row]))
        self._rest_nodes = np.stack([setting.rest_nodes for setting in self._settings])

    def _setting_in(self, world: int, tool_size: float) -> Setting:
        """The setting of a world whose organ and tools have been drawn."""
        at = np.array([world])
        organ_position = np.array([[self.scene.organs[0].position]])
        ground = (0.0, 0.0, self._rest[:, 2].min() if self.scene.ground is None else self.scene.ground.height)
        return replace(
            self.setting,
            rest_nodes=np.ascontiguousarray(self.frames.points_from_scene(self._rest[None], at)[0]),
            ground_height=float(self.frames.points_from_scene(np.array([[ground]]), at)[0, 0, 2]),
            tools=tuple(
                replace(tool, vertices=tool.vertices * tool_size, nodes=tool.nodes * tool_size)
                for tool in self.setting.tools
            ),
            organ_position=self.frames.points_from_scene(organ_position, at)[0, 0],
            length=float(self.frames.length[world]),
        )

    def _rest_of(self, worlds: IntArray) -> FloatArray:
        return self._rest_nodes if len(self._rest_nodes) < self.count else self._rest_nodes[worlds]

    def _situation(self, motion: Motion, actions: FloatArray, loads: Loads) -> Situation:
        frames, worlds, every = self.frames, self.worlds, np.arange(self.count)
        positions = frames.points_from_scene(worlds.tool_positions, every)
        orientations = frames.orientations_from_scene(worlds.tool_orientations, every)
        grip = positions.mean(axis=1)
        forces = frames.vectors_from_scene(loads.forces, frames.force)
        torques = frames.vectors_from_scene(loads.torques, frames.torque)
        # With the lever arms at the end of the step: tools turn little about the grip in one.
        torque = (torques + np.cross(positions - grip[:, None], forces)).sum(axis=1)
        return Situation(
            tool_position=grip,
            tool_velocity=motion.velocity,
            tool_orientation=orientations[:, 0],
            tool_rotation_rate=motion.rate,
            tool_positions=positions,
            tool_orientations=orientations,
            tool_scale=self._tool_scale,
            control=self.control.opening(positions, self._tool_scale),
            control_rate=motion.coordinate_rate,
            contact_forces=forces,
            contact_force=forces.sum(axis=1),
            contact_torque=torque,
            peak_force=loads.peak_forces.max(axis=1) * frames.force,
            peak_pressure=loads.peak_pressures * frames.pressure,
            mean_pressure=loads.mean_pressures * frames.pressure,
            contact_share=np.concatenate(
                [flags @ share for flags, share in zip(loads.flags, self._shares, strict=True)], axis=1
            ),
            contact_depth=loads.penetrations * frames.length,
            nodes=frames.points_from_scene(worlds.nodes, every),
            rest_nodes=self._rest_nodes,
            action=actions,
            elapsed=np.asarray((self.elapsed + 1) * self.period, dtype=np.float64),
        )

    def _judge(self, situation: Situation, worlds: IntArray) -> FloatArray:
        """The reward (n,) of some worlds (n,), after counting how long each has fulfilled its goal."""
        evaluation = self._show(situation, worlds, first=False)
        if self._sparse:
            return self.task.compute_reward(evaluation.achieved, self.goals[worlds]).astype(np.float64)
        return weighted_sum(evaluation.terms, self.task.weights)

    def _show(self, situation: Situation, worlds: IntArray, *, first: bool) -> Evaluation:
        """Judge the situation of some worlds (n,), and renew their observation and info."""
        goals = self.goals[worlds]
        every = len(worlds) == self.count and bool((worlds[1:] > worlds[:-1]).all())
        memory = self._memory if every else {name: values[worlds] for name, values in self._memory.items()}
        evaluation = self.task.evaluate(situation, goals, memory)
        if not every:
            for name, values in memory.items():
                self._memory[name][worlds] = values
        within = evaluation.within_tolerance
        if not first:
            self._held[worlds] = held = np.where(within, self._held[worlds] + 1, 0)
            self._succeeded[worlds] |= held >= self._steps_to_hold
        self._keep(situation, worlds, every=every)
        self._observe(situation, goals, evaluation, worlds, first=first)
        info: Info = {
            "is_success": self._succeeded[worlds],
            "within_tolerance": within,
            "diverged": np.zeros(len(worlds), dtype=np.bool_),
            "hold_time": self._held[worlds] * self.period,
            "time": self.worlds.times[worlds],
            "force": np.sqrt((situation.contact_force**2).sum(axis=1)),
            "peak_force": situation.peak_force,
            "peak_pressure": situation.peak_pressure,
            "mean_pressure": situation.mean_pressure,
            **self._safety.info(worlds, self.settings.damage_limit),
            **evaluation.measures,
            **{f"reward/{name}": values for name, values in evaluation.terms.items()},
            **{f"randomization/{name}": self._drawn[name][worlds] for name in self.settings.randomization},
        }
        if every:
            self._info = info
        else:
            for name, values in info.items():
                self._info.setdefault(name, np.zeros(self.count, dtype=values.dtype))[worlds] = values
        return evaluation

    def _keep(self, situation: Situation, worlds: IntArray, *, every: bool) -> None:
        """Remember the situation of some worlds (n,)."""
        if every:
            self.situation = situation
            return
        if self.situation is None:
            blank = np.zeros(self.count, dtype=np.int64)
            self.situation = situation.rows(blank)
        for name, values in vars(situation).items():
            whole = np.array(getattr(self.situation, name))
            if len(whole) == self.count:
                whole[worlds] = values
            self.situation = replace(self.situation, **{name: whole})

    def _observe(
        self, situation: Situation, goals: FloatArray, evaluation: Evaluation, worlds: IntArray, *, first: bool
    ) -> None:
        """Renew the observations of some worlds (n,)."""
        builder = self.observation_builder
        noise, deviations = None, self._drawn["sensor_noise"][worlds]
        if (deviations > 0.0).any():
            size = sum(part.size for part in builder.parts)
            noise = deviations[:, None] * np.stack(
                [self._generator_of_noise(world).standard_normal(size) for world in worlds.tolist()]
            )
        pictures = None if self._draw_pictures is None else self._draw_pictures(worlds)
        frames = builder.build(situation, goals, evaluation, noise, pictures)
        late = self.settings.observation
        if late.delay or late.history > 1:
            self._frames.push(frames, worlds, self.count, first=first)
            frames, worlds = self._frames.show(), np.arange(self.count)
        if len(worlds) == self.count and (worlds[1:] > worlds[:-1]).all():
            self._observation = frames[""] if "" in frames else frames
            return
        whole = self._observation if isinstance(self._observation, dict) else {"": self._observation}
        for name, values in frames.items():
            whole[name][worlds] = values

    def _generator_of_noise(self, world: int) -> np.random.Generator:
        generator = self._noise[world]
        assert generator is not None
        return generator


class Safety:
    """Counts what the organs of W worlds suffer in an episode; none of it enters a reward."""

    _STEP = ("cost", "work")
    _TOTALS = ("cost", "work", "violation_time", "peak_force", "peak_pressure")

    def __init__(self, count: int) -> None:
        """Nothing suffered yet.

        Args:
            count: W.
        """
        self._now = {name: np.zeros(count) for name in self._STEP}
        self._violation: BoolArray = np.zeros(count, dtype=np.bool_)
        self._episode = {name: np.zeros(count) for name in self._TOTALS}

    def begin(self, worlds: IntArray) -> None:
        """Start counting anew in some worlds (n,)."""
        for values in (*self._now.values(), *self._episode.values()):
            values[worlds] = 0.0
        self._violation[worlds] = False

    def count(
        self,
        situation: Situation,
        motion: Motion,
        loads: Loads,
        frames: Frames,
        period: float,
        worlds: IntArray,
    ) -> None:
        """Add a control step of some worlds (n,)."""
        torques = frames.vectors_from_scene(loads.torques, frames.torque)
        power = -(situation.contact_forces * motion.linear + torques * motion.angular).sum(axis=(1, 2))
        self._now["cost"][worlds] = (loads.overpressures * frames.pressure)[worlds]
        self._now["work"][worlds] = power[worlds] * period
        self._violation[worlds] = (situation.peak_pressure > VIOLATION_PRESSURE)[worlds]
        episode = self._episode
        for name in self._STEP:
            episode[name][worlds] += self._now[name][worlds]
        episode["violation_time"][worlds] += period * self._violation[worlds]
        for name, values in (("peak_force", situation.peak_force), ("peak_pressure", situation.peak_pressure)):
            episode[name][worlds] = np.maximum(episode[name], values)[worlds]

    def damaged(self, limit: float) -> BoolArray:
        """(W,) whether an episode's cost exceeds a limit [Pa s]."""
        return np.asarray(self._episode["cost"] > limit)

    def info(self, worlds: IntArray, limit: float | None) -> Info:
        """What there is to tell of some worlds (n,)."""
        damaged = self.damaged(limit) if limit is not None else self._violation & False
        return {
            **{name: values[worlds] for name, values in self._now.items()},
            "violation": self._violation[worlds],
            "is_damaged": damaged[worlds],
            **{f"episode_{name}": values[worlds] for name, values in self._episode.items()},
        }


def place_workspace(scene: Scene, rest_nodes: FloatArray, height: float) -> Workspace:
    """The workspace above the organ's axis, its middle at a height above the organ's top [m]."""
    x, y, _ = scene.organs[0].position
    top = float(rest_nodes[:, 2].max())
    return Workspace((x, y, top + height / scene.scale.length), scene.scale.length)


def setting_of(
    scene: Scene,
    workspace: Workspace,
    rest_nodes: FloatArray | None = None,
    triangles: NDArray[np.int32] | None = None,
    period: float = 0.05,
) -> Setting:
    """The setting of a scene, for its task.

    Args:
        scene: With one organ.
        workspace: Where its tools may move; see `place_workspace`.
        rest_nodes: (V, 3) of the organ [u]; as the scene has it, before it has come to rest, by default.
        triangles: (T, 3) of the organ; its own by default.
        period: Length of a control step [s].
    """
    length = scene.scale.length
    placed = scene.organs[0]
    rest = np.array(placed.vertices) if rest_nodes is None else rest_nodes
    grip = np.mean([tool.position for tool in scene.tools], axis=0)
    ground = float(rest[:, 2].min()) if scene.ground is None else scene.ground.height
    tools = tuple(
        ToolShape(
            vertices=np.array(tool.tool.vertices) * length,
            orientation=np.array(tool.orientation),
            offset=(np.array(tool.position) - grip) * length,
            nodes=np.array(tool.tool.nodes) * length,
            normals=np.array(tool.tool.normals),
            face=np.array(tool.tool.face),
            triangles=np.array(tool.tool.triangles),
        )
        for tool in scene.tools
    )
    return Setting(
        rest_nodes=workspace.from_scene(rest),
        triangles=np.array(placed.organ.triangles if triangles is None else triangles),
        ground_height=float(workspace.from_scene((0.0, 0.0, ground))[2]),
        tools=tools,
        workspace_low=workspace.low,
        workspace_high=workspace.high,
        period=period,
        organ=placed.organ,
        organ_position=workspace.from_scene(placed.position),
        length=length,
    )


def _share_of_face(face: NDArray[np.int32]) -> FloatArray:
    """(n, F) what each contact node adds to the share of each face's nodes that are in contact."""
    return np.asarray((face[:, None] == np.arange(face.max() + 1)) / np.bincount(face))


def _count_steps(control_frequency: float, dt: float) -> int:
    """How many physics steps make a control step."""
    steps = 1.0 / (control_frequency * dt)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        raise ValueError(
            f"control_frequency must go a whole number of times into that of physics, {1.0 / dt:.6g} Hz; "
            f"got {control_frequency!r}"
        )
    return round(steps)
