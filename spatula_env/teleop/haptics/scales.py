"""Force scale of each task, from tool to hand, chosen so that the usual peak on the hand is 2 to 3 N.

A Falcon produces 8 N, weighs 0.9 N at the grip and has friction of tenths of a newton; what most tasks' tools feel
would not be noticed against that. The peaks are those of the scripted experts, over a twentieth of a second: press
0.55 N, retract 0.15 N, palpate 0.2 N, fissure 0.15 N, clamp 0.08 N. Palpation stays below that range, as its tissue is
the stiffest.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import gymnasium

FORCE_SCALES: Mapping[str, float] = MappingProxyType(
    {"press": 4.0, "retract": 15.0, "palpate": 6.0, "fissure": 15.0, "clamp": 30.0}
)
"""Force scales by the name of the task's definition."""


def force_scale(env: gymnasium.Env[Any, Any]) -> float:
    """The force scale of an environment's task; 1 for environments from elsewhere.

    Args:
        env: The environment, wrapped or not.
    """
    definition = getattr(env.unwrapped, "definition", None)
    return FORCE_SCALES.get(getattr(definition, "name", ""), 1.0)
