"""Loops and branches of traceable NumPy code, with trees of arrays.

A symbol of a tracer (`export.graph`) records a loop or a branch; with arrays they simply run.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

Tree = Any
"""Nested dicts, tuples and lists of arrays."""
Body = Callable[[Tree, Tree], tuple[Tree, Tree]]
"""Maps a loop's carry and a row of every array to the new carry and an output."""


class Traced(ABC):
    """The symbol of an array in a traced function."""

    @abstractmethod
    def branch(self, yes: Callable[[], Tree], no: Callable[[], Tree]) -> Tree:
        """Record a branch with this flag as its condition."""

    @abstractmethod
    def loop(self, body: Body, carry: Tree, xs: Sequence[Any]) -> tuple[Tree, Tree]:
        """Record a loop, see `scan`."""


def leaves(tree: Tree) -> list[Any]:
    """Return the arrays of a tree in their order."""
    return [leaf for _, leaf in named_leaves(tree)]


def named_leaves(tree: Tree, path: str = "") -> list[tuple[str, Any]]:
    """Return the arrays of a tree with their paths, such as `base_level` or `members_0_h`."""
    if tree is None:
        return []
    if isinstance(tree, dict):
        items = list(tree.items())
    elif isinstance(tree, tuple | list):
        items = [(str(i), branch) for i, branch in enumerate(tree)]
    else:
        return [(path, tree)]
    joined = f"{path}_" if path else ""
    return [leaf for name, branch in items for leaf in named_leaves(branch, f"{joined}{name}")]


def rebuilt(tree: Tree, new: Sequence[Any]) -> Tree:
    """Return a tree of equal structure with other leaves."""
    new_leaves = iter(new)

    def of(branch: Tree) -> Tree:
        if branch is None:
            return None
        if isinstance(branch, dict):
            return {name: of(inner) for name, inner in branch.items()}
        if isinstance(branch, tuple | list):
            return [of(inner) for inner in branch]
        return next(new_leaves)

    return of(tree)


def cond(flag: Any, yes: Callable[[], Tree], no: Callable[[], Tree]) -> Tree:
    """Return `yes()` if the flag is true, else `no()`; both need the same shapes."""
    if isinstance(flag, Traced):
        return flag.branch(yes, no)
    return yes() if flag else no()


def scan(body: Body, carry: Tree, xs: Sequence[Any]) -> tuple[Tree, Tree]:
    """Call `carry, out = body(carry, x)` for the rows x of the arrays `xs` in turn.

    Returns the last carry, and the outputs stacked; `out` may be None.
    """
    for leaf in leaves((carry, list(xs))):
        if isinstance(leaf, Traced):
            return leaf.loop(body, carry, list(xs))
    outs = []
    for rows in zip(*xs, strict=True):
        carry, out = body(carry, rows)
        outs.append(out)
    if not outs or outs[0] is None:
        return carry, None
    return carry, rebuilt(
        outs[0], [np.stack(rows) for rows in zip(*map(leaves, outs), strict=True)]
    )
