"""Moved to `spatula_env.learning.configuration`; what imports it from here goes on to work."""

from __future__ import annotations

import sys

from spatula_env.learning import configuration

sys.modules[__name__] = configuration
