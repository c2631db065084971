"""Intervals around forecasts: what they hold, and how they grow."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy

from splitband import Forecaster
from splitband.comparison.run import compare
from splitband.forecasters.intervals import HeldOut, Interval
from splitband.forecasters.prediction import ForecastContext
from splitband.records import Record
from tests.signals import LENGTH, SETUP, TRAIN, holed, with_gaps

Array = npt.NDArray[np.float64]
RECORD = np.random.default_rng(0).standard_normal((2000, 1)) * 50
NORMAL = scipy.stats.norm.ppf(0.95)


def of_errors(errors: Sequence[Array], y: Array, share: float = 0.9) -> Interval:
    """The interval that errors of forecasts of a record call for."""
    return HeldOut.of(errors, y).interval(share)


def errors(samples: int, growth: float, seed: int) -> Array:
    """Independent errors whose deviation is sqrt(1 + (growth n)²)."""
    size = np.hypot(1.0, growth * np.arange(samples))
    return (np.random.default_rng(seed).standard_normal(samples) * size)[:, None]


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("growth", [0.0, 0.001, 0.02])
def test_it_holds_its_share_of_errors_like_those_it_was_fitted_to(
    growth: float, share: float
) -> None:
    found = [
        of_errors([errors(500, growth, seed)], RECORD, share).coverage(
            errors(500, growth, 100 + seed)
        )
        for seed in range(20)
    ]
    assert np.mean(found) == pytest.approx(share, abs=0.02)


def test_several_forecasts_count_each_from_its_own_beginning() -> None:
    """Errors that restart with each forecast: taken for one long forecast they would not grow."""
    parts = [errors(170, 0.02, seed) for seed in range(12)]
    apart, glued = (
        of_errors(each, RECORD).half_widths(1001)[:, 0] for each in (parts, [np.concatenate(parts)])
    )
    expected = np.hypot(1, 0.02 * 1000)
    assert apart[-1] / apart[0] > 0.5 * expected
    assert glued[-1] / glued[0] < 0.25 * expected


# What is forecast, and with what, `(samples, train)`: the forecast of all samples from `train` on.
def held(y: Array, train: int) -> Array:
    return np.full(len(y) - train, y[train - 1])


def repeated(period: int) -> Callable[[Array, int], Array]:
    return lambda y, train: np.resize(y[train - period : train], len(y) - train)


def averaged(y: Array, train: int) -> Array:
    return np.full(len(y) - train, y[:train].mean())


def autoregressive(rng: np.random.Generator) -> Array:
    return np.asarray(scipy.signal.lfilter([1], [1, -0.99], rng.standard_normal(3000))[2000:])


N = np.arange(1000)
SEASON = np.sin(2 * np.pi * N / 25)
RECORDS: dict[str, tuple[Callable[[np.random.Generator], Array], Any, float, float]] = {
    "white noise": (lambda rng: rng.standard_normal(1000), averaged, 0.87, 0.93),
    "sine": (lambda rng: SEASON + 0.2 * rng.standard_normal(1000), repeated(25), 0.87, 0.95),
    # Of a single one, nearly all or hardly anything lies inside.
    "random walk": (lambda rng: rng.standard_normal(1000).cumsum(), held, 0.8, 0.95),
    # Four correlation times are too few to tell it from a random walk.
    "AR(0.99)": (autoregressive, held, 0.85, 0.99),
    # All that is left of these errors is a drift, which an interval holds or does not.
    "ramp": (lambda rng: N / 100 + 0.1 * rng.standard_normal(1000), held, 0.9, 1.0),
    "trend and season": (
        lambda rng: N / 200 + SEASON + 0.1 * rng.standard_normal(1000),
        repeated(25),
        0.9,
        1.0,
    ),
}


def fitted(y: Array, forecast: Callable[[Array, int], Array], train: int = 400) -> Interval:
    """From forecasts at six shares of the training part, as a comparison makes them."""
    cuts = [round(share * train) for share in (0.5, 0.625, 0.75, 0.8, 0.85, 0.9)]
    left = [(y[cut:train] - forecast(y[:train], cut))[:, None] for cut in cuts]
    return of_errors(left, y[:train, None])


@pytest.mark.parametrize("kind", RECORDS)
def test_it_holds_nine_tenths_of_a_future_longer_than_the_past(kind: str) -> None:
    make, forecast, least, most = RECORDS[kind]
    found = []
    for seed in range(30):
        y = make(np.random.default_rng(seed))
        left = (y[400:] - forecast(y, 400))[:, None]
        found.append(fitted(y, forecast).coverage(left))
    assert least <= np.mean(found) <= most


def test_errors_that_are_all_alike_say_less_than_as_many_different_ones() -> None:
    """An offset is one error, however many samples show it: Student's quantile of two at most."""
    alike = of_errors([np.ones((200, 1))], RECORD).half_widths(1)[0, 0]
    assert alike == pytest.approx(scipy.stats.t.ppf(0.95, 2) / NORMAL, rel=0.1)
    different = of_errors([errors(2000, 0.0, 2)], RECORD).half_widths(1)[0, 0]
    assert different == pytest.approx(NORMAL, rel=0.08)


def test_only_what_is_bounded_limits_it() -> None:
    rng = np.random.default_rng(2)
    noise, steps = rng.standard_normal((2, 400))
    y = np.stack([noise, steps.cumsum(), 0.02 * N[:400] + noise], axis=1)
    growing = of_errors([np.tile(errors(400, 0.5, 1), 3)], y)
    # Two independent Gaussians of the record's deviation: nine tenths of their differences.
    differences = np.diff(np.random.default_rng(2).standard_normal((2, 10**6)), axis=0)
    apart = np.quantile(abs(differences), 0.9)
    assert growing.most[0] == pytest.approx(apart * noise.std(), rel=0.01)
    assert growing.most[1:] == (None, None)
    widths = growing.half_widths(100_000)
    assert (np.diff(widths, axis=0) >= 0).all()
    assert widths[-1, 0] == growing.most[0]
    assert (widths[-1, 1:] > 100 * apart * y.std(axis=0)[1:]).all()


def test_it_scales_with_the_unit_of_each_channel() -> None:
    e = np.hstack([errors(300, 0.01, 3), errors(300, 0.0, 4)])
    y = np.hstack([RECORD, RECORD])
    one = of_errors([e], y).half_widths(700)
    other = of_errors([e * [1000.0, 0.1]], y * [1000.0, 0.1]).half_widths(700)
    np.testing.assert_allclose(other, one * [1000.0, 0.1], rtol=1e-6)


def test_a_perfect_forecast_has_no_interval() -> None:
    widths = of_errors([np.zeros((50, 1))], RECORD).half_widths(100)
    assert 0 < widths.max() < 1e-12 * abs(RECORD).max()


def test_one_error_is_enough() -> None:
    widths = of_errors([np.array([[1.0]])], RECORD).half_widths(100)
    assert np.isfinite(widths).all()
    assert widths.min() > 1


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0])
def test_a_share_outside_is_named(share: float) -> None:
    with pytest.raises(ValueError, match=f"share must lie between 0 and 1, got {share}"):
        of_errors([np.ones((3, 1))], RECORD, share)


@pytest.mark.parametrize("none", [[], [np.empty((0, 1))], [np.array([[1.0, np.nan]])]])
def test_no_errors_are_named(none: list[Array]) -> None:
    with pytest.raises(ValueError, match="errors must have a sample at least"):
        of_errors(none, np.hstack([RECORD] * none[0].shape[1]) if none else RECORD)


class Changing(Forecaster):
    """Forecasts 0 when fitted to few samples, and a value for each seed when fitted to all."""

    name, random, refits = "changing", True, False
    final: tuple[float, ...] = ()

    def extrapolate(self, known: ForecastContext) -> Array:
        fitted = self.require_fitted()
        whole = len(fitted.record) == 400
        return np.full((known.steps, 1), self.final[fitted.report.seed] if whole else 0.0)


@pytest.mark.parametrize(
    ("final", "variance"), [((3.0,), 9), ((3.0, 5.0), 16 + 2), ((0.03,), None)]
)
def test_change_and_disagreement_of_seeds_add_up_in_the_interval_of_a_network(
    final: tuple[float, ...], variance: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Changing, "final", final)
    y = 50 * errors(420, 0.0, 1)
    y[300:] /= 500
    held_out = compare(Record(y, 0.1), 400, [Changing()], seeds=len(final)).require_trial().held_out
    found = held_out["changing"].interval(0.9).half_widths(20)
    if variance is None:  # a change that the held-out errors explain
        expected = replace(held_out["changing"], doubt=np.zeros((20, 1))).interval(0.9)
        np.testing.assert_array_equal(found, expected.half_widths(20))
    else:
        assert found.mean() == pytest.approx(NORMAL * np.sqrt(variance))


def test_noise_that_a_forecast_repeats_is_counted_once() -> None:
    """Seasonal-naive's error holds the noise twice."""
    inside, widths = [], []
    for seed in range(4):
        y = SEASON + 0.2 * np.random.default_rng(seed).standard_normal(1000)
        record = Record(y[:, None], 0.1)
        found = compare(record, 400, "seasonal-naive")
        interval = found.require_trial().intervals["seasonal-naive"]
        left = record.y[400:] - found.fits["seasonal-naive"][0].ahead
        inside.append(interval.coverage(left))
        widths.append(interval.half_widths(600).mean() / np.quantile(abs(left), 0.9))
    assert 0.85 <= np.mean(inside) <= 0.95
    assert np.mean(widths) <= 1.3


def growing(samples: int, ny: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((samples, ny)) * (1 + 0.01 * np.arange(samples))[:, None]


def test_an_interval_is_fitted_to_the_errors_that_are_known() -> None:
    y = 50 * np.random.default_rng(9).standard_normal((1000, 2))
    parts = [growing(150, 2, seed) for seed in range(3)]
    ends = [holed(part, slice(100 + i, None)) for i, part in enumerate(parts)]
    cut = of_errors([part[: 100 + i] for i, part in enumerate(parts)], y)
    found = of_errors(ends, y).half_widths(500)
    np.testing.assert_allclose(found, cut.half_widths(500), rtol=1e-9)
    # What is known counts at its own horizon: with holes it is nearly the same interval, which it
    # is not when the samples after a hole move into it.
    scattered = [holed(holed(p, slice(3, 40), channel=0), 0, 77, channel=1) for p in parts]
    found, whole = (of_errors(each, y).half_widths(150)[50:] for each in (scattered, parts))
    np.testing.assert_allclose(found, whole, rtol=0.05)
    closed = [p[~np.isnan(p[:, 0])][:, :1] for p in scattered]
    moved = of_errors(closed, y[:, :1]).half_widths(150)[50:, 0]
    assert (moved > 1.1 * whole[:, 0]).all()


def test_an_interval_is_limited_by_the_spread_of_what_was_measured() -> None:
    y = holed(np.random.default_rng(6).standard_normal((LENGTH, 1)), slice(20, 60))
    apart = np.sqrt(2) * NORMAL
    interval = (
        compare(with_gaps(y), TRAIN, ["mean"], **SETUP.options).require_trial().intervals["mean"]
    )
    assert interval.most[0] == pytest.approx(apart * np.nanstd(y[:TRAIN]))


def test_an_interval_is_narrow_or_wide_where_chance_does_not_explain_what_it_holds() -> None:
    """Of 100 independent samples one standard deviation is 3 % of them, of 1,000 it is 1 %."""
    interval = Interval((1.0,), (0.0,), (None,))
    narrow, fits = [(0.52, 20), (0.85, 1000)], [(0.85, 40), (0.88, 100_000), (0.9, 1000), (1.0, 20)]
    cases = {"narrow": narrow, "": fits, "wide": [(0.99, 1000), (1.0, 1000)]}
    for expected, inside, samples in ((word, *each) for word in cases for each in cases[word]):
        size = np.where(np.arange(samples) < inside * samples, 0.5, 2.0)
        size -= 0.1 * np.random.default_rng(0).uniform(size=samples)
        left = np.random.default_rng(1).permutation(size)[:, None]
        assert interval.misfits(left) == (expected,), (inside, samples)
        assert interval.misfits(np.insert(left, 5, np.nan, axis=0)) == (expected,)


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.99])
def test_few_intervals_that_fit_are_called_narrow_or_wide(pole: float) -> None:
    """Nor are those whose errors are alike for long: these count as few."""
    noise = np.random.default_rng(2).standard_normal((300, 1500))
    left = scipy.signal.lfilter([1.0], [1.0, -pole], noise)[:, 500:] * np.sqrt(1 - pole**2)
    interval = Interval((float(NORMAL),) * 300, (0.0,) * 300, (None,) * 300)
    found = interval.misfits(left.T)
    assert found.count("narrow") + found.count("wide") <= 0.12 * len(found)
    half = replace(interval, first=(0.4 * NORMAL,) * 300).misfits(left.T)
    assert half.count("narrow") >= 0.6 * len(found)
