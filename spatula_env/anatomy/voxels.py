"""From voxels to a surface, and from any surface to voxels.

Marching cubes are those of scikit-image (T. Lewiner, H. Lopes, A. W. Vieira and G. Tavares, Efficient implementation of
marching cubes' cases with topological guarantees, Journal of Graphics Tools 8(2), 2003).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.libraries import load
from spatula_env.anatomy.topology import Surface

if TYPE_CHECKING:
    from spatula_env.anatomy.reading import RawVolume
    from spatula_env.arrays import BoolArray, FloatArray

FINEST = 160
"""Most voxels along the longest side of an organ of which marching cubes make a surface; finer ones are merged."""

BLUR = 1.0
"""Standard deviation of the blur that takes the staircases off, in voxels."""

MOST_LISTED = 40
"""Most labels that an error lists."""

MARGIN = 4
"""Empty voxels around an organ, for the blur."""


@dataclass(frozen=True)
class Cleaned:
    """What was done to the voxels of a label.

    Attributes:
        islands: Pieces apart from the largest that were removed.
        removed: Part of the voxels that was in these.
        cavities: Cavities that were filled.
    """

    islands: int
    removed: float
    cavities: int


def choose_label(volume: RawVolume, label: int | None, name: str) -> int:
    """The label of the organ.

    Args:
        volume: All labels.
        label: The wanted one; None takes the only one that is not 0.
        name: The file's name, for errors.

    Raises:
        ValueError: If it is not there, or none was named and there are several; the message lists those that are.
    """
    found, counts = np.unique(volume.labels, return_counts=True)
    there = {int(value): int(count) for value, count in zip(found, counts, strict=True) if value > 0}
    listed = ", ".join(f"{value} ({count} voxels)" for value, count in list(there.items())[:MOST_LISTED])
    if len(there) > MOST_LISTED:
        listed += f" and {len(there) - MOST_LISTED} more; if it is an image and no segmentation, segment it first"
    if not there:
        raise ValueError(f"{name} holds no label: none of its voxels is above 0")
    if label is None and len(there) == 1:
        return next(iter(there))
    if label is None:
        raise ValueError(f"label must be given, as {name} holds several: {listed}")
    if label not in there:
        raise ValueError(f"label must be one of those in {name}, got {label}; there are {listed}")
    return label


def clean_voxels(inside: BoolArray, *, keep_islands: bool, keep_cavities: bool) -> tuple[BoolArray, Cleaned]:
    """Remove islands and fill cavities.

    Args:
        inside: (I, J, K) the voxels of the organ.
        keep_islands: Whether all pieces stay, not the largest alone.
        keep_cavities: Whether cavities stay open.

    Returns:
        The voxels, and what was done.
    """
    ndimage = load("scipy.ndimage")
    islands = cavities = 0
    removed = 0.0
    if not keep_islands:
        # Voxels are of one piece if they share a face: at a shared edge, the surface would be no manifold.
        pieces, count = ndimage.label(inside)
        sizes = np.bincount(pieces.ravel())[1:]
        inside, islands = pieces == 1 + int(np.argmax(sizes)), count - 1
        removed = 1.0 - float(sizes.max() / sizes.sum())
    if not keep_cavities:
        filled = ndimage.binary_fill_holes(inside)
        cavities = int(ndimage.label(filled & ~inside)[1])
        inside = filled
    return inside, Cleaned(islands, removed, cavities)


def crop(inside: BoolArray, affine: FloatArray) -> tuple[BoolArray, FloatArray]:
    """The smallest box around the organ with an empty margin, and its matrix."""
    spans = [np.flatnonzero(inside.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    low = np.array([span[0] for span in spans])
    box = inside[tuple(slice(span[0], span[-1] + 1) for span in spans)]
    matrix = affine.copy()
    matrix[:3, 3] = affine[:3, :3] @ (low - MARGIN) + affine[:3, 3]
    return np.pad(box, MARGIN), matrix


def surface_of_voxels(inside: BoolArray, affine: FloatArray) -> Surface:
    """The surface around voxels, without staircases.

    Args:
        inside: (I, J, K) the voxels of the organ, with an empty margin.
        affine: (4, 4) from indices to positions [m].

    Returns:
        A closed surface.

    Raises:
        ValueError: If nothing is left of the organ after the blur.
    """
    ndimage, measure = load("scipy.ndimage"), load("skimage.measure")
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    extent = float((np.array(inside.shape) * spacing).max())
    # One spacing along all axes: thick slices are interpolated, and a volume finer than needed is coarsened.
    step = max(float(spacing.min()), extent / FINEST)
    blurred = ndimage.gaussian_filter(inside.astype(np.float32), BLUR * np.maximum(1.0, 0.5 * step / spacing))
    # Positions of the new samples, in voxels of the old ones.
    counts = np.maximum(np.ceil((np.array(inside.shape) - 1) * spacing / step).astype(int) + 1, 2)
    sampled = ndimage.zoom(blurred, counts / np.array(inside.shape), order=1, grid_mode=False)
    scale = (np.array(inside.shape) - 1) / (np.array(sampled.shape) - 1)
    if not sampled.max() > 0.5:
        raise ValueError(f"the organ is too thin for its voxels of {1e3 * spacing.max():.3g} mm: nothing is left of it")
    vertices, faces, *_ = measure.marching_cubes(np.pad(sampled, 1), 0.5, allow_degenerate=False)
    places = (vertices - 1.0) * scale @ affine[:3, :3].T + affine[:3, 3]
    return Surface(places.astype(np.float64), faces.astype(np.int64))


def wrap(surface: Surface, pitch: float, closing: float = 0.0) -> Surface:
    """A closed surface around any other one: around a solid of voxels that its triangles and what they enclose fill.

    Holes narrower than a voxel, crossings, non-manifold edges and inner walls vanish.

    Args:
        surface: Triangles.
        pitch: Size of the voxels [m].
        closing: Furrows narrower than twice this are closed, too [m].

    Raises:
        ValueError: If the triangles enclose nothing.
    """
    ndimage, measure = load("scipy.ndimage"), load("skimage.measure")
    margin = MARGIN + int(np.ceil(closing / pitch))
    origin = surface.vertices.min(axis=0) - margin * pitch
    shape = np.ceil(np.ptp(surface.vertices, axis=0) / pitch).astype(int) + 1 + 2 * margin
    shell = np.zeros(shape, dtype=np.bool_)
    shell[tuple(np.rint((_samples(surface, 0.5 * pitch) - origin) / pitch).astype(int).T)] = True
    solid = ndimage.binary_fill_holes(shell)
    if (solid & ~shell).sum() < 0.05 * shell.sum():
        raise ValueError("the surface is open: it encloses nothing")
    pieces = ndimage.label(solid)[0]
    solid = pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    depth = _depth(solid)
    if closing > 0.0:
        depth = np.maximum(depth, _depth(depth > -closing / pitch) - closing / pitch)
    # The outermost voxels have the surface in them, half a voxel inside of the border of the solid.
    smooth = ndimage.gaussian_filter(depth.astype(np.float32), BLUR)
    vertices, faces, *_ = measure.marching_cubes(smooth, 0.5, allow_degenerate=False)
    return Surface(vertices.astype(np.float64) * pitch + origin, faces.astype(np.int64))


def _depth(solid: BoolArray) -> FloatArray:
    """Distance of each voxel's middle from the border of a solid, negative outside, in voxels."""
    edt = load("scipy.ndimage").distance_transform_edt
    depth: FloatArray = np.where(solid, edt(solid) - 0.5, 0.5 - edt(~solid))
    return depth


def _samples(surface: Surface, spacing: float) -> FloatArray:
    """(n, 3) points on the triangles, no farther apart than a spacing."""
    corners = surface.vertices[surface.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    counts = np.maximum(np.ceil(longest / spacing).astype(int), 1)
    found = []
    for count in np.unique(counts):
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        i, j = i[i + j <= count], j[i + j <= count]
        weights = np.column_stack([i, j, count - i - j]) / count
        found.append(np.einsum("nk,tkd->tnd", weights, corners[counts == count]).reshape(-1, 3))
    return np.concatenate(found)
