"""An episode as the bytes of an HDF5 file, as Minari reads it."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces

from spatula_env.data.episode import Episode
from spatula_env.data.pictures import encode_pictures, is_picture

COMPRESSION = 4
"""Deflate level for arrays of numbers, lossless."""
SMALL = 4096
"""Arrays up to this size are stored in their header, unless they can be compressed [bytes]."""
ONE_CHUNK = 1 << 20
"""Arrays up to this size are one chunk, longer ones several of about this size [bytes]."""
FORMAT = "v110"
"""The oldest HDF5 format that reads the files. In older formats, files of short episodes are half as large again."""
LEAF = "value"
"""Name of a value whose own name is that of a group, as in an `info` with both "reward" and "reward/term"."""


def episode_image(
    episode: Episode, number: int, encoded: Mapping[str, spaces.Space[Any]] = MappingProxyType({})
) -> bytes:
    """Encode an episode as the bytes of its file.

    The file is made in memory first, so that only plain writes can fail, whose errors say why.

    Args:
        episode: The episode.
        number: Number of the episode in its dataset.
        encoded: Spaces of "observations" and "actions" whose pictures are stored as PNG.
    """
    import h5py

    # Nothing is ever removed from the file, so its free space need not be managed.
    with h5py.File(
        "episode", "w", driver="core", backing_store=False, libver=(FORMAT, FORMAT), fs_strategy="none"
    ) as file:
        file.attrs["id"] = number
        file.attrs["total_steps"] = len(episode)
        if episode.seed is not None:
            file.attrs["seed"] = episode.seed
        for name, value in _flat(episode.options or {}, "options").items():
            file.attrs[name] = _as_attribute(value)
        for name, value in episode.attributes.items():
            file.attrs[name] = _as_attribute(value)
        for name in ("observations", "actions", "rewards", "terminations", "truncations", "infos"):
            _put(file, name, getattr(episode, name), encoded.get(name))
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _put(group: Any, name: str, value: Any, space: spaces.Space[Any] | None = None) -> None:
    # A slash in a name is a path to HDF5, and a group of groups to Minari. `info` has such keys.
    if isinstance(value, Mapping):
        inner = group.require_group(name)
        for key, each in value.items():
            is_group = not isinstance(each, Mapping) and any(str(other).startswith(f"{key}/") for other in value)
            of = space.spaces[key] if isinstance(space, spaces.Dict) else None
            _put(inner, f"{key}/{LEAF}" if is_group else str(key), each, of)
    elif isinstance(value, list):
        _put_array(group, name, np.array([text.encode() for text in value], dtype=np.bytes_), text=True)
    elif space is not None and is_picture(space):
        _put_array(group, name, encode_pictures(np.asarray(value)))
    else:
        _put_array(group, name, np.asarray(value))


def _put_array(group: Any, name: str, array: Any, *, text: bool = False) -> None:
    import h5py

    *folders, leaf = name.split("/")
    for folder in folders:
        group = group.require_group(folder)
    created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    created.set_obj_track_times(False)
    if array.nbytes > SMALL or _is_compressible(array):
        # Chunks of whole steps, because readers read episodes or steps of them.
        steps = max(1, ONE_CHUNK * len(array) // array.nbytes)
        created.set_chunk((min(steps, len(array)), *array.shape[1:]))
        created.set_shuffle()
        created.set_deflate(COMPRESSION)
    elif array.nbytes:
        created.set_layout(h5py.h5d.COMPACT)
    kind = h5py.h5t.py_create(array.dtype, logical=True)
    if text:
        kind.set_cset(h5py.h5t.CSET_UTF8)
    space = h5py.h5s.create_simple(array.shape)
    dataset = h5py.h5d.create(group.id, leaf.encode(), kind, space, created)
    if array.nbytes:
        dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(array), mtype=kind)


def _is_compressible(array: Any) -> bool:
    """Whether an array can be compressed."""
    rows = np.frombuffer(np.ascontiguousarray(array).tobytes(), dtype=np.uint8).reshape(-1, array.dtype.itemsize)
    return len(zlib.compress(rows.T.tobytes(), COMPRESSION)) < int(array.nbytes)


def _flat(value: Mapping[str, Any], parent: str) -> dict[str, Any]:
    """Flatten nested mappings into one with paths as names, as Minari reads them."""
    flat: dict[str, Any] = {}
    for name, each in value.items():
        path = f"{parent}/{name}"
        flat |= _flat(each, path) if isinstance(each, Mapping) else {path: each}
    return flat


def _as_attribute(value: Any) -> Any:
    """Convert a value for an HDF5 attribute; types that HDF5 does not support become text in JSON."""
    array = (
        np.asarray(value) if isinstance(value, bool | int | float | np.generic | np.ndarray | list | tuple) else None
    )
    if isinstance(value, str) or (array is not None and array.dtype.kind in "biuf" and array.nbytes < 32768):
        return value if isinstance(value, str) else array
    return json.dumps(value, default=repr)
