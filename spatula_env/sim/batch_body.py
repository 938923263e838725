"""Bullet's classic soft body for many worlds at once.

A step is Bullet's: velocities change by gravity and by the changes that are requested, positions advance with them,
sweeps over all links pull the nodes towards the links' rest lengths, and the velocities become the nodes' displacements
divided by the time step. In a sweep, link after link (Gauss–Seidel) is corrected as

    k = stiffness (r2 - l2) / (r2 + l2),   x_a -= k s_a d,   x_b += k s_b d,

with d = x_b - x_a, l2 = d . d, r2 the squared rest length and s the link's shares, see `SoftBody.shares`
(`btSoftBody::predictMotion`, `PSolve_Links` and `solveConstraints` of Bullet 3). A sweep's outcome depends on the order
of the links, so a single world offers little parallelism. Many worlds perform the same operations on different numbers:
they are put side by side into the lanes of vector registers, a block of worlds at a time, and each link is corrected in
all worlds of the block at once.

Arrays of a block have shape (V, C, lanes), so that a coordinate of a node in all the block's worlds is one vector. The
correction of a link is written as vector instructions: in a loop over the lanes the compiler cannot know that a link's
two nodes are different, and would test for that before every link. With a single world, the coordinates of a node are
adjacent instead and form one vector: C is then 4, otherwise 3.

The operations, fused multiply–adds among them, and their order are spelled out and the same for any number of lanes,
and each is rounded as IEEE 754 prescribes. The result in a world is therefore the same to the last bit, whatever other
worlds there are and however they are grouped into blocks. Processors older than about 2013 have no fused multiply–add;
there a function computes it, correctly but slowly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from spatula_env._kernels import array_kernel, inline_kernel, kernel
from spatula_env.geometry.checks import check_positive
from spatula_env.sim.lanes import NARROW, WIDE, aligned_zeros, tell_finite
from spatula_env.sim.selection import one_each, refuse, world_indices
from spatula_env.sim.soft_body import SWEEPS
from spatula_env.threads import share_out

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from spatula_env.sim.soft_body import SoftBody

    FloatArray = NDArray[np.float64]

GREATEST_STIFFNESS = 2.0
"""Successive over-relaxation converges below this factor only (Kahan's theorem)."""


def _link_kernel(lanes: int) -> Any:
    """Make the function that corrects one link in all worlds of a block with `lanes` lanes.

    It takes the block's positions (V, 3, lanes), the link's nodes, squared rest length and shares, and the worlds'
    stiffness (lanes,).
    """

    @intrinsic
    def correct(
        typing_context: Any, positions: Any, a: Any, b: Any, rest: Any, share_a: Any, share_b: Any, stiffness: Any
    ) -> Any:
        signature = types.void(positions, a, b, rest, share_a, share_b, stiffness)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vectors = _Vectors(context, builder, signature.args[0], lanes)
            base = vectors.data(signature.args[0], arguments[0])
            at = [[vectors.address(base, node, axis, 3) for axis in range(3)] for node in arguments[1:3]]
            here, there = ([vectors.load(pointer) for pointer in pointers] for pointers in at)
            apart = [builder.fsub(q, p) for p, q in zip(here, there, strict=True)]
            squared = builder.fmul(apart[0], apart[0])
            for d in apart[1:]:
                squared = vectors.fma(d, d, squared)
            wanted = vectors.spread(arguments[3])
            stretch = builder.fdiv(builder.fsub(wanted, squared), builder.fadd(wanted, squared))
            factor = vectors.load(vectors.address(vectors.data(signature.args[6], arguments[6]), None, 0, 1))
            stretch = builder.fmul(stretch, factor)
            back, forth = (builder.fmul(stretch, vectors.spread(share)) for share in arguments[4:6])
            back = builder.fneg(back)
            for axis in range(3):
                vectors.store(vectors.fma(apart[axis], back, here[axis]), at[0][axis])
                vectors.store(vectors.fma(apart[axis], forth, there[axis]), at[1][axis])
            return context.get_dummy_value()

        return signature, generate

    return correct


class _Vectors:
    """Vector instructions on arrays, for the body of an intrinsic function."""

    def __init__(self, context: Any, builder: Any, array: Any, lanes: int) -> None:
        self._context, self._builder, self._lanes = context, builder, lanes
        element = context.get_data_type(array.dtype)
        self._kind = ir.VectorType(element, lanes)
        # Alignment that loads and stores assume: arrays begin at a cache line, but nothing breaks if one does not.
        self._align = context.get_abi_sizeof(element)

    def data(self, kind: Any, array: Any) -> Any:
        """Pointer to the first element of an array."""
        return self._context.make_array(kind)(self._context, self._builder, array).data

    def address(self, base: Any, node: Any, axis: int, axes: int) -> Any:
        """The address of a row of lanes."""
        word = ir.IntType(64)
        offset: Any = ir.Constant(word, axis * self._lanes)
        if node is not None:
            row = self._builder.mul(self._builder.sext(node, word), ir.Constant(word, axes * self._lanes))
            offset = self._builder.add(row, offset)
        return self._builder.bitcast(self._builder.gep(base, [offset]), self._kind.as_pointer())

    def load(self, pointer: Any) -> Any:
        return self._builder.load(pointer, align=self._align)

    def store(self, value: Any, pointer: Any) -> None:
        self._builder.store(value, pointer, align=self._align)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """The value of a b + c with a single rounding, for vectors or scalars."""
        kind = a.type
        lanes = f"v{kind.count}" if isinstance(kind, ir.VectorType) else ""
        name = f"llvm.fma.{lanes}{self._kind.element.intrinsic_name}"
        function = self._builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, [kind] * 3))
        return self._builder.call(function, [a, b, c])

    def spread(self, value: Any) -> Any:
        """A vector whose elements all equal a scalar."""
        nothing, first = ir.Constant(self._kind, ir.Undefined), ir.Constant(ir.IntType(32), 0)
        single = self._builder.insert_element(nothing, value, first)
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self._lanes), [0] * self._lanes)
        return self._builder.shuffle_vector(single, nothing, mask)


def _single_link_kernel() -> Any:
    """Make the function that corrects one link in a single world: positions (V, 4, 1), and stiffness a number."""

    @intrinsic
    def correct(
        typing_context: Any, positions: Any, a: Any, b: Any, rest: Any, share_a: Any, share_b: Any, stiffness: Any
    ) -> Any:
        signature = types.void(positions, a, b, rest, share_a, share_b, stiffness)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vectors = _Vectors(context, builder, signature.args[0], 4)
            base = vectors.data(signature.args[0], arguments[0])
            at_a, at_b = (vectors.address(base, node, 0, 1) for node in arguments[1:3])
            here, there = vectors.load(at_a), vectors.load(at_b)
            apart = builder.fsub(there, here)
            x, y, z = (builder.extract_element(apart, ir.Constant(ir.IntType(32), axis)) for axis in range(3))
            squared = vectors.fma(z, z, vectors.fma(y, y, builder.fmul(x, x)))
            stretch = builder.fdiv(builder.fsub(arguments[3], squared), builder.fadd(arguments[3], squared))
            stretch = builder.fmul(stretch, arguments[6])
            back, forth = (vectors.spread(builder.fmul(stretch, share)) for share in arguments[4:6])
            vectors.store(vectors.fma(apart, builder.fneg(back), here), at_a)
            vectors.store(vectors.fma(apart, forth, there), at_b)
            return context.get_dummy_value()

        return signature, generate

    return correct


_correct_wide = _link_kernel(WIDE)
_correct_narrow = _link_kernel(NARROW)
_correct_single = _single_link_kernel()


class Blocks(NamedTuple):
    """The arrays of a body in all worlds: B blocks of `lanes` worlds each, in the body's precision.

    Attributes:
        positions: (B, V, C, lanes) [u].
        velocities: (B, V, C, lanes) [u/s].
        predicted: (B, V, C, lanes) workspace.
        movable: (V,) which nodes are not held fixed.
        links: (L, 2) nodes.
        factors: (L, 3) squared rest length [u2] and shares.
        gravity: (B, lanes) downward acceleration [u/s2].
        stiffness: (B, lanes) factor on the stiffness of links.
        dt: Length of a step [s].
        inverse_dt: One over `dt` [1/s].
        finite: (B, lanes) zero where all velocities are finite after a step, NaN otherwise.
    """

    positions: NDArray[Any]
    velocities: NDArray[Any]
    predicted: NDArray[Any]
    movable: NDArray[np.bool_]
    links: NDArray[np.int32]
    factors: NDArray[Any]
    gravity: NDArray[Any]
    stiffness: NDArray[Any]
    dt: Any
    inverse_dt: Any
    finite: NDArray[Any]


@array_kernel
def predict_block(
    positions: np.ndarray,
    velocities: np.ndarray,
    predicted: np.ndarray,
    movable: np.ndarray,
    gravity: np.ndarray,
    dt: float,
) -> None:
    """Advance a block's nodes by one step without the links; see `advance_block`."""
    nodes, axes, lanes = positions.shape
    for i in range(nodes):
        if movable[i]:
            for k in range(lanes):
                velocities[i, 2, k] -= gravity[k] * dt
        else:
            for axis in range(3):
                for k in range(lanes):
                    velocities[i, axis, k] = 0.0
    size = nodes * axes * lanes
    x, v, p = positions.reshape(size), velocities.reshape(size), predicted.reshape(size)
    for k in range(size):
        x[k] += v[k] * dt
        p[k] = x[k]


@array_kernel
def sweep_block(
    positions: np.ndarray, links: np.ndarray, factors: np.ndarray, stiffness: np.ndarray, sweeps: int
) -> None:
    """Pull a block's nodes towards the links' rest lengths; see `advance_block`."""
    lanes = positions.shape[2]
    for _ in range(sweeps):
        if lanes == WIDE:
            for i in range(links.shape[0]):
                _correct_wide(
                    positions, links[i, 0], links[i, 1], factors[i, 0], factors[i, 1], factors[i, 2], stiffness
                )
        elif lanes == NARROW:
            for i in range(links.shape[0]):
                _correct_narrow(
                    positions, links[i, 0], links[i, 1], factors[i, 0], factors[i, 1], factors[i, 2], stiffness
                )
        else:
            for i in range(links.shape[0]):
                _correct_single(
                    positions, links[i, 0], links[i, 1], factors[i, 0], factors[i, 1], factors[i, 2], stiffness[0]
                )


@array_kernel
def finish_block(positions: np.ndarray, velocities: np.ndarray, predicted: np.ndarray, inverse_dt: float) -> None:
    """Add to a block's velocities the displacements by links, divided by the time step.

    Bullet divides the whole displacement of a node by the time step, which is the same but for rounding. The velocity
    gained by gravity in a step moves a node by only a few hundred units in the last place of single precision: a
    velocity computed from the rounded displacement falls short of it by the same part in a thousand in every step.
    """
    nodes, axes, lanes = positions.shape
    size = nodes * axes * lanes
    x, v, p = positions.reshape(size), velocities.reshape(size), predicted.reshape(size)
    for k in range(size):
        v[k] += (x[k] - p[k]) * inverse_dt


@inline_kernel
def advance_block(blocks: Blocks, b: int) -> None:
    """Advance all worlds of a block by one step.

    Args:
        blocks: The arrays of all blocks; written.
        b: Index of the block.
    """
    positions, velocities, predicted = blocks.positions[b], blocks.velocities[b], blocks.predicted[b]
    predict_block(positions, velocities, predicted, blocks.movable, blocks.gravity[b], blocks.dt)
    sweep_block(positions, blocks.links, blocks.factors, blocks.stiffness[b], SWEEPS)
    finish_block(positions, velocities, predicted, blocks.inverse_dt)
    tell_finite(velocities, blocks.finite[b])


@array_kernel
def read_world(block: np.ndarray, lane: int, values: np.ndarray) -> None:
    """Copy one world's values (V, 3) out of a block's (V, C, lanes)."""
    for i in range(values.shape[0]):
        for axis in range(3):
            values[i, axis] = block[i, axis, lane]


@array_kernel
def write_world(block: np.ndarray, lane: int, values: np.ndarray) -> None:
    """Copy one world's values (V, 3) into a block's (V, C, lanes)."""
    for i in range(values.shape[0]):
        for axis in range(3):
            block[i, axis, lane] = values[i, axis]


@array_kernel
def read_block(block: np.ndarray, values: np.ndarray) -> None:
    """Copy the values (n, V, 3) of a block's first n worlds out of it (V, C, lanes)."""
    for i in range(values.shape[1]):
        for axis in range(3):
            for lane in range(values.shape[0]):
                values[lane, i, axis] = block[i, axis, lane]


@array_kernel
def write_block(block: np.ndarray, values: np.ndarray) -> None:
    """Copy the values (n, V, 3) of a block's first n worlds into it (V, C, lanes)."""
    for i in range(values.shape[1]):
        for axis in range(3):
            for lane in range(values.shape[0]):
                block[i, axis, lane] = values[lane, i, axis]


def _copy_signature(real: Any, *, readonly: bool) -> Any:
    worlds, values = types.Array(types.int64, 1, "C"), types.Array(types.float64, 3, "C", readonly=readonly)
    return types.void(types.Array(real, 4, "C"), worlds, values)


def _add_signature(real: Any) -> Any:
    flags, values = types.Array(types.boolean, 1, "C"), types.Array(types.float64, 3, "C", readonly=True)
    return types.void(types.Array(real, 4, "C"), flags, values)


_REALS = (types.float32, types.float64)
_READ_SIGNATURES = [_copy_signature(real, readonly=False) for real in _REALS]
_ADD_SIGNATURES = [_add_signature(real) for real in _REALS]
_WRITE_SIGNATURES = [_copy_signature(real, readonly=True) for real in _REALS]


# Compiled when first called, because a process rarely needs both precisions.
@kernel(nogil=True)
def _advance_blocks(first_block: int, end_block: int, blocks: Blocks) -> None:
    """Advance some blocks by one step."""
    for b in range(first_block, end_block):
        advance_block(blocks, b)


@kernel(*_READ_SIGNATURES)
def _read_worlds(blocks: np.ndarray, worlds: np.ndarray, values: np.ndarray) -> None:
    """Copy the values (n, V, 3) of some worlds (n,) out of the blocks (B, V, C, lanes)."""
    lanes = blocks.shape[3]
    for i in range(worlds.shape[0]):
        read_world(blocks[worlds[i] // lanes], worlds[i] % lanes, values[i])


@kernel(*_WRITE_SIGNATURES)
def _write_worlds(blocks: np.ndarray, worlds: np.ndarray, values: np.ndarray) -> None:
    """Copy the values (n, V, 3) of some worlds (n,) into the blocks (B, V, C, lanes)."""
    lanes = blocks.shape[3]
    for i in range(worlds.shape[0]):
        write_world(blocks[worlds[i] // lanes], worlds[i] % lanes, values[i])


@kernel(*_ADD_SIGNATURES)
def _add_to_worlds(blocks: np.ndarray, movable: np.ndarray, values: np.ndarray) -> None:
    """Add values (W, V, 3) to those of all worlds in the blocks (B, V, C, lanes), where nodes can move."""
    lanes = blocks.shape[3]
    for w in range(values.shape[0]):
        block, lane = blocks[w // lanes], w % lanes
        for i in range(values.shape[1]):
            if movable[i]:
                for axis in range(3):
                    block[i, axis, lane] += values[w, i, axis]


class BatchBody:
    """One soft body in many worlds, which differ in state, gravity, stiffness and mass.

    World w is lane w % lanes of block w // lanes. The last block is padded with unused worlds that nothing moves.

    Attributes:
        body: The nodes and links.
        worlds: Number of worlds W.
        dt: Length of a step [s], rounded to single precision as Bullet rounds it for soft bodies.
        blocks: The arrays that kernels work on.
    """

    def __init__(
        self,
        body: SoftBody,
        worlds: int = 1,
        *,
        dt: float = 1.0 / 240.0,
        gravity: ArrayLike = 10.0,
        dtype: DTypeLike = np.float32,
        parallel: bool = False,
        lanes: int | None = None,
    ) -> None:
        """Put the body into every world, at rest in its initial shape.

        Args:
            body: The nodes and links.
            worlds: Number of worlds W.
            dt: Length of a step [s].
            gravity: Downward acceleration, for all worlds or (W,) for each [u/s2].
            dtype: float32, or float64 to follow Bullet more closely.
            parallel: Whether blocks are distributed over threads; `numba.set_num_threads` says how many.
            lanes: Worlds in a block: 1, 8 or 16; by default as suits their number. Only the speed depends on it.

        Raises:
            ValueError: If an argument is not allowed.
        """
        check_positive(dt, "dt")
        if not isinstance(worlds, int | np.integer) or worlds < 1:
            raise ValueError(f"worlds must be an integer, 1 or more, got {worlds!r}")
        self._real = np.dtype(dtype)
        if self._real not in (np.dtype(np.float32), np.dtype(np.float64)):
            raise ValueError(f"dtype must be float32 or float64, got {self._real}")
        if lanes is None:
            lanes = 1 if worlds == 1 else NARROW if worlds <= NARROW else WIDE
        if lanes not in (1, NARROW, WIDE):
            raise ValueError(f"lanes must be 1, {NARROW} or {WIDE}, got {lanes!r}")
        self.body, self.worlds, self._parallel = body, worlds, parallel
        self.dt = float(np.float32(dt))
        blocks = -(-worlds // lanes)
        shape = (blocks, len(body.vertices), 4 if lanes == 1 else 3, lanes)
        linked = (body.inverse_masses[body.links] > 0.0).any(axis=1)
        factors = np.column_stack([body.squared_rest_lengths, body.shares()])[linked]
        self.blocks = Blocks(
            positions=aligned_zeros(shape, self._real),
            velocities=aligned_zeros(shape, self._real),
            predicted=aligned_zeros(shape, self._real),
            movable=body.inverse_masses > 0.0,
            links=np.ascontiguousarray(body.links[linked]),
            factors=np.ascontiguousarray(factors.astype(self._real)),
            gravity=aligned_zeros((blocks, lanes), self._real),
            stiffness=aligned_zeros((blocks, lanes), self._real),
            dt=np.array(self.dt, dtype=self._real)[()],
            inverse_dt=np.array(1.0 / self.dt, dtype=self._real)[()],
            finite=aligned_zeros((blocks, lanes), self._real),
        )
        self._mass_scale: FloatArray = np.ones(worlds)
        every = np.arange(blocks * lanes)
        _write_worlds(self.blocks.positions, every, np.repeat(body.vertices[None], len(every), axis=0))
        self.set_parameters(gravity=gravity, stiffness=1.0)

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        mass_scale: ArrayLike | None = None,
        worlds: ArrayLike | None = None,
    ) -> None:
        """Change parameters of some worlds.

        Args:
            gravity: Downward acceleration [u/s2].
            stiffness: Factor on the stiffness of all links, from 0 to less than 2. Beyond 1 links along edges
                over-relax.
            mass_scale: Factor on all masses. The motion of a free body does not depend on it; forces on the body, and
                contact, which derives them from `inverse_masses`, do.
            worlds: (n,) which, or (W,) a mask; all by default. A parameter is one number for all of them, or (n,).

        Raises:
            ValueError: If a value is not allowed; nothing has then changed.
        """
        indices = world_indices(worlds, self.worlds)
        checked: dict[str, FloatArray] = {}
        for name, value in (("gravity", gravity), ("stiffness", stiffness), ("mass_scale", mass_scale)):
            if value is not None:
                checked[name] = one_each(value, name, indices)
        if "stiffness" in checked:
            bad = (checked["stiffness"] < 0.0) | (checked["stiffness"] >= GREATEST_STIFFNESS)
            refuse(bad, indices, "stiffness", f"zero to less than {GREATEST_STIFFNESS:g}", checked["stiffness"])
        if "mass_scale" in checked:
            refuse(checked["mass_scale"] <= 0.0, indices, "mass_scale", "more than zero", checked["mass_scale"])
        for name, values in checked.items():
            target = self._mass_scale if name == "mass_scale" else getattr(self.blocks, name).reshape(-1)
            target[indices] = values

    def step(self, velocity_changes: ArrayLike | None = None, displacements: ArrayLike | None = None) -> None:
        """Advance all worlds by one step of `dt`. A world that diverges leaves the others alone; see `finite`.

        Nodes that are held fixed do not move, whatever the arguments say.

        Args:
            velocity_changes: (W, V, 3) added to the nodes' velocities before the step [u/s].
            displacements: (W, V, 3) added to their positions, leaving velocities as they are [u].

        Raises:
            ValueError: If an argument has another shape.
        """
        for name, value, target in (
            ("velocity_changes", velocity_changes, self.blocks.velocities),
            ("displacements", displacements, self.blocks.positions),
        ):
            if value is not None:
                array = np.ascontiguousarray(value, dtype=np.float64)
                if array.shape != (self.worlds, len(self.body.vertices), 3):
                    raise ValueError(
                        f"{name} must have shape {(self.worlds, len(self.body.vertices), 3)}, got {array.shape}"
                    )
                _add_to_worlds(target, self.blocks.movable, array)
        blocks, count = self.blocks, len(self.blocks.positions)
        threads = numba.get_num_threads() if self._parallel else 1
        if min(count, threads) == 1:
            _advance_blocks(0, count, blocks)
        else:
            share_out(lambda block: _advance_blocks(block, block + 1, blocks), count, threads)

    def set_state(self, positions: ArrayLike, velocities: ArrayLike = 0.0, worlds: ArrayLike | None = None) -> None:
        """Replace the state of all nodes in some worlds; what follows does not depend on the previous state.

        Args:
            positions: (V, 3) for all of these worlds, or (n, V, 3) for each [u].
            velocities: (V, 3) or (n, V, 3), or zero [u/s].
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            ValueError: If an argument has another shape or is not finite; nothing has then changed.
        """
        indices = world_indices(worlds, self.worlds)
        shape = (len(indices), len(self.body.vertices), 3)
        arrays = []
        for name, value in (("positions", positions), ("velocities", velocities)):
            array = np.asarray(value, dtype=np.float64)
            if array.shape not in (shape, shape[1:]) and (name == "positions" or array.shape != ()):
                raise ValueError(f"{name} must have shape {shape[1:]} or {shape}, got {array.shape}")
            array = np.ascontiguousarray(np.broadcast_to(array, shape))
            refuse(np.asarray(~np.isfinite(array).all(axis=(1, 2))), indices, name, "finite")
            arrays.append(array)
        for target, array in zip((self.blocks.positions, self.blocks.velocities), arrays, strict=True):
            _write_worlds(target, indices, array)
        self.blocks.finite.reshape(-1)[indices] = 0.0

    def get_state(self, worlds: ArrayLike | None = None) -> tuple[FloatArray, FloatArray]:
        """Positions (n, V, 3) [u] and velocities (n, V, 3) [u/s] of some worlds, to be given to `set_state` later.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.

        Returns:
            Copies.
        """
        indices = world_indices(worlds, self.worlds)
        return self._get(self.blocks.positions, indices), self._get(self.blocks.velocities, indices)

    def _get(self, blocks: NDArray[Any], indices: NDArray[np.int64]) -> FloatArray:
        values: FloatArray = np.empty((len(indices), len(self.body.vertices), 3))
        _read_worlds(blocks, indices, values)
        return values

    @property
    def positions(self) -> FloatArray:
        """(W, V, 3) of all nodes (a copy) [u]."""
        return self._get(self.blocks.positions, np.arange(self.worlds))

    @property
    def velocities(self) -> FloatArray:
        """(W, V, 3) of all nodes (a copy) [u/s]."""
        return self._get(self.blocks.velocities, np.arange(self.worlds))

    @property
    def finite(self) -> NDArray[np.bool_]:
        """(W,) whether all velocities were finite after the last step."""
        finite: NDArray[np.bool_] = self.blocks.finite.reshape(-1)[: self.worlds] == 0.0
        return finite

    @property
    def inverse_masses(self) -> FloatArray:
        """(W, V) of the nodes [1/kg]; zero for a node that is held fixed."""
        inverse_masses: FloatArray = self.body.inverse_masses / self._mass_scale[:, None]
        return inverse_masses

    @property
    def gravity(self) -> FloatArray:
        """(W,) downward acceleration (a copy) [u/s2]."""
        return self._parameter(self.blocks.gravity)

    @property
    def stiffness(self) -> FloatArray:
        """(W,) factor on the stiffness of all links (a copy)."""
        return self._parameter(self.blocks.stiffness)

    @property
    def mass_scale(self) -> FloatArray:
        """(W,) factor on all masses (a copy)."""
        return self._mass_scale.copy()

    def _parameter(self, blocks: NDArray[Any]) -> FloatArray:
        """(W,) one of the worlds' parameters."""
        values: FloatArray = blocks.reshape(-1)[: self.worlds].astype(np.float64)
        return values
