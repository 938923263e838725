"""Alternatives to the contact detector's ray casting: which triangle does each contact node's ray meet first?

Every contact node has two rays on one line, inwards against its face's normal and outwards along it. Each rival gets
rays, triangles and vertices in its own input format, prepared untimed. The timed part is what every rival has to do
whenever the organ has moved: take in the vertices, update its search structure, and cast all rays. Answers are per ray:
ray 2 i is node i's inward ray, ray 2 i + 1 its outward ray.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from spatula_env.engines import bullet_version, import_bullet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry import Tool

FAR = 1e30
"""Farther than any hit, yet finite, because fast-math code may assume that there are no infinities [u]."""

LANES = 8
"""Number of triangles that the brute force by lanes rejects with one branch."""

RAY_LENGTH = 20.0
"""Length of rays for rivals whose rays must be finite [u]: more than the width of any organ here."""


@dataclass(frozen=True, eq=False)
class Question:
    """A tool at a pose, and the shapes of an organ that it is in contact with.

    Attributes:
        tool: The tool.
        position: (3,) of the tool [u].
        orientation: (4,) of the tool, quaternion xyzw.
        linear_velocity: (3,) of the tool [u/s].
        triangles: (T, 3) int32 of the organ.
        shapes: Vertices of the organ in several shapes, each (V, 3) float64 [u]. The last is far from the others, to
            test whether a rival's search structure follows; it is not timed.
        nodes: (n, 3) the contact nodes in the world [u].
        normals: (n, 3) the nodes' outward normals in the world.
    """

    tool: Tool
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]
    linear_velocity: NDArray[np.float64]
    triangles: NDArray[np.int32]
    shapes: list[NDArray[np.float64]]
    nodes: NDArray[np.float64]
    normals: NDArray[np.float64]

    @property
    def origins(self) -> NDArray[np.float64]:
        """(2 n, 3) origins of the rays [u]."""
        return np.repeat(self.nodes, 2, axis=0)

    @property
    def directions(self) -> NDArray[np.float64]:
        """(2 n, 3) unit directions of the rays."""
        return np.stack([-self.normals, self.normals], axis=1).reshape(-1, 3)


class Rival:
    """One way of answering a question.

    Attributes:
        name: Name in the results.
        version: Name and version of the package that does the work.
    """

    name = ""
    version = ""

    def __init__(self, question: Question) -> None:
        """Prepare the inputs from the question; raises ImportError or OSError if the package is not installed."""

    def query(self, index: int) -> None:
        """Take in shape `index` and cast all rays; this is timed."""
        raise NotImplementedError

    def answer(self) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
        """Results of the last query.

        Returns:
            (triangles, distances): (2 n,) the triangle that each ray meets first, -1 where it meets none, or None for
            a rival that does not report triangles; and (2 n,) its distance, infinite where there is none [u].
        """
        raise NotImplementedError

    def close(self) -> None:
        """Release resources of the operating system or a server."""


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def fill_edges(vertices: np.ndarray, triangles: np.ndarray, edges: np.ndarray) -> None:
    """Write each triangle's first corner and the two edges from it into a row (9,) of `edges`."""
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        for j in range(3):
            edges[k, j] = vertices[a, j]
            edges[k, 3 + j] = vertices[b, j] - vertices[a, j]
            edges[k, 6 + j] = vertices[c, j] - vertices[a, j]


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def cast_lines(
    nodes: np.ndarray,
    normals: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    edges: np.ndarray,
    hits: np.ndarray,
    distances: np.ndarray,
) -> None:
    """Cast both rays of every node: Möller and Trumbore's test of the node's line against every triangle.

    The edges are prepared once for all nodes, one test serves both rays of a line, and the division is done only for
    the few triangles that the line meets.

    Args:
        nodes: (n, 3) common origin of both rays of each node [u].
        normals: (n, 3) direction of the outward ray.
        vertices: (V, 3) [u].
        triangles: (T, 3).
        edges: (T, 9) workspace.
        hits: (n, 2) output: the triangle each ray meets first, inward ray first; -1 where it meets none.
        distances: (n, 2) output: distances of these triangles, `FAR` where there is none [u].
    """
    fill_edges(vertices, triangles, edges)
    for i in range(nodes.shape[0]):
        ox, oy, oz = nodes[i, 0], nodes[i, 1], nodes[i, 2]
        dx, dy, dz = normals[i, 0], normals[i, 1], normals[i, 2]
        inward, outward, inward_distance, outward_distance = -1, -1, FAR, FAR
        for k in range(triangles.shape[0]):
            e1x, e1y, e1z = edges[k, 3], edges[k, 4], edges[k, 5]
            e2x, e2y, e2z = edges[k, 6], edges[k, 7], edges[k, 8]
            px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
            determinant = e1x * px + e1y * py + e1z * pz
            tx, ty, tz = ox - edges[k, 0], oy - edges[k, 1], oz - edges[k, 2]
            v = tx * px + ty * py + tz * pz
            if determinant > 0.0:
                if v < 0.0 or v > determinant:
                    continue
            elif v > 0.0 or v < determinant:
                continue
            qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
            w = dx * qx + dy * qy + dz * qz
            if determinant > 0.0:
                if w < 0.0 or v + w > determinant:
                    continue
            elif w > 0.0 or v + w < determinant or determinant == 0.0:
                continue
            t = (e2x * qx + e2y * qy + e2z * qz) / determinant
            if t >= 0.0:
                if t < outward_distance:
                    outward, outward_distance = k, t
            elif -t < inward_distance:
                inward, inward_distance = k, -t
        hits[i, 0], hits[i, 1] = inward, outward
        distances[i, 0], distances[i, 1] = inward_distance, outward_distance


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def cast_rays(
    nodes: np.ndarray,
    normals: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    edges: np.ndarray,
    hits: np.ndarray,
    distances: np.ndarray,
) -> None:
    """Cast both rays of every node: Möller and Trumbore's test, as published, of each ray against every triangle.

    Arguments are as in `cast_lines`.
    """
    fill_edges(vertices, triangles, edges)
    for i in range(nodes.shape[0]):
        ox, oy, oz = nodes[i, 0], nodes[i, 1], nodes[i, 2]
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            dx, dy, dz = sign * normals[i, 0], sign * normals[i, 1], sign * normals[i, 2]
            hit, distance = -1, FAR
            for k in range(triangles.shape[0]):
                e1x, e1y, e1z = edges[k, 3], edges[k, 4], edges[k, 5]
                e2x, e2y, e2z = edges[k, 6], edges[k, 7], edges[k, 8]
                px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
                determinant = e1x * px + e1y * py + e1z * pz
                if determinant == 0.0:
                    continue
                inverse = 1.0 / determinant
                tx, ty, tz = ox - edges[k, 0], oy - edges[k, 1], oz - edges[k, 2]
                v = (tx * px + ty * py + tz * pz) * inverse
                if v < 0.0 or v > 1.0:
                    continue
                qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
                w = (dx * qx + dy * qy + dz * qz) * inverse
                if w < 0.0 or v + w > 1.0:
                    continue
                t = (e2x * qx + e2y * qy + e2z * qz) * inverse
                if 0.0 <= t < distance:
                    hit, distance = k, t
            hits[i, side], distances[i, side] = hit, distance


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def cast_lines_by_lanes(
    nodes: np.ndarray,
    normals: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    edges: np.ndarray,
    inside: np.ndarray,
    hits: np.ndarray,
    distances: np.ndarray,
) -> None:
    """As `cast_lines`, in a form that the compiler turns into vector instructions.

    For each line, a first loop without branches tests on which side of each triangle's edges it passes, many triangles
    at a time. A second loop picks out the triangles that the line meets, and computes their distances.

    Arguments are as in `cast_lines`, with two differences: `edges` is (T, 9) in Fortran order, so that the same
    component of consecutive triangles is contiguous; and `inside` is a workspace whose length is T rounded up to a
    multiple of `LANES`, and which must be negative beyond T.
    """
    fill_edges(vertices, triangles, edges)
    for i in range(nodes.shape[0]):
        ox, oy, oz = nodes[i, 0], nodes[i, 1], nodes[i, 2]
        dx, dy, dz = normals[i, 0], normals[i, 1], normals[i, 2]
        for k in range(triangles.shape[0]):
            e1x, e1y, e1z = edges[k, 3], edges[k, 4], edges[k, 5]
            e2x, e2y, e2z = edges[k, 6], edges[k, 7], edges[k, 8]
            px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
            tx, ty, tz = ox - edges[k, 0], oy - edges[k, 1], oz - edges[k, 2]
            qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
            v = tx * px + ty * py + tz * pz
            w = dx * qx + dy * qy + dz * qz
            u = e1x * px + e1y * py + e1z * pz - v - w
            # The line meets the triangle if all three have the same sign.
            inside[k] = max(min(u, min(v, w)), -max(u, max(v, w)))
        inward, outward, inward_distance, outward_distance = -1, -1, FAR, FAR
        for first in range(0, inside.shape[0], LANES):
            greatest = inside[first]
            for k in range(first + 1, first + LANES):
                greatest = max(greatest, inside[k])
            if greatest < 0.0:
                continue
            for k in range(first, first + LANES):
                if inside[k] < 0.0:
                    continue
                e1x, e1y, e1z = edges[k, 3], edges[k, 4], edges[k, 5]
                e2x, e2y, e2z = edges[k, 6], edges[k, 7], edges[k, 8]
                nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
                slope = nx * dx + ny * dy + nz * dz
                if slope == 0.0:
                    continue
                t = (nx * (edges[k, 0] - ox) + ny * (edges[k, 1] - oy) + nz * (edges[k, 2] - oz)) / slope
                if t >= 0.0:
                    if t < outward_distance:
                        outward, outward_distance = k, t
                elif -t < inward_distance:
                    inward, inward_distance = k, -t
        hits[i, 0], hits[i, 1] = inward, outward
        distances[i, 0], distances[i, 1] = inward_distance, outward_distance


class BruteForce(Rival):
    """Tests every ray against every triangle, one after the other, with Numba in double precision: as published."""

    name = "brute_force"
    precision: type[np.floating[Any]] = np.float64

    def __init__(self, question: Question) -> None:
        """Prepare the arrays."""
        super().__init__(question)
        self.version = f"numba {version('numba')}"
        self._nodes = question.nodes.astype(self.precision)
        self._normals = question.normals.astype(self.precision)
        self._triangles = question.triangles
        self._shapes = [shape.astype(self.precision) for shape in question.shapes]
        self._edges = np.zeros((len(question.triangles), 9), self.precision)
        self._hits = np.zeros((len(question.nodes), 2), np.int32)
        self._distances = np.zeros((len(question.nodes), 2), self.precision)

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        cast_rays(
            self._nodes, self._normals, self._shapes[index], self._triangles, self._edges, self._hits, self._distances
        )

    def answer(self) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
        """See `Rival.answer`."""
        hits = self._hits.ravel().copy()
        return hits, np.where(hits >= 0, self._distances.ravel().astype(np.float64), np.inf)


class BruteForceByLines(BruteForce):
    """Tests both rays of a node at once by their common line, and divides only where the line meets a triangle."""

    name = "brute_force_by_lines"

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        cast_lines(
            self._nodes, self._normals, self._shapes[index], self._triangles, self._edges, self._hits, self._distances
        )


class BruteForceByLanes(BruteForce):
    """Tests a line against several triangles at once with vector instructions, in single precision as libraries do."""

    name = "brute_force_by_lanes"
    precision = np.float32

    def __init__(self, question: Question) -> None:
        """Lay the arrays out."""
        super().__init__(question)
        count = len(question.triangles)
        self._edges = np.zeros((count, 9), self.precision, order="F")
        self._inside = np.full(-(-count // LANES) * LANES, -1.0, self.precision)

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        cast_lines_by_lanes(
            self._nodes,
            self._normals,
            self._shapes[index],
            self._triangles,
            self._edges,
            self._inside,
            self._hits,
            self._distances,
        )


class WarpMesh(Rival):
    """Warp on the CPU: `Mesh.refit`, then a kernel that calls `mesh_query_ray`, whose launch is recorded beforehand."""

    name = "warp"

    def __init__(self, question: Question) -> None:
        """Build the hierarchy for the first shape and compile the kernel."""
        import warp

        warp.config.log_level = 40  # errors; otherwise it greets on standard output

        def cast(
            mesh: warp.uint64,
            origins: warp.array(dtype=warp.vec3),
            directions: warp.array(dtype=warp.vec3),
            hits: warp.array(dtype=warp.int32),
            distances: warp.array(dtype=warp.float32),
        ):
            ray = warp.tid()
            found = warp.mesh_query_ray(mesh, origins[ray], directions[ray], 1.0e30)
            if found.result:
                hits[ray] = found.face
                distances[ray] = found.t
            else:
                hits[ray] = -1

        self.version = f"warp-lang {version('warp-lang')}"
        count = 2 * len(question.nodes)
        self._shapes = [shape.astype(np.float32) for shape in question.shapes]
        points = warp.array(self._shapes[0], dtype=warp.vec3, device="cpu")
        indices = warp.array(question.triangles.ravel(), dtype=warp.int32, device="cpu")
        # "sah" was the fastest of the BVH constructors that are available on the CPU.
        self._mesh = warp.Mesh(points=points, indices=indices, bvh_constructor="sah")
        self._points = points.numpy()
        hits = warp.zeros(count, dtype=warp.int32, device="cpu")
        distances = warp.zeros(count, dtype=warp.float32, device="cpu")
        origins, directions = (
            warp.array(rays.astype(np.float32), dtype=warp.vec3, device="cpu")
            for rays in (question.origins, question.directions)
        )
        self._launch = warp.launch(
            warp.kernel(cast, enable_backward=False),
            dim=count,
            inputs=[self._mesh.id, origins, directions, hits, distances],
            device="cpu",
            record_cmd=True,
        )
        self._arrays = (points, indices, origins, directions, hits, distances)
        self._hits, self._distances = hits.numpy(), distances.numpy()

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        self._points[:] = self._shapes[index]
        self._mesh.refit()
        self._launch.launch()

    def answer(self) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
        """See `Rival.answer`."""
        return self._hits.copy(), np.where(self._hits >= 0, self._distances, np.inf)


class Open3DScene(Rival):
    """Open3D's `RaycastingScene`, which has to be rebuilt for every shape."""

    name = "open3d"

    def __init__(self, question: Question) -> None:
        """Make the tensors."""
        import open3d

        self.version = f"open3d {open3d.__version__}"
        self._open3d = open3d
        tensor = open3d.core.Tensor
        self._shapes = [tensor(shape.astype(np.float32)) for shape in question.shapes]
        self._triangles = tensor(question.triangles.astype(np.uint32))
        self._rays = tensor(np.concatenate([question.origins, question.directions], axis=1).astype(np.float32))
        self._found: dict[str, Any] = {}

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        scene = self._open3d.t.geometry.RaycastingScene()
        scene.add_triangles(self._shapes[index], self._triangles)
        self._found = scene.cast_rays(self._rays)

    def answer(self) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
        """See `Rival.answer`."""
        # "No hit" is the greatest unsigned number, which is -1 as a signed one.
        return self._found["primitive_ids"].numpy().astype(np.int32), self._found["t_hit"].numpy().astype(np.float64)


class EmbreeScene(Rival):
    """Embree through embreex's own interface; the scene has to be rebuilt for every shape."""

    name = "embreex"

    def __init__(self, question: Question) -> None:
        """Lay the arrays out."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene as Scene

        self.version = f"embreex {version('embreex')}"
        self._make_scene, self._make_mesh = Scene, TriangleMesh
        self._shapes = [shape.astype(np.float32) for shape in question.shapes]
        self._triangles = question.triangles
        self._origins = question.origins.astype(np.float32)
        self._directions = question.directions.astype(np.float32)
        self._found: dict[str, Any] = {}

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        scene = self._make_scene()
        self._make_mesh(scene, self._shapes[index], self._triangles)
        self._found = scene.run(self._origins, self._directions, output=True)

    def answer(self) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
        """See `Rival.answer`."""
        hits = self._found["primID"].astype(np.int32)
        return hits, np.where(hits >= 0, self._found["tfar"], np.inf).astype(np.float64)


class BulletRays(Rival):
    """PyBullet's `rayTestBatch` on a soft body whose vertices are set by `resetMeshData`.

    It does not report which triangle was hit. It also answers for an earlier shape than the one set: the tree of faces
    and their normals are updated only in `stepSimulation`, which costs several times as much as the rays and moves the
    vertices. It is therefore timed, but not comparable.
    """

    name = "pybullet"

    def __init__(self, question: Question) -> None:
        """Load the first shape as a soft body."""
        pybullet = import_bullet("rayTestBatch")
        self.version = " ".join(bullet_version() or ("pybullet",))
        self._bullet = pybullet
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.resetSimulation(0, physicsClientId=self._client)
        handle, name = tempfile.mkstemp(suffix=".obj", prefix="spatula_env-")
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                file.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in question.shapes[0])
                file.writelines(f"f {a} {b} {c}\n" for a, b, c in question.triangles + 1)
            self._body = pybullet.loadSoftBody(name, mass=1.0, useMassSpring=1, physicsClientId=self._client)
        finally:
            Path(name).unlink()
        # Lists, and the same ones every time: resetMeshData never releases the sequences it is given.
        self._shapes = [shape.tolist() for shape in question.shapes]
        self._starts = question.origins.tolist()
        self._ends = (question.origins + RAY_LENGTH * question.directions).tolist()
        self._found: Any = ()

    def query(self, index: int) -> None:
        """See `Rival.query`."""
        self._bullet.resetMeshData(self._body, self._shapes[index], physicsClientId=self._client)
        self._found = self._bullet.rayTestBatch(self._starts, self._ends, physicsClientId=self._client)

    def answer(self) -> tuple[NDArray[np.int32] | None, NDArray[np.float64]]:
        """See `Rival.answer`."""
        return None, np.array([RAY_LENGTH * ray[2] if ray[0] == self._body else np.inf for ray in self._found])

    def close(self) -> None:
        """End the physics server."""
        self._bullet.disconnect(physicsClientId=self._client)


WRITTEN_HERE: tuple[type[Rival], ...] = (BruteForce, BruteForceByLines, BruteForceByLanes)
LIBRARIES: tuple[type[Rival], ...] = (WarpMesh, Open3DScene, EmbreeScene, BulletRays)
