"""Policies that act in commands where no operator does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import gymnasium

POLICY_HELP = "expert, proportional, random, pretrained, or the path of a run or of exported weights"

Policy = Callable[[Any], NDArray[np.float32]]


@dataclass(frozen=True)
class Actor:
    """Who acts.

    Attributes:
        name: As it was asked for.
        options: What the environment must be made with for it.
        make: Makes the policy for an environment with one agent; the number is the seed of its first episode.
    """

    name: str
    options: Mapping[str, Any]
    make: Callable[[gymnasium.Env[Any, Any], int], Policy]


def find_actor(name: str, env_id: str) -> Actor:
    """What a name on the command line means.

    Args:
        name: See `POLICY_HELP`.
        env_id: Of the environment.

    Raises:
        FileNotFoundError: If there is no such policy.
        ValueError: If it is one for another environment.
    """
    from spatula_env.learning.finding import find_policy

    source = find_policy(name, env_id)

    def make(env: gymnasium.Env[Any, Any], seed: int) -> Policy:
        policy = source.make(env)
        policy.begin([seed])
        shape = env.action_space.shape or ()

        def act(observation: Any) -> NDArray[np.float32]:
            # Those made for many worlds answer with one row for each.
            return np.asarray(policy(observation), dtype=np.float32).reshape(shape)

        return act

    return Actor(name, source.kwargs, make)
