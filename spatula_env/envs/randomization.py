"""Domain randomization: what differs between episodes besides goal and start."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.envs.sway import PARTS, Sway, phase_name
from spatula_env.tasks.configuration import check_range

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.envs.workspace_frames import Frames
    from spatula_env.scenes import Scene
    from spatula_env.sim.worlds import Worlds
    from spatula_env.tasks.situation import Setting

Ranges = Mapping[str, tuple[float, float]]
"""Least and greatest value of each randomised quantity, drawn uniformly in each episode."""

LONGEST_DELAY = 0.5
"""Greatest delay of actions and observations [s]."""

NEUTRAL: Mapping[str, float] = MappingProxyType(
    {
        "stiffness": 1.0,
        "friction": 1.0,
        "organ_size": 1.0,
        "organ_x": 0.0,
        "organ_y": 0.0,
        "organ_yaw": 0.0,
        "tool_size": 1.0,
        "sensor_noise": 0.0,
        "action_delay": 0.0,
        "breathing": 0.0,
        "breathing_phase": 0.0,
        "pulse": 0.0,
        "pulse_phase": 0.0,
    }
)
"""The quantities that can be randomised, with their values when they are not.

- stiffness: factor on the organ's stiffness and its density. Bullet's soft body cannot separate the two: its links have
  one stiffness, and their effective resistance grows with the masses at their ends.
- friction: factor on the friction coefficients between tools and organ.
- organ_size: factor on the organ's lengths, about the middle of its top; its material stays the same.
- organ_x, organ_y: shift of the organ in the workspace [m].
- organ_yaw: rotation of the organ about the vertical [rad].
- tool_size: factor on the tools' lengths.
- sensor_noise: replaces `observation.noise`.
- action_delay: delay after which an action is carried out, a whole number of control steps [s].
- breathing, pulse: amplitudes with which the organ rises and sinks; see `Sway` [m].
- breathing_phase, pulse_phase: phases of these motions when episodes begin; of a whole turn, if only an amplitude is
  given [rad].
"""

LEAST: Mapping[str, float] = MappingProxyType(
    {
        "stiffness": 0.05,
        "friction": 0.0,
        "organ_size": 0.5,
        "organ_x": -0.02,
        "organ_y": -0.02,
        "organ_yaw": -np.pi,
        "tool_size": 0.5,
        "sensor_noise": 0.0,
        "action_delay": 0.0,
        "breathing": 0.0,
        "breathing_phase": -np.pi,
        "pulse": 0.0,
        "pulse_phase": -np.pi,
    }
)
"""Least values allowed."""

GREATEST: Mapping[str, float] = MappingProxyType(
    {
        "stiffness": 20.0,
        "friction": 10.0,
        "organ_size": 2.0,
        "organ_x": 0.02,
        "organ_y": 0.02,
        "organ_yaw": np.pi,
        "tool_size": 2.0,
        "sensor_noise": 100.0,
        "action_delay": LONGEST_DELAY,
        "breathing": 0.01,
        "breathing_phase": np.pi,
        "pulse": 0.001,
        "pulse_phase": np.pi,
    }
)
"""Greatest values allowed."""

DEFAULT_RANGES: Ranges = MappingProxyType(
    {
        "stiffness": (0.7, 1.4),
        "friction": (0.5, 1.5),
        "organ_size": (0.95, 1.05),
        "organ_x": (-0.004, 0.004),
        "organ_y": (-0.004, 0.004),
        "tool_size": (0.95, 1.05),
        "sensor_noise": (0.0, 1.0),
        "action_delay": (0.0, 0.05),
    }
)
"""Ranges of `randomization="default"` for tasks that do not define their own."""


def read_ranges(value: Any, default: Ranges) -> dict[str, tuple[float, float]]:
    """Interpret the option `randomization`.

    Args:
        value: "none", "default", or a mapping from names to two numbers, or to a single number for a constant.
        default: Ranges of "default".

    Returns:
        The range of each randomised quantity.

    Raises:
        ValueError: If it is something else, a quantity does not exist, or a range exceeds the allowed limits.
    """
    if isinstance(value, str) and value in ("none", "default"):
        return _with_phases(dict(default)) if value == "default" else {}
    if not isinstance(value, Mapping):
        raise ValueError(f"randomization must be 'none', 'default' or a mapping, got {value!r}")
    unknown = sorted(str(name) for name in value if name not in NEUTRAL)
    if unknown:
        raise ValueError(f"randomization has no {', '.join(unknown)}; allowed are {', '.join(sorted(NEUTRAL))}")
    ranges: dict[str, tuple[float, float]] = {}
    for name, given in value.items():
        pair = (given, given) if isinstance(given, int | float) else given
        low, high = check_range(pair, f"randomization.{name}")
        if low < LEAST[name] or high > GREATEST[name]:
            raise ValueError(f"randomization.{name} must lie in {LEAST[name]:g} to {GREATEST[name]:g}, got {given!r}")
        ranges[name] = (low, high)
    return _with_phases(ranges)


def _with_phases(ranges: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Add the phases of motions of which only the amplitude is given: a whole turn."""
    for name, _ in PARTS:
        if name in ranges:
            ranges.setdefault(phase_name(name), (-np.pi, np.pi))
    return ranges


def draw(ranges: Ranges, generator: np.random.Generator, period: float) -> dict[str, float]:
    """Draw all quantities once, by name, for control steps of a length [s]."""
    values = dict(NEUTRAL)
    for name, (low, high) in ranges.items():
        if name == "action_delay":
            values[name] = period * float(generator.integers(round(low / period), round(high / period) + 1))
        else:
            values[name] = float(generator.uniform(low, high))
    return values


class Variation:
    """Randomised quantities of W worlds: draws them at the beginning of episodes, and derives their effects.

    Attributes:
        drawn: (W,) values, by the names in `NEUTRAL`.
        settings: Setting of each world's task.
        rest_nodes: (W, V, 3) the organs at rest, or (1, V, 3) if nothing is randomised [m].
        tool_scale: (W,) factor on the tools' lengths.
        sway: Motion of the organs with breath and pulse.
    """

    def __init__(
        self, ranges: Ranges, noise: float, scene: Scene, setting: Setting, frames: Frames, worlds: Worlds
    ) -> None:
        """Start with all worlds alike.

        Args:
            ranges: Ranges of the randomised quantities.
            noise: Factor on the standard deviations of measurements, if it is not randomised.
            scene: Scene of all worlds.
            setting: Setting that they have in common.
            frames: Placement and scale of each world's organ; written.
            worlds: The physics, with everything at rest.
        """
        self._ranges, self._scene, self._setting, self._frames = ranges, scene, setting, frames
        self._worlds: Worlds | None = worlds
        count = worlds.count
        self._rest = np.array(worlds.nodes[0])
        self._noisy = noise > 0.0
        self._generators: list[np.random.Generator | None] = [None] * count
        self.drawn = {name: np.full(count, value) for name, value in NEUTRAL.items()}
        self.drawn["sensor_noise"][:] = noise
        self.settings = [setting] * count
        self.rest_nodes: FloatArray = setting.rest_nodes[None]
        if ranges:
            self.rest_nodes = np.repeat(self.rest_nodes, count, axis=0)
        self.tool_scale: FloatArray = np.ones(count)
        self.sway = Sway(self.drawn, moving=any(name in ranges for name, _ in PARTS))

    def draw(self, generators: Mapping[int, np.random.Generator]) -> None:
        """Draw the randomised quantities for new episodes.

        Args:
            generators: The worlds in which episodes begin, and the source of randomness of each.
        """
        ranges = self._ranges
        if not ranges and not self._noisy:
            return
        for world, generator in generators.items():
            # Use a separate generator: goals and starts are then the same as without randomisation, and do not depend
            # on the length of the previous episode.
            (child,) = generator.spawn(1)
            self._generators[world] = child
            for name, value in draw(ranges, child, self._setting.period).items():
                if name in ranges:
                    self.drawn[name][world] = value
        self._apply(np.fromiter(generators, dtype=np.int64))

    def would_be(self, generators: Mapping[int, np.random.Generator]) -> tuple[list[Setting], FloatArray]:
        """Compute what `draw` would lead to, without applying it.

        Args:
            generators: As for `draw`; they are advanced.

        Returns:
            The setting of each world, and the scale of its tools (n,).
        """
        worlds = np.fromiter(generators, dtype=np.int64)
        # Copy only these worlds, so that the time does not depend on how many others there are.
        trial = copy.copy(self)
        trial._worlds, trial._frames = None, self._frames.rows(worlds)
        trial._generators = [None] * len(worlds)
        trial.settings = [self.settings[world] for world in worlds.tolist()]
        trial.drawn = {name: values[worlds] for name, values in self.drawn.items()}
        trial.tool_scale, trial.rest_nodes = self.tool_scale[worlds], np.array(self.rest_of(worlds))
        trial.draw(dict(enumerate(generators.values())))
        return trial.settings, trial.tool_scale

    def save(self, worlds: IntArray) -> tuple[dict[str, FloatArray], tuple[np.random.Generator | None, ...]]:
        """Copy the randomised quantities of some worlds (n,), and the generators of their measurement errors."""
        drawn = {name: values[worlds] for name, values in self.drawn.items()}
        return drawn, tuple(copy.deepcopy(self._generators[world]) for world in worlds.tolist())

    def restore(
        self, drawn: Mapping[str, FloatArray], generators: Sequence[np.random.Generator | None], worlds: IntArray
    ) -> None:
        """Restore in some worlds (n,) what `save` returned. The tools' contact flags are cleared where tools differ."""
        for name, values in drawn.items():
            self.drawn[name][worlds] = values
        for world, generator in zip(worlds.tolist(), generators, strict=True):
            self._generators[world] = copy.deepcopy(generator)
        self._apply(worlds)

    def _apply(self, worlds: IntArray) -> None:
        """Apply the quantities drawn for some worlds (n,)."""
        ranges = self._ranges
        if not ranges:
            return
        drawn = {name: values[worlds] for name, values in self.drawn.items()}
        self._frames.set(
            worlds,
            shift=np.stack([drawn["organ_x"], drawn["organ_y"]], axis=1),
            yaw=drawn["organ_yaw"],
            size=drawn["organ_size"],
            stiffness=drawn["stiffness"],
        )
        self.tool_scale[worlds] = drawn["tool_size"]
        # `would_be` has no physics to change.
        if self._worlds is not None and {"friction", "tool_size", "organ_size"} & set(ranges):
            self._worlds.vary(drawn["friction"], drawn["tool_size"] / drawn["organ_size"], worlds)
        for world in worlds.tolist():
            self.settings[world] = setting = self._setting_in(world)
            self.rest_nodes[world] = setting.rest_nodes

    def rest_of(self, worlds: IntArray) -> FloatArray:
        """(n, V, 3) the organs of some worlds (n,) at rest, or (1, V, 3) if nothing is randomised [m]."""
        return self.rest_nodes[worlds] if self._ranges else self.rest_nodes

    def bed_heights(self, worlds: IntArray, times: FloatArray) -> FloatArray | None:
        """Heights (n,) of the organs of worlds (n,) above their mean at times (n,) [s], in [m]; None if none moves."""
        return self.sway.heights(times, worlds) if self.sway.moving else None

    def sensor_noise(self, worlds: IntArray, size: int) -> FloatArray | None:
        """Measurement errors in some worlds (n,), in standard deviations: (n, size), or None if there are none."""
        deviations = self.drawn["sensor_noise"][worlds]
        if not (deviations > 0.0).any():
            return None
        errors = []
        for world in worlds.tolist():
            generator = self._generators[world]
            assert generator is not None
            errors.append(generator.standard_normal(size))
        return np.asarray(deviations[:, None] * np.stack(errors))

    def _setting_in(self, world: int) -> Setting:
        """Setting of a world whose organ and tools have been drawn."""
        scene, frames, at, tool_size = self._scene, self._frames, np.array([world]), float(self.tool_scale[world])
        organ_position = np.array([[scene.organs[0].position]])
        ground = (0.0, 0.0, self._rest[:, 2].min() if scene.ground is None else scene.ground.height)
        return replace(
            self._setting,
            rest_nodes=np.ascontiguousarray(frames.points_from_scene(self._rest[None], at)[0]),
            ground_height=float(frames.points_from_scene(np.array([[ground]]), at)[0, 0, 2]),
            tools=tuple(
                replace(tool, vertices=tool.vertices * tool_size, nodes=tool.nodes * tool_size)
                for tool in self._setting.tools
            ),
            organ_position=frames.points_from_scene(organ_position, at)[0, 0],
            length=float(frames.length[world]),
        )
