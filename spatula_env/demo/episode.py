"""One episode of a task, by a policy that the caller brings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

Policy = Callable[[Any], NDArray[np.float32]]
"""From observation to action."""

PolicyMaker = Callable[[gymnasium.Env[Any, Any]], Policy]
"""Makes a policy for an environment. To be called in another process it must be importable from a module."""

TASK = "Spatula/Press-v0"


@dataclass(frozen=True, eq=False)
class Episode:
    """What came of an episode.

    Attributes:
        task: The environment's id.
        seed: Of its reset.
        success: Whether the goal was reached and held.
        steps: Control steps.
        time: Simulated [s].
        total_reward: Sum of the rewards.
        goal_depth: Asked for [m].
        depth_error: At the end [m].
        peak_force: The greatest in the episode [N].
        frames: Pictures, evenly spaced.
        frame_time: Between two pictures [s].
    """

    task: str
    seed: int
    success: bool
    steps: int
    time: float
    total_reward: float
    goal_depth: float
    depth_error: float
    peak_force: float
    frames: tuple[NDArray[np.uint8], ...]
    frame_time: float

    def as_record(self) -> dict[str, Any]:
        """All but the pictures, as JSON has it."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "frames"}


def run_episode(make_policy: PolicyMaker, *, seed: int = 0, size: int = 360, stride: int = 2) -> Episode:
    """Run an episode until success or its time limit.

    Args:
        make_policy: Makes the policy.
        seed: Of the reset.
        size: Edge of the square pictures [pixels].
        stride: Control steps between two pictures.

    Returns:
        What came of it.
    """
    # The module's name before the colon makes Gymnasium import it, which registers the task.
    env = gymnasium.make(
        f"spatula_env:{TASK}", render_mode="rgb_array", width=size, height=size, terminate_on_success=True
    )
    try:
        policy = make_policy(env)
        observation, info = env.reset(seed=seed)
        frames = [_picture(env)]
        total, peak, steps, ended = 0.0, 0.0, 0, False
        while not ended:
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            total += float(reward)
            peak = max(peak, float(info["peak_force"]))
            steps += 1
            ended = terminated or truncated
            if steps % stride == 0 or ended:
                frames.append(_picture(env))
        goal = env.unwrapped.goal  # type: ignore[attr-defined]
        return Episode(
            task=TASK,
            seed=seed,
            success=bool(info["is_success"]),
            steps=steps,
            time=float(info["time"]),
            total_reward=total,
            goal_depth=float(goal[2]),
            depth_error=float(info["depth_error"]),
            peak_force=peak,
            frames=tuple(frames),
            frame_time=stride / float(env.metadata["render_fps"]),
        )
    finally:
        env.close()


def _picture(env: gymnasium.Env[Any, Any]) -> NDArray[np.uint8]:
    picture = env.render()
    if not isinstance(picture, np.ndarray):
        raise TypeError(f"render() must return an array with render_mode='rgb_array', got {type(picture).__name__}")
    return picture.copy()
