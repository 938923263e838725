"""Policies that act in commands in place of an operator."""

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
    """A policy that acts, before it is made for an environment.

    Attributes:
        name: Name as given on the command line.
        options: Options with which the environment must be made for it.
        make: Makes the policy for an environment with one agent; the number is the seed of its first episode.
    """

    name: str
    options: Mapping[str, Any]
    make: Callable[[gymnasium.Env[Any, Any], int], Policy]


def find_actor(name: str, env_id: str) -> Actor:
    """Find the policy that the command line names.

    Args:
        name: See `POLICY_HELP`.
        env_id: Id of the environment.

    Raises:
        FileNotFoundError: If there is no such policy.
        ValueError: If the policy is for another environment.
    """
    from spatula_env.learning.finding import find_policy

    source = find_policy(name, env_id)

    def make(env: gymnasium.Env[Any, Any], seed: int) -> Policy:
        policy = source.make(env)
        policy.begin([seed])
        shape = env.action_space.shape or ()

        def act(observation: Any) -> NDArray[np.float32]:
            # Policies for many worlds return one row per world.
            return np.asarray(policy(observation), dtype=np.float32).reshape(shape)

        return act

    return Actor(name, source.kwargs, make)
