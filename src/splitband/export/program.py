"""Trace a stream's update by one sample as a program, which is rendered as C or ONNX."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np

from splitband.export.graph import Block, Node, Symbol, trace
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import known_of
from splitband.forecasters.steps import State, Steps, tick
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import named_leaves


@dataclass(frozen=True, eq=False)
class Leaf:
    """Hold an array of the state."""

    name: str  # name of the field of the state
    begun: Array  # its value when the program begins
    cleared: Array  # its value before anything has been measured


@dataclass(frozen=True, eq=False)
class Program:
    """Hold the update of a forecaster's state by one sample.

    block : Inputs are the state's leaves, y, u and y_sim; outputs are the state's leaves, the
        predicted sample and whether it could be predicted.
    given : Names and shapes of the signals of a sample: y, and u and y_sim if the model has them.
    begins : What it goes on from, in words; empty where it begins with nothing measured, because
        the simulator's output for the history was not available.
    needed : How many samples must be observed before a step, if it is cleared.
    note : What a user must know, in sentences; empty for nothing.
    """

    name: str  # an identifier
    forecaster: Forecaster
    block: Block
    leaves: tuple[Leaf, ...]  # the state
    given: dict[str, tuple[int, ...]]
    begins: str
    needed: int
    note: str

    @property
    def record(self) -> Record:
        """Return the training record, for names and the sampling time."""
        return self.forecaster.require_fitted().record

    @property
    def cleared(self) -> str:
        """Return how it begins without measured samples, as the end of a sentence."""
        if self.needed:
            return f"{self.needed} sample(s) must then be observed before a step"
        return "in the model's initial state, and a step needs no observed sample"


def program(
    forecaster: Forecaster, name: str, history: Record | None = None, other_record: bool = False
) -> Program:
    """Return the program of a fitted forecaster, which begins after a history."""
    steps = forecaster.step_form()
    record = forecaster.require_fitted().record
    state = begun(steps, forecaster, history, other_record)
    cleared = steps.begin(None)
    given = {
        "y": (record.ny,),
        "u": (record.nu,),
        "y_sim": (1 + steps.ahead, record.ny if steps.simulated else 0),
    }
    examples = [np.zeros(shape) for shape in given.values()]

    def moved(state: State, *sample: Array) -> tuple[State, Array, Any]:
        following, predicted = tick(steps, state, *sample)
        return following, predicted, np.logical_not(np.isnan(predicted).any())

    try:
        block, _ = trace(moved, cleared, *examples)
    except TypeError as error:
        raise InputError(f"{forecaster.name} cannot be exported: {error}") from error
    prune(block)
    pairs = zip(
        named_leaves(cleared if state is None else state), named_leaves(cleared), strict=True
    )
    leaves = [
        Leaf(f"s_{path}", np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64))
        for (path, one), (_, other) in pairs
    ]
    begins = "training record" if history is None else "history with which it was exported"

    def ready(state: State) -> bool:
        with np.errstate(all="ignore"):
            return not np.isnan(steps.advance(state, *examples[1:])[1]).any()

    needed = 0 if ready(cleared) else max(steps.warmup, 1)
    if state is not None and not ready(state):
        warnings.warn(
            f"{forecaster.name} needs {needed} measured sample(s) before it predicts, which the "
            f"{begins} does not hold: the first steps of {name} predict nothing until it has "
            "observed them",
            stacklevel=2,
        )
    used = {signal: shape for signal, shape in given.items() if np.prod(shape)}
    begins = "" if state is None else begins
    return Program(
        identifier(name), forecaster, block, tuple(leaves), used, begins, needed, steps.note
    )


def begun(
    steps: Steps, forecaster: Forecaster, history: Record | None, other_record: bool
) -> State | None:
    """Return the state after a history; None where that needs output that is not there."""
    try:
        return steps.begin(known_of(forecaster, 0, history, other_record))
    except ValueError:
        if not steps.simulated or history is not None or other_record:
            raise
        return None


def identifier(name: str) -> str:
    """Turn a name into an identifier that is valid in C and FMI."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"model_{word}" if not word or word[0].isdigit() or word[0] == "_" else word


def size(symbol: Symbol) -> int:
    """Return the number of elements."""
    return int(np.prod(symbol.shape))


def prune(block: Block) -> set[Symbol]:
    """Drop operations and inner outputs that a block does not need; return the symbols it uses."""
    needed = {symbol for symbol in block.outputs if size(symbol)}
    kept = []
    for node in reversed(block.nodes):
        if not needed.intersection(node.outputs):
            continue
        if node.blocks:
            carried = node.options.get("carried", 0)
            used = [i < carried or out in needed for i, out in enumerate(node.outputs)]
            node.outputs = tuple(compress(node.outputs, used))
            for inner in node.blocks:
                inner.outputs = list(compress(inner.outputs, used))
                needed |= prune(inner)
        needed.update(symbol for symbol in node.inputs if size(symbol))
        kept.append(node)
    block.nodes = kept[::-1]
    return needed


def used_for(nodes: Sequence[Node], outputs: Iterable[Symbol]) -> set[Symbol]:
    """Return the symbols of which outputs of these operations are computed."""
    needed = {*outputs}
    for node in reversed(nodes):
        if needed.intersection(node.outputs):
            needed.update(node.inputs)
            for block in node.blocks:
                needed |= used_for(block.nodes, block.outputs)
    return needed


def used_by(node: Node) -> Iterator[Symbol]:
    """Yield the symbols that a node and its blocks use, including the blocks' own symbols."""
    yield from (symbol for symbol in node.inputs if size(symbol))
    for block in node.blocks:
        for inner in block.nodes:
            yield from used_by(inner)
        yield from (symbol for symbol in block.outputs if size(symbol))
