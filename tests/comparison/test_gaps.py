"""Comparisons and trials of records with gaps."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from splitband import Record
from splitband.forecasters.held_out import Origin
from splitband.training import fit
from tests.signals import (
    DT,
    LENGTH,
    QUICK,
    SETUP,
    TRAIN,
    WARMUP,
    error_of,
    holed,
    record,
    with_gaps,
)
from tests.support import asked, compare, simulated, untrained, with_own_predictions

Array = npt.NDArray[np.float64]


def test_errors_and_coverage_do_not_depend_on_what_stands_in_for_later_gaps() -> None:
    methods = ["gru", "mean", "persistence", "seasonal-naive"]
    y = holed(holed(record(ny=2).y, 25, slice(60, 66)), TRAIN, slice(100, 110), channel=1)
    records = []
    for value in (0.0, 300.0):
        standing = np.where(np.arange(LENGTH) < TRAIN, 0.0, value)[:, None]
        known = np.isfinite(y)
        records.append(Record(np.where(known, y, standing), DT, measured=known))
    first, other = (compare(each, methods, SETUP) for each in records)
    trials = [each.require_trial() for each in (first, other)]
    for method in methods:
        a, b = first.fits[method][0], other.fits[method][0]
        np.testing.assert_array_equal(a.ahead, b.ahead)
        errors = first.errors(a)
        assert errors == other.errors(b)
        assert errors.total == pytest.approx(error_of(y[-len(a.from_start) :], a.from_start.y))
        assert errors.forecast == pytest.approx(error_of(y[TRAIN:], a.ahead))
        left = y[TRAIN:] - a.ahead
        half = trials[0].intervals[method].half_widths(len(left))
        inside = [abs(e) <= h for e, h in zip(left.flat, half.flat, strict=True) if not np.isnan(e)]
        for each, trial in zip(records, trials, strict=True):
            covered = trial.intervals[method].coverage(each.y_with_gaps[TRAIN:] - a.ahead)
            assert covered == pytest.approx(np.mean(inside))
    assert trials[0].errors == trials[1].errors
    assert trials[0].intervals == trials[1].intervals


def test_held_out_errors_count_what_was_measured() -> None:
    train = 80  # of which the last 20, 16, 12 and 8 are held out
    y = holed(record().y, 64, slice(70, 74))
    trial = compare(with_gaps(y), ["persistence"], replace(SETUP, train=train)).require_trial()
    last = {60: y[59], 64: y[63], 68: y[67], 72: y[69]}
    left = np.concatenate([y[start:train] - value for start, value in last.items()])
    assert trial.errors["persistence"] == pytest.approx((np.sqrt(np.nanmean(left**2)),))


def test_simulations_warm_up_on_their_own_predictions_in_gaps() -> None:
    y = holed(record().y, 4, TRAIN - 3, TRAIN + 20)
    r = with_gaps(y)
    model = untrained("gru", r, SETUP, 0)
    fit(model, r[:TRAIN], QUICK, seed=0)
    later = [TRAIN + 2, TRAIN + 20, TRAIN + 25]
    found = asked("gru", r, SETUP, later=later).forecasts
    filled = with_own_predictions(model, y, WARMUP)
    for at in (5 + WARMUP, TRAIN, *later):
        expected = simulated(model, filled[at - WARMUP : at], LENGTH - at)
        np.testing.assert_allclose(found[Origin(TRAIN, at)].y, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("y", "method", "words"),
    [
        (holed(record(ny=2).y, slice(TRAIN), channel=1), "mean", "the training part must have"),
        (holed(record(ny=2).y, slice(TRAIN, None), channel=1), "mean", "the predicted part must"),
        (holed(record(ny=2).y, slice(60, TRAIN), channel=1), "gru", "last quarter of the 90 train"),
        (holed(record().y, *range(5, TRAIN, 12)), "gru", "gaps of the 90 training samples, got 12"),
    ],
    ids=["training part", "predicted part", "held-out part", "no warm-up"],
)
def test_what_was_not_measured_where_it_is_needed_is_named(
    y: Array, method: str, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        compare(with_gaps(y), [method], SETUP)


def test_what_is_predicted_must_be_measured_even_if_the_truth_is_known() -> None:
    gone = holed(record().y, slice(TRAIN, None))
    with pytest.raises(ValueError, match="the predicted part must have a measured sample"):
        compare(replace(with_gaps(gone), y_true=record().y), ["mean"], SETUP)
