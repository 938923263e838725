from __future__ import annotations

import errno
import json
from dataclasses import dataclass

import numpy as np
import pytest

from spatula_env.data.statistics import wilson_interval
from spatula_env.learning.commands.evaluate import describe, main
from spatula_env.learning.evaluation import MEASURES, Plan, evaluate, run_episodes, summarize
from spatula_env.learning.finding import find_policy
from spatula_env.learning.policies import PolicySource

PRESS = "Spatula/Press-v0"


def plan(episodes=4, engine="batch", seed=0, **kwargs):
    return Plan(PRESS, {"max_episode_steps": 12, **kwargs}, engine, episodes, seed)


def assert_same(first, second, tolerance=0.0):
    for name in MEASURES:
        np.testing.assert_allclose(first[name], second[name], rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("name", ["expert", "random"])
def test_episodes_do_not_depend_on_how_many_worlds_there_are(name):
    source = find_policy(name, PRESS)
    results = []
    for worlds in (1, 2, 3):
        env = plan().make(worlds)
        results.append(run_episodes(env, source.make(env), [5, 6, 7, 8]))
        env.close()
    assert len(results[0]["return"]) == 4
    assert len(set(results[0]["return"])) == 4
    # Single precision in the batch engine.
    for other in results[1:]:
        np.testing.assert_allclose(other["return"], results[0]["return"], atol=1e-3)
        np.testing.assert_allclose(other["path_length"], results[0]["path_length"], atol=1e-5)


@pytest.mark.bullet
def test_processes_share_the_episodes():
    source = find_policy("random", PRESS)
    alone, _ = evaluate(source, plan(3, "bullet", max_episode_steps=4), processes=1)
    shared, rate = evaluate(source, plan(3, "bullet", max_episode_steps=4), processes=2)
    assert_same(alone, shared, 1e-9)
    assert rate > 0.0


@dataclass(frozen=True)
class Straight:
    """Goes along x at a share of the greatest speed."""

    share: float

    def begin(self, seeds):
        pass

    def __call__(self, observation):
        return np.tile(np.float32([self.share, 0.0, 0.0]), (len(observation), 1))


def test_the_way_is_measured():
    source = PolicySource(lambda env: Straight(0.5))
    episodes, _ = evaluate(source, plan(2, max_episode_steps=6))
    np.testing.assert_allclose(episodes["path_length"], 6 * 0.05 * 0.05, rtol=1e-4)
    assert episodes["steps"].tolist() == [6, 6]
    assert np.isnan(episodes["time_to_success"]).all()


def test_an_expert_succeeds_and_stops_if_it_may():
    source = find_policy("expert", PRESS)
    whole, _ = evaluate(source, plan(2, max_episode_steps=80), end_at_success=False)
    short, _ = evaluate(source, plan(2, max_episode_steps=80))
    assert whole["success"].all() and short["success"].all()
    assert whole["steps"].tolist() == [80, 80]
    # Each ends for itself.
    np.testing.assert_allclose(short["steps"] * 0.05, short["time_to_success"])
    assert len(set(short["steps"])) == 2
    # As if what is left after success had paid the best: no less than staying did.
    assert (short["return"] >= whole["return"]).all()
    assert (short["return"] <= 80.0).all()
    np.testing.assert_array_equal(whole["time_to_success"], short["time_to_success"])
    assert (whole["time_to_success"] >= 0.5).all()
    assert (whole["dose"] > 0.0).any() == bool((whole["peak_pressure"] > 2670.0).any())
    np.testing.assert_array_equal(whole["violation"], whole["peak_pressure"] > 4000.0)


def test_what_is_told_of_episodes():
    episodes = {name: np.zeros(4) for name in MEASURES}
    episodes.update(
        success=np.array([True, True, True, False]),
        violation=np.array([True, False, False, False]),
        diverged=np.zeros(4, dtype=bool),
        time_to_success=np.array([1.0, 2.0, 6.0, np.nan]),
        peak_force=np.array([1.0, 2.0, 3.0, 6.0]),
    )
    told = summarize(episodes)
    assert told["success_rate"] == 0.75
    assert told["success_interval"] == pytest.approx(wilson_interval(3, 4))
    assert told["violation_rate"] == 0.25
    assert (told["time_to_success"], told["time_to_success_median"]) == (3.0, 2.0)
    assert (told["peak_force"], told["peak_force_max"]) == (3.0, 6.0)
    episodes.update(success=np.zeros(4, dtype=bool), time_to_success=np.full(4, np.nan))
    told = summarize(episodes)
    assert told["time_to_success"] is None
    assert json.loads(json.dumps(told)) == told
    report = {"policy": "p", "env": "e", "engine": "batch", "steps_per_second": 1.0, **told}
    assert "time to success  never" in describe(report)


def test_the_command_ends_with_one_json_object(capsys):
    status = main(
        ["--env", PRESS, "--policy", "random", "--engine", "batch", "--episodes", "2", "--seed", "3", "--json",
         "--set", "max_episode_steps=5"]
    )  # fmt: skip
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert status == 0
    assert (report["env"], report["policy"], report["episodes"], report["seed"]) == (PRESS, "random", 2, 3)
    assert report["steps"] == 5
    assert set(report) >= {
        "success_rate", "success_interval", "return", "cost", "violation_rate", "peak_force", "peak_pressure",
        "time_to_success", "path_length", "steps_per_second",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env", "Spatula/Nothing-v0", "--policy", "random"], "Nothing"),
        (["--env", "CartPole-v1", "--policy", "random"], "environment of this package"),
        (["--env", PRESS, "--policy", "/no/such/policy"], "no /no/such/policy"),
        (["--env", PRESS, "--policy", "random", "--set", "smell=3"], "unexpected keyword argument 'smell'"),
    ],
)
def test_what_is_wrong_is_said(arguments, message, capsys):
    assert main([*arguments, "--episodes", "1"]) == 1
    assert message in capsys.readouterr().err


def test_a_module_that_is_missing_is_no_extra_of_ours(capsys):
    assert main(["--env", "no_such_module:Mine/Press-v0", "--policy", "random", "--episodes", "1"]) == 1
    said = capsys.readouterr().err
    assert "names a module that cannot be imported" in said and "pip install" not in said


@pytest.mark.parametrize("arguments", [["--episodes", "0"], ["--seed", "-1"], ["--video", "film.txt"]])
def test_impossible_numbers_are_refused(arguments, capsys):
    with pytest.raises(SystemExit):
        main(["--env", PRESS, "--policy", "random", *arguments])
    assert arguments[0] in capsys.readouterr().err


def test_a_film_that_may_not_be_written_is_told_in_a_line(tmp_path, monkeypatch, capsys):
    def refuse(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    # Not by the folder's mode, which root may ignore.
    monkeypatch.setattr("spatula_env.files.tempfile.TemporaryFile", refuse)
    monkeypatch.setattr("spatula_env.learning.commands.evaluate.check_film", lambda path: None)
    monkeypatch.setattr("spatula_env.learning.evaluation.evaluate", lambda *_, **__: pytest.fail("an episode was run"))
    assert main(["--env", PRESS, "--policy", "random", "--video", str(tmp_path / "x.mp4")], "evaluate") == 1
    assert capsys.readouterr().err == f"evaluate: {tmp_path} cannot be written to: permission denied in {tmp_path}\n"


def test_a_film_is_written(tmp_path):
    pytest.importorskip("PIL")
    from spatula_env.learning.evaluation import film

    source = find_policy("random", PRESS)
    film(source, plan(1, max_episode_steps=2, width=64, height=64), tmp_path / "film.gif")
    assert (tmp_path / "film.gif").read_bytes()[:3] == b"GIF"
