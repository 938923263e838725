"""LeRobot's own evaluation takes an environment that an EnvHub repository makes."""

from __future__ import annotations

from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import pytest

from spatula_env.envs.adapters.lerobot import make_hub_env

pytestmark = [
    pytest.mark.lerobot,
    pytest.mark.filterwarnings("ignore"),
    pytest.mark.skipif(find_spec("lerobot") is None, reason="LeRobot is missing; `make test-lerobot` installs it"),
]


def test_a_policy_is_rolled_out() -> None:
    torch = pytest.importorskip("torch")
    evaluation = pytest.importorskip("lerobot.scripts.lerobot_eval")
    utils = pytest.importorskip("lerobot.envs.utils")
    seen: list[dict[str, Any]] = []

    class Down(torch.nn.Module):
        def reset(self) -> None:
            seen.clear()

        def select_action(self, observation: dict[str, Any]) -> Any:
            seen.append(observation)
            return torch.tensor([[0.0, 0.0, -1.0]]).expand(len(observation["observation.state"]), 3)

    def make_env(n_envs: int = 1, use_async_envs: bool = False) -> Any:
        return make_hub_env("Spatula/Press-v0", n_envs, use_async_envs, max_episode_steps=5)

    made = utils._normalize_hub_result(utils._call_make_env(SimpleNamespace(make_env=make_env), 2, False, None))
    ((env,),) = (each.values() for each in made.values())

    def same(value: Any) -> Any:
        return value

    result = evaluation.rollout(env, Down(), same, same, same, same, seeds=[0, 1])
    assert result["action"].shape == (2, 5, 3)
    assert result["done"][:, -1].all()
    assert not result["success"].any()
    assert len(seen) == 5
    assert set(seen[0]) == {"observation.images.front", "observation.state", "task"}
    assert seen[0]["observation.images.front"].shape == (2, 3, 84, 84)
    assert seen[0]["task"][0].startswith("Press the organ")
    env.close()
