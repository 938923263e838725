"""What one environment and many at once have in common: worlds, a control, a task and an observation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import create_empty_array
from numpy.typing import NDArray

from spatula_env.envs.control import VelocityControl, Workspace
from spatula_env.envs.observations import Observation, ObservationBuilder
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.transforms import rotate
from spatula_env.tasks.base import (
    BoolArray,
    Evaluation,
    FloatArray,
    Setting,
    Situation,
    Start,
    Task,
    weighted_sum,
)

if TYPE_CHECKING:
    from spatula_env.scenes import Scene
    from spatula_env.sim.worlds import IntArray, Loads, Worlds

CONTROLS = ("velocity",)
"""What an action can mean."""

REWARDS = ("dense", "sparse")
"""How success can be rewarded."""

START_OPTIONS = ("goal", "tool_position")
"""What of an episode's beginning can be chosen."""

RENDER_MODES = ("rgb_array",)
"""How environments can be looked at."""

Info = dict[str, NDArray[Any]]
"""What there is to tell of W worlds: (W,) each, under keys that never change."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a control step led to, beside observation and info.

    Attributes:
        reward: (W,) zero where physics has diverged.
        terminated: (W,) whether the episode ends by success.
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
        workspace: The cube that the tools' positions are kept in.
        task: What is asked.
        control: What an action means.
        observation_builder: How observations are laid out.
        action_space: Of one world.
        steps_per_action: Physics steps in a control step.
        period: Length of a control step [s].
        goals: (W, G) what is asked in each world's episode [m].
        elapsed: (W,) control steps since each episode began.
        forces: (W, 3) on each tool, averaged over the last control step [N].
    """

    def __init__(
        self,
        scene: Scene,
        load: Callable[[], Worlds],
        make_task: Callable[[Setting], Task],
        *,
        workspace_height: float,
        obs_mode: str,
        control: str,
        reward: str,
        max_speed: float,
        control_frequency: float,
        terminate_on_success: bool,
    ) -> None:
        """Put the parts together.

        Args:
            scene: With one organ and one tool.
            load: Makes worlds of the scene in which all is at rest; they are closed by `close`, and if the rest of
                the construction fails.
            make_task: Makes the task for the setting it is told.
            workspace_height: Of the workspace's middle above the organ's top at rest [m].
            obs_mode: "state" or "dict"; see `ObservationBuilder`.
            control: "velocity"; see `VelocityControl`.
            reward: "dense" or "sparse"; see `SpatulaEnv`.
            max_speed: Of the tool along each axis [m/s].
            control_frequency: Control steps in a second [Hz].
            terminate_on_success: Whether success ends an episode.

        Raises:
            ValueError: If an option is not one of those allowed, or a number is out of its range.
        """
        check_choice(control, "control", CONTROLS)
        check_choice(reward, "reward", REWARDS)
        if len(scene.organs) != 1 or len(scene.tools) != 1:
            raise ValueError(f"scene must have one organ and one tool, got {len(scene.organs)} and {len(scene.tools)}")
        self.steps_per_action = _count_steps(control_frequency, scene.dt)
        self.period = self.steps_per_action * scene.dt
        self._sparse = reward == "sparse"
        self._terminate_on_success = bool(terminate_on_success)
        self._orientation = np.array(scene.tools[0].orientation, dtype=np.float64)
        faces = scene.tools[0].tool.face
        self._share_of_face = (faces[:, None] == np.unique(faces)) / np.bincount(faces)

        self.worlds = load()
        try:
            self._rest_nodes = self.worlds.nodes[0]
            self.workspace = _place_workspace(scene, self._rest_nodes, workspace_height)
            setting = _setting(scene, self._rest_nodes, self.worlds.triangles, self.workspace)
            self.task = make_task(setting)
            self.control = VelocityControl(self.workspace, max_speed, self.period)
            self.observation_builder = ObservationBuilder(
                setting,
                self.task,
                self._share_of_face.shape[1],
                self.control.max_speed,
                obs_mode,
                goal_interface=self._sparse,
            )
        except BaseException:
            self.worlds.close()
            raise
        self.action_space = spaces.Box(-1.0, 1.0, (self.control.size,), dtype=np.float32)
        self._steps_to_hold = max(1, round(self.task.hold_time / self.period))
        count = self.worlds.count
        self.goals: FloatArray = np.zeros((count, len(self.task.goal_names)))
        self.elapsed: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self.forces: FloatArray = np.zeros((count, 3))
        self._held: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self._succeeded: BoolArray = np.zeros(count, dtype=np.bool_)
        self._still = np.zeros((count, 1, 3))
        self._observation: Observation = create_empty_array(self.observation_builder.space, count)  # type: ignore[assignment]
        self._info: Info = {}

    @property
    def count(self) -> int:
        """W."""
        return len(self.elapsed)

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
            array = np.array(value, dtype=np.float64)
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
        """Begin an episode in some worlds: the organ at rest, a new goal, the tool at a new place above the organ.

        Args:
            generators: The worlds, and where the randomness of each comes from.
            chosen: What is not left to chance, from `choose`.
        """
        worlds = np.fromiter(generators, dtype=np.int64)
        # Drawn in any case, so that choices do not change the episodes after this one; and one by one, so that a
        # world's episodes depend on its own generator only.
        starts = [self.task.sample(generator, 1) for generator in generators.values()]
        start = Start(
            goal=np.concatenate([one.goal for one in starts]),
            tool_position=np.concatenate([one.tool_position for one in starts]),
        )
        chosen = chosen or {}
        goals, positions = chosen.get("goal", start.goal), chosen.get("tool_position", start.tool_position)
        self.worlds.reset(worlds)
        orientations = np.broadcast_to(self._orientation, (len(worlds), 1, 4))
        self.worlds.place_tools(self.workspace.to_scene(positions)[:, None], orientations, worlds)
        self.goals[worlds] = goals
        self.elapsed[worlds], self._held[worlds], self._succeeded[worlds] = 0, 0, False
        self.forces[worlds] = 0.0
        still = np.zeros((len(worlds), 3))
        situation = Situation(
            tool_position=self.workspace.from_scene(self.worlds.tool_positions[worlds, 0]),
            tool_velocity=still,
            contact_force=still,
            peak_force=still[:, 0],
            contact_share=np.zeros((len(worlds), self._share_of_face.shape[1])),
            contact_depth=still[:, 0],
            nodes=self.workspace.from_scene(self.worlds.nodes[worlds]),
            action=np.zeros((len(worlds), self.control.size)),
        )
        self._show(situation, worlds)

    def step(self, actions: FloatArray) -> Outcome:
        """Move all tools for one control step.

        Args:
            actions: (W, A) in [-1, 1].

        Returns:
            What that led to. Where physics has diverged, observation and info stay those of the step before, but for
            what info tells of the divergence.
        """
        worlds, scale = self.worlds, self.worlds.scene.scale
        velocity = self.control.velocity(actions, self.workspace.from_scene(worlds.tool_positions[:, 0]))
        loads = worlds.advance((velocity / scale.speed)[:, None], self._still, self.steps_per_action)
        lost = loads.diverged
        going = np.flatnonzero(~lost)
        situation = self._situation(velocity, actions, loads)
        self.elapsed += 1
        self.forces = situation.contact_force
        if lost.any():
            self._info["diverged"][lost] = True
        reward = np.zeros(self.count)
        if len(going) == self.count:
            reward[:] = self._judge(situation, going)
        elif len(going):
            reward[going] = self._judge(_rows(situation, going), going)
        return Outcome(reward, self._succeeded & self._terminate_on_success, lost)

    def close(self) -> None:
        """Free the engine. Closing twice is allowed."""
        self.worlds.close()

    def _situation(self, velocity: FloatArray, actions: FloatArray, loads: Loads) -> Situation:
        force_scale = self.worlds.scene.scale.force
        return Situation(
            tool_position=self.workspace.from_scene(self.worlds.tool_positions[:, 0]),
            tool_velocity=velocity,
            contact_force=loads.forces[:, 0] * force_scale,
            peak_force=loads.peak_forces[:, 0] * force_scale,
            contact_share=loads.flags[0] @ self._share_of_face,
            contact_depth=loads.penetrations * self.workspace.length,
            nodes=self.workspace.from_scene(self.worlds.nodes),
            action=actions,
        )

    def _judge(self, situation: Situation, worlds: IntArray) -> FloatArray:
        """The reward (n,) of some worlds (n,), after counting how long each has fulfilled its goal."""
        evaluation = self._show(situation, worlds, counting=True)
        if self._sparse:
            return self.task.compute_reward(evaluation.achieved, self.goals[worlds]).astype(np.float64)
        return weighted_sum(evaluation.terms, self.task.weights)

    def _show(self, situation: Situation, worlds: IntArray, *, counting: bool = False) -> Evaluation:
        """Judge the situation of some worlds (n,), and renew their observation and info."""
        goals = self.goals[worlds]
        evaluation = self.task.evaluate(situation, goals)
        within = evaluation.within_tolerance
        if counting:
            self._held[worlds] = held = np.where(within, self._held[worlds] + 1, 0)
            self._succeeded[worlds] |= held >= self._steps_to_hold
        observation = self.observation_builder.build(situation, goals, evaluation)
        info: Info = {
            "is_success": self._succeeded[worlds],
            "within_tolerance": within,
            "diverged": np.zeros(len(worlds), dtype=np.bool_),
            "hold_time": self._held[worlds] * self.period,
            "time": self.worlds.times[worlds],
            "force": np.sqrt((situation.contact_force**2).sum(axis=1)),
            "peak_force": situation.peak_force,
            **evaluation.measures,
            **{f"reward/{name}": values for name, values in evaluation.terms.items()},
        }
        if len(worlds) == self.count and (worlds[1:] > worlds[:-1]).all():
            self._observation, self._info = observation, info
            return evaluation
        whole, parts = _by_name(self._observation), _by_name(observation)
        for name, values in parts.items():
            whole[name][worlds] = values
        for name, values in info.items():
            self._info.setdefault(name, np.zeros(self.count, dtype=values.dtype))[worlds] = values
        return evaluation


def check_choice(value: Any, name: str, allowed: tuple[Any, ...]) -> None:
    """Check that a value is one of those allowed.

    Raises:
        ValueError: If it is not.
    """
    if value not in allowed:
        raise ValueError(f"{name} must be one of {list(allowed)}, got {value!r}")


def check_render_mode(value: str | None) -> None:
    """Check that environments can be looked at like that, or not at all.

    Raises:
        ValueError: If they cannot.
    """
    if value is not None:
        check_choice(value, "render_mode", (None, *RENDER_MODES))


def _by_name(observation: Observation) -> dict[str, NDArray[np.float32]]:
    """An observation as a dictionary, be it one or not."""
    return observation if isinstance(observation, dict) else {"": observation}


def _rows(situation: Situation, worlds: IntArray) -> Situation:
    """The situation of some of the worlds."""
    return Situation(**{name: values[worlds] for name, values in vars(situation).items()})


def _count_steps(control_frequency: float, dt: float) -> int:
    """How many physics steps make a control step."""
    check_positive(control_frequency, "control_frequency")
    steps = 1.0 / (control_frequency * dt)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        raise ValueError(
            f"control_frequency must go a whole number of times into that of physics, {1.0 / dt:.6g} Hz; "
            f"got {control_frequency!r}"
        )
    return round(steps)


def _place_workspace(scene: Scene, rest_nodes: FloatArray, height: float) -> Workspace:
    """The workspace above the organ's axis, its middle at a height above the organ's top [m]."""
    x, y, _ = scene.organs[0].position
    top = float(rest_nodes[:, 2].max())
    return Workspace((x, y, top + height / scene.scale.length), scene.scale.length)


def _setting(scene: Scene, rest_nodes: FloatArray, triangles: NDArray[np.int32], workspace: Workspace) -> Setting:
    placed = scene.tools[0]
    corners = rotate(np.array(placed.orientation), placed.tool.vertices) * scene.scale.length
    ground = float(rest_nodes[:, 2].min()) if scene.ground is None else scene.ground.height
    return Setting(
        rest_nodes=workspace.from_scene(rest_nodes),
        triangles=triangles,
        ground_height=float(workspace.from_scene((0.0, 0.0, ground))[2]),
        tool_low=corners.min(axis=0),
        tool_high=corners.max(axis=0),
        workspace_low=workspace.low,
        workspace_high=workspace.high,
    )
