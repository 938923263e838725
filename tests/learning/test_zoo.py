"""RL Baselines3 Zoo trains with the files in configs/rl_zoo3."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import gymnasium
import pytest
import yaml

import spatula_env

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "configs" / "rl_zoo3").glob("*.yml"))

needs_zoo = pytest.mark.skipif(
    find_spec("rl_zoo3") is None, reason="needs RL Baselines3 Zoo: the extra zoo is not installed"
)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_there_is_a_block_for_each_task(file):
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    ids = {f"Spatula/{name}-v0" for name in spatula_env.TASKS}
    if file.stem == "her":
        # What is achieved in these depends on what is asked.
        ids -= {"Spatula/Fissure-v0", "Spatula/Palpate-v0"}
    assert ids == set(content) - {"defaults"}
    for env_id in ids:
        block = content[env_id]
        env = gymnasium.make(env_id, **block["env_kwargs"])
        goals = isinstance(env.observation_space, gymnasium.spaces.Dict)
        env.close()
        assert block["policy"] == ("MultiInputPolicy" if goals else "MlpPolicy")
        assert goals == (block.get("replay_buffer_class") == "HerReplayBuffer")
        assert isinstance(block["n_timesteps"], float)


TRAIN = """
import json, sys
from rl_zoo3.train import train
for words in json.loads(sys.argv[1]):
    sys.argv = ["train", *words]
    train()
"""


def zoo_words(name, algorithm, folder):
    """What the zoo is told: two worlds, little of everything, and no evaluation, which makes an environment too."""
    small = ["n_envs:2", "env_kwargs:dict(engine='batch', max_episode_steps=20" + (
        ", reward='sparse')" if name == "her" else ")"
    )]  # fmt: skip
    small += (
        ["n_steps:20", "batch_size:20"]
        if name == "ppo"
        else ["learning_starts:60", "buffer_size:1000", "batch_size:16", "gradient_steps:1"]
    )
    return [
        "--algo", algorithm, "--env", "Spatula/Press-v0",
        "--gym-packages", "spatula_env", "--conf-file", str(ROOT / "configs" / "rl_zoo3" / f"{name}.yml"),
        "--n-timesteps", "120", "--eval-freq", "-1", "--num-threads", "1", "--device", "cpu",
        "--log-folder", str(folder / name), "--seed", "0", "--hyperparams", *small,
    ]  # fmt: skip


@needs_zoo
@pytest.mark.timeout(600)
def test_the_zoo_trains(tmp_path):
    algorithms = {"sac": "sac", "tqc": "tqc", "ppo": "ppo", "her": "sac"}
    # In one process, because starting costs most.
    command = [
        sys.executable, "-c", TRAIN,
        json.dumps([zoo_words(name, algorithm, tmp_path) for name, algorithm in algorithms.items()]),
    ]  # fmt: skip
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    for name, algorithm in algorithms.items():
        (run,) = (tmp_path / name / algorithm).iterdir()
        assert run.name == "Spatula-Press-v0_1"
        assert (run / "Spatula-Press-v0.zip").exists()
        assert (run / "Spatula-Press-v0" / "vecnormalize.pkl").exists()
