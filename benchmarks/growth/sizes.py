"""The cost of a step, a reset and a picture over worlds, nodes, tools and pixels: processor time on one thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numba
import numpy as np

from benchmarks.growth.fitting import cpu_microseconds, growth, tell
from spatula_env import Simulation, scenes
from spatula_env.geometry import seed_sphere
from spatula_env.geometry.transforms import quaternion_from_axis_angle, rotate

TASK = "Spatula/Press-v0"
UNIT = "us"
TILT = np.deg2rad(40.0)
"""Angle between the vertical and the direction from which the tools of `with_tools` come [rad]."""
DEPTH, SPEED = 0.6, 5.0
"""Depth to which tools press [u], and their speed [u/s]."""


@dataclass(frozen=True)
class Sizes:
    """Sizes to measure at.

    Attributes:
        worlds: Numbers of worlds of vector environments.
        organ_nodes: Numbers of nodes of spheres.
        tool_edges: Numbers of contact nodes along an edge of a spatula.
        tools: Numbers of tools.
        pixels: Edge lengths of square pictures [pixels].
        calls: Number of timed calls at each size; more or fewer for some measurements.
    """

    worlds: tuple[int, ...] = (16, 64, 256, 1024, 4096)
    organ_nodes: tuple[int, ...] = (162, 328, 642, 1280, 2562)
    tool_edges: tuple[int, ...] = (4, 6, 9, 13, 19)
    tools: tuple[int, ...] = (1, 2, 3, 4)
    pixels: tuple[int, ...] = (32, 64, 128, 256, 512)
    calls: int = 40


QUICK = Sizes((16, 64, 256), (162, 328, 642), (4, 6, 9), (1, 2, 3), (32, 64, 128), calls=10)


def measure_worlds(sizes: Sizes) -> dict[str, Any]:
    """Measure a control step of W worlds, many of which are in contact, and a reset of one of them."""
    step, reset = {}, {}
    for count in sizes.worlds:
        envs = gymnasium.make_vec(TASK, num_envs=count, engine="batch", autoreset_mode="disabled")
        envs.unwrapped.reset(seed=0)
        generator = np.random.default_rng(0)
        down = np.tile(np.array([0.0, 0.0, -1.0], dtype=np.float32), (count, 1))
        for _ in range(8):
            envs.step(down)

        def step_all(envs: Any = envs, generator: Any = generator, count: int = count) -> None:
            actions = generator.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
            envs.step(actions)

        # Ten calls at most, half a second of simulated time: the amount of contact changes as the worlds go on.
        step[count] = cpu_microseconds(step_all, min(sizes.calls, 10))
        worlds = iter(np.resize(np.random.default_rng(1).permutation(count), 10 * sizes.calls))

        def reset_one(envs: Any = envs, worlds: Any = worlds, count: int = count) -> None:
            mask = np.zeros(count, dtype=np.bool_)
            mask[next(worlds)] = True
            envs.reset(options={"reset_mask": mask})

        reset[count] = cpu_microseconds(reset_one, 2 * sizes.calls)
        envs.close()
        tell(f"{count} worlds: {step[count] / count:.0f} us a step and world, {reset[count]:.0f} us a reset of one")
    return {
        "step of all worlds": growth(step, UNIT, "worlds"),
        "reset of one world": growth(reset, UNIT, "worlds"),
    }


def measure_nodes(sizes: Sizes) -> dict[str, Any]:
    """Measure a physics step in contact over the number of nodes of the organ, and of the tool."""
    organ = {count: step_in_contact(with_organ(count), sizes.calls) for count in sizes.organ_nodes}
    tool = {2 * edge**2: step_in_contact(scenes.palpate(nodes_per_edge=edge), sizes.calls) for edge in sizes.tool_edges}
    tell(f"organ's nodes: {_shown(organ)}; tool's: {_shown(tool)}")
    return {
        "step, organ's nodes": growth(organ, UNIT, "nodes of the organ"),
        "step, tool's nodes": growth(tool, UNIT, "contact nodes of the tool"),
    }


def measure_tools(sizes: Sizes) -> dict[str, Any]:
    """Measure a physics step over the number of tools, all of which press."""
    found = {count: step_in_contact(with_tools(count), sizes.calls) for count in sizes.tools}
    tell(f"tools: {_shown(found)}")
    return {"step, tools": growth(found, UNIT, "tools")}


def measure_pictures(sizes: Sizes) -> dict[str, Any]:
    """Measure a picture of the scene over the number of its pixels."""
    found = {}
    for edge in sizes.pixels:
        env = gymnasium.make(TASK, engine="batch", render_mode="rgb_array", width=edge, height=edge)
        env.reset(seed=0)
        found[edge**2] = cpu_microseconds(env.render, max(sizes.calls // 4, 5))
        env.close()
    tell(f"pictures: {_shown(found)}")
    return {"picture": growth(found, UNIT, "pixels")}


def with_organ(count: int) -> scenes.Scene:
    """The palpation scene with a sphere of `count` nodes."""
    scene = scenes.palpate()
    sphere = replace(scene.organs[0], organ=seed_sphere(node_count=count), fixed_nodes=())
    held = np.flatnonzero(sphere.vertices[:, 2] < 2.0)
    return replace(scene, organs=(replace(sphere, fixed_nodes=tuple(held.tolist())),))


def with_tools(count: int) -> scenes.Scene:
    """The palpation scene with `count` spatulas around the top of the sphere, all tilted by `TILT`."""
    scene = scenes.palpate()
    tool, middle = scene.tools[0], np.array([0.0, 0.0, 3.0])
    tools = []
    for azimuth in 2.0 * np.pi * np.arange(count) / count:
        turn = quaternion_from_axis_angle((-np.sin(azimuth), np.cos(azimuth), 0.0), TILT)
        place = middle + rotate(turn, np.array([0.0, 0.0, 3.2]))
        tools.append(replace(tool, position=tuple(place.tolist()), orientation=tuple(turn.tolist())))
    return replace(scene, tools=tuple(tools))


def step_in_contact(scene: scenes.Scene, calls: int) -> float:
    """Processor time of a physics step of the batch engine while all tools press towards the organ's middle [us]."""
    simulation = Simulation(scene, engine="batch")
    simulation.reset()
    normals = np.array([rotate(np.array(tool.orientation), np.array([0.0, 0.0, -1.0])) for tool in scene.tools])
    surface = simulation.nodes
    gaps = [float(np.min(np.linalg.norm(surface - tool.position, axis=1))) for tool in scene.tools]
    steps = round((max(gaps) + DEPTH) / SPEED / simulation.dt)
    motion = SPEED * normals if len(scene.tools) > 1 else SPEED * normals[0]
    still = np.zeros_like(motion)
    for _ in range(steps):
        report = simulation.step(motion)
    assert np.all(np.linalg.norm(np.reshape(report.force, (-1, 3)), axis=1) > 0.0), "a tool does not touch"
    made = cpu_microseconds(_several(lambda: simulation.step(still)), calls)
    simulation.close()
    return made / STEPS


STEPS = 10
"""Number of physics steps in a timed call."""


def _several(call: Callable[[], object]) -> Callable[[], None]:
    def calls() -> None:
        for _ in range(STEPS):
            call()

    return calls


def _shown(costs: dict[int, float]) -> str:
    return ", ".join(f"{size}: {cost:.0f} us" for size, cost in costs.items())


def measure_sizes(sizes: Sizes, parts: dict[str, Callable[[Sizes], dict[str, Any]]]) -> dict[str, Any]:
    """Measure some parts on one thread.

    Args:
        sizes: Sizes to measure at.
        parts: Functions that measure, by name.
    """
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        return {name: measure(sizes) for name, measure in parts.items()}
    finally:
        numba.set_num_threads(before)
