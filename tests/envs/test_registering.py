"""`register_task` makes both environments of a task, by an id that other processes can make them of, too."""

from __future__ import annotations

import json
import pickle
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from spatula_env.envs import PressEnv
from spatula_env.extending import Task, register_task, scenes
from spatula_env.naming import vector_spec
from spatula_env.tasks import PressConfig, PressTask


class OwnTask(PressTask):
    """A user's own version of the task Press."""


FIELDS = {
    "task": OwnTask,
    "config": PressConfig,
    "scene": scenes.seed,
    "workspace_height": 0.025,
    "observed": PressEnv.definition.observed,
}


@pytest.fixture(autouse=True)
def forgotten():
    ids, names = set(gymnasium.registry), set(globals())
    yield
    for added in set(gymnasium.registry) - ids:
        del gymnasium.registry[added]
    for added in set(globals()) - names:
        del globals()[added]


def test_both_environments_are_made_by_the_id():
    one, many = register_task("Mine/Own-v3", **FIELDS, defaults={"max_speed": 0.05}, episode_time=0.2)
    assert one is OwnEnv and many is OwnVectorEnv  # noqa: F821
    assert one.__doc__ == many.__doc__ == OwnTask.__doc__
    with gymnasium.make("Mine/Own-v3", engine="batch") as env:
        observation, _ = env.reset(seed=3)
        assert isinstance(env.unwrapped, one) and env.unwrapped.settings.max_speed == 0.05
        assert [env.step(env.action_space.sample())[3] for _ in range(4)] == [False, False, False, True]
    envs = gymnasium.make_vec("Mine/Own-v3", num_envs=2)
    assert isinstance(envs, many)
    np.testing.assert_array_equal(envs.reset(seed=3)[0][0], observation)
    envs.close()
    reference = PressEnv(engine="batch")
    np.testing.assert_array_equal(reference.reset(seed=3)[0], observation)
    reference.close()


def test_the_specification_and_the_classes_can_be_sent():
    one, many = register_task("Mine/Own-v0", **FIELDS)
    spec = EnvSpec.from_json(gymnasium.spec("Mine/Own-v0").to_json())
    with gymnasium.make(spec, engine="batch") as env:
        assert type(env.unwrapped) is one
    assert pickle.loads(pickle.dumps((one, many))) == (one, many)
    assert json.loads(gymnasium.spec("Mine/Own-v0").to_json())["kwargs"] == {"episode_time": 10.0}
    assert vector_spec("Mine/Own-v0").vector_entry_point == f"{__name__}:OwnVectorEnv"


def test_the_same_may_be_registered_again_and_nothing_else_by_that_name():
    first, _ = register_task("Mine/Own-v0", **FIELDS)
    with pytest.warns(UserWarning, match="already in registry"):
        second, _ = register_task("Mine/Own-v0", **FIELDS)
    assert second is not first and OwnEnv is second  # noqa: F821
    with pytest.raises(ValueError, match=r"env_id needs the name OwnEnv in the module .*; got 'Mine/Own-v1'"):
        register_task("Mine/Own-v1", **FIELDS)
    assert "Mine/Own-v1" not in gymnasium.registry and OwnEnv is second  # noqa: F821


def test_a_task_of_the_package_is_registered_by_the_module_that_says_so():
    fields = {**FIELDS, "task": PressTask}
    with pytest.raises(ValueError, match="module must be given for a task of this package: module=__name__; got Press"):
        register_task("Mine/Other-Scene-v0", **fields)
    one, _ = register_task("Mine/Other-Scene-v0", **fields, module=__name__)
    assert (one.__module__, one.__name__, one.definition.name) == (__name__, "Other_SceneEnv", "other-scene")
    assert not hasattr(sys.modules[PressTask.__module__], one.__name__)


def test_what_is_missing_or_unknown_is_named():
    with pytest.raises(TypeError, match="'workspace_height'"):
        register_task("Mine/Own-v0", task=OwnTask, config=PressConfig, scene=scenes.seed)
    with pytest.raises(TypeError, match="'stop'"):
        register_task("Mine/Own-v0", **FIELDS, stop=0.1)
    with pytest.raises(gymnasium.error.Error):
        register_task("Mine Own", **FIELDS)
    assert "Mine/Own-v0" not in gymnasium.registry
    assert issubclass(OwnTask, Task)
