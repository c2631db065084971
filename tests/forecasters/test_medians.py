"""The median over trainings, beside NumPy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from splitband.forecasters.prediction import median, median_components


@given(count=st.integers(1, 9), seed=st.integers(0, 2**16))
def test_it_is_numpys_with_ties_and_odd_or_even_members(count: int, seed: int) -> None:
    values = [*np.random.default_rng(seed).integers(0, 4, (count, 6, 2)).astype(float)]
    expected = np.median(values, axis=0)
    whole = median_components([{"": each} for each in values], values)
    np.testing.assert_array_equal(whole[""], expected)
    np.testing.assert_array_equal(median(values), expected)


@given(count=st.integers(1, 6), seed=st.integers(0, 2**16))
def test_the_parts_of_the_members_in_the_middle_add_up(count: int, seed: int) -> None:
    low, high = np.random.default_rng(seed).standard_normal((2, count, 5, 1))
    members = [{"low": one, "high": other} for one, other in zip(low, high, strict=True)]
    parts = median_components(members, [*(low + high)])
    np.testing.assert_allclose(
        parts["low"] + parts["high"], np.median(low + high, axis=0), atol=1e-12
    )
