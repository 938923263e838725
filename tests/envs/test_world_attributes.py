"""Attributes and methods of vector environments that libraries use, by Gymnasium's interface."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

import spatula_env
from spatula_env import envs
from spatula_env.envs import PressEnv, PressVectorEnv, SpatulaEnv, SpatulaVectorEnv

COUNT = 2


class OwnVectorEnv(SpatulaVectorEnv):
    """A task of one's own, with an attribute of its own."""

    definition = PressEnv.definition
    difficulty = 1


class Mixin:
    pass


class MixedVectorEnv(Mixin, PressVectorEnv):
    pass


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    made: Any = gym.make_vec("Spatula/Press-v0", num_envs=COUNT, engine="batch", render_mode="rgb_array", width=32,
                             height=24)  # fmt: skip
    made.reset(seed=3)
    yield made
    made.close()


@pytest.fixture(scope="module")
def gymnasiums() -> Iterator[Any]:
    made = SyncVectorEnv(
        [lambda: gym.make("Spatula/Press-v0", engine="batch", render_mode="rgb_array", width=32, height=24)] * COUNT
    )
    made.reset(seed=3)
    yield made
    made.close()


@pytest.mark.parametrize("task", spatula_env.TASKS)
def test_gymnasiums_classes_are_direct_bases(task: str) -> None:
    # Libraries such as skrl look at the direct bases only.
    assert VectorEnv in getattr(envs, f"{task}VectorEnv").__bases__
    assert gym.Env in getattr(envs, f"{task}Env").__bases__


def test_they_are_of_ones_own_classes_too() -> None:
    assert VectorEnv in OwnVectorEnv.__bases__
    assert MixedVectorEnv.__mro__[1:4] == (Mixin, PressVectorEnv, SpatulaVectorEnv)
    assert MixedVectorEnv.__bases__ == (Mixin, PressVectorEnv, VectorEnv)

    class OwnEnv(PressEnv):
        pass

    assert OwnEnv.__bases__ == (PressEnv, gym.Env)
    assert issubclass(OwnEnv, SpatulaEnv)


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_the_autoreset_mode_is_an_attribute(mode: str) -> None:
    made = PressVectorEnv(1, autoreset_mode=mode)
    assert made.autoreset_mode is AutoresetMode[mode.upper()]
    assert made.autoreset_mode is made.metadata["autoreset_mode"]


@pytest.mark.parametrize(
    "name",
    ["task_description", "_max_episode_steps", "goal", "grip", "render_mode", "np_random_seed", "steps_per_action",
     "observation_space", "action_space"],
)  # fmt: skip
def test_worlds_tell_what_gymnasiums_vector_environment_tells(env: Any, gymnasiums: Any, name: str) -> None:
    for ask in ("call", "get_attr"):
        mine, theirs = getattr(env, ask)(name), getattr(gymnasiums, ask)(name)
        assert isinstance(mine, tuple)
        assert len(mine) == COUNT
        for one, other in zip(mine, theirs, strict=True):
            assert np.allclose(one, other, atol=1e-6) if isinstance(one, np.ndarray) else one == other


def test_worlds_are_drawn_by_call(env: Any, gymnasiums: Any) -> None:
    pictures = env.call("render")
    assert [picture.shape for picture in pictures] == [picture.shape for picture in gymnasiums.call("render")]
    blind = PressVectorEnv(COUNT)
    blind.reset(seed=0)
    assert blind.call("render") == (None,) * COUNT


def test_methods_are_called_with_their_arguments() -> None:
    made = PressVectorEnv(COUNT, reward="sparse")
    goals = np.zeros((4, 3), np.float32)
    assert [reward.tolist() for reward in made.call("compute_reward", goals, goals, None)] == [[0.0] * 4] * COUNT


def test_what_worlds_lack_by_their_options_says_which(env: Any) -> None:
    for ask in (env.call, env.get_attr):
        with pytest.raises(
            AttributeError, match=r"needs the goal interface: make the environment with reward='sparse'"
        ):
            ask("compute_reward")


@pytest.mark.parametrize("task", spatula_env.TASKS)
def test_what_is_asked_is_a_sentence(task: str) -> None:
    made: Any = gym.make(f"Spatula/{task}-v0", engine="batch")
    sentence = made.get_wrapper_attr("task_description")
    assert sentence[0].isupper()
    assert sentence.endswith(".")
    assert sentence == made.unwrapped.task.description
    made.close()


@pytest.mark.parametrize("name", ["envs", "step", "reset", "goals", "num_envs", "_goals"])
def test_what_worlds_do_not_have_is_an_attribute_error(env: Any, name: str) -> None:
    for ask in (env.call, env.get_attr):
        with pytest.raises(AttributeError, match=f"a world of PressVectorEnv has no attribute '{name}'"):
            ask(name)
    with pytest.raises(AttributeError, match="did you mean 'task_description'"):
        env.call("task_descripton")


def test_what_has_an_effect_can_be_set() -> None:
    made = PressVectorEnv(COUNT, max_episode_steps=50)
    for name in ("_max_episode_steps", "max_episode_steps"):
        made.set_attr(name, [1] * COUNT)
        made.reset(seed=0)
        assert made.step(np.zeros((COUNT, 3)))[3].all()
        made.set_attr(name, None)
        made.reset(seed=0)
        assert not made.step(np.zeros((COUNT, 3)))[3].any()
    own = OwnVectorEnv(COUNT)
    own.set_attr("difficulty", (3, 3))
    assert own.get_attr("difficulty") == (3, 3)


@pytest.mark.parametrize(
    "name", ["settings", "task", "goal", "render_mode", "definition", "step", "metadata", "num_envs"]
)
def test_what_has_no_effect_cannot_be_set(env: Any, name: str) -> None:
    with pytest.raises(AttributeError, match=f"'{name}'.*(no effect|no attribute)"):
        env.set_attr(name, 1)


def test_what_cannot_be_set_world_by_world_is_refused(env: Any) -> None:
    with pytest.raises(AttributeError, match="has no attribute 'colour'"):
        env.set_attr("colour", 1)
    with pytest.raises(ValueError, match="values must be the same for all worlds, which share '_max_episode_steps'"):
        env.set_attr("_max_episode_steps", [1, 2])
    with pytest.raises(ValueError, match="values must be 2, one for each world, got 3"):
        env.set_attr("_max_episode_steps", [1, 1, 1])
    with pytest.raises(ValueError, match="max_episode_steps must be an integer of at least 1, got 0"):
        env.set_attr("_max_episode_steps", 0)


# ----------------------------------------------------------------------------------------- arguments of others


@pytest.mark.parametrize("many", [False, True])
def test_unknown_options_are_refused_in_pythons_words(many: bool) -> None:
    def make(**options: Any) -> Any:
        return gym.make_vec("Spatula/Press-v0", num_envs=1, **options) if many else gym.make(
            "Spatula/Press-v0", engine="batch", **options
        )  # fmt: skip

    owner = "PressVectorEnv" if many else "PressEnv"
    with pytest.raises(TypeError, match=rf"{owner}.__init__\(\) got an unexpected keyword argument 'frameskip'; allow"):
        make(frameskip=1)
    with pytest.raises(TypeError, match=r"argument 'controls'\. Did you mean 'control'\? Allowed are "):
        make(controls="velocity")


@pytest.mark.parametrize("many", [False, True])
def test_reset_options_of_others_are_ignored_with_a_warning(many: bool) -> None:
    made: Any = PressVectorEnv(COUNT) if many else PressEnv(engine="batch")
    expected, _ = made.reset(seed=4)
    with pytest.warns(UserWarning, match="options has no 'lerobot_new_rollout', which is ignored; there are"):
        observation, _ = made.reset(seed=4, options={"lerobot_new_rollout": True})
    assert (observation == expected).all()
    goal = (0.0, 0.0, 0.01)
    with pytest.warns(UserWarning, match="which is ignored"):
        made.reset(seed=4, options={"lerobot_new_rollout": True, "goal": goal})
    assert np.reshape(made.goals if many else made.goal, (-1, 3))[0].tolist() == list(goal)
    made.close()


@pytest.mark.parametrize(("wrong", "meant"), [("gaol", "goal"), ("tool_pos", "tool_position"), ("Goal", "goal")])
def test_misspelt_reset_options_are_refused(wrong: str, meant: str) -> None:
    with PressEnv(engine="batch") as made, pytest.raises(ValueError, match=f"no '{wrong}'; did you mean '{meant}'"):
        made.reset(options={wrong: (0.0, 0.0, 0.01)})
    with pytest.raises(ValueError, match="options has no 'reset_masks'; did you mean 'reset_mask'"):
        PressVectorEnv(COUNT).reset(options={"reset_masks": np.ones(COUNT, bool)})
