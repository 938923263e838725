"""A pinhole camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.geometry.transforms import as_vector3

Vector = tuple[float, float, float]


def to_vector(value: ArrayLike, name: str) -> Vector:
    """Check one vector.

    Args:
        value: three finite numbers.
        name: the name that an error shows.

    Returns:
        The vector as a tuple of floats.

    Raises:
        ValueError: if `value` is not three finite numbers.
    """
    x, y, z = as_vector3(value, name).tolist()
    return (x, y, z)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: square pixels, the optical axis through the middle of the picture.

    Pixels are counted from the top left corner of the picture, x to the right and y down; the centre of the first
    pixel is (0.5, 0.5). *Depth* is the distance along the optical axis, not along the ray. Two cameras with the same
    numbers are equal, so a camera can be a key.

    Attributes:
        position: the eye, u (x, y, z).
        target: the point in the middle of the picture, u.
        up: the direction that points up in the picture; not parallel to the view.
        vertical_field_of_view: the angle between the upper and the lower edge of the picture, degrees.
        near: depth below which nothing is drawn, u.
        far: depth above which nothing is drawn, u.

    Raises:
        ValueError: if a vector is not three finite numbers, the target is at the position, `up` is parallel to the
            view, the angle is outside 1..179 degrees, or not 0 < near < far.
    """

    position: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    vertical_field_of_view: float = 40.0
    near: float = 0.05
    far: float = 200.0

    def __post_init__(self) -> None:
        for name in ("position", "target", "up"):
            object.__setattr__(self, name, to_vector(getattr(self, name), name))
        for name in ("vertical_field_of_view", "near", "far"):
            object.__setattr__(self, name, float(getattr(self, name)))
        forward = np.subtract(self.target, self.position)
        distance = float(np.linalg.norm(forward))
        if distance < 1e-9:
            raise ValueError(f"target must differ from position, got {self.target} for both")
        up_length = float(np.linalg.norm(self.up))
        if up_length < 1e-9 or float(np.linalg.norm(np.cross(forward, self.up))) < 1e-6 * distance * up_length:
            raise ValueError(f"up must not be zero or parallel to the view, got {self.up}")
        if not 1.0 <= self.vertical_field_of_view <= 179.0:
            raise ValueError(f"vertical_field_of_view must be in 1..179 degrees, got {self.vertical_field_of_view}")
        if not 0.0 < self.near < self.far < math.inf:
            raise ValueError(f"near and far must obey 0 < near < far, got near={self.near}, far={self.far}")

    @classmethod
    def orbit(
        cls,
        target: ArrayLike,
        distance: float,
        azimuth: float,
        elevation: float,
        *,
        vertical_field_of_view: float = 40.0,
        near: float = 0.05,
        far: float = 200.0,
    ) -> Camera:
        """A camera on a sphere around a target, z up.

        Args:
            target: the point it looks at, u (3,).
            distance: from the target, u, above zero.
            azimuth: degrees about z from the x axis towards the y axis, to the camera as seen from the target.
            elevation: degrees above the horizontal plane, between -89.9 and 89.9.
            vertical_field_of_view: degrees.
            near: near depth, u.
            far: far depth, u.

        Returns:
            The camera.

        Raises:
            ValueError: if `distance` or `elevation` is out of its range, or as the class says.
        """
        if not 0.0 < distance < math.inf:
            raise ValueError(f"distance must be above zero and finite, got {distance}")
        if not -89.9 <= elevation <= 89.9:
            raise ValueError(f"elevation must be in -89.9..89.9 degrees, got {elevation}")
        middle = to_vector(target, "target")
        turn, rise = math.radians(azimuth), math.radians(elevation)
        position = (
            middle[0] + distance * math.cos(rise) * math.cos(turn),
            middle[1] + distance * math.cos(rise) * math.sin(turn),
            middle[2] + distance * math.sin(rise),
        )
        return cls(position, middle, vertical_field_of_view=vertical_field_of_view, near=near, far=far)

    def axes(self) -> NDArray[np.float64]:
        """The unit vectors right, up and forward in the world, the rows of a (3, 3) array."""
        forward = np.subtract(self.target, self.position)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])

    def view_matrix(self) -> NDArray[np.float64]:
        """World to camera, (4, 4), in OpenGL's convention: x right, y up, the camera looks along -z."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.axes() * np.array([[1.0], [1.0], [-1.0]])
        matrix[:3, 3] = -matrix[:3, :3] @ self.position
        return matrix

    def projection_matrix(self, aspect: float) -> NDArray[np.float64]:
        """Camera to clip space, (4, 4), in OpenGL's convention.

        Args:
            aspect: width of the picture over its height, above zero.

        Raises:
            ValueError: if `aspect` is not above zero.
        """
        if not 0.0 < aspect < math.inf:
            raise ValueError(f"aspect must be above zero and finite, got {aspect}")
        scale = 1.0 / math.tan(math.radians(self.vertical_field_of_view) / 2.0)
        span = self.near - self.far
        matrix = np.zeros((4, 4))
        matrix[0, 0] = scale / aspect
        matrix[1, 1] = scale
        matrix[2, 2] = (self.far + self.near) / span
        matrix[2, 3] = 2.0 * self.far * self.near / span
        matrix[3, 2] = -1.0
        return matrix

    def intrinsics(self, width: int, height: int) -> NDArray[np.float64]:
        """The matrix K of the pinhole model, (3, 3), in pixels: pixel = K (right, down, depth) / depth."""
        _check_size(width, height)
        focal = 0.5 * height / math.tan(math.radians(self.vertical_field_of_view) / 2.0)
        return np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])

    def project(self, points: ArrayLike, width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project points into the picture.

        Args:
            points: world points, u (..., 3).
            width: of the picture, pixels.
            height: of the picture, pixels.

        Returns:
            Pixels (..., 2) and depth, u (...,). A point at the depth of the eye or behind it has pixels NaN.

        Raises:
            ValueError: if the last axis of `points` is not 3 or the size is below one pixel.
        """
        array = np.asarray(points, dtype=np.float64)
        if array.ndim < 1 or array.shape[-1] != 3:
            raise ValueError(f"points must have the shape (..., 3), got {array.shape}")
        matrix = self.intrinsics(width, height)
        local = (array - np.asarray(self.position)) @ self.axes().T
        depth = local[..., 2]
        ahead = np.where(depth > 0.0, depth, np.nan)
        pixels = np.stack(
            [
                matrix[0, 2] + matrix[0, 0] * local[..., 0] / ahead,
                matrix[1, 2] - matrix[1, 1] * local[..., 1] / ahead,
            ],
            axis=-1,
        )
        return pixels, np.asarray(depth)

    def unproject(self, depth: ArrayLike) -> NDArray[np.float64]:
        """World points of a depth picture.

        Args:
            depth: (H, W), u, as `Renderer.render_rgbd` returns it; the points are those at the pixel centres.

        Returns:
            World points, u (H, W, 3).

        Raises:
            ValueError: if `depth` has not two axes.
        """
        array = np.asarray(depth, dtype=np.float64)
        if array.ndim != 2:
            raise ValueError(f"depth must have the shape (H, W), got {array.shape}")
        height, width = array.shape
        matrix = self.intrinsics(width, height)
        across = (np.arange(width) + 0.5 - matrix[0, 2]) / matrix[0, 0]
        down = (np.arange(height) + 0.5 - matrix[1, 2]) / matrix[1, 1]
        right, up, forward = self.axes()
        rays = across[None, :, None] * right - down[:, None, None] * up + forward
        return np.asarray(np.asarray(self.position) + rays * array[..., None])


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise ValueError(f"width and height must be one pixel or more, got {width} x {height}")
