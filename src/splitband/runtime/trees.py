"""Flatten nested dicts, tuples and lists of arrays, and rebuild them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Tree = Any
"""Nested dicts, tuples and lists of arrays."""


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
    """Return a tree of the same structure with other leaves."""
    given = iter(new)

    def of(branch: Tree) -> Tree:
        if branch is None:
            return None
        if isinstance(branch, dict):
            return {name: of(inner) for name, inner in branch.items()}
        if isinstance(branch, tuple | list):
            return [of(inner) for inner in branch]
        return next(given)

    return of(tree)
