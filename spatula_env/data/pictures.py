"""How a dataset keeps pictures: each as a PNG, which loses nothing.

Minari reads pictures of an `info` or of a small space as plain arrays, and those of a space that it takes for one of
pictures through Pillow, which knows a PNG as well as the JPEG that Minari itself would have written. Minari 0.5.3, the
last for Python 3.10, reads no others; so they are what any version reads.
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
"""Under which Minari's metadata tell whether pictures are encoded."""
CHANNELS = (2, 3, 4)
"""That a PNG can have in a picture with three axes."""
COMPRESSION = 4
"""Of pictures, lossless."""


def is_picture(space: spaces.Space[Any]) -> bool:
    """Whether Minari takes a space for one of pictures."""
    from minari.dataset.minari_storage import is_image_space

    return bool(is_image_space(space))


def can_be_encoded(*of: spaces.Space[Any]) -> bool:
    """Whether all pictures of some spaces fit a PNG."""
    return all(len(shape) == 2 or shape[2] in CHANNELS for space in of for shape in _picture_shapes(space))


def reads_plain_pictures() -> bool:
    """Whether the Minari that is installed reads pictures that are not encoded."""
    from minari.dataset.minari_storage import MinariStorage

    return hasattr(MinariStorage, "jpeg_encoding")


def has_pictures(*of: spaces.Space[Any]) -> bool:
    """Whether Minari takes a part of some spaces for pictures."""
    return any(True for space in of for _ in _picture_shapes(space))


def encode_pictures(pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pictures as PNG.

    Args:
        pictures: (n, H, W) or (n, H, W, C).

    Returns:
        (n, length) bytes of each; short ones are filled up with zeros, which readers of PNG ignore.
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
    """Shapes of what Minari takes for pictures."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        inner = space.spaces
        for each in inner.values() if isinstance(inner, Mapping) else inner:
            yield from _picture_shapes(each)
    elif is_picture(space):
        yield space.shape or ()
