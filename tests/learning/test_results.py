from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("stable_baselines3")
pytest.importorskip("scipy")
pytest.importorskip("matplotlib", reason="pictures are drawn with matplotlib: the extra results is not installed")

from spatula_env.learning.commands.results import main
from spatula_env.learning.configuration import CONFIG_FOLDERS, find_config
from spatula_env.learning.evaluation import MEASURES, Plan
from spatula_env.learning.results import runs as making
from spatula_env.learning.results.gather import gather
from spatula_env.learning.results.page import write_page
from spatula_env.learning.results.pictures import draw_pictures
from spatula_env.learning.results.plan import BootstrapPlan, planned_references, planned_runs, read_plan
from spatula_env.learning.results.statistics import estimate, estimate_columns, first_reaching, on_grid, when_reached
from spatula_env.learning.saving import provenance, write_json

PRESS = "Spatula/Press-v0"

TRAINING = {
    "environment": {
        "id": PRESS,
        "kwargs": {"max_episode_steps": 10},
        "parts": ["tool_position", "error"],
        "num_envs": 4,
    },
    "algorithm": "sac",
    "hyperparameters": {"learning_starts": 20, "batch_size": 16, "gradient_steps": 1, "buffer_size": 2000},
    "network": {"layers": [16]},
    "total_steps": 120,
    "evaluation": {"every": 40, "episodes": 1},
    "checkpoint_every": 40,
    "success_target": None,
}


def write_plan(folder, **changes):
    """A plan of two algorithms and two seeds on one task, in a folder of its own."""
    (folder / "tiny.yaml").write_text(yaml.safe_dump(TRAINING))
    config = str(folder / "tiny.yaml")
    content = {
        "runs": str(folder / "runs"),
        "page": str(folder / "docs" / "results.md"),
        "pictures": str(folder / "docs" / "images"),
        "seeds": [0, 1],
        "evaluation": {"episodes": 1, "seed": 5, "engines": ["batch", "bullet"]},
        "bootstrap": {"resamples": 100},
        "tasks": {
            "press": {
                "environment": PRESS,
                "algorithms": {"sac": {"config": config, "label": "SAC"}, "clone": {"config": config, "clone": 2}},
            }
        },
        **changes,
    }
    file = folder / "plan.yaml"
    file.write_text(yaml.safe_dump(content))
    return file


def test_the_plan_of_the_documentation_can_be_read():
    plan = read_plan(find_config("results"))
    assert len(plan.seeds) == 5
    assert {"press", "retract", "fissure", "clamp", "palpate"} == set(plan.tasks)
    everything = planned_runs(plan)
    assert len({run.folder for run in everything}) == len(everything)
    for run in everything:
        assert run.plan.read(run.seed).seeds == (run.seed,)
    # Seed by seed, so that an interrupted plan has something of everything.
    assert [run.seed for run in everything] == sorted(run.seed for run in everything)
    assert plan.evaluation.episodes == 200
    for task in plan.tasks.values():
        assert {"sac_scratch", "ppo", "clone"} <= set(task.algorithms)
        for name in ("sac_scratch", "ppo"):
            assert task.algorithms[name].read(0).demonstrations == 0
    assert {run.name for run in planned_references(plan)} == {"expert", "proportional", "random", "pretrained"}
    some = planned_runs(plan, ["retract"], ["sac"], [0, 1])
    assert [(run.task, run.name, run.seed) for run in some] == [("retract", "sac", 0), ("retract", "sac", 1)]
    with pytest.raises(ValueError, match=r"algorithms must be some of .*'sac'.*, got \['dqn'\]"):
        planned_runs(plan, algorithms=["dqn"])
    with pytest.raises(ValueError, match=r"seeds must be some of \[0, 1, 2, 3, 4\], got \[7\]"):
        planned_runs(plan, seeds=[7])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tasks": {}, "seed": 3}, r"unknown keys \['seed'\]"),
        ({"tasks": [1]}, "key 'tasks'"),
        ({"tasks": {"press": {"environment": PRESS}}}, "'environment' and 'algorithms'"),
        (
            {"tasks": {"clamp": {"environment": "Spatula/Clamp-v0", "algorithms": {"sac": {"config": "press_sac"}}}}},
            "press_sac is for Spatula/Press-v0, not Spatula/Clamp-v0",
        ),
        (
            {"tasks": {"x": {"environment": "No-v0", "algorithms": {}}}},
            "must be the id of an environment: there is no environment 'No-v0'",
        ),
        ({"tasks": {}, "evaluation": {"engines": ["steam"]}}, "engines must be one of"),
        ({"tasks": {}, "references": ["oracle"]}, "references must be some of"),
        ({"tasks": {}, "thresholds": [80]}, r"thresholds must be in \(0, 1\], got 80"),
        ({"tasks": {}, "bootstrap": {"confidence": 95}}, "confidence must be between 0 and 1"),
    ],
)
def test_what_is_wrong_with_a_plan_is_said(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        read_plan(write_plan(tmp_path, **changes))


def test_interquartile_means_leave_the_ends_out():
    plan = BootstrapPlan(resamples=500)
    told = estimate([[0.0, 0.5, 0.6, 0.7, 1.0]], plan)
    assert told.value == pytest.approx(0.6)
    assert 0.0 < told.low < told.value < told.high < 1.0
    constant = estimate([[0.9] * 5], plan)
    assert (constant.value, constant.low, constant.high) == (0.9, 0.9, 0.9)
    alone = estimate([[0.4]], plan)
    assert (alone.value, alone.low, alone.high) == (0.4, None, None)
    with pytest.raises(ValueError, match="one sample each"):
        estimate([[]], plan)


def test_resamples_are_drawn_within_tasks():
    """Two tasks whose seeds agree among each other: the whole has no spread, although the tasks differ."""
    told = estimate([[0.2] * 4, [0.8] * 4], BootstrapPlan(resamples=200))
    assert told.low == told.value == told.high == pytest.approx(0.5)
    mixed = estimate([[0.2, 0.8, 0.2, 0.8], [0.2, 0.8, 0.2, 0.8]], BootstrapPlan(resamples=200))
    assert mixed.low < mixed.value < mixed.high


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    generator = np.random.default_rng(0)
    plan, hits = BootstrapPlan(resamples=200), 0
    for _ in range(60):
        told = estimate([generator.normal(1.0, 0.3, 30)], plan)
        hits += told.low <= 1.0 <= told.high
    assert 49 <= hits <= 60


CURVE = [
    {"step": 100, "success_rate": 0.1, "seconds": 5.0},
    {"step": 200, "success_rate": 0.9, "seconds": 9.0},
    {"step": 300, "success_rate": 0.7, "seconds": 12.0},
]


def test_thresholds_are_reached_when_they_first_are():
    assert first_reaching(CURVE, 0.8) == (200.0, 9.0)
    assert first_reaching(CURVE, 0.95) is None
    late = [{"step": 400, "success_rate": 1.0, "seconds": 40.0}]
    told = when_reached([CURVE, late, late], 0.8)
    assert (told.count, told.of, told.steps, told.seconds) == (3, 3, 400.0, 40.0)
    # Steps of demonstrations are steps: what began as a clone has not learned for nothing.
    cloned = [{"step": 0, "demonstration_steps": 2000, "success_rate": 0.85, "seconds": 3.0}, *CURVE]
    assert first_reaching(cloned, 0.8) == (2000.0, 3.0)
    # Most never did.
    told = when_reached([CURVE, late, CURVE], 0.95)
    assert (told.count, told.of, told.steps, told.seconds) == (1, 3, None, None)


def test_curves_are_read_off_between_evaluations():
    grid = np.array([50.0, 100.0, 150.0, 300.0, 900.0])
    np.testing.assert_allclose(on_grid(CURVE, grid), [np.nan, 0.1, 0.5, 0.7, 0.7])
    later = [{**line, "demonstration_steps": 50} for line in CURVE]
    np.testing.assert_allclose(on_grid(later, grid + 50), on_grid(CURVE, grid))
    value, low, high = estimate_columns(np.array([[0.1, 0.5], [0.1, 0.7], [0.1, 0.9]]), BootstrapPlan(resamples=50))
    np.testing.assert_allclose(value, [0.1, 0.7])
    assert (low <= value).all() and (value <= high).all()
    assert low[0] == high[0]
    assert low[1] < high[1]


def pretend(run, rates, curve=None):
    """What a finished run leaves, with these success rates in the engines."""
    run.folder.mkdir(parents=True)
    if run.seed is not None:
        write_json(run.folder / "summary.json", {"steps": [3000], "seconds": [60.0], "demonstration_steps": [700]})
        folder = run.folder / f"seed-{run.seed}"
        folder.mkdir()
        (folder / "curve.jsonl").write_text("".join(json.dumps(line) + "\n" for line in curve or CURVE))
    for engine, rate in rates.items():
        summary = {
            "success_rate": rate, "success_interval": [rate / 2, rate], "return": 12.5, "cost": 1234.0,
            "safe_success_rate": rate / 2,
            "violation_rate": 0.25, "time_to_success": None if rate == 0.0 else 2.5,
        }  # fmt: skip
        write_json(
            making.evaluation_file(run, engine),
            {"key": {}, "summary": summary, "provenance": provenance("Spatula/Press-v0")},
        )


def pretended_plan(tmp_path):
    config = str(tmp_path / "tiny.yaml")
    algorithms = {"sac": {"config": config, "label": "SAC"}, "tqc": {"config": config, "label": "TQC"}}
    tasks = {"press": {"environment": PRESS, "note": "A note.", "algorithms": algorithms}}
    plan = read_plan(write_plan(tmp_path, tasks=tasks, seeds=[0, 1, 2, 3, 4]))
    every = planned_runs(plan)
    for run, rate in zip([run for run in every if run.name == "sac"], (0.5, 0.8, 0.9, 1.0, 1.0), strict=True):
        pretend(run, {"batch": rate, "bullet": rate - 0.1})
    pretend(next(run for run in every if run.name == "tqc"), {"batch": 0.6})
    for run, rate in zip(planned_references(plan), (1.0, 0.0), strict=True):
        pretend(run, {"batch": rate, "bullet": rate})
    return plan


def cells(page, label, heading):
    """The cells of the row with a label, in the table under a heading."""
    lines = page.split(heading, 1)[1].splitlines()
    row = next(line for line in lines if line.startswith(f"| {label} |"))
    return [cell.strip() for cell in row.strip("|").split("|")]


def test_the_page_tells_what_the_runs_say(tmp_path):
    plan = pretended_plan(tmp_path)
    page = write_page(plan, gather(plan), [])
    assert "Not finished yet: press with tqc (1 of 5 seeds)." in page
    assert "## Press\n\nA note.\n" in page
    row = cells(page, "SAC", "In the batch engine")
    # Interquartile: the mean of 0.8, 0.9 and 1.0, which knows nothing of the seed that has 0.5.
    assert row[1:3] == ["5", "3 700"] and row[3].startswith("90.0 [") and row[4:6] == ["84.0", "50.0"]
    assert row[6].startswith("45.0 [") and row[8].startswith("1234 [") and row[9].startswith("25.0 [")
    assert cells(page, "TQC", "In the batch engine")[1:6] == ["1", "3 700", "60.0", "60.0", "60.0"]
    expert = cells(page, "scripted expert", "In the batch engine")
    assert expert[1:7] == ["–", "–", "100.0 [50.0, 100.0]", "–", "–", "50.0"]
    assert cells(page, "random actions", "In the batch engine")[-1] == "–"
    learning = cells(page, "SAC", "When an evaluation")
    assert learning == ["SAC", "5 of 5", "200", "0.1 min", "0 of 5", "–", "–", "700", "3 700", "1.0 min"]
    there = cells(page, "SAC", "The same policies in Bullet")
    assert there[1].startswith("80.0 [") and there[2:4] == ["40.0", "-10.0"]
    overall = cells(page, "SAC", "## All tasks")
    assert overall[-3].startswith("90.0 [") and overall[-2:] == ["84.0", "50.0"]
    assert cells(page, "scripted expert", "## All tasks")[-3:] == ["–", "–", "–"]
    assert "beside scripted expert and random actions" in page
    assert "[definition](definitions.md) 2" in page
    assert "](images/results_press.png)" in page and "](images/results_success.png)" in page


def test_the_page_tells_of_which_part_of_the_plan_it_is(tmp_path):
    plan = pretended_plan(tmp_path)
    rows = gather(plan)
    assert "last added to" not in write_page(plan, rows, [], "python -m agents.results")
    part = "python -m agents.results --engines batch"
    assert f"What is here was last added to with `{part}`." in write_page(plan, rows, [], part)


def test_some_engines_do(tmp_path, capsys):
    pretended_plan(tmp_path)
    arguments = ["--plan", str(tmp_path / "plan.yaml"), "--page"]
    assert main([*arguments, "--engines", "batch"], "python -m agents.results") == 0
    page = (tmp_path / "docs" / "results.md").read_text()
    assert "In the batch engine" in page and "The same policies in Bullet" not in page
    assert "--page --engines batch`" in page
    write_plan(tmp_path, evaluation={"episodes": 1, "engines": ["batch"]})
    assert main([*arguments, "--engines", "bullet"]) == 1
    assert "engines must be some of ['batch'], got ['bullet']" in capsys.readouterr().err


def test_pictures_show_something_and_are_small(tmp_path):
    from PIL import Image

    plan = pretended_plan(tmp_path)
    files = draw_pictures(plan, gather(plan))
    assert [file.name for file in files] == ["results_press.png", "results_success.png"]
    for file in files:
        assert file.stat().st_size < 200_000
        with Image.open(file) as picture:
            pixels = np.asarray(picture.convert("RGB"), dtype=int)
        # The colour of SAC is there.
        assert (np.abs(pixels - [0x00, 0x72, 0xB2]).max(axis=-1) < 12).sum() > 20, file.name


@pytest.fixture
def _short_evaluations(monkeypatch):
    make = Plan.make

    def make_short(self, count, **more):
        return make(self, count, **{"max_episode_steps": 10, **more})

    monkeypatch.setattr(Plan, "make", make_short)


@pytest.mark.bullet
@pytest.mark.usefixtures("_short_evaluations")
def test_a_small_plan_is_carried_out_once_and_gone_on_with(tmp_path, capsys, monkeypatch):
    file = write_plan(tmp_path)
    page = tmp_path / "docs" / "results.md"
    arguments = ["--plan", str(file), "--algorithms", "sac", "--seeds", "0"]
    assert main(arguments) == 0, capsys.readouterr().err
    told = capsys.readouterr().out
    assert "press sac seed 0: begins" in told and "evaluated in the bullet engine" in told
    assert str(page) in told.splitlines()
    assert "1 of 2 seeds" in page.read_text()
    plan = read_plan(file)
    (run,) = planned_runs(plan, algorithms=["sac"], seeds=[0])
    kept = json.loads(making.evaluation_file(run, "batch").read_text())
    assert set(kept["episodes"]) == set(MEASURES)
    assert kept["summary"]["episodes"] == 1
    # Nothing is left to do.
    with monkeypatch.context() as patch:
        patch.setattr(making.subprocess, "Popen", None)
        patch.setattr(making, "evaluate", None)
        assert main(arguments) == 0
    told = capsys.readouterr().out
    assert "1 of 1 runs are finished" in told and "evaluated" not in told
    # As if it had been killed before it was over: the last checkpoint is there, and the end is not.
    (run.folder / "summary.json").unlink()
    (run.folder / "seed-0" / "summary.json").unlink()
    assert making.command_of(run)[-2:] == [str(run.folder), "--quiet"]
    assert main([*arguments, "--runs"]) == 0
    assert "press sac seed 0: goes on" in capsys.readouterr().out
    assert json.loads((run.folder / "summary.json").read_text())["steps"] == [120]
    # Nor is an agent that was made for another definition of the task evaluated in this one.
    places = [place for place in run.folder.rglob("provenance.json")]
    for place in places:
        place.write_text(json.dumps({**json.loads(place.read_text()), "definition": 1}))
    assert main([*arguments, "--again"]) == 1
    assert "was made for definition 1 of the task, the present one is 2" in capsys.readouterr().err
    # A run of another configuration is not taken for this one.
    (run.folder / "summary.json").unlink()
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump({**TRAINING, "total_steps": 160}))
    assert main(arguments) == 1
    assert "begun with other values of total_steps" in capsys.readouterr().err


def test_a_run_that_fails_is_told_and_the_others_go_on(tmp_path, capsys, monkeypatch):
    file = write_plan(tmp_path)
    monkeypatch.setattr(making, "command_of", lambda run: ["false"] if run.name == "sac" else ["true"])
    assert main(["--plan", str(file), "--runs", "--jobs", "2"]) == 1
    told = capsys.readouterr()
    assert told.err.count("failed with status 1") == 2
    assert told.out.count("clone") == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--plan", "none"], "no none"),
        (["--tasks", "dance"], "tasks must be some of"),
        (["--seeds", "99"], "seeds must"),
    ],
)
def test_what_is_wrong_is_said(arguments, message, capsys):
    assert main(arguments) == 1
    assert message in capsys.readouterr().err


def test_a_page_of_nothing_is_not_written(tmp_path, capsys):
    assert main(["--plan", str(write_plan(tmp_path)), "--page"]) == 1
    assert "nothing to write of yet" in capsys.readouterr().err


def test_configurations_are_found_by_name(tmp_path):
    assert find_config("press_sac") == CONFIG_FOLDERS[1] / "press_sac.yaml"
    own = tmp_path / "press_sac"
    own.write_text("")
    assert find_config(own) == own
    with pytest.raises(FileNotFoundError, match=r"one of .*press_sac.*: no dance_sac"):
        find_config("dance_sac")
    assert Path(find_config("results")).name == "results.yaml"
