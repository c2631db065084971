"""What a forecaster says that it is, for people; nothing is taken from its name."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband.forecasters.names import NAMES


class NonLinear(sb.Forecaster):
    name = "nonlinear"

    def trajectory(self, known: sb.ForecastContext) -> npt.NDArray[np.float64]:
        return np.zeros((len(known.y) + known.steps, 1))

    def extrapolate(self, known: sb.ForecastContext) -> npt.NDArray[np.float64]:
        return self.trajectory(known)[len(known.y) :]


@pytest.mark.parametrize(
    ("model", "name", "words"),
    [
        (sb.Residual(sb.Single(sb.GRU(4)), sb.GRU(4)), "residual-gru-gru", "network plus GRU"),
        (sb.Residual(NonLinear(), sb.GRU(4)), "residual-nonlinear-gru", "nonlinear plus GRU"),
        (sb.Filtered(sb.Linear(), sb.GRU(4)), "filtered-linear-gru", "linear model in the low"),
        (
            sb.Filtered(sb.Calibrated(), sb.GRU(4), conditioned=True),
            "filtered-gru-calibrated-conditioned",
            "calibrated simulator in the low band",
        ),
        (
            sb.Ensemble(sb.Single(sb.StateSpace(3, 4))),
            "state-space",
            "state-space network",
        ),
    ],
)
def test_a_hybrid_says_what_its_base_is(model: sb.Forecaster, name: str, words: str) -> None:
    assert model.name == name
    assert model.in_words().startswith(words)
    assert ("simulator" in model.in_words()) == ("simulator" in model.needs)


def test_a_base_of_ones_own_is_fitted_and_labelled_by_its_name() -> None:
    record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    model = sb.Residual(NonLinear(), sb.GRU(2), settings=sb.Settings(40, 10, 1)).fit(record)
    assert sorted(model.predict(10).components) == ["network", "nonlinear"]


def test_every_name_is_that_of_its_object() -> None:
    assert all(method.name == name for name, method in NAMES.items())
    assert all(method.in_words() for method in NAMES.values())
