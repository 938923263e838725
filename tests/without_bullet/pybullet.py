"""Shadows PyBullet on the path in tests that run as if it were not installed."""

raise ModuleNotFoundError("made unimportable for the tests", name="pybullet")
