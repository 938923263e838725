"""Moved to `spatula_env.learning.rllib_training`; checkpoints of earlier versions refer to this module."""

from __future__ import annotations

import sys

from spatula_env.learning import rllib_training

sys.modules[__name__] = rllib_training
