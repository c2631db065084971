"""Errors and spread count what was measured."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband.metrics import cumulative_rmse, nrmse, rmse, spread
from tests.records import NAN, error_of

Array = npt.NDArray[np.float64]


with_missing = st.tuples(st.integers(1, 15), st.integers(1, 3)).flatmap(
    lambda shape: st.tuples(
        hnp.arrays(np.float64, shape, elements=st.floats(-1e3, 1e3)),
        hnp.arrays(np.float64, shape, elements=st.floats(-1e3, 1e3)),
        hnp.arrays(np.bool_, shape),
    )
)


@given(drawn=with_missing)
def test_errors_count_what_was_measured(drawn: tuple[Array, Array, npt.NDArray[np.bool_]]) -> None:
    y, prediction, missing = drawn
    y = np.where(missing, NAN, y)
    assert rmse(y, prediction) == pytest.approx(error_of(y, prediction), nan_ok=True)
    cumulative = cumulative_rmse(y, prediction)
    expected = [error_of(y[:n], prediction[:n]) for n in range(1, len(y) + 1)]
    np.testing.assert_allclose(cumulative, expected, rtol=1e-9, atol=1e-9)


def test_a_prediction_that_is_no_number_is_no_gap() -> None:
    prediction = np.array([0.0, NAN, 0.0])
    assert np.isnan(rmse([0.0, 0.0, NAN], prediction))
    assert rmse([0.0, NAN, 3.0], prediction) == pytest.approx(np.sqrt(4.5))


def test_the_spread_is_that_of_what_was_measured() -> None:
    y = np.array([[1.0, 0.1, NAN], [NAN, NAN, 7.0], [2.0, 0.1, NAN], [6.0, 0.1, NAN]])
    seen = [[1.0, 2.0, 6.0], [0.1] * 3, [7.0]]
    means = [sum(values) / len(values) for values in seen]
    deviation = np.sqrt(sum((v - means[0]) ** 2 for v in seen[0]) / 3)
    np.testing.assert_allclose(spread(y), [deviation, 1, 1])  # 1 for what is constant
    assert nrmse(y[:, 0], np.full(4, 4.0)) == pytest.approx(np.sqrt((9 + 4 + 4) / 3) / deviation)
