"""Exported policies: dense layers with their normalisation, stored as a few arrays and run with NumPy alone.

`spatula_env.learning.export` writes a trained policy to one file; `ExportedPolicy` reads it and acts.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import Float32Array
from spatula_env.definitions import FIRST, tell_definition
from spatula_env.files import whole_file
from spatula_env.policies.parts import PartSelection

FORMAT = 1
"""Version of the file format. Increased when older files can no longer be read."""


def _relu(values: Float32Array) -> Float32Array:
    return np.maximum(values, np.float32(0.0))


def _elu(values: Float32Array) -> Float32Array:
    return np.where(values > 0.0, values, np.expm1(np.minimum(values, np.float32(0.0))))


ACTIVATIONS: Mapping[str, Callable[[Float32Array], Float32Array]] = MappingProxyType(
    {"relu": _relu, "tanh": np.tanh, "elu": _elu}
)
"""Activation functions between layers, by name."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One normalised vector of the network's input.

    Attributes:
        name: Name of the entry in a dictionary observation; "" for an observation that is one vector.
        mean: (k,) mean to subtract.
        scale: (k,) standard deviation to divide by.
    """

    name: str
    mean: NDArray[np.float64]
    scale: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExportedPolicy:
    """A network of dense layers with its normalisation.

    Attributes:
        entries: Parts of the input, concatenated in this order.
        clip: Greatest magnitude of a normalised number.
        layers: Weights (out, in) and biases (out,) of each layer.
        activation: Name of the activation function between layers.
        squash: Whether a tanh follows the last layer; otherwise actions are clipped.
        low: (A,) least actions.
        high: (A,) greatest actions.
        metadata: Purpose of the policy: "env_id", "env_kwargs", "parts", and "definition", the task definition's
            number.
        selection: Selection of the observation's parts, once an environment is known; None for all.
    """

    entries: tuple[Entry, ...]
    clip: float
    layers: tuple[tuple[Float32Array, Float32Array], ...]
    activation: str
    squash: bool
    low: Float32Array
    high: Float32Array
    metadata: Mapping[str, Any]
    selection: PartSelection | None = None

    def begin(self, seeds: Sequence[int]) -> None:
        """Nothing to do at the beginning of episodes."""

    def bound_to(self, env: Any) -> ExportedPolicy:
        """Bind the policy to an environment: find there the observation's numbers that it was trained on.

        Args:
            env: For one agent or for many, wrapped or not.

        Raises:
            ValueError: If its observations or actions differ from those of training.
        """
        warn_of_definition(self.metadata)
        bound = replace(self, selection=PartSelection.of(env, self.metadata.get("parts")))
        space = getattr(env, "single_observation_space", env.observation_space)
        actions = getattr(env, "single_action_space", env.action_space)
        given: Any = bound.selection.space(space) if bound.selection is not None else space
        for entry in self.entries:
            try:
                size = int(np.prod(given[entry.name].shape if entry.name else given.shape))
            except (KeyError, TypeError) as error:
                raise ValueError(f"observations must have the entry {entry.name!r}, got {given}") from error
            if size != len(entry.mean):
                what = f"{entry.name!r}" if entry.name else "observations"
                raise ValueError(f"{what} must have {len(entry.mean)} numbers for this policy, got {size}")
        if actions.shape != self.low.shape:
            raise ValueError(f"actions must have {len(self.low)} numbers for this policy, got {actions.shape}")
        return bound

    def __call__(self, observation: Any) -> Float32Array:
        """The action (A,) for an observation, or the actions (W, A) for those of W worlds."""
        if self.selection is not None:
            observation = self.selection(observation)
        pieces = []
        for entry in self.entries:
            numbers = np.asarray(observation[entry.name] if entry.name else observation)
            if numbers.shape[-1] != len(entry.mean):
                # Stacked moments have an axis of their own: flatten it.
                numbers = numbers.reshape(*numbers.shape[:-2], -1)
            normalized = np.clip((numbers - entry.mean) / entry.scale, -self.clip, self.clip)
            pieces.append(normalized.astype(np.float32))
        values = np.concatenate(pieces, axis=-1)
        activate = ACTIVATIONS[self.activation]
        for index, (weights, biases) in enumerate(self.layers):
            values = values @ weights.T + biases
            if index < len(self.layers) - 1:
                values = activate(values)
        if self.squash:
            values = self.low + np.float32(0.5) * (np.tanh(values) + np.float32(1.0)) * (self.high - self.low)
        return np.clip(values, self.low, self.high).astype(np.float32)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy as an .npz file atomically."""
        header = {
            "format": FORMAT,
            "entries": [entry.name for entry in self.entries],
            "clip": self.clip,
            "layers": len(self.layers),
            "activation": self.activation,
            "squash": self.squash,
            "metadata": dict(self.metadata),
        }
        # Annotated as Any for mypy, to which an array could otherwise be savez_compressed's allow_pickle.
        arrays: dict[str, Any] = {"header": np.array(json.dumps(header)), "low": self.low, "high": self.high}
        for index, entry in enumerate(self.entries):
            arrays[f"mean_{index}"], arrays[f"scale_{index}"] = entry.mean, entry.scale
        for index, (weights, biases) in enumerate(self.layers):
            arrays[f"weights_{index}"], arrays[f"biases_{index}"] = weights, biases
        with whole_file(Path(path)) as unfinished, unfinished.open("wb") as stream:
            np.savez_compressed(stream, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ExportedPolicy:
        """Read a policy.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file holds something else.
        """
        try:
            # Opened here because NumPy does not close a file that is not an archive.
            with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
                header = _checked_header(json.loads(str(arrays["header"])))
                policy = cls(
                    entries=tuple(
                        Entry(name, arrays[f"mean_{index}"], arrays[f"scale_{index}"])
                        for index, name in enumerate(header["entries"])
                    ),
                    clip=float(header["clip"]),
                    layers=tuple(
                        (arrays[f"weights_{index}"], arrays[f"biases_{index}"]) for index in range(header["layers"])
                    ),
                    activation=header["activation"],
                    squash=header["squash"],
                    low=arrays["low"],
                    high=arrays["high"],
                    metadata=header["metadata"],
                )
            policy._check_shapes()
        except FileNotFoundError:
            raise
        except (
            AttributeError,
            EOFError,
            KeyError,
            MemoryError,
            OSError,
            RuntimeError,
            TypeError,
            ValueError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise ValueError(f"{path} holds no exported policy: {error}") from error
        return policy

    def _check_shapes(self) -> None:
        """Check that the shapes of the arrays are consistent."""
        size = 0
        for entry in self.entries:
            _check_array(f"mean of {entry.name!r}", entry.mean, (len(np.atleast_1d(entry.mean)),))
            _check_array(f"scale of {entry.name!r}", entry.scale, entry.mean.shape)
            size += len(entry.mean)
        for number, (weights, biases) in enumerate(self.layers):
            _check_array(f"biases of layer {number}", biases, (len(np.atleast_1d(biases)),))
            _check_array(f"weights of layer {number}", weights, (len(biases), size))
            size = len(biases)
        _check_array("low", self.low, (size,))
        _check_array("high", self.high, (size,))


def warn_of_definition(metadata: Mapping[str, Any]) -> None:
    """Warn if a policy was trained for a definition of its task other than the present one.

    Args:
        metadata: Metadata of the policy; see `ExportedPolicy`.
    """
    if "env_id" in metadata:
        tell_definition("the policy", metadata["env_id"], metadata.get("definition", FIRST), stacklevel=3)


def _check_array(name: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    if values.dtype.kind != "f" or values.shape != shape:
        raise ValueError(f"{name} must be numbers {shape}, got {values.dtype} {values.shape}")


def _checked_header(header: Any) -> dict[str, Any]:
    """Validate the metadata of a policy's file.

    Raises:
        ValueError: If something is wrong; the message says what.
    """
    if not isinstance(header, dict):
        raise ValueError(f"its header must be a mapping, got {_shown(header)}")
    if header.get("format") != FORMAT:
        raise ValueError(f"it has the format {_shown(header.get('format'))}, this version reads {FORMAT}")

    def is_texts(value: Any) -> bool:
        return isinstance(value, list) and all(isinstance(each, str) for each in value)

    def is_count(value: Any) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and value > 0

    metadata = header.get("metadata")
    told = metadata if isinstance(metadata, dict) else {}
    for name, fits, allowed in (
        ("entries", is_texts(header.get("entries")), "a list of names"),
        ("clip", isinstance(header.get("clip"), int | float), "a number"),
        ("layers", is_count(header.get("layers")), "a positive integer"),
        ("activation", header.get("activation") in list(ACTIVATIONS), f"one of {list(ACTIVATIONS)}"),
        ("squash", isinstance(header.get("squash"), bool), "true or false"),
        ("metadata", isinstance(metadata, dict), "a mapping"),
        ("metadata's env_id", isinstance(told.get("env_id", ""), str), "text"),
        ("metadata's env_kwargs", isinstance(told.get("env_kwargs", {}), dict), "a mapping"),
        ("metadata's definition", is_count(told.get("definition", FIRST)), "a positive integer"),
        ("metadata's parts", told.get("parts") is None or is_texts(told["parts"]), "null or a list of names"),
    ):
        if not fits:
            raise ValueError(f"its {name} must be {allowed}, got {_shown(header.get(name, metadata))}")
    return header


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]} …"
