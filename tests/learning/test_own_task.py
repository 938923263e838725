"""A task of one's own, whose module nobody has imported, in every command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

from training_helpers import write_small

from spatula_env import cli
from spatula_env.envs.sb3 import make_sb3_vec_env
from spatula_env.learning import demonstrations
from spatula_env.learning.commands import clone, evaluate, export, train
from spatula_env.learning.configuration import read_training
from spatula_env.learning.evaluation import Plan
from spatula_env.learning.evaluation import evaluate as evaluate_plan
from spatula_env.learning.finding import find_policy
from spatula_env.naming import bare_id, find_environment

pytestmark = pytest.mark.usefixtures("short_evaluations")

ROOT = Path(__file__).parents[2]


def forget(module):
    """As if this process had just begun: nobody has imported the module."""
    import gymnasium

    sys.modules.pop(module, None)
    for name in [each for each in gymnasium.registry if each.startswith("Mine/")]:
        del gymnasium.registry[name]


@pytest.mark.parametrize("name", ["Press", "Alone"])
def test_worlds_are_made_for_stable_baselines(own_press, name):
    env = make_sb3_vec_env(f"{own_press}:Mine/{name}-v0", 2, seed=0)
    ours = make_sb3_vec_env("press", 2, seed=0)
    np.testing.assert_array_equal(env.reset(), ours.reset())
    env.close()
    ours.close()


@pytest.mark.parametrize("task", ["Press", "Alone"])
def test_it_is_trained_evaluated_exported_and_gone_on_with(own_press, task, tmp_path, capsys):
    env_id, output = f"{own_press}:Mine/{task}-v0", tmp_path / "run"
    file = write_small(tmp_path / "c.yaml", env_id=env_id)
    assert train.main(["--config", str(file), "--output", str(output), "--quiet"]) == 0
    assert read_training(output / "config.yaml").environment.id == env_id
    evaluating = ["--policy", str(output), "--episodes", "2", "--set", "max_episode_steps=3", "--json"]
    assert evaluate.main(["--env", env_id, *evaluating]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["env"] == env_id
    # Registered by now, it needs its module no more.
    assert evaluate.main(["--env", bare_id(env_id), *evaluating]) == 0
    longer = ["--resume", str(output), "--set", "total_steps=80", "--quiet"]
    forget(own_press)
    capsys.readouterr()
    # A file alone has nothing imported; the user has.
    assert train.main(longer) == 1
    assert "no module is imported because a file names it" in capsys.readouterr().err
    assert own_press not in sys.modules
    assert train.main([*longer, "--env", "press"]) == 1
    assert "is Mine/" in capsys.readouterr().err
    assert train.main([*longer, "--env", env_id]) == 0
    assert json.loads((output / "summary.json").read_text())["steps"] == [80]
    forget(own_press)
    exporting = [str(output), str(tmp_path / "w.npz"), "--episodes", "1", "--engines", "batch"]
    assert export.main(exporting) == 1
    assert not (tmp_path / "w.npz").exists()
    assert export.main([*exporting, "--env", env_id]) == 0
    assert find_policy(str(tmp_path / "w.npz"), env_id).description == "exported weights w.npz"


def test_it_is_evaluated_in_processes_of_their_own(own_press):
    env_id = find_environment(f"{own_press}:Mine/Press-v0")
    for name in (env_id, bare_id(env_id)):
        plan = Plan(name, {"max_episode_steps": 2}, "batch", 2, 0)
        shared, _ = evaluate_plan(find_policy("random", name), plan, processes=2)
        assert shared["steps"].tolist() == [2, 2]
        alone, _ = evaluate_plan(find_policy("random", name), plan, processes=1)
        np.testing.assert_array_equal(shared["return"], alone["return"])


def test_it_is_cloned(own_press, tmp_path, monkeypatch):
    monkeypatch.setattr(
        demonstrations, "collect_successes",
        lambda plan, **more: demonstrations.Collected(demonstrations.collect(plan, num_envs=1, steps=2), 0.0, 2),
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)
    env_id = f"{own_press}:Mine/Press-v0"
    assert clone.main(["--env", env_id, "--expert", "1", "--gradient-steps", "2", "--rounds", "1"]) == 0
    assert read_training(tmp_path / "runs" / "press_clone" / "policy" / "config.yaml").environment.id == env_id


def test_it_is_looked_at_and_recorded(own_press, tmp_path, monkeypatch, capsys):
    pytest.importorskip("minari")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    env_id, engine = f"{own_press}:Mine/Press-v0", ["--engine", "batch", "--set", "max_episode_steps=3"]
    assert cli.main(["view", env_id, "--policy", "random", "--steps", "1", "--size", "32", "--output", "a.png"]) == 0
    scripted = ["--device", "scripted", "--policy", "random", "--no-wait", "--view", "none"]
    assert cli.main(["record", env_id, "--dataset", "mine/press-v0", *engine, *scripted]) == 0
    assert cli.main(["replay", "mine/press-v0"]) == 0
    forget(own_press)
    capsys.readouterr()
    cloning = ["clone", "--dataset", "mine/press-v0", "--gradient-steps", "2", "--output", "c"]
    assert cli.main(cloning) == 1
    assert "no module is imported because a file names it" in capsys.readouterr().err
    assert own_press not in sys.modules
    assert cli.main([*cloning, "--env", env_id]) == 0


def test_the_task_of_the_documentation_is_trained(tmp_path):
    """As it is pasted, in a working directory of its own, by the commands."""
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    (tmp_path / "touch.py").write_text(page.partition("```python\n# touch.py\n")[2].partition("```")[0])
    file = write_small(tmp_path / "c.yaml", env_id="touch:Spatula/Touch-v0")
    # One process for both, because starting costs most.
    script = f"""
from spatula_env import cli
words = ["--config", {str(file)!r}, "--set", "evaluation.episodes=1", "--output", "run", "--quiet"]
assert cli.main(["train", *words]) == 0
words = ["--policy", "run", "--episodes", "2", "--processes", "1", "--set", "max_episode_steps=10"]
assert cli.main(["evaluate", "--env", "touch:Spatula/Touch-v0", *words]) == 0
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
