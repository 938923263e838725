"""Motions of tools that test whether contact holds: press, slide, plough, turn, and random ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.transforms import rotate

if TYPE_CHECKING:
    from spatula_env import Simulation
    from spatula_env.arrays import FloatArray

    Motion = tuple[FloatArray, FloatArray]

SCENES = ("seed", "palpate", "clamp", "fissure", "retract")
"""Names of the presets of `spatula_env.scenes` to move tools in."""

RECORDED = ("nodes", "velocities", "positions", "orientations", "linear", "angular")
"""Names of the arrays that every recording holds."""

SPEED = 1.25
"""Speed of the motions [u/s]: 25 mm/s in the scenes of the tasks."""

TURNING = 5.0
"""Angular speed of a tool that turns [rad/s]."""

DEPTHS = (0.1, 0.9)
"""Least and greatest depth that a tool is pressed to before it slides or turns [u]."""

CONTROL_STEP = 0.05
"""Unit of the durations of random velocities [s]."""

HOLD = 6
"""Greatest number of these units for which a random velocity is kept."""

BIAS = 0.4
"""Mean downward velocity of random motions, relative to `SPEED`: without it they would not come into contact."""


def clearance(simulation: Simulation) -> float:
    """Height of the tools' lowest corner above the organs' highest vertex [u]; negative if it is below."""
    lowest = min(
        float((rotate(orientation, placed.tool.vertices) + position)[:, 2].min())
        for placed, position, orientation in zip(
            simulation.scene.tools, simulation.tool_positions, simulation.tool_orientations, strict=True
        )
    )
    return lowest - float(simulation.nodes[:, 2].max())


def _spread(steps: list[tuple[int, FloatArray, FloatArray]], tools: int) -> Motion:
    """Linear and angular velocities (S, N, 3) of all tools, from phases: number of steps, linear, angular velocity."""
    counts = [count for count, _, _ in steps]
    linear = np.repeat([v for _, v, _ in steps], counts, axis=0)
    angular = np.repeat([w for _, _, w in steps], counts, axis=0)
    return np.repeat(linear[:, None], tools, axis=1), np.repeat(angular[:, None], tools, axis=1)


def _press(simulation: Simulation, generator: np.random.Generator) -> tuple[int, FloatArray, FloatArray]:
    """The first phase of a motion: down to a random depth."""
    way = max(clearance(simulation), 0.0) + generator.uniform(*DEPTHS)
    return math.ceil(way / (SPEED * simulation.dt)), np.array([0.0, 0.0, -SPEED]), np.zeros(3)


def _level(generator: np.random.Generator) -> FloatArray:
    """A random horizontal unit vector (3,)."""
    angle = generator.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def press(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Move down, and hold still."""
    held = (math.ceil(seconds / simulation.dt), np.zeros(3), np.zeros(3))
    return _spread([_press(simulation, generator), held], len(simulation.scene.tools))


def slide(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Move down, then sideways."""
    sideways = (math.ceil(seconds / simulation.dt), SPEED * _level(generator), np.zeros(3))
    return _spread([_press(simulation, generator), sideways], len(simulation.scene.tools))


def plough(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Move down, then sideways and further down at once."""
    onwards = SPEED * _level(generator) - np.array([0.0, 0.0, 0.3 * SPEED])
    ploughing = (math.ceil(seconds / simulation.dt), onwards, np.zeros(3))
    return _spread([_press(simulation, generator), ploughing], len(simulation.scene.tools))


def turn(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Move down, then turn about a random axis."""
    axis = generator.normal(size=3)
    turning = (math.ceil(seconds / simulation.dt), np.zeros(3), TURNING / np.linalg.norm(axis) * axis)
    return _spread([_press(simulation, generator), turning], len(simulation.scene.tools))


def random(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Move as an untrained learner does: random velocities, kept for a while, down more often than up."""
    per_control = max(1, round(CONTROL_STEP / simulation.dt))
    total, tools = math.ceil(seconds / simulation.dt), len(simulation.scene.tools)
    down = max(0, math.ceil(clearance(simulation) / (SPEED * simulation.dt)))
    linear = [np.repeat([[[0.0, 0.0, -SPEED]]], down, axis=0).repeat(tools, axis=1)]
    made = 0
    while made < total:
        count = min(per_control * int(generator.integers(1, HOLD + 1)), total - made)
        velocities = SPEED * (generator.uniform(-1.0, 1.0, (tools, 3)) - np.array([0.0, 0.0, BIAS]))
        linear.append(np.repeat(velocities[None], count, axis=0))
        made += count
    stacked = np.concatenate(linear)
    return stacked, np.zeros_like(stacked)


MOTIONS: dict[str, Callable[[Simulation, float, np.random.Generator], Motion]] = {
    "press": press,
    "slide": slide,
    "plough": plough,
    "turn": turn,
    "random": random,
}
"""All motions, by name."""
