"""From contacts to motion: the organ is moved out of the tool, and the momentum that takes is what the tool feels.

Both halves are projected Gauss-Seidel sweeps over unilateral constraints. A constraint holds one point of the organ's
surface, s = sum of weight x vertex, on the far side of a plane with normal n through a point p:

- positions: (s - p) . n >= 0, by mass-weighted displacements. This is the enforced displacement of Fukuhara et al.
  (ROBOMECH Journal 1:6, 2014). It gives no velocity, so it adds no kinetic energy, however deep the tool came.
- velocities: (ds/dt - dp/dt) . n >= -gap / dt, by impulses. They are the only exchange of momentum between organ and
  tool, so the wrench on the tool is minus their sum.

Friction is Coulomb's, in the same sweeps: a tangential displacement (or impulse) that cancels the slip, limited to the
friction coefficient times the normal one. Limiting displacements as well as impulses makes friction static: a point
held inside the cone does not creep (Müller et al., Detailed rigid body simulation with extended position based
dynamics, Computer Graphics Forum 39(8), 2020, section 3.5).
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import inline_kernel, kernel
from spatula_env.contact.raycast import line_meets_triangle
from spatula_env.contact.rigid import dot, opposes_best, turn

CONTACT_MARGIN = 1e-4
"""What is no farther from a plane than this touches it [u]."""

GROUND = -1
"""Owner of a constraint that is not a tool's."""


class Constraints:
    """Room for the unilateral constraints of one step, filled and solved by the kernels of this module.

    Attributes:
        count: How many are in use.
        corners: (C, 3) the three vertices that carry the constrained point.
        weights: (C, 3) their weights, summing to one.
        normal: (C, 3) n, towards the organ.
        point: (C, 3) p [u].
        carry: (C, 3) how far p has moved since the reference positions of the organ [u].
        velocity: (C, 3) dp/dt [u/s].
        friction: (C,) coefficient.
        owner: (C,) index of the tool, or `GROUND`.
        node: (C,) index of the tool's contact node, or -1 for a vertex of the organ.
        displacement: (C, 3) what the position solve applied, mass times length [kg u].
        impulse: (C, 3) what the velocity solve applied to the organ [kg u/s].
        gap: (C,) (s - p) . n after the position solve [u].
    """

    def __init__(self, capacity: int) -> None:
        """Make room for `capacity` constraints."""
        self.count = 0
        self.corners = np.zeros((capacity, 3), dtype=np.int32)
        self.weights = np.zeros((capacity, 3))
        self.normal = np.zeros((capacity, 3))
        self.point = np.zeros((capacity, 3))
        self.carry = np.zeros((capacity, 3))
        self.velocity = np.zeros((capacity, 3))
        self.friction = np.zeros(capacity)
        self.owner = np.zeros(capacity, dtype=np.int32)
        self.node = np.zeros(capacity, dtype=np.int32)
        self.displacement = np.zeros((capacity, 3))
        self.impulse = np.zeros((capacity, 3))
        self.gap = np.zeros(capacity)

    @property
    def planes(self) -> tuple[np.ndarray, ...]:
        """The arrays that `add_*_constraints` write, from `corners` to `node`."""
        return (
            self.corners,
            self.weights,
            self.normal,
            self.point,
            self.carry,
            self.velocity,
            self.friction,
            self.owner,
            self.node,
        )

    @property
    def capacity(self) -> int:
        """How many constraints there is room for."""
        return len(self.friction)


@inline_kernel
def _project_onto_cone(value: np.ndarray, nx: float, ny: float, nz: float, normal_part: float, friction: float) -> None:
    """Set `value` to normal_part n plus its tangential part, the latter shortened to friction x normal_part."""
    along = value[0] * nx + value[1] * ny + value[2] * nz
    tx, ty, tz = value[0] - along * nx, value[1] - along * ny, value[2] - along * nz
    length = np.sqrt(tx * tx + ty * ty + tz * tz)
    limit = friction * normal_part
    scale = limit / length if length > limit else 1.0
    value[0], value[1], value[2] = (
        normal_part * nx + scale * tx,
        normal_part * ny + scale * ty,
        normal_part * nz + scale * tz,
    )


@kernel(
    "f8(i8, i4[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8[:,::1],"
    " f8[:,::1], f8[::1], i8, f8)"
)
def solve_positions(
    count: int,
    corners: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    point: np.ndarray,
    carry: np.ndarray,
    friction: np.ndarray,
    inverse_mass: np.ndarray,
    reference: np.ndarray,
    vertices: np.ndarray,
    displacement: np.ndarray,
    gap: np.ndarray,
    sweeps: int,
    tolerance: float,
) -> float:
    """Move the vertices until a sweep moves no constrained point by more than `tolerance`.

    Args:
        count: How many constraints; the arrays are those of `Constraints`.
        corners: See there, as the next five.
        weights: See there.
        normal: See there.
        point: See there.
        carry: See there.
        friction: See there.
        inverse_mass: (V,) [1/kg].
        reference: (V, 3) positions from which slip is counted [u].
        vertices: (V, 3) positions; changed [u].
        displacement: (C, 3) result [kg u].
        gap: (C,) result [u].
        sweeps: Greatest number of sweeps.
        tolerance: [u].

    Returns:
        The greatest violation left [u].
    """
    for c in range(count):
        displacement[c, 0], displacement[c, 1], displacement[c, 2] = 0.0, 0.0, 0.0
    for _ in range(sweeps):
        moved = 0.0
        for c in range(count):
            i, j, k = corners[c, 0], corners[c, 1], corners[c, 2]
            a, b, d = weights[c, 0], weights[c, 1], weights[c, 2]
            nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
            sx = a * vertices[i, 0] + b * vertices[j, 0] + d * vertices[k, 0]
            sy = a * vertices[i, 1] + b * vertices[j, 1] + d * vertices[k, 1]
            sz = a * vertices[i, 2] + b * vertices[j, 2] + d * vertices[k, 2]
            violation = (point[c, 0] - sx) * nx + (point[c, 1] - sy) * ny + (point[c, 2] - sz) * nz
            ox, oy, oz = displacement[c, 0], displacement[c, 1], displacement[c, 2]
            before = ox * nx + oy * ny + oz * nz
            mobility = a * a * inverse_mass[i] + b * b * inverse_mass[j] + d * d * inverse_mass[k]
            if (violation <= 0.0 and before <= 0.0) or mobility == 0.0:
                continue
            inertia = 1.0 / mobility
            along = max(before + violation * inertia, 0.0)
            new = displacement[c]
            if friction[c] > 0.0:
                slip_x = sx - carry[c, 0] - a * reference[i, 0] - b * reference[j, 0] - d * reference[k, 0]
                slip_y = sy - carry[c, 1] - a * reference[i, 1] - b * reference[j, 1] - d * reference[k, 1]
                slip_z = sz - carry[c, 2] - a * reference[i, 2] - b * reference[j, 2] - d * reference[k, 2]
                new[0], new[1], new[2] = ox - slip_x * inertia, oy - slip_y * inertia, oz - slip_z * inertia
            _project_onto_cone(new, nx, ny, nz, along, friction[c])
            dx, dy, dz = new[0] - ox, new[1] - oy, new[2] - oz
            moved = max(moved, np.sqrt(dx * dx + dy * dy + dz * dz) / inertia)
            wi, wj, wk = a * inverse_mass[i], b * inverse_mass[j], d * inverse_mass[k]
            vertices[i, 0] += wi * dx
            vertices[i, 1] += wi * dy
            vertices[i, 2] += wi * dz
            vertices[j, 0] += wj * dx
            vertices[j, 1] += wj * dy
            vertices[j, 2] += wj * dz
            vertices[k, 0] += wk * dx
            vertices[k, 1] += wk * dy
            vertices[k, 2] += wk * dz
        if moved <= tolerance:
            break
    worst = 0.0
    for c in range(count):
        gap[c] = 0.0
        for corner in range(3):
            for axis in range(3):
                gap[c] += weights[c, corner] * normal[c, axis] * vertices[corners[c, corner], axis]
        for axis in range(3):
            gap[c] -= normal[c, axis] * point[c, axis]
        worst = max(worst, -gap[c])
    return worst


@kernel(
    "f8(i8, i4[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8, i8, f8)"
)
def solve_velocities(
    count: int,
    corners: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    gap: np.ndarray,
    inverse_mass: np.ndarray,
    velocities: np.ndarray,
    impulse: np.ndarray,
    dt: float,
    sweeps: int,
    tolerance: float,
) -> float:
    """Change the vertices' velocities by impulses until a sweep changes none by more than `tolerance`.

    Args:
        count: How many constraints; the arrays are those of `Constraints`.
        corners: See there, as the next five.
        weights: See there.
        normal: See there.
        velocity: See there.
        friction: See there.
        gap: See there.
        inverse_mass: (V,) [1/kg].
        velocities: (V, 3) of the vertices; changed [u/s].
        impulse: (C, 3) result, on the organ [kg u/s].
        dt: Length of the step [s].
        sweeps: Greatest number of sweeps.
        tolerance: [u/s].

    Returns:
        The greatest change of a constrained point's velocity in the last sweep [u/s].
    """
    for c in range(count):
        impulse[c, 0], impulse[c, 1], impulse[c, 2] = 0.0, 0.0, 0.0
    moved = 0.0
    for _ in range(sweeps):
        moved = 0.0
        for c in range(count):
            i, j, k = corners[c, 0], corners[c, 1], corners[c, 2]
            a, b, d = weights[c, 0], weights[c, 1], weights[c, 2]
            nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
            vx = a * velocities[i, 0] + b * velocities[j, 0] + d * velocities[k, 0] - velocity[c, 0]
            vy = a * velocities[i, 1] + b * velocities[j, 1] + d * velocities[k, 1] - velocity[c, 1]
            vz = a * velocities[i, 2] + b * velocities[j, 2] + d * velocities[k, 2] - velocity[c, 2]
            closing = -(vx * nx + vy * ny + vz * nz) - max(gap[c], 0.0) / dt
            ox, oy, oz = impulse[c, 0], impulse[c, 1], impulse[c, 2]
            before = ox * nx + oy * ny + oz * nz
            mobility = a * a * inverse_mass[i] + b * b * inverse_mass[j] + d * d * inverse_mass[k]
            if (closing <= 0.0 and before <= 0.0) or mobility == 0.0:
                continue
            inertia = 1.0 / mobility
            along = max(before + closing * inertia, 0.0)
            new = impulse[c]
            if friction[c] > 0.0:
                new[0], new[1], new[2] = ox - vx * inertia, oy - vy * inertia, oz - vz * inertia
            _project_onto_cone(new, nx, ny, nz, along, friction[c])
            dx, dy, dz = new[0] - ox, new[1] - oy, new[2] - oz
            moved = max(moved, np.sqrt(dx * dx + dy * dy + dz * dz) / inertia)
            wi, wj, wk = a * inverse_mass[i], b * inverse_mass[j], d * inverse_mass[k]
            velocities[i, 0] += wi * dx
            velocities[i, 1] += wi * dy
            velocities[i, 2] += wi * dz
            velocities[j, 0] += wj * dx
            velocities[j, 1] += wj * dy
            velocities[j, 2] += wj * dz
            velocities[k, 0] += wk * dx
            velocities[k, 1] += wk * dy
            velocities[k, 2] += wk * dz
        if moved <= tolerance:
            break
    return moved


@inline_kernel
def _fill_plane(
    c: int,
    place: np.ndarray,
    direction: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    start_position: np.ndarray,
    start_rotation: np.ndarray,
    linear_velocity: np.ndarray,
    angular_velocity: np.ndarray,
    normal: np.ndarray,
    point: np.ndarray,
    carry: np.ndarray,
    velocity: np.ndarray,
) -> None:
    """Write normal, point, carry and velocity of constraint c for a point of the tool (tool frame)."""
    rx, ry, rz = turn(rotation, place)
    normal[c, 0], normal[c, 1], normal[c, 2] = turn(rotation, direction)
    point[c, 0], point[c, 1], point[c, 2] = position[0] + rx, position[1] + ry, position[2] + rz
    sx, sy, sz = turn(start_rotation, place)
    carry[c, 0] = point[c, 0] - start_position[0] - sx
    carry[c, 1] = point[c, 1] - start_position[1] - sy
    carry[c, 2] = point[c, 2] - start_position[2] - sz
    velocity[c, 0] = linear_velocity[0] + angular_velocity[1] * rz - angular_velocity[2] * ry
    velocity[c, 1] = linear_velocity[1] + angular_velocity[2] * rx - angular_velocity[0] * rz
    velocity[c, 2] = linear_velocity[2] + angular_velocity[0] * ry - angular_velocity[1] * rx


@kernel(
    "i8(i8, b1[:,::1], i4[::1], f8[:,::1], f8[:,::1], f8[:,::1], i4[:,::1], i8, f8[::1], f8[::1], f8[::1], f8[::1],"
    " f8[::1], f8[::1], f8, i4, i4[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], i4[::1],"
    " i4[::1])"
)
def add_node_constraints(
    count: int,
    states: np.ndarray,
    triangle: np.ndarray,
    record: np.ndarray,
    nodes: np.ndarray,
    normals: np.ndarray,
    triangles: np.ndarray,
    first_vertex: int,
    position: np.ndarray,
    rotation: np.ndarray,
    start_position: np.ndarray,
    start_rotation: np.ndarray,
    linear_velocity: np.ndarray,
    angular_velocity: np.ndarray,
    coefficient: float,
    tool: int,
    corners: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    point: np.ndarray,
    carry: np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    owner: np.ndarray,
    node: np.ndarray,
) -> int:
    """Append one constraint for each flagged node: the contact point stays on the outer side of the node's face.

    Args:
        count: Constraints already there.
        states: (3, n) of the detector, flags first.
        triangle: (n,) of the detector.
        record: (n, 10) of the detector, weights first.
        nodes: (n, 3) tool frame [u].
        normals: (n, 3) tool frame.
        triangles: (T, 3) of the organ.
        first_vertex: Index of the organ's first vertex among all.
        position: (3,) of the tool [u].
        rotation: (9,) of the tool.
        start_position: (3,) of the tool when slip begins to count [u].
        start_rotation: (9,) then.
        linear_velocity: (3,) of the tool [u/s].
        angular_velocity: (3,) [rad/s].
        coefficient: Of friction.
        tool: Its index.
        corners: Arrays of `Constraints`, as the next eight.
        weights: See there.
        normal: See there.
        point: See there.
        carry: See there.
        velocity: See there.
        friction: See there.
        owner: See there.
        node: See there.

    Returns:
        The new count.
    """
    for i in range(nodes.shape[0]):
        if not states[0, i]:
            continue
        for k in range(3):
            corners[count, k] = triangles[triangle[i], k] + first_vertex
            weights[count, k] = record[i, k]
        _fill_plane(
            count, nodes[i], normals[i], position, rotation, start_position, start_rotation, linear_velocity,
            angular_velocity, normal, point, carry, velocity,
        )  # fmt: skip
        friction[count], owner[count], node[count] = coefficient, tool, i
        count += 1
    return count


@inline_kernel
def _clip_to_face(
    start: np.ndarray,
    end: np.ndarray,
    face_normal: np.ndarray,
    plane_normals: np.ndarray,
    plane_offsets: np.ndarray,
) -> tuple[float, float]:
    """The part of a segment (tool frame) that lies over a face, as fractions (first, last); empty if first > last."""
    first, last = 0.0, 1.0
    for p in range(plane_normals.shape[0]):
        # The face's own plane and its opposite do not bound it sideways.
        if abs(dot(plane_normals[p], face_normal)) > 1.0 - 1e-9:
            continue
        at_start = dot(plane_normals[p], start) - plane_offsets[p]
        at_end = dot(plane_normals[p], end) - plane_offsets[p]
        if at_start > 0.0 and at_end > 0.0:
            return 1.0, 0.0
        if at_start > 0.0:
            first = max(first, at_start / (at_start - at_end))
        elif at_end > 0.0:
            last = min(last, at_start / (at_start - at_end))
    return first, last


@kernel(
    "i8(i8, b1[:,::1], f8[:,::1], i4[::1], f8[:,:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], i4[::1], f8[:,::1],"
    " f8[::1], b1, i4[:,::1], f8[:,::1], i8, f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8, i4,"
    " f8[:,::1], u1[::1], i4[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], i4[::1], i4[::1])"
)
def add_surface_constraints(
    count: int,
    states: np.ndarray,
    record: np.ndarray,
    face: np.ndarray,
    face_frames: np.ndarray,
    face_bounds: np.ndarray,
    face_heights: np.ndarray,
    face_slack: np.ndarray,
    face_corners: np.ndarray,
    first_corner: np.ndarray,
    plane_normals: np.ndarray,
    plane_offsets: np.ndarray,
    selective: bool,
    triangles: np.ndarray,
    vertices: np.ndarray,
    first_vertex: int,
    position: np.ndarray,
    rotation: np.ndarray,
    start_position: np.ndarray,
    start_rotation: np.ndarray,
    linear_velocity: np.ndarray,
    angular_velocity: np.ndarray,
    coefficient: float,
    tool: int,
    local: np.ndarray,
    codes: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    point: np.ndarray,
    carry: np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    owner: np.ndarray,
    node: np.ndarray,
) -> int:
    """Append constraints where the organ's surface between the contact nodes has come through a face in contact.

    Over a flat face the organ's surface is a piecewise linear height; it is greatest at a corner of the face, at a
    vertex of the organ over the face, or where an edge of the organ crosses the rim of the face. Each of these that
    is behind the face's plane, but no deeper than the face's deepest node, gets a constraint, so that nothing of the
    organ is left in the tool, however coarse the contact nodes.

    Args:
        count: Constraints already there.
        states: As in `add_node_constraints`.
        record: See there.
        face: (n,) of the tool.
        face_frames: (F, 3, 3) rows u, v, w of the faces with nodes, w their outward normal, tool frame.
        face_bounds: (F, 4) least u, greatest u, least v, greatest v of each face [u].
        face_heights: (F,) w of each face [u].
        face_slack: (F,) how much deeper than its deepest node a face may be in the organ [u].
        face_corners: (K, 2) u and v of the corners of all faces, face after face [u].
        first_corner: (F + 1,) index of each face's first corner, and their number.
        plane_normals: (P, 3) of all the tool's planes, tool frame.
        plane_offsets: (P,) normal . x on each plane [u].
        selective: Whether a triangle counts only for the face that opposes it best.
        triangles: (T, 3) of the organ.
        vertices: (V, 3) of all organs [u].
        first_vertex: As in `add_node_constraints`, as the next eight.
        position: See there.
        rotation: See there.
        start_position: See there.
        start_rotation: See there.
        linear_velocity: See there.
        angular_velocity: See there.
        coefficient: See there.
        tool: See there.
        local: (3, V of the organ) workspace.
        codes: (V of the organ,) workspace.
        corners: Arrays of `Constraints`, as the next eight.
        weights: See there.
        normal: See there.
        point: See there.
        carry: See there.
        velocity: See there.
        friction: See there.
        owner: See there.
        node: See there.

    Returns:
        The new count; -1 if there is no room for more.
    """
    place = np.empty((3, 3))
    contact = np.empty(3)
    world_frame = np.empty((3, 3))
    for f in range(face_frames.shape[0]):
        deepest = 0.0
        for i in range(face.shape[0]):
            if states[0, i] and face[i] == f:
                deepest = max(deepest, record[i, 3])
        if deepest <= 0.0:
            continue
        deepest += face_slack[f]
        first_of_face = count
        frame, height = face_frames[f], face_heights[f]
        for row in range(3):
            world_frame[row, 0], world_frame[row, 1], world_frame[row, 2] = turn(rotation, frame[row])
        for i in range(local.shape[1]):
            x = vertices[first_vertex + i, 0] - position[0]
            y = vertices[first_vertex + i, 1] - position[1]
            z = vertices[first_vertex + i, 2] - position[2]
            u = world_frame[0, 0] * x + world_frame[0, 1] * y + world_frame[0, 2] * z
            v = world_frame[1, 0] * x + world_frame[1, 1] * y + world_frame[1, 2] * z
            w = world_frame[2, 0] * x + world_frame[2, 1] * y + world_frame[2, 2] * z
            local[0, i], local[1, i], local[2, i] = u, v, w
            codes[i] = (
                (u < face_bounds[f, 0])
                | ((u > face_bounds[f, 1]) << 1)
                | ((v < face_bounds[f, 2]) << 2)
                | ((v > face_bounds[f, 3]) << 3)
                | ((w > height + CONTACT_MARGIN) << 4)
                | ((w < height - deepest) << 5)
            )
        for t in range(triangles.shape[0]):
            i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if codes[i] & codes[j] & codes[k]:
                continue
            area = (local[0, j] - local[0, i]) * (local[1, k] - local[1, i]) - (local[1, j] - local[1, i]) * (
                local[0, k] - local[0, i]
            )
            if area >= 0.0:
                # This side of the organ faces away from the face.
                continue
            if selective:
                ux, uy, uz = local[0, j] - local[0, i], local[1, j] - local[1, i], local[2, j] - local[2, i]
                vx, vy, vz = local[0, k] - local[0, i], local[1, k] - local[1, i], local[2, k] - local[2, i]
                px, py = uy * vz - uz * vy, uz * vx - ux * vz
                scale = 1.0 / np.sqrt(px * px + py * py + area * area)
                for axis in range(3):
                    contact[axis] = scale * (frame[0, axis] * px + frame[1, axis] * py + frame[2, axis] * area)
                if not opposes_best(contact, frame[2], face_frames[:, 2]):
                    continue
            for corner in range(first_corner[f], first_corner[f + 1]):
                facing, wa, wb, wc = line_meets_triangle(
                    face_corners[corner, 0], face_corners[corner, 1],
                    local[0, i], local[1, i], local[0, j], local[1, j], local[0, k], local[1, k],
                )  # fmt: skip
                depth = height - (wa * local[2, i] + wb * local[2, j] + wc * local[2, k])
                if facing >= 0 or depth < -CONTACT_MARGIN or depth > deepest:
                    continue
                if count == friction.shape[0]:
                    return -1
                corners[count, 0], corners[count, 1], corners[count, 2] = (
                    i + first_vertex,
                    j + first_vertex,
                    k + first_vertex,
                )
                weights[count, 0], weights[count, 1], weights[count, 2] = wa, wb, wc
                for axis in range(3):
                    contact[axis] = (
                        frame[0, axis] * face_corners[corner, 0]
                        + frame[1, axis] * face_corners[corner, 1]
                        + frame[2, axis] * height
                    )
                _fill_plane(
                    count, contact, frame[2], position, rotation, start_position, start_rotation,
                    linear_velocity, angular_velocity, normal, point, carry, velocity,
                )  # fmt: skip
                friction[count], owner[count], node[count] = coefficient, tool, -1
                count += 1
            for corner in range(3):
                for axis in range(3):
                    place[corner, axis] = (
                        frame[0, axis] * local[0, triangles[t, corner]]
                        + frame[1, axis] * local[1, triangles[t, corner]]
                        + frame[2, axis] * local[2, triangles[t, corner]]
                    )
            for corner in range(3):
                a, b = triangles[t, corner], triangles[t, (corner + 1) % 3]
                start, end = place[corner], place[(corner + 1) % 3]
                first, last = _clip_to_face(start, end, frame[2], plane_normals, plane_offsets)
                for side in range(2):
                    fraction = first if side == 0 else last
                    # The end of this edge is the start of the next.
                    if first > last or (fraction == 1.0 and side == 1):
                        continue
                    for axis in range(3):
                        contact[axis] = start[axis] + fraction * (end[axis] - start[axis])
                    above = dot(frame[2], contact) - height
                    if above > CONTACT_MARGIN or above < -deepest:
                        continue
                    # An edge belongs to two triangles, a vertex to several.
                    known = False
                    for c in range(first_of_face, count):
                        if fraction == 0.0:
                            known = known or (corners[c, 0] == a + first_vertex and weights[c, 0] == 1.0)
                        else:
                            known = known or (
                                corners[c, 0] == b + first_vertex
                                and corners[c, 1] == a + first_vertex
                                and abs(weights[c, 0] - fraction) < 1e-9
                            )
                    if known:
                        continue
                    if count == friction.shape[0]:
                        return -1
                    corners[count, 0] = a + first_vertex
                    corners[count, 1], corners[count, 2] = b + first_vertex, b + first_vertex
                    weights[count, 0], weights[count, 1], weights[count, 2] = 1.0 - fraction, fraction, 0.0
                    for axis in range(3):
                        contact[axis] -= above * frame[2, axis]
                    _fill_plane(
                        count, contact, frame[2], position, rotation, start_position, start_rotation,
                        linear_velocity, angular_velocity, normal, point, carry, velocity,
                    )  # fmt: skip
                    friction[count], owner[count], node[count] = coefficient, tool, -1
                    count += 1
    return count


@kernel(
    "i8(i8, f8[:,::1], f8[::1], f8, f8, i4[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1],"
    " i4[::1], i4[::1])"
)
def add_ground_constraints(
    count: int,
    vertices: np.ndarray,
    inverse_mass: np.ndarray,
    height: float,
    coefficient: float,
    corners: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    point: np.ndarray,
    carry: np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    owner: np.ndarray,
    node: np.ndarray,
) -> int:
    """Append one constraint for each vertex that is below the ground or touches it.

    Args:
        count: Constraints already there.
        vertices: (V, 3) [u].
        inverse_mass: (V,) [1/kg].
        height: Of the ground [u].
        coefficient: Of friction.
        corners: Arrays of `Constraints`, as the next eight.
        weights: See there.
        normal: See there.
        point: See there.
        carry: See there.
        velocity: See there.
        friction: See there.
        owner: See there.
        node: See there.

    Returns:
        The new count; -1 if there is no room for more.
    """
    for i in range(vertices.shape[0]):
        if vertices[i, 2] > height + CONTACT_MARGIN or inverse_mass[i] == 0.0:
            continue
        if count == friction.shape[0]:
            return -1
        for axis in range(3):
            corners[count, axis] = i
            weights[count, axis] = 1.0 if axis == 0 else 0.0
            normal[count, axis] = 1.0 if axis == 2 else 0.0
            point[count, axis] = height if axis == 2 else vertices[i, axis]
            carry[count, axis] = 0.0
            velocity[count, axis] = 0.0
        friction[count], owner[count], node[count] = coefficient, GROUND, -1
        count += 1
    return count


@kernel(
    "void(i8, i4[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i4[::1], i4[::1], f8[:,::1], i4, f8[::1], f8[::1],"
    " f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1])"
)
def sum_tool_impulses(
    count: int,
    corners: np.ndarray,
    weights: np.ndarray,
    normal: np.ndarray,
    impulse: np.ndarray,
    owner: np.ndarray,
    node: np.ndarray,
    vertices: np.ndarray,
    tool: int,
    position: np.ndarray,
    rotation: np.ndarray,
    nodes: np.ndarray,
    normals: np.ndarray,
    nodal_impulses: np.ndarray,
    total: np.ndarray,
    moment: np.ndarray,
    node_impulses: np.ndarray,
) -> None:
    """Add up what one tool gave the organs.

    Args:
        count: How many constraints; the next six arrays are those of `Constraints`.
        corners: See there.
        weights: See there.
        normal: See there.
        impulse: See there.
        owner: See there.
        node: See there.
        vertices: (V, 3) [u].
        tool: Its index.
        position: (3,) of the tool [u].
        rotation: (9,) of the tool.
        nodes: (n, 3) of the tool, tool frame [u].
        normals: (n, 3) of the tool, tool frame.
        nodal_impulses: (V, 3) added to, on the organs' vertices [kg u/s].
        total: (3,) added to [kg u/s].
        moment: (3,) added to, about the tool's origin [kg u2/s].
        node_impulses: (n, 3) added to, by contact node; what acts between nodes goes to the nearest of the face.
    """
    contact = np.empty(3)
    for c in range(count):
        if owner[c] != tool:
            continue
        contact[:] = 0.0
        for corner in range(3):
            for axis in range(3):
                contact[axis] += weights[c, corner] * vertices[corners[c, corner], axis]
                nodal_impulses[corners[c, corner], axis] += weights[c, corner] * impulse[c, axis]
        for axis in range(3):
            total[axis] += impulse[c, axis]
            contact[axis] -= position[axis]
        moment[0] += contact[1] * impulse[c, 2] - contact[2] * impulse[c, 1]
        moment[1] += contact[2] * impulse[c, 0] - contact[0] * impulse[c, 2]
        moment[2] += contact[0] * impulse[c, 1] - contact[1] * impulse[c, 0]
        nearest = node[c]
        if nearest < 0:
            least = np.inf
            for i in range(nodes.shape[0]):
                nx, ny, nz = turn(rotation, normals[i])
                x, y, z = turn(rotation, nodes[i])
                distance = (x - contact[0]) ** 2 + (y - contact[1]) ** 2 + (z - contact[2]) ** 2
                if nx * normal[c, 0] + ny * normal[c, 1] + nz * normal[c, 2] > 0.999 and distance < least:
                    nearest, least = i, distance
        for axis in range(3):
            node_impulses[nearest, axis] += impulse[c, axis]
