"""When a prediction goes far beyond what was measured."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splitband.metrics import leaves_range
from tests.signals import (
    NAN,
    QUICK,
    SETUP,
    holed,
    standing_in,
)
from tests.support import compare


@pytest.mark.parametrize(
    ("training", "prediction", "leaves"),
    [
        ([0, 2], [1, 4, -2, 1], None),  # three times as far from 1 as the training samples
        ([0, 2], [1, 4.001, 0], 1),
        ([0, NAN, 2, NAN], [4, 4.001], 1),
        ([0, 2], [1, 1, NAN], 2),
        ([0, 2], [np.inf], 0),
        ([[0, 0], [2, 20]], [[4, 40], [1, 10], [1, -21]], 2),
        ([[0, NAN], [NAN, 0], [2, 20]], [[4, 40], [5, 10]], 1),
        # What was constant is left by what is no number.
        ([7, NAN, 7], [7, 7.001, -1e6], None),
        ([7, NAN, 7], [7, np.inf], 1),
    ],
)
def test_a_prediction_leaves_three_times_the_range_of_the_training_samples(
    training: Any, prediction: Any, leaves: int | None
) -> None:
    first, second = (np.array(values, dtype=np.float64) for values in (training, prediction))
    if first.ndim == 1:
        first, second = first[:, None], second[:, None]
    assert leaves_range(first, second) == leaves


def test_a_run_says_when_its_forecast_leaves_the_range_of_what_was_measured() -> None:
    y = np.concatenate([np.tile([0.0, 1.0], 50), np.zeros(20)])[:, None]
    far = standing_in(holed(y, 3, 50), 1e6, y_sim=np.arange(120.0)[:, None] / 55)
    short = replace(SETUP, train=100, settings=replace(QUICK, warmup=2))
    found = compare(far, ["simulator", "persistence"], short)
    assert found.leaves("persistence") is None
    assert found.leaves("simulator") == 11  # at sample 111 it says more than 2
