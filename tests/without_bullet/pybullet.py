"""Stands before PyBullet on the path when the tests are to run as if there were none of it."""

raise ModuleNotFoundError("made unimportable for the tests", name="pybullet")
