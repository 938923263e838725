"""`SpatulaEnv`, the environment for one agent behind Gymnasium's interface."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils import seeding
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.envs.base import EpisodesEnv
from spatula_env.envs.control import as_action
from spatula_env.envs.episodes import Episodes
from spatula_env.envs.incentives import check_horizon
from spatula_env.envs.observations import Observation, first_of
from spatula_env.envs.observed_pictures import observed_pictures
from spatula_env.envs.physics_listener import PhysicsListener, PhysicsStep
from spatula_env.envs.pictures import EpisodePictures, as_frame_rate
from spatula_env.envs.settings import RENDER_MODES
from spatula_env.envs.snapshots import EnvState, check_fits
from spatula_env.envs.start_options import START_OPTIONS, own_options
from spatula_env.envs.time_limit import read_step_limit, steps_in, told_in_steps
from spatula_env.geometry.checks import as_seed
from spatula_env.sim.simulation import Simulation, SimulationDiverged

if TYPE_CHECKING:
    from spatula_env.envs.steering import Pilot
    from spatula_env.render.moment import Moment
    from spatula_env.scenes import Scene
    from spatula_env.sim.report import Report
    from spatula_env.sim.worlds import Worlds


class SpatulaEnv(EpisodesEnv, gymnasium.Env[Observation, NDArray[np.float32]]):
    r"""Any task, in any scene with one organ, for one agent.

    Environments with an id, such as `PressEnv`, are this class with a `Definition`: a scene and a task. They share all
    that follows. `SpatulaVectorEnv` is the same for many worlds at once, which `gymnasium.make_vec(id, num_envs=64)`
    makes. Physics runs at 240 Hz and control at 20 Hz: a step lasts 50 ms, and the 200 steps of an episode 10 s.

    ## Action Space
    `control="velocity"` is what the task needs, and `control="velocity_6d"` moves along and turns about all three axes
    (and opens and closes jaws, where there are any). An action is a vector of fractions of the greatest velocities,
    which are kept for a whole step. What would lead out of the workspace, or turn or open the tools too far, is cut to
    what just reaches the limit. No point of a tool gets below a stop above the ground, which each task has where tissue
    is held. Numbers beyond -1 and 1 are clipped; an action of the wrong shape or that is not finite is a `ValueError`.

    The workspace is that of a Novint Falcon, one to one: a cube of 101.6 mm over the organ's axis. All positions are
    relative to its middle: x to the operator's right, y away from the operator and z up. A Falcon's axes are x to the
    right, y up and z towards the operator; the tasks' tables tell which of them moves what.

    ## Observation Space
    Everything is in SI units, positions in the frame of the workspace. Every number is clipped to the bounds of its
    space, which are finite; those of velocities follow `max_speed`, `max_rotation_rate` and `max_jaw_speed`, and those
    of what is felt and of the organ are what is met in the task, with a margin. SI units make small numbers: normalise
    them for learning, for instance with `gymnasium.wrappers.RescaleObservation`.
    Random motion hardly leaves the bounds of forces, torques and contact depths. It does leave those of pressures,
    which are several times what tissue bears, and of places on an organ that it pushes away:
    [how often](../tasks.md#bounds-of-observations). `info["peak_pressure"]` and `info["peak_force"]` are not clipped.

    | `obs_mode`   | Observation                                                                                     |
    | ------------ | ----------------------------------------------------------------------------------------------- |
    | `state`      | a vector of the parts that the task's table lists                                               |
    | `dict`       | a dictionary of these parts                                                                     |
    | `rgb`        | `image` (84, 84, 3) uint8, and `state`, the parts known without looking at the organ            |
    | `rgbd`       | `depth` (84, 84, 1) as well, the distance from the camera's plane [m], at most 1 m              |
    | `pointcloud` | `organ` (256, 3) and `tool` (64, 3), always the same points of the surfaces [m], and `state`    |

    The 16 nodes of the organ whose displacement is observed are spread over its upper half by farthest-point sampling,
    and always the same. Where there are pictures or points, `state` holds, in this order, the pose and the velocity of
    the tools, force and torque on them, and the goal.

    With `reward="sparse"` observations are dictionaries with Gymnasium-Robotics' goal interface: "achieved_goal" and
    "desired_goal", beside "observation" (in the mode `state`) or the others, and no part depends on the goal, unless
    success ends episodes: then `hold_progress` is a part, for how long the goal has been held, and hindsight replay is
    not to be used. With a `damage_limit` the last part is `dose_share`, the episode's dose relative to the limit.
    Press, Retract and Clamp have the goal interface. In Fissure and Palpate what is achieved depends on what is asked,
    so that no step can be replayed as if something else had been asked: there is no `compute_reward`, and observations
    are as with the dense reward.

    `observation={"parts": ...}` chooses among the parts, for one environment and for many:

    | `parts`     | Observation                                                                                     |
    | ----------- | ----------------------------------------------------------------------------------------------- |
    | `"all"`     | all parts; the default                                                                          |
    | `"sensors"` | what a robot knows: pose, velocity, force and torque of the tools, and the goal, which is told  |
    | `"grouped"` | all in two entries, `sensors` and `privileged`, as for a critic that knows more than the actor  |

    What is privileged is read off the simulated organ: where it touches, how deep and with what pressure, the
    landmarks, what the task measures on it, how far the goal is from being achieved and for how long it has been held.
    The choice is of the vector in the mode `state`, of the entries in the mode `dict`, which has no groups, and of
    `state` beside pictures; a point cloud follows points of the organ, which no sensor does, and has no choice. With
    the goal interface "achieved_goal" stays an entry, for hindsight replay, and is privileged.

    `observation` also changes how it is seen: `noise`, a factor on the standard deviations of measurements (0.1 mm,
    1 mm/s, 2 mrad, 20 mN, 50 Pa; see `observations.NOISE`); `delay` [s], rounded to control steps; `history`, how many
    observations are shown at once, the oldest first, on a first axis; `image_size` (height, width); `picture_style`;
    `organ_points` and `tool_points`. Goals are exact and never late.

    Pictures are those of a camera in the room: the organ, with the part of it that a task has dyed, the tools and the
    ground, but neither goals nor pressures. With `picture_style="plain"`, the default, each pixel shows what is in its
    middle, lit by vertex, without shadows, highlights and textures: learners need many pictures, and
    [it is fast](../performance.md#observed-pictures). `"full"` is the style of `render`. Depth is that of the middle of
    a pixel, and in the full style, at the outline of an object, that of the nearest object in the pixel.

    Names that LeRobot's datasets have for these entries; `observations.lerobot_keys(space)` gives them:

    | Entry                          | LeRobot                          |
    | ------------------------------ | -------------------------------- |
    | the vector, or `observation`   | `observation.state`              |
    | `state`                        | `observation.state`              |
    | `image`                        | `observation.images.front`       |
    | `depth`                        | `observation.images.front_depth` |
    | `organ`, `tool`                | `observation.points.<name>`      |
    | `desired_goal`                 | `observation.goal`               |
    | any other                      | `observation.<name>`             |
    | the action                     | `action`                         |

    ## Rewards
    `reward="dense"`: the weighted sum of the task's terms, which `info` holds before weighting. `reward="sparse"`: 0
    within tolerance, -1 elsewhere; `compute_reward(achieved_goal, desired_goal, info)` gives it for any goals, one or
    many, as hindsight replay needs.

    What ends an episode takes away what the rest of it would have paid. So that no end is worth more than going on,
    ends pay as follows, with B the sum of the positive weights (the best that a step can pay) and H the control steps
    of a whole episode, or 200 if that is more. A learner that looks beyond the time limit, as those of
    Stable-Baselines3 do, finds damage dearer than going on without success if its discount is at most 1 - 1/H:

    | Option                                | `reward="dense"`                                  | `reward="sparse"` |
    | ------------------------------------- | ------------------------------------------------- | ----------------- |
    | `terminate_on_success`                | every step pays B less, so that it pays 0 at best | as without        |
    | a limit, `terminate_on_tangle`        | the step that ends an episode so pays -B H        | that step pays -H |

    Limits are `damage_limit`, `pressure_limit` and `strain_limit`. They and `terminate_on_tangle` are refused without a
    time limit.

    ## Safety
    What an organ suffers is a channel of its own and never a part of the reward. The *cost* of a step is the
    time by which limits were exceeded, weighted by how far: its length times the sum of two parts, what the force on a
    tool has grown faster than the task's `loading_limit`, as a part of that, and what the greatest contact pressure
    exceeds by what the goal needs, as a part of that. The same thing done more slowly costs less, and done with care
    next to nothing: success is *safe* if the cost until then is within the task's `cost_budget`. The force is the mean
    of a control step and the pressure the greatest of its physics steps, so costs and budgets are those of 20 control
    steps a second: with another `control_frequency` the same motion has another cost. The *dose* of a step
    is the integral over time of what the greatest contact pressure exceeds 2.67 kPa (20 mmHg) by, and a *violation* is
    a pressure above 4.0 kPa (30 mmHg) in any physics step. Both figures come from retraction of rat brains for 15
    minutes (J. Rosenorn and N. Diemer, J Neurosurg 63:608, 1985): they are no limits for a moment. A dose grows with
    the time that a goal is held. `damage_limit` ends an episode whose dose exceeds it, `pressure_limit` one in which a
    physics step has a greater pressure, and `strain_limit`, with `"tissue"`, one in which a control step ends with a
    greater principal strain. A tool that has met more than
    `max_force` in a physics step does not move on against that force in the next one, and does not turn: the protective
    stop that robots have. Velocities in observations are those that were reached.

    ## Episode End
    Success is to have been within tolerance for `hold_time` without a break; `info["is_success"]` stays true until the
    next reset.

    ### Termination
    By success if `terminate_on_success` is set, by damage if one of the limits is, and by a tangle of organs if
    `terminate_on_tangle` is; else never.

    ### Truncation
    After `episode_time`. `gymnasium.make` passes 10 s, which are 200 steps at 20 Hz and 600 at 60 Hz. Who tells
    `gymnasium.make` a number of steps, with `max_episode_steps`, gets that many; with -1 episodes are never cut.

    ## Domain Randomisation
    `randomization` is "none", "default" or a mapping of some of these names to their ranges, from which each episode
    draws uniformly; `info` tells what was drawn.

    | Name           | Default range   | What                                                       |
    | -------------- | --------------- | ---------------------------------------------------------- |
    | `stiffness`    | 0.7 to 1.4      | factor on the organ's stiffness and density                |
    | `friction`     | 0.5 to 1.5      | factor on the friction between tools and organ             |
    | `organ_size`   | 0.95 to 1.05    | factor on the organ's lengths, of the same material        |
    | `organ_x`      | -0.004 to 0.004 | shift of the organ [m]                                     |
    | `organ_y`      | -0.004 to 0.004 | shift of the organ [m]                                     |
    | `organ_yaw`    | not varied      | turn of the organ about the vertical [rad]                 |
    | `tool_size`    | 0.95 to 1.05    | factor on the tools' lengths                               |
    | `sensor_noise` | 0 to 1          | replaces `observation["noise"]`                            |
    | `action_delay` | 0 to 0.05       | how late actions are, rounded to control steps [s]         |
    | `breathing`    | not varied      | amplitude with which the organ rises and sinks, 15/min [m] |
    | `breathing_phase` | not varied   | its phase when the episode begins [rad]                    |
    | `pulse`        | not varied      | as `breathing`, 72/min [m]                                 |
    | `pulse_phase`  | not varied      | its phase when the episode begins [rad]                    |

    A phase is drawn from a whole turn if only the amplitude is given. The bed moves, with the organ, the ground and the
    camera on it, and goals and the chosen place of a tool are relative to it. Actions, and the observed places of tools
    and organ, are those of a robot that stands still.

    ## Levels
    `level` is "easy", "standard" or "hard", and chooses the defaults of other options; whatever is given besides comes
    first, and `task` and `observation` are completed field by field. "standard" draws `randomization="default"`; "hard"
    draws more, breathing among it, shows what sensors know (`parts="sensors"`), and ends an episode by harm.
    `split="test"` draws organs that are softer and larger than any of `split="train"`.
    [What each level of each task has](../levels.md).

    ## Info
    The same keys after `reset` and `step`:

    | Key                      | Meaning                                                                             |
    | ------------------------ | ----------------------------------------------------------------------------------- |
    | `is_success`             | whether the goal has been held in this episode                                      |
    | `is_safe_success`        | whether it has with a cost, until then, within the task's budget                    |
    | `within_tolerance`       | whether it is fulfilled now                                                         |
    | `diverged`               | whether physics has broken down, which only a vector environment lives to tell      |
    | `tangled`                | whether organs have crossed themselves or each other for longer than 0.1 s          |
    | `residual`               | how deep tools and organs were left in each other in a physics step, at most [m]    |
    | `is_damaged`             | whether the episode has exceeded `damage_limit` or another limit                    |
    | `hold_time`              | for how long the goal has been kept [s]                                             |
    | `time`                   | since the reset [s]                                                                 |
    | `force`                  | magnitude of the contact force, averaged over the step [N]                          |
    | `peak_force`             | greatest force on a tool in a physics step of it [N]                                |
    | `peak_pressure`          | greatest contact pressure in a physics step of it [Pa]                              |
    | `mean_pressure`          | the greatest normal force on a face of a tool by its area, averaged over it [Pa]    |
    | `cost`                   | of the step [s]                                                                     |
    | `dose`                   | of the step [Pa s]                                                                  |
    | `violation`              | whether there was one in the step                                                   |
    | `work`                   | done by the tools on the organ in the step [J]                                      |
    | `episode_cost`           | sum over the episode [s]                                                            |
    | `episode_dose`           | sum over the episode [Pa s]                                                         |
    | `episode_work`           | sum over the episode [J]                                                            |
    | `episode_violation_time` | length of the steps with a violation [s]                                            |
    | `episode_peak_force`     | greatest in the episode [N]                                                         |
    | `episode_peak_pressure`  | greatest in the episode [Pa]                                                        |
    | `reward/<name>`          | each reward term before weighting                                                   |
    | `randomization/<name>`   | what was drawn, of all that is drawn                                                |

    with the engine `"tissue"` also

    | Key                   | At the end of the step                                                                 |
    | --------------------- | -------------------------------------------------------------------------------------- |
    | `peak_strain`         | greatest principal strain in the organ (Green and Lagrange's)                          |
    | `high_strain`         | what 95 % of its volume do not exceed                                                  |
    | `peak_stress`         | greatest principal (Cauchy) stress, tension positive [Pa]                              |
    | `high_stress`         | what 95 % of its volume do not exceed [Pa]                                             |
    | `strained_share`      | share of its volume with a strain beyond 0.21                                          |
    | `strain_dose`         | that times the length of the step [s]                                                  |
    | `episode_peak_strain` | greatest in the episode                                                                |
    | `episode_strain_dose` | sum over the episode [s]                                                               |

    and what the task measures. Numbers are `numpy.float64`, which is a Python `float` too; truth values are `bool`.

    ## Arguments

    | Parameter              | Type               | Default      | Description                                         |
    | ---------------------- | ------------------ | ------------ | --------------------------------------------------- |
    | `engine`               | **str \| None**    | `None`       | `"bullet"`, `"batch"`, `"tissue"` or `"mujoco"`     |
    | `material`             | **Material**       | `None`       | Of the organ, with `"tissue"` and `"mujoco"`        |
    | `organ`                | **str \| None**    | `None`       | A file of an organ to take instead of the task's    |
    | `contact`              | **str**            | `"flags"`    | `"flags"`, `"second_step"`, `"bullet"`, `"mujoco"`  |
    | `obs_mode`             | **str**            | `"state"`    | See above                                           |
    | `control`              | **str**            | `"velocity"` | `"velocity"` or `"velocity_6d"`                     |
    | `reward`               | **str**            | `"dense"`    | `"dense"` or `"sparse"`                             |
    | `task`                 | **dict**           | `None`       | Fields of the task's configuration to change        |
    | `max_speed`            | **float**          | `0.1`        | Greatest speed along each axis [m/s]                |
    | `max_rotation_rate`    | **float**          | `1.0`        | Greatest rate of rotation about each axis [rad/s]   |
    | `max_jaw_speed`        | **float**          | `0.05`       | Greatest speed at which jaws open and close [m/s]   |
    | `max_force`            | **float \| None**  | `2.0`        | With a greater one no tool pushes on [N]            |
    | `control_frequency`    | **float**          | `20.0`       | Control steps in a second, 0.5 on, divides 240 Hz   |
    | `episode_time`         | **float \| None**  | `None`       | After which the episode is cut; `make` passes 10 [s]|
    | `terminate_on_success` | **bool**           | `False`      | Whether success ends the episode                    |
    | `terminate_on_tangle`  | **bool**           | `False`      | Whether `tangled` ends the episode                  |
    | `damage_limit`         | **float \| None**  | `None`       | Dose that ends the episode [Pa s]                   |
    | `pressure_limit`       | **float \| None**  | `None`       | Contact pressure that does [Pa]                     |
    | `strain_limit`         | **float \| None**  | `None`       | Greatest principal strain that does, with `"tissue"`|
    | `level`                | **str**            | `"easy"`     | `"easy"`, `"standard"` or `"hard"`; see above       |
    | `split`                | **str**            | `"train"`    | `"train"`, or `"test"` for organs held out          |
    | `randomization`        | **str or dict**    | `"none"`     | See above                                           |
    | `observation`          | **dict**           | `None`       | Fields of `ObservationSettings` to change           |
    | `render_mode`          | **str \| None**    | `None`       | `None`, `"rgb_array"` or `"human"`                  |
    | `width`                | **int**            | `480`        | Of pictures, 1 to 8192 [pixels]                     |
    | `height`               | **int**            | `480`        | Of pictures, 1 to 8192 [pixels]                     |

    With `engine=None` it is `"bullet"` where PyBullet is installed, else `"batch"`, and a warning says so once;
    `env.spec` has the one that is used. `material` is a `scenes.Material`, a mapping of its fields, or the name of a
    region of the brain, as `"cortex"`; None is the engine's default, and all that the engines of springs take. `organ`
    is a file of `spatula organ prepare`; each task tells what is then different, and what it needs of the organ.

    Attributes:
        definition: Scene and task; subclasses have one.
        simulation: The physics.
        settings: All options.
    """

    _gymnasium_class = gymnasium.Env

    # Not a ClassVar: Gymnasium lets an environment have metadata of its own.
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Let Python tell what arguments there are."""
        super().__init_subclass__(**kwargs)
        if "definition" in vars(cls):
            cls.__signature__ = cls.definition.signature()

    def __init__(self, **options: Any) -> None:
        """Load the scene and put the parts together.

        Args:
            **options: See `EnvSettings`.

        Raises:
            TypeError: If there is no such option.
            ValueError: If an option is not one of those allowed, or a number is out of its range.
            ImportError: If PyBullet is asked for and is not installed; says what to install.
        """
        before = set(vars(self))
        settings = self.definition.read(options, type(self).__name__)
        told = told_in_steps(self)
        if told is not None:
            settings = replace(settings, episode_time=None)
        cut_outside = read_step_limit(told)
        check_horizon(settings, limited=settings.episode_time is not None or cut_outside is not None)
        self.simulation: Simulation

        def load(scene: Scene) -> Worlds:
            self.simulation = Simulation(scene, engine=settings.engine, contact=settings.contact)
            return self.simulation.worlds

        self._episodes = Episodes(self.definition, settings, load, observed_pictures)
        self.settings = settings
        self.render_mode = settings.render_mode
        self.metadata = {**self.metadata, "render_fps": as_frame_rate(settings.control_frequency)}
        self.observation_space = self._episodes.observation_builder.space
        self.action_space = self._episodes.action_space
        self._pictures = EpisodePictures(
            self._episodes, settings.width, settings.height, frames_per_second=settings.control_frequency
        )
        self._step_limit = steps_in(settings.episode_time, self._episodes.period)
        self._set_horizon(self._step_limit if cut_outside is None else cut_outside)
        self._closed = False
        self._started = False
        self._pilot: Pilot | None = None
        self.constructed_names = frozenset({*dir(SpatulaEnv), *vars(self)} - before)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: the organ at rest, a new goal, the tool at a new place above the organ.

        Args:
            seed: Starts the random numbers anew; None goes on with them.
            options: "goal" (G,) and "tool_position" (3,) [m] replace what is drawn.

        Returns:
            The first observation, and `info` with the same keys as after a step.

        Raises:
            ValueError: If the seed is no integer or negative, an option is misspelt, malformed or out of its range, or
                a tool would begin in the organ or below the stop above the ground; nothing has then changed. Options
                that are not of this package are ignored, with a warning.
        """
        self._check_open()
        chosen = self._episodes.choose(own_options(options, START_OPTIONS), np.zeros(1, dtype=np.int64))
        whole = as_seed(seed)
        if chosen:
            generator = self.np_random if whole is None else seeding.np_random(whole)[0]
            self._episodes.check_begin({0: generator}, chosen)
        super().reset(seed=whole)
        self._episodes.begin({0: self.np_random}, chosen)
        self._started = True
        self._show()
        return first_of(self._episodes.observation), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the tools for one control step.

        Args:
            action: What `control` says; clipped to [-1, 1].

        Returns:
            Observation, reward, whether the episode ends by success or by damage, whether its time is over, and `info`.

        Raises:
            ValueError: If `action` has the wrong shape or is not finite; nothing has then changed.
            SimulationDiverged: If the physics broke down; `reset` makes the environment usable again.
        """
        self._check_started("step")
        episodes = self._episodes
        tell = self.simulation.tell if self.simulation.listeners else None
        outcome = episodes.step(as_action(action, episodes.control.size)[None], self._pilot, tell)
        if outcome.diverged[0]:
            self._started = False
            raise SimulationDiverged(
                f"physics broke down within {episodes.period:.4g} s after {self._info()['time']:.4f} s; call reset()"
            )
        self._show()
        return (
            first_of(episodes.observation),
            float(outcome.reward[0]),
            bool(outcome.terminated[0]),
            self._step_limit is not None and bool(episodes.elapsed[0] >= self._step_limit),
            self._info(),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3) of the scene if `render_mode` is "rgb_array".

        With "human" the window shows every step by itself, and with None there is nothing to see.
        """
        self._check_started("render")
        return self._pictures.draw()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free the engine. Closing twice is allowed."""
        self._closed = True
        self._pictures.close()
        self._episodes.close()

    def save(self) -> EnvState:
        """Everything that the next step depends on: physics, task, sums, delays, noise, time and random numbers.

        A `gymnasium.wrappers.TimeLimit` around the environment, which `max_episode_steps` brings, counts on its own:
        the time limit of `episode_time` is part of the state.

        Returns:
            The state, which can be restored as often as one likes, and pickled.

        Raises:
            ResetNeeded: If no episode has begun.
        """
        self._check_started("save")
        physics, episodes = self._episodes.save(np.zeros(1, dtype=np.int64))
        return EnvState(
            name=self.definition.name,
            settings=self.settings,
            physics=physics,
            episodes=episodes,
            generators=(copy.deepcopy(self._np_random),),
            seeds=(self._np_random_seed,),
            over=np.zeros(1, dtype=np.bool_),
        )

    def restore(self, state: EnvState) -> tuple[Observation, dict[str, Any]]:
        """Go back to a saved state, of this environment or another one like it. No `reset` is needed before.

        From there on, the same actions lead to the same numbers, to the last bit. Wrappers know nothing of it: those
        that `gymnasium.make` puts around an environment still want one `reset` before the first step.

        Args:
            state: What `save` returned, or one world of it where a vector environment saved it.

        Returns:
            The observation and the info that belong to it.

        Raises:
            TypeError: If it is no state of an environment.
            ValueError: If it is that of another environment, or of several worlds; nothing has then changed.
        """
        self._check_open()
        check_fits(state, self.definition.name, self.settings, self._episodes.setting)
        if state.count != 1:
            raise ValueError(f"state must be of one world, it is of {state.count}: see EnvState.rows")
        self._episodes.restore(state.physics, state.episodes, np.zeros(1, dtype=np.int64))
        self._np_random, self._np_random_seed = copy.deepcopy(state.generators[0]), state.seeds[0]
        self._started = True
        self._show()
        return first_of(self._episodes.observation), self._info()

    def _whole_state(self) -> dict[str, Any]:
        random = (copy.deepcopy(self._np_random), self._np_random_seed)
        started = self._started and not self._closed
        return {"state": self.save() if started else None, "random": random, "closed": self._closed}

    def _set_whole_state(self, state: dict[str, Any]) -> None:
        if state["state"] is not None:
            self._episodes.restore(state["state"].physics, state["state"].episodes, np.zeros(1, dtype=np.int64))
            self._started = True
        self._np_random, self._np_random_seed = state["random"]
        if state["closed"]:
            self.close()

    @property
    def grip(self) -> FloatArray:
        """(3,) where the middle of the tools is now, workspace frame [m]."""
        return np.asarray(self._episodes.grips[0])

    @property
    def reach(self) -> tuple[FloatArray, FloatArray]:
        """Two corners (3,) of the box in which the grip can be, with tools turned and opened as they are now [m]."""
        low, high = self._episodes.reach
        return low[0], high[0]

    @property
    def moment(self) -> Moment:
        """What there is to see now, for a view of one's own."""
        (moment,) = self._pictures.moments([0])
        return moment

    def listen(self, listener: PhysicsListener) -> Callable[[], None]:
        """Have something called after every physics step, for what a control step is too long for: a haptic device.

        Args:
            listener: Takes a `PhysicsStep`. An exception of it ends the control step in the middle and is passed on.

        Returns:
            What ends the calls. Calling it twice is allowed.
        """
        listeners = self.simulation.listeners

        def hear(report: Report) -> None:
            frames = self._episodes.frames
            force = report.loads[:, :3].sum(axis=0)
            felt = frames.vectors_from_scene(force[None, None], frames.force)[0, 0]
            listener(PhysicsStep(self.simulation.time, self.grip, felt))

        def stop() -> None:
            if hear in listeners:
                listeners.remove(hear)

        listeners.append(hear)
        return stop

    def steer(self, pilot: Pilot) -> Callable[[], None]:
        """Have someone asked before every physics step how the tools are to move, instead of what `step` is given.

        Observation, reward and `info` are those of the control step, whose action is the mean of what was asked for.

        Args:
            pilot: Takes where the grip is (3,), workspace frame [m], and gives the action (A,) of the coming physics
                step; what is asked for is rounded to float32, as actions are, so that a recording of it can be done
                again to the last bit. An exception of it ends the control step in the middle and is passed on.

        Returns:
            What ends the calls. Calling it twice is allowed.
        """
        self._pilot = pilot

        def stop() -> None:
            if self._pilot is pilot:
                self._pilot = None

        return stop

    @property
    def window_closed(self) -> bool:
        """Whether there was a window, with `render_mode="human"`, and the user has closed it."""
        return self._pictures.closed

    @property
    def goal(self) -> FloatArray:
        """(G,) what is asked in this episode (a copy)."""
        goal: FloatArray = self._episodes.goals[0].copy()
        return goal

    def _show(self) -> None:
        if self.render_mode == "human":
            self._pictures.show()

    def _info(self) -> dict[str, Any]:
        # Numbers that are Python's and NumPy's at once: JSON takes the one, learning libraries ask for `dtype`. Truth
        # values are Python's alone: NumPy's are no numbers to Gymnasium, and JSON does not take them.
        return {
            name: bool(values[0]) if values.dtype == np.bool_ else np.float64(values[0])
            for name, values in self._episodes.info.items()
        }

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedEnvironmentError("this environment is closed; make a new one")

    def _check_started(self, method: str) -> None:
        self._check_open()
        if not self._started:
            raise ResetNeeded(f"call reset() before {method}()")
