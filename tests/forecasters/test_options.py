"""Options: kept, read, changed, cloned, written as Python; and what a forecaster is called."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from torch import nn

import splitband as sb
from splitband import Forecaster, Record
from splitband.comparison.methods import NAMES, named
from splitband.forecasters.prediction import ForecastContext

SETTINGS = sb.TrainingSettings.paper(
    40, 10, 3, lbfgs_iterations=20, clip=1.0, milestones=((2, 1e-4),)
)
SHORT = sb.TrainingSettings.paper(40, 10, 1)
BANDS = sb.Bands(0.5, 2, 3)
MADE: dict[str, Forecaster] = {
    "single": sb.Single(sb.GRU(5), SETTINGS),
    "sized": sb.Single(sb.GRU(5, ny=2, nu=1), SETTINGS, "my 'first', best = network"),
    "rnn": sb.Single(sb.networks.EulerMLP(state_size=7, hidden_size=9, step_size=0.25), SETTINGS),
    "split": sb.Split(sb.GRU(2), sb.GRU(3), BANDS, filter_output=True, settings=SETTINGS),
    "open bands": sb.Split(sb.GRU(2), sb.GRU(3), conditioned=True, settings=SETTINGS),
    "filtered": sb.Filtered(sb.Calibrated(), sb.GRU(4), BANDS, settings=SETTINGS),
    "filtered high": sb.Filtered(None, sb.GRU(4), settings=SETTINGS, simulator_band="high"),
    "on a baseline": sb.Residual(sb.Periodic(), sb.GRU(4), conditioned=True, settings=SETTINGS),
    "baseline": sb.Harmonic(),
    "simulator": sb.Calibrated(terms=["gain", "offset"]),
    "on an affine simulator": sb.Residual(
        sb.Calibrated(terms=["gain", "offset"]), sb.GRU(4), settings=SETTINGS
    ),
    "on a network of other settings": sb.Residual(
        sb.Single(sb.GRU(5), sb.TrainingSettings.paper(60, 20, 2)), sb.GRU(4), settings=SETTINGS
    ),
    "some seeds": sb.Ensemble(sb.Single(sb.GRU(5), SETTINGS), seeds=(0, 2)),
    "several": sb.Ensemble(sb.Single(sb.GRU(5), SETTINGS), 4),
    "several kinds": sb.Ensemble([sb.Single(sb.GRU(5), SETTINGS), sb.Single(sb.GRU(7))]),
}


class Mine(Forecaster):
    name = "mine"

    def __init__(self, weight: float, parts: tuple[Forecaster, ...] = ()) -> None:
        self.weight, self.parts = weight, parts

    def extrapolate(self, known: ForecastContext) -> npt.NDArray[np.float64]:
        return np.zeros((known.steps, 1))


class Forgetful(Mine):
    def __init__(self, factor: float) -> None:
        super().__init__(2 * factor)


class OwnCell(nn.Module):
    def __init__(self, hidden_size: int, ny: int = 1) -> None:
        super().__init__()
        self.hidden_size, self.ny = hidden_size, ny

    def sized(self, ny: int, nu: int, warmup: int) -> OwnCell:
        return OwnCell(self.hidden_size, ny)


def rig(time: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.sin(time)


def record() -> Record:
    time = 0.1 * np.arange(160)
    return Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)


def seen(value: object) -> Any:
    """All that a forecaster was made with, and is."""
    if isinstance(value, sb.GRU | sb.networks.EulerMLP):
        sizes = "ny", "nu", "warmup", "hidden_size", "state_size", "recognition_size", "step_size"
        return type(value), [getattr(value, name, None) for name in sizes]
    if isinstance(value, Forecaster):
        return type(value), {k: seen(v) for k, v in vars(value).items()}
    return [seen(part) for part in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("name", MADE)
def test_its_repr_and_its_clone_make_the_same_forecaster(name: str) -> None:
    forecaster = MADE[name]
    assert seen(eval(repr(forecaster), {"sb": sb})) == seen(forecaster)
    assert seen(forecaster.clone()) == seen(forecaster)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (sb.GRU(32, 2, 1), "sb.GRU(32, ny=2, nu=1)"),
        (sb.Bands(0.5, 2, 3).chosen(record().y, 10.0, 20), repr(sb.Bands(0.5, 2, 3))),
        (sb.Function(rig, start=1), "sb.Function(rig, start=1)"),
        (sb.Function(lambda t: t), "sb.Function(...)"),
        (sb.Ode(rig, [0.0, 1.0], method="BDF"), "sb.Ode(rig, [0.0, 1.0], method='BDF')"),
        (sb.Recorded(np.zeros(3), 0.1), "sb.Recorded(..., 0.1)"),
        (Mine(np.float64(0.5), (sb.Mean(),)), "Mine(0.5, parts=(sb.Mean(),))"),
        (Forgetful(1.0), "Forgetful(...)"),
        (sb.Single(OwnCell(6)), "sb.Single(OwnCell(6))"),  # type: ignore[arg-type]
        (
            sb.Residual(sb.Function(rig), sb.GRU(4)),
            "sb.Residual(sb.Simulation(sb.Function(rig)), sb.GRU(4))",
        ),
    ],
)
def test_what_differs_from_the_defaults_is_written(value: object, expected: str) -> None:
    assert repr(value) == expected


def test_options_are_read_and_changed_by_name() -> None:
    model = sb.Single(sb.GRU(4), SHORT)
    assert model.get_params() == {"cell": model.cell, "settings": SHORT, "name": None}
    assert model.set_params(name="small", settings=SETTINGS) is model
    assert (model.name, model.settings) == ("small", SETTINGS)
    assert model.set_params(name=None).name == "gru"
    with pytest.raises(TypeError, match="windows"):
        model.set_params(windows=3)
    with pytest.raises(ValueError, match="count must be"):
        sb.Ensemble(model).set_params(count=0)


def test_options_changed_after_a_fit_ask_for_another_one() -> None:
    model = sb.Calibrated(sb.Function(rig)).fit(record()).set_params(terms=("gain",))
    assert model.name == "simulator-gain"
    with pytest.raises(ValueError, match="must be fitted"):
        model.predict(5)


@pytest.mark.parametrize(
    "model",
    [
        sb.Residual(sb.Single(sb.GRU(2), SHORT), sb.GRU(2), settings=SHORT),
        sb.Residual(sb.Calibrated(sb.Function(rig)), sb.GRU(2), settings=SHORT),
        sb.Split(sb.GRU(2), sb.GRU(2), settings=SHORT),
        sb.Ensemble(sb.Single(sb.GRU(2), SHORT), 2),
        sb.Linear(),
    ],
    ids=lambda model: model.name,
)
def test_a_fit_leaves_the_options_as_they_are(model: Forecaster) -> None:
    given = record()
    if "inputs" in model.needs:
        given = Record(given.y, 0.1, u=np.cos(0.3 * np.arange(160)))
    options = model.get_params()
    before = {name: seen(value) for name, value in options.items()}
    model.fit(given)
    after = model.get_params()
    assert all(after[name] is options[name] for name in options)
    assert {name: seen(value) for name, value in after.items()} == before


def test_a_clone_shares_no_forecaster_and_is_not_fitted() -> None:
    model = Mine(1.0, (sb.Mean().fit(record()),)).fit(record())
    other = model.clone()
    assert other.fitted is None
    assert other.parts[0].fitted is None
    assert model.parts[0].fitted is not None


def test_an_option_that_is_not_kept_is_named() -> None:
    with pytest.raises(TypeError, match="Forgetful must keep its constructor's argument factor"):
        Forgetful(1.0).clone()


class NonLinear(sb.Forecaster):
    name = "nonlinear"

    def trajectory(self, known: ForecastContext) -> npt.NDArray[np.float64]:
        return np.zeros((len(known.y) + known.steps, 1))

    def extrapolate(self, known: ForecastContext) -> npt.NDArray[np.float64]:
        return self.trajectory(known)[len(known.y) :]


@pytest.mark.parametrize(
    ("model", "name"),
    [
        (sb.Residual(sb.Single(sb.GRU(4)), sb.GRU(4)), "residual-gru-gru"),
        (sb.Residual(NonLinear(), sb.GRU(4)), "residual-nonlinear-gru"),
        (sb.Filtered(sb.Linear(), sb.GRU(4)), "filtered-linear-gru"),
        (
            sb.Filtered(sb.Calibrated(), sb.GRU(4), conditioned=True),
            "filtered-gru-calibrated-conditioned",
        ),
        (sb.Ensemble(sb.Single(sb.StateSpace(3, 4))), "state-space"),
    ],
)
def test_a_hybrid_is_called_by_its_base_and_says_whether_it_is_a_simulator(
    model: sb.Forecaster, name: str
) -> None:
    assert model.name == name
    assert ("simulator" in model.in_words()) == ("simulator" in model.needs)


def test_a_base_of_ones_own_is_fitted_and_labelled_by_its_name() -> None:
    record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    model = sb.Residual(NonLinear(), sb.GRU(2), settings=sb.TrainingSettings.paper(40, 10, 1)).fit(
        record
    )
    assert sorted(model.predict(10).components) == ["network", "nonlinear"]


def test_every_name_is_that_of_its_object() -> None:
    assert all(method.name == name for name, method in NAMES.items())
    assert all(method.in_words() for method in NAMES.values())


def test_a_model_of_bands_says_its_cut_off_once_it_is_known() -> None:
    assert named("filtered-gru").in_words() == "simulator in the low band, GRU in the high band"
    model = sb.Filtered(None, sb.GRU(4), sb.Bands(0.15, 1, 1), conditioned=True)
    assert model.in_words() == "simulator below 0.15 Hz, GRU above"
    assert named("residual-gru-calibrated").in_words() == "calibrated simulator + GRU"
