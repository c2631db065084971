"""A forecast begins with the state that the history tells, of whichever run it is."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband as sb
from benchmarks import kinds as records
from splitband import Record, TrainingSettings
from splitband.metrics import ExtrapolationWarning, rmse, spread
from tests.streams import fitted
from tests.support import known_after

STEPS, BEGUN = 300, 200


def run(seed: int, begin: float, start: float | None = None) -> Record:
    """Of a slow pole, from a state of its own."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 0.5, 1.0], 60), 10)
    y = np.full(600, begin)
    for n in range(1, 600):
        y[n] = 0.995 * y[n - 1] + 0.05 * u[n]
    return Record(y + 0.01 * rng.standard_normal(600), 0.1, u=u, y_true=y, start=start)


@pytest.fixture(scope="module")
def linear() -> sb.Linear:
    return sb.Linear().fit(run(0, 0.0, start=0.0))


@pytest.mark.parametrize(
    ("start", "samples"), [(None, 3), (0.0, 30), (35.0, BEGUN), (1e6, 3), (None, BEGUN)]
)
def test_the_state_of_another_run_is_that_of_its_history(
    linear: sb.Linear, samples: int, start: float | None
) -> None:
    other = run(1, -1.5, start)
    for other_record in (False, True):
        y = linear.predict(
            STEPS, other[:samples], **known_after(other, samples), other_record=other_record
        ).y
        assert rmse(np.asarray(y), other.truth[samples : samples + STEPS]) < 0.02


def test_so_it_is_for_a_network_on_a_linear_model() -> None:
    model = sb.Residual(sb.Linear(), sb.GRU(3), settings=TrainingSettings.paper(40, 10, 1))
    model.fit(run(0, 0.0))
    other = run(1, 4.0)
    slow = model.predict(STEPS, other[:BEGUN], **known_after(other, BEGUN)).components["linear"]
    assert rmse(slow, other.truth[BEGUN : BEGUN + STEPS]) < 0.02


@pytest.mark.parametrize(
    ("make", "at"),
    [(records.two_masses, 3), (records.two_masses, 600), (records.tanks, 10)],
)
def test_noise_does_not_move_the_state_of_the_training_record(make: Any, at: int) -> None:
    """From any origin in it the forecast is what the fit has found."""
    record = make(np.random.default_rng(0))
    model = sb.Linear().fit(record[:1200])
    scale = spread(record.truth)
    expected = rmse((model.model.simulate(record.u) / scale)[at:], (record.truth / scale)[at:])
    y = np.asarray(model.predict(len(record) - at, record[:at], **known_after(record, at)).y)
    found = rmse(y.reshape(-1, record.ny) / scale, (record.truth / scale)[at:])
    assert found <= 1.01 * expected


def test_a_few_samples_of_another_run_do_not_make_up_a_state() -> None:
    """Least squares alone has an error of 0.72 deviations here."""
    record = records.two_masses(np.random.default_rng(0))
    coming = known_after(record, 1200)
    model, scale = sb.Linear().fit(record[:1200]), spread(record.truth)
    y = np.asarray(model.predict(800, record[1195:1200], **coming, other_record=True).y)
    assert rmse(y / scale, record.truth[1200:] / scale) < 0.25


def cycle(phase: float, begin: float = 0.0, level: float = 0.0) -> Record:
    rng, t = np.random.default_rng(7), np.arange(300)
    y = level + np.exp(np.sin(2 * np.pi * t / 40 + phase)) + 0.02 * rng.standard_normal(300)
    return Record(y, 1.0, start=begin)


@pytest.mark.parametrize("make", [sb.Periodic, sb.Harmonic, sb.SeasonalNaive])
@pytest.mark.parametrize("other", [cycle(2.0), cycle(0.0, level=0.2)], ids=["phase", "level"])
def test_a_function_of_time_warns_of_a_history_that_it_disagrees_with(
    make: type[sb.Periodic], other: Record
) -> None:
    model = make().fit(cycle(0.0))
    with pytest.warns(ExtrapolationWarning, match="disagrees with the history"):
        found = model.predict(20, other[:120])
    assert found.doubts
    later = cycle(2 * np.pi * 300 / 40, begin=300.0)  # as the first one would go on
    for history in (None, cycle(0.0)[:120], later[:120], replace(later, start=300.0)[20:90]):
        assert not model.predict(20, history).doubts


@pytest.mark.parametrize("network", [False, True])
def test_recorded_output_has_to_cover_only_what_a_forecast_uses(
    network: bool, tmp_path: Path
) -> None:
    """That is the warm-up and what follows it, or without a network what follows the origin."""
    at = 20 + 0.1 * np.arange(400)
    record = Record(np.sin(at), 0.1, y_sim=0.9 * np.sin(at), start=20.0)
    hybrid = sb.Residual(sb.Calibrated(), sb.GRU(3), settings=TrainingSettings.paper(40, 10, 1))
    (hybrid if network else sb.Calibrated()).fit(record[:200]).save(tmp_path)
    used = 300 - 10 * network
    whole, part, short = (
        sb.load(tmp_path, sb.Recorded(0.9 * np.sin(at[begin:]), 0.1, at[begin]))
        for begin in (0, used - 2, used + 2)
    )
    expected = whole.predict(50, record[150:300])
    np.testing.assert_allclose(part.predict(50, record[150:300]).y, expected.y, atol=1e-6)
    with pytest.raises(ValueError, match=r"the exported trajectory must cover"):
        short.predict(50, record[150:300])


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
def test_a_history_with_few_measured_samples_is_said_to_be_short() -> None:
    """Before them nothing was measured, of one channel or of both: the rest is made up."""
    forecaster, record = fitted("gru")
    few = np.arange(60)[:, None] >= np.array([55, 55])
    for measured, said in (
        (few, "has 5 of the 20 samples of a warm-up"),
        (few | np.array([False, True]), None),
        (np.full((60, 1), True) & np.array([False, True]), "output y0 was not measured"),
    ):
        history = replace(record[100:160], measured=measured)
        found = forecaster.predict(5, history, record.u[160:165]).warnings
        assert [said in each for each in found] == [True] if said else not found
