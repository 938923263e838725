"""Storage of pictures in a dataset: each as a PNG, which is lossless.

Minari reads pictures in an `info` or of a small space as plain arrays. Pictures of a space that it recognises as an
image space it reads through Pillow, which decodes a PNG as well as the JPEG that Minari itself would have written.
Minari 0.5.3, the last for Python 3.10, can read only encoded ones, so encoded pictures can be read by any version.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

if TYPE_CHECKING:
    from numpy.typing import NDArray

ENCODED = "jpeg_encoding"
"""Key in Minari's metadata that says whether pictures are encoded."""
CHANNELS = (2, 3, 4)
"""Numbers of channels that a PNG can have for a picture with three axes."""
COMPRESSION = 4
"""Compression level of pictures, lossless."""


def is_picture(space: spaces.Space[Any]) -> bool:
    """Whether Minari treats a space as one of pictures."""
    from minari.dataset.minari_storage import is_image_space

    return bool(is_image_space(space))


def can_be_encoded(*of: spaces.Space[Any]) -> bool:
    """Whether all pictures of some spaces can be stored as PNG."""
    return all(len(shape) == 2 or shape[2] in CHANNELS for space in of for shape in _picture_shapes(space))


def reads_plain_pictures() -> bool:
    """Whether the installed Minari reads pictures that are not encoded."""
    from minari.dataset.minari_storage import MinariStorage

    return hasattr(MinariStorage, "jpeg_encoding")


def has_pictures(*of: spaces.Space[Any]) -> bool:
    """Whether Minari treats a part of some spaces as pictures."""
    return any(True for space in of for _ in _picture_shapes(space))


def encode_pictures(pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Encode pictures as PNG.

    Args:
        pictures: (n, H, W) or (n, H, W, C).

    Returns:
        (n, length) bytes of each; shorter ones are padded with zeros, which PNG readers ignore.
    """
    from PIL import Image

    encoded = []
    for picture in pictures:
        file = io.BytesIO()
        Image.fromarray(picture).save(file, format="PNG", compress_level=COMPRESSION)
        encoded.append(file.getvalue())
    filled = np.zeros((len(encoded), max(map(len, encoded), default=0)), dtype=np.uint8)
    for row, content in zip(filled, encoded, strict=True):
        row[: len(content)] = np.frombuffer(content, dtype=np.uint8)
    return filled


def _picture_shapes(space: spaces.Space[Any]) -> Iterator[tuple[int, ...]]:
    """Shapes of all parts of a space that Minari treats as pictures."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        inner = space.spaces
        for each in inner.values() if isinstance(inner, Mapping) else inner:
            yield from _picture_shapes(each)
    elif is_picture(space):
        yield space.shape or ()
