"""Pretrained policies and the code that runs them, with NumPy alone and no learning library.

Example:
    >>> import gymnasium as gym
    >>> from spatula_env.policies import load_pretrained
    >>> env = gym.make("spatula_env:Spatula/Press-v0", engine="batch")
    >>> policy = load_pretrained("Spatula/Press-v0").bound_to(env)
    >>> observation, info = env.reset(seed=0)
    >>> action = policy(observation)
    >>> env.close()

`spatula_env.learning` trains them and writes their files.
"""

from __future__ import annotations

from spatula_env.policies.exported import Entry, ExportedPolicy
from spatula_env.policies.parts import PartSelection
from spatula_env.policies.pretrained_policies import (
    PRETRAINED,
    describe_provenance,
    load_pretrained,
    pretrained_path,
    read_provenance,
)

__all__ = [
    "PRETRAINED",
    "Entry",
    "ExportedPolicy",
    "PartSelection",
    "describe_provenance",
    "load_pretrained",
    "pretrained_path",
    "read_provenance",
]
