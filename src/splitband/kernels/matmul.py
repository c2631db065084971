"""Compile the matrix product of the kernels, for the many small products of a rollout.

BLAS spends most of a small product on packing operands and waking threads. Here a block of the
result stays in registers while the inner index runs, by LLVM instructions: a loop over an array
would go through memory.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils as _cgutils
from numba.extending import intrinsic

from splitband.kernels.common import Array, part

cgutils: Any = _cgutils  # its helpers have no types
_VECTOR_BYTES = 64
"""Bytes of the widest vectors, those of AVX-512."""
_WIDE = ((4, (4, 1)), (2, (8, 4, 1)), (1, (8, 4, 1)))
"""Vectors by rows of a block of sums in 16 of the 32 registers of AVX-512. Smaller blocks cover the
remainder."""
_NARROW = ((1, (6, 4, 1)),)
"""The same in 12 of 16 registers half as wide."""
_HAS_32_REGISTERS = bool(binding.get_host_cpu_features().get("avx512f"))
_BLOCKS = _WIDE if _HAS_32_REGISTERS else _NARROW
_SUMS = (4, 1) if _HAS_32_REGISTERS else (2, 1)
"""Rows of a and of b in a block of `add_products`."""


@part
def matmul(out: Array, a: Array, w: Array, accumulate: bool) -> None:
    """Write or add a @ w to `out`; rows of both are contiguous, a multiple of `PAD` long."""
    _matmul(out, a, w, accumulate)


@part
def add_products(out: Array, a: Array, b: Array) -> None:
    """Add to `out[i, j]` the sum of `a[t, i, l] * b[t, j, l]` over all t and l.

    The last axes are contiguous, a multiple of `PAD` long.
    """
    _add_products(out, a, b)


def _emitted_by(kind: type[_Product], *types_of_args: Any) -> tuple[Any, Any]:
    """Return the signature of a product for Numba, and the generator of its code.

    The code is a function for every layout of the arrays: inlined into all calls, kernels take
    twice as long to compile, and no less time to run.
    """
    of_item, item_bytes = types_of_args[1].dtype, types_of_args[1].dtype.bitwidth // 8

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        views = [
            _View.of(builder, context.make_array(of_arg)(context, builder, value))
            for of_arg, value in zip(signature.args[:3], args[:3], strict=True)
        ]
        values = [x for view in views for x in (view.data, *view.shape, *view.strides)]
        values += args[3:]
        kinds = ir.FunctionType(ir.VoidType(), [value.type for value in values])
        module = builder.module
        product = ir.Function(module, kinds, module.get_unique_name(kind.__name__))
        product.linkage = "internal"
        product.attributes.add("noinline")
        arguments = iter(product.args)
        out, a, w = (
            _View(
                next(arguments),
                [next(arguments) for _ in v.shape],
                [next(arguments) for _ in v.strides],
            )
            for v in views
        )
        inner = ir.IRBuilder(product.append_basic_block())
        kind(inner, out, a, w, context.get_value_type(of_item), item_bytes, *arguments).emit()
        inner.ret_void()
        builder.call(product, values)
        return context.get_dummy_value()

    return types.void(*types_of_args), codegen


class _View(NamedTuple):
    """An array's pointer, shape and strides, as LLVM values."""

    data: Any
    shape: list[Any]
    strides: list[Any]

    @classmethod
    def of(cls, builder: Any, array: Any) -> _View:
        """Return the view of one of Numba's arrays."""
        shape, strides = (cgutils.unpack_tuple(builder, x) for x in (array.shape, array.strides))
        return cls(array.data, shape, strides)


def _product(typingctx: Any, out: Any, a: Any, w: Any, accumulate: Any) -> tuple[Any, Any]:
    return _emitted_by(_Product, out, a, w, accumulate)


def _sum_of_products(typingctx: Any, out: Any, a: Any, b: Any) -> tuple[Any, Any]:
    return _emitted_by(_SumOfProducts, out, a, b)


_matmul: Any = intrinsic(_product)
_add_products: Any = intrinsic(_sum_of_products)


@dataclass(frozen=True)
class _Product:
    """A product to emit; rows, columns and sizes are LLVM integers unless typed `int`."""

    builder: Any
    out: _View
    a: _View
    w: _View
    item: Any
    item_bytes: int
    accumulate: Any = None

    @property
    def vector(self) -> Any:
        return ir.VectorType(self.item, _VECTOR_BYTES // self.item_bytes)

    def emit(self) -> None:
        rows, columns = self.out.shape
        j = zero = columns.type(0)
        for width, heights in _BLOCKS:
            n_strips, j_end = self.divide(j, columns, width * self.vector.count)
            with cgutils.for_range(self.builder, n_strips) as strip:
                column = self.step(j, strip.index, width * self.vector.count)
                i = zero
                for height in heights:
                    n_blocks, i_end = self.divide(i, rows, height)
                    with cgutils.for_range(self.builder, n_blocks) as block:
                        self.block(self.step(i, block.index, height), column, height, width)
                    i = i_end
            j = j_end

    def block(self, row: Any, column: Any, height: int, width: int) -> None:
        count = self.vector.count
        down = [self.step(row, row.type(r), 1) for r in range(height)]
        across = [self.step(column, column.type(v), count) for v in range(width)]
        sums = self.registers((r, c) for r in down for c in across)
        inner = self.w.shape[0]
        with cgutils.for_range(self.builder, inner) as k:
            ws = {c: self.load(self.w, (k.index, c), self.vector) for c in across}
            for r in down:
                x = self.spread(self.load(self.a, (r, k.index), self.item))
                for c in across:
                    self.add(sums[r, c], self.builder.fmul(x, ws[c], flags=("contract",)))
        # The old values are added last: rounding is less than with products added to them.
        with self.builder.if_then(self.accumulate):
            for (r, c), register in sums.items():
                self.add(register, self.load(self.out, (r, c), self.vector))
        for (r, c), register in sums.items():
            target = self.pointer(self.out, (r, c), self.vector)
            self.builder.store(self.builder.load(register), target, align=self.item_bytes)

    def registers(self, places: Iterable[tuple[Any, Any]]) -> dict[tuple[Any, Any], Any]:
        """Return vectors of zeros by place in the result."""
        vectors = {place: cgutils.alloca_once(self.builder, self.vector) for place in places}
        for register in vectors.values():
            self.builder.store(ir.Constant(self.vector, None), register)
        return vectors

    def divide(self, start: Any, stop: Any, length: int) -> tuple[Any, Any]:
        """Return the number of whole lengths between start and stop, and their end."""
        count = self.builder.sdiv(self.builder.sub(stop, start), start.type(length))
        return count, self.step(start, count, length)

    def step(self, start: Any, count: Any, length: int) -> Any:
        return self.builder.add(start, self.builder.mul(count, start.type(length)))

    def pointer(self, array: Any, index: tuple[Any, ...], kind: Any) -> Any:
        offset = array.strides[0].type(0)
        for i, stride in zip(index, array.strides, strict=True):
            offset = self.builder.add(offset, self.builder.mul(i, stride))
        return cgutils.pointer_add(self.builder, array.data, offset, kind.as_pointer())

    def load(self, array: Any, index: tuple[Any, ...], kind: Any) -> Any:
        return self.builder.load(self.pointer(array, index, kind), align=self.item_bytes)

    def spread(self, x: Any) -> Any:
        lanes = ir.VectorType(ir.IntType(32), self.vector.count)
        undefined = ir.Constant(self.vector, ir.Undefined)
        first = self.builder.insert_element(undefined, x, ir.Constant(lanes.element, 0))
        return self.builder.shuffle_vector(first, undefined, ir.Constant(lanes, None))

    def add(self, register: Any, x: Any) -> None:
        total = self.builder.fadd(self.builder.load(register), x, flags=("contract",))
        self.builder.store(total, register)


class _SumOfProducts(_Product):
    """Products of rows to emit, summed over lanes and over the first axis; `w` is b."""

    def emit(self) -> None:
        rows, columns = self.out.shape
        i = zero = rows.type(0)
        for height in _SUMS:
            n_rows, i_end = self.divide(i, rows, height)
            with cgutils.for_range(self.builder, n_rows) as down:
                row = self.step(i, down.index, height)
                j = zero
                for width in _SUMS:
                    n_columns, j_end = self.divide(j, columns, width)
                    with cgutils.for_range(self.builder, n_columns) as across:
                        self.block(row, self.step(j, across.index, width), height, width)
                    j = j_end
            i = i_end

    def block(self, row: Any, column: Any, height: int, width: int) -> None:
        down = [self.step(row, row.type(r), 1) for r in range(height)]
        across = [self.step(column, column.type(c), 1) for c in range(width)]
        sums = self.registers((r, c) for r in down for c in across)
        times, _, lanes = self.a.shape
        vectors, _ = self.divide(lanes.type(0), lanes, self.vector.count)
        with (
            cgutils.for_range(self.builder, times) as t,
            cgutils.for_range(self.builder, vectors) as v,
        ):
            lane = self.step(lanes.type(0), v.index, self.vector.count)
            bs = {c: self.load(self.w, (t.index, c, lane), self.vector) for c in across}
            for r in down:
                x = self.load(self.a, (t.index, r, lane), self.vector)
                for c in across:
                    self.add(sums[r, c], self.builder.fmul(x, bs[c], flags=("contract",)))
        for (r, c), register in sums.items():
            target = self.pointer(self.out, (r, c), self.item)
            total = self.total(self.builder.load(register))
            self.builder.store(self.builder.fadd(total, self.builder.load(target)), target)

    def total(self, vector: Any) -> Any:
        """Return the sum of a vector, by halves."""
        count = self.vector.count
        while count > 1:
            count //= 2
            lanes = ir.VectorType(ir.IntType(32), count)
            halves = [
                self.builder.shuffle_vector(
                    vector, vector, ir.Constant(lanes, [*range(first, first + count)])
                )
                for first in (0, count)
            ]
            vector = self.builder.fadd(*halves)
        return self.builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))
