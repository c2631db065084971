"""Error measures against closed forms, of what was measured."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband.metrics import cumulative_rmse, fit_percent, nrmse, rmse, spread
from splitband.runtime.arrays import Array
from tests.signals import NAN, error_of

METRICS: list[Callable[..., Any]] = [rmse, cumulative_rmse, nrmse, fit_percent]

shapes = hnp.array_shapes(min_dims=1, max_dims=2, max_side=30)
arrays = hnp.arrays(np.float64, shapes, elements=st.floats(-1e3, 1e3))


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal(shape)


@given(y=arrays, scale=st.floats(0.01, 100), shift=st.floats(-100, 100))
def test_rmse_scales_with_the_unit_and_ignores_a_common_shift(
    y: Array, scale: float, shift: float
) -> None:
    prediction = np.roll(y, 1, axis=0)
    rounding = 1e-14 * (scale * abs(y).max() + abs(shift))
    assert rmse(scale * y + shift, scale * prediction + shift) == pytest.approx(
        scale * rmse(y, prediction), rel=1e-9, abs=rounding
    )


@pytest.mark.parametrize("shape", [(50,), (50, 3)])
def test_nrmse_of_the_mean_is_one(shape: tuple[int, ...]) -> None:
    y = 100 + noise(*shape)
    mean = np.broadcast_to(y.mean(axis=0), shape)
    assert nrmse(y, mean) == pytest.approx(1)
    assert fit_percent(y, mean) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("error", "fit"), [(0.0, 100.0), (0.25, 75.0), (3.0, -200.0)])
def test_fit_percent_falls_with_the_error(error: float, fit: float) -> None:
    y = noise(50)
    assert fit_percent(y, y + error * y.std()) == pytest.approx(fit)


def test_lists_and_integers_are_taken_as_real_numbers() -> None:
    for metric in METRICS:
        np.testing.assert_allclose(
            metric([1, 2, 4], [1, 1, 1]), metric(np.array([1.0, 2.0, 4.0]), np.ones(3))
        )


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize(
    ("y", "prediction"),
    [
        (noise(5), noise(4)),
        (noise(2, 5, 1), noise(2, 5, 1)),
        (noise(0), noise(0)),
        (np.array(1.0), np.array(1.0)),
    ],
)
def test_shapes_that_do_not_fit_are_named(
    metric: Callable[..., Any], y: Array, prediction: Array
) -> None:
    with pytest.raises(ValueError, match="y and prediction must have one shape") as caught:
        metric(y, prediction)
    assert str(caught.value).endswith(f"got {y.shape} and {prediction.shape}")


@pytest.mark.parametrize("constant", [0.0, 0.1, 1 / 3])
def test_a_constant_record_has_no_nrmse_and_no_fit(constant: float) -> None:
    y = np.full(1000, constant)
    with pytest.raises(ValueError, match="y must not be constant"):
        nrmse(y, np.ones(1000))
    assert np.isnan(fit_percent(y, np.ones(1000)))


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
    assert fit_percent(y, np.full(y.shape, 4.0))[0] == pytest.approx(
        100 * (1 - np.sqrt((9 + 4 + 4) / 3) / deviation)
    )
    assert nrmse(y[:, 0], np.full(4, 4.0)) == pytest.approx(np.sqrt((9 + 4 + 4) / 3) / deviation)
