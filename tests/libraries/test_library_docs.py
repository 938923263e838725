"""The code in docs/rl-libraries.md runs; with fewer worlds and steps than there, to be quick."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from spatula_env.data import DatasetWriter, Episode, Layout

PAGE = (Path(__file__).parents[2] / "docs" / "rl-libraries.md").read_text(encoding="utf-8")
SECTIONS = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
BLOCKS = [
    (section.partition("\n")[0], code)
    for section in SECTIONS
    for code in re.findall(r"^```python\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)
]
LIBRARIES = ("d3rlpy", "masa", "omnisafe", "rl_games", "sbx", "skrl", "stable_baselines3", "tianshou", "torchrl")
SMALLER = {
    "num_envs=64": "num_envs=4",
    '"Spatula/Press-v0", 64': '"Spatula/Press-v0", 4',
    "max_episode_steps=100": "max_episode_steps=10",
    '"max_episode_steps": 100': '"max_episode_steps": 10',
    "learning_starts=6_400, gradient_steps=8": "learning_starts=16, gradient_steps=1",
    "learn(12_800)": "learn(64)",
    "rollout(200": "rollout(20",
    '"rollouts": 50': '"rollouts": 4',
    '"learning_epochs": 10': '"learning_epochs": 2',
    '"timesteps": 200': '"timesteps": 8',
    "range(100)": "range(10)",
    '"num_actors": 64': '"num_actors": 4',
    '"horizon_length": 50': '"horizon_length": 16',
    '"minibatch_size": 800': '"minibatch_size": 32',
    '"mini_epochs": 10': '"mini_epochs": 2',
    "n_episode=96": "n_episode=6",
    "(400_000, 64)": "(4_000, 4)",
    "sample_size=256": "sample_size=16",
    '"total_steps": 12_800, "vector_env_nums": 64': '"total_steps": 80, "vector_env_nums": 4',
    '"steps_per_epoch": 6_400': '"steps_per_epoch": 40',
    "batch_size=256": "batch_size=16",
    "n_steps=100, n_steps_per_epoch=50": "n_steps=4, n_steps_per_epoch=2",
}


def needed(code: str) -> tuple[str, ...]:
    """The libraries that some code imports."""
    imported = set(re.findall(r"^(?:from|import) (\w+)", code, flags=re.MULTILINE))
    return tuple(name for name in LIBRARIES if name in imported)


def write_dataset(root: Path) -> None:
    """A few episodes of the environment's shape, under the name that the page has."""
    env: Any = SimpleNamespace(
        spec=gym.spec("Spatula/Press-v0"),
        observation_space=spaces.Box(-1.0, 1.0, (5,), np.float32),
        action_space=spaces.Box(-1.0, 1.0, (3,), np.float32),
    )
    writer = DatasetWriter("spatula/press/scripted-v0", env, root=root, layout=Layout())
    generator = np.random.default_rng(0)
    for steps in (12, 9):
        writer.add(
            Episode(
                observations=generator.uniform(-1.0, 1.0, (steps + 1, 5)).astype(np.float32),
                actions=generator.uniform(-1.0, 1.0, (steps, 3)).astype(np.float32),
                rewards=np.ones(steps),
                terminations=np.zeros(steps, dtype=np.bool_),
                truncations=np.arange(steps) == steps - 1,
                infos={},
                seed=0,
                attributes={"success": True},
            )
        )


def test_all_that_is_made_smaller_is_there() -> None:
    assert [name for name in SMALLER if not any(name in code for _, code in BLOCKS)] == []


@pytest.mark.parametrize(
    "code",
    [
        pytest.param(code, id=f"{section}-{number}", marks=pytest.mark.libraries(*needed(code)) if needed(code) else ())
        for number, (section, code) in enumerate(BLOCKS)
    ],
)
def test_a_block_runs_as_pasted(
    code: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if "load_d3rlpy" in code:
        pytest.importorskip("minari")
        monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
        write_dataset(tmp_path)
    smaller = code
    for name, less in SMALLER.items():
        smaller = smaller.replace(name, less)
    scope: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(smaller, "rl-libraries.md", "exec"), scope)
    if "make_env" in scope:
        envs = scope["make_env"](n_envs=2)
        observations, _ = envs.reset(seed=0)
        assert observations in envs.observation_space
        envs.close()
    printed = capsys.readouterr().out.splitlines()
    told = [one.replace("64", "4") for one in re.findall(r"print\(.*\)  # (.*)", code)]
    assert printed[len(printed) - len(told) :] == told
