"""Base of this package's wrappers of vector environments."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import VectorWrapper


class TransparentVectorWrapper(VectorWrapper):
    """A wrapper that forwards all attributes that a vector environment has beyond Gymnasium's base class.

    Gymnasium's `VectorWrapper` hides `call`, `get_attr`, `set_attr` and `autoreset_mode`, which LeRobot, skrl and
    TorchRL use.
    """

    def __getattr__(self, name: str) -> Any:
        """Look up missing attributes in the wrapped environment."""
        if name == "env" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.env, name)
