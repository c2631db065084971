"""A stream says what `predict` says, from any origin."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.forecasters.prediction import ForecastContext
from splitband.runtime.arrays import Array
from tests.streams import BANDS, SHORT, WITH_INPUTS, WITHOUT, driven, fitted, free, rows

pytestmark = pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")


def forecast(forecaster: sb.Forecaster, history: sb.Record, record: sb.Record, steps: int) -> Array:
    """`predict` from the end of a history within a record; of one more step, for its slopes."""
    n = len(history)
    u = None if record.u is None else record.u[n : n + steps + 1]
    y_sim = None if record.y_sim is None else record.y_sim[n : n + steps + 1]
    return forecaster.predict(steps + 1, history, u, y_sim).y[:steps]


@pytest.fixture
def usual_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """A linear model then expects of an initial state what it was in training, in `predict` too."""
    monkeypatch.setattr("splitband.linear.kalman._SURPRISING", 1e9)


@pytest.mark.usefixtures("usual_prior")
@pytest.mark.parametrize("name", [*WITH_INPUTS, *(f"{name}, no inputs" for name in WITHOUT)])
def test_a_stream_says_what_predict_says(name: str) -> None:
    forecaster, record = fitted(name)
    scale = np.std(record.y)

    # From the training record on.
    stream = forecaster.stream()
    at = rows(record, stream)
    ahead = forecaster.predict(
        31,
        u=None if record.u is None else record.u[150:181],
        y_sim=None if record.y_sim is None else record.y_sim[150:181],
    ).y
    found = np.stack([stream.step(**at(n)) for n in range(150, 180)])
    assert np.abs(found - ahead[:30]).max() < 1e-9 * scale
    if "linear" in name:  # after its training record its state is that of the fit
        return

    # Measured, then predicted, from origins within and after gaps, in whole or of a channel.
    y = record.y.copy()
    y[200:210] = np.nan
    if record.ny > 1:
        y[165:175, 1] = y[212, 0] = np.nan
    stream = forecaster.stream(record[:155])
    for n in range(155, 240):
        if n in (190, 205, 215, 239):
            gaps = replace(record[:n], measured=~np.isnan(y[:n]))
            what_if = stream.copy()
            found = np.stack([what_if.step(**at(m)) for m in range(n, n + 15)])
            assert np.abs(found - forecast(forecaster, gaps, record, 15)).max() < 1e-9 * scale
            again = np.stack([stream.copy().step(**at(n))])
            np.testing.assert_array_equal(found[:1], again)
        stream.observe(y[n], **at(n))


@pytest.mark.usefixtures("usual_prior")
@pytest.mark.parametrize("gaps", [False, True])
def test_the_filter_of_a_linear_model_finds_what_predict_estimates(gaps: bool) -> None:
    """In another record, also of a channel that is missing for a while."""
    model, record = fitted("linear")
    y = record.y.copy()
    y[180:186, 0] = np.nan if gaps else y[180:186, 0]
    other = replace(record, measured=~np.isnan(y))[160:]
    coming = record.u[220:240]
    wanted = model.predict(20, other[:60], coming, other_record=True).y
    for begin in (2, 9, 30):
        stream = model.stream(other[:begin], other_record=True)
        for n in range(begin, 60):
            stream.observe(y[160 + n], record.u[160 + n])
        found = np.stack([stream.step(u) for u in coming])
        assert np.abs(found - wanted).max() < 1e-9 * np.std(record.y)


def test_a_network_warms_up_on_an_output_that_is_seldom_measured() -> None:
    """The samples between are its own predictions, of which later ones are better."""
    time = np.arange(400)
    u = np.repeat(np.random.default_rng(0).normal(size=40), 10)
    y = scipy.signal.lfilter([0.0, 0.1], [1.0, -0.9], u)
    settings = sb.TrainingSettings.paper(window=60, warmup=20, epochs=30)
    model = sb.Single(sb.StateSpace(3, 4), settings).fit(sb.Record(y[:300], 0.1, u=u[:300]))
    seldom = np.where(time % 10 == 0, y, np.nan)
    history = sb.Record.with_gaps(seldom[:391], 0.1, u=u[:391])
    found = model.predict(9, history, u[391:]).y[:, 0]
    whole = model.predict(9, sb.Record(y[:391], 0.1, u=u[:391]), u[391:]).y[:, 0]
    assert np.abs(found - whole).max() < 0.1 * np.std(y)
    # An output that begins with the record is held before its first sample.
    late = sb.Record.with_gaps(np.where(time[:30] < 12, np.nan, y[:30]), 0.1, u=u[:30])
    assert np.isfinite(model.predict(9, late, u[30:]).y).all()


@pytest.mark.parametrize("name", ["gru", "gru, no inputs", "filtered", "filtered, no inputs"])
def test_a_stream_goes_on_from_a_history_that_ends_in_a_gap(name: str) -> None:
    forecaster, record = fitted(name)
    missing = np.arange(190)[:, None] >= 185
    history = replace(record[:190], measured=~np.repeat(missing, record.ny, axis=1))
    longer = replace(history, y_sim=record.y_sim[:191])  # of the slope, which needs the next one
    stream = forecaster.stream(longer)
    at = rows(record, stream)
    found = np.stack([stream.step(**at(n)) for n in range(190, 205)])
    assert np.abs(found - forecast(forecaster, history, record, 15)).max() < 1e-9 * record.y.std()
    if name == "filtered, no inputs":
        with pytest.raises(ValueError, match=r"y_sim.*of the sample after its end.*in a gap"):
            forecaster.stream(history)


def test_a_linear_model_finds_its_state_in_another_record() -> None:
    """Also where the history is shorter than what an input acts late by, or twice that."""
    record = driven(channels=1)
    forecaster = sb.Linear().fit(record[:150])
    assert max(forecaster.delays) == 6
    for samples in (4, 9, 40):
        other = record[170 : 170 + samples]
        stream = forecaster.stream(other, other_record=True)
        coming = record.u[170 + samples : 190 + samples]
        found = np.stack([stream.step(u) for u in coming])
        wanted = forecaster.predict(20, other, coming, other_record=True).y
        assert np.abs(found - wanted).max() < 1e-9 * np.std(record.y)


class Twice(sb.Forecaster):
    """A forecaster of a user's own: twice the last sample."""

    name = "twice"

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.tile(2 * known.y[-1], (known.steps, 1))


def test_what_has_no_step_form_predicts_and_is_named() -> None:
    record = free()
    # The output is filtered forwards and backwards: a forecast is that of its own length.
    split = sb.Split(sb.GRU(4), sb.GRU(4), BANDS, filter_output=True, settings=SHORT)
    late = sb.Calibrated(sb.Function(np.sin), terms=["delay"])
    nested = sb.Residual(sb.Single(sb.GRU(3), SHORT), sb.GRU(3), settings=SHORT)
    for model, said in (
        (Twice(), "twice has no step form"),
        (split, "split-gru-hp cannot be stepped"),
        (late, r"simulator-delay cannot be stepped.*gain and offset alone"),
        (nested, r"residual-gru-gru cannot be stepped: its base is a network"),
    ):
        assert np.isfinite(model.fit(record[:150]).predict(3).y).all()
        with pytest.raises(ValueError, match=said):
            model.stream()


def test_a_stream_between_two_samples_repeats_the_period_that_predict_does() -> None:
    """Half a sample after the training record's, however many samples have been seen."""
    t = np.arange(120)
    record = sb.Record(np.sin(2 * np.pi * t / 12) + (t % 12 == 0), 1.0, start=0.0)
    model = sb.SeasonalNaive().fit(record)
    for samples in (30, 31):
        for begin in (0.5, 1.5):
            history = sb.Record(record.y[:samples], 1.0, start=begin)
            stream = model.stream(history)
            found = np.stack([stream.step() for _ in range(5)])
            np.testing.assert_allclose(found, model.predict(5, history).y)


def test_what_a_stream_refuses() -> None:
    record = driven()
    model = sb.Filtered(None, sb.GRU(3), BANDS, settings=SHORT).fit(record[:150])
    stream = model.stream(record[:10])  # the samples before it are estimated
    given = {"u": [0.0, 0.0], "y_sim": [0.0, 0.0]}
    for changed, message in (
        ({"u": None}, r"u must be given at every sample"),
        ({"y_sim": None}, r"y_sim must be given at every sample"),
        ({"u": [0.0]}, r"u must have the shape \(2,\), got \(1,\)"),
        ({"u": [0.0, np.nan]}, r"u must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            stream.observe([0.0, 0.0], **(given | changed))
    short = replace(record[:10], measured=np.arange(20).reshape(10, 2) != 5)
    with pytest.raises(ValueError, match="20 samples for filtered-gru to warm up on"):
        model.stream(short)
    with pytest.raises(ValueError, match="u must be left out"):
        sb.Mean().fit(free()).stream().step(u=1.0)
    never = replace(record[:10], measured=np.array([[True, False]] * 10))
    held = sb.Persistence().fit(record[:150]).stream(never)
    with pytest.raises(ValueError, match="one measured sample"):
        held.step([0.0, 0.0])
    held.observe([np.nan, 2.0], [0.0, 0.0])
    np.testing.assert_array_equal(held.step([0.0, 0.0]), [record.y[9, 0], 2.0])
