"""Moved to `spatula_env.learning.policies` and `finding`; importing from here still works."""

from __future__ import annotations

from spatula_env.learning.finding import find_policy
from spatula_env.learning.policies import ExpertPolicy, Policy, PolicySource, RandomPolicy, interface_of, make_expert

__all__ = ["ExpertPolicy", "Policy", "PolicySource", "RandomPolicy", "find_policy", "interface_of", "make_expert"]
