"""How tools are moved to see whether contact holds: pressed, slid, ploughed, turned, and at random."""

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
"""Presets of `spatula_env.scenes`."""

RECORDED = ("nodes", "velocities", "positions", "orientations", "linear", "angular")
"""What a recording holds."""

SPEED = 1.25
"""Of the motions [u/s]: 25 mm/s in the scenes of the tasks."""

TURNING = 5.0
"""Of a tool that turns [rad/s]."""

DEPTHS = (0.1, 0.9)
"""How deep a tool is pressed in before it slides or turns, at least and at most [u]."""

CONTROL_STEP = 0.05
"""A random motion changes at whole multiples of this [s],"""

HOLD = 6
"""and stays the same for so many at most."""

BIAS = 0.4
"""Random motions go down by so much on the average, as a part of `SPEED`: else they do not come to touch."""


def clearance(simulation: Simulation) -> float:
    """Between the lowest of the tools' corners and the organs' highest vertex [u]; negative if that is lower."""
    lowest = min(
        float((rotate(orientation, placed.tool.vertices) + position)[:, 2].min())
        for placed, position, orientation in zip(
            simulation.scene.tools, simulation.tool_positions, simulation.tool_orientations, strict=True
        )
    )
    return lowest - float(simulation.nodes[:, 2].max())


def _spread(steps: list[tuple[int, FloatArray, FloatArray]], tools: int) -> Motion:
    """Velocities of all tools in each step, from how many steps they have which ones."""
    counts = [count for count, _, _ in steps]
    linear = np.repeat([v for _, v, _ in steps], counts, axis=0)
    angular = np.repeat([w for _, _, w in steps], counts, axis=0)
    return np.repeat(linear[:, None], tools, axis=1), np.repeat(angular[:, None], tools, axis=1)


def _press(simulation: Simulation, generator: np.random.Generator) -> tuple[int, FloatArray, FloatArray]:
    """Down until the tools are as deep as drawn."""
    way = max(clearance(simulation), 0.0) + generator.uniform(*DEPTHS)
    return math.ceil(way / (SPEED * simulation.dt)), np.array([0.0, 0.0, -SPEED]), np.zeros(3)


def _level(generator: np.random.Generator) -> FloatArray:
    """A level direction (3,), of unit length."""
    angle = generator.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def press(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Down, and held."""
    held = (math.ceil(seconds / simulation.dt), np.zeros(3), np.zeros(3))
    return _spread([_press(simulation, generator), held], len(simulation.scene.tools))


def slide(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Down, and then sideways."""
    sideways = (math.ceil(seconds / simulation.dt), SPEED * _level(generator), np.zeros(3))
    return _spread([_press(simulation, generator), sideways], len(simulation.scene.tools))


def plough(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Down, and then sideways and further down."""
    onwards = SPEED * _level(generator) - np.array([0.0, 0.0, 0.3 * SPEED])
    ploughing = (math.ceil(seconds / simulation.dt), onwards, np.zeros(3))
    return _spread([_press(simulation, generator), ploughing], len(simulation.scene.tools))


def turn(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """Down, and then turned about any axis."""
    axis = generator.normal(size=3)
    turning = (math.ceil(seconds / simulation.dt), np.zeros(3), TURNING / np.linalg.norm(axis) * axis)
    return _spread([_press(simulation, generator), turning], len(simulation.scene.tools))


def random(simulation: Simulation, seconds: float, generator: np.random.Generator) -> Motion:
    """What a learner does that knows nothing: velocities that are kept for a while, down more often than up."""
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
"""By name."""
