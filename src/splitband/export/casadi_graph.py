"""Write the free run of a forecaster as a CasADi function, for predictive control.

Every array of the graph is a column of its elements in NumPy's order (row by row); CasADi's own
order is column by column. What does not depend on state and inputs is a `casadi.DM`, of which
CasADi computes with numbers at once.
"""

from __future__ import annotations

import operator
import tempfile
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.export.graph import Block, Node, Symbol, table, trace
from splitband.export.program import begun, prune, size, used_for
from splitband.forecasters.base import Forecaster
from splitband.forecasters.steps import State
from splitband.forecasters.stream import Stream
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError, missing
from splitband.runtime.tracing import leaves, named_leaves

try:
    import casadi
except ImportError:
    raise missing("CasADi's format", "casadi", "casadi") from None

Column = Any
"""A `casadi.DM`, `SX` or `MX` with one column."""

MOST_IN_SX = 5_000
"""Most multiplications by weights for which every number has a symbol of its own (SX), which is
faster for small models; above, matrices stay whole (MX). By eye."""

_OF_PYTHON = table("add sub mul div=truediv neg lt gt le ge eq")
_OF_CASADI = table("""
    and=logic_and or=logic_or not=logic_not where=if_else max=fmax min=fmin abs=fabs floor fmod
    pow=power exp expm1 log log1p sqrt sin cos tan asin acos atan atan2
    sinh cosh tanh asinh acosh atanh
""")
_OPERATIONS: dict[str, Callable[..., Column]] = {
    **{op: vars(operator)[name] for op, name in _OF_PYTHON.items()},
    **{op: vars(casadi)[name] for op, name in _OF_CASADI.items()},
    # By tanh, as the derivative of 1 / (1 + exp(-x)) is inf / inf for large -x.
    "sigmoid": lambda x: 0.5 + 0.5 * casadi.tanh(0.5 * x),
    "isnan": lambda x: casadi.DM.zeros(x.numel(), 1),  # what is computed is a number
}
_REDUCTIONS = {"sum": operator.add, "largest": casadi.fmax, "smallest": casadi.fmin}


class CasadiStep:
    """Predict the next sample, as a function of CasADi.

    `step(state, u)` returns the next state and the prediction, as numbers or as expressions; a
    model that is given a simulator's output takes that as a third argument. All are columns, in
    measured units.

    Attributes
    ----------
    function : The `casadi.Function`, with the names `state`, `u`, `y_sim`, `state_next` and `y`.
    stream : Takes measured samples, `stream.observe(y, u)`, after which `state` is another one.
    """

    def __init__(
        self, forecaster: Forecaster, history: Record | None = None, other_record: bool = False
    ) -> None:
        steps = forecaster.step_form()
        state = begun(steps, forecaster, history, other_record)
        if state is None:
            raise InputError(
                f"history must bring the simulator's output (y_sim) for {forecaster.name}, or the "
                "simulator must be passed to sb.load"
            )
        record = forecaster.require_fitted().record
        self.forecaster = forecaster
        self.stream = Stream(forecaster.name, steps, state, record.ny, record.nu)
        self.function, self._kept = _function(self.stream)

    def __call__(self, *given: Any) -> Any:
        """Return the next state and the prediction."""
        return self.function(*given)

    def state(self, history: Record | None = None, other_record: bool = False) -> Array:
        """Return the state from which a plan starts, as a vector.

        By default it is that after the samples that `stream` has observed.

        Parameters
        ----------
        history, other_record : Measured samples up to now, see `Forecaster.predict`.

        Raises
        ------
        ValueError
            Where too few samples have been measured, and for a history that does not fit.
        """
        stream = self.stream
        if history is not None:
            stream = self.forecaster.stream(history, other_record)
        return _vector(_ready(stream), self._kept)

    def __repr__(self) -> str:
        return f"CasadiStep({self.forecaster.name!r}, {self.function})"


def files(step: CasadiStep) -> tuple[bytes, bytes]:
    """Return the saved functions: of a step, and of the state after the history."""
    state = casadi.DM(step.state())
    start = casadi.Function("start", [], [casadi.SX(state)], [], ["state"])
    return _saved(step.function), _saved(start)


def _saved(function: casadi.Function) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "function"
        function.save(str(path))
        return path.read_bytes()


def _ready(stream: Stream) -> State:
    """Return the state of a stream, warmed up; raises ValueError where that cannot predict yet."""
    u = np.zeros(stream.nu) if stream.nu else None
    simulated = np.zeros((1 + stream.steps.ahead, stream.ny)) if stream.steps.simulated else None
    stream.copy().step(u, simulated)
    state = stream.steps.warmed_up(stream.state)
    if any(np.isnan(leaf).any() for leaf in leaves(state)):
        raise InputError(
            f"history must bring the simulator's output of the sample after its end for "
            f"{stream.name}, whose slope needs it: a record whose y_sim is longer"
        )
    return state


def _vector(state: State, kept: Sequence[int]) -> Array:
    """Return the arrays at these places of a state one after the other."""
    arrays = leaves(state)
    parts = [np.asarray(arrays[i], dtype=np.float64).ravel() for i in kept]
    return np.concatenate([np.zeros(0), *parts])


def _function(stream: Stream) -> tuple[casadi.Function, list[int]]:
    """Return the step of a free run, and the places of the arrays of its state that it needs.

    What only measured samples need, such as a covariance, is no part of it.
    """
    steps, state = stream.steps, _ready(stream)
    simulated = np.zeros((1 + steps.ahead, stream.ny if steps.simulated else 0))
    try:
        block, (after, _) = trace(steps.run, state, np.zeros(stream.nu), simulated)
    except TypeError as error:
        raise InputError(f"the model cannot be a CasADi function: {error}") from error
    names = [name for name, _ in named_leaves(state)]
    assert names == [name for name, _ in named_leaves(after)], "a run must keep its state's order"
    *given_state, u, y_sim = block.inputs
    *new, y = block.outputs
    kept: list[int] = []
    while True:
        used = used_for(block.nodes, [y, *(new[i] for i in kept)])
        found = [i for i, symbol in enumerate(given_state) if symbol in used and size(symbol)]
        if found == kept:
            break
        kept = found
    block.outputs = [*(new[i] for i in kept), y]
    prune(block)
    kind = casadi.SX if _multiplications(block) <= MOST_IN_SX else casadi.MX
    given, values = {}, {}
    parts = {"state": [given_state[i] for i in kept], "u": [u], "y_sim": [y_sim]}
    for name, symbols in parts.items():
        ends = np.cumsum([0, *map(size, symbols)]).tolist()
        column = kind.sym(name, ends[-1])
        for symbol, begin, end in zip(symbols, ends, ends[1:], strict=False):
            values[symbol] = column[begin:end]
        if name == "state" or ends[-1]:
            given[name] = column
    writer = _Writer(values)
    writer.block(block)
    *later, predicted = (writer.column(symbol) for symbol in block.outputs)
    outputs = [casadi.densify(casadi.vertcat(kind(0, 1), *x)) for x in (later, [predicted])]
    step = casadi.Function("step", [*given.values()], outputs, [*given], ["state_next", "y"])
    return step, kept


def _multiplications(block: Block) -> int:
    """Return the number of multiplications by weights, those of loops included."""
    products = (node for node in block.nodes if node.op == "matmul")
    own = sum(x.value.size for node in products for x in node.inputs if x.value is not None)
    inner = (
        node.options.get("length", 1) * _multiplications(each)
        for node in block.nodes
        for each in node.blocks
    )
    return own + sum(inner)


class _Writer:
    """Compute the operations of a block by CasADi; `values` holds a column for each input."""

    def __init__(self, values: dict[Symbol, Column]) -> None:
        self.values = values

    def block(self, block: Block) -> None:
        """Compute all operations of a block."""
        for node in block.nodes:
            if node.op == "scan":
                self._scan(node)
            elif node.op == "cond":
                self._cond(node)
            else:
                self.values[node.outputs[0]] = self._simple(node)

    def column(self, symbol: Symbol, shape: tuple[int, ...] | None = None) -> Column:
        """Return the elements of a symbol, by default not broadcast."""
        shape = symbol.shape if shape is None else shape
        if not int(np.prod(shape)):
            return casadi.DM(0, 1)
        if symbol.value is not None:
            known = np.broadcast_to(symbol.value, shape).astype(np.float64)
            return casadi.DM(known.ravel())
        value = self.values[symbol]
        if shape == symbol.shape:
            return value
        return _picked(value, np.broadcast_to(_places(symbol.shape), shape))

    def _simple(self, node: Node) -> Column:  # noqa: PLR0911  a line for each kind
        out = node.outputs[0]
        if not size(out):
            return casadi.DM(0, 1)
        if node.op == "view":
            return _picked(self.column(node.inputs[0]), _viewed(node))
        if node.op == "reshape":
            return self.column(node.inputs[0])
        if node.op == "concat":
            return self._joined(node)
        if node.op == "matmul":
            return self._product(node)
        if node.op in _REDUCTIONS:
            return self._reduced(node)
        return _OPERATIONS[node.op](*(self.column(x, out.shape) for x in node.inputs))

    def _joined(self, node: Node) -> Column:
        parts = [x for x in node.inputs if size(x)]
        ends = np.cumsum([0, *map(size, parts)]).tolist()
        places = [begin + _places(x.shape) for begin, x in zip(ends, parts, strict=False)]
        together = np.concatenate(places, axis=node.options["axis"])
        return _picked(casadi.vertcat(*map(self.column, parts)), together)

    def _product(self, node: Node) -> Column:
        left, right = node.inputs
        a = self._matrix(left, (1, *left.shape)[-2:])
        b = self._matrix(right, (*right.shape, 1)[:2])
        return casadi.vec(casadi.mtimes(a, b).T)

    def _matrix(self, symbol: Symbol, shape: tuple[int, ...]) -> Any:
        rows, columns = shape
        return casadi.reshape(self.column(symbol), columns, rows).T

    def _reduced(self, node: Node) -> Column:
        source, axis = node.inputs[0], node.options["axis"]
        column, places = self.column(source), _places(source.shape)
        terms = [_picked(column, np.take(places, i, axis=axis)) for i in range(source.shape[axis])]
        return reduce(_REDUCTIONS[node.op], terms)

    def _cond(self, node: Node) -> None:
        """Compute both branches, or the one that is chosen before anything is known."""
        flag = self.column(node.inputs[0])
        known = isinstance(flag, casadi.DM)
        blocks = [node.blocks[0 if float(flag) else 1]] if known else node.blocks
        found: list[Sequence[Column]] = []
        for block in blocks:
            self.block(block)
            found.append([self.column(symbol) for symbol in block.outputs])
        for out, *values in zip(node.outputs, *found, strict=True):
            both = len(values) > 1 and size(out)
            self.values[out] = casadi.if_else(flag, *values) if both else values[0]

    def _scan(self, node: Node) -> None:
        """Write a loop out."""
        block, carried = node.blocks[0], node.options["carried"]
        now = [self.column(x) for x in node.inputs[:carried]]
        series: list[list[Column]] = [[] for _ in block.outputs[carried:]]
        for n in range(node.options["length"]):
            rows = [_picked(self.column(x), _places(x.shape)[n]) for x in node.inputs[carried:]]
            self.values.update(zip(block.inputs, [*now, *rows], strict=True))
            self.block(block)
            found = [self.column(symbol) for symbol in block.outputs]
            now = found[:carried]
            for values, value in zip(series, found[carried:], strict=True):
                values.append(value)
        stacked = [casadi.vertcat(*values) for values in series]
        self.values.update(zip(node.outputs, [*now, *stacked], strict=True))


def _places(shape: tuple[int, ...]) -> npt.NDArray[np.int_]:
    """Return the place of each element in its column, in the shape of the array."""
    return np.arange(int(np.prod(shape))).reshape(shape)


def _viewed(node: Node) -> npt.NDArray[np.int_]:
    """Return the places in its operand of the elements of a view."""
    source, out = node.inputs[0], node.outputs[0]
    found = np.zeros(out.shape, dtype=np.int_)
    for i, (start, step, axis) in enumerate(node.options["axes"]):
        stride = int(np.prod(source.shape[i + 1 :]))
        if axis is None:
            found += stride * start
            continue
        along = start + step * np.arange(out.shape[axis])
        shape = [1] * len(out.shape)
        shape[axis] = -1
        found += stride * along.reshape(shape)
    return found


def _picked(column: Column, places: npt.NDArray[np.int_]) -> Column:
    """Return the elements at these places, as a column."""
    index = places.ravel().tolist()
    if index == [*range(column.numel())]:
        return column
    return casadi.reshape(column[index], len(index), 1)  # an element of one is a row for CasADi
