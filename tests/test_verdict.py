"""One commit has one verdict: nothing in the suite is drawn anew."""

from typing import Any

import torch
from hypothesis import given
from hypothesis import strategies as st


def drawn() -> list[Any]:
    """The examples of a property test."""
    seen = []

    @given(st.lists(st.floats()))
    def look(values: list[float]) -> None:
        seen.append(repr(values))

    look()
    return seen


def test_property_tests_see_the_same_examples_every_time() -> None:
    first = drawn()
    assert len(set(first)) > 30
    assert drawn() == first


def test_networks_begin_with_the_same_weights_every_time() -> None:
    assert torch.initial_seed() == 0
