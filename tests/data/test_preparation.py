"""What is done to a record is remembered by its model, done to a history, undone on predictions."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb
from splitband.forecasters.prediction import ForecastContext

DT = 0.1
RNG = np.random.default_rng(0)
U = RNG.standard_normal(600) + 4.0
X = scipy.signal.lfilter([0.5], [1.0, -0.8], U - 4.0)


def record(start: object = 5.0) -> sb.Record:
    t = DT * np.arange(600)
    y = X + 100 + 0.5 * t + 0.01 * np.random.default_rng(1).standard_normal(600)
    return sb.Record(y, DT, u=U, start=start, name="rig")  # type: ignore[arg-type]


@pytest.mark.parametrize("start", [5.0, pd.Timestamp("2024-03-01 08:00")])
def test_a_trend_is_taken_from_a_history_and_given_back_to_the_prediction(start: object) -> None:
    raw = record(start)
    straight = raw.detrend(1)
    np.testing.assert_allclose(straight.y[:, 0], scipy.signal.detrend(raw.y[:, 0]), atol=1e-6)
    assert straight.u is not None
    np.testing.assert_allclose(straight.u[:, 0], scipy.signal.detrend(U), atol=1e-6)
    model = sb.Linear().fit(straight[:400])
    found = model.predict(100, raw[:450], u=U[450:550])
    own = model.predict(100, straight[:450], u=straight.u[450:])
    trend = raw.y[450:550] - straight.y[450:550]
    np.testing.assert_allclose(found.y, own.y + trend, atol=1e-6)
    assert sb.fit_percent(raw.y[450:550], found.y)[0] > 95


class WithTrend(sb.Forecaster):
    """Has a component that is called like what the preparation adds."""

    name = "with-trend"

    def extrapolate(self, known: ForecastContext) -> dict[str, np.ndarray]:
        ones = np.ones((known.steps, 1))
        return {"trend": 2 * ones, "season": 3 * ones}


def test_the_components_add_up_where_one_is_called_trend() -> None:
    raw = record()
    found = WithTrend().fit(raw[:400].detrend()).predict(4, raw[:400], u=U[400:])
    np.testing.assert_allclose(sum(found.components.values()), found.y)


def test_the_saved_model_remembers_it(tmp_path: object) -> None:
    raw = record()
    model = sb.Persistence().fit(raw.detrend(1).clip_outliers()[:400])
    model.save(f"{tmp_path}/model")
    loaded = sb.load(f"{tmp_path}/model")
    expected = model.predict(50, raw[:450], u=U[450:], level=0.9)
    found = loaded.predict(50, raw[:450], u=U[450:])
    np.testing.assert_allclose(found.y, expected.y)
    assert expected.lower is not None
    assert (expected.lower < expected.y).all()


@pytest.mark.filterwarnings("ignore:output y is beyond its range")
def test_outliers_are_limited_in_a_history_too() -> None:
    y = X.copy()
    y[50], y[420] = 500.0, -500.0
    raw = sb.Record(y, DT, u=U)
    clipped = raw.clip_outliers(6)
    middle = np.median(y)
    reach = 6 * scipy.stats.median_abs_deviation(y, scale=1 / 1.4826)
    assert clipped.y.max() == pytest.approx(middle + reach)
    np.testing.assert_array_equal(np.delete(clipped.y[:, 0], [50, 420]), np.delete(y, [50, 420]))
    model = sb.Persistence().fit(clipped[:400])
    assert model.predict(1, raw[:421], u=U[421:]).y[0, 0] == pytest.approx(middle - reach)


def test_a_longer_step_is_the_mean_of_the_samples_since_the_last_one() -> None:
    raw = record()[:599]
    coarse = raw.resample(0.5)
    assert (len(coarse), coarse.sampling_time) == (119, 0.5)
    np.testing.assert_allclose(coarse.y[-1], raw.y[-5:].mean(axis=0))
    assert coarse.start == pytest.approx(raw.time[4 + 4])
    assert coarse.time[-1] == pytest.approx(raw.time[-1])
    model = sb.Mean().fit(coarse)
    found = model.predict(3, raw[:300], u=U[:3])
    assert np.diff(found.time) == pytest.approx([0.5, 0.5])
    assert found.time[0] == pytest.approx(raw.time[299] + 0.5)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (lambda r: r.resample(0.25), "sampling_time must be a whole multiple of 0.1 s, got 0.25"),
        (lambda r: r.detrend(2), "order must be 0 .* or 1"),
        (lambda r: sb.Record(r.y, DT).detrend(1), "without time stamps"),
        (lambda r: r.detrend(1).resample(0.5), "must be changed before detrend"),
        (lambda r: sb.Record(r.y, DT, u=r.u).prepared_as(r.detrend(1)), "must have time stamps"),
        (lambda r: r.clip_outliers(0), "deviations must be above 0"),
        (lambda r: r.detrend().prepared_as(r), "must be prepared like rig, or not at all"),
        (lambda r: sb.Mean().fit(r.detrend(), r), "must be prepared like the training record"),
    ],
)
def test_what_cannot_be_is_named(asked: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        asked(record())  # type: ignore[operator]


def test_a_frame_becomes_a_record_and_comes_back() -> None:
    frame = pd.DataFrame({"time": DT * np.arange(600), "force": U, "x (m)": X})
    found = sb.read(frame, inputs=["force"])
    assert (found.columns, found.inputs, found.units) == (("x (m)",), ("force",), ("m",))
    pd.testing.assert_frame_equal(found.to_frame(), frame)
    dated = frame.drop(columns="time").set_index(pd.date_range("2024", periods=600, freq="100ms"))
    again = sb.read(dated, inputs="force")
    assert again.start == pd.Timestamp("2024")
    with pytest.raises(ValueError, match="DataFrame: column 'y' is unknown"):
        sb.read(frame, columns="y")


def test_predictions_show_themselves_in_notebooks() -> None:
    prediction = sb.Mean().fit(record()).predict(5, u=U[:5])
    assert "<table" in prediction._repr_html_()
    assert "<Prediction of y: 65 s to 65.4 s" in repr(prediction)
