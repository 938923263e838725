from __future__ import annotations

import dataclasses
import json
import warnings
from functools import partial

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from spatula_env.learning import cloning, demonstrations
from spatula_env.learning.cloning import clone
from spatula_env.learning.commands.clone import main
from spatula_env.learning.configuration import training_from_mapping
from spatula_env.learning.demonstrations import (
    Demonstration,
    collect,
    collect_successes,
    fill_buffer,
    greatest_noise,
    read_minari,
)
from spatula_env.learning.evaluation import Plan, evaluate
from spatula_env.learning.export import export_policy
from spatula_env.learning.finding import find_policy
from spatula_env.learning.imitation import CloneConfig, calm_down
from spatula_env.learning.policies import make_expert

PRESS = "Spatula/Press-v0"


def config(algorithm="sac", **environment):
    return training_from_mapping(
        {
            "environment": {"id": PRESS, "parts": ["error", "tool_position"], **environment},
            "algorithm": algorithm,
            "hyperparameters": {"buffer_size": 1} if algorithm != "ppo" else {"n_steps": 2, "batch_size": 2},
            "network": {"layers": [32]},
        }
    )


def steering(count=3, steps=40, seed=0):
    """Demonstrations of a simple rule: back to the middle, which actions say exactly."""
    generator = np.random.default_rng(seed)
    for _ in range(count):
        seen = generator.uniform(-0.05, 0.05, (steps + 1, 6)).astype(np.float32)
        actions = np.clip(-15.0 * seen[:-1, :3], -1, 1)
        yield Demonstration(seen, actions, actions, np.zeros(steps), True)


@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_a_simple_rule_is_imitated(algorithm):
    model, normalizer, losses = clone(config(algorithm), list(steering()), CloneConfig(gradient_steps=600))
    assert losses[-1] < 0.02 < losses[0]
    (fresh,) = steering(1, seed=9)
    policy = export_policy(model, normalizer)
    assert np.abs(policy(fresh.observations[:-1]) - fresh.actions).mean() < 0.15


def test_nothing_cannot_be_imitated():
    with pytest.raises(ValueError, match="demonstrations must be one at least"):
        clone(config(), [], CloneConfig())
    with pytest.raises(ValueError, match="gradient_steps must be 1 or more"):
        CloneConfig(gradient_steps=0)


def test_experts_demonstrate_what_they_would_do():
    plan = Plan(PRESS, {"max_episode_steps": 6}, "batch", 3, 7)
    whole = collect(plan, num_envs=2)
    env = plan.make(1)
    expert = make_expert(env)
    env.close()
    assert len(whole) == 3
    for each in whole:
        assert each.observations.shape == (7, 71)
        np.testing.assert_array_equal(expert(each.observations[:-1]), each.actions)
    # Chance moves the tool, and the record still says what the expert wanted.
    astray = collect(plan, num_envs=2, noise=0.5)
    assert np.abs(astray[0].observations[-1, :3] - whole[0].observations[-1, :3]).max() > 1e-4
    np.testing.assert_array_equal(expert(astray[0].observations[:-1]), astray[0].actions)
    assert np.abs(astray[0].carried - astray[0].actions).max() > 0.1
    np.testing.assert_array_equal(whole[0].carried, whole[0].actions)
    np.testing.assert_array_equal(astray[0].observations[0], whole[0].observations[0])
    # A driver goes its own way, and the record says what the expert would have done there.
    driven = collect(plan, num_envs=2, driver=find_policy("random", PRESS))
    np.testing.assert_array_equal(expert(driven[0].observations[:-1]), driven[0].actions)
    assert np.abs(driven[0].carried - driven[0].actions).max() > 0.1
    np.testing.assert_array_equal(driven[0].observations[0], whole[0].observations[0])
    some = collect(plan, num_envs=2, parts=("error",), steps=4)
    np.testing.assert_array_equal(some[0].observations, whole[0].observations[:5, -4:-1])


def test_demonstrations_must_fit_the_buffer():
    class Worlds:
        num_envs = 2

    short, long = (next(steering(1, steps)) for steps in (3, 4))
    for given in ([short], [short, long]):
        with pytest.raises(ValueError, match="demonstrations must be 2 of one length"):
            fill_buffer(None, Worlds(), given)


class Unsteady:
    """Stands in for `collect`: succeeds while noise is not above a limit, and then in every second episode."""

    def __init__(self, limit):
        self.limit, self.asked = limit, []

    def __call__(self, plan, *, num_envs=32, noise=0.0, parts=None, steps=None):
        self.asked.append((noise, plan.episodes, plan.seed))
        nothing, three = np.zeros(0), np.zeros((3, 1))
        return [
            Demonstration(nothing, three, three, np.array([plan.seed + k]), noise <= self.limit or k % 2 == 0)
            for k in range(plan.episodes)
        ]


def test_noise_is_the_greatest_that_the_expert_copes_with(monkeypatch):
    plan = Plan(PRESS, {}, "batch", 5, 7)
    for limit, expected in ((1.0, 0.3), (0.15, 0.1), (-1.0, 0.0)):
        unsteady = Unsteady(limit)
        monkeypatch.setattr(demonstrations, "collect", unsteady)
        assert greatest_noise(plan) == expected
        assert all(seed >= demonstrations.TRIAL_SEED for _, _, seed in unsteady.asked)


def test_what_fails_is_not_a_demonstration(monkeypatch):
    unsteady = Unsteady(0.0)
    monkeypatch.setattr(demonstrations, "collect", unsteady)
    found, noise, steps = collect_successes(Plan(PRESS, {}, "batch", 5, 7), num_envs=4, noise=0.2)
    assert (len(found), noise) == (5, 0.2)
    # Three for each of the twelve that were made.
    assert steps == 36
    tried = Unsteady(0.15)
    monkeypatch.setattr(demonstrations, "collect", tried)
    _, noise, steps = collect_successes(Plan(PRESS, {}, "batch", 4, 7), num_envs=4)
    assert (noise, steps) == (0.1, 3 * (3 * demonstrations.TRIALS + 4))
    monkeypatch.setattr(demonstrations, "collect", unsteady)
    assert all(each.success for each in found)
    # Eight for five, of which four succeed, then four more for the last.
    assert unsteady.asked == [(0.2, 8, 7), (0.2, 4, 15)]
    assert [float(each.rewards[0]) for each in found] == [7, 9, 11, 13, 15]
    monkeypatch.setattr(demonstrations, "collect", lambda plan, **_: [])
    with pytest.raises(ValueError, match=r"noise must leave the expert a chance, got 0.2: 0 of 20 episodes"):
        collect_successes(Plan(PRESS, {}, "batch", 5, 7), num_envs=5, noise=0.2)
    with pytest.raises(ValueError, match="noise must be a number from 0 on or 'auto', got 'much'"):
        collect_successes(Plan(PRESS, {}, "batch", 5, 7), noise="much")


def test_noise_comes_in_bursts():
    (whole,) = collect(Plan(PRESS, {}, "batch", 1, 7), noise=0.3)
    astray = np.abs(whole.carried - whole.actions).max(axis=1) > 0.0
    assert 0.03 < astray.mean() < 0.7
    # Most steps follow one of the same kind.
    assert (astray[1:] == astray[:-1]).mean() > 0.7


def test_an_actor_that_has_imitated_explores_little():
    model, _, _ = clone(config(), list(steering()), CloneConfig(gradient_steps=1))
    calm_down(model)
    import torch

    _, log_std, _ = model.policy.actor.get_action_dist_params(torch.randn(5, 6))
    np.testing.assert_allclose(log_std.exp().detach(), 0.2, rtol=1e-5)


def test_a_clone_of_the_expert_is_better_than_chance(tmp_path, capsys, monkeypatch):
    # By then the expert has pressed.
    monkeypatch.setattr(demonstrations, "collect_successes", partial(collect_successes, num_envs=6, steps=60))
    monkeypatch.setattr(cloning, "collect", partial(collect, steps=60))
    file = tmp_path / "press_sac.yaml"
    file.write_text(
        f"environment: {{id: {PRESS}, parts: [tool_position, contact_force, contact_depth, error, goal]}}\n"
        "algorithm: sac\nhyperparameters: {buffer_size: 1}\nnetwork: {layers: [64, 64]}\n"
    )
    arguments = ["--config", str(file), "--expert", "6", "--gradient-steps", "1500", "--output", str(tmp_path / "run")]
    assert main([*arguments, "--rounds", "1", "--noise", "0.1"]) == 0
    told = capsys.readouterr().out
    assert "6 demonstrations" in told
    assert "round 1: " in told
    origin = json.loads((tmp_path / "run" / "provenance.json").read_text())
    assert origin["demonstrations"]["episodes"] == 6
    (corrected,) = origin["rounds"]
    assert corrected["episodes"] == 6
    # What was said in the policy's own episodes is imitated as well.
    assert corrected["losses"][-1] < corrected["losses"][0]
    plan = Plan(PRESS, {"max_episode_steps": 60}, "batch", 8, 50)
    cloned, _ = evaluate(find_policy(str(tmp_path / "run"), PRESS), plan)
    chance, _ = evaluate(find_policy("random", PRESS), plan)
    assert cloned["return"].mean() > 3.0 * max(chance["return"].mean(), 1.0)


def test_data_sets_are_read(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = gymnasium.make(PRESS, engine="batch", max_episode_steps=5)
    recorded = collect(Plan(PRESS, {"max_episode_steps": 5}, "batch", 2, 0))
    buffers = [
        EpisodeBuffer(
            id=index, seed=index, options=None,
            observations=each.observations, actions=each.actions, rewards=each.rewards,
            terminations=np.zeros(5, dtype=bool), truncations=np.arange(5) == 4,
            infos={"is_success": np.arange(6) == 5},
        )
        for index, each in enumerate(recorded)
    ]  # fmt: skip
    with warnings.catch_warnings():
        # That nobody is named who recorded it.
        warnings.simplefilter("ignore")
        minari.create_dataset_from_buffers("spatula/press/test-v0", buffers, env=env)
    env.close()
    read, env_id, kwargs = read_minari("spatula/press/test-v0", ("error",))
    assert (env_id, len(read)) == (PRESS, 2)
    assert "engine" not in kwargs
    for mine, theirs in zip(read, recorded, strict=True):
        np.testing.assert_array_equal(mine.observations, theirs.observations[:, -4:-1])
        np.testing.assert_array_equal(mine.actions, theirs.actions)
        np.testing.assert_allclose(mine.rewards, theirs.rewards)
        assert mine.success
    arguments = ["--dataset", "spatula/press/test-v0", "--gradient-steps", "20", "--output", str(tmp_path / "run")]
    assert main(arguments) == 0
    assert find_policy(str(tmp_path / "run"), PRESS).description.startswith("saved policy")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--expert", "3"], "needs --config or --env"),
        (["--expert", "0", "--env", PRESS], "1 or more"),
        (["--expert", "3", "--env", PRESS, "--rounds", "-1"], "--rounds must be 0 or more"),
        (["--dataset", "spatula/press/test-v0", "--rounds", "2"], "--rounds needs --expert"),
        (["--expert", "3", "--env", PRESS, "--set", "seeds=[1]"], "--set needs --config"),
    ],
)
def test_impossible_wishes_are_refused(arguments, message, capsys):
    with pytest.raises(SystemExit):
        main(arguments)
    assert message in capsys.readouterr().err


def test_the_configuration_of_cloning_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        CloneConfig().seed = 3
