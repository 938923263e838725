from __future__ import annotations

import dataclasses
import json
import os
import signal
import threading
import time
from importlib.util import find_spec

import numpy as np
import pytest
import yaml

from spatula_env.installing import install_hint
from spatula_env.learning.commands import train_rllib as command
from spatula_env.learning.configuration import find_config, to_mapping
from spatula_env.learning.evaluation import Plan, evaluate
from spatula_env.learning.finding import find_policy
from spatula_env.learning.rllib_configuration import RLlibConfig, read_rllib
from spatula_env.learning.saving import checkpoints_in, read_curve

PRESS = "Spatula/Press-v0"

needs_ray = [
    pytest.mark.ray,
    pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray: make test-ray"),
    pytest.mark.timeout(1800),
    # Ray's own, of which there are many.
    pytest.mark.filterwarnings("ignore"),
]

TINY = [
    "environment.num_envs=4",
    "environment.kwargs.max_episode_steps=10",
    "env_runners.fragment=10",
    "hyperparameters.minibatch_size=40",
    "hyperparameters.epochs=2",
    "network.layers=[16]",
    "evaluation.every=160",
    "evaluation.episodes=2",
    "checkpoint_every=160",
    "success_target=null",
    "total_steps=320",
]


def with_ray(function):
    """Only where Ray is."""
    for mark in needs_ray:
        function = mark(function)
    return function


def test_the_configuration_of_the_documentation_can_be_read():
    config = read_rllib(find_config("rllib_press"))
    assert config.env_runners.count == 2
    assert config.batch_size == 2 * 32 * 50
    assert read_rllib(find_config("rllib_press"), ["env_runners.count=0"]).batch_size == 32 * 50


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("env_runners.number=3", r"env_runners has unknown keys \['number'\]; allowed are .*'count'"),
        ("env_runners.count=-1", "env_runners.count must be 0 or more, got -1"),
        ("env_runners.probe_seconds=0", "env_runners.probe_seconds must be positive"),
        ("hyperparameters.gamma=2", r"hyperparameters.gamma must be in \[0, 1\], got 2"),
        ("network.activation=elu", "network.activation must be 'relu' or 'tanh' with RLlib, got 'elu'"),
        ("normalization.rewards=true", "normalization.rewards must be false"),
        ("environment.kwargs.reward=sparse", "must not be 'sparse'"),
        ("total_steps=0", "total_steps must be 1 or more, got 0"),
    ],
)
def test_what_is_wrong_with_a_configuration_is_said(change, message):
    with pytest.raises(ValueError, match=message):
        read_rllib(find_config("rllib_press"), [change])


def test_what_is_written_is_read_as_it_was(tmp_path):
    config = read_rllib(find_config("rllib_press"), TINY)
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(to_mapping(config)))
    assert read_rllib(tmp_path / "config.yaml") == config
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.seed = 3
    assert isinstance(config, RLlibConfig)


@pytest.mark.skipif(find_spec("ray") is not None, reason="is about what happens without Ray")
def test_without_ray_it_is_said_how_to_get_it(tmp_path, capsys):
    assert command.main(["--config", "rllib_press", "--output", str(tmp_path / "run")]) == 1
    assert f"needs ray: {install_hint('ray')}" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "rllib_dance"], "no rllib_dance"),
        (["--config", "rllib_press", "--set", "gama=3"], "unknown keys ['gama']"),
        (["--resume", "runs/none"], "none"),
    ],
)
def test_what_is_wrong_is_said(arguments, message, capsys):
    assert command.main(arguments) == 1
    assert message in capsys.readouterr().err


@pytest.fixture(scope="module")
def cluster():
    """Two nodes of Ray on this machine, with one processor for an environment runner each."""
    # Ray's processes are nice to others, and would wait for tests beside them.
    os.environ.update(RAY_worker_niceness="0", RAY_AUTH_MODE="disabled", RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO="0")
    import ray
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    made.add_node(num_cpus=1)
    ray.init(address=made.address, log_to_driver=False, logging_level="ERROR")
    try:
        yield made
    finally:
        ray.shutdown()
        made.shutdown()


@with_ray
def test_runners_on_two_nodes_hold_vector_environments_and_one_that_is_killed_is_replaced(cluster, tmp_path):
    import ray

    from spatula_env.envs.vector import SpatulaVectorEnv
    from spatula_env.learning.rllib_training import LeanVectorEnv, RLlibTrainer, export_algorithm

    assert len([node for node in ray.nodes() if node["Alive"]]) == 2
    config = read_rllib(find_config("rllib_press"), [*TINY, "env_runners.probe_seconds=60"])
    told = []
    trainer = RLlibTrainer(config, tmp_path / "run", told.append)
    try:
        group = trainer.algorithm.env_runner_group

        def look(runner):
            env = runner.env
            lean = env
            while not isinstance(lean, LeanVectorEnv):
                lean = lean.env
            return {
                "pid": os.getpid(),
                "node": ray.get_runtime_context().get_node_id(),
                "vector": isinstance(env.unwrapped, SpatulaVectorEnv),
                "worlds": env.num_envs,
                "engine": env.unwrapped.settings.engine,
                "size": env.single_observation_space.shape[0],
            }

        before = group.foreach_env_runner(look, local_env_runner=False)
        assert len({each["node"] for each in before}) == 2
        assert len({each["pid"] for each in before}) == 2
        for each in before:
            assert (each["vector"], each["worlds"], each["engine"]) == (True, 4, "batch")
            assert each["size"] < 71
        line = trainer.iterate()
        assert line["step"] == config.batch_size == 80
        assert (line["healthy"], line["restarts"]) == (2, 0)

        # In the middle of training: as soon as the next update has begun.
        victim = before[0]["pid"]
        killer = threading.Timer(0.05, os.kill, (victim, signal.SIGKILL))
        killer.start()
        lines = [trainer.iterate()]
        killer.join()
        deadline = time.monotonic() + 900
        while (lines[-1]["restarts"] < 1 or lines[-1]["healthy"] < 2) and time.monotonic() < deadline:
            lines.append(trainer.iterate())
        assert (lines[-1]["healthy"], lines[-1]["restarts"]) == (2, 1), told
        after = {each["pid"] for each in group.foreach_env_runner(look, local_env_runner=False)}
        assert len(after) == 2 and victim not in after
        # It collects again: an update has the steps of both.
        step = lines[-1]["step"]
        last = trainer.iterate()
        assert last["step"] - step == config.batch_size
        assert last["success"] is not None and last["cost"] is not None

        # What it has learnt acts with NumPy alone, as RLlib would.
        import torch

        policy = export_algorithm(trainer.algorithm, config)
        (entry,) = policy.entries
        assert (entry.scale > 1e-6).all() and np.abs(entry.mean).max() > 1e-3
        seen = entry.mean + entry.scale * np.random.default_rng(0).normal(size=(20, len(entry.mean)))
        normalized = torch.as_tensor((seen - entry.mean) / entry.scale, dtype=torch.float32)
        outputs = trainer.algorithm.get_module().forward_inference({"obs": normalized})["action_dist_inputs"]
        expected = np.clip(outputs[:, :3].detach().numpy(), -1.0, 1.0)
        np.testing.assert_allclose(policy(seen), expected, atol=1e-4)
    finally:
        trainer.close()


@with_ray
def test_a_run_is_evaluated_kept_and_gone_on_with(cluster, tmp_path):
    output = tmp_path / "run"
    changes = [part for change in (*TINY, "env_runners.count=1") for part in ("--set", change)]
    assert command.main(["--config", "rllib_press", *changes, "--output", str(output)]) == 0
    summary = json.loads((output / "summary.json").read_text())
    assert summary["steps"] == 320
    assert [line["step"] for line in read_curve(output / "curve.jsonl")] == [160, 320]
    assert [path.name for path in checkpoints_in(output / "checkpoints")] == ["step-000000000160", "step-000000000320"]
    source = find_policy(str(output / "policy.npz"), PRESS)
    assert source.provenance["versions"]["ray"]
    episodes, _ = evaluate(source, Plan(PRESS, {"max_episode_steps": 5}, "batch", 2, 0))
    assert np.isfinite(episodes["return"]).all()
    # A run is not written over, but it can be longer than it was.
    assert command.main(["--config", "rllib_press", "--output", str(output)]) == 1
    file = output / "config.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), "total_steps": 400}))
    assert command.main(["--resume", str(output), "--quiet"]) == 0
    assert json.loads((output / "summary.json").read_text())["steps"] == 400
    assert [line["step"] for line in read_curve(output / "curve.jsonl")] == [160, 320, 400]
