"""Runs episodes in W worlds, from physics, control, task and observation; shared by single and vector environments."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import create_empty_array
from numpy.typing import NDArray

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.envs.control import VelocityControl
from spatula_env.envs.incentives import Incentives
from spatula_env.envs.observations import FrameMemory, Observation, ObservationBuilder
from spatula_env.envs.randomization import Variation
from spatula_env.envs.safety import Safety
from spatula_env.envs.scenery import scene_of, task_of
from spatula_env.envs.settings import Definition, EnvSettings
from spatula_env.envs.snapshots import EpisodesState, joined, save_physics
from spatula_env.envs.start_options import check_free, chosen_starts
from spatula_env.envs.steering import Steering, mean_of_track
from spatula_env.envs.strains import StrainCount
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.envs.workspace_frames import Frames
from spatula_env.pressure_limits import COST_PRESSURE
from spatula_env.tasks.base import Evaluation, weighted_sum
from spatula_env.tasks.situation import Situation, Start

if TYPE_CHECKING:
    from spatula_env.envs.control import Motion
    from spatula_env.envs.snapshots import Physics
    from spatula_env.envs.steering import Pilot
    from spatula_env.scenes import Scene
    from spatula_env.sim.worlds import Loads, Worlds
    from spatula_env.tasks.marks import Mark
    from spatula_env.tasks.situation import Setting

Info = dict[str, NDArray[Any]]
"""Further information on W worlds: arrays (W,), whose keys never change."""

Pictures = Callable[[IntArray], Mapping[str, NDArray[Any]]]
"""Draws the pictures of some worlds (n,): "image" (n, height, width, 3), and "depth" (n, height, width, 1) [m]."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a control step, besides observation and info.

    Attributes:
        reward: (W,) rewards; zero where physics has diverged.
        terminated: (W,) whether the episode ends by success, damage or a tangle.
        diverged: (W,) whether physics has diverged, so that the episode cannot go on.
    """

    reward: FloatArray
    terminated: BoolArray
    diverged: BoolArray


class Episodes:
    """Runs one episode in each of W worlds.

    It does not decide when an episode is truncated or when a new one begins: the environments do.

    Attributes:
        worlds: The physics.
        workspace: The cube within which the grip is kept, without any randomised shift.
        frames: Position and units of each world's workspace.
        setting: What all episodes have in common, without anything drawn at random.
        task: The task.
        control: The control, which defines the meaning of actions.
        observation_builder: The layout of observations.
        action_space: Action space of one world.
        incentives: Payments at the ends of episodes.
        horizon: Number of control steps after which environments truncate episodes; None for no limit.
        steps_per_action: Number of physics steps per control step.
        period: Length of a control step [s].
        goals: (W, G) goal of each world's episode.
        achieved: (W, G) what has been achieved towards it.
        elapsed: (W,) number of control steps since each episode began.
        situation: Latest situation of all worlds; None before any episode has begun. Its rows are overwritten in place
            where episodes begin.
    """

    def __init__(
        self, definition: Definition, settings: EnvSettings, load: Callable[[Scene], Worlds], pictures: Any = None
    ) -> None:
        """Compose the parts.

        Args:
            definition: Scene and task.
            settings: From `Definition.read`.
            load: Makes worlds of the scene, with everything at rest; they are closed by `close`, or if the rest of the
                construction fails.
            pictures: Makes the function that draws observed pictures of these episodes; see `Pictures`.

        Raises:
            ValueError: If an option is invalid, or a number is out of its range.
        """
        self.scene = scene = scene_of(definition, settings)
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
        self.frames = Frames(self.workspace, scene.scale, top, count)
        self.task = task_of(definition, settings, self.setting)
        self.control = VelocityControl(
            definition.controls[settings.control],
            self.setting,
            settings.max_speed,
            settings.max_rotation_rate,
            settings.max_jaw_speed,
            definition.stop_height if self.task.stop_height is None else self.task.stop_height,
        )
        self.observation_builder = ObservationBuilder(
            self.setting,
            self.task,
            self.control,
            settings.obs_mode,
            settings.observation,
            definition.observed,
            settings.control,
            goal_interface=self.has_goal_interface,
            hold_progress=not self.has_goal_interface or settings.terminate_on_success,
            dose_share=settings.damage_limit is not None,
        )
        self.action_space = spaces.Box(-1.0, 1.0, (self.control.size,), dtype=np.float32)
        self.incentives = Incentives(settings, self.task)
        self.horizon: int | None = None
        self._steps_to_hold = max(1, round(self.task.hold_time / self.period))
        self.goals: FloatArray = np.zeros((count, len(self.task.goal_names)))
        self.achieved: FloatArray = np.zeros_like(self.goals)
        self.elapsed: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self.situation: Situation | None = None
        self._variation = Variation(
            settings.randomization, settings.observation.noise, scene, self.setting, self.frames, self.worlds
        )
        self._memory = self.task.new_memory(count)
        self._held: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self._succeeded: BoolArray = np.zeros(count, dtype=np.bool_)
        self._safely: BoolArray = np.zeros(count, dtype=np.bool_)
        self._strains = StrainCount(self.worlds)
        self._safety = Safety(count, len(scene.tools), self.task.loading_limit)
        self._node_pressures = [np.zeros((count, len(tool.nodes))) for tool in self.setting.tools]
        longest = round(settings.randomization.get("action_delay", (0.0, 0.0))[1] / self.period)
        # Stored per physics step, as a pilot may change its action between two of them.
        self._asked: FloatArray = np.zeros((count, longest + 1, self.steps_per_action, self.control.size))
        self._frames = FrameMemory(round(settings.observation.delay / self.period), settings.observation.history)
        # Gymnasium's return type covers all spaces; for these it is an array, or a dictionary of arrays.
        self._observation = cast("Observation", create_empty_array(self.observation_builder.space, count))
        self._info: Info = {}

    @property
    def has_goal_interface(self) -> bool:
        """Whether goals are separate entries of the observation, which hindsight replay may exchange."""
        return self._sparse and self.task.hindsight

    @property
    def count(self) -> int:
        """Number of worlds, W."""
        return len(self.elapsed)

    @property
    def forces(self) -> FloatArray:
        """(W, N, 3) forces on the tools of each world, averaged over the last control step [N]."""
        shape = (self.count, len(self.setting.tools), 3)
        return np.zeros(shape) if self.situation is None else self.situation.contact_forces.copy()

    @property
    def grips(self) -> FloatArray:
        """(W, 3) present positions of the grips, workspace frames, of robots that stand still [m]."""
        positions = self.frames.points_from_scene(self.worlds.tool_positions, np.arange(self.count))
        return self._in_robot_frame(np.asarray(positions.mean(axis=1)))

    @property
    def reach(self) -> tuple[FloatArray, FloatArray]:
        """Two corners (W, 3) of the regions that the grips can reach now, workspace frames [m]."""
        positions, orientations = self._poses()
        low, high = self.control.reach(positions.mean(axis=1), positions, orientations, self._variation.tool_scale)
        return self._in_robot_frame(low), self._in_robot_frame(high)

    @property
    def pressures(self) -> tuple[FloatArray, ...]:
        """(W, n) for each tool: pressures on its contact nodes in the last physics step [Pa]."""
        return tuple(pressures.copy() for pressures in self._node_pressures)

    @property
    def observation(self) -> Observation:
        """The observations of all worlds, batched as by Gymnasium, in new arrays."""
        if isinstance(self._observation, dict):
            return {name: values.copy() for name, values in self._observation.items()}
        return self._observation.copy()

    @property
    def info(self) -> Info:
        """The info of all worlds, in new arrays."""
        return {name: values.copy() for name, values in self._info.items()}

    def info_of(self, worlds: IntArray) -> Info:
        """The info of some worlds (n,): arrays (n,)."""
        return {name: values[worlds] for name, values in self._info.items()}

    def observations_of(self, worlds: IntArray) -> list[Observation]:
        """The observations of some worlds (n,), one by one, in new arrays."""
        if isinstance(self._observation, dict):
            whole = self._observation
            return [{name: values[world].copy() for name, values in whole.items()} for world in worlds.tolist()]
        return [self._observation[world].copy() for world in worlds.tolist()]

    def to_scene(self, points: FloatArray, world: int) -> FloatArray:
        """Convert points (K, 3) in the workspace frame of a world [m] to the scene [u]."""
        scene_points: FloatArray = self.frames.points_to_scene(points[None], np.array([world]))[0]
        return scene_points

    def marks(self, world: int) -> tuple[Mark, ...]:
        """Marks that show the goal of a world in a picture, in its workspace frame [m]."""
        row = np.array([world])
        situation = None if self.situation is None else self.situation.rows(row)
        memory = {name: values[row] for name, values in self._memory.items()}
        return self.task.marks(self.goals[world], situation, memory)

    def patches(self, worlds: IntArray) -> dict[str, BoolArray]:
        """Nodes of the organ that are dyed in worlds (n,), as cameras see them: (n, V) by role; see `Task.patches`."""
        assert self.situation is not None
        if self.are_all(worlds):
            return self.task.patches(self.goals, self.situation, self._memory)
        memory = {name: values[worlds] for name, values in self._memory.items()}
        return self.task.patches(self.goals[worlds], self.situation.rows(worlds), memory)

    def choose(self, options: Mapping[str, Any], worlds: IntArray) -> dict[str, FloatArray]:
        """Validate the chosen beginnings of episodes in worlds (n,); see `chosen_starts`."""
        return chosen_starts(options, worlds, self.count, self.task, self.workspace)

    def check_begin(self, generators: Mapping[int, np.random.Generator], chosen: Mapping[str, FloatArray]) -> None:
        """Check that `begin` would put no tool into an organ or below the stop. Changes nothing.

        Only checked where a position was chosen: the positions that tasks draw are free.

        Args:
            generators: As for `begin`; copies of them are used for drawing.
            chosen: As for `begin`.

        Raises:
            ValueError: If it would; the message names the world.
        """
        if "tool_position" not in chosen:
            return
        copies = copy.deepcopy(dict(generators))
        settings, scale = self._variation.would_be(copies)
        start = self._sampled(copies, settings, chosen)
        positions, orientations = self.control.place(start.tool_position, start.tool_orientation, start.control, scale)
        worlds = np.fromiter(generators, dtype=np.int64)
        check_free(chosen["tool_position"], positions, orientations, scale, settings, self.control, worlds)

    def _sampled(
        self,
        generators: Mapping[int, np.random.Generator],
        settings: Sequence[Setting],
        chosen: Mapping[str, FloatArray] | None,
    ) -> Start:
        """Beginnings of episodes in some worlds, with the chosen values inserted."""
        # Always draw, so that choices do not affect later episodes; and draw one by one, so that a world's episodes
        # depend on its own generator only.
        start = Start.joined(
            [
                self.task.sample(generator, 1, setting)
                for generator, setting in zip(generators.values(), settings, strict=True)
            ]
        )
        return self.task.arrange(replace(start, **(chosen or {})), settings, chosen or ())

    def begin(
        self, generators: Mapping[int, np.random.Generator], chosen: Mapping[str, FloatArray] | None = None
    ) -> None:
        """Begin episodes in some worlds: with the organ at rest, a new goal, and the tools at a new place.

        Args:
            generators: The worlds, and the source of randomness of each.
            chosen: Values that replace the drawn ones, from `choose`.
        """
        worlds = np.fromiter(generators, dtype=np.int64)
        self._variation.draw(generators)
        settings = [self._variation.settings[world] for world in worlds.tolist()]
        start = self._sampled(generators, settings, chosen)
        self.worlds.reset(worlds)
        scale = self._variation.tool_scale[worlds]
        positions, orientations = self.control.place(start.tool_position, start.tool_orientation, start.control, scale)
        self.worlds.place_tools(
            self.frames.points_to_scene(positions, worlds),
            self.frames.orientations_to_scene(orientations, worlds),
            worlds,
        )
        self.goals[worlds] = start.goal
        self.elapsed[worlds], self._held[worlds] = 0, 0
        self._succeeded[worlds], self._safely[worlds] = False, False
        self._asked[worlds] = 0.0
        self._safety.begin(worlds)
        self._strains.begin(worlds, self.frames)
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
            nodes=self.frames.points_from_scene(self.worlds.nodes_of(worlds), worlds),
            rest_nodes=self._variation.rest_of(worlds),
        )
        self._show(situation, worlds, first=True)

    def step(
        self, actions: FloatArray, pilot: Pilot | None = None, after_step: Callable[[], object] | None = None
    ) -> Outcome:
        """Move all tools for one control step.

        Args:
            actions: (W, A) actions in [-1, 1].
            pilot: Called before every physics step to replace the action; for one world only.
            after_step: Called after every physics step.

        Returns:
            Result of the step. Where physics has diverged, observation and info stay those of the step before, except
            for info on the divergence itself.
        """
        worlds, frames = self.worlds, self.frames
        every = np.arange(self.count)
        positions, orientations = self._poses()
        scale = self._variation.tool_scale
        pressure_limits = COST_PRESSURE / frames.pressure
        force_limits = None if self.settings.max_force is None else self.settings.max_force / frames.force
        bed = self._bed_velocities()
        if pilot is None:
            motion = self.control.motion(
                self._delayed(actions), positions.mean(axis=1), positions, orientations, self.period, scale, bed
            )
            steer, linear = None, frames.velocities_to_scene(motion.linear)
            angular = frames.rates_to_scene(motion.angular)
        else:
            steering = Steering(self, pilot)
            steer, linear, angular = steering.velocities, np.zeros_like(positions), np.zeros_like(positions)
        loads = worlds.advance(linear, angular, self.steps_per_action, pressure_limits, force_limits, steer, after_step)
        held = loads.restrained > 0.0
        if pilot is not None:
            motion, actions = steering.motion(), mean_of_track(steering.track)[None]
            held = np.ones(self.count, dtype=np.bool_)
        if held.any():
            reached = frames.points_from_scene(worlds.tool_positions, every)
            restrained = loads.restrained
            motion = self.control.carried_out(motion, restrained, positions, reached, self.period, scale, held, bed)
        lost = loads.diverged
        going = np.flatnonzero(~lost)
        situation = self._situation(motion, actions, loads)
        self.elapsed += 1
        self._node_pressures = [pressures * frames.pressure[:, None] for pressures in loads.node_pressures]
        if lost.any():
            self._info["diverged"][lost] = True
        needed = self.task.pressure_limit(self.goals)
        self._safety.count(situation, motion, loads, frames, self.period, needed, going)
        self._strains.count(going, frames, self.period)
        reward = np.zeros(self.count)
        if len(going) == self.count:
            reward[:] = self._judge(situation, going)
        elif len(going):
            reward[going] = self._judge(situation.rows(going), going)
        self._info["tangled"][:] = loads.tangled
        self._info["residual"][:] = np.where(lost, 0.0, loads.residuals * frames.length)
        badly = loads.tangled & self.settings.terminate_on_tangle
        badly |= self._damaged(every)
        reward = np.where(lost, 0.0, self.incentives.pay(reward, badly, self.horizon))
        return Outcome(reward, badly | (self._succeeded & self.settings.terminate_on_success), lost)

    def _damaged(self, worlds: IntArray) -> BoolArray:
        """(n,) whether the organs of some worlds (n,) have met more in the episode than a limit allows."""
        limits = self.settings
        damaged = self._safety.damaged(worlds, limits.damage_limit, limits.pressure_limit)
        return damaged | self._strains.damaged(worlds, limits.strain_limit)

    def save(self, worlds: IntArray) -> tuple[Physics, EpisodesState]:
        """Copy everything that the next step depends on in some worlds (n,), in which episodes have begun."""
        assert self.situation is not None
        drawn, generators = self._variation.save(worlds)
        physics = save_physics(self.worlds, worlds)
        return physics, EpisodesState(
            counters={name: values[worlds] for name, values in self._counters().items()},
            memory={name: values[worlds] for name, values in self._memory.items()},
            safety={**self._safety.save(worlds), **self._strains.save(worlds)},
            node_pressures=tuple(pressures[worlds] for pressures in self._node_pressures),
            drawn=dict(drawn),
            generators=generators,
            situation=self.situation.rows(worlds),
            frames=self._frames.save(worlds),
            observation={name: values[worlds] for name, values in self._seen().items()},
            info={name: values[worlds] for name, values in self._info.items()},
        )

    def restore(self, physics: Physics, state: EpisodesState, worlds: IntArray) -> None:
        """Restore in some worlds (n,) what `save` returned for n worlds."""
        # Restore the tools before contact, because exchanging them clears the contact memory.
        self._variation.restore(state.drawn, state.generators, worlds)
        self.worlds.restore(joined(physics), worlds)
        every = self.are_all(worlds)
        for mine, saved in (
            (self._counters(), state.counters),
            (self._memory, state.memory),
            (self._seen(), state.observation),
        ):
            for name, values in saved.items():
                mine[name][worlds] = values
        for name, values in state.info.items():
            self._info.setdefault(name, np.zeros(self.count, dtype=values.dtype))[worlds] = values
        for pressures, values in zip(self._node_pressures, state.node_pressures, strict=True):
            pressures[worlds] = values
        self._safety.restore(state.safety, worlds)
        self._strains.restore(state.safety, worlds)
        self._frames.restore(state.frames, worlds, self.count)
        self._keep(state.situation.rows(np.arange(len(worlds))), worlds, every=every)

    def close(self) -> None:
        """Close the engine. Closing twice is allowed."""
        self.worlds.close()

    def are_all(self, worlds: IntArray) -> bool:
        """Whether some worlds (n,) are all there are, in their order."""
        return len(worlds) == self.count and bool((worlds[1:] > worlds[:-1]).all())

    def _counters(self) -> dict[str, NDArray[Any]]:
        """Counters and delayed actions, arrays (W, ...) by name."""
        return {
            "goals": self.goals,
            "elapsed": self.elapsed,
            "held": self._held,
            "succeeded": self._succeeded,
            "safely": self._safely,
            "asked": self._asked,
        }

    def _seen(self) -> dict[str, NDArray[Any]]:
        """The observation's entries; an observation that is one vector has the name ""."""
        return self._observation if isinstance(self._observation, dict) else {"": self._observation}

    def _delayed(self, actions: FloatArray) -> FloatArray:
        """Actions carried out now (W, A), given those requested now (W, A)."""
        if self._asked.shape[1] == 1:
            return actions
        self._asked[:, :-1] = self._asked[:, 1:]
        self._asked[:, -1] = actions[:, None]
        return mean_of_track(self._asked[np.arange(self.count), self._asked.shape[1] - 1 - self._lateness()])

    def delayed_within(self, action: FloatArray, step: int) -> FloatArray:
        """Action carried out in a physics step of a control step (A,), given the requested one (A,); for one world."""
        if self._asked.shape[1] == 1:
            return action
        if step == 0:
            self._asked[:, :-1] = self._asked[:, 1:]
        self._asked[0, -1, step] = action
        return np.asarray(self._asked[0, self._asked.shape[1] - 1 - self._lateness()[0], step].copy())

    def _lateness(self) -> IntArray:
        """(W,) delay of actions in control steps."""
        return np.asarray(np.rint(self._variation.drawn["action_delay"] / self.period).astype(np.int64))

    def motion_now(self, action: FloatArray) -> Motion:
        """Motion of the tools in the coming physics step for an action (A,); for one world."""
        positions, orientations = self._poses()
        return self.control.motion(
            action[None],
            positions.mean(axis=1),
            positions,
            orientations,
            self.period / self.steps_per_action,
            self._variation.tool_scale,
            self._bed_velocities(),
        )

    @property
    def _elapsed_times(self) -> FloatArray:
        """(W,) time since each episode began [s]."""
        return np.asarray(self.elapsed * self.period, dtype=np.float64)

    def _bed_velocities(self) -> FloatArray | None:
        """(W,) mean velocities with which the organs rise in the present control step [m/s]; None if none ever does."""
        sway = self._variation.sway
        return sway.velocities(self._elapsed_times, self.period) if sway.moving else None

    def _in_robot_frame(self, points: FloatArray) -> FloatArray:
        """Convert present positions (W, 3) relative to the beds to positions relative to the robots [m]."""
        if self._variation.sway.moving:
            points[:, 2] += self._variation.sway.heights(self.worlds.times_of(np.arange(self.count)))
        return points

    def _poses(self) -> tuple[FloatArray, FloatArray]:
        """Poses of the tools in workspace frames: positions (W, N, 3) [m] and orientations (W, N, 4)."""
        every = np.arange(self.count)
        return (
            self.frames.points_from_scene(self.worlds.tool_positions, every),
            self.frames.orientations_from_scene(self.worlds.tool_orientations, every),
        )

    def _situation(self, motion: Motion, actions: FloatArray, loads: Loads) -> Situation:
        frames, worlds, every = self.frames, self.worlds, np.arange(self.count)
        positions, orientations = self._poses()
        grip = positions.mean(axis=1)
        forces = frames.vectors_from_scene(loads.forces, frames.force)
        torques = frames.vectors_from_scene(loads.torques, frames.torque)
        # Use the lever arms at the end of the step: tools turn little about the grip within a step.
        torque = (torques + np.cross(positions - grip[:, None], forces)).sum(axis=1)
        return Situation(
            tool_position=grip,
            tool_velocity=motion.velocity,
            tool_orientation=orientations[:, 0],
            tool_rotation_rate=motion.rate,
            tool_positions=positions,
            tool_orientations=orientations,
            tool_scale=self._variation.tool_scale,
            control=self.control.opening(positions, self._variation.tool_scale),
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
            rest_nodes=self._variation.rest_nodes,
            action=actions,
            elapsed=np.asarray((self.elapsed + 1) * self.period, dtype=np.float64),
        )

    def _judge(self, situation: Situation, worlds: IntArray) -> FloatArray:
        """The reward (n,) of some worlds (n,); also counts how long each has fulfilled its goal."""
        evaluation = self._show(situation, worlds, first=False)
        if self._sparse:
            return self.task.compute_reward(evaluation.achieved, self.goals[worlds]).astype(np.float64)
        return weighted_sum(evaluation.terms, self.task.weights)

    def _show(self, situation: Situation, worlds: IntArray, *, first: bool) -> Evaluation:
        """Evaluate the situation of some worlds (n,), and update their observation and info."""
        goals = self.goals[worlds]
        every = self.are_all(worlds)
        memory = self._memory if every else {name: values[worlds] for name, values in self._memory.items()}
        evaluation = self.task.evaluate(situation, goals, memory)
        self.achieved[worlds] = evaluation.achieved
        if not every:
            for name, values in memory.items():
                self._memory[name][worlds] = values
        within = evaluation.within_tolerance
        if not first:
            self._held[worlds] = held = np.where(within, self._held[worlds] + 1, 0)
            reached = ~self._succeeded[worlds] & (held >= self._steps_to_hold)
            self._succeeded[worlds] |= reached
            self._safely[worlds] |= reached & self._safety.within(self.task.cost_budget, worlds)
        self._keep(situation, worlds, every=every)
        self._observe(situation, goals, evaluation, worlds, first=first)
        info: Info = {
            "is_success": self._succeeded[worlds],
            "is_safe_success": self._safely[worlds],
            "within_tolerance": within,
            "diverged": np.zeros(len(worlds), dtype=np.bool_),
            "tangled": np.zeros(len(worlds), dtype=np.bool_),
            "residual": np.zeros(len(worlds)),
            "hold_time": self._held[worlds] * self.period,
            "time": self.worlds.times_of(worlds),
            "force": situation.force,
            "peak_force": situation.peak_force,
            "peak_pressure": situation.peak_pressure,
            "mean_pressure": situation.mean_pressure,
            "is_damaged": self._damaged(worlds),
            **self._safety.info(worlds),
            **self._strains.info(worlds),
            **evaluation.measures,
            **{f"reward/{name}": values for name, values in evaluation.terms.items()},
            **{f"randomization/{name}": self._variation.drawn[name][worlds] for name in self.settings.randomization},
        }
        if every:
            self._info = info
        else:
            for name, values in info.items():
                self._info.setdefault(name, np.zeros(self.count, dtype=values.dtype))[worlds] = values
        return evaluation

    def _keep(self, situation: Situation, worlds: IntArray, *, every: bool) -> None:
        """Store the situation of some worlds (n,)."""
        if every:
            self.situation = situation
            return
        if self.situation is None:
            blank = np.zeros(self.count, dtype=np.int64)
            self.situation = situation.rows(blank)
        changes = {}
        for name, values in vars(situation).items():
            whole = getattr(self.situation, name)
            if len(whole) != self.count:
                continue
            if not whole.flags.writeable:
                whole = changes[name] = whole.copy()
            # In place, to avoid copying all worlds for the sake of a few.
            whole[worlds] = values
        if changes:
            self.situation = replace(self.situation, **changes)

    def _observe(
        self, situation: Situation, goals: FloatArray, evaluation: Evaluation, worlds: IntArray, *, first: bool
    ) -> None:
        """Update the observations of some worlds (n,)."""
        builder = self.observation_builder
        noise = self._variation.sensor_noise(worlds, sum(part.size for part in builder.parts))
        pictures = None if self._draw_pictures is None else self._draw_pictures(worlds)
        held = np.minimum(self._held[worlds] / self._steps_to_hold, 1.0)
        limit = self.settings.damage_limit
        dose = None if limit is None else self._safety.dose_share(limit, worlds)
        heights = self._variation.bed_heights(worlds, self._elapsed_times[worlds])
        frames = builder.build(situation, goals, evaluation, held, noise, pictures, dose, heights)
        if self._frames.delay or self.settings.observation.history > 1:
            self._frames.push(frames, worlds, self.count, first=first)
            frames = self._frames.show(worlds)
        if self.are_all(worlds):
            self._observation = frames[""] if "" in frames else frames
            return
        whole = self._seen()
        for name, values in frames.items():
            whole[name][worlds] = values


def _share_of_face(face: NDArray[np.int32]) -> FloatArray:
    """(n, F) contribution of each contact node to the share of each face's nodes that are in contact."""
    return np.asarray((face[:, None] == np.arange(face.max() + 1)) / np.bincount(face))


def _count_steps(control_frequency: float, dt: float) -> int:
    """Number of physics steps per control step."""
    steps = 1.0 / (control_frequency * dt)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        raise ValueError(
            f"control_frequency must go a whole number of times into that of physics, {1.0 / dt:.6g} Hz; "
            f"got {control_frequency!r}"
        )
    return round(steps)
