from __future__ import annotations

from hypothesis import settings

# No deadline: the machine may be busy, and the first example of a test may load kernels.
settings.register_profile("spatula_env", deadline=None)
settings.load_profile("spatula_env")
