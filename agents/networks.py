"""Moved to `spatula_env.learning.networks`; models saved by earlier versions refer to this module."""

from __future__ import annotations

import sys

from spatula_env.learning import networks

sys.modules[__name__] = networks
