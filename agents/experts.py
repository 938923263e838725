"""Moved to `spatula_env.learning.experts`; importing from here still works."""

from __future__ import annotations

import sys

from spatula_env.learning import experts

sys.modules[__name__] = experts
