"""One episode of a task, by the policy that comes with the package or one that the caller brings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spatula_env.policies import describe_provenance, load_pretrained, pretrained_path, read_provenance

Policy = Callable[[Any], NDArray[np.float32]]
"""From observation to action."""

PolicyMaker = Callable[[gymnasium.Env[Any, Any]], Policy]
"""Makes a policy for an environment. To be called in another process it must be importable from a module."""

TASK = "Spatula/Press-v0"


@dataclass(frozen=True)
class Actor:
    """Who acts.

    Attributes:
        name: For people.
        origin: Where the policy comes from, for people.
        make: Makes the policy.
        options: What the environment must be made with for it.
    """

    name: str
    origin: str
    make: PolicyMaker
    options: Mapping[str, Any] = field(default_factory=dict)


def trained_actor() -> Actor:
    """The policy for the task that comes with the package.

    Raises:
        FileNotFoundError: If there is none.
    """
    policy, origin = load_pretrained(TASK), describe_provenance(read_provenance(pretrained_path(TASK)))
    return Actor("trained policy", origin, _make_trained, dict(policy.metadata.get("env_kwargs", {})))


def _make_trained(env: gymnasium.Env[Any, Any]) -> Policy:
    return load_pretrained(TASK).bound_to(env)


@dataclass(frozen=True, eq=False)
class Frame:
    """A moment of an episode.

    Attributes:
        picture: (height, width, 3).
        time: Simulated [s].
        depth: Of the organ's surface below its place at rest, under the goal [m].
        force: On the spatula [N].
    """

    picture: NDArray[np.uint8]
    time: float
    depth: float
    force: float


@dataclass(frozen=True, eq=False)
class Episode:
    """The result of an episode.

    Attributes:
        task: The environment's id.
        policy: Who acted, for people.
        origin: Where the policy comes from, for people.
        seed: Of its reset.
        success: Whether the goal was reached and held.
        steps: Control steps.
        time: Simulated [s].
        total_reward: Sum of the rewards.
        goal_depth: Asked for [m].
        depth_error: At the end [m].
        peak_force: The greatest in the episode [N].
        frames: Evenly spaced.
        frame_time: Between two pictures [s].
    """

    task: str
    policy: str
    origin: str
    seed: int
    success: bool
    steps: int
    time: float
    total_reward: float
    goal_depth: float
    depth_error: float
    peak_force: float
    frames: tuple[Frame, ...]
    frame_time: float

    def as_record(self) -> dict[str, Any]:
        """All but the pictures, as JSON has it."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "frames"}


def run_episode(actor: Actor, *, seed: int = 0, size: int = 360, stride: int = 2) -> Episode:
    """Run an episode until success or its time limit.

    Args:
        actor: Who acts.
        seed: Of the reset.
        size: Edge of the square pictures [pixels].
        stride: Control steps between two pictures.

    Returns:
        The result.
    """
    # The module's name before the colon makes Gymnasium import it, which registers the task.
    env = gymnasium.make(
        f"spatula_env:{TASK}",
        render_mode="rgb_array",
        width=size,
        height=size,
        terminate_on_success=True,
        **actor.options,
    )
    try:
        policy = actor.make(env)
        observation, info = env.reset(seed=seed)
        frames = [_frame(env, info)]
        total, peak, steps, ended = 0.0, 0.0, 0, False
        while not ended:
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            total += float(reward)
            peak = max(peak, float(info["peak_force"]))
            steps += 1
            ended = terminated or truncated
            if steps % stride == 0 or ended:
                frames.append(_frame(env, info))
        goal = env.get_wrapper_attr("goal")
        return Episode(
            task=TASK,
            policy=actor.name,
            origin=actor.origin,
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


def _frame(env: gymnasium.Env[Any, Any], info: Mapping[str, Any]) -> Frame:
    picture = env.render()
    if not isinstance(picture, np.ndarray):
        raise TypeError(f"render() must return an array with render_mode='rgb_array', got {type(picture).__name__}")
    return Frame(picture.copy(), float(info["time"]), float(info["depth"]), float(info["force"]))
