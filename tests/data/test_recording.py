from __future__ import annotations

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.data import replay
from spatula_env.data.replaying import open_dataset, recorded_states
from spatula_env.teleop.recording import record
from spatula_env.teleop.replay_device import ReplayDevice
from spatula_env.teleop.scripted import ScriptedFalcon, ScriptedOperator

sys.path.insert(0, str(Path(__file__).parents[1] / "teleop"))
from teleop_helpers import Puppet

minari = pytest.importorskip("minari")
assert spatula_env.TASKS

ID = "spatula/press/test-v0"
STEPS = 12


def dive(_) -> np.ndarray:
    """Down, a little to the side."""
    return np.array([0.05, 0.0, -0.8], dtype=np.float32)


@pytest.fixture(scope="module")
def env():
    made = gym.make("Spatula/Press-v0", max_episode_steps=STEPS)
    yield made
    made.close()


@pytest.fixture(scope="module")
def recorded(env, tmp_path_factory):
    """Two scripted episodes with the hand on an emulated Falcon."""
    root = tmp_path_factory.mktemp("datasets")
    told = []
    with ScriptedFalcon(dive, np.random.default_rng(3), tremor=0.05) as device:
        summary = record(
            env,
            device,
            ID,
            episodes=2,
            seed=11,
            root=root,
            options={"tool_position": (0.0, 0.0, -0.015)},
            progress=lambda fate, _: told.append(fate),
        )
    assert told == ["recorded"] * 2
    return root, summary


def test_what_came_of_it(env, recorded):
    root, summary = recorded
    assert (summary.recorded, summary.discarded, summary.total_episodes, summary.lost) == (2, 0, 2, None)
    dataset = open_dataset(ID, root)
    assert [int(data["seed"]) for data in dataset.storage.get_episode_metadata([0, 1])] == [11, 12]
    (metadata,) = dataset.storage.get_episode_metadata([1])
    assert metadata["operator"] == "scripted"
    assert metadata["device"] == "emulated Falcon"
    assert metadata["engine"] == env.unwrapped.settings.engine
    episode = next(iter(dataset.iterate_episodes([0])))
    assert episode.observations.shape[0] == STEPS + 1
    assert {name.decode() for name in episode.infos["acted_by"]} == {"scripted"}
    assert episode.infos["force"].max() > 0.0
    assert "scripted" in dataset.storage.metadata["description"]


def test_the_engine_repeats_what_was_recorded(recorded):
    root, _ = recorded
    results = replay(ID, root=root)
    assert [result.episode for result in results] == [0, 1]
    for result in results:
        assert result.matches
        assert result.difference <= 1e-9
        assert result.steps == STEPS


def test_a_hand_is_repeated_exactly_and_its_mean_nearly(recorded, env):
    root, _ = recorded
    episode = next(iter(open_dataset(ID, root).iterate_episodes([0])))
    tracks = episode.infos["steering"]
    assert tracks.shape == (STEPS + 1, env.unwrapped.steps_per_action, 3)
    assert np.isnan(tracks[0]).all()
    np.testing.assert_allclose(tracks[1:].mean(axis=1), episode.actions, atol=1e-6)
    assert tracks[1:].std(axis=1).max() > 0.01
    exact, mean = (replay(ID, root=root, episodes=[0], steering=steering)[0] for steering in (True, False))
    assert exact.difference == 0.0
    # Tools are where they were at the end of each control step; the organ has felt another way there.
    assert 0.0 < mean.difference < 1.0


def test_a_recording_that_was_changed_does_not_match(recorded, monkeypatch):
    root, _ = recorded
    from spatula_env.data import replaying

    states = replaying.physics_state

    def shifted(simulation):
        return {name: values + 1e-6 for name, values in states(simulation).items()}

    monkeypatch.setattr(replaying, "physics_state", shifted)
    (result,) = replay(ID, root=root, episodes=[1])
    assert not result.matches
    assert result.difference == pytest.approx(1e-6, rel=1e-3)


def test_states_need_no_physics(recorded, env):
    root, _ = recorded
    states = list(recorded_states(ID, 1, root=root))
    assert len(states) == STEPS + 1
    nodes, tools = states[-1]
    assert nodes.shape == env.unwrapped.simulation.nodes.shape
    assert tools.shape == (1, 7)
    assert tools[0, 2] < states[0][1][0, 2]


def test_a_recording_is_a_device(recorded, env, tmp_path):
    root, _ = recorded
    with ReplayDevice.from_dataset(ID, 0, root) as device:
        assert device.operator == "scripted"
        record(env, device, ID, seed=11, root=tmp_path, options={"tool_position": (0.0, 0.0, -0.015)}, real_time=False)
    first, second = (next(iter(open_dataset(ID, place).iterate_episodes([0]))) for place in (root, tmp_path))
    np.testing.assert_allclose(second.actions, first.actions, atol=1e-6)
    np.testing.assert_array_equal(second.observations, first.observations)


def test_the_loop_is_recorded_at_its_own_rate(env, tmp_path):
    from spatula_env.teleop.haptics.track import HapticTrack
    from spatula_env.teleop.recording import haptics_file

    with ScriptedFalcon(dive) as device:
        summary = record(env, device, ID, root=tmp_path, options={"tool_position": (0.0, 0.0, -0.015)}, haptics=True)
    track = HapticTrack.load(haptics_file(summary.path, 0))
    assert len(track.time) == pytest.approx(STEPS * 50, abs=5)
    assert track.told[:, 2].max() > 0.0
    (metadata,) = open_dataset(ID, tmp_path).storage.get_episode_metadata([0])
    assert metadata["force_scale"] == 1.0
    with ScriptedOperator(dive) as device, pytest.raises(TypeError, match="haptic loop"):
        record(env, device, ID, root=tmp_path, haptics=True)


def test_nothing_to_replay(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no dataset"):
        replay(ID, root=tmp_path)


def test_failures_can_be_dropped_and_the_operator_can_stop(env, tmp_path):
    seen = []

    def quit_third(_, summary):
        seen.append(summary.seed)
        if len(seen) == 3:
            operator.buttons_down = {"quit"}

    class Stopper(ScriptedOperator):
        buttons_down = frozenset()

        def read(self):
            sample = super().read()
            return type(sample)("rate", sample.time, sample.sequence, None, sample.rate, sample.velocity, self.held())

        def held(self):
            # Pressed in the middle of an episode.
            return self.buttons_down if self._sequence % (STEPS + 1) == 5 else frozenset()

    operator = Stopper(dive)
    with operator:
        summary = record(
            env,
            operator,
            ID,
            episodes=5,
            root=tmp_path,
            keep_failures=False,
            states=False,
            progress=quit_third,
            real_time=False,
        )
    assert (summary.recorded, summary.discarded, summary.successes) == (0, 4, 0)
    assert seen == [0, 1, 2, 3]


def test_no_seed_comes_twice(env, tmp_path):
    fates = []

    class Discarder(ScriptedOperator):
        def read(self):
            sample = super().read()
            # The first episode is discarded in its fourth step.
            buttons = frozenset({"discard"} if not fates and self._sequence == 4 else ())
            return type(sample)("rate", sample.time, sample.sequence, None, sample.rate, sample.velocity, buttons)

    with Discarder(dive) as operator:
        for _ in range(2):
            record(
                env,
                operator,
                ID,
                seed=3,
                root=tmp_path,
                states=False,
                progress=lambda fate, summary: fates.append((fate, summary.seed)),
                real_time=False,
            )
    assert fates == [("discarded", 3), ("recorded", 4), ("recorded", 5)]


def test_tries_can_be_counted(env, tmp_path):
    with ScriptedOperator(dive) as operator:
        summary = record(
            env, operator, ID, episodes=5, root=tmp_path, keep_failures=False, attempts=2, states=False, real_time=False
        )
        assert (summary.recorded, summary.discarded) == (0, 2)
        for wrong in ({"episodes": 0}, {"attempts": 0}):
            with pytest.raises(ValueError, match=next(iter(wrong))):
                record(env, operator, ID, root=tmp_path, **wrong)


def test_a_lost_device_costs_the_running_episode_only(env, tmp_path):
    device = Puppet("rate")

    def lose(_, info):
        if info["time"] > 0.2 and len(done) == 1:
            device.lost = True

    done = []
    summary = record(
        env,
        device,
        ID,
        episodes=3,
        root=tmp_path,
        progress=lambda *_: done.append(1),
        after_step=lose,
        real_time=False,
    )
    assert summary.recorded == 1
    assert "does not answer" in summary.lost
    assert open_dataset(ID, tmp_path).total_episodes == 1
    assert all(replay.matches for replay in replay(ID, root=tmp_path))
