"""Write the operations of a program as statements of C99."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import zip_longest
from typing import Literal

import numpy as np
import numpy.typing as npt

from splitband.export.graph import Block, Node, Symbol, table
from splitband.export.program import size, used_by

Precision = Literal["double", "float"]
Index = Sequence[str | int]
Value = Callable[[Index], str]

_INFIX = table("add=+ sub=- mul=* div=/ lt=< gt=> le=<= ge=>= eq=== and=&& or=||")
_OPERATORS = {op: f"({{}} {sign} {{}})" for op, sign in _INFIX.items()}
_OPERATORS |= {"neg": "(-{})", "not": "(!{})", "where": "({} ? {} : {})", "isnan": "isnan({})"}
_FUNCTIONS = table("""
    abs=fabs floor fmod max=fmax min=fmin pow exp expm1 log log1p sqrt sigmoid
    sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh
""")
_REDUCTIONS = {"sum": "{0} + {1}", "largest": "fmax", "smallest": "fmin"}
_REUSED = ("matmul", "scan", "cond", "view", "reshape")
"""Operations whose inputs are stored, as they may be read more than once."""


class Renderer:
    """Write the operations of a block as statements; `names` holds the names of the inputs."""

    def __init__(self, precision: Precision, names: dict[Symbol, str]) -> None:
        self.precision, self.names = precision, names
        self.constants: dict[tuple[bytes, tuple[int, ...]], tuple[str, str]] = {}
        self.inlined: set[Symbol] = set()
        self.lines: list[str] = []
        self.indent = 1
        self.count = 0
        self.functions: set[str] = set()

    def block(self, block: Block) -> None:
        """Write all nodes of a block."""
        uses = Counter(symbol for node in block.nodes for symbol in used_by(node))
        uses.update(block.outputs)
        for node in block.nodes:
            for symbol in node.inputs:
                cheap = symbol.node is not None and symbol.node.op in (_OPERATORS | _FUNCTIONS)
                if cheap and uses[symbol] == 1 and _reads_once(node, symbol):
                    self.inlined.add(symbol)
        for node in block.nodes:
            self.node(node)

    def node(self, node: Node) -> None:
        """Write one operation."""
        if node.op == "scan":
            self._scan(node)
        elif node.op == "cond":
            self._cond(node)
        elif node.op == "matmul":
            self._matmul(node)
        elif node.op in _REDUCTIONS:
            self._reduce(node)
        elif node.op == "concat":
            self._concat(node)
        elif node.op == "reshape":
            name, source = self._declared(node.outputs[0]), node.inputs[0]
            at, of = partial(_flat, source.shape), partial(self.element, source)
            self.loops(source.shape, lambda i: f"{name}[{at(i)}] = {of(i)};")
        elif node.op != "view" and (out := node.outputs[0]) not in self.inlined:
            self.names[out] = self._kept(out.shape, out.flag, lambda i: self._expression(node, i))

    def element(self, symbol: Symbol, index: Index) -> str:
        """Return an expression for an element."""
        if symbol.value is not None:
            return self._constant(symbol.value, index)
        node = symbol.node
        if symbol in self.names:
            return _element(self.names[symbol], symbol.shape, index)
        assert node is not None
        if node.op == "view":
            axes = node.options["axes"]
            inner = [
                start if out is None else _affine(start, step, index[out])
                for start, step, out in axes
            ]
            return self.element(node.inputs[0], inner)
        return self._expression(node, index)

    def stored_outputs(self, block: Block) -> list[str]:
        """Write outputs to variables; return their names, "" for an unchanged or empty one."""
        named = []
        for symbol, old in zip_longest(block.outputs, block.inputs[: len(block.outputs) - 2]):
            if not size(symbol) or symbol is old:
                named.append("")
            elif symbol in self.names and symbol.node is not None:
                named.append(self.names[symbol])
            else:
                named.append(self._copied(symbol))
        return named

    def write(self, line: str) -> None:
        """Write a line."""
        self.lines.append("    " * self.indent + line)

    def number(self, value: float) -> str:
        """Return a number as a C literal."""
        if np.isnan(value):
            return "NAN"
        if np.isinf(value):
            return "INFINITY" if value > 0 else "(-INFINITY)"
        if self.precision == "float":
            most = np.finfo(np.float32).max  # a finite number beyond it saturates
            text = repr(float(str(np.float32(np.clip(value, -most, most))))) + "f"
        else:
            text = repr(float(value))
        return f"({text})" if text.startswith("-") else text

    def copy(self, shape: tuple[int, ...], target: str, source: str) -> None:
        """Write a copy of an array or a scalar."""
        if not shape:
            self.write(f"{target} = {source};")
        else:
            self.loops((int(np.prod(shape)),), lambda i: f"{target}[{i[0]}] = {source}[{i[0]}];")

    def fill(self, length: int, target: str, value: str) -> None:
        """Write a value to all elements of an array."""
        self.loops((length,), lambda i: f"{target}[{i[0]}] = {value};")

    def function(self, name: str) -> str:
        """Return the name of a function of math.h in the chosen precision."""
        if name == "sigmoid":
            self.functions.add(name)
            return name
        return f"{name}f" if self.precision == "float" else name

    def array(self, values: npt.NDArray[np.float64], kind: str = "real") -> str:
        """Return the name of a constant array."""
        values = np.ascontiguousarray(values)
        key = values.tobytes(), values.shape
        if key not in self.constants:
            name = f"w{len(self.constants)}"
            flat = [str(int(v)) if kind == "int" else self.number(v) for v in values.ravel()]
            rows = [", ".join(flat[i : i + 6]) for i in range(0, len(flat), 6)]
            body = ",\n    ".join(rows)
            text = f"static const {kind} {name}[{len(flat)}] = {{\n    {body}\n}};"
            self.constants[key] = name, text
        return self.constants[key][0]

    def _expression(self, node: Node, index: Index) -> str:
        parts = [self.element(x, _broadcast(x.shape, index)) for x in node.inputs]
        if node.op in _OPERATORS:
            return _OPERATORS[node.op].format(*parts)
        return f"{self.function(_FUNCTIONS[node.op])}({', '.join(parts)})"

    def _constant(self, value: npt.NDArray[np.float64], index: Index) -> str:
        first = value.flat[0]
        whole = all(isinstance(i, int) for i in index)
        if whole or (value == first).all():
            chosen = value[tuple(index)] if whole else first  # type: ignore[arg-type]
            return str(int(chosen)) if value.dtype == np.bool_ else self.number(float(chosen))
        kind = "int" if value.dtype == np.bool_ else "real"
        return f"{self.array(value, kind)}[{_flat(value.shape, index)}]"

    def _new(self) -> str:
        self.count += 1
        return f"t{self.count}"

    def _declared(self, symbol: Symbol) -> str:
        """Write the declaration of a variable for a symbol; return its name."""
        name = self.names[symbol] = self._new()
        kind = "int" if symbol.flag else "real"
        self.write(f"{kind} {name}{f'[{size(symbol)}]' if symbol.shape else ''};")
        return name

    def _kept(self, shape: tuple[int, ...], flag: bool, value: Value) -> str:
        """Write values to a new variable, `const` if it is a scalar; return its name."""
        name, kind = self._new(), "int" if flag else "real"
        if not shape:
            self.write(f"const {kind} {name} = {value(())};")
        else:
            self.write(f"{kind} {name}[{int(np.prod(shape))}];")
            self._put(name, shape, value)
        return name

    def _put(self, target: str, shape: tuple[int, ...], value: Value) -> None:
        """Write a value for each index to the elements of an array, or one to a scalar."""
        self.loops(shape, lambda i: f"{_element(target, shape, i)} = {value(i)};")

    def _copied(self, symbol: Symbol) -> str:
        """Write a copy of a symbol (an input, a constant or a view); return its name."""
        return self._kept(symbol.shape, symbol.flag, lambda i: self.element(symbol, i))

    @contextmanager
    def braces(self, opening: str) -> Iterator[None]:
        """Enclose what this context writes in braces."""
        self.write(f"{opening} {{")
        self.indent += 1
        yield
        self.indent -= 1
        self.write("}")

    def loops(self, shape: tuple[int, ...], statement: Callable[[list[str | int]], str]) -> None:
        """Write loops over all elements of a shape."""
        index = [0 if length == 1 else f"i{axis}" for axis, length in enumerate(shape)]
        with ExitStack() as inside:
            for i, length in zip(index, shape, strict=True):
                if i:
                    inside.enter_context(self.braces(f"for (int {i} = 0; {i} < {length}; {i}++)"))
            self.write(statement(index))

    def _matmul(self, node: Node) -> None:
        (a, b), out = node.inputs, node.outputs[0]
        name = self._declared(out)
        if a.value is not None and len(a.shape) == 2 and len(b.shape) == 1:
            # Column by column, which compilers turn into vector instructions.
            rows, columns = a.shape
            weights = self.array(a.value.T)
            self.fill(rows, name, "0")
            at = f"j * {rows} + " if columns > 1 else ""
            with self.braces(f"for (int j = 0; j < {columns}; j++)"):
                self.write(f"const real x = {self.element(b, ['j'])};")
                self.loops((rows,), lambda i: f"{name}[{i[0]}] += {weights}[{at}{i[0]}] * x;")
            return
        inner = a.shape[-1]

        def product(i: Index) -> str:
            left, right = i[: len(a.shape) - 1], i[len(a.shape) - 1 :]
            terms = [
                f"{self.element(a, [*left, j])} * {self.element(b, [j, *right])}"
                for j in range(inner)
            ]
            return " + ".join(terms)

        self._put(name, out.shape, product)

    def _reduce(self, node: Node) -> None:
        source, out, axis = node.inputs[0], node.outputs[0], node.options["axis"]
        name, length = self._declared(out), source.shape[axis]
        joined = _REDUCTIONS[node.op]
        if node.op != "sum":
            joined = f"{self.function(joined)}({{0}}, {{1}})"

        def at(i: Index, k: str | int) -> str:
            return self.element(source, [*i[:axis], k, *i[axis:]])

        def first(i: list[str | int]) -> str:
            target = _element(name, out.shape, i)
            start = f"{target} = {at(i, 0)};"
            if length == 1:
                return start
            step = f"{target} = {joined.format(target, at(i, 'k'))};"
            return f"{start} for (int k = 1; k < {length}; k++) {{ {step} }}"

        self.loops(out.shape, first)

    def _concat(self, node: Node) -> None:
        out, axis = node.outputs[0], node.options["axis"]
        name, offset = self._declared(out), 0
        for part in node.inputs:

            def copied(i: list[str | int], part: Symbol = part, offset: int = offset) -> str:
                at = [*i[:axis], _affine(offset, 1, i[axis]), *i[axis + 1 :]]
                return f"{_element(name, out.shape, at)} = {self.element(part, i)};"

            self.loops(part.shape, copied)
            offset += part.shape[axis]

    def _cond(self, node: Node) -> None:
        flag = self.element(node.inputs[0], ())
        targets = [self._declared(out) if size(out) else "" for out in node.outputs]
        for block, opening in zip(node.blocks, (f"if ({flag}) {{", "} else {"), strict=True):
            self.write(opening)
            self.indent += 1
            self.block(block)
            for symbol, target in zip(block.outputs, targets, strict=True):
                self._assign(symbol, target)
            self.indent -= 1
        self.write("}")

    def _scan(self, node: Node) -> None:
        block, length, carried = node.blocks[0], node.options["length"], node.options["carried"]
        starts, xs = node.inputs[:carried], node.inputs[carried:]
        for start, inner, out in zip(starts, block.inputs, node.outputs, strict=False):
            if size(start):
                name = self._declared(out)
                self._assign(start, name)
                self.names[inner] = name
        for out in node.outputs[carried:]:
            if size(out):
                self._declared(out)
        self.count += 1
        n = f"n{self.count}"
        with self.braces(f"for (int {n} = 0; {n} < {length}; {n}++)"):
            used = {*block.outputs, *(x for node in block.nodes for x in used_by(node))}
            for x, inner in zip(xs, block.inputs[carried:], strict=True):
                if inner in used and size(inner):
                    self.names[inner] = self._row(x, inner.shape, n)
            self.block(block)
            for symbol, out in zip(block.outputs[carried:], node.outputs[carried:], strict=True):
                if size(out):
                    self._put_row(symbol, out, n)
            after = [
                self._copied(symbol) if size(symbol) and symbol is not inner else ""
                for symbol, inner in zip(block.outputs[:carried], block.inputs, strict=False)
            ]
            for out, new in zip(node.outputs, after, strict=False):
                if new:
                    self.copy(out.shape, self.names[out], new)

    def _row(self, x: Symbol, shape: tuple[int, ...], n: str) -> str:
        """Write the n-th row of an array to a variable; return its name."""
        return self._kept(shape, False, lambda i: self.element(x, [n, *i]))

    def _put_row(self, symbol: Symbol, out: Symbol, n: str) -> None:
        """Write a symbol to the n-th row of an array."""
        at, of = partial(_element, self.names[out], out.shape), partial(self.element, symbol)
        self.loops(out.shape[1:], lambda i: f"{at([n, *i])} = {of(i)};")

    def _assign(self, symbol: Symbol, target: str) -> None:
        """Write the elements of a symbol to a variable."""
        if target:
            self._put(target, symbol.shape, lambda i: self.element(symbol, i))


def _reads_once(node: Node, symbol: Symbol) -> bool:
    """Return whether an operation reads each element of an input once."""
    if node.op in _REDUCTIONS or node.op == "concat":
        return True
    return node.op not in _REUSED and size(symbol) == size(node.outputs[0])


def _broadcast(shape: tuple[int, ...], index: Index) -> list[str | int]:
    """Return the index into an operand for an index into the broadcast result."""
    own = index[len(index) - len(shape) :]
    return [0 if length == 1 else i for length, i in zip(shape, own, strict=True)]


def _affine(start: int, step: int, i: str | int) -> str | int:
    if isinstance(i, int):
        return start + step * i
    scaled = i if step == 1 else f"-{i}" if step == -1 else f"{step} * ({i})"
    return scaled if not start else f"{start} + {scaled}" if step != -1 else f"{start} - ({i})"


def _element(name: str, shape: tuple[int, ...], index: Index) -> str:
    """Return the expression for an element of an array, or for a scalar."""
    return f"{name}[{_flat(shape, index)}]" if shape else name


def _flat(shape: tuple[int, ...], index: Index) -> str:
    """Return the flat index of an element, in row-major order."""
    terms: list[str] = []
    fixed, stride = 0, 1
    for length, i in zip(reversed(shape), reversed(index), strict=True):
        if isinstance(i, int):
            fixed += stride * i
        else:
            terms.insert(0, f"({i}) * {stride}" if stride > 1 else i)
        stride *= length
    return " + ".join([*terms, *([str(fixed)] if fixed or not terms else [])])
