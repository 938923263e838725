"""Moved to `spatula_env.learning.replay`; models that earlier versions saved name it here."""

from __future__ import annotations

import sys

from spatula_env.learning import replay

sys.modules[__name__] = replay
