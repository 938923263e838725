"""Episodes of scripted experts, and of data sets, to learn from."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agents.evaluation import Plan
from agents.parts import PartSelection
from agents.policies import Policy, find_policy

if TYPE_CHECKING:
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecEnv


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One episode.

    Attributes:
        observations: (T + 1, ...), or a dictionary of such arrays.
        actions: (T, A) what the demonstrator wanted.
        rewards: (T,).
        success: Whether the goal was held.
    """

    observations: Any
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    success: bool


def collect(
    plan: Plan,
    *,
    num_envs: int = 32,
    noise: float = 0.0,
    parts: tuple[str, ...] | None = None,
    steps: int | None = None,
) -> list[Demonstration]:
    """Let the scripted expert demonstrate.

    Args:
        plan: Where, and how many episodes.
        num_envs: How many worlds at once.
        noise: Standard deviation of what is added to the actions that are carried out, not to those that are recorded;
            it leads the expert astray, so that its way back is demonstrated too.
        parts: Of the observation that are recorded; None: all.
        steps: Length of an episode; None: the environment's.

    Returns:
        The episodes, successful or not.

    Raises:
        ValueError: If there is no expert for the environment.
    """
    worlds = min(num_envs, plan.episodes)
    env = plan.make(worlds, **({} if steps is None else {"max_episode_steps": steps}))
    demonstrations: list[Demonstration] = []
    try:
        expert = find_policy("expert", plan.env_id).make(env)
        selection = PartSelection.of(env, parts)
        generator = np.random.default_rng([plan.seed, 2])
        for first in range(plan.seed, plan.seed + plan.episodes, worlds):
            demonstrations += _collect_round(
                env, expert, list(range(first, first + worlds)), noise, generator, selection
            )
    finally:
        env.close()
    return demonstrations[: plan.episodes]


def _collect_round(
    env: Any,
    expert: Policy,
    seeds: list[int],
    noise: float,
    generator: np.random.Generator,
    selection: PartSelection | None,
) -> list[Demonstration]:
    """One episode in each world."""
    observation, _ = env.reset(seed=seeds)
    expert.begin(seeds)
    seen, acted, rewarded = [_selected(observation, selection)], [], []
    lengths = np.zeros(len(seeds), dtype=np.int64)
    success = np.zeros(len(seeds), dtype=np.bool_)
    going = np.ones(len(seeds), dtype=np.bool_)
    while going.any():
        wanted = expert(observation)
        carried = wanted if noise == 0.0 else wanted + noise * generator.standard_normal(wanted.shape)
        with warnings.catch_warnings():
            # A broken episode simply ends there.
            warnings.filterwarnings("ignore", "physics has diverged", RuntimeWarning)
            observation, rewards, terminated, truncated, infos = env.step(np.clip(carried, -1.0, 1.0))
        seen.append(_selected(observation, selection))
        acted.append(wanted)
        rewarded.append(rewards)
        lengths += going
        success |= going & infos["is_success"]
        going &= ~(terminated | truncated)
    actions, gains = np.stack(acted), np.stack(rewarded)
    return [
        Demonstration(
            observations=_of_world(seen, world, int(length) + 1),
            actions=actions[:length, world],
            rewards=gains[:length, world],
            success=bool(success[world]),
        )
        for world, length in enumerate(lengths.tolist())
    ]


def read_minari(name: str, parts: tuple[str, ...] | None = None) -> tuple[list[Demonstration], str, dict[str, Any]]:
    """Read a Minari data set, recorded in an environment of this package.

    Args:
        name: Its id.
        parts: Of the observation that are kept; None: all.

    Returns:
        The episodes, the environment's id, and its keyword arguments.

    Raises:
        ImportError: If the extra "data" is not installed.
        ValueError: If it was recorded elsewhere, or does not say where.
    """
    try:
        import minari
    except ImportError as error:
        raise ImportError("data sets need Minari: pip install 'spatula-env[data]'", name=error.name) from error
    dataset = minari.load_dataset(name)
    spec = dataset.env_spec
    if spec is None:
        raise ValueError(f"dataset {name!r} does not say in which environment it was recorded")
    plan = Plan(spec.id, spec.kwargs, "batch", 1, 0)
    env = plan.make(1)
    try:
        selection = PartSelection.of(env, parts)
    finally:
        env.close()
    demonstrations = [
        Demonstration(
            observations=_selected(episode.observations, selection),
            actions=np.asarray(episode.actions, dtype=np.float32),
            rewards=np.asarray(episode.rewards, dtype=np.float64),
            success=_has_succeeded(episode),
        )
        for episode in dataset.iterate_episodes()
    ]
    return demonstrations, spec.id, {key: value for key, value in spec.kwargs.items() if key != "engine"}


def fill_buffer(model: OffPolicyAlgorithm, env: VecEnv, demonstrations: list[Demonstration], rounds: int) -> None:
    """Put demonstrations into a replay buffer, and let the normalisation know them.

    Args:
        model: Whose buffer.
        env: What it trains in, whose running estimates are updated if it normalises.
        demonstrations: Of the same length each; a transition of each world goes into the buffer at a time.
        rounds: How many episodes each world has: there are as many demonstrations as worlds, times this.

    Raises:
        ValueError: If there are fewer, or their lengths differ.
    """
    from stable_baselines3.common.vec_env import VecNormalize

    worlds = env.num_envs
    lengths = {len(each.actions) for each in demonstrations}
    if len(demonstrations) != worlds * rounds or len(lengths) != 1:
        raise ValueError(
            f"demonstrations must be {worlds * rounds} of one length,"
            f" got {len(demonstrations)} of {sorted(lengths)} steps"
        )
    buffer = model.replay_buffer
    assert buffer is not None
    (length,) = lengths
    for first in range(0, len(demonstrations), worlds):
        group = demonstrations[first : first + worlds]
        for step in range(length):
            now = _stacked([_at(each.observations, step) for each in group])
            after = _stacked([_at(each.observations, step + 1) for each in group])
            # Cut, not ended: as an episode of training that reaches its limit.
            last = step == length - 1
            infos: list[dict[str, Any]] = [{"TimeLimit.truncated": last} for _ in group]
            buffer.add(
                now,
                after,
                np.stack([each.actions[step] for each in group]),
                np.array([each.rewards[step] for each in group]),
                np.full(worlds, last),
                infos,
            )
            if isinstance(env, VecNormalize) and env.norm_obs:
                _learn_statistics(env, now)


def _learn_statistics(env: Any, observation: Any) -> None:
    if isinstance(observation, dict):
        for key, values in observation.items():
            env.obs_rms[key].update(values)
    else:
        env.obs_rms.update(observation)


def _has_succeeded(episode: Any) -> bool:
    infos = episode.infos
    if isinstance(infos, dict) and "is_success" in infos:
        return bool(np.asarray(infos["is_success"]).any())
    return True


def _selected(observation: Any, selection: PartSelection | None) -> Any:
    chosen = observation if selection is None else selection(observation)
    return {key: np.array(values) for key, values in chosen.items()} if isinstance(chosen, dict) else np.array(chosen)


def _of_world(frames: list[Any], world: int, count: int) -> Any:
    if isinstance(frames[0], dict):
        return {key: np.stack([frame[key][world] for frame in frames[:count]]) for key in frames[0]}
    return np.stack([frame[world] for frame in frames[:count]])


def _at(observations: Any, step: int) -> Any:
    return (
        {key: values[step] for key, values in observations.items()}
        if isinstance(observations, dict)
        else observations[step]
    )


def _stacked(observations: list[Any]) -> Any:
    if isinstance(observations[0], dict):
        return {key: np.stack([each[key] for each in observations]) for key in observations[0]}
    return np.stack(observations)
