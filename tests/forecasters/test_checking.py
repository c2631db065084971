"""The check of a model: residual tests with known answers, stability, ranges."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt
import pytest
import scipy

import splitband as sb
from benchmarks import residuals
from splitband.forecasters.residuals import LAGS, residual_tests

Array = npt.NDArray[np.float64]


@pytest.mark.parametrize(("order", "rejected"), [(1, True), (2, False)])
def test_a_linear_model_of_the_wrong_order_is_rejected(order: int, rejected: bool) -> None:
    for seed in (0, 1):
        test, _ = residuals.tested(seed, order, 1000)
        assert (test.dependent == ["u"]) == rejected
        assert test.white != rejected
        assert ("rejected" if rejected else "accepted") in test.verdict()


def test_white_noise_is_rejected_as_often_as_the_level_says() -> None:
    """Under the hypothesis p is uniform: a test of the test, by Kolmogorov and Smirnov."""
    rng = np.random.default_rng(0)
    tests = [
        residual_tests(rng.standard_normal((400, 1)), u, ("y",), ("u",))[0]
        for u in rng.standard_normal((300, 400, 1))
    ]
    for p in ([t.whiteness.p for t in tests], [t.inputs[0].p for t in tests]):
        assert scipy.stats.kstest(p, "uniform").pvalue > 0.01


def test_colored_signals_that_have_nothing_in_common_are_not_taken_to_depend() -> None:
    """Two slow signals look alike where they are not whitened."""
    rng = np.random.default_rng(1)
    slow = scipy.signal.lfilter([1.0], [1.0, -0.97], rng.standard_normal((100, 2, 1000)))
    tests = [residual_tests(e[:, None], u[:, None], ("y",), ("u",))[0] for e, u in slow]
    assert sum(bool(test.dependent) for test in tests) <= 5
    assert not any(test.white for test in tests)


def test_the_ljung_box_statistic_is_that_of_its_definition() -> None:
    e = np.random.default_rng(2).standard_normal(300)
    x = e - e.mean()
    r = np.array([np.sum(x[k:] * x[:-k]) for k in range(1, LAGS + 1)]) / np.sum(x**2)
    q = 300 * 302 * sum(r[k - 1] ** 2 / (300 - k) for k in range(1, LAGS + 1))
    (test,) = residual_tests(e[:, None], None, ("y",), ())
    np.testing.assert_allclose(test.whiteness.values, r)
    assert test.whiteness.p == pytest.approx(1 - scipy.stats.chi2.cdf(q, LAGS))
    assert test.whiteness.band == pytest.approx(2.5758 / np.sqrt(300), rel=1e-4)


def driven(samples: int, seed: int = 0) -> sb.Record:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = scipy.signal.lfilter([0.5], [1.0, -0.8], u) + 0.01 * rng.standard_normal(samples)
    return sb.Record(y, 0.1, u=u, inputs=("force",))


def test_a_good_model_is_accepted_with_its_fits_on_a_record_with_gaps() -> None:
    model = sb.Linear().fit(driven(600))
    other = driven(400, 1)
    y = other.y.copy()
    y[200:210] = np.nan
    gaps = sb.Record.with_gaps(y, 0.1, other.u, inputs=("force",))
    found = model.check_residuals(gaps)
    assert found.accepted
    assert [*found.fits] == ["simulation", "1 step ahead", "10 steps ahead"]
    (fit,) = found.fits["simulation"]
    simulated = model.predict(360, other[:40], other_record=True).y
    assert fit == pytest.approx(sb.fit_percent(gaps.seen[40:], simulated)[0])
    assert "stays in range" in str(found)


class Growing(sb.Forecaster):
    """Doubles in 100 samples."""

    name = "growing"

    def extrapolate(self, known: sb.Known) -> Array:
        return np.asarray(known.y[-1] * 2.0 ** (np.arange(1, known.steps + 1)[:, None] / 100))


def test_a_free_run_that_leaves_the_range_and_an_input_beyond_it_are_named() -> None:
    record = sb.Record(np.sin(0.3 * np.arange(300)), 0.1)
    found = Growing().fit(record).check_residuals(record)
    assert found.leaves is not None
    assert not found.accepted
    assert f"leaves the range of the training record by far after {found.leaves:,}" in str(found)
    model = sb.Linear().fit(driven(600))
    far = driven(400, 1)
    assert far.u is not None
    found = model.check_residuals(sb.Record(5 * far.y, 0.1, u=5 * far.u, inputs=("force",)))
    assert any("force" in line and "range in training" in line for line in found.in_words())


def test_a_record_that_is_too_short_is_named() -> None:
    model = sb.Mean().fit(sb.Record(np.sin(np.arange(99.0)), 0.1))
    with pytest.raises(ValueError, match="record must have 50 samples after the warm-up of mean"):
        model.check_residuals(sb.Record(np.sin(np.arange(40.0)), 0.1))


def test_nothing_is_warned_of_beside_what_is_returned() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Growing().fit(driven(300)).check_residuals(driven(300, 1))
