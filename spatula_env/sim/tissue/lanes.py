"""Arithmetic on vector registers, for kernels that are written as instructions.

The compiler cannot know that a loop over worlds may be turned into vector instructions if it reads and writes the same
nodes through several elements. So the bodies of such loops are written as vector instructions: a `Row` is the value of
one quantity in all worlds of a block, one in each lane of a vector register, and `+`, `-`, `*` and `/` of rows are one
instruction each. Each is rounded as IEEE 754 prescribes, so that a world's outcome does not depend on the number of
lanes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import ir
from numba.core import cgutils

WORD = ir.IntType(64)


class Row:
    """One value in each lane."""

    def __init__(self, build: Build, value: Any) -> None:
        """Wrap an LLVM value of the type `build.kind`."""
        self.build, self.value = build, value

    def __add__(self, other: Row) -> Row:
        return Row(self.build, self.build.builder.fadd(self.value, other.value))

    def __sub__(self, other: Row) -> Row:
        return Row(self.build, self.build.builder.fsub(self.value, other.value))

    def __mul__(self, other: Row) -> Row:
        return Row(self.build, self.build.builder.fmul(self.value, other.value))

    def __truediv__(self, other: Row) -> Row:
        return Row(self.build, self.build.builder.fdiv(self.value, other.value))

    def __neg__(self) -> Row:
        return Row(self.build, self.build.builder.fneg(self.value))

    def plus(self, a: Row, b: Row) -> Row:
        """This row plus a b, rounded once."""
        return self.build.fma(a, b, self)

    def root(self) -> Row:
        """The square root."""
        build = self.build
        name = f"llvm.sqrt.{build.suffix}"
        function = build.builder.module.declare_intrinsic(name, (), ir.FunctionType(build.kind, [build.kind]))
        return Row(build, build.builder.call(function, [self.value]))

    def is_less(self, other: Row) -> Any:
        """In which lanes this row is less than the other; false where one of them is NaN."""
        return self.build.builder.fcmp_ordered("<", self.value, other.value)

    def least(self, other: Row) -> Row:
        """The lesser of the two; the other one where one of them is NaN."""
        return self._choose("<", other)

    def most(self, other: Row) -> Row:
        """The greater of the two; the other one where one of them is NaN."""
        return self._choose(">", other)

    def _choose(self, relation: str, other: Row) -> Row:
        builder = self.build.builder
        chosen = builder.fcmp_ordered(relation, self.value, other.value)
        return Row(self.build, builder.select(chosen, self.value, other.value))


class Build:
    """Emits instructions on rows of lanes into the body of a Numba intrinsic."""

    def __init__(self, context: Any, builder: Any, array: Any, lanes: int) -> None:
        """Prepare for arrays of an element type.

        Args:
            context: Numba's target context.
            builder: LLVM's builder of instructions.
            array: Numba type of an array of that element type.
            lanes: Number of lanes; with one, rows are scalars.
        """
        self.context, self.builder, self.lanes = context, builder, lanes
        self.element = context.get_data_type(array.dtype)
        self.kind = self.element if lanes == 1 else ir.VectorType(self.element, lanes)
        # Alignment that loads and stores assume: arrays begin at a cache line, but nothing breaks if one does not.
        self._align = context.get_abi_sizeof(self.element)

    def data(self, kind: Any, array: Any) -> Any:
        """Pointer to the first element of an array."""
        return self.context.make_array(kind)(self.context, self.builder, array).data

    def index(self, base: Any, place: Any, offset: int, count: int) -> Any:
        """An entry of an int32 array of `count` columns, as a 64-bit integer."""
        builder = self.builder
        pointer = builder.gep(base, [self._place(place, count, offset)])
        return builder.sext(builder.load(pointer), WORD)

    def number(self, base: Any, place: Any, offset: int, count: int) -> Row:
        """An entry of an array of `count` columns, the same in all lanes."""
        pointer = self.builder.gep(base, [self._place(place, count, offset)])
        return self.spread(self.builder.load(pointer))

    def constant(self, value: float) -> Row:
        """A number, in all lanes."""
        return self.spread(ir.Constant(self.element, value))

    def address(self, base: Any, place: Any, offset: int, count: int) -> Any:
        """Pointer to row `offset` of the `count` rows at a place."""
        pointer = self.builder.gep(base, [self._place(place, count * self.lanes, offset * self.lanes)])
        return self.builder.bitcast(pointer, self.kind.as_pointer())

    def load(self, pointer: Any) -> Row:
        """The row at an address."""
        return Row(self, self.builder.load(pointer, align=self._align))

    def store(self, row: Row, pointer: Any) -> None:
        """Write a row to an address."""
        self.builder.store(row.value, pointer, align=self._align)

    def whole(self, value: int) -> Any:
        """An integer constant, for an index."""
        return ir.Constant(WORD, value)

    def sums(self, count: int) -> list[Sum]:
        """A list of `count` sums that are zero."""
        return [Sum(self) for _ in range(count)]

    @contextmanager
    def each(self, start: Any, end: Any) -> Iterator[Any]:
        """Emit a loop over indices whose body is the ``with`` block, and yield the index."""
        with cgutils.for_range_slice(self.builder, start, end, ir.Constant(WORD, 1)) as (index, _):
            yield index

    def fma(self, a: Row, b: Row, c: Row) -> Row:
        """The value of a b + c, rounded once."""
        name = f"llvm.fma.{self.suffix}"
        function = self.builder.module.declare_intrinsic(name, (), ir.FunctionType(self.kind, [self.kind] * 3))
        return Row(self, self.builder.call(function, [a.value, b.value, c.value]))

    def choose(self, chosen: Any, a: Row, b: Row) -> Row:
        """A row with the values of `a` where `chosen` is true, and those of `b` elsewhere."""
        return Row(self, self.builder.select(chosen, a.value, b.value))

    @property
    def suffix(self) -> str:
        """Suffix of the names of LLVM's intrinsics that work on rows."""
        return f"{'' if self.lanes == 1 else f'v{self.lanes}'}{self.element.intrinsic_name}"

    def _place(self, place: Any, count: int, offset: int) -> Any:
        fixed = ir.Constant(WORD, offset)
        if place is None:
            return fixed
        return self.builder.add(self.builder.mul(place, ir.Constant(WORD, count)), fixed)

    def spread(self, value: Any) -> Row:
        """A number, in all lanes."""
        if self.lanes == 1:
            return Row(self, value)
        nothing, first = ir.Constant(self.kind, ir.Undefined), ir.Constant(ir.IntType(32), 0)
        single = self.builder.insert_element(nothing, value, first)
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), [0] * self.lanes)
        return Row(self, self.builder.shuffle_vector(single, nothing, mask))


class Sum:
    """A row that accumulates in a loop; it stays in a register."""

    def __init__(self, build: Build) -> None:
        """Begin with zero."""
        self._build = build
        self._place: Any = cgutils.alloca_once(build.builder, build.kind)  # type: ignore[no-untyped-call]
        build.store(build.constant(0.0), self._place)

    @property
    def row(self) -> Row:
        """The present value of the sum."""
        return self._build.load(self._place)

    def add(self, a: Row, b: Row) -> None:
        """Add a b, rounded once."""
        self._build.store(self.row.plus(a, b), self._place)


def dot(a: list[Row], b: list[Row]) -> Row:
    """The scalar product of two lists of rows."""
    total = a[0] * b[0]
    for p, q in zip(a[1:], b[1:], strict=True):
        total = total.plus(p, q)
    return total


def cross(a: list[Row], b: list[Row]) -> list[Row]:
    """The vector product of two vectors."""
    return [(-(a[(k + 2) % 3] * b[(k + 1) % 3])).plus(a[(k + 1) % 3], b[(k + 2) % 3]) for k in range(3)]
