"""The lines of Python on the page make the forecaster that they stand for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband import Known
from splitband.report.page.python import making

SETTINGS = sb.Settings(40, 10, 3, quasi_newton=20, clip=1.0, milestones=((2, 1e-4),))
BANDS = sb.Bands(0.5, 2, 3)
MADE = {
    "single": sb.Single(sb.GRU(5), SETTINGS),
    "rnn": sb.Single(sb.EulerMLP(state_size=7, hidden_size=9, step_size=0.25), SETTINGS),
    "split": sb.Split(sb.GRU(2), sb.GRU(3), BANDS, filter_output=True, settings=SETTINGS),
    "open bands": sb.Split(sb.GRU(2), sb.GRU(3), conditioned=True, settings=SETTINGS),
    "filtered": sb.Filtered(None, sb.GRU(4), BANDS, calibrated=True, settings=SETTINGS),
    "on a baseline": sb.Residual(sb.Periodic(), sb.GRU(4), conditioned=True, settings=SETTINGS),
    "baseline": sb.Harmonic(),
    "simulator": sb.Simulation(calibrated=["gain", "offset"]),
    "on an affine simulator": sb.Residual(
        sb.Simulation(calibrated=["gain", "offset"]), sb.GRU(4), settings=SETTINGS
    ),
    "on a network of other settings": sb.Residual(
        sb.Single(sb.GRU(5), sb.Settings(60, 20, 2)), sb.GRU(4), settings=SETTINGS
    ),
    "some seeds": sb.Ensemble(sb.Single(sb.GRU(5), SETTINGS), seeds=(0, 2)),
    "several": sb.Ensemble(sb.Single(sb.GRU(5), SETTINGS), 4),
}


class Mine(sb.Forecaster):
    name = "mine"

    def extrapolate(self, known: Known) -> npt.NDArray[np.float64]:
        return np.zeros((known.steps, 1))


@pytest.mark.parametrize("name", MADE)
def test_they_make_the_same_forecaster(name: str) -> None:
    forecaster = MADE[name]
    names = {"sb": sb}
    exec("\n".join(making(forecaster)), names)
    assert _options(names["model"]) == _options(forecaster)


def _options(value: object) -> object:
    """All that a forecaster was made with."""
    if isinstance(value, sb.GRU | sb.EulerMLP):
        return str(value), getattr(value, "step_size", None)
    if isinstance(value, sb.Forecaster):
        return type(value), {k: _options(v) for k, v in vars(value).items()}
    return list(value) if isinstance(value, tuple) else value


def test_what_only_the_user_can_make_is_left_open() -> None:
    assert making(sb.Residual(sb.Function(np.sin), sb.GRU(4))) == [
        "model = sb.Residual(..., sb.GRU(4))"
    ]
    assert making(Mine()) == ["model = ...  # mine"]
