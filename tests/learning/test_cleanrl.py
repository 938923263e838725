"""The scripts of one file: their parts, and that they run from beginning to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("tyro")

from agents import cleanrl_ppo, cleanrl_sac  # noqa: E402

TINY = {"num_envs": 4, "max_episode_steps": 6, "hidden": 8, "batch_size": 16, "eval_episodes": 2}


def test_sac_runs_and_tells_what_it_came_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "sac.pt"
    arguments = cleanrl_sac.Arguments(
        **TINY, total_steps=64, learning_starts=32, gradient_steps=1, buffer_size=48, output=output
    )
    result = cleanrl_sac.main(arguments)
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    assert result["steps"] == 64
    assert 0.0 <= result["success"] <= 1.0
    saved = torch.load(output, weights_only=True)
    assert all(torch.isfinite(values).all() for values in saved["actor"].values())
    assert saved["mean"].shape == saved["variance"].shape == (23,)


def test_ppo_runs_and_tells_what_it_came_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "ppo.pt"
    arguments = cleanrl_ppo.Arguments(**TINY, total_steps=64, rollout_steps=8, epochs=2, output=output)
    result = cleanrl_ppo.main(arguments)
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    assert result["steps"] == 64
    saved = torch.load(output, weights_only=True)
    assert all(torch.isfinite(values).all() for values in saved["agent"].values())
    assert saved["mean"].shape == saved["variance"].shape == (23,)


def test_training_ends_when_enough_episodes_have_succeeded() -> None:
    short = {**TINY, "num_envs": 50, "max_episode_steps": 2, "success_target": 0.0}
    # Two rounds of 50 episodes, and one rollout.
    assert cleanrl_sac.main(cleanrl_sac.Arguments(**short, learning_starts=10_000))["steps"] == 200
    assert cleanrl_ppo.main(cleanrl_ppo.Arguments(**short, rollout_steps=8))["steps"] == 400


@pytest.mark.parametrize("script", [cleanrl_sac, cleanrl_ppo])
def test_a_part_that_is_not_there_is_named(script: object) -> None:
    with pytest.raises(ValueError, match=r"leave_out must be of .* got \['nose'\]"):
        script.main(script.Arguments(**TINY, leave_out=("nose",)))  # type: ignore[attr-defined]


def test_normalisation_is_that_of_all_that_was_seen() -> None:
    generator = np.random.default_rng(0)
    seen = generator.normal(3.0, 2.0, (500, 4))
    norm = cleanrl_sac.RunningNorm(4)
    for part in np.split(seen, [100, 130, 400]):
        norm.update(part)
    np.testing.assert_allclose(norm.mean, seen.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(norm.variance, seen.var(axis=0), rtol=1e-4)
    assert norm(1e6 * np.ones(4)).max() == 10.0


def test_the_replay_forgets_the_oldest() -> None:
    replay = cleanrl_sac.Replay(4, 1, 1)
    for first in (0, 3):
        rows = np.arange(first, first + 3, dtype=np.float32)
        replay.add(rows[:, None], rows[:, None] + 0.5, rows[:, None], rows, np.zeros(3))
    assert sorted(replay.rewards) == [2.0, 3.0, 4.0, 5.0]
    np.testing.assert_array_equal(replay.next_observations, replay.observations + 0.5)


def test_densities_of_squashed_actions_are_those_of_the_change_of_variables() -> None:
    torch.manual_seed(0)
    actor = cleanrl_sac.Actor(3, 2, 8).double()
    observations = torch.randn(200, 3, dtype=torch.float64)
    actions, densities = actor(observations)
    mean, log_std = actor.net(observations).chunk(2, dim=-1)
    raw = torch.atanh(actions)
    expected = torch.distributions.Normal(mean, log_std.exp()).log_prob(raw) - torch.log(1.0 - actions**2)
    torch.testing.assert_close(densities, expected.sum(dim=-1), rtol=1e-6, atol=1e-6)


def test_advantages_end_with_episodes_but_see_beyond_a_truncation() -> None:
    """Three steps: the second is cut, the third begins the next episode and is not learnt from."""
    rewards = torch.tensor([[1.0], [2.0], [0.0]])
    values = torch.tensor([[10.0], [20.0], [30.0], [40.0]])
    cut = torch.tensor([[0.0], [1.0], [0.0]])
    none = torch.zeros(3, 1)
    gained = cleanrl_ppo.advantages(rewards, values, none, cut, gamma=0.5, gae_lambda=0.8)
    second = 2.0 + 0.5 * 30.0 - 20.0
    torch.testing.assert_close(gained[1, 0], torch.tensor(second))
    torch.testing.assert_close(gained[0, 0], torch.tensor(1.0 + 0.5 * 20.0 - 10.0 + 0.5 * 0.8 * second))
    gained = cleanrl_ppo.advantages(rewards, values, cut, cut, gamma=0.5, gae_lambda=0.8)
    torch.testing.assert_close(gained[1, 0], torch.tensor(2.0 - 20.0))
