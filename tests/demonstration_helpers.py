"""A dataset of made-up episodes in the layout of an environment of this package, without physics."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from gymnasium import spaces

import spatula_env
from spatula_env.data import DatasetWriter, Episode
from spatula_env.data.layout import VECTOR, Layout

assert spatula_env.TASKS

ID = "spatula/press/made_up-v0"
NAMES = ("contact_depth", "tool_position_x", "tool_position_y", "tool_position_z")
LAYOUT = Layout(
    observation_names={VECTOR: NAMES},
    action_names=("velocity_x", "velocity_y", "velocity_z"),
    control_frequency=20.0,
    task="Press the organ to a depth at a place, and hold it there.",
    scene="seed",
    lerobot_names={VECTOR: "observation.state"},
    workspace_low=(-0.05, -0.05, -0.05),
    workspace_high=(0.05, 0.05, 0.05),
)
LENGTHS = (4, 6, 3)
FORCES = (1.0, 2.0, 4.0)
"""Of each episode, from its second step on."""


def make_episode(number: int, *, nodes: Any = None) -> Episode:
    """An episode of `LENGTHS[number]` steps; those with an even number succeed in the last."""
    steps = LENGTHS[number]
    rows = np.arange(steps + 1)
    observations = np.zeros((steps + 1, 4), dtype=np.float32)
    observations[:, 1] = 0.01 * (rows - 2) + 0.005
    observations[:, 3] = 0.01 * number + 0.005
    success = number % 2 == 0
    infos: dict[str, Any] = {
        "time": 0.05 * rows,
        "force": np.where(rows > 1, FORCES[number], 0.0),
        "peak_pressure": np.where(rows > 1, 1000.0 * FORCES[number], 0.0),
        "episode_peak_force": np.where(rows > 1, FORCES[number], 0.0),
        "episode_peak_pressure": np.where(rows > 1, 1000.0 * FORCES[number], 0.0),
        "episode_dose": 10.0 * rows,
        "violation": (rows > 1) & (FORCES[number] >= 4.0),
        "is_success": (rows == steps) & success,
    }
    if nodes is not None:
        tools = np.tile([0.0, 0.0, 6.3, 0.0, 0.0, 0.0, 1.0], (steps + 1, 1, 1))
        tools[:, 0, 2] -= 0.05 * rows
        infos["state"] = {"nodes": np.repeat(nodes[None], steps + 1, axis=0), "tools": tools}
    actions = np.zeros((steps, 3), dtype=np.float32)
    actions[:, 0] = np.arange(steps) / 10.0
    return Episode(
        observations=observations,
        actions=actions,
        rewards=np.full(steps, float(number + 1)),
        terminations=np.zeros(steps, dtype=np.bool_),
        truncations=np.arange(steps) == steps - 1,
        infos=infos,
        seed=10 + number,
        attributes={
            "operator": "human" if number == 1 else "scripted",
            "device": "made-up",
            "success": success,
            "engine": "bullet",
        },
    )


def made_up_env() -> Any:
    """Stands in for an environment, with all that a writer needs of it and no physics."""
    import gymnasium as gym

    return SimpleNamespace(
        spec=gym.spec("Spatula/Press-v0"),
        observation_space=spaces.Box(-1.0, 1.0, (4,), np.float32),
        action_space=spaces.Box(-1.0, 1.0, (3,), np.float32),
    )


def write_dataset(
    root: Path, dataset_id: str = ID, *, layout: Layout = LAYOUT, episodes: int = 3, nodes: Any = None
) -> Path:
    """Write made-up episodes as a dataset; returns its folder."""
    writer = DatasetWriter(dataset_id, made_up_env(), root=root, layout=layout, description="Made up.")
    for number in range(episodes):
        writer.add(make_episode(number, nodes=nodes))
    return writer.path
