from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from spatula_env.learning.finding import find_policy
from spatula_env.policies import (
    PRETRAINED,
    Entry,
    ExportedPolicy,
    describe_provenance,
    load_pretrained,
    read_provenance,
)

ROOT = Path(__file__).parents[2]

VECTOR = spaces.Box(-3.0, 3.0, (7,), dtype=np.float32)
GOALS = spaces.Dict(
    {
        "observation": VECTOR,
        "achieved_goal": spaces.Box(-1.0, 1.0, (2,), dtype=np.float32),
        "desired_goal": spaces.Box(-1.0, 1.0, (2,), dtype=np.float32),
    }
)
ACTIONS = spaces.Box(np.array([-1.0, -0.5, 0.0], dtype=np.float32), np.array([1.0, 0.5, 2.0], dtype=np.float32))


class Nothing(gymnasium.Env):
    """Has spaces, and nothing happens."""

    def __init__(self, observation_space):
        self.observation_space, self.action_space = observation_space, ACTIONS

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def trained(algorithm, space, activation="ReLU"):
    """A model with weights by chance, and a normalisation that has seen something."""
    pytest.importorskip("stable_baselines3")
    import stable_baselines3
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = VecNormalize(DummyVecEnv([lambda: Nothing(space)]), clip_obs=1.5)
    env.reset()
    for _ in range(50):
        env.step([ACTIONS.sample()])
    if algorithm == "TQC":
        kind = pytest.importorskip("sb3_contrib").TQC
    else:
        kind = getattr(stable_baselines3, algorithm)
    policy = "MultiInputPolicy" if isinstance(space, spaces.Dict) else "MlpPolicy"
    kwargs = {"net_arch": [16, 12], "activation_fn": getattr(torch.nn, activation)}
    sizes = {"n_steps": 8, "batch_size": 8} if algorithm == "PPO" else {"buffer_size": 10}
    model = kind(policy, env, policy_kwargs=kwargs, seed=3, device="cpu", **sizes)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            # So that actions reach their bounds.
            parameter.add_(0.4 * torch.randn_like(parameter))
    return model, env


@pytest.mark.parametrize("space", [VECTOR, GOALS], ids=["vector", "goals"])
@pytest.mark.parametrize(
    ("algorithm", "activation"), [("SAC", "ReLU"), ("TQC", "ELU"), ("PPO", "Tanh"), ("SAC", "Tanh")]
)
def test_an_exported_policy_does_what_the_model_does(algorithm, activation, space, tmp_path):
    from spatula_env.learning.export import export_policy

    model, normalizer = trained(algorithm, space, activation)
    exported = export_policy(model, normalizer, {"env_id": "Nothing-v0"})
    exported.save(tmp_path / "policy.npz")
    loaded = ExportedPolicy.load(tmp_path / "policy.npz")
    space.seed(1)
    seen = [space.sample() for _ in range(200)]
    if isinstance(space, spaces.Dict):
        batch = {key: np.stack([one[key] for one in seen]) for key in space.spaces}
    else:
        batch = np.stack(seen)
    expected, _ = model.predict(normalizer.normalize_obs(batch), deterministic=True)
    # Some actions are at a bound, others between.
    assert ((expected == ACTIONS.low) | (expected == ACTIONS.high)).mean() < 0.95
    for policy in (exported, loaded):
        np.testing.assert_allclose(policy(batch), expected, rtol=0, atol=1e-5)
        np.testing.assert_allclose(policy(seen[0]), expected[0], rtol=0, atol=1e-5)
    assert loaded.metadata == {"env_id": "Nothing-v0"}
    assert loaded(batch).dtype == np.float32


def test_without_a_normalisation_there_is_none():
    from spatula_env.learning.export import export_policy

    model, _ = trained("SAC", VECTOR)
    batch = np.stack([VECTOR.sample() for _ in range(20)])
    expected, _ = model.predict(batch, deterministic=True)
    np.testing.assert_allclose(export_policy(model)(batch), expected, rtol=0, atol=1e-5)


def test_a_model_of_another_kind_is_refused():
    sb3 = pytest.importorskip("stable_baselines3")
    from spatula_env.learning.export import export_policy

    model = sb3.DQN("MlpPolicy", gymnasium.make("CartPole-v1"), buffer_size=10)
    with pytest.raises(ValueError, match="PPO, SAC or TQC, got DQN"):
        export_policy(model)


def linear(size=71, actions=3, **metadata):
    """Steers by the first numbers of an observation."""
    weights = np.zeros((actions, size), dtype=np.float32)
    weights[np.arange(actions), np.arange(actions)] = 2.0
    bound = np.ones(actions, dtype=np.float32)
    entry = Entry("", np.zeros(size), np.ones(size))
    return ExportedPolicy(
        (entry,), 10.0, ((weights, np.zeros(actions, dtype=np.float32)),), "relu", False, -bound, bound, metadata
    )


def test_actions_of_a_known_network():
    policy = linear(4, 2)
    np.testing.assert_allclose(policy(np.array([0.25, -3.0, 7.0, 7.0])), [0.5, -1.0])


def test_a_policy_finds_its_parts_in_an_environment():
    env = gymnasium.make_vec("Spatula/Press-v0", num_envs=2)
    policy = linear(6, 3, parts=["error", "goal"]).bound_to(env)
    observation, _ = env.reset(seed=0)
    goals = observation[:, env.unwrapped.observation_builder.slices["goal"]]
    np.testing.assert_allclose(policy(observation), 2.0 * goals, rtol=1e-6)
    with pytest.raises(ValueError, match="must have 70 numbers for this policy, got 71"):
        linear(70).bound_to(env)
    with pytest.raises(ValueError, match="actions must have 2 numbers"):
        linear(71, 2).bound_to(env)
    env.close()


def test_a_file_with_something_else_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match=r"other\.npz holds no exported policy"):
        ExportedPolicy.load(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ValueError):
        ExportedPolicy.load(tmp_path / "text.npz")
    with pytest.raises(FileNotFoundError):
        ExportedPolicy.load(tmp_path / "none.npz")


def test_policies_are_for_their_environment_only(tmp_path):
    linear(env_id="Spatula/Press-v0").save(tmp_path / "press.npz")
    assert find_policy(str(tmp_path / "press.npz"), "Spatula/Press-v0").description == "exported weights press.npz"
    with pytest.raises(ValueError, match=r"is for Spatula/Press-v0, not for Spatula/Clamp-v0"):
        find_policy(str(tmp_path / "press.npz"), "Spatula/Clamp-v0")
    with pytest.raises(FileNotFoundError, match="expert, proportional, random, pretrained"):
        find_policy(str(tmp_path / "none"), "Spatula/Press-v0")


@pytest.mark.parametrize("path", sorted(PRETRAINED.glob("*.npz")), ids=lambda path: path.stem)
def test_pretrained_policies_are_small_and_say_where_they_come_from(path):
    assert path.stat().st_size < 200_000
    policy = ExportedPolicy.load(path)
    env_id = policy.metadata["env_id"]
    assert env_id == f"Spatula/{path.stem.capitalize()}-v0"
    provenance = read_provenance(path)
    assert {"config", "steps", "seed", "evaluation", "versions", "commit"} <= set(provenance)
    assert provenance["config"]["environment"]["id"] == env_id
    evaluation = provenance["evaluation"]
    assert set(evaluation) & {"batch", "bullet"}
    for engine, told in evaluation.items():
        assert told["success_rate"] >= 0.9, engine
    env = gymnasium.make_vec(env_id, num_envs=2, **policy.metadata["env_kwargs"])
    observation, _ = env.reset(seed=0)
    assert policy.bound_to(env)(observation).shape == env.action_space.shape
    env.close()


def test_pretrained_policies_act_without_torch():
    code = (
        "import sys, gymnasium, spatula_env\n"
        "from spatula_env.learning.finding import find_policy\n"
        "source = find_policy('pretrained', 'Spatula/Press-v0')\n"
        "env = gymnasium.make_vec('Spatula/Press-v0', num_envs=2, **source.kwargs)\n"
        "policy = source.make(env)\n"
        "observation, _ = env.reset(seed=0)\n"
        "for _ in range(3):\n"
        "    observation = env.step(policy(observation))[0]\n"
        "print([name for name in ('torch', 'stable_baselines3') if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("provenance", "described"),
    [
        ({"steps": 25600, "config": {"algorithm": "sac"}}, "soft actor-critic, 25 600 steps"),
        (
            {"steps": 1_000_000, "config": {"algorithm": "tqc", "demonstrations": 64}},
            "truncated quantile critics, 1 000 000 steps, 64 demonstrations",
        ),
        ({"steps": 0, "demonstrations": {"episodes": 50}}, "clone of 50 demonstrations"),
        ({}, "unknown origin"),
    ],
)
def test_where_a_policy_comes_from_is_said_in_few_words(provenance, described):
    assert describe_provenance(provenance) == described


def test_pretrained_policies_are_found_by_environment():
    policy = load_pretrained("Spatula/Press-v0")
    assert policy.metadata["env_id"] == "Spatula/Press-v0"
    with pytest.raises(FileNotFoundError, match="with a pretrained policy, got 'CartPole-v1'"):
        load_pretrained("CartPole-v1")


def test_policies_need_no_agents():
    """The code that plays exported policies is part of the environments' package, on which `agents` builds."""
    code = (
        "import sys, gymnasium, spatula_env.demo.episode\n"
        "from spatula_env.policies import load_pretrained\n"
        "load_pretrained('Spatula/Press-v0')\n"
        "print([name for name in sys.modules if name.partition('.')[0] in ('agents', 'torch')])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
