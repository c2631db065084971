"""Further training records are for baselines, too; and what cannot be fitted has a reason."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.signal

import splitband as sb
from splitband import Bands, Record, TrainingSettings
from splitband.comparison.candidates import candidates
from splitband.linear.identification import identified
from splitband.metrics import ExtrapolationWarning, rmse
from splitband.report.tables import of_comparison
from tests.signals import Setup
from tests.support import compare, known_after

SHORT = TrainingSettings.paper(40, 10, 1)
SETUP = Setup(300, SHORT, Bands(0.6, 1, 2))


def driven(seed: int, amplitude: float = 1.0) -> Record:
    rng = np.random.default_rng(seed)
    u = amplitude * np.repeat(rng.standard_normal(40), 10)
    y = scipy.signal.lfilter([0.1], [1, -0.9], u) + 0.01 * rng.standard_normal(400)
    return Record(np.asarray(y) + 3, 0.1, u=u, name=f"run {seed}")


STILL, MOVED, TEST = driven(0, 0.0), driven(1), driven(2)


@pytest.fixture(scope="module")
def linear() -> sb.Linear:
    return sb.Linear().fit(STILL, MOVED)


def test_baselines_learn_from_all_records(linear: sb.Linear) -> None:
    found = compare(STILL, ["mean"], SETUP, others=[MOVED], tests=[TEST])
    (mean,) = found.fits["mean"]
    both = np.concatenate([STILL.y[:300], MOVED.y]).mean()
    assert mean.tests[0].y[0, 0] == pytest.approx(both)
    y = linear.predict(390, TEST[:10], **known_after(TEST, 10), other_record=True).y
    assert rmse(np.asarray(y), TEST.y[10:]) < 0.1 * found.errors(mean).tests[0]


@pytest.mark.filterwarnings("ignore:output y is beyond its range")
def test_an_input_within_the_range_of_any_training_record_is_not_warned_of(
    linear: sb.Linear,
) -> None:
    assert not linear.predict(20, MOVED[:300], **known_after(MOVED, 300)).warnings
    with pytest.warns(ExtrapolationWarning, match="input u"):
        sb.Linear().fit(STILL).predict(20, MOVED[:300], **known_after(MOVED, 300))


def test_what_depends_on_the_time_says_that_it_knows_but_one_record() -> None:
    found = compare(STILL, ["seasonal-naive", "mean"], SETUP, others=[MOVED])
    assert "fitted to the first record only" in found.table["note"]["seasonal-naive"]
    assert "first record" not in found.table["note"]["mean"]
    assert "includes 1 more record(s), none held out" in of_comparison(found).title


def test_a_network_stands_on_a_linear_model_of_all_records(linear: sb.Linear) -> None:
    model = sb.Residual(sb.Linear(), sb.GRU(3), settings=SHORT).fit(STILL, MOVED)
    known: Any = {"history": TEST[:50], "u": known_after(TEST, 50)["u"], "other_record": True}
    expected = linear.predict(30, **known).y
    slow = model.predict(30, **known).components["linear"]
    np.testing.assert_allclose(slow, np.reshape(expected, slow.shape))


def test_records_of_one_run_say_what_the_whole_of_it_says() -> None:
    """Each part has an initial state of its own."""
    u = np.random.default_rng(0).standard_normal((600, 1))
    y = scipy.signal.lfilter([0.3, 0.1], [1, -1.5, 0.7], u, axis=0)
    found = identified([(y[:200], u[:200]), (y[200:400], u[200:400]), (y[400:], u[400:])])
    np.testing.assert_allclose(found.simulate(u), y, atol=1e-6)


def test_a_constant_record_needs_no_band_where_no_method_has_one() -> None:
    constant = Record(np.full(200, 7.0), 0.1, u=TEST.u[:200] if TEST.u is not None else None)
    found = sb.compare(constant, 150, ["linear", "mean"])
    for fits in found.fits.values():
        np.testing.assert_allclose(fits[0].ahead, 7.0)
    assert found.plan.bands == Bands()


def test_a_method_that_cannot_be_fitted_does_not_take_the_others_along() -> None:
    constant = Record(np.full(200, 7.0), 0.1)
    methods = [sb.Split(sb.GRU(2), sb.GRU(2), settings=SHORT), sb.Mean()]
    found = sb.compare(constant, 150, methods, seeds=1)
    assert found.recommended == "mean"
    assert "there is no band to split off" in found.table["note"]["split-gru"]
    with pytest.raises(ValueError, match="no band to split off"):
        sb.compare(constant, 150, methods[:1], seeds=1)


def test_windows_that_nobody_chose_fit_into_the_shortest_record() -> None:
    more = [MOVED[:60]]
    result = sb.compare(STILL, 300, ["gru"], others=more, settings={"epochs": 1}, seeds=1)
    assert result.plan.settings.window == 60
    assert [*result.fits] == ["gru"]
    network = sb.Single(sb.StateSpace(2, 2), settings=SHORT)
    tried = {c.settings.window for c in candidates(network, False, STILL, more, 0)}
    assert max(tried) <= 60
    with pytest.raises(ValueError, match="window must fit into the training record run 1 of 60 sa"):
        sb.Single(sb.GRU(2), settings=replace(SHORT, window=61)).fit(STILL, *more)
