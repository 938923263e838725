"""Each layout of observations selects the kind of policy that accepts it, in training and in cloning."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

import torch
from gymnasium import spaces
from training_helpers import write_small

from spatula_env.learning import cloning, demonstrations
from spatula_env.learning.commands import clone, evaluate, export, train
from spatula_env.learning.evaluation import Plan
from spatula_env.learning.finding import find_policy
from spatula_env.learning.networks import ObservationExtractor, policy_class
from spatula_env.learning.saving import find_saved, load_model, load_normalizer, read_saved_config

pytestmark = pytest.mark.usefixtures("short_evaluations")

SMALL = {"image_size": [16, 20], "organ_points": 12, "tool_points": 6}
MODES = {
    "dict": {"obs_mode": "dict"},
    "rgb": {"obs_mode": "rgb", "observation": SMALL},
    "rgbd of three moments": {"obs_mode": "rgbd", "observation": {**SMALL, "history": 3}},
    "pointcloud": {"obs_mode": "pointcloud", "observation": SMALL},
    "state of three moments": {"observation": {"history": 3}},
}


# Each mode once, each algorithm with observations of each kind: vectors, pictures, points.
@pytest.mark.parametrize(
    ("mode", "algorithm"),
    [
        ("dict", "sac"),
        ("rgb", "ppo"),
        ("rgbd of three moments", "sac_her"),
        ("pointcloud", "sac"),
        ("pointcloud", "ppo"),
        ("state of three moments", "sac_her"),
        ("state of three moments", "ppo"),
        ("rgb", "sac"),
    ],
)
def test_it_is_trained_saved_and_evaluated(mode, algorithm, tmp_path):
    file = write_small(tmp_path / "c.yaml", algorithm, **MODES[mode])
    output = tmp_path / "run"
    assert train.main(["--config", str(file), "--output", str(output), "--quiet"]) == 0
    words = ["--env", "press", "--policy", str(output), "--episodes", "2", "--set", "max_episode_steps=3"]
    assert evaluate.main(words) == 0
    assert train.main(["--resume", str(output), "--set", "total_steps=80", "--quiet"]) == 0
    # What acts does what Stable-Baselines3 does.
    folder = find_saved(output)
    config = read_saved_config(folder)
    source = find_policy(str(output), "Spatula/Press-v0")
    env = Plan("Spatula/Press-v0", source.kwargs, "batch", 2, 0).make(2)
    observation, _ = env.reset(seed=[0, 1])
    model, normalizer = load_model(folder, config), load_normalizer(folder)
    expected, _ = model.predict(normalizer.normalize_obs(observation), deterministic=True)
    np.testing.assert_allclose(source.make(env)(observation), expected, atol=1e-5)
    env.close()


@pytest.mark.parametrize("mode", ["dict", "rgb", "pointcloud"])
def test_it_is_cloned_and_corrected(mode, tmp_path, monkeypatch):
    monkeypatch.setattr(
        demonstrations, "collect_successes",
        lambda plan, **more: demonstrations.Collected(
            demonstrations.collect(plan, num_envs=2, parts=more["parts"], steps=6), 0.0, 12
        ),
    )  # fmt: skip
    monkeypatch.setattr(cloning, "WORLDS", 2)
    file = write_small(tmp_path / "c.yaml", **MODES[mode])
    output = str(tmp_path / "clone")
    words = ["--config", str(file), "--expert", "2", "--gradient-steps", "3", "--rounds", "1", "--output", output]
    assert clone.main(words) == 0
    assert evaluate.main(["--env", "press", "--policy", output, "--episodes", "1", "--set", "max_episode_steps=3"]) == 0


def test_an_expert_shows_pictures_what_it_would_do_by_the_state():
    by_state, by_pictures = (
        demonstrations.collect(Plan("Spatula/Press-v0", {"max_episode_steps": 4, **MODES[mode]}, "batch", 2, 5))
        for mode in ("dict", "rgb")
    )
    for one, other in zip(by_state, by_pictures, strict=True):
        np.testing.assert_array_equal(one.actions, other.actions)
        assert other.observations["image"].dtype == np.uint8


def test_pictures_are_not_exported(tmp_path, capsys):
    file, output = write_small(tmp_path / "c.yaml", **MODES["rgb"]), tmp_path / "run"
    assert train.main(["--config", str(file), "--output", str(output), "--quiet"]) == 0
    assert export.main([str(output), str(tmp_path / "w.npz")]) == 1
    assert "a policy with layers for pictures or points cannot be exported" in capsys.readouterr().err
    assert not (tmp_path / "w.npz").exists()


def test_the_policy_follows_from_the_space():
    box = spaces.Box(-1.0, 1.0, (5,))
    picture = spaces.Box(0, 255, (84, 84, 3), dtype=np.uint8)
    assert [policy_class(each) for each in (box, picture, spaces.Dict({"a": box}))] == [
        "MlpPolicy", "CnnPolicy", "MultiInputPolicy",
    ]  # fmt: skip


def test_features_do_not_depend_on_the_order_of_points_and_do_on_all_channels():
    space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (2, 9, 12, 3), dtype=np.uint8),
            "depth": spaces.Box(0.0, 1.0, (2, 9, 12, 1)),
            "organ": spaces.Box(-0.1, 0.1, (7, 3)),
            "state": spaces.Box(-1.0, 1.0, (2, 4)),
        }
    )
    space.seed(0)
    extractor = ObservationExtractor(space)
    seen = {name: torch.as_tensor(value[None]).float() for name, value in space.sample().items()}

    def features(**changes):
        with torch.no_grad():
            return extractor({**seen, **changes})

    assert features().shape == (1, extractor.features_dim)
    turned = seen["organ"][:, torch.randperm(7, generator=torch.Generator().manual_seed(0))]
    torch.testing.assert_close(features(organ=turned), features())
    for name, values in seen.items():
        for moment in range(2) if name != "organ" else [slice(None)]:
            other = values.clone()
            other[:, moment] = 0.0
            assert not torch.allclose(features(**{name: other}), features())
