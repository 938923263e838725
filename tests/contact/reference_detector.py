"""A slow and plain reference implementation of the flags method, for the tests to compare with.

It follows the published description: every ray is tested against every triangle by Möller and Trumbore's test, and the
nodes are visited one after the other in a Python loop. Only the tool's arrays are shared with the package.

One rule, `exclusive`, is not in the description. It matters only where a surface overlaps itself or has holes, so that
the inward ray of a node finds it inside and the outward ray outside: a node whose opposite has been given the contact
in the same query, and which is itself inside, is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class ReferenceContacts:
    flags: np.ndarray
    unfeasible: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    points: np.ndarray


def rotation_matrix(quaternion):
    """Rotation matrix of a unit quaternion xyzw, by Rodrigues' formula."""
    x, y, z, w = (float(value) for value in quaternion)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def random_rotation(generator):
    """A random unit quaternion xyzw: four normal numbers are a direction in four dimensions."""
    quaternion = generator.normal(size=4)
    return quaternion / np.linalg.norm(quaternion)


def cross(a, b):
    """Cross products of vectors along the last axis."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


class Surface:
    """A triangle surface to cast rays at."""

    def __init__(self, vertices, triangles):
        corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles, dtype=np.int64)]
        self.origin, self.first, self.second = (
            corners[:, 0],
            corners[:, 1] - corners[:, 0],
            corners[:, 2] - corners[:, 0],
        )
        normals = cross(self.first, self.second)
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def cast(self, start, direction):
        """First triangle along a ray: (index or -1, distance, weights of the three corners)."""
        p = cross(direction[None, :], self.second)
        determinant = (self.first * p).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / determinant
            away = start - self.origin
            v = (away * p).sum(axis=1) * inverse
            q = cross(away, self.first)
            w = (q @ direction) * inverse
            t = (self.second * q).sum(axis=1) * inverse
            hit = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (t >= 0.0)
        if not hit.any():
            return -1, np.inf, np.zeros(3)
        nearest = int(np.argmin(np.where(hit, t, np.inf)))
        return nearest, t[nearest], np.array([1.0 - v[nearest] - w[nearest], v[nearest], w[nearest]])


class ReferenceDetector:
    """The two steps of the method for each node; flags are kept from query to query."""

    def __init__(self, tool, first_step="inside", exclusive=True):
        self.tool, self.first_step, self.exclusive = tool, first_step, exclusive
        self.flags = [False] * len(tool.nodes)

    def detect(
        self,
        position,
        orientation,
        vertices,
        triangles,
        linear_velocity=(0.0, 0.0, 0.0),
        angular_velocity=(0.0, 0.0, 0.0),
    ):
        tool, count = self.tool, len(self.tool.nodes)
        turned = rotation_matrix(orientation)
        arms = tool.nodes @ turned.T
        places = arms + np.asarray(position, dtype=np.float64)
        outwards = tool.normals @ turned.T
        velocities = np.asarray(linear_velocity) + cross(
            np.broadcast_to(np.asarray(angular_velocity), arms.shape), arms
        )
        leads = (velocities * outwards).sum(axis=1) > 0.0
        surface = Surface(vertices, triangles)
        found = ReferenceContacts(
            flags=np.zeros(count, dtype=bool),
            unfeasible=np.zeros(count, dtype=bool),
            triangle=np.full(count, -1),
            barycentric=np.zeros((count, 3)),
            depth=np.zeros(count),
            normal=np.zeros((count, 3)),
            points=places.copy(),
        )
        visited = set()
        for node in [*np.flatnonzero(leads), *np.flatnonzero(~leads)]:
            visited.add(node)
            index, distance, weights = surface.cast(places[node], -outwards[node])
            is_inside = bool(index >= 0 and surface.normals[index] @ outwards[node] < 0.0)
            # First step: does the opposite node own a contact, and is it inside the organ?
            other = tool.opposite[node]
            if self.first_step != "off" and self.flags[other]:
                beyond, _, _ = surface.cast(places[other], outwards[other])
                refused = beyond >= 0 and (
                    self.first_step == "any_hit" or surface.normals[beyond] @ outwards[other] > 0.0
                )
                if refused or (self.exclusive and other in visited and is_inside):
                    self.flags[node] = False
                    found.unfeasible[node] = True
                    continue
            # Second step: is this node inside the organ?
            self.flags[node] = is_inside
            if is_inside:
                found.triangle[node] = index
                found.barycentric[node] = weights
                found.depth[node] = distance
                found.normal[node] = surface.normals[index]
                found.points[node] = places[node] - distance * outwards[node]
        found.flags[:] = self.flags
        return found
