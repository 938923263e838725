"""The environment: one simulation, a control, a task and an observation, behind Gymnasium's interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from spatula_env.envs.control import Workspace, as_action
from spatula_env.envs.episodes import RENDER_MODES, Episodes, check_render_mode
from spatula_env.envs.observations import Observation, ObservationBuilder, first_of
from spatula_env.envs.pictures import EpisodePictures
from spatula_env.sim.simulation import Simulation, SimulationDiverged
from spatula_env.sim.worlds import SeparateWorlds
from spatula_env.tasks.base import FloatArray, Setting, Task

if TYPE_CHECKING:
    from spatula_env.scenes import Scene


class SpatulaEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Any task, in any scene with one organ and one tool, for one agent.

    Environments with an id, such as `PressEnv`, are this class with a scene and a task chosen. `SpatulaVectorEnv` is
    the same for many worlds at once.

    Attributes:
        simulation: The physics.
    """

    # Not a ClassVar: Gymnasium lets an environment have metadata of its own.
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012

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
        check_render_mode(render_mode)
        self.simulation: Simulation

        def load() -> SeparateWorlds:
            self.simulation = Simulation(scene, engine=engine, contact=contact)  # type: ignore[arg-type]
            return SeparateWorlds([self.simulation])

        self._episodes = Episodes(
            scene,
            load,
            make_task,
            workspace_height=workspace_height,
            obs_mode=obs_mode,
            control=control,
            reward=reward,
            max_speed=max_speed,
            control_frequency=control_frequency,
            terminate_on_success=terminate_on_success,
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(control_frequency)}
        self.observation_space = self._episodes.observation_builder.space
        self.action_space = self._episodes.action_space
        self._pictures = EpisodePictures(self._episodes, width, height)
        self._closed = False
        self._started = False

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
        chosen = self._episodes.choose(options, np.zeros(1, dtype=np.int64))
        super().reset(seed=seed)
        self._episodes.begin({0: self.np_random}, chosen)
        self._started = True
        return first_of(self._episodes.observation), self._info()

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
        episodes = self._episodes
        outcome = episodes.step(as_action(action, episodes.control.size)[None])
        if outcome.diverged[0]:
            self._started = False
            raise SimulationDiverged(
                f"physics broke down within {episodes.period:.4g} s after {self._info()['time']:.4f} s; call reset()"
            )
        return (
            first_of(episodes.observation),
            float(outcome.reward[0]),
            bool(outcome.terminated[0]),
            False,
            self._info(),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3) of the scene, or None if `render_mode` is None."""
        self._check_started("render")
        return None if self.render_mode is None else self._pictures.draw()[0]

    def close(self) -> None:
        """Free the engine. Closing twice is allowed."""
        self._closed = True
        self._episodes.close()

    @property
    def workspace(self) -> Workspace:
        """The cube that the tool's position is kept in."""
        return self._episodes.workspace

    @property
    def task(self) -> Task:
        """What is asked."""
        return self._episodes.task

    @property
    def observation_builder(self) -> ObservationBuilder:
        """How observations are laid out."""
        return self._episodes.observation_builder

    @property
    def steps_per_action(self) -> int:
        """Physics steps in a control step."""
        return self._episodes.steps_per_action

    @property
    def goal(self) -> FloatArray:
        """(G,) what is asked in this episode (a copy) [m]."""
        goal: FloatArray = self._episodes.goals[0].copy()
        return goal

    @property
    def compute_reward(self) -> Callable[[NDArray[Any], NDArray[Any], Any], NDArray[np.float32]]:
        """The sparse reward of goals, for hindsight replay: of (achieved_goal, desired_goal, info).

        Goals are (..., G) and the result is (...); `info` is not looked at. There is no such attribute with
        `reward="dense"`, because libraries tell by it which environments have the goal interface.
        """
        return self._episodes.compute_reward

    def _info(self) -> dict[str, Any]:
        return {name: values[0].item() for name, values in self._episodes.info.items()}

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedEnvironmentError("this environment is closed; make a new one")

    def _check_started(self, method: str) -> None:
        self._check_open()
        if not self._started:
            raise ResetNeeded(f"call reset() before {method}()")
