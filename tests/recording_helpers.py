"""Episodes without physics, for tests of recording."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from spatula_env.data.episode import Episode, EpisodeRecorder

ID = "spatula/test/made_up-v0"


class Pictures(gym.Env):
    """An environment whose pictures are noise, which any lossy compression changes."""

    observation_space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (40, 40, 3), np.uint8),
            "state": spaces.Box(-np.inf, np.inf, (4,), np.float32),
        }
    )
    action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._count = 0
        return self._look(), self._info()

    def step(self, action):
        self._count += 1
        return self._look(), float(action[0]), False, self._count >= 6, self._info()

    def _look(self):
        return (
            self.observation_space.sample()
            if False
            else {
                "image": self.np_random.integers(0, 256, (40, 40, 3), dtype=np.uint8),
                "state": self.np_random.standard_normal(4).astype(np.float32),
            }
        )

    def _info(self):
        return {"is_success": self._count > 4, "reward/term": 0.5 * self._count, "acted_by": "human"}


def make_pictures() -> gym.Env:
    if "Tests/Pictures-v0" not in gym.registry:
        gym.register("Tests/Pictures-v0", entry_point="recording_helpers:Pictures")
    return gym.make("Tests/Pictures-v0", disable_env_checker=True)


def do_episode(env: gym.Env, seed: int) -> Episode:
    """An episode of random actions."""
    recorder = EpisodeRecorder(env)
    generator = np.random.default_rng(seed)
    recorder.begin(*env.reset(seed=seed), seed)
    truncated = False
    while not truncated:
        action = generator.uniform(-1.0, 1.0, 3).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.add(action, observation, reward, terminated, truncated, info)
    return recorder.finish(operator="scripted", device="dice", success=bool(info["is_success"]))
