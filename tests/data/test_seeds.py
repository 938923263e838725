"""Seeds that no dataset can keep are refused before anything is played."""

from __future__ import annotations

import pytest
from recording_helpers import ID, do_episode, make_pictures

from spatula_env.cli.main import main
from spatula_env.data import EpisodeRecorder
from spatula_env.data.checking import LARGEST
from spatula_env.teleop.recording import record
from spatula_env.teleop.scripted import ScriptedOperator
from spatula_env.teleop.scripted_dataset import make_scripted

pytest.importorskip("minari", reason="pip install 'spatula-env[data]'")


@pytest.mark.parametrize("seed", [LARGEST + 1, 10**23, -1])
def test_record_refuses_them_before_anything_is_made(tmp_path, seed):
    env = make_pictures()
    with (
        ScriptedOperator(lambda _: [0.0, 0.0, 0.0]) as device,
        pytest.raises(ValueError, match="seed must be from 0 to"),
    ):
        record(env, device, ID, seed=seed, root=tmp_path)
    env.close()
    with pytest.raises(ValueError, match="seed must be from 0 to"):
        make_scripted("Spatula/Press-v0", lambda _: None, seed=seed, root=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seed", [LARGEST + 1, -1])
def test_the_recorder_refuses_them_when_an_episode_begins(seed):
    env = make_pictures()
    recorder = EpisodeRecorder(env)
    observation, info = env.reset(seed=0)
    with pytest.raises(ValueError, match="seed must be from 0 to"):
        recorder.begin(observation, info, seed)
    env.close()


def test_the_greatest_is_kept(tmp_path):
    from spatula_env.data import DatasetWriter
    from spatula_env.data.replaying import read_entries

    env = make_pictures()
    DatasetWriter(ID, env, root=tmp_path).add(do_episode(env, LARGEST))
    env.close()
    assert read_entries(ID, tmp_path)[0].seed == LARGEST


@pytest.mark.parametrize("device", ["scripted", "keyboard", "web"])
@pytest.mark.parametrize("seed", [str(LARGEST + 1), "99999999999999999999999"])
def test_the_command_says_which_are_allowed(tmp_path, device, seed, capsys):
    words = ["record", "press", "--dataset", "odd-v0", "--device", device, "--seed", seed, "--root", str(tmp_path)]
    with pytest.raises(SystemExit):
        main(words)
    assert f"must be from 0 to {LARGEST}" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["datasets", "make", "press", "--seed", seed, "--root", str(tmp_path)])
    assert list(tmp_path.iterdir()) == []
