"""Error measures against closed forms."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband.metrics import cumulative_rmse, fit_percent, nrmse, rmse

Array = npt.NDArray[Any]

THREE_FOUR: Array = np.array([3.0, 4.0])
METRICS: list[Callable[..., Any]] = [rmse, cumulative_rmse, nrmse, fit_percent]

shapes = hnp.array_shapes(min_dims=1, max_dims=2, max_side=30)
arrays = hnp.arrays(np.float64, shapes, elements=st.floats(-1e3, 1e3))


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal(shape)


def test_errors_of_channels_add_up_as_a_euclidean_norm() -> None:
    y = noise(40, 2)
    assert rmse(y, y + THREE_FOUR) == pytest.approx(5)
    np.testing.assert_allclose(cumulative_rmse(y, y + THREE_FOUR), 5)
    assert rmse(y, np.zeros_like(y)) ** 2 == pytest.approx(
        sum(rmse(channel, np.zeros(40)) ** 2 for channel in y.T)
    )


def test_known_errors() -> None:
    assert rmse([1, 2], [4, 6]) == pytest.approx(np.sqrt(12.5))
    np.testing.assert_allclose(
        cumulative_rmse(np.zeros(4), [2, 0, 0, 2]), np.sqrt([4, 2, 4 / 3, 2])
    )


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


def test_nrmse_divides_by_the_population_standard_deviation() -> None:
    y = noise(50)
    assert nrmse(y, y + 2) == pytest.approx(2 / y.std())
    channels = noise(50, 2)
    assert nrmse(channels, channels + THREE_FOUR) == pytest.approx(
        5 / np.sqrt(channels.var(axis=0).sum())
    )


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
        (noise(5), noise(5, 1)),
        (noise(5, 2), noise(5, 1)),
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


def test_each_output_has_a_fit() -> None:
    y, prediction = noise(50, 2), noise(50, 2, seed=1)
    y[10:20, 0] = np.nan
    known = ~np.isnan(y[:, 0])
    expected = [fit_percent(y[known, 0], prediction[known, 0]),
                fit_percent(y[:, 1], prediction[:, 1])]  # fmt: skip
    np.testing.assert_allclose(fit_percent(y, prediction), expected)
