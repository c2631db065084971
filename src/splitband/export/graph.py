"""Record what a NumPy function computes as a graph, from which code is generated.

A function of arrays of fixed shapes is called once with symbols in place of the arrays, which
record the operations on them. Loops and branches that depend on values are written with `scan` and
`cond` (`runtime.tracing`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from splitband.runtime.tracing import Body, Traced, Tree, leaves, rebuilt

Array = npt.NDArray[Any]


def table(text: str) -> dict[str, str]:
    """Return a table of names, written as `name=other`, or as `name` where both are equal."""
    return {name: other or name for name, _, other in (w.partition("=") for w in text.split())}


ELEMENTWISE = table("""
    add subtract=sub multiply=mul divide=div negative=neg absolute=abs fabs=abs floor fmod
    maximum=max fmax=max minimum=min fmin=min exp expm1 log log1p sqrt expit=sigmoid
    sin cos tan arcsin=asin arccos=acos arctan=atan arctan2=atan2
    sinh cosh tanh arcsinh=asinh arccosh=acosh arctanh=atanh
    isnan less=lt greater=gt less_equal=le greater_equal=ge equal=eq
    logical_and=and bitwise_and=and logical_or=or bitwise_or=or logical_not=not invert=not
""")
"""NumPy's elementwise functions, and their names in graphs."""
FLAGS = {"isnan", "lt", "gt", "le", "ge", "eq", "and", "or", "not"}
"""The elementwise operations with Boolean results."""
_OF_FLAGS = {"add": "or", "mul": "and", "max": "or", "min": "and"}
"""What NumPy computes of flags alone."""


@dataclass(eq=False)
class Node:
    """Hold an operation of a graph."""

    op: str  # of `ELEMENTWISE`, `_FUNCTIONS`, "pow", "matmul", "view", "reshape", "scan", "cond"
    inputs: tuple[Symbol, ...]  # its operands
    options: dict[str, Any] = field(default_factory=dict)  # its settings
    blocks: tuple[Block, ...] = ()  # the body of a loop, or both branches of a condition
    outputs: tuple[Symbol, ...] = ()  # its results


@dataclass(eq=False)
class Block:
    """Hold a sequence of operations with its inputs and outputs."""

    inputs: list[Symbol] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    outputs: list[Symbol] = field(default_factory=list)


class Trace:
    """Record the operations on symbols."""

    def __init__(self) -> None:
        self.blocks = [Block()]

    def input(self, like: Any) -> Symbol:
        """Return a new input of the innermost block, of the shape of `like`."""
        symbol = Symbol(self, _shape(like), isinstance(like, Symbol) and like.flag)
        self.blocks[-1].inputs.append(symbol)
        return symbol

    def symbol(self, value: Any) -> Symbol:
        """Return a symbol for a value, which may be one already, or an array of symbols."""
        if isinstance(value, Symbol):
            return value
        known = np.asarray(value)
        if known.dtype == np.object_:  # of numbers and symbols, as a user's equation makes it
            return _stack(self, [*known.ravel()]).reshape(*known.shape)
        return Symbol(self, known.shape, known.dtype == np.bool_, value=known)

    def number(self, value: Any) -> Symbol:
        """Return a symbol for numbers; flags are 0 and 1."""
        symbol = self.symbol(value)
        if not symbol.flag:
            return symbol
        if symbol.value is not None:
            return self.symbol(symbol.value.astype(np.float64))
        return self.add("where", [symbol, 1.0, 0.0], symbol.shape)

    def flags(self, value: Any) -> Symbol:
        """Return a symbol for flags; of numbers, whether they differ from 0."""
        symbol = self.symbol(value)
        if symbol.flag:
            return symbol
        if symbol.value is not None:
            return self.symbol(symbol.value != 0)
        zero = self.add("eq", [symbol, 0.0], symbol.shape, True)
        return self.add("not", [zero], symbol.shape, True)

    def add(
        self,
        op: str,
        inputs: Sequence[Any],
        shape: tuple[int, ...],
        flag: bool = False,
        **options: Any,
    ) -> Symbol:
        """Record an operation with one output."""
        return self.control(op, inputs, (), [(shape, flag)], **options)[0]

    def inner(self, body: Callable[[], Tree]) -> tuple[Block, Tree]:
        """Record a block within the innermost one; return it, and the tree of its outputs."""
        block = Block()
        self.blocks.append(block)
        tree = body()
        self.blocks.pop()
        block.outputs = [self.symbol(leaf) for leaf in leaves(tree)]
        return block, tree

    def control(
        self,
        op: str,
        inputs: Sequence[Any],
        blocks: tuple[Block, ...],
        like: Sequence[tuple[tuple[int, ...], bool]],
        **options: Any,
    ) -> list[Symbol]:
        """Record an operation, a loop or a branch, with outputs of the shapes and flags `like`."""
        node = Node(op, tuple(self.symbol(x) for x in inputs), options, blocks)
        node.outputs = tuple(Symbol(self, shape, flag, node=node) for shape, flag in like)
        self.blocks[-1].nodes.append(node)
        return list(node.outputs)


class Symbol(np.lib.mixins.NDArrayOperatorsMixin, Traced):
    """Stand for an array whose values are not known.

    shape : Shape of the array.
    flag : Whether its elements are Boolean.
    node : The operation that computes it; None for an input or a constant.
    value : Value of a constant; None for any other symbol.
    """

    __hash__ = object.__hash__

    def __init__(
        self,
        trace: Trace,
        shape: tuple[int, ...],
        flag: bool = False,
        node: Node | None = None,
        value: Array | None = None,
    ) -> None:
        self.trace, self.shape, self.flag, self.node, self.value = trace, shape, flag, node, value

    @property
    def ndim(self) -> int:
        """Return the number of axes."""
        return len(self.shape)

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, *_: Any, **__: Any) -> Array:
        if self.shape:
            raise TypeError("a value that is not known yet cannot become an array of numbers")
        found = np.empty((), dtype=object)  # an element of np.array([...])
        found[()] = self
        return found

    def __bool__(self) -> bool:
        raise TypeError(
            "a value that is not known yet cannot decide an if, max, min, and or or: write "
            "np.where, np.maximum, np.minimum, np.logical_and, np.logical_or"
        )

    def __float__(self) -> float:
        raise TypeError(
            "a value that is not known yet is no number for the functions of math, or for an array "
            "of numbers: write np.sin for math.sin, and a list or np.zeros_like(x) for np.zeros(n)"
        )

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Symbol:
        if method != "__call__" or kwargs:
            raise TypeError(f"np.{ufunc.__name__} into an array, or its {method}, cannot be traced")
        if ufunc is np.matmul:
            return _matmul(self.trace, *inputs)
        if composed := _COMPOSED.get(ufunc.__name__):
            return composed(*inputs)
        op = ELEMENTWISE.get(ufunc.__name__)
        if op is None:
            raise TypeError(f"np.{ufunc.__name__} cannot be traced")
        shape = np.broadcast_shapes(*(_shape(x) for x in inputs))
        symbols = [self.trace.symbol(x) for x in inputs]
        if all(x.flag for x in symbols):
            op = _OF_FLAGS.get(op, op)
        kind = self.trace.flags if op in ("and", "or", "not") else self.trace.number
        return self.trace.add(op, [kind(x) for x in symbols], shape, op in FLAGS)

    def __array_function__(
        self, func: Callable[..., Any], _: Any, args: Any, kwargs: Any
    ) -> Symbol:
        traced = _FUNCTIONS.get(func)
        if traced is None:
            raise TypeError(f"np.{func.__name__} cannot be traced")
        return traced(self.trace, *args, **kwargs)

    def __getitem__(self, key: Any) -> Symbol:
        keys = list(key) if isinstance(key, tuple) else [key]
        given = sum(k is not None and k is not Ellipsis for k in keys)
        rest = [slice(None)] * (self.ndim - given)
        at = next((i for i, k in enumerate(keys) if k is Ellipsis), len(keys))
        keys = [*keys[:at], *rest, *keys[at + 1 :]]
        if any(isinstance(k, Symbol) for k in keys):
            raise TypeError("a mask cannot be traced: write np.where")
        several = [i for i, k in enumerate(keys) if isinstance(k, list | np.ndarray) and np.ndim(k)]
        if several:  # such as x[:, [0, 2]]
            return self._chosen(keys, several)
        shape: list[int] = []
        axes: list[tuple[int, int, int | None]] = []
        for k in keys:
            if k is None:
                shape.append(1)
                continue
            size = self.shape[len(axes)]
            if isinstance(k, slice):
                start, stop, step = k.indices(size)
                axes.append((start, step, len(shape)))
                shape.append(len(range(start, stop, step)))
            else:
                axes.append((range(size)[k], 0, None))
        return self.trace.add("view", [self], tuple(shape), self.flag, axes=tuple(axes))

    def _chosen(self, keys: list[Any], several: list[int]) -> Symbol:
        """Return the elements of a key that has a list of whole numbers at the place `several`."""
        at = several[0]
        if len(several) > 1 or np.asarray(keys[at]).dtype == np.bool_:
            raise TypeError("a mask, or two lists, cannot be traced as an index: write np.where")
        rows = [self[(*keys[:at], int(k), *keys[at + 1 :])] for k in keys[at]]
        return _stack(self.trace, rows, sum(k is None or isinstance(k, slice) for k in keys[:at]))

    def __getattr__(self, name: str) -> NoReturn:
        """Raise AttributeError, which says what to write for a method that arrays have."""
        known = name in {function.__name__ for function in _FUNCTIONS}
        instead = f"np.{name}(x)" if known else "sums, products and NumPy's elementwise functions"
        if name == "copy":
            instead = "x itself, which nothing changes, or np.zeros_like(x) and each element of it"
        raise AttributeError(f"a value that is not known yet has no .{name}: write {instead}")

    def __setitem__(self, key: Any, value: Any) -> NoReturn:
        raise TypeError(
            "a value that is not known yet cannot be changed: write a list of its elements, or set "
            "those of np.zeros_like(x)"
        )

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))

    def sum(self, axis: int | None = None) -> Symbol:
        """Return the sum over an axis, or over all axes."""
        return _reduced(self.trace, "sum", self, axis)

    def any(self) -> Symbol:
        """Return whether any element is true."""
        return np.where(self, 1.0, 0.0).sum() > 0

    def all(self) -> Symbol:
        """Return whether all elements are true."""
        return np.logical_not(np.logical_not(self).any())

    def reshape(self, *shape: int) -> Symbol:
        """Return the same elements in another shape."""
        size = int(np.prod(self.shape))
        others = int(np.prod([n for n in shape if n >= 0]))
        wanted = tuple(size // others if n < 0 else n for n in shape)
        return self.trace.add("reshape", [self], wanted, self.flag)

    @property
    def T(self) -> Symbol:  # noqa: N802  NumPy's name
        """Return the transpose: the axes are reversed."""
        axes = tuple((0, 1, self.ndim - 1 - i) for i in range(self.ndim))
        return self.trace.add("view", [self], self.shape[::-1], self.flag, axes=axes)

    def branch(self, yes: Callable[[], Tree], no: Callable[[], Tree]) -> Tree:
        """Record that `yes()` or `no()` is computed, as this flag says; see `cond`."""
        (one, tree), (other, _) = map(self.trace.inner, (yes, no))
        like = [(s.shape, s.flag) for s in one.outputs]
        if like != [(s.shape, s.flag) for s in other.outputs]:
            raise TypeError("both branches must have the same shapes")
        return rebuilt(tree, self.trace.control("cond", [self], (one, other), like))

    def loop(self, body: Body, carry: Tree, xs: Sequence[Any]) -> tuple[Tree, Tree]:
        """Record a loop over the rows of arrays; see `scan`."""
        trace = self.trace
        starts = [trace.symbol(leaf) for leaf in leaves(carry)]
        rows = [trace.symbol(x) for x in xs]

        def inner() -> Tree:
            begun = rebuilt(carry, [trace.input(s) for s in starts])
            return body(begun, [trace.input(Symbol(trace, x.shape[1:])) for x in rows])

        block, (after, outs) = trace.inner(inner)
        length, like = len(rows[0]), [(s.shape, s.flag) for s in block.outputs]
        if [shape for shape, _ in like[: len(starts)]] != [s.shape for s in starts]:
            raise TypeError("a loop must keep the shapes of what it carries")
        like[len(starts) :] = [((length, *shape), flag) for shape, flag in like[len(starts) :]]
        options = {"length": length, "carried": len(starts)}
        found = trace.control("scan", [*starts, *rows], (block,), like, **options)
        return rebuilt(after, found[: len(starts)]), rebuilt(outs, found[len(starts) :])


def _shape(x: Any) -> tuple[int, ...]:
    return x.shape if isinstance(x, Symbol) else np.shape(x)


def _power(x: Any, y: Any) -> Any:
    """Return a power; whole ones up to 4 are products, as a compiler writes them."""
    trace = x.trace if isinstance(x, Symbol) else y.trace
    x = trace.number(x)
    exponent = None if isinstance(y, Symbol) or np.ndim(y) else float(y)
    if exponent in (1.0, 2.0, 3.0, 4.0):
        found = x
        for _ in range(int(exponent) - 1):
            found = found * x
        return found
    if exponent == 0.5:
        return np.sqrt(x)
    return trace.add("pow", [x, trace.number(y)], np.broadcast_shapes(_shape(x), _shape(y)))


def _remainder(x: Any, y: Any) -> Any:
    """Return the remainder with the sign of `y`, rounded as NumPy's is."""
    left = np.fmod(x, y)
    return np.where(left * y < 0, left + y, left)


_COMPOSED: dict[str, Callable[..., Any]] = {
    "positive": lambda x: x,
    "square": lambda x: _power(x, 2.0),
    "reciprocal": lambda x: 1.0 / x,
    "sign": lambda x: np.where(x > 0, 1.0, np.where(x < 0, -1.0, 0.0)),
    "hypot": lambda x, y: np.sqrt(x * x + y * y),
    "exp2": lambda x: np.exp(np.log(2.0) * x),
    "log2": lambda x: np.log(x) / np.log(2.0),
    "log10": lambda x: np.log(x) / np.log(10.0),
    "ceil": lambda x: -np.floor(-x),
    "floor_divide": lambda x, y: np.floor((x - np.remainder(x, y)) / y + 0.5),
    "remainder": _remainder,
    "deg2rad": lambda x: x * (np.pi / 180),
    "radians": lambda x: x * (np.pi / 180),
    "rad2deg": lambda x: x * (180 / np.pi),
    "degrees": lambda x: x * (180 / np.pi),
    "heaviside": lambda x, at_zero: np.where(x > 0, 1.0, np.where(x < 0, 0.0, at_zero)),
    "not_equal": lambda x, y: np.logical_not(np.equal(x, y)),
    "power": _power,
    "float_power": _power,
}
"""NumPy's elementwise functions that are written by others."""


def _matmul(trace: Trace, a: Any, b: Any) -> Symbol:
    """Record the product of matrices, or of a matrix and a vector."""
    left, right = _shape(a), _shape(b)
    if len(left) > 2 or len(right) > 2:
        raise TypeError("products of batches of matrices cannot be traced")
    return trace.add("matmul", [trace.number(a), trace.number(b)], (*left[:-1], *right[1:]))


def _reduced(trace: Trace, op: str, x: Any, axis: int | None = None) -> Symbol:
    symbol = trace.number(x)
    if axis is None:
        symbol, axis = symbol.reshape(-1) if symbol.ndim != 1 else symbol, 0
    axis %= symbol.ndim
    shape = symbol.shape[:axis] + symbol.shape[axis + 1 :]
    return trace.add(op, [symbol], shape, axis=axis)


def _where(trace: Trace, flag: Any, yes: Any, no: Any) -> Symbol:
    shape = np.broadcast_shapes(*(_shape(x) for x in (flag, yes, no)))
    branches = _of_one_kind(trace, [yes, no])
    return trace.add("where", [trace.flags(flag), *branches], shape, branches[0].flag)


def _of_one_kind(trace: Trace, arrays: Sequence[Any]) -> list[Symbol]:
    """Return symbols for arrays: numbers, unless all are flags."""
    symbols = [trace.symbol(x) for x in arrays]
    return symbols if all(x.flag for x in symbols) else [trace.number(x) for x in symbols]


def _concatenate(trace: Trace, arrays: Sequence[Any], axis: int = 0) -> Symbol:
    parts = _of_one_kind(trace, arrays)
    full = [x for x in parts if x.shape[axis]] or parts[:1]
    if len(full) == 1:
        return full[0]
    axis %= full[0].ndim
    shape = list(full[0].shape)
    shape[axis] = sum(x.shape[axis] for x in full)
    return trace.add("concat", full, tuple(shape), full[0].flag, axis=axis)


def _stack(trace: Trace, arrays: Sequence[Any], axis: int = 0) -> Symbol:
    symbols = [trace.symbol(x) for x in arrays]
    axis %= symbols[0].ndim + 1
    key = (*[slice(None)] * axis, None, Ellipsis)
    return _concatenate(trace, [x[key] for x in symbols], axis)


def _broadcast_to(trace: Trace, x: Any, shape: tuple[int, ...]) -> Symbol:
    symbol = trace.symbol(x)
    new = len(shape) - symbol.ndim
    sizes = enumerate(symbol.shape, new)
    axes = tuple((0, 0, None) if size == 1 else (0, 1, i) for i, size in sizes)
    return trace.add("view", [symbol], tuple(shape), symbol.flag, axes=axes)


def _clip(_: Trace, x: Any, a_min: Any = None, a_max: Any = None) -> Symbol:
    x = x if a_min is None else np.maximum(x, a_min)
    return x if a_max is None else np.minimum(x, a_max)


def _interp(trace: Trace, x: Any, xp: Any, fp: Any) -> Symbol:
    """Record a table as the sum of its ramps; it is held beyond its ends, as NumPy does."""
    at, values = np.asarray(xp, dtype=np.float64), np.asarray(fp, dtype=np.float64)
    width, rise = np.diff(at), np.diff(values)
    jump = width == 0  # two values at one place, of which the second one holds there
    beyond = trace.symbol(x)[..., None] - at[:-1]
    ramps = np.clip(beyond, 0.0, width) * (rise / np.where(jump, 1.0, width))
    if jump.any():
        ramps = np.where(jump & (beyond >= 0), rise, ramps)
    found: Symbol = values[0] + ramps.sum(axis=-1)
    return found


def _mean(trace: Trace, x: Any, axis: int | None = None) -> Any:
    count = np.prod(_shape(x)) if axis is None else _shape(x)[axis]
    return _reduced(trace, "sum", x, axis) / float(count)


def _filled(value: float) -> Callable[..., Any]:
    """Return the function that makes an array of numbers and symbols, which may be written to."""
    return lambda trace, x, **_: np.full(_shape(x), value, dtype=object)


_FUNCTIONS: dict[Callable[..., Any], Callable[..., Symbol]] = {
    np.where: _where,
    np.concatenate: _concatenate,
    np.stack: _stack,
    np.broadcast_to: _broadcast_to,
    np.sum: lambda trace, x, axis=None: _reduced(trace, "sum", x, axis),
    np.max: lambda trace, x, axis=None: _reduced(trace, "largest", x, axis),
    np.min: lambda trace, x, axis=None: _reduced(trace, "smallest", x, axis),
    np.hstack: lambda trace, arrays: _concatenate(trace, arrays, min(len(_shape(arrays[0])), 1)),
    np.vstack: lambda trace, arrays: _concatenate(
        trace, [x if len(_shape(x)) > 1 else trace.symbol(x)[None] for x in arrays]
    ),
    np.column_stack: lambda trace, arrays: _stack(trace, arrays, 1),  # of columns (time,)
    np.clip: _clip,
    np.interp: _interp,
    np.dot: _matmul,
    np.mean: _mean,
    np.diff: lambda trace, x: x[..., 1:] - x[..., :-1],
    np.any: lambda trace, x: trace.symbol(x).any(),
    np.all: lambda trace, x: trace.symbol(x).all(),
    np.zeros_like: _filled(0.0),
    np.empty_like: _filled(0.0),
    np.ones_like: _filled(1.0),
}


def trace(function: Callable[..., Tree], *examples: Tree) -> tuple[Block, Tree]:
    """Record what a function computes; return the block and the tree of its outputs.

    `examples` are arguments of the right structure and shapes; the block's inputs are their leaves.
    """
    new = Trace()
    arguments = [rebuilt(tree, [new.input(leaf) for leaf in leaves(tree)]) for tree in examples]
    result = function(*arguments)
    block = new.blocks[0]
    block.outputs = [new.symbol(leaf) for leaf in leaves(result)]
    return block, result
