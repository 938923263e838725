"""Adapter to OmniSafe, whose constrained learners need an environment class of its own.

Importing this module registers `Spatula/Press-v0` and the others with OmniSafe 0.5. OmniSafe's pinned requirements are
of 2023 and conflict with Gymnasium 1, so install it without them:

    pip install --no-deps omnisafe==0.5.0
    pip install torch tensorboard wandb pyyaml moviepy typer seaborn pandas matplotlib gdown rich

OmniSafe imports Safety-Gymnasium 1.0 for its own environments, which does not work with Gymnasium 1. If that cannot be
imported, a placeholder takes its place while OmniSafe is imported: import this module first.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv

import spatula_env
from spatula_env.envs.episode_sums import values_of_step
from spatula_env.geometry.checks import check_positive

COST_SCALE = 1e3
"""Factor on costs: in milliseconds, the tasks' budgets are of the order of OmniSafe's default limit of 25 [1/s]."""


class _NoSafetyGymnasium(ModuleType):
    """Placeholder for Safety-Gymnasium."""

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{name}: Safety-Gymnasium is not there; its own environments need it and Gymnasium 0.28")


def _import_omnisafe() -> None:
    """Import OmniSafe, with or without Safety-Gymnasium.

    Raises:
        ImportError: If something else is missing.
    """
    if "omnisafe" in sys.modules:
        return
    try:
        importlib.import_module("safety_gymnasium")
        missing = False
    except ImportError:
        missing = True
    if missing:
        sys.modules["safety_gymnasium"] = _NoSafetyGymnasium("safety_gymnasium")
    try:
        importlib.import_module("omnisafe")
    finally:
        if missing:
            del sys.modules["safety_gymnasium"]


try:
    _import_omnisafe()
    import torch
    from omnisafe.envs.core import CMDP, env_register
except ImportError as error:
    raise ImportError(
        "spatula_env.envs.adapters.omnisafe needs OmniSafe: pip install --no-deps omnisafe==0.5.0, and what it "
        f"imports; docs/rl-libraries.md says what that is ({error})",
        name=error.name,
    ) from error

StepTensors = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]


@env_register
class SpatulaCMDP(CMDP):  # type: ignore[misc]
    """An environment of this package for OmniSafe, with one or many worlds.

    The step that ends an episode begins the next one, and its cost is that of the step taken. All worlds are stepped by
    the batch engine. The success rate is reported to OmniSafe as "Env/Success".

    Example:
        >>> import spatula_env.envs.adapters.omnisafe
        >>> import omnisafe
        >>> agent = omnisafe.Agent("PPOLag", "Spatula/Press-v0")  # doctest: +SKIP
    """

    _support_envs: ClassVar[list[str]] = [f"Spatula/{name}-v0" for name in spatula_env.TASKS]
    need_time_limit_wrapper = False
    need_auto_reset_wrapper = False

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        device: str | torch.device = "cpu",
        cost_scale: float = COST_SCALE,
        **kwargs: Any,
    ) -> None:
        """Make an environment.

        Args:
            env_id: Id such as "Spatula/Press-v0".
            num_envs: Number of worlds, W.
            device: Device of the tensors.
            cost_scale: Factor on costs [1/s].
            **kwargs: Further arguments of the environment, OmniSafe's `env_cfgs`; observations must be a single vector.

        Raises:
            ValueError: If an argument is out of its range, or observations are not a single vector.
        """
        super().__init__(env_id)
        check_positive(cost_scale, "cost_scale")
        self._scale, self._device = float(cost_scale), torch.device(device)
        self._env: VectorEnv[Any, Any, Any] = gymnasium.make_vec(
            env_id, num_envs=num_envs, autoreset_mode="same_step", **kwargs
        )
        if not isinstance(self._env.single_observation_space, spaces.Box):
            self._env.close()
            raise ValueError("OmniSafe takes observations that are one vector: obs_mode='state' and reward='dense'")
        self._num_envs = num_envs
        self._observation_space, self._action_space = (
            self._env.single_observation_space,
            self._env.single_action_space,
        )
        self._metadata = self._env.metadata
        self.env_spec_log = {"Env/Success": 0.0}

    def step(self, action: torch.Tensor) -> StepTensors:
        """Step all worlds.

        Args:
            action: (W, A), or (A,) for a single world.

        Returns:
            Observations (W, O), rewards (W,), costs (W,), whether episodes were terminated (W,), whether they were
            truncated (W,), all without the first axis for a single world; and info, with "final_observation" if an
            episode is over.
        """
        actions = action.detach().cpu().numpy().reshape(self._num_envs, -1)
        observations, rewards, terminations, truncations, infos = self._env.step(actions)
        costs = self._scale * values_of_step(infos, "cost")
        info: dict[str, Any] = {}
        ended = terminations | truncations
        if ended.any():
            final = np.zeros_like(observations)
            for world in np.flatnonzero(ended).tolist():
                final[world] = infos["final_obs"][world]
            info["final_observation"] = self._tensor(final)
            info["_final_observation"] = ended
            self.env_spec_log["Env/Success"] = float(values_of_step(infos, "is_success")[ended].mean())
        observed, reward, cost, terminated, truncated = (
            self._tensor(values) for values in (observations, rewards, costs, terminations, truncations)
        )
        return observed, reward, cost, terminated, truncated, info

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """Begin new episodes in all worlds.

        Args:
            seed: World k's episode is drawn from seed + k; None to continue the random numbers.
            options: See `SpatulaVectorEnv.reset`.

        Returns:
            Observations (W, O), or (O,), and an empty info.
        """
        observations, _ = self._env.reset(seed=seed, options=options)
        return self._tensor(observations), {}

    def set_seed(self, seed: int) -> None:
        """Seed the random numbers of world k with seed + k."""
        self.reset(seed=seed)

    @property
    def max_episode_steps(self) -> int | None:
        """Number of steps after which episodes are truncated."""
        steps: int | None = self._env.unwrapped.max_episode_steps  # type: ignore[attr-defined]
        return steps

    def spec_log(self, logger: Any) -> None:
        """Report an ended episode to OmniSafe's logger."""
        logger.store(self.env_spec_log)

    def render(self) -> Any:
        """Pictures of the worlds, or of the single world, with `render_mode="rgb_array"`."""
        pictures = self._env.render()
        return pictures[0] if pictures is not None and self._num_envs == 1 else pictures

    def close(self) -> None:
        """Free the engine."""
        self._env.close()

    def _tensor(self, values: Any) -> torch.Tensor:
        tensor = torch.as_tensor(np.asarray(values), dtype=torch.float32, device=self._device)
        return tensor[0] if self._num_envs == 1 else tensor
