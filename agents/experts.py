"""Moved to `spatula_env.learning.experts`; what imports it from here goes on to work."""

from __future__ import annotations

import sys

from spatula_env.learning import experts

sys.modules[__name__] = experts
