"""What a comparison hands out: methods as they were trained, medians with their parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband import GRU, Bands, Forecaster, Record, TrainingSettings
from splitband.comparison.methods import Sizes
from splitband.forecasters.prediction import ForecastContext, median_of
from splitband.metrics import ExtrapolationWarning
from splitband.runtime.workers import Workers
from tests.signals import Setup
from tests.support import compare

Array = npt.NDArray[np.float64]
DT, TRAIN, WARMUP = 0.1, 160, 12
SETTINGS = TrainingSettings.paper(40, WARMUP, 1, 16)
SETUP = Setup(TRAIN, SETTINGS, Bands(0.6, 1, 2), Sizes(hidden_high=4, hidden_low=3))


def record(samples: int = 200) -> Record:
    t = DT * np.arange(samples)
    return Record(np.sin(1.3 * t) + 0.2 * np.sin(8 * t), DT)


@cache
def compared() -> sb.Comparison:
    return compare(record(), ["split-gru", "gru", "mean"], SETUP, seeds=3)


def of_all(methods: Sequence[Forecaster | str] | str, **options: Any) -> sb.Comparison:
    """Trained on the whole record."""
    return sb.compare(record(), len(record()), methods, **SETUP.options, **options)


@pytest.mark.parametrize("name", ["split-gru", "mean"])
def test_a_method_is_handed_out_as_it_was_trained(name: str, tmp_path: Path) -> None:
    """Nothing is trained again: not for its forecast, and not for the interval."""
    model = compared().trained(name)
    np.testing.assert_allclose(model.predict(40).y, compared().medians[name].ahead, atol=1e-12)
    model.save(tmp_path / "model")
    loaded = sb.load(tmp_path / "model").predict(40, level=0.9)
    np.testing.assert_array_equal(loaded.y, model.predict(40).y)
    assert loaded.lower is not None
    again = model.untrained()
    assert again.fitted is None
    ahead = again.fit(record()[:TRAIN], seed=0).predict(40).y
    np.testing.assert_allclose(ahead, compared().medians[name].ahead, atol=1e-12)


def widths(prediction: sb.Prediction) -> Array:
    """The widths of its interval."""
    assert prediction.lower is not None
    assert prediction.upper is not None
    return np.asarray(prediction.upper - prediction.lower)


class Fickle(sb.Forecaster):
    """Forecasts 0 when fitted to few samples, and 1 when fitted to more."""

    name, random, refits = "fickle", True, False

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.full((known.steps, 1), float(len(self.require_fitted().record) >= TRAIN))


def test_the_interval_of_what_is_handed_out_is_that_of_the_page(tmp_path: Path) -> None:
    """A forecast that the final training has changed is doubted by the model, too."""
    y = 0.01 * np.random.default_rng(0).standard_normal(200)
    y[:100] += np.linspace(5, 0, 100)
    result = compare(Record(y, DT), [Fickle()], SETUP)
    shown = result.predictions["fickle"]
    assert (widths(shown) > 1).all()
    np.testing.assert_allclose(widths(result.model.predict(40, level=0.9)), widths(shown))
    result.model.save(tmp_path / "model")
    loaded = sb.load(tmp_path / "model").predict(40, level=0.9)
    np.testing.assert_allclose(widths(loaded), widths(shown))


class Wild(Fickle):
    """Forecasts the mean, and with the seed 1 a hundred times the range."""

    name = "wild"

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.full((known.steps, 1), 100.0 * (self.require_fitted().report.seed == 1))


def test_a_failed_training_is_left_out_of_a_comparison_and_of_a_forecast() -> None:
    """By its simulation of the training record."""
    compared = sb.compare(record(), TRAIN, [Wild()], **SETUP.options)
    found = of_all([Wild()])
    assert [fit.seed for fit in compared.fits["wild"]] == [0, 2]
    assert isinstance(found.model, sb.Ensemble)
    assert found.model.seeds == (0, 2)
    np.testing.assert_array_equal(found.model.predict(30).y, 0)
    assert "seed 1 left out: training error" in found.fits["wild"][0].description
    assert of_all([Wild()], seeds=3).model.get_params()["seeds"] == (0, 1, 2)


@pytest.mark.parametrize("methods", [["mean", "persistence"], [Fickle()]])
def test_a_comparison_beyond_the_record_is_refused_before_anything_is_fitted(methods: Any) -> None:
    expected = "horizon must end within the record: at most 0 .* got 50; `splitband forecast`"
    with pytest.raises(ValueError, match=expected):
        sb.compare(record(), train=200, methods=methods, horizon=50)


def test_what_was_trained_elsewhere_is_handed_out() -> None:
    below = sb.Single(GRU(3), SETTINGS)
    methods: list[Forecaster | str] = [sb.Residual(below, GRU(4)), "mean"]
    with Workers(1) as executor:
        result = compare(record(), methods, SETUP, seeds=2, executor=executor)
    for name in result.fits:
        ahead = result.trained(name).predict(40).y
        np.testing.assert_allclose(ahead, result.medians[name].ahead, atol=1e-12)


def test_the_recommended_method_is_fitted_to_the_whole_record_where_that_is_asked_for() -> None:
    result = compare(record(), ["gru"], SETUP, seeds=2, refit=True)
    again = result.trained().untrained().fit(record(), seed=0)
    np.testing.assert_allclose(result.model.predict(30).y, again.predict(30).y, atol=1e-12)


def test_a_model_of_the_whole_record_forecasts_what_comes_after_it() -> None:
    found = of_all(["gru"], seeds=2)
    assert not found.predictions
    said = found.model.predict(30, level=0.9)
    assert (widths(said) > 0).all()
    again = found.model.untrained().fit(record(), seed=0)
    np.testing.assert_allclose(again.predict(30).y, said.y, atol=1e-12)


def test_what_was_not_compared_is_not_handed_out() -> None:
    with pytest.raises(ValueError, match="name must be one of split-gru, gru, mean, got linear"):
        compared().trained("linear")


def test_reasons_to_doubt_one_seed_are_reasons_to_doubt_the_median() -> None:
    first, second, _ = (fit.from_start for fit in compared().fits["gru"])
    median = median_of([replace(first, warnings=("a", "b")), replace(second, warnings=("b", "c"))])
    assert median.warnings == ("a", "b", "c")


def test_a_first_warm_up_after_the_training_part_does_not_hide_the_forecast() -> None:
    y = record().y.copy()
    y[5:TRAIN:10] = np.nan
    measured = ~np.isnan(y)
    gaps = Record(np.nan_to_num(y), DT, measured=measured)
    setup = replace(SETUP, settings=replace(SETTINGS, warmup=20))
    (fit,) = compare(gaps, ["mean"], setup).fits["mean"]
    assert fit.forecast is not None
    assert len(fit.forecast) == 40
    assert len(fit.from_start) < 40


class _Diverging(Forecaster):
    """Says its seed, but for the seed 1, with which it diverges."""

    name, random = "diverging", True

    def learn(self, records: Sequence[Record], *, seed: int, **_: Any) -> None:
        if seed == 1:
            raise FloatingPointError("it diverged")
        self.value = float(seed)

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.full((known.steps, 1), self.value)


class _DivergingLater(_Diverging):
    """Diverges with every seed once it is fitted to the whole training part."""

    def learn(self, records: Sequence[Record], *, seed: int, **_: Any) -> None:
        """Remember the seed."""
        if len(records[0]) == TRAIN:
            raise FloatingPointError("it diverged")
        self.value = float(seed)


def test_a_method_of_which_every_last_training_fails_does_not_end_a_comparison() -> None:
    result = sb.compare(record(), TRAIN, methods=[_DivergingLater(), sb.Mean()])
    assert result.recommended == "mean"
    assert {*result.fits} == {"diverging", "mean"}
    (note,) = result.clock.notes
    assert "(it diverged); its results are those of a model trained on three quarters" in note


def test_the_seeds_that_did_not_diverge_are_handed_out() -> None:
    result = compare(record(), [_Diverging()], SETUP, seeds=3)
    assert [fit.seed for fit in result.fits["diverging"]] == [0, 2]
    assert result.fits["diverging"][0].description.endswith("seed 1 failed: it diverged")
    again = result.trained("diverging").untrained().fit(record()[:TRAIN], seed=0)
    np.testing.assert_array_equal(again.predict(40).y, result.medians["diverging"].ahead)
    found = of_all([_Diverging()], seeds=3).model
    assert isinstance(found, sb.Ensemble)
    assert found.seeds == (0, 2)
    again = found.untrained().fit(record(), seed=0)
    np.testing.assert_array_equal(again.predict(30).y, found.predict(30).y)


def test_a_calibration_is_the_same_wherever_it_is_fitted() -> None:
    """Of a simulator whose output ends with the record."""
    t = DT * np.arange(400)
    simulated = Record(np.sin(1.03 * t), DT, y_sim=np.sin(t))
    setup = replace(SETUP, train=300)
    result = compare(simulated, [sb.Calibrated(terms=["clock"])], setup)
    part = replace(simulated[:300], y_sim=simulated.y_sim)
    with pytest.warns(ExtrapolationWarning, match="output ends too early"):
        found = result.trained().untrained().fit(part).predict(100)
    np.testing.assert_array_equal(found.y, result.medians["simulator-clock"].ahead)


def test_a_method_goes_by_its_name_alone() -> None:
    assert [*sb.compare(record(), methods="mean").fits] == ["mean"]
