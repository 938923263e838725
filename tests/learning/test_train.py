from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

import torch

from benchmarks.resume import readable
from spatula_env.envs.sb3 import make_sb3_vec_env
from spatula_env.learning import training
from spatula_env.learning.commands import train as command
from spatula_env.learning.configuration import training_from_mapping
from spatula_env.learning.evaluation import Plan, evaluate
from spatula_env.learning.finding import find_policy
from spatula_env.learning.imitation import hold_to_demonstrations
from spatula_env.learning.progress import ProgressView
from spatula_env.learning.saving import (
    checkpoints_in,
    find_saved,
    load_model,
    read_curve,
    read_saved_config,
    sweep,
    write_folder,
)
from spatula_env.learning.training import train, train_seed
from spatula_env.learning.worlds import OverlappedVecEnv, make_training_env

ROOT = Path(__file__).parents[2]

OFF_POLICY = {"learning_starts": 20, "batch_size": 16, "gradient_steps": 1, "buffer_size": 2000}
HYPERPARAMETERS = {
    "ppo": {"n_steps": 5, "batch_size": 20, "n_epochs": 2},
    "sac": OFF_POLICY,
    "tqc": OFF_POLICY,
    # Hindsight needs whole episodes.
    "sac_her": {**OFF_POLICY, "learning_starts": 48},
}


def small_environment(algorithm="sac"):
    """The press in four worlds, with episodes of ten steps."""
    sparse = algorithm == "sac_her"
    return {
        "id": "Spatula/Press-v0",
        "kwargs": {"max_episode_steps": 10, **({"reward": "sparse"} if sparse else {})},
        "parts": ["tool_position", "contact_force", *([] if sparse else ["error"])],
        "num_envs": 4,
    }


def small(algorithm="sac", **changes):
    """A configuration that trains for a second or two: 4 worlds, 50 steps of each."""
    content = {
        "environment": small_environment(algorithm),
        "algorithm": algorithm,
        "hyperparameters": HYPERPARAMETERS[algorithm],
        "network": {"layers": [16]},
        "total_steps": 200,
        "evaluation": {"every": 100, "episodes": 2},
        "checkpoint_every": 60,
        "success_target": None,
    }
    return training_from_mapping({**content, **changes})


@pytest.fixture(autouse=True)
def _short_evaluations(monkeypatch):
    make = Plan.make

    def make_short(self, count, **more):
        return make(self, count, **{"max_episode_steps": self.kwargs.get("max_episode_steps", 10), **more})

    monkeypatch.setattr(Plan, "make", make_short)


@pytest.fixture(scope="module")
def demonstrations():
    """What experts have shown in the tests of this file, by what was asked for."""
    return {}


@pytest.fixture(autouse=True)
def _demonstrations_are_made_once(demonstrations, monkeypatch):
    collect = training.collect_successes

    def collect_once(plan, **asked):
        key = (repr(plan), repr(asked))
        if key not in demonstrations:
            demonstrations[key] = collect(plan, **asked)
        return demonstrations[key]

    monkeypatch.setattr(training, "collect_successes", collect_once)


QUIET = ProgressView(quiet=True)


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "tqc", "sac_her"])
def test_all_that_is_promised_is_left_behind(algorithm, tmp_path):
    if algorithm == "tqc":
        pytest.importorskip("sb3_contrib")
    config = small(algorithm)
    summary = train_seed(config, 3, tmp_path / "seed-3", QUIET)
    folder = tmp_path / "seed-3"
    assert summary["steps"] == 200
    assert read_saved_config(folder).seeds == (3,)
    origin = json.loads((folder / "provenance.json").read_text())
    assert origin["versions"]["torch"] and "commit" in origin
    curve = read_curve(folder / "curve.jsonl")
    assert [line["step"] for line in curve] == [100, 200]
    assert {"success_rate", "return", "cost", "violation_rate", "seconds"} <= set(curve[0])
    assert [path.name for path in checkpoints_in(folder / "checkpoints")] == ["step-000000000180", "step-000000000200"]
    assert list((folder / "tensorboard").glob("events*"))
    # What is saved acts, here as its model does.
    source = find_policy(str(tmp_path), "Spatula/Press-v0")
    assert source.kwargs == ({"reward": "sparse"} if algorithm == "sac_her" else {})
    episodes, _ = evaluate(source, Plan("Spatula/Press-v0", source.kwargs, "batch", 2, 0))
    assert np.isfinite(episodes["return"]).all()
    # A run that is over is not begun again.
    before = (folder / "summary.json").stat().st_mtime_ns
    assert train_seed(config, 3, folder, QUIET) == summary
    assert (folder / "summary.json").stat().st_mtime_ns == before


class _Stop(Exception):
    pass


def interrupted_at(steps, monkeypatch):
    """Training breaks off once so many steps are done."""
    whole = training.Trainer._on_step

    def step(self):
        if self.model.num_timesteps > steps:
            raise _Stop
        return whole(self)

    monkeypatch.setattr(training.Trainer, "_on_step", step)


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "sac_her"])
def test_an_interrupted_run_goes_on_from_its_checkpoint(algorithm, tmp_path):
    config, folder = small(algorithm), tmp_path / "seed-0"
    with pytest.MonkeyPatch.context() as patch:
        interrupted_at(150, patch)
        with pytest.raises(_Stop):
            train_seed(config, 0, folder, QUIET)
    checkpoint = checkpoints_in(folder / "checkpoints")[-1]
    assert checkpoint.name == "step-000000000120"
    assert not (folder / "summary.json").exists()
    seen = {}
    restore = training.restore_checkpoint

    def spy(path, model):
        progress = restore(path, model)
        seen.update(path=path, steps=model.num_timesteps, updates=model._n_updates)
        if algorithm != "ppo":
            seen["stored"] = model.replay_buffer.size()
        return progress

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "restore_checkpoint", spy)
        summary = train_seed(config, 0, folder, QUIET)
    assert (seen["path"], seen["steps"]) == (checkpoint, 120)
    assert seen["updates"] > 0
    if algorithm != "ppo":
        # Rows of four transitions.
        assert seen["stored"] == 30
    assert summary["steps"] == 200
    assert [line["step"] for line in read_curve(folder / "curve.jsonl")] == [100, 200]
    assert summary["seconds"] > 0.0


def test_all_random_numbers_go_on_where_they_were(tmp_path):
    import random

    from spatula_env.learning.models import make_model
    from spatula_env.learning.saving import restore_checkpoint, save_checkpoint

    config = small()
    env, _ = make_training_env(config, 0, 0.9)
    model = make_model(config, env, 0)

    def draw():
        drawn = [torch.rand(3).tolist(), np.random.rand(3).tolist(), random.random()]  # noqa: NPY002 - the global ones
        return [*drawn, model.action_space.sample().tolist()]

    model.learn(40)
    checkpoint = save_checkpoint(tmp_path, model, env, config, {"best": None})
    expected = draw()
    assert draw() != expected
    weights = model.policy.actor.mu.weight.detach().clone()
    model = load_model(checkpoint, config, env)
    assert restore_checkpoint(checkpoint, model) == {"best": None}
    assert draw() == expected
    assert model.num_timesteps == 40
    np.testing.assert_array_equal(model.policy.actor.mu.weight.detach(), weights)
    env.close()


def test_a_run_that_was_killed_goes_on(tmp_path):
    config = small(total_steps=480, checkpoint_every=80, evaluation={"every": 80, "episodes": 1})
    file, output = tmp_path / "config.yaml", tmp_path / "run"
    from spatula_env.learning.configuration import write_training

    write_training(config, file)
    arguments = ["--config", str(file), "--output", str(output), "--quiet"]
    process = subprocess.Popen([sys.executable, "-m", "agents.train", *arguments], cwd=ROOT)
    try:
        while len(checkpoints_in(output / "seed-0" / "checkpoints")) < 2:
            assert process.poll() is None, "training ended before it could be killed"
            time.sleep(0.02)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    folder = output / "seed-0"
    reached = int(checkpoints_in(folder / "checkpoints")[-1].name.partition("-")[2])
    assert 0 < reached < 480
    problems = readable(output)
    assert len(problems) > 8
    assert {str(file): problem for file, problem in problems.items() if problem} == {}
    assert find_saved(output).name == "best"
    assert command.main(["--resume", str(output), "--quiet"]) == 0
    summary = json.loads((output / "summary.json").read_text())
    final = 480
    assert summary["steps"] == [final]
    curve = [line["step"] for line in read_curve(folder / "curve.jsonl")]
    assert curve == sorted({*range(80, final + 1, 80), final})
    assert not any(readable(output).values())
    assert not list(output.rglob("*.tmp*")) and not list(output.rglob("*.old"))


def test_training_stops_at_its_target(tmp_path):
    # Any evaluation reaches no success at all.
    summary = train_seed(small(success_target=0.0), 0, tmp_path, QUIET)
    assert summary["reached_target"]
    assert summary["steps"] < 200
    assert len(read_curve(tmp_path / "curve.jsonl")) == 1


def test_several_seeds_are_trained_and_summed_up(tmp_path):
    config = small(seeds=[1, 5], total_steps=60)
    summary = train(config, tmp_path, QUIET)
    assert summary["seeds"] == [1, 5]
    assert summary["steps"] == [60, 60]
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    networks = [load_model(find_saved(tmp_path / f"seed-{seed}"), config).policy.actor.mu.weight for seed in (1, 5)]
    assert not np.allclose(networks[0].detach(), networks[1].detach())
    with pytest.raises(ValueError, match="several seeds"):
        find_saved(tmp_path)


def demonstrated(**changes):
    """A model that has been shown six episodes of sixty steps."""
    from spatula_env.learning.models import make_model

    config = small(
        environment={**small_environment(), "kwargs": {"max_episode_steps": 60}}, demonstrations=6, **changes
    )
    env, _ = make_training_env(config, 0, 0.9)
    model = make_model(config, env, 0)
    training.demonstrate(config, 0, model, env)
    return config, model, env


def test_demonstrations_are_in_the_buffer_before_training():
    _, model, env = demonstrated()
    buffer = model.replay_buffer
    # Two rounds of four worlds, sixty steps each.
    assert buffer.pos == 120
    assert buffer.dones[:120, 0].nonzero()[0].tolist() == [59, 119]
    assert buffer.timeouts[59].all()
    np.testing.assert_array_equal(buffer.next_observations[:59], buffer.observations[1:60])
    # The estimates know what was demonstrated: places of the tool, at a few centimetres.
    assert env.obs_rms.count > 400
    np.testing.assert_allclose(env.obs_rms.mean, buffer.observations[:120].reshape(480, -1).mean(axis=0), atol=1e-4)
    env.close()


def test_demonstrations_are_a_share_of_each_batch_and_the_actor_begins_as_their_clone(tmp_path):
    config, model, env = demonstrated(demonstration_share=0.25, clone_steps=300, demonstration_noise=0.1)
    buffer = model.replay_buffer
    assert buffer.size() == 0 and buffer.demonstrations.size() == 120
    # Nothing has been experienced yet.
    assert len(buffer.sample(8).rewards) == 8
    for _ in range(5):
        buffer.add(
            np.zeros((4, 9)), np.zeros((4, 9)), np.full((4, 3), 0.5), np.full(4, -7.0), np.zeros(4), [{}] * 4
        )  # fmt: skip
    batch = buffer.sample(40, env)
    assert (batch.rewards[:10] > -7.0).all() and (batch.rewards[10:] == -7.0).all()
    seen, wanted = buffer.imitated
    done = model.policy.actor(torch.as_tensor(env.normalize_obs(seen)), deterministic=True).detach().numpy()
    assert np.abs(done - wanted).mean() < 0.5 * np.abs(wanted - wanted.mean(axis=0)).mean()
    # A checkpoint keeps them.
    from spatula_env.learning.saving import restore_checkpoint, save_checkpoint

    checkpoint = save_checkpoint(tmp_path, model, env, config, {})
    again = load_model(checkpoint, config, env)
    restore_checkpoint(checkpoint, again)
    np.testing.assert_array_equal(again.replay_buffer.imitated[0], seen)
    assert again.replay_buffer.demonstrations.size() == 120
    env.close()


@pytest.mark.parametrize("algorithm", ["sac", "tqc"])
def test_imitation_holds_an_actor_that_is_pulled_elsewhere(algorithm):
    def pulled_away(weight):
        _, model, env = demonstrated(algorithm=algorithm, demonstration_share=0.5, clone_steps=300)
        seen, wanted = model.replay_buffer.imitated
        if weight:
            hold_to_demonstrations(model, (seen, wanted), weight=weight, batch_size=64)
        batch = torch.as_tensor(env.normalize_obs(seen))
        for _ in range(200):
            # In place of the critics: the greatest actions are best everywhere.
            loss = -model.actor(batch, deterministic=True).mean()
            model.actor.optimizer.zero_grad()
            loss.backward()
            model.actor.optimizer.step()
        env.close()
        return np.abs(model.actor(batch, deterministic=True).detach().numpy() - wanted).mean()

    assert pulled_away(20.0) < 0.3 * pulled_away(0.0)


@pytest.mark.parametrize(("actor_starts", "stays"), [(1000, True), (60, False)])
def test_an_actor_stays_a_clone_until_it_starts(tmp_path, actor_starts, stays):
    changes = {"demonstration_share": 0.5, "clone_steps": 20}
    config, clone, env = demonstrated(**changes)
    env.close()
    config = dataclasses.replace(config, actor_starts=actor_starts, imitation_weight=1.0, total_steps=120)
    train_seed(config, 0, tmp_path, QUIET)
    trained = load_model(tmp_path / "policy", config)
    same = [
        torch.equal(one, two) for one, two in zip(trained.actor.parameters(), clone.actor.parameters(), strict=True)
    ]
    assert all(same) if stays else not any(same)
    assert not torch.equal(next(trained.critic.parameters()), next(clone.critic.parameters()))


def test_training_with_all_that_demonstrations_can_do_goes_to_its_end(tmp_path):
    config = small(
        environment={**small_environment(), "kwargs": {"max_episode_steps": 60}},
        demonstrations=4, demonstration_share=0.5, clone_steps=20, imitation_weight=2.0, actor_starts=60,
        total_steps=120,
    )  # fmt: skip
    summary = train_seed(config, 0, tmp_path, QUIET)
    assert summary["steps"] == 120
    # Four episodes of sixty steps, which the agent has not made itself.
    assert summary["demonstration_steps"] == 240
    assert find_policy(str(tmp_path), "Spatula/Press-v0")


@pytest.mark.parametrize(("clone_steps", "steps"), [(20, [0, 100]), (0, [100])])
def test_what_begins_as_a_clone_is_evaluated_before_it_learns(tmp_path, clone_steps, steps):
    config = small(
        environment={**small_environment(), "kwargs": {"max_episode_steps": 60}},
        demonstrations=4, clone_steps=clone_steps, success_target=0.0,
    )  # fmt: skip
    summary = train_seed(config, 0, tmp_path, QUIET)
    curve = read_curve(tmp_path / "curve.jsonl")
    assert [line["step"] for line in curve] == steps
    assert {line["demonstration_steps"] for line in curve} == {240}
    # Any evaluation would reach the target but this one, which is not what has been trained.
    assert summary["reached_target"] and summary["steps"] >= 100
    saved = json.loads((tmp_path / "best" / "evaluation.json").read_text())
    assert saved["step"] == 100


def test_stepping_meanwhile_changes_nothing():
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 3, 3)).astype(np.float32)
    plain = make_sb3_vec_env("Spatula/Press-v0", 3, seed=4, max_episode_steps=4)
    overlapped = OverlappedVecEnv(make_sb3_vec_env("Spatula/Press-v0", 3, seed=4, max_episode_steps=4))
    calls = []
    overlapped.meanwhile = lambda: calls.append(1)
    np.testing.assert_array_equal(overlapped.reset(), plain.reset())
    for action in actions:
        mine, theirs = overlapped.step(action), plain.step(action)
        for k in range(3):
            np.testing.assert_array_equal(mine[k], theirs[k])
    assert len(calls) == 6
    overlapped.close()
    plain.close()


def test_an_error_meanwhile_is_raised_after_the_step():
    env = OverlappedVecEnv(make_sb3_vec_env("Spatula/Press-v0", 1, seed=4))
    env.reset()

    def fail():
        raise _Stop

    env.meanwhile = fail
    with pytest.raises(_Stop):
        env.step(np.zeros((1, 3), dtype=np.float32))
    env.meanwhile = None
    assert env.step(np.zeros((1, 3), dtype=np.float32))[3][0]["time"] == pytest.approx(0.1)
    env.close()


def test_folders_appear_whole_or_not_at_all(tmp_path):
    place = tmp_path / "step-1"
    write_folder(place, lambda folder: (folder / "a").write_text("first"))

    def fail(folder):
        (folder / "a").write_text("second")
        raise _Stop

    with pytest.raises(_Stop):
        write_folder(place, fail)
    assert (place / "a").read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["step-1"]
    write_folder(place, lambda folder: (folder / "b").write_text("third"))
    assert [path.name for path in place.iterdir()] == ["b"]


def test_what_a_killed_run_left_is_put_right(tmp_path):
    for name in (".best.1.old", ".policy.2.old", "policy", ".step-1.3.tmp"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(name)
    (tmp_path / ".curve.jsonl.4.tmp").write_text("")
    sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["best", "policy"]
    assert (tmp_path / "best" / "file").read_text() == ".best.1.old"
    assert (tmp_path / "policy" / "file").read_text() == "policy"


def test_a_line_that_was_cut_is_left_out(tmp_path):
    (tmp_path / "curve.jsonl").write_text('{"step": 1}\n{"step": 2}\n{"ste')
    assert read_curve(tmp_path / "curve.jsonl") == [{"step": 1}, {"step": 2}]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "configs/none.yaml"], "none.yaml"),
        (["--config", "configs/press_sac.yaml", "--set", "gama=3"], "unknown keys ['gama']"),
        (["--resume", "runs/none"], "none"),
    ],
)
def test_what_is_wrong_is_said(arguments, message, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert command.main(arguments) == 1
    assert message in capsys.readouterr().err


def test_a_run_is_not_written_over(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    (tmp_path / "config.yaml").write_text("mine: 1")
    assert command.main(["--config", "configs/press_sac.yaml", "--output", str(tmp_path)]) == 1
    assert "holds a config.yaml that is not of a run" in capsys.readouterr().err
    assert (tmp_path / "config.yaml").read_text() == "mine: 1"
    with pytest.raises(SystemExit):
        command.main(["--resume", str(tmp_path), "--seed", "3"])


def test_little_training_is_better_than_chance(tmp_path, monkeypatch):
    """On an easy press: a few seconds of soft actor-critic, compared by the same reward."""
    easy = {"max_episode_steps": 40, "task": {"place_radius": 0.0, "start_radius": 0.005}}
    config = small(
        environment={
            "id": "Spatula/Press-v0",
            "kwargs": easy,
            "parts": ["tool_position", "error"],
            "num_envs": 16,
        },
        hyperparameters={
            "learning_starts": 640, "batch_size": 128, "gradient_steps": 4, "gamma": 0.9, "buffer_size": 10_000,
        },
        network={"layers": [64, 64]},
        total_steps=2880,
        evaluation={"every": 1_000_000, "episodes": 1},
        checkpoint_every=1_000_000,
    )  # fmt: skip
    train_seed(config, 0, tmp_path, QUIET)
    plan = Plan("Spatula/Press-v0", easy, "batch", 16, 123)
    trained, _ = evaluate(find_policy(str(tmp_path), "Spatula/Press-v0"), plan)
    chance, _ = evaluate(find_policy("random", "Spatula/Press-v0"), plan)
    assert trained["return"].mean() > 2.0 * max(chance["return"].mean(), 1.0)
