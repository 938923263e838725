"""Running episodes of an operator at a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from spatula_env.teleop.buttons import DISCARD, FINISH, QUIT
from spatula_env.teleop.device import TeleopDevice
from spatula_env.teleop.wrapper import FalconTeleop

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.data.episode import EpisodeRecorder


@dataclass(frozen=True)
class EpisodeSummary:
    """Result of an episode.

    Attributes:
        steps: Number of control steps.
        seed: Seed of the reset.
        success: Whether the goal was reached.
        total_reward: Sum of the rewards.
        peak_force: Greatest force on a tool [N].
        operator_share: Share of the steps in which the operator acted rather than a policy.
        kept: False if the operator discarded it.
        quit: Whether the operator wants to end the session.
    """

    steps: int
    seed: int | None
    success: bool
    total_reward: float
    peak_force: float
    operator_share: float
    kept: bool = True
    quit: bool = False


def run_episode(
    env: FalconTeleop,
    *,
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    policy: Callable[[Any], Any] | None = None,
    recorder: EpisodeRecorder | None = None,
    end_on_success: bool = False,
    after_step: Callable[[Any, dict[str, Any]], None] | None = None,
) -> EpisodeSummary:
    """Run one episode with the operator.

    It ends when the environment says so, or with the buttons "finish", "discard" and "quit".

    Args:
        env: The environment with its device.
        seed: Seed of the reset.
        options: Options of the reset.
        policy: Acts while the operator does not.
        recorder: Records the episode; the caller finishes the recorded episode.
        end_on_success: Whether reaching the goal ends the episode.
        after_step: Called with observation and info after the reset and every step.

    Returns:
        Result of the episode.

    Raises:
        DeviceLost: If the device does not answer any more. The recorder holds the episode up to that point.
    """
    chosen = None if options is None else dict(options)
    observation, info = env.reset(seed=seed, options=chosen)
    if recorder is not None:
        recorder.begin(observation, info, seed, options)
    if after_step is not None:
        after_step(observation, info)
    steps, total, operated = 0, 0.0, 0
    held_before = env.pressed
    ended = ""
    done = False
    while not done:
        action = None if policy is None else policy(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        steps += 1
        total += float(reward)
        operated += info["acted_by"] != "policy"
        if recorder is not None:
            recorder.add(info["action"], observation, float(reward), terminated, truncated, info)
        if after_step is not None:
            after_step(observation, info)
        # Only presses within this episode count: the button that ended the last one may still be held.
        held_before &= env.pressed
        ended = next((name for name in (QUIT, DISCARD, FINISH) if name in env.pressed - held_before), "")
        done = terminated or truncated or bool(ended) or (end_on_success and info["is_success"])
    env.let_go()
    return EpisodeSummary(
        steps=steps,
        seed=seed,
        success=bool(info["is_success"]),
        total_reward=total,
        peak_force=float(info["episode_peak_force"]),
        operator_share=operated / steps,
        kept=ended not in (DISCARD, QUIT),
        quit=ended == QUIT,
    )


def play(
    env: gymnasium.Env[Any, Any],
    device: TeleopDevice,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    policy: Callable[[Any], Any] | None = None,
    end_on_success: bool = False,
    progress: Callable[[EpisodeSummary], None] | None = None,
    after_step: Callable[[Any, dict[str, Any]], None] | None = None,
    **teleop: Any,
) -> list[EpisodeSummary]:
    """Let an operator play, without recording.

    Args:
        env: One of the Spatula environments, from `gymnasium.make`, for one agent.
        device: The operator's device, open and calibrated.
        episodes: Number of episodes; None to continue until the button "quit".
        seed: Seed of the first episode; increases by one for each further one.
        policy: Acts while the operator does not.
        end_on_success: Whether reaching the goal ends an episode.
        progress: Called after each episode.
        after_step: Called with observation and info after every reset and step.
        **teleop: Arguments for `FalconTeleop`: mode, intervention ….

    Returns:
        Results of the episodes.

    Raises:
        ValueError: If a number is out of range.
        DeviceLost: If the device does not answer any more.
    """
    if episodes is not None and episodes < 1:
        raise ValueError(f"episodes must be None, or 1 or more, got {episodes!r}")
    wrapped = FalconTeleop(env, device, **teleop)
    summaries: list[EpisodeSummary] = []
    while episodes is None or len(summaries) < episodes:
        summary = run_episode(
            wrapped,
            seed=None if seed is None else seed + len(summaries),
            policy=policy,
            end_on_success=end_on_success,
            after_step=after_step,
        )
        summaries.append(summary)
        if progress is not None:
            progress(summary)
        if summary.quit:
            break
    return summaries
