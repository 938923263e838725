"""The training commands: checks before anything is written, resuming, and never replacing files unasked."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import yaml

pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

from training_helpers import write_small

from spatula_env import cli
from spatula_env.learning import checks, cloning, demonstrations
from spatula_env.learning.commands import clone, evaluate, export, train
from spatula_env.learning.configuration import read_training, training_from_mapping
from spatula_env.learning.folders import occupied
from spatula_env.learning.saving import checkpoints_in, read_curve

pytestmark = pytest.mark.usefixtures("short_evaluations")

ROOT = Path(__file__).parents[2]


@pytest.fixture
def run(tmp_path):
    """A run that has ended, after sixty steps."""
    output = tmp_path / "a"
    assert train.main(["--config", str(write_small(tmp_path / "c.yaml")), "--output", str(output), "--quiet"]) == 0
    return output


@pytest.fixture
def quick_experts(monkeypatch):
    """Experts that demonstrate two steps, and succeed at nothing."""
    monkeypatch.setattr(
        demonstrations, "collect_successes",
        lambda plan, **more: demonstrations.Collected(demonstrations.collect(plan, num_envs=1, steps=2), 0.0, 2),
    )  # fmt: skip


def listing(folder):
    return {str(file.relative_to(folder)): file.stat().st_mtime_ns for file in folder.rglob("*") if file.is_file()}


REFUSED = [
    ("sac", "environment.kwargs.max_sped=0.05", "unexpected keyword argument 'max_sped'"),
    ("sac", "environment.kwargs.contact=bullet", "contact"),
    ("sac", "environment.kwargs.control_frequency=7", "control_frequency"),
    ("sac", "environment.parts=[smell]", "no parts ['smell']"),
    ("sac", "environment.kwargs.observation.image_size=[1, 1]", "image_size"),
    ("sac", "total_steps=1", "total_steps must be 2 or more, got 1"),
    ("sac", "hyperparameters.batch_size=501", "buffer_size must be 501 or more, got 500"),
    ("sac", "hyperparameters.ent_coef=auto_much", "auto_much"),
    ("sac", "hyperparameters.ent_coef=auto_0", "'auto_X' with a positive X, got 'auto_0'"),
    ("tqc", "hyperparameters.top_quantiles_to_drop_per_net=25", "must be less than n_quantiles, 25, got 25"),
    ("ppo", "hyperparameters.batch_size=21", "batch_size must be from 2 to 20, got 21"),
    ("ppo", "hyperparameters.batch_size=1", "batch_size must be from 2 to 20, got 1"),
    ("ppo", "total_steps=19", "total_steps must be 20 or more, got 19"),
    ("sac_her", "hyperparameters.learning_starts=19", "learning_starts must be 20 or more, got 19 (2 worlds x 10"),
    ("sac_her", "hyperparameters.buffer_size=39", "buffer_size must be 40 or more, got 39"),
    ("sac_her", "environment.kwargs.terminate_on_success=true", "terminate_on_success must be left out with algorithm"),
    ("sac_her", "environment.id=Spatula/Palpate-v0", "algorithm must not be 'sac_her' with Spatula/Palpate-v0"),
    ("sac_her", "environment.kwargs.damage_limit=10.0", "damage_limit must be left out with algorithm 'sac_her'"),
    (
        "sac_her",
        "environment.kwargs.level=hard",
        "pressure_limit must be None, as level 'hard' sets it, with algorithm",
    ),
    ("sac", "environment.id=Spatula/Knead-v0", "there is no environment 'Spatula/Knead-v0'"),
    ("sac", "environment.id=CartPole-v1", "must be an environment of this package or built on it"),
]


@pytest.mark.parametrize(("algorithm", "change", "message"), REFUSED, ids=[f"{a}-{c}" for a, c, _ in REFUSED])
def test_what_cannot_be_trained_leaves_nothing(algorithm, change, message, tmp_path, capsys):
    if algorithm == "tqc":
        pytest.importorskip("sb3_contrib")
    file, output = write_small(tmp_path / "c.yaml", algorithm), tmp_path / "run"
    assert train.main(["--config", str(file), "--set", change, "--output", str(output), "--quiet"]) == 1
    said = capsys.readouterr().err.strip()
    assert message in said
    # One line, and not a traceback of somebody else's.
    assert said.startswith("spatula train: ") and "\n" not in said
    assert not output.exists()


def test_what_has_demonstrations_is_checked_before_they_are_made():
    content = yaml.safe_load((ROOT / "configs" / "retract_sac.yaml").read_text())
    content["environment"]["kwargs"]["terminate_on_success"] = True
    with pytest.raises(ValueError, match="terminate_on_success must be left out with demonstrations"):
        checks.check_training(training_from_mapping(content))
    content["environment"].update(kwargs={"obs_mode": "rgb"}, parts=None)
    content["hyperparameters"]["buffer_size"] = 1000
    with pytest.raises(ValueError, match="demonstration_share must be 0 where observations are a dictionary"):
        checks.check_training(training_from_mapping(content))


def test_a_buffer_must_have_room(tmp_path, monkeypatch):
    monkeypatch.setattr(checks, "memory", lambda: 1_000_000)
    config = read_training(write_small(tmp_path / "c.yaml", obs_mode="rgb", observation={"image_size": [32, 32]}))
    with pytest.raises(ValueError, match=r"hyperparameters.buffer_size must be \d+ at most here: one observation"):
        checks.check_training(config)
    chosen = dataclasses.replace(config.hyperparameters, buffer_size=100)
    assert checks.check_training(dataclasses.replace(config, hyperparameters=chosen)) == []


@pytest.mark.parametrize("name", sorted(file.stem for file in (ROOT / "configs").glob("*_*.yaml")))
def test_what_comes_with_the_package_can_be_trained(name):
    if name.startswith("rllib"):
        return
    if name.endswith("tqc"):
        pytest.importorskip("sb3_contrib")
    assert checks.check_training(read_training(ROOT / "configs" / f"{name}.yaml")) == []


def test_nothing_is_learnt_without_a_word(tmp_path, capsys):
    file = write_small(tmp_path / "c.yaml")
    arguments = ["--config", str(file), "--set", "hyperparameters.learning_starts=100", "--output", str(tmp_path / "r")]
    assert train.main([*arguments, "--quiet"]) == 0
    assert "nothing is learnt in total_steps 60" in capsys.readouterr().err


def test_a_stub_of_a_former_version_is_begun_again(tmp_path):
    file, output = write_small(tmp_path / "c.yaml"), tmp_path / "run"
    for place in (output, output / "seed-0"):
        place.mkdir()
        (place / "config.yaml").write_text(file.read_text().replace("max_episode_steps", "max_sped"))
    (output / "seed-0" / "provenance.json").write_text("{}")
    (output / "notes.txt").write_text("mine")
    assert train.main(["--config", str(file), "--output", str(output), "--quiet"]) == 0
    assert json.loads((output / "summary.json").read_text())["steps"] == [60]
    assert (output / "notes.txt").read_text() == "mine"
    assert "max_sped" not in (output / "seed-0" / "config.yaml").read_text()


def test_a_run_is_replaced_only_if_that_is_asked_for(run, tmp_path, capsys):
    before = listing(run)
    arguments = ["--config", str(tmp_path / "c.yaml"), "--output", str(run), "--quiet"]
    assert train.main(arguments) == 1
    assert "--resume" in (said := capsys.readouterr().err) and "--overwrite" in said
    assert train.main([*arguments, "--overwrite", "--set", "environment.kwargs.max_sped=1"]) == 1
    assert listing(run) == before
    (run / "notes.txt").write_text("mine")
    assert train.main([*arguments, "--overwrite", "--seed", "4"]) == 0
    assert [each.name for each in run.glob("seed-*")] == ["seed-4"]
    assert (run / "notes.txt").exists()


def test_a_finished_run_is_trained_for_longer(run, capsys):
    seed = run / "seed-0"
    before = read_curve(seed / "curve.jsonl")
    assert train.main(["--resume", str(run), "--set", "total_steps=100", "--quiet"]) == 0
    assert json.loads((run / "summary.json").read_text())["steps"] == [100]
    assert json.loads((seed / "summary.json").read_text())["steps"] == 100
    assert read_training(run / "config.yaml").total_steps == read_training(seed / "config.yaml").total_steps == 100
    # It went on from where it had ended.
    curve = read_curve(seed / "curve.jsonl")
    assert curve[: len(before)] == before
    assert [line["step"] for line in curve] == [40, 60, 80, 100]
    assert checkpoints_in(seed / "checkpoints")[-1].name == f"step-{100:012d}"
    after = listing(run)
    # As it is, there is nothing to do, and that is said.
    assert train.main(["--resume", str(run), "--quiet"]) == 0
    assert "is finished; --set total_steps=N" in capsys.readouterr().err
    for changes, message in (
        (["total_steps=60"], "total_steps must be no less than before, 100"),
        (["hyperparameters.gamma=0.5", "total_steps=200"], "other values of hyperparameters.gamma make another run"),
        (["environment.kwargs.max_speed=0.05"], "other values of environment.kwargs.max_speed"),
        (["total_steps=200", "success_target=0.0"], "because it reached its success_target"),
    ):
        arguments = [word for change in changes for word in ("--set", change)]
        assert train.main(["--resume", str(run), *arguments, "--quiet"]) == 1
        assert message in capsys.readouterr().err
    assert set(listing(run)) == set(after)
    assert (run / "config.yaml").read_text().count("gamma: 0.97") == 1


def test_a_run_whose_files_were_changed_is_not_gone_on_with(run, capsys):
    file = run / "config.yaml"
    file.write_text(file.read_text().replace("gamma: 0.97", "gamma: 0.5"))
    assert train.main(["--resume", str(run), "--quiet"]) == 1
    assert "other values of hyperparameters.gamma" in capsys.readouterr().err


def test_a_seed_is_gone_on_with_by_its_own_folder(run):
    seed = run / "seed-0"
    summary = (run / "summary.json").read_text()
    files = {str(path.relative_to(run)) for path in run.rglob("*")}
    assert train.main(["--resume", str(seed), "--quiet"]) == 0
    assert {str(path.relative_to(run)) for path in run.rglob("*")} == files
    assert json.loads((run / "summary.json").read_text()) == json.loads(summary)
    assert train.main(["--resume", str(seed), "--set", "total_steps=80", "--quiet"]) == 0
    assert json.loads((seed / "summary.json").read_text())["steps"] == 80
    assert json.loads((run / "summary.json").read_text())["steps"] == [80]
    assert not (seed / "seed-0").exists()


def test_a_seed_ends_its_run_if_it_is_the_last(tmp_path):
    config = read_training(write_small(tmp_path / "c.yaml", top_seeds=[0, 1]))
    from spatula_env.learning.progress import ProgressView
    from spatula_env.learning.training import train_seed, write_config

    output = tmp_path / "run"
    output.mkdir()
    write_config(output, config)
    train_seed(config, 0, output / "seed-0", ProgressView(quiet=True))
    (output / "seed-1").mkdir()
    write_config(output / "seed-1", dataclasses.replace(config, seeds=(1,)))
    assert not (output / "summary.json").exists()
    assert train.main(["--resume", str(output / "seed-1"), "--quiet"]) == 0
    assert json.loads((output / "summary.json").read_text())["seeds"] == [0, 1]


def test_what_is_no_run_is_not_gone_on_with(run, capsys):
    for place, message in (
        (run / "seed-0" / "best", "is a policy of a run: name the run's folder"),
        (run / "seed-0" / "checkpoints", "holds no run to go on with"),
        (run / "nothing", "holds no run to go on with"),
    ):
        assert train.main(["--resume", str(place), "--quiet"]) == 1
        assert message in capsys.readouterr().err


def test_two_commands_do_not_train_in_one_folder(run, capsys):
    pytest.importorskip("fcntl")
    with occupied(run):
        assert train.main(["--resume", str(run), "--set", "total_steps=80", "--quiet"]) == 1
    assert "another command is at work in" in capsys.readouterr().err


@pytest.mark.usefixtures("quick_experts")
def test_nothing_else_is_replaced_either(run, tmp_path, capsys):
    weights, film, place = tmp_path / "w.npz", tmp_path / "f.gif", tmp_path / "clone"
    commands = [
        lambda *more: export.main([str(run), str(weights), *more]),
        lambda *more: clone.main(
            ["--env", "press", "--expert", "2", "--noise", "0", "--gradient-steps", "3", "--output", str(place), *more]
        ),
    ]
    try:
        import moviepy  # noqa: F401
    except ImportError:
        film = None
    else:
        size = ["--set", "width=32", "--set", "height=32", "--set", "max_episode_steps=2"]
        commands.append(
            lambda *more: evaluate.main(
                ["--env", "press", "--policy", "random", "--episodes", "1", *size, "--video", str(film), *more]
            )
        )
    for command in commands:
        assert command() == 0
    before = listing(tmp_path)
    capsys.readouterr()
    for command in commands:
        assert command() == 1
        assert "--overwrite" in capsys.readouterr().err
    assert listing(tmp_path) == before
    for command in commands:
        assert command("--overwrite") == 0
    after = listing(tmp_path)
    assert set(after) == set(before)
    for file in (weights, film, place / "provenance.json", place / "policy" / "model.zip"):
        if file is not None:
            assert after[str(file.relative_to(tmp_path))] > before[str(file.relative_to(tmp_path))]


@pytest.mark.parametrize("command", ["evaluate", "export", "clone", "train"])
def test_places_that_cannot_be_written_are_refused_before_anything_is_done(
    command, request, tmp_path, monkeypatch, capsys
):
    there = request.getfixturevalue("run") if command == "export" else tmp_path

    def fail(*_, **__):
        pytest.fail("something was done first")

    monkeypatch.setattr("spatula_env.learning.commands.evaluate.check_film", lambda path: None)
    monkeypatch.setattr("spatula_env.learning.evaluation.evaluate", fail)
    monkeypatch.setattr("spatula_env.learning.demonstrations.collect_successes", fail)
    monkeypatch.setattr("spatula_env.learning.checks.rehearse_clone", fail)
    monkeypatch.setattr("spatula_env.learning.checks.check_training", fail)
    (tmp_path / "file").write_text("in the way")
    below = tmp_path / "file" / "below"
    words = {
        "evaluate": ["--env", "press", "--policy", "random", "--video", str(below / "x.mp4")],
        "export": [str(there), str(below / "x.npz"), "--episodes", "1"],
        "clone": ["--env", "press", "--expert", "1", "--output", str(below)],
        "train": ["--config", str(write_small(tmp_path / "small.yaml")), "--output", str(below)],
    }
    capsys.readouterr()
    assert cli.main([command, *words[command]]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"spatula {command}: {below} cannot be written to: ") and len(said.splitlines()) == 1
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_clone_does_not_replace_a_run(run, capsys):
    before = listing(run)
    assert clone.main(["--env", "press", "--expert", "1", "--output", str(run)]) == 1
    assert "holds a run already" in capsys.readouterr().err
    assert listing(run) == before


def test_an_export_that_is_interrupted_leaves_nothing(run, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("spatula_env.learning.evaluation.evaluate", interrupt)
    output = tmp_path / "weights" / "w.npz"
    assert export.main([str(run), str(output), "--episodes", "1"]) == 130
    assert not list(output.parent.iterdir())


@pytest.mark.parametrize(
    ("words", "typed"),
    [
        (["train", "--config", "knead"], "spatula train: config must be a file or one of"),
        (["evaluate", "--env", "knead", "--policy", "random"], "spatula evaluate: there is no environment 'knead'"),
        (["clone", "--env", "knead", "--expert", "1"], "spatula clone: there is no environment 'knead'"),
        (["export", "nowhere", "w.npz"], "spatula export: there is no policy in nowhere"),
    ],
)
def test_messages_name_the_command_that_was_typed(words, typed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 1
    assert typed in capsys.readouterr().err
    with pytest.raises(SystemExit):
        cli.main([words[0], "--help"])
    assert capsys.readouterr().out.startswith(f"usage: spatula {words[0]} ")


def test_training_that_is_interrupted_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    from spatula_env.learning import training

    step = training.Trainer._on_step

    def interrupted(self):
        if self.model.num_timesteps > 50:
            raise KeyboardInterrupt
        return step(self)

    monkeypatch.setattr(training.Trainer, "_on_step", interrupted)
    output = tmp_path / "run"
    words = ["train", "--config", str(write_small(tmp_path / "c.yaml")), "--output", str(output), "--quiet"]
    assert cli.main(words) == 130
    said = capsys.readouterr().err
    assert "seed 0 is saved as it was at 30 steps" in said
    assert f"go on with: spatula train --resume {output}" in said


@pytest.mark.usefixtures("quick_experts")
def test_a_clone_of_failures_is_told(tmp_path, capsys):
    arguments = ["--env", "press", "--expert", "1", "--gradient-steps", "2", "--output", str(tmp_path / "c")]
    assert clone.main(arguments) == 0
    assert "note: none of the 1 demonstrations of scripted expert" in capsys.readouterr().err


@pytest.mark.usefixtures("quick_experts")
def test_cloning_that_is_interrupted_says_what_is_saved(monkeypatch, tmp_path, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    arguments = ["--env", "press", "--expert", "2", "--noise", "0", "--gradient-steps", "2", "--rounds", "1"]
    monkeypatch.setattr(cloning, "correct", interrupt)
    assert clone.main([*arguments, "--output", str(tmp_path / "c")]) == 130
    assert f"interrupted; the clone is in {tmp_path / 'c'}" in capsys.readouterr().err
    monkeypatch.setattr(cloning, "clone", interrupt)
    assert clone.main([*arguments, "--output", str(tmp_path / "d")]) == 130
    assert "interrupted; nothing has been saved" in capsys.readouterr().err
