"""A stream says what `predict` says, from any origin."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband.forecasters.prediction import ForecastContext
from tests.streams import BANDS, SHORT, WITH_INPUTS, WITHOUT, driven, fitted, free, rows

Array = npt.NDArray[np.float64]

pytestmark = pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")


def forecast(forecaster: sb.Forecaster, history: sb.Record, record: sb.Record, steps: int) -> Array:
    """`predict` from the end of a history within a record; of one more step, for its slopes."""
    n = len(history)
    u = None if record.u is None else record.u[n : n + steps + 1]
    y_sim = None if record.y_sim is None else record.y_sim[n : n + steps + 1]
    return forecaster.predict(steps + 1, history, u, y_sim).y[:steps]


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
    other = stream.copy()
    found = np.stack([other.step(**at(n)) for n in range(150, 180)])
    assert np.abs(found - ahead[:30]).max() < 1e-9 * scale

    # Measured, then predicted, from two origins, the second after a gap.
    y = record.y.copy()
    for n in range(150, 190):
        stream.observe(y[n], **at(n))
    copied = stream.copy()
    found = np.stack([stream.step(**at(n)) for n in range(190, 200)])
    wanted = forecast(forecaster, record[:190], record, 10)
    assert np.abs(found - wanted).max() < 1e-9 * scale
    again = np.stack([copied.step(**at(n)) for n in range(190, 200)])
    np.testing.assert_array_equal(found, again)

    y[190:200] = np.nan
    for end in (205, 230):  # within a warm-up after the gap, and after one
        for n in range(200 if end == 205 else 205, end):
            stream.observe(y[n], **at(n))
        gaps = replace(record[:end], measured=~np.isnan(y[:end]))
        what_if = stream.copy()
        found = np.stack([what_if.step(**at(n)) for n in range(end, end + 15)])
        assert np.abs(found - forecast(forecaster, gaps, record, 15)).max() < 1e-9 * scale


def test_a_linear_model_finds_its_state_in_another_record() -> None:
    """Also where the history is shorter than what an input acts late by, or twice that."""
    record = driven(channels=1)
    assert record.u is not None
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


def test_what_has_no_form_sample_by_sample_is_asked() -> None:
    record = free()
    stream = Twice().fit(record).stream()
    stream.observe(1.5)
    assert stream.copy().step()[0] == stream.step()[0] == 3.0
    stream.observe(2.5)
    assert stream.step()[0] == 5.0
    # The output is filtered forwards and backwards: a forecast is that of its own length.
    split = sb.Split(sb.GRU(4), sb.GRU(4), BANDS, filter_output=True, settings=SHORT)
    stream = split.fit(record[:150]).stream()
    stream.step()
    assert stream.step() == pytest.approx(split.predict(2).y[1])


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
    stream = model.stream(record[:10])
    given = {"u": [0.0, 0.0], "y_sim": [0.0, 0.0]}
    for changed, message in (
        ({"u": None}, r"u must be given at every sample"),
        ({"y_sim": None}, r"y_sim must be given at every sample"),
        ({"u": [0.0]}, r"u must have the shape \(2,\), got \(1,\)"),
        ({"u": [0.0, np.nan]}, r"u must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            stream.observe([0.0, 0.0], **(given | changed))
    with pytest.raises(ValueError, match="20 measured sample"):
        stream.step(**given)
    with pytest.raises(ValueError, match="u must be left out"):
        sb.Mean().fit(free()).stream().step(u=1.0)
