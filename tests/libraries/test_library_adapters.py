"""Adapters that need their library: their results agree with the environment's, world by world."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env

assert spatula_env.TASKS
ID = "Spatula/Press-v0"
DOWN = np.tile(np.float32([0.0, 0.0, -1.0]), (3, 1))


def reference(steps: int, **kwargs: Any) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Observations (steps + 1), rewards and costs of three worlds that press down, seeded with 5."""
    envs = gym.make_vec(ID, num_envs=3, autoreset_mode="disabled", **kwargs)
    seen, rewards, costs = [envs.reset(seed=5)[0]], [], []
    for _ in range(steps):
        observations, reward, _, _, infos = envs.step(DOWN)
        seen.append(observations)
        rewards.append(reward)
        costs.append(infos["cost"])
    envs.close()
    return seen, rewards, costs


@pytest.mark.libraries("rl_games")
def test_rl_games_is_told_what_was_cut_and_what_succeeded() -> None:
    from spatula_env.envs.adapters.rl_games import RlGamesVecEnv

    seen, rewards, _ = reference(4, max_episode_steps=4)
    envs = RlGamesVecEnv(3, ID, seed=5, max_episode_steps=4)
    assert envs.get_env_info()["action_space"].shape == (3,)
    np.testing.assert_array_equal(envs.reset(), seen[0])
    for t in range(4):
        observations, reward, dones, infos = envs.step(DOWN)
        np.testing.assert_allclose(reward, rewards[t], rtol=1e-6)
        assert reward.dtype == np.float32
        np.testing.assert_array_equal(infos["time_outs"], np.full(3, t == 3))
        np.testing.assert_array_equal(dones, np.full(3, t == 3))
        np.testing.assert_array_equal(infos["scores"], np.zeros(3))
    # What follows is the next episode.
    assert not np.array_equal(observations, seen[4])
    envs.close()


@pytest.mark.libraries("rl_games")
def test_rl_games_takes_damage_for_an_end_and_not_for_a_cut() -> None:
    from spatula_env.envs.adapters.rl_games import RlGamesVecEnv

    envs = RlGamesVecEnv(3, ID, seed=5, damage_limit=1.0)
    envs.reset()
    for _ in range(30):
        _, _, dones, infos = envs.step(DOWN)
        assert not infos["time_outs"].any()
        if dones.any():
            break
    assert dones.any()
    envs.close()


@pytest.mark.libraries("tianshou")
def test_tianshou_steps_and_resets_some_worlds() -> None:
    from spatula_env.envs.adapters.tianshou import TianshouVectorEnv

    seen, rewards, costs = reference(4, max_episode_steps=4)
    envs = TianshouVectorEnv(ID, 3, max_episode_steps=4)
    assert len(envs) == 3
    assert len(envs.action_space) == 3
    assert envs.seed(5) == [5, 6, 7]
    observations, infos = envs.reset()
    np.testing.assert_array_equal(observations, seen[0])
    for t in range(4):
        observations, reward, _, truncated, infos = envs.step(DOWN)
        np.testing.assert_array_equal(observations, seen[t + 1])
        np.testing.assert_array_equal(reward, rewards[t])
        np.testing.assert_array_equal([info["cost"] for info in infos], costs[t])
        np.testing.assert_array_equal([info["env_id"] for info in infos], range(3))
    assert truncated.all()
    with pytest.raises(RuntimeError, match=r"worlds \[0, 1, 2\] are over: reset them first"):
        envs.step(DOWN)
    observations, infos = envs.reset([0, 2])
    assert observations.shape == (2, *seen[0].shape[1:])
    observations, *_, infos = envs.step(DOWN[:2], [0, 2])
    np.testing.assert_array_equal([info["env_id"] for info in infos], [0, 2])
    with pytest.raises(RuntimeError, match=r"worlds \[1\] are over"):
        envs.step(DOWN)
    envs.reset(1)
    envs.step(DOWN[:1], [0])
    with pytest.raises(RuntimeError, match=r"worlds \[1, 2\] went on while others were stepped: reset them first"):
        envs.step(DOWN)
    envs.close()
    assert envs.is_closed


@pytest.mark.libraries("tianshou")
def test_tianshou_shares_attributes_and_refuses_to_set_them() -> None:
    from spatula_env.envs.adapters.tianshou import TianshouVectorEnv

    envs = TianshouVectorEnv(ID, 2)
    with pytest.raises(RuntimeError, match="reset all worlds before some of them"):
        envs.reset([0])
    assert envs.observation_space[0].shape == (71,)
    with pytest.raises(AttributeError, match="'goal' cannot be set for single worlds"):
        envs.set_env_attr("goal", 1.0)
    envs.close()


@pytest.mark.libraries("omnisafe")
@pytest.mark.parametrize("worlds", [1, 3])
def test_omnisafe_gets_the_costs_of_the_step_that_was_taken(worlds: int) -> None:
    import torch

    from spatula_env.envs.adapters.omnisafe import SpatulaCMDP

    seen, rewards, costs = reference(12, max_episode_steps=12)
    env = SpatulaCMDP(ID, num_envs=worlds, cost_scale=0.5, max_episode_steps=12)
    assert env.max_episode_steps == 12
    assert ID in SpatulaCMDP.support_envs()
    observation, _ = env.reset(seed=5)
    rows: Any = slice(worlds) if worlds > 1 else 0
    np.testing.assert_array_equal(observation, seen[0][rows])
    for t in range(12):
        observation, reward, cost, terminated, truncated, info = env.step(torch.as_tensor(DOWN[rows]))
        assert {each.dtype for each in (observation, reward, cost, terminated, truncated)} == {torch.float32}
        np.testing.assert_allclose(reward, rewards[t][rows], rtol=1e-6)
        np.testing.assert_allclose(cost, 0.5 * costs[t][rows], rtol=1e-6)
    assert bool(truncated.all())
    assert bool((cost > 0).all())
    np.testing.assert_array_equal(info["final_observation"], seen[12][rows])
    assert env.env_spec_log == {"Env/Success": 0.0}
    env.close()


@pytest.mark.libraries("omnisafe")
def test_omnisafe_refuses_what_is_no_vector() -> None:
    from spatula_env.envs.adapters.omnisafe import SpatulaCMDP

    with pytest.raises(ValueError, match="observations that are one vector"):
        SpatulaCMDP(ID, reward="sparse")
    with pytest.raises(ValueError, match="cost_scale must be positive"):
        SpatulaCMDP(ID, cost_scale=-1.0)


@pytest.mark.libraries("torchrl")
def test_torchrl_reads_the_costs_of_the_step_that_was_taken() -> None:
    import torch
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    _, _, costs = reference(12, max_episode_steps=12)
    envs = GymWrapper(gym.make_vec(ID, num_envs=3, autoreset_mode="same_step", max_episode_steps=12))
    check_env_specs(envs)
    rollout = envs.rollout(24, lambda td: td.set("action", torch.as_tensor(DOWN)), break_when_any_done=False)
    cost, done = rollout["next", "cost"], rollout["next", "done"][..., 0]
    assert cost.shape == (3, 24)
    assert done[:, 11].all() and done[:, 23].all() and done.sum() == 6
    # Another seed than that of the reference, but the same press: pressures at an episode's end are no zeros.
    assert (cost[:, [11, 23]] > 0.1 * costs[-1].mean()).all()
    np.testing.assert_allclose(cost[:, :12].sum(dim=1), rollout["next", "episode_cost"][:, 11])
    envs.close()


@pytest.mark.libraries("torchrl")
def test_torchrl_makes_an_environment_by_its_id() -> None:
    from torchrl.envs import GymEnv

    env = GymEnv(ID, engine="batch")
    assert env.rollout(3).shape == (3,)
    env.close()


@pytest.mark.libraries("torchrl")
def test_torchrl_refuses_next_step_autoreset() -> None:
    from torchrl.envs import GymWrapper

    envs = gym.make_vec(ID, num_envs=2)
    with pytest.raises(Exception, match=r"(?i)autoreset"):
        GymWrapper(envs)
    envs.close()


@pytest.mark.libraries("skrl")
def test_skrl_recognises_one_and_many() -> None:
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.envs.wrappers.torch.gymnasium_envs import GymnasiumWrapper

    for env, count in ((gym.make(ID, engine="batch"), 1), (gym.make_vec(ID, num_envs=3), 3)):
        wrapped = wrap_env(env)
        assert isinstance(wrapped, GymnasiumWrapper)
        assert wrapped.num_envs == count
        wrapped.close()


@pytest.mark.libraries("masa")
def test_masa_reads_the_labels() -> None:
    from masa.common.constraints.cmdp import CumulativeCostEnv
    from masa.common.labelled_env import LabelledEnv

    from spatula_env.envs.adapters.masa import LabelsWrapper

    labelled = LabelsWrapper(gym.make(ID, engine="batch", max_episode_steps=14))
    env = CumulativeCostEnv(
        LabelledEnv(labelled, labelled.label_fn), cost_fn=lambda labels: float("violation" in labels), budget=0.0
    )
    env.reset(seed=5)
    violations, truncated = 0, False
    while not truncated:
        *_, truncated, info = env.step(DOWN[0])
        violations += info["violation"]
    assert violations > 0
    assert env.constraint_episode_metrics() == {"cum_cost": violations, "satisfied": 0.0}
    env.close()
