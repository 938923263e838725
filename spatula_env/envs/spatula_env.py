"""The environment: one simulation, a control, a task and an observation, behind Gymnasium's interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from spatula_env.envs.control import VelocityControl, Workspace, as_action
from spatula_env.envs.observations import Observation, ObservationBuilder, first_of
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.transforms import rotate
from spatula_env.sim.simulation import Simulation, SimulationDiverged
from spatula_env.tasks.base import Evaluation, FloatArray, Setting, Situation, Task, weighted_sum

if TYPE_CHECKING:
    from spatula_env.render.scene_view import SceneView
    from spatula_env.scenes import Scene
    from spatula_env.sim.report import Report

CONTROLS = ("velocity",)
"""What an action can mean."""

REWARDS = ("dense", "sparse")
"""How success can be rewarded."""

RESET_OPTIONS = ("goal", "tool_position")
"""What `reset(options=...)` understands."""


class SpatulaEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Any task, in any scene with one organ and one tool, for one agent.

    Environments with an id, such as `PressEnv`, are this class with a scene and a task chosen.

    Attributes:
        simulation: The physics.
        workspace: The cube that the tool's position is kept in.
        task: What is asked.
        observation_builder: How observations are laid out.
        steps_per_action: Physics steps in a control step.
        goal: (G,) what is asked in this episode [m].
    """

    # Not a ClassVar: Gymnasium lets an environment have metadata of its own.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        scene: Scene,
        make_task: Callable[[Setting], Task],
        *,
        workspace_height: float,
        engine: str = "bullet",
        contact: str = "flags",
        obs_mode: str = "state",
        control: str = "velocity",
        reward: str = "dense",
        max_speed: float = 0.1,
        control_frequency: float = 20.0,
        terminate_on_success: bool = False,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
    ) -> None:
        """Load the scene and put the parts together.

        Args:
            scene: With one organ and one tool.
            make_task: Makes the task for the setting it is told.
            workspace_height: Of the workspace's middle above the organ's top at rest [m].
            engine: What integrates the organ; see `Simulation`.
            contact: What resolves contact; see `Simulation`.
            obs_mode: "state" or "dict"; see `ObservationBuilder`.
            control: "velocity"; see `VelocityControl`.
            reward: "dense": the weighted sum of the task's terms. "sparse": 0 within tolerance, -1 elsewhere,
                with Gymnasium-Robotics' goal interface.
            max_speed: Of the tool along each axis [m/s].
            control_frequency: Control steps in a second [Hz].
            terminate_on_success: Whether success ends an episode.
            render_mode: None or "rgb_array".
            width: Of pictures [pixels].
            height: Of pictures [pixels].

        Raises:
            ValueError: If an option is not one of those allowed, or a number is out of its range.
        """
        _check_choice(control, "control", CONTROLS)
        _check_choice(reward, "reward", REWARDS)
        if render_mode is not None:
            _check_choice(render_mode, "render_mode", (None, *self.metadata["render_modes"]))
        if len(scene.organs) != 1 or len(scene.tools) != 1:
            raise ValueError(f"scene must have one organ and one tool, got {len(scene.organs)} and {len(scene.tools)}")
        self.steps_per_action = _count_steps(control_frequency, scene.dt)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(control_frequency)}
        self._period = self.steps_per_action * scene.dt
        self._sparse = reward == "sparse"
        self._terminate_on_success = bool(terminate_on_success)
        self._picture_size = (width, height)
        self._view: SceneView | None = None
        self._closed = False
        self._started = False

        self.simulation = Simulation(scene, engine=engine, contact=contact)  # type: ignore[arg-type]
        try:
            self.workspace = _place_workspace(scene, self.simulation.nodes, workspace_height)
            setting = _setting(scene, self.simulation, self.workspace)
            self.task = make_task(setting)
            self._control = VelocityControl(self.workspace, max_speed, self._period)
            faces = scene.tools[0].tool.face
            self._share_of_face = (faces[:, None] == np.unique(faces)) / np.bincount(faces)
            self.observation_builder = ObservationBuilder(
                setting,
                self.task,
                self._share_of_face.shape[1],
                self._control.max_speed,
                obs_mode,
                goal_interface=self._sparse,
            )
        except BaseException:
            self.simulation.close()
            raise
        self.observation_space = self.observation_builder.space
        self.action_space = spaces.Box(-1.0, 1.0, (self._control.size,), dtype=np.float32)
        self._steps_to_hold = max(1, round(self.task.hold_time / self._period))
        self.goal: FloatArray = np.zeros(len(self.task.goal_names))
        self._held = 0
        self._succeeded = False
        self._report: Report | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: the organ at rest, a new goal, the tool at a new place above the organ.

        Args:
            seed: Starts the random numbers anew; None goes on with them.
            options: "goal" (G,) and "tool_position" (3,) replace what is drawn [m].

        Returns:
            The first observation, and `info` with the same keys as after a step.

        Raises:
            ValueError: If an option is unknown, malformed or out of its range.
        """
        self._check_open()
        chosen = self._read_options(options)
        super().reset(seed=seed)
        start = self.task.sample(self.np_random, 1)
        # Drawn in any case, so that options do not change the episodes after this one.
        self.goal = chosen.get("goal", start.goal[0])
        position = chosen.get("tool_position", start.tool_position[0])
        self.simulation.reset()
        placed = self.simulation.scene.tools[0]
        self.simulation.place_tool(self.workspace.to_scene(position), placed.orientation)
        self._held = 0
        self._succeeded = False
        self._report = None
        self._started = True
        situation = self._situation(np.zeros((1, 3)), np.zeros((1, self._control.size)), np.zeros((1, 3)), 0.0)
        evaluation = self.task.evaluate(situation, self.goal[None])
        return self._observe(situation, evaluation), self._info(situation, evaluation)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the tool for one control step.

        Args:
            action: What `control` says; clipped to [-1, 1].

        Returns:
            Observation, reward, whether the episode ends by success, False, and `info`.

        Raises:
            ValueError: If `action` has the wrong shape or is not finite; nothing has then changed.
            SimulationDiverged: If the physics broke down; `reset` makes the environment usable again.
        """
        self._check_started("step")
        wanted = as_action(action, self._control.size)[None]
        simulation, scale = self.simulation, self.simulation.scene.scale
        velocity = self._control.velocity(wanted, self.workspace.from_scene(simulation.tool_position)[None])
        scene_velocity = velocity[0] / scale.speed
        impulse, peak_squared = np.zeros(3), 0.0
        try:
            for _ in range(self.steps_per_action):
                report = simulation.step(scene_velocity)
                force = report.force
                impulse += force
                peak_squared = max(peak_squared, float(force @ force))
        except SimulationDiverged:
            self._started = False
            raise
        self._report = report
        mean_force = impulse[None] * (scale.force / self.steps_per_action)
        situation = self._situation(velocity, wanted, mean_force, peak_squared**0.5 * scale.force)
        evaluation = self.task.evaluate(situation, self.goal[None])

        within = bool(evaluation.within_tolerance[0])
        self._held = self._held + 1 if within else 0
        self._succeeded |= self._held >= self._steps_to_hold
        if self._sparse:
            reward = float(self.task.compute_reward(evaluation.achieved[0], self.goal))
        else:
            reward = float(weighted_sum(evaluation.terms, self.task.weights)[0])
        terminated = self._terminate_on_success and self._succeeded
        return (
            self._observe(situation, evaluation),
            reward,
            terminated,
            False,
            self._info(situation, evaluation),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3) of the scene, or None if `render_mode` is None."""
        self._check_started("render")
        if self.render_mode is None:
            return None
        simulation = self.simulation
        if self._view is None:
            from spatula_env.render.scene_view import SceneView

            self._view = SceneView(simulation.scene, simulation.triangles, *self._picture_size)
        force = np.zeros(3) if self._report is None else self._report.force_newtons
        return self._view.draw(
            simulation.nodes,
            simulation.tool_position,
            simulation.tool_orientation,
            force=force,
            targets=self.workspace.to_scene(self.task.target_points(self.goal)),
        )

    def close(self) -> None:
        """Free the engine. Closing twice is allowed."""
        self._closed = True
        self._view = None
        self.simulation.close()

    @property
    def compute_reward(self) -> Callable[[NDArray[Any], NDArray[Any], Any], NDArray[np.float32]]:
        """The sparse reward of goals, for hindsight replay: of (achieved_goal, desired_goal, info).

        Goals are (..., G) and the result is (...); `info` is not looked at. There is no such attribute with
        `reward="dense"`, because libraries tell by it which environments have the goal interface.
        """
        if not self._sparse:
            raise AttributeError("compute_reward needs the goal interface: make the environment with reward='sparse'")
        task = self.task

        def compute(achieved: NDArray[Any], desired: NDArray[Any], info: Any) -> NDArray[np.float32]:
            return task.compute_reward(achieved, desired)

        return compute

    def _situation(self, velocity: FloatArray, action: FloatArray, force: FloatArray, peak_force: float) -> Situation:
        simulation, report = self.simulation, self._report
        flags = np.zeros(len(self._share_of_face)) if report is None else report.contacts.flags
        depth = 0.0 if report is None else report.penetration * self.workspace.length
        return Situation(
            tool_position=self.workspace.from_scene(simulation.tool_position)[None],
            tool_velocity=velocity,
            contact_force=force,
            peak_force=np.array([peak_force]),
            contact_share=(flags @ self._share_of_face)[None],
            contact_depth=np.array([depth]),
            nodes=self.workspace.from_scene(simulation.nodes)[None],
            action=action,
        )

    def _observe(self, situation: Situation, evaluation: Evaluation) -> Observation:
        return first_of(self.observation_builder.build(situation, self.goal[None], evaluation))

    def _info(self, situation: Situation, evaluation: Evaluation) -> dict[str, Any]:
        info: dict[str, Any] = {
            "is_success": self._succeeded,
            "within_tolerance": bool(evaluation.within_tolerance[0]),
            "hold_time": self._held * self._period,
            "time": self.simulation.time,
            "force": float(np.linalg.norm(situation.contact_force[0])),
            "peak_force": float(situation.peak_force[0]),
        }
        info.update((name, float(values[0])) for name, values in evaluation.measures.items())
        info.update((f"reward/{name}", float(values[0])) for name, values in evaluation.terms.items())
        return info

    def _read_options(self, options: Mapping[str, Any] | None) -> dict[str, FloatArray]:
        chosen: dict[str, FloatArray] = {}
        for name, value in (options or {}).items():
            _check_choice(name, "options", RESET_OPTIONS)
            size = len(self.goal) if name == "goal" else 3
            array = np.array(value, dtype=np.float64)
            if array.shape != (size,) or not np.isfinite(array).all():
                raise ValueError(f"options[{name!r}] must be {size} finite numbers, got {value!r}")
            chosen[name] = array
        if "goal" in chosen:
            self.task.check_goal(chosen["goal"])
        position = chosen.get("tool_position")
        low, high = self.workspace.low, self.workspace.high
        if position is not None and ((position < low) | (position > high)).any():
            raise ValueError(f"options['tool_position'] must lie in {low} to {high} m, got {position}")
        return chosen

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedEnvironmentError("this environment is closed; make a new one")

    def _check_started(self, method: str) -> None:
        self._check_open()
        if not self._started:
            raise ResetNeeded(f"call reset() before {method}()")


def _check_choice(value: Any, name: str, allowed: tuple[Any, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{name} must be one of {list(allowed)}, got {value!r}")


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


def _setting(scene: Scene, simulation: Simulation, workspace: Workspace) -> Setting:
    placed = scene.tools[0]
    corners = rotate(np.array(placed.orientation), placed.tool.vertices) * scene.scale.length
    nodes = simulation.nodes
    ground = float(nodes[:, 2].min()) if scene.ground is None else scene.ground.height
    return Setting(
        rest_nodes=workspace.from_scene(nodes),
        triangles=simulation.triangles,
        ground_height=float(workspace.from_scene((0.0, 0.0, ground))[2]),
        tool_low=corners.min(axis=0),
        tool_high=corners.max(axis=0),
        workspace_low=workspace.low,
        workspace_high=workspace.high,
    )
