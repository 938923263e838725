"""Moved to `spatula_env.learning.configuration`; importing from here still works."""

from __future__ import annotations

import sys

from spatula_env.learning import configuration

sys.modules[__name__] = configuration
