from __future__ import annotations

from hypothesis import HealthCheck, settings

# No deadline: the machine may be busy, and the first example of a test may load kernels. Tests whose cases come from a
# seed sort out those in which nothing meets, and chance may make that many at a time.
settings.register_profile(
    "spatula_env",
    deadline=None,
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)
settings.load_profile("spatula_env")
