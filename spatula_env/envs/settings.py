"""The definition of an environment, and the options that all environments have."""

from __future__ import annotations

import difflib
import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from spatula_env.engines import choose_engine, load_engine
from spatula_env.envs.control import ALL_SIX, TRANSLATION, ControlLayout
from spatula_env.envs.levels import LEVELS, SPLITS, Level, default_levels, merged
from spatula_env.envs.observed_ranges import ALL_PARTS, PART_CHOICES, ObservedRanges, check_parts
from spatula_env.envs.randomization import DEFAULT_RANGES, LONGEST_DELAY, Ranges, read_ranges
from spatula_env.geometry.checks import check_boolean, check_count, check_not_negative, check_positive, is_number
from spatula_env.geometry.prepared import PREPARED_SUFFIX
from spatula_env.scenes.material import as_material
from spatula_env.tasks.configuration import config_from_mapping
from spatula_env.tasks.plain import make_fields_plain

if TYPE_CHECKING:
    from spatula_env.geometry.prepared import PreparedOrgan
    from spatula_env.scenes import Scene
    from spatula_env.sim.engine import ContactName
    from spatula_env.tasks.base import Task
    from spatula_env.tasks.situation import Setting

OBS_MODES = ("state", "dict", "rgb", "rgbd", "pointcloud")
"""Layouts of observations; see `ObservationBuilder`."""

REWARDS = ("dense", "sparse")
"""Kinds of reward."""

RENDER_MODES = ("rgb_array", "human")
"""Ways to render an environment; vector environments only support pictures."""


LEAST_CONTROL_FREQUENCY = 0.5
"""Least control frequency: control steps longer than two seconds are no control, and as slow to compute [Hz]."""

PICTURE_STYLES = ("plain", "full")
"""Styles of observed pictures: fast for learners, and as `render` draws them."""

LARGEST_PICTURE = 8192
"""Greatest width and height of pictures [pixels]."""

MOST_SHOWN = 1000
"""Greatest number of stacked observations."""

MOST_POINTS = 100_000
"""Greatest number of points of a point cloud, on either surface."""


@dataclass(frozen=True)
class ObservationSettings:
    """How observations are derived from the true state.

    Attributes:
        noise: Factor on the standard deviations in `observations.NOISE`; 0 for no noise.
        delay: Delay of observations, rounded to control steps [s].
        history: Number of observations that are stacked, oldest first, on a leading axis if there is more than one.
        image_size: (height, width) of pictures [pixels].
        picture_style: "plain": one sample per pixel, without shadows, highlights and textures, for learners, who need
            many pictures. "full": as `render` draws them, at some twenty times the time.
        organ_points: Number of points of a point cloud on the organ's surface.
        tool_points: Number of points of a point cloud on the tools' surfaces.
        parts: "all"; "sensors": those that a robot knows from its own sensors or is told; "grouped": all, in two
            entries, "sensors" and "privileged".
    """

    noise: float = 0.0
    delay: float = 0.0
    history: int = 1
    image_size: tuple[int, int] = (84, 84)
    picture_style: str = "plain"
    organ_points: int = 256
    tool_points: int = 64
    parts: str = ALL_PARTS

    def __post_init__(self) -> None:
        """Check the values; convert a list from a file, and NumPy's numbers and arrays."""
        make_fields_plain(self)
        check_not_negative(self.noise, "observation.noise")
        if not (is_number(self.delay) and 0.0 <= self.delay <= LONGEST_DELAY):
            raise ValueError(f"observation.delay must be 0 to {LONGEST_DELAY:g} s, got {self.delay!r}")
        check_count(self.history, "observation.history", 1, MOST_SHOWN)
        check_count(self.organ_points, "observation.organ_points", 1, MOST_POINTS)
        check_count(self.tool_points, "observation.tool_points", 1, MOST_POINTS)
        try:
            height, width = self.image_size
        except (TypeError, ValueError):
            raise ValueError(
                f"observation.image_size must be two integers (height, width), got {self.image_size!r}"
            ) from None
        for number in (height, width):
            check_count(number, "observation.image_size", 8, LARGEST_PICTURE)
        object.__setattr__(self, "image_size", (height, width))
        check_choice(self.picture_style, "observation.picture_style", PICTURE_STYLES)
        check_choice(self.parts, "observation.parts", PART_CHOICES)


@dataclass(frozen=True)
class EnvSettings:
    """The options that all environments have.

    Attributes:
        engine: Engine that simulates the organ: "bullet", "batch", "tissue" or "mujoco". None: "bullet" if PyBullet is
            installed, else "batch"; for vector environments "batch".
        material: Material of the organ with the engines "tissue" and "mujoco": a `scenes.Material`, a mapping of its
            fields, or the name of a region that `Material.brain` knows. None: the engine's default.
        organ: A file of `spatula organ prepare`, with an organ to take instead of the task's own; None for that.
        contact: Method that resolves contact: "flags", "second_step" or the own one of the engine "bullet" or "mujoco",
            by its name.
        obs_mode: "state", "dict", "rgb", "rgbd" or "pointcloud".
        control: "velocity": the degrees of freedom that the task needs. "velocity_6d": six degrees of freedom.
        reward: "dense": the weighted sum of the task's terms. "sparse": 0 within tolerance, -1 elsewhere, with
            Gymnasium-Robotics' goal interface where the task offers hindsight.
        task: Fields of the task's configuration to change, by name.
        max_speed: Greatest speed of the grip along each axis [m/s].
        max_rotation_rate: Greatest rate of rotation of the tools about each axis [rad/s].
        max_jaw_speed: Greatest speed of the jaws [m/s].
        max_force: A tool that has met a greater force in a physics step does not advance in the next one [N]; None for
            no such stop.
        control_frequency: Number of control steps per second, at least 0.5 [Hz].
        episode_time: Time after which an episode is truncated [s]; None for no limit.
        terminate_on_success: Whether success ends an episode.
        terminate_on_tangle: Whether an episode ends if organs stay crossed; see `info["tangled"]`.
        damage_limit: An episode ends when its dose exceeds this [Pa s]; None for no limit.
        pressure_limit: An episode ends when a contact pressure exceeds this in a physics step [Pa]; None for no limit.
        strain_limit: An episode ends when the greatest principal strain in the organ exceeds this at the end of a
            control step, with an engine that tells strains; None for no limit.
        level: "easy", "standard" or "hard": which defaults the other options have; see `levels`.
        split: "train", or "test" for organs that are not drawn for training.
        randomization: "none", "default", or the range of each quantity that is randomised in each episode.
        observation: Fields of `ObservationSettings` to change, by name.
        render_mode: None, "rgb_array" or, for one agent, "human".
        width: Width of pictures, 1 to 8192 [pixels].
        height: Height of pictures, 1 to 8192 [pixels].
    """

    engine: str | None = None
    material: Any = None
    organ: str | None = None
    contact: ContactName = "flags"
    obs_mode: str = "state"
    control: str = "velocity"
    reward: str = "dense"
    task: Any = None
    max_speed: float = 0.1
    max_rotation_rate: float = 1.0
    max_jaw_speed: float = 0.05
    max_force: float | None = 2.0
    control_frequency: float = 20.0
    episode_time: float | None = None
    terminate_on_success: bool = False
    terminate_on_tangle: bool = False
    damage_limit: float | None = None
    pressure_limit: float | None = None
    strain_limit: float | None = None
    level: str = "easy"
    split: str = "train"
    randomization: Any = "none"
    observation: Any = None
    render_mode: str | None = None
    width: int = 480
    height: int = 480

    def __post_init__(self) -> None:
        """Check the values that do not depend on the scene; convert NumPy's numbers and arrays."""
        make_fields_plain(self)
        check_choice(self.obs_mode, "obs_mode", OBS_MODES)
        check_choice(self.reward, "reward", REWARDS)
        if self.render_mode is not None:
            check_choice(self.render_mode, "render_mode", (None, *RENDER_MODES))
        for name in ("max_speed", "max_rotation_rate", "max_jaw_speed", "control_frequency"):
            check_positive(getattr(self, name), name)
        if self.control_frequency < LEAST_CONTROL_FREQUENCY:
            raise ValueError(
                f"control_frequency must be {LEAST_CONTROL_FREQUENCY:g} Hz at least, got {self.control_frequency!r}"
            )
        for name in ("max_force", "episode_time"):
            check_positive(getattr(self, name), name, or_none=True)
        check_not_negative(self.damage_limit, "damage_limit", or_none=True)
        check_positive(self.pressure_limit, "pressure_limit", or_none=True)
        check_positive(self.strain_limit, "strain_limit", or_none=True)
        check_choice(self.level, "level", LEVELS)
        check_choice(self.split, "split", SPLITS)
        check_boolean(self.terminate_on_success, "terminate_on_success")
        check_boolean(self.terminate_on_tangle, "terminate_on_tangle")
        for name in ("width", "height"):
            check_count(getattr(self, name), name, 1, LARGEST_PICTURE)
        if self.material is not None:
            object.__setattr__(self, "material", as_material(self.material))
        if self.organ is not None:
            object.__setattr__(self, "organ", _as_organ_file(self.organ))
        observation = config_from_mapping(ObservationSettings, self.observation, "observation")
        object.__setattr__(self, "observation", observation)
        check_parts(observation.parts, self.obs_mode)


@dataclass(frozen=True)
class OwnOrgan:
    """How a task is set on an organ of one's own.

    Attributes:
        scene: Makes the scene of a prepared organ.
        task: Makes the task from its configuration and the setting.
        defaults: Defaults of options where they differ from those of the `Definition`, by name.
    """

    scene: Callable[[PreparedOrgan], Scene]
    task: Callable[[Any, Setting], Task]
    defaults: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Definition:
    """What distinguishes one environment from another.

    Attributes:
        name: Name of the task.
        scene: Makes the scene, which has one organ.
        task: Makes the task from its configuration and the setting; for example, the task's class.
        config: The dataclass that configures the task.
        workspace_height: Height of the workspace's middle above the organ's top at rest [m].
        stop_height: Height above the ground below which no point of a tool gets [m]. Tissue that is held cannot make
            way for a tool that is driven into it.
        controls: Layouts of actions, by the names that the option `control` takes.
        defaults: Defaults of options where they differ from those of `EnvSettings`, by name.
        randomization: The ranges of `randomization="default"`; see `randomization.DEFAULT_RANGES`.
        levels: Defaults of options at each level of difficulty.
        observed: Ranges of observed measurements of contact and of the organ, and the observed faces.
        own_organ: How the task is set on an organ of one's own; None if it cannot be.
        former_options: By the number of a former definition of the task, the options whose values had another meaning
            then: their former default, and the present names of the values. See `definitions.present_options`.
    """

    name: str
    scene: Callable[[], Scene]
    task: Callable[[Any, Setting], Task]
    config: type[Any]
    workspace_height: float
    stop_height: float = 0.0
    controls: Mapping[str, ControlLayout] = field(
        default_factory=lambda: {"velocity": TRANSLATION, "velocity_6d": ALL_SIX}
    )
    defaults: Mapping[str, Any] = field(default_factory=dict)
    randomization: Ranges = field(default_factory=lambda: dict(DEFAULT_RANGES))
    levels: Mapping[str, Level] = field(default_factory=default_levels)
    observed: ObservedRanges = field(default_factory=ObservedRanges)
    own_organ: OwnOrgan | None = None
    former_options: Mapping[int, Mapping[str, tuple[Any, Mapping[Any, Any]]]] = field(default_factory=dict)

    def read(
        self, options: Mapping[str, Any], owner: str, others: tuple[str, ...] = (), **defaults: Any
    ) -> EnvSettings:
        """Validate the options of an environment.

        Args:
            options: The options by name.
            owner: Owner of the options, for error messages.
            others: Names of further arguments that it takes, for error messages.
            **defaults: Defaults that differ from those of `EnvSettings`.

        Returns:
            All options; `engine` is the one to use, `task` is a configuration, `observation` `ObservationSettings`,
            `randomization` ranges.

        Raises:
            TypeError: If an option does not exist.
            ValueError: If a value is not one of those allowed, or out of its range.
            ImportError: If PyBullet is requested and not installed; the message says what to install.
        """
        allowed = sorted([*(each.name for each in fields(EnvSettings)), *others])
        for name in options:
            if name not in allowed:
                near = difflib.get_close_matches(name, allowed, 1)
                hint = f". Did you mean {near[0]!r}? Allowed" if near else "; allowed"
                # Worded as Python does: libraries look for these words to retry without an argument.
                raise TypeError(
                    f"{owner}.__init__() got an unexpected keyword argument {name!r}{hint} are {', '.join(allowed)}"
                )
        own = self.own_organ.defaults if self.own_organ is not None and options.get("organ") is not None else {}
        level = self._level(options)
        values = merged({**defaults, **self.defaults, **own, **level.options}, options)
        if values.get("engine") is None:
            values["engine"] = {**defaults, **self.defaults}.get("engine")
        if level.material_options and values["engine"] is not None:
            engine = choose_engine(values["engine"], values.get("contact", EnvSettings.contact))
            if load_engine(engine).abilities.strains:
                values = merged({**values, **level.material_options}, options)
        settings = EnvSettings(**values)
        check_choice(settings.control, "control", tuple(self.controls))
        if settings.organ is not None and self.own_organ is None:
            raise ValueError(
                f"organ must be None in {self.name}, which needs an organ with parts of its own; got {settings.organ!r}"
            )
        engine = choose_engine(settings.engine, settings.contact)
        if settings.material is not None and not load_engine(engine).abilities.materials:
            raise ValueError(
                f"material must be None but with the engines 'tissue' and 'mujoco', got it with engine {engine!r}"
            )
        if settings.strain_limit is not None and not load_engine(engine).abilities.strains:
            raise ValueError(
                f"strain_limit must be None but with an engine that tells strains, as 'tissue' does, got "
                f"{settings.strain_limit!r} with engine {engine!r}"
            )
        ranges = read_ranges(settings.randomization, self.randomization if level.ranges is None else level.ranges)
        if settings.split == "test":
            ranges |= level.held_out
        return EnvSettings(
            **{
                **vars(settings),
                "engine": engine,
                "task": config_from_mapping(self.config, settings.task, "task"),
                "randomization": ranges,
            }
        )

    def _level(self, options: Mapping[str, Any]) -> Level:
        check_choice(options.get("level", "easy"), "level", LEVELS)
        return self.levels[options.get("level", "easy")]

    def signature(self, *more: inspect.Parameter, **defaults: Any) -> inspect.Signature:
        """Signature of an environment with this definition, for `inspect.signature`.

        Args:
            *more: Arguments before the options.
            **defaults: Defaults that differ from those of `EnvSettings`.
        """
        values = {**{each.name: each.default for each in fields(EnvSettings)}, **defaults, **self.defaults}
        options = [
            inspect.Parameter(
                each.name, inspect.Parameter.KEYWORD_ONLY, default=values[each.name], annotation=each.type
            )
            for each in fields(EnvSettings)
        ]
        return inspect.Signature([*more, *options])


def _as_organ_file(value: Any) -> str:
    if not isinstance(value, str | os.PathLike):
        raise ValueError(f"organ must be the path of a file of `spatula organ prepare`, or None, got {value!r}")
    path = os.fspath(value)
    if not path.lower().endswith(PREPARED_SUFFIX):
        raise ValueError(
            f"organ must be a file of `spatula organ prepare`, which ends in {PREPARED_SUFFIX}, got {path!r}: prepare "
            "the surface or the volume first"
        )
    return path


def check_choice(value: Any, name: str, allowed: tuple[Any, ...]) -> None:
    """Check that a value is an allowed one.

    Raises:
        ValueError: If it is not.
    """
    if not any(value is one or (isinstance(value, str) and value == one) for one in allowed):
        raise ValueError(f"{name} must be one of {list(allowed)}, got {value!r}")
