"""The base of this package's wrappers of vector environments."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import VectorWrapper


class TransparentVectorWrapper(VectorWrapper):
    """A wrapper through which all is seen that a vector environment has beyond Gymnasium's base class.

    Gymnasium's `VectorWrapper` hides `call`, `get_attr`, `set_attr` and `autoreset_mode`, by which LeRobot, skrl and
    TorchRL ask.
    """

    def __getattr__(self, name: str) -> Any:
        """What this object does not have, the wrapped environment may."""
        if name == "env" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.env, name)
