"""Fixtures of tests of comparisons."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from splitband.comparison import candidates


@pytest.fixture(scope="module")
def short_rounds() -> Iterator[None]:
    """Begin the search with few epochs and steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(candidates, "FIRST_ROUND", 4)
        patch.setattr(candidates, "FIRST_STEPS", 3)
        yield
