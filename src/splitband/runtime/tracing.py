"""Trace NumPy code: record what a function computes as a graph, from which code is generated.

A function of arrays of fixed shapes is called once with symbols in place of the arrays, which
record the operations on them (`runtime.graph`). Loops and branches that depend on values are
written with `scan` and `cond`, which simply run if the arrays are real.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splitband.runtime.graph import Block, Symbol, Trace
from splitband.runtime.trees import Tree, leaves, rebuilt


def cond(flag: Any, yes: Callable[[], Tree], no: Callable[[], Tree]) -> Tree:
    """Return `yes()` if the flag is true, else `no()`; both need the same shapes."""
    if not isinstance(flag, Symbol):
        return yes() if flag else no()
    (one, tree), (other, _) = map(flag.trace.inner, (yes, no))
    like = [(s.shape, s.flag) for s in one.outputs]
    if like != [(s.shape, s.flag) for s in other.outputs]:
        raise TypeError("both branches must have the same shapes")
    return rebuilt(tree, flag.trace.control("cond", [flag], (one, other), like))


def scan(
    body: Callable[[Tree, Tree], tuple[Tree, Tree]], carry: Tree, xs: Sequence[Any]
) -> tuple[Tree, Tree]:
    """Call `carry, out = body(carry, x)` for the rows x of each array of `xs` in turn.

    Returns the last carry, and the outputs stacked; `out` may be None.
    """
    trace = next((leaf.trace for leaf in leaves((carry, list(xs))) if isinstance(leaf, Symbol)),
                 None)  # fmt: skip
    if trace is not None:
        return _traced_scan(trace, body, carry, list(xs))
    outs = []
    for rows in zip(*xs, strict=True):
        carry, out = body(carry, rows)
        outs.append(out)
    if not outs or outs[0] is None:
        return carry, None
    return carry, rebuilt(
        outs[0], [np.stack(rows) for rows in zip(*map(leaves, outs), strict=True)]
    )


def _traced_scan(
    trace: Trace, body: Callable[[Tree, Tree], tuple[Tree, Tree]], carry: Tree, xs: list[Any]
) -> tuple[Tree, Tree]:
    starts = [trace.symbol(leaf) for leaf in leaves(carry)]
    rows = [trace.symbol(x) for x in xs]

    def inner() -> Tree:
        begun = rebuilt(carry, [trace.input(s) for s in starts])
        return body(begun, [trace.input(Symbol(trace, x.shape[1:])) for x in rows])

    block, (after, outs) = trace.inner(inner)
    length = len(rows[0])
    like = [(s.shape, s.flag) for s in block.outputs[: len(starts)]]
    if [shape for shape, _ in like] != [s.shape for s in starts]:
        raise TypeError("a loop must keep the shapes of what it carries")
    like += [((length, *s.shape), s.flag) for s in block.outputs[len(starts) :]]
    options = {"length": length, "carried": len(starts)}
    found = trace.control("scan", [*starts, *rows], (block,), like, **options)
    return rebuilt(after, found[: len(starts)]), rebuilt(outs, found[len(starts) :])


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
