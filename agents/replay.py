"""Moved to `spatula_env.learning.replay`; models saved by earlier versions refer to this module."""

from __future__ import annotations

import sys

from spatula_env.learning import replay

sys.modules[__name__] = replay
