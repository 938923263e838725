"""Moved to `spatula_env.learning.networks`; models that earlier versions saved name it here."""

from __future__ import annotations

import sys

from spatula_env.learning import networks

sys.modules[__name__] = networks
