"""Render a program as ONNX: the graph of a step, and that of a whole simulation, a loop over it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.export.c_statements import Precision
from splitband.export.graph import Block, Node, Symbol, table
from splitband.export.program import Program, size
from splitband.runtime.errors import InputError, missing

try:
    import onnx
    from onnx import TensorProto, helper, numpy_helper
except ImportError:
    raise missing("ONNX", "the package onnx", "onnx") from None

OPSET, IR_VERSION = 18, 9
"""Versions of operators and file format, which onnxruntime reads from its version 1.16 on."""
_OPERATORS = table("""
    add=Add sub=Sub mul=Mul div=Div neg=Neg abs=Abs floor=Floor max=Max min=Min pow=Pow
    exp=Exp log=Log sqrt=Sqrt sin=Sin cos=Cos tanh=Tanh sigmoid=Sigmoid matmul=MatMul
    lt=Less gt=Greater le=LessOrEqual ge=GreaterOrEqual eq=Equal isnan=IsNaN
    and=And or=Or not=Not where=Where
""")
_REDUCTIONS = {"sum": "ReduceSum", "largest": "ReduceMax", "smallest": "ReduceMin"}


class _Writer:
    """Write the operations of a program as nodes; bodies of loops and branches are subgraphs."""

    def __init__(self, precision: Precision) -> None:
        self.real = TensorProto.DOUBLE if precision == "double" else TensorProto.FLOAT
        self.type = np.float64 if precision == "double" else np.float32
        self.names: dict[Symbol, str] = {}
        self.constants: dict[tuple[bytes, tuple[int, ...], str], Any] = {}
        self.nodes: list[Any] = []
        self.count = 0

    def add(self, op: str, inputs: Sequence[str], outputs: int = 1, **options: Any) -> list[str]:
        """Add a node; return the names of its outputs."""
        self.count += 1
        named = [f"t{self.count}_{i}" for i in range(outputs)]
        # Older ONNX Runtime names what it makes of a node after it: nodes need names of their own.
        self.nodes.append(helper.make_node(op, inputs, named, f"{op}_{self.count}", **options))
        return named

    def one(self, op: str, *inputs: str, **options: Any) -> str:
        """Add a node with one output; return its name."""
        return self.add(op, inputs, **options)[0]

    def constant(self, value: npt.NDArray[Any]) -> str:
        """Return the name of a constant."""
        if value.dtype == np.float64:
            value = value.astype(self.type)
        key = value.tobytes(), value.shape, str(value.dtype)
        if key not in self.constants:
            whole = np.ascontiguousarray(value).reshape(value.shape)
            self.constants[key] = numpy_helper.from_array(whole, f"w{len(self.constants)}")
        return str(self.constants[key].name)

    def whole(self, *numbers: int) -> str:
        """Return the name of a constant list of whole numbers."""
        return self.constant(np.array(numbers, dtype=np.int64))

    def name(self, symbol: Symbol) -> str:
        """Return the name of a symbol, or of the constant that it stands for."""
        if symbol.value is not None:
            value = symbol.value
            return self.constant(value if value.dtype == np.bool_ else value.astype(np.float64))
        return self.names[symbol]

    def block(self, block: Block) -> None:
        """Write the nodes of a block."""
        for node in block.nodes:
            self.node(node)

    def node(self, node: Node) -> None:
        """Write one operation."""
        if node.op == "scan":
            self._scan(node)
        elif node.op == "cond":
            self._cond(node)
        else:
            self.names[node.outputs[0]] = self._simple(node)

    def described(self, symbol: Symbol, name: str) -> Any:
        """Return name, type and shape for the inputs and outputs of a graph."""
        kind = TensorProto.BOOL if symbol.flag else self.real
        return helper.make_tensor_value_info(name, kind, list(symbol.shape))

    def _simple(self, node: Node) -> str:  # noqa: PLR0911  a line for each kind
        if node.op == "view":
            return self._view(node)
        inputs = [self.name(x) for x in node.inputs]
        if node.op == "reshape":
            return self.one("Reshape", inputs[0], self.whole(*node.outputs[0].shape))
        if node.op == "concat":
            return self.one("Concat", *inputs, axis=node.options["axis"])
        if node.op in _REDUCTIONS:
            axis = self.whole(node.options["axis"])
            return self.one(_REDUCTIONS[node.op], inputs[0], axis, keepdims=0)
        if node.op == "where" and node.outputs[0].flag:  # onnxruntime's Where takes only numbers
            flag, yes, no = inputs
            others = self.one("And", self.one("Not", flag), no)
            return self.one("Or", self.one("And", flag, yes), others)
        if node.op == "matmul" and len(node.inputs[1].shape) == 1:
            # As a matrix of one column: onnxruntime 1.32 multiplies a transposed matrix and a
            # vector wrongly where it fuses both operations.
            last = self.whole(-1)
            column = self.one("Unsqueeze", inputs[1], last)
            return self.one("Squeeze", self.one("MatMul", inputs[0], column), last)
        if node.op == "fmod":
            return self.one("Mod", *inputs, fmod=1)
        if node.op not in _OPERATORS:  # onnxruntime has it in single precision at most
            raise InputError(
                f"ONNX has no {node.op} in double precision, which the equation uses: export it as "
                "C, FMU or CasADi"
            )
        return self.one(_OPERATORS[node.op], *inputs)

    def _view(self, node: Node) -> str:
        source, out, axes = node.inputs[0], node.outputs[0], node.options["axes"]
        name = self.name(source)
        starts, ends, places, steps = [], [], [], []
        for i, (start, step, to) in enumerate(axes):
            length = 1 if to is None else out.shape[to]
            if (start, step, length) == (0, 1, source.shape[i]) or source.shape[i] == 1:
                continue
            last = start + (step or 1) * (length - 1)
            starts.append(start)
            ends.append(last + 1 if step >= 0 else (last - 1 if last else -(2**31)))
            places.append(i)
            steps.append(step or 1)
        if starts:
            name = self.one("Slice", name, *(self.whole(*v) for v in (starts, ends, places, steps)))
        kept = [i for i, (_, _, to) in enumerate(axes) if to is not None]
        if len(kept) < len(axes):
            gone = [i for i in range(len(axes)) if i not in kept]
            name = self.one("Squeeze", name, self.whole(*gone))
        targets = [axes[i][2] for i in kept]
        if targets != sorted(targets):
            name = self.one("Transpose", name, perm=[*np.argsort(targets).tolist()])
        new = [i for i in range(len(out.shape)) if i not in targets]
        if new:
            name = self.one("Unsqueeze", name, self.whole(*new))
        if any(out.shape[i] > 1 for i in new):
            name = self.one("Expand", name, self.whole(*out.shape))
        return name

    def _inner(self, block: Block, inputs: Sequence[Symbol], outputs: Sequence[Symbol]) -> Any:
        """Return the subgraph of a block."""
        outer, self.nodes = self.nodes, []
        given = []
        for symbol in inputs:
            self.count += 1
            self.names[symbol] = f"x{self.count}"
            given.append(self.described(symbol, self.names[symbol]))
        self.block(block)
        named = [self.one("Identity", self.name(symbol)) for symbol in outputs]
        told = [self.described(symbol, name) for symbol, name in zip(outputs, named, strict=True)]
        self.count += 1
        graph = helper.make_graph(self.nodes, f"g{self.count}", given, told)
        self.nodes = outer
        return graph

    def _cond(self, node: Node) -> None:
        kept = [i for i, out in enumerate(node.outputs) if size(out)]
        yes, no = (self._inner(b, [], [b.outputs[i] for i in kept]) for b in node.blocks)
        flag = self.name(node.inputs[0])
        named = self.add("If", [flag], len(kept), then_branch=yes, else_branch=no)
        for i, name in zip(kept, named, strict=True):
            self.names[node.outputs[i]] = name

    def _scan(self, node: Node) -> None:
        block, carried = node.blocks[0], node.options["carried"]
        pairs = [
            (x, inner) for x, inner in zip(node.inputs, block.inputs, strict=True) if size(inner)
        ]
        kept = [i for i, out in enumerate(node.outputs) if size(out)]
        graph = self._inner(block, [i for _, i in pairs], [block.outputs[i] for i in kept])
        rows = sum(1 for x in block.inputs[carried:] if size(x))
        inputs = [self.name(x) for x, _ in pairs]
        named = self.add("Scan", inputs, len(kept), body=graph, num_scan_inputs=rows)
        for i, name in zip(kept, named, strict=True):
            self.names[node.outputs[i]] = name


def render(program: Program, precision: Precision) -> tuple[bytes, bytes]:
    """Return the models of a step and of a simulation."""
    writer = _Writer(precision)
    graph = _step(program, writer)
    start = np.concatenate([*(leaf.begun.ravel() for leaf in program.leaves), np.zeros(1)])
    begun = numpy_helper.from_array(start.astype(writer.type), "state")
    step = helper.make_graph(
        graph.node, program.name, graph.input, graph.output, [*graph.initializer, begun]
    )
    rows = ["state", *program.given]
    outputs = ["state_out", "predicted", "ready"]
    loop = helper.make_node("Scan", rows, outputs, body=graph, num_scan_inputs=len(program.given))

    def over_time(name: str, kind: int, shape: Sequence[int]) -> Any:
        return helper.make_tensor_value_info(name, kind, ["time", *shape])

    simulation = helper.make_graph(
        [loop],
        f"{program.name}_rollout",
        [graph.input[0], *(over_time(n, writer.real, s) for n, s in program.given.items())],
        [
            graph.output[0],
            over_time("predicted", writer.real, (program.record.ny,)),
            over_time("ready", TensorProto.BOOL, ()),
        ],
        [begun],
    )
    return _model(step, program), _model(simulation, program)


def _step(program: Program, writer: _Writer) -> Any:
    """Return the graph of a step, with the state as one vector."""
    block = program.block
    sizes = [leaf.begun.size for leaf in program.leaves]
    state = helper.make_tensor_value_info("state", writer.real, [sum(sizes) + 1])
    begin = 0
    for leaf, symbol, length in zip(program.leaves, block.inputs, sizes, strict=False):
        ends = writer.whole(begin), writer.whole(begin + length)
        if length:
            part = writer.one("Slice", "state", *ends)
            writer.names[symbol] = writer.one("Reshape", part, writer.whole(*leaf.begun.shape))
        begin += length
    last = writer.one("Slice", "state", writer.whole(begin), writer.whole(begin + 1))
    for name, symbol in zip(("y", "u", "y_sim"), block.inputs[-3:], strict=True):
        writer.names[symbol] = name
    writer.block(block)
    *leaves, predicted, ready = block.outputs
    flat = [writer.one("Reshape", writer.name(x), writer.whole(-1)) for x in leaves if size(x)]
    named = {"state_out": writer.one("Concat", *flat, last, axis=0)}
    named |= {"predicted": writer.name(predicted), "ready": writer.name(ready)}
    for name, found in named.items():
        writer.nodes.append(helper.make_node("Identity", [found], [name]))
    given = [
        helper.make_tensor_value_info(name, writer.real, shape)
        for name, shape in program.given.items()
    ]
    outputs = [
        helper.make_tensor_value_info("state_out", writer.real, [sum(sizes) + 1]),
        helper.make_tensor_value_info("predicted", writer.real, [program.record.ny]),
        helper.make_tensor_value_info("ready", TensorProto.BOOL, []),
    ]
    constants = [*writer.constants.values()]
    return helper.make_graph(writer.nodes, "step", [state, *given], outputs, constants)


def _model(graph: Any, program: Program) -> bytes:
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION)
    model.producer_name = "splitband"
    record = program.record
    facts = {
        "model": program.forecaster.name,
        "sampling_time": repr(float(record.sampling_time)),
        "columns": ",".join(record.columns),
        "inputs": ",".join(record.inputs),
        "units": str(record.reading),
    }
    helper.set_model_props(model, facts)
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content
