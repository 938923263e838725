"""Demonstrations to learn from: episodes of scripted experts, or of data sets."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatula_env.definitions import present_options, tell_definition
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.learning.configuration import check_noise
from spatula_env.learning.evaluation import Plan
from spatula_env.learning.policies import ExpertPolicy, Policy, PolicySource, make_expert
from spatula_env.naming import registered_id
from spatula_env.policies import PartSelection

if TYPE_CHECKING:
    from stable_baselines3.common.buffers import ReplayBuffer
    from stable_baselines3.common.vec_env import VecEnv

NOISES = (0.3, 0.2, 0.1, 0.05, 0.02, 0.0)
"""Standard deviations that are tried when the noise is "auto", the greatest first."""

COPES = 0.9
"""An expert copes with a noise if at least this share of its episodes succeeds."""

TRIALS = 32
"""Number of episodes per trial."""

BURST, PAUSE = 8.0, 24.0
"""Mean lengths of bursts of noise and of the pauses between them [control steps]. A burst leads the expert astray;
afterwards it finds its way back, and the pauses are long enough to hold a goal for half a second."""

TRIAL_SEED = 3_000_000
"""Seed of the first trial, distinct from all episodes of training, evaluation and demonstration."""

EXPERT_MODES = ("state", "dict")
"""Observation modes that experts can use."""

FRUITLESS = 4
"""Demonstrating is given up after this multiple of the requested number of episodes."""


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One episode.

    Attributes:
        observations: (T + 1, ...), or a dictionary of such arrays.
        actions: (T, A) actions that the demonstrator wanted.
        carried: (T, A) actions that were carried out.
        rewards: (T,) rewards.
        success: Whether the goal was held.
    """

    observations: Any
    actions: NDArray[np.float32]
    carried: NDArray[np.float32]
    rewards: NDArray[np.float64]
    success: bool


class Collected(NamedTuple):
    """Result of collecting demonstrations.

    Attributes:
        episodes: The episodes that succeeded.
        noise: Standard deviation of their noise.
        steps: Number of control steps made for them, including failed episodes and trials of the noise.
    """

    episodes: list[Demonstration]
    noise: float
    steps: int


def greatest_noise(plan: Plan, *, num_envs: int = 32, steps: int | None = None) -> float:
    """Find the greatest noise that the scripted expert copes with.

    Noise makes the expert demonstrate the way back to its path, which a clone needs (M. Laskey et al., "DART: Noise
    Injection for Robust Imitation Learning", CoRL 2017). With too much noise the demonstrations fail; where that begins
    differs between tasks by a factor of ten.

    Args:
        plan: Environment and engine; its number of episodes and its seed are not used.
        num_envs: Number of worlds at once.
        steps: Length of an episode; None for the environment's own.

    Returns:
        One of `NOISES`: the first with which nine of ten trials succeed; 0 if there is none.
    """
    return _try_noises(plan, num_envs, steps)[0]


def _try_noises(plan: Plan, num_envs: int, steps: int | None) -> tuple[float, int]:
    """See `greatest_noise`; also returns the number of control steps made."""
    trial, made = replace(plan, episodes=TRIALS, seed=TRIAL_SEED), 0
    for noise in NOISES[:-1]:
        episodes = collect(trial, num_envs=num_envs, noise=noise, steps=steps)
        made += steps_of(episodes)
        if np.mean([episode.success for episode in episodes]) >= COPES:
            return noise, made
    return NOISES[-1], made


def steps_of(episodes: Sequence[Demonstration]) -> int:
    """Total number of control steps of some episodes."""
    return sum(len(episode.actions) for episode in episodes)


def collect_successes(
    plan: Plan,
    *,
    num_envs: int = 32,
    noise: float | str = "auto",
    parts: tuple[str, ...] | None = None,
    steps: int | None = None,
) -> Collected:
    """Collect demonstrations of the scripted expert until enough episodes have succeeded.

    Args:
        plan: Environment, engine and number of episodes.
        num_envs: Number of worlds at once.
        noise: See `collect`; "auto": see `greatest_noise`.
        parts: Parts of the observation that are recorded; None for all.
        steps: Length of an episode; None for the environment's own.

    Returns:
        The episodes, their noise, and the number of control steps made for them.

    Raises:
        ValueError: If the expert hardly ever succeeds.
    """
    check_noise(noise, "noise")
    sigma, made_steps = _try_noises(plan, num_envs, steps) if isinstance(noise, str) else (noise, 0)
    successes: list[Demonstration] = []
    made = 0
    while len(successes) < plan.episodes:
        if made >= FRUITLESS * plan.episodes:
            raise ValueError(
                f"noise must leave the expert a chance, got {sigma:g}: {len(successes)} of {made} episodes succeeded"
            )
        # Episodes are made in full rounds of all worlds.
        count = math.ceil((plan.episodes - len(successes)) / num_envs) * num_envs
        some = collect(
            replace(plan, episodes=count, seed=plan.seed + made),
            num_envs=num_envs,
            noise=sigma,
            parts=parts,
            steps=steps,
        )
        successes += [episode for episode in some if episode.success]
        made += count
        made_steps += steps_of(some)
    return Collected(successes[: plan.episodes], sigma, made_steps)


def collect(
    plan: Plan,
    *,
    num_envs: int = 32,
    noise: float = 0.0,
    parts: tuple[str, ...] | None = None,
    steps: int | None = None,
    driver: PolicySource | None = None,
) -> list[Demonstration]:
    """Collect demonstrations of the scripted expert.

    Args:
        plan: Environment, engine and number of episodes.
        num_envs: Number of worlds at once.
        noise: Standard deviation of the noise that is added, in bursts, to the actions carried out but not to those
            recorded as wanted; it leads the expert astray, so that its way back is demonstrated too.
        parts: Parts of the observation that are recorded; None for all.
        steps: Length of an episode; None for the environment's own.
        driver: Policy whose actions are carried out while the expert only says what it would do; None for the expert
            itself.

    Returns:
        The episodes, successful or not.

    Raises:
        ValueError: If there is no expert for the environment.
    """
    worlds = min(num_envs, plan.episodes)
    more = {} if steps is None else {"max_episode_steps": steps}
    env = plan.make(worlds, **more)
    demonstrations: list[Demonstration] = []
    # The expert uses the state, whatever the learner observes.
    seen_by_expert: SpatulaVectorEnv | None = None
    try:
        if env.settings.obs_mode not in EXPERT_MODES or env.settings.observation.parts != "all":
            seen_by_expert = plan.make(worlds, **more, obs_mode=EXPERT_MODES[0], observation=None)
        expert = ExpertPolicy(make_expert(env if seen_by_expert is None else seen_by_expert))
        leader = None if driver is None else driver.make(env)
        selection = PartSelection.of(env, parts)
        generator = np.random.default_rng([plan.seed, 2])
        for first in range(plan.seed, plan.seed + plan.episodes, worlds):
            demonstrations += _collect_round(
                env, seen_by_expert, expert, leader, list(range(first, first + worlds)), noise, generator, selection
            )
    finally:
        env.close()
        if seen_by_expert is not None:
            seen_by_expert.close()
    return demonstrations[: plan.episodes]


def _collect_round(
    env: SpatulaVectorEnv,
    seen_by_expert: SpatulaVectorEnv | None,
    expert: Policy,
    driver: Policy | None,
    seeds: list[int],
    noise: float,
    generator: np.random.Generator,
    selection: PartSelection | None,
) -> list[Demonstration]:
    """Run one episode in each world."""
    observation, _ = env.reset(seed=seeds)
    state = observation if seen_by_expert is None else seen_by_expert.reset(seed=seeds)[0]
    expert.begin(seeds)
    if driver is not None:
        driver.begin(seeds)
    seen, acted, done, rewarded = [_selected(observation, selection)], [], [], []
    lengths = np.zeros(len(seeds), dtype=np.int64)
    success = np.zeros(len(seeds), dtype=np.bool_)
    going = np.ones(len(seeds), dtype=np.bool_)
    burst = np.ones(len(seeds), dtype=np.bool_)
    while going.any():
        wanted = expert(state)
        astray = noise * burst[:, None] * generator.standard_normal(wanted.shape)
        leading = wanted if driver is None else driver(observation)
        carried = np.clip(leading + astray, -1.0, 1.0).astype(np.float32)
        burst ^= generator.random(len(seeds)) < np.where(burst, 1.0 / BURST, 1.0 / PAUSE)
        with warnings.catch_warnings():
            # An episode with diverged physics simply ends there.
            warnings.filterwarnings("ignore", "physics has diverged", RuntimeWarning)
            observation, rewards, terminated, truncated, infos = env.step(carried)
            state = observation if seen_by_expert is None else seen_by_expert.step(carried)[0]
        seen.append(_selected(observation, selection))
        acted.append(wanted)
        done.append(carried)
        rewarded.append(rewards)
        lengths += going
        success |= going & infos["is_success"]
        going &= ~(terminated | truncated)
    actions, moves, gains = np.stack(acted), np.stack(done), np.stack(rewarded)
    return [
        Demonstration(
            observations=_of_world(seen, world, int(length) + 1),
            actions=actions[:length, world],
            carried=moves[:length, world],
            rewards=gains[:length, world],
            success=bool(success[world]),
        )
        for world, length in enumerate(lengths.tolist())
    ]


def read_minari(
    name: str, parts: tuple[str, ...] | None = None, env: str | None = None
) -> tuple[list[Demonstration], str, dict[str, Any]]:
    """Read a Minari data set that was recorded in an environment of this package or built on it.

    A policy learnt from it acts in the bare environment, so observations and actions must be those of the bare
    environment.

    Args:
        name: Id of the data set.
        parts: Parts of the observation that are kept; None for all.
        env: Name of the environment as the user gives it; needed if its module has to be imported.

    Returns:
        The episodes, the environment's id, and its keyword arguments.

    Raises:
        ImportError: If the extra "data" is not installed.
        ValueError: If it was recorded elsewhere or does not say where, or with wrappers that change observations or
            actions.
    """
    dataset = _open_minari(name)
    env_id, kwargs, _ = recorded_in(name, env)
    made = Plan(env_id, kwargs, "batch", 1, 0).make(1)
    try:
        selection = PartSelection.of(made, parts)
    finally:
        made.close()
    demonstrations = [
        Demonstration(
            observations=_selected(episode.observations, selection),
            actions=np.asarray(episode.actions, dtype=np.float32),
            carried=np.asarray(episode.actions, dtype=np.float32),
            rewards=np.asarray(episode.rewards, dtype=np.float64),
            success=_has_succeeded(episode),
        )
        for episode in dataset.iterate_episodes()
    ]
    return demonstrations, env_id, kwargs


def recorded_in(name: str, env: str | None = None) -> tuple[str, dict[str, Any], int]:
    """Find out where a Minari data set was recorded.

    Args:
        name: Id of the data set.
        env: See `read_minari`.

    Returns:
        The environment's id, its keyword arguments except for the engine, and the number of episodes.

    Raises:
        ImportError: See `read_minari`.
        ValueError: See `read_minari`.
    """
    from spatula_env.data.dataset import read_layout

    dataset = _open_minari(name)
    spec = dataset.env_spec
    if spec is None:
        raise ValueError(f"dataset {name!r} does not say in which environment it was recorded")
    try:
        env_id = registered_id(spec.id, env)
    except ValueError as error:
        raise ValueError(f"dataset {name!r}: {error}") from error
    _check_wrappers(name)
    number = read_layout(name).definition_of(env_id)
    tell_definition(f"dataset {name!r}", env_id, number)
    kwargs = {key: value for key, value in spec.kwargs.items() if key != "engine"}
    return env_id, present_options(env_id, number, kwargs), int(dataset.total_episodes)


def _check_wrappers(name: str) -> None:
    """Check that no episode of a data set was recorded with wrappers that change observations or actions."""
    from spatula_env.data.replaying import recorded_specs
    from spatula_env.data.wrappers import is_neutral, is_of_gymnasium

    points = [each.entry_point for spec in recorded_specs(name) for each in spec.additional_wrappers]
    found = [point for point in dict.fromkeys(points) if not is_neutral(point)]
    if not found:
        return
    names = ", ".join(dict.fromkeys(point.partition(":")[2] or point for point in found))
    several = "s" if len(found) > 1 else ""
    verb = f"change{'' if several else 's'}" if all(map(is_of_gymnasium, found)) else "may change"
    raise ValueError(
        f"dataset {name!r} was recorded with the wrapper{several} {names}, which {verb} what is seen or done: a policy "
        "cannot be cloned from it"
    )


def _open_minari(name: str) -> Any:
    from spatula_env.data.replaying import open_dataset

    return open_dataset(name)


def fill_buffer(buffer: ReplayBuffer, env: VecEnv, demonstrations: list[Demonstration]) -> None:
    """Put demonstrations into a replay buffer, and update the normalisation with them.

    Args:
        buffer: Buffer for as many worlds as `env` has.
        env: Training environment, whose running estimates are updated if it normalises.
        demonstrations: Episodes of equal length; they are added in groups of one episode per world.

    Raises:
        ValueError: If their number is not a positive multiple of the number of worlds, or their lengths differ.
    """
    from stable_baselines3.common.vec_env import VecNormalize

    worlds = env.num_envs
    lengths = {len(each.actions) for each in demonstrations}
    if not demonstrations or len(demonstrations) % worlds or len(lengths) != 1:
        raise ValueError(
            f"demonstrations must be {worlds} of one length, or several times as many,"
            f" got {len(demonstrations)} of {sorted(lengths)} steps"
        )
    (length,) = lengths
    for first in range(0, len(demonstrations), worlds):
        group = demonstrations[first : first + worlds]
        for step in range(length):
            now = _stacked([_at(each.observations, step) for each in group])
            after = _stacked([_at(each.observations, step + 1) for each in group])
            # Mark the end as truncated, not terminated, as for a training episode that reaches its limit.
            last = step == length - 1
            infos: list[dict[str, Any]] = [{"TimeLimit.truncated": last} for _ in group]
            buffer.add(
                now,
                after,
                np.stack([each.carried[step] for each in group]),
                np.array([each.rewards[step] for each in group]),
                np.full(worlds, last),
                infos,
            )
            if isinstance(env, VecNormalize) and env.norm_obs:
                _learn_statistics(env, now)


def joined_observations(demonstrations: Sequence[Demonstration]) -> Any:
    """Observations before each action, of all demonstrations: (N, ...), or a dictionary of such arrays."""
    observations = [each.observations for each in demonstrations]
    if isinstance(observations[0], dict):
        return {key: np.concatenate([each[key][:-1] for each in observations]) for key in observations[0]}
    return np.concatenate([each[:-1] for each in observations])


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
