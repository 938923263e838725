from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, version

import gymnasium as gym
import pytest
from fresh_interpreter import ROOT, run_code
from gymnasium.envs.registration import EnvSpec

import spatula_env


def test_importing_loads_no_engine_compiler_or_learning_library() -> None:
    code = (
        "import sys, json, spatula_env, gymnasium; assert 'Spatula/Press-v0' in gymnasium.registry;"
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    )
    loaded = json.loads(run_code(code))
    assert "spatula_env" in loaded
    for heavy in (
        "pybullet",
        "numba",
        "llvmlite",
        "torch",
        "stable_baselines3",
        "matplotlib",
        "scipy",
        "PIL",
    ):
        assert heavy not in loaded


def test_gymnasium_imports_the_package_by_the_id() -> None:
    code = (
        "import gymnasium; env = gymnasium.make('spatula_env:Spatula/Press-v0');"
        "env.reset(seed=0); print(type(env.unwrapped).__name__, env.spec.max_episode_steps); env.close()"
    )
    assert run_code(code).split()[-2:] == ["PressEnv", "200"]


def test_many_are_made_by_the_same_id() -> None:
    code = (
        "import gymnasium; env = gymnasium.make_vec('spatula_env:Spatula/Press-v0', num_envs=2);"
        "env.reset(seed=0); print(type(env).__name__, env.num_envs, env.max_episode_steps); env.close()"
    )
    assert run_code(code).split()[-3:] == ["PressVectorEnv", "2", "200"]


def test_a_specification_makes_many_again() -> None:
    env = gym.make_vec("Spatula/Press-v0", num_envs=2, reward="sparse", autoreset_mode="same_step", max_episode_steps=7)
    assert env.spec is not None
    again = gym.make_vec(env.spec)
    assert again.num_envs == 2
    assert again.metadata["autoreset_mode"] == env.metadata["autoreset_mode"]
    assert again.max_episode_steps == 7
    assert again.single_observation_space == env.single_observation_space
    env.close()
    again.close()


def test_the_specification_can_be_written_to_a_file() -> None:
    spec = gym.spec("Spatula/Press-v0")
    assert isinstance(spec.entry_point, str)
    assert isinstance(spec.vector_entry_point, str)
    assert not spec.nondeterministic
    with gym.make(spec, reward="sparse", task={"depth_range": [0.006, 0.01]}) as env:
        assert env.spec is not None
        engine = env.unwrapped.settings.engine
        written = env.spec.to_json()
    with gym.make(EnvSpec.from_json(written)) as again:
        assert again.spec is not None
        chosen = {"reward": "sparse", "task": {"depth_range": [0.006, 0.01]}, "engine": engine}
        assert again.spec.kwargs == {"episode_time": 10.0, **chosen}
        again.reset(seed=0)
        assert 0.006 <= again.unwrapped.goal[2] <= 0.01


def test_lazy_names_are_the_real_ones() -> None:
    from spatula_env import Simulation, scenes
    from spatula_env.sim.simulation import Simulation as Original

    assert Simulation is Original
    assert scenes.seed().name == "seed"
    assert {"Simulation", "scenes", "__version__"} <= set(dir(spatula_env))
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        _ = spatula_env.nonsense


def test_the_version_is_that_of_the_distribution() -> None:
    try:
        assert spatula_env.__version__ == version("spatula-env")
    except PackageNotFoundError:
        pyproject = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
        assert f'\nversion = "{spatula_env.__version__}"\n' in pyproject
