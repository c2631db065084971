"""A record reports what preparing it has decided; a model takes and returns its units."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb
from splitband.forecasters.prediction import inputs_after

DT = 0.1
RNG = np.random.default_rng(0)
U = RNG.standard_normal(600) + 4.0
X = scipy.signal.lfilter([0.5], [1.0, -0.8], U - 4.0)


def record(start: object = 5.0) -> sb.Record:
    t = DT * np.arange(600)
    y = X + 100 + 0.5 * t + 0.01 * np.random.default_rng(1).standard_normal(600)
    return sb.Record(y, DT, u=U, start=start, name="rig")  # type: ignore[arg-type]


@pytest.mark.parametrize("start", [5.0, pd.Timestamp("2024-03-01 08:00")])
def test_lines_are_taken_from_another_record_too(start: object) -> None:
    raw = record(start)
    straight = raw.detrend(1)
    np.testing.assert_allclose(straight.y[:, 0], scipy.signal.detrend(raw.y[:, 0]), atol=1e-6)
    np.testing.assert_allclose(straight.u[:, 0], scipy.signal.detrend(U), atol=1e-6)
    later = raw[450:].like(straight[:400])
    np.testing.assert_allclose(later.y, straight.y[450:], atol=1e-9)
    assert later.reading == straight.reading
    with pytest.raises(ValueError, match="must have time stamps"):
        sb.Record(raw.y, DT, u=U).like(straight)


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
def test_a_model_of_a_detrended_record_predicts_one_of_another_mean(tmp_path: Path) -> None:
    """The units of answers are those of the training record, and its levels are arguments."""
    whole = sb.Record(X + 100, DT, u=U, name="rig", columns=("tank",), inputs=("flow",))
    train = whole[:400].detrend()
    assert train.reading.levels == pytest.approx(
        {"tank": X[:400].mean() + 100, "flow": U[:400].mean()}
    )
    sb.Linear().fit(train).save(tmp_path / "model")
    model = sb.load(tmp_path / "model")
    u = U + 3.0
    y = scipy.signal.lfilter([0.5], [1.0, -0.8], u - 4.0) + 100
    other = sb.Record(y, DT, u=u, columns=("tank",), inputs=("flow",))[100:]
    reading = model.fitted.record.reading
    given = other.detrend(levels=reading.levels)
    np.testing.assert_array_equal(given.y, other.like(model.fitted.record).y)
    np.testing.assert_array_equal(given.y[:, 0], other.y[:, 0] - reading.levels["tank"])
    found = model.predict(300, given[:100], u=given.u[100:], other_record=True)
    np.testing.assert_allclose(found.y, given.y[100:400], atol=0.01)
    own = other.detrend()
    said = r"history must be prepared like .*, tank \(minus 99.9.*, got {}; Record.like does"
    for history, units in (other, "as it was measured"), (own, r"tank \(minus 107.*"):
        with pytest.raises(ValueError, match=said.format(units)):
            model.predict(300, history[:100], u=u[200:], other_record=True)
    with pytest.raises(ValueError, match=r"must be given as it was measured, .* got tank"):
        own.like(model.fitted.record)
    with pytest.raises(ValueError, match="another record must be prepared like"):
        sb.Linear().fit(train, other)


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
def test_limits_of_one_record_hold_for_another() -> None:
    y = X.copy()
    y[50], y[420] = 500.0, -500.0
    raw = sb.Record(y, DT, u=U)
    clipped = raw[:400].clip_outliers(6)
    middle = np.median(y[:400])
    reach = 6 * scipy.stats.median_abs_deviation(y[:400], scale=1 / 1.4826)
    assert clipped.reading.limits["y"] == pytest.approx((middle - reach, middle + reach))
    assert clipped.y.max() == pytest.approx(middle + reach)
    np.testing.assert_array_equal(np.delete(clipped.y[:, 0], 50), np.delete(y[:400], 50))
    for other in (raw.like(clipped), raw.clip_outliers(limits=clipped.reading.limits)):
        assert other.y[420, 0] == pytest.approx(middle - reach)
        assert sb.Persistence().fit(clipped).predict(1, other[:421], u=U[421:]).y[0, 0] < 0


def test_a_longer_step_is_the_mean_of_the_samples_since_the_last_one() -> None:
    raw = record()[:599]
    coarse = raw.resample(0.5)
    assert (len(coarse), coarse.sampling_time, coarse.reading.step) == (119, 0.5, 0.1)
    np.testing.assert_allclose(coarse.y[-1], raw.y[-5:].mean(axis=0))
    assert coarse.start == pytest.approx(raw.time[4 + 4])
    assert coarse.time[-1] == pytest.approx(raw.time[-1])
    model = sb.Mean().fit(coarse)
    with pytest.raises(ValueError, match=r"every 0.5 s, got every 0.1 s; Record.like does"):
        model.predict(3, raw[:300], u=U[:3])
    found = model.predict(3, raw[:300].like(coarse), u=U[:3])
    assert np.diff(found.time) == pytest.approx([0.5, 0.5])
    assert found.time[0] == pytest.approx(raw.time[299] + 0.5)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (lambda r: r.resample(0.25), "sampling_time must be a whole multiple of 0.1 s, got 0.25"),
        (lambda r: r.detrend(2), "order must be 0 .* or 1"),
        (lambda r: sb.Record(r.y, DT).detrend(1), "must have time stamps"),
        (lambda r: r.detrend().resample(0.5), "resample must come once, in the order unwrap, "),
        (lambda r: r.detrend().detrend(), "detrend must come once, .* got it after detrend"),
        (lambda r: r.clip_outliers(0), "deviations must be above 0"),
        (lambda r: r.clip_outliers(limits={"y": (3, 1)}), "limits of 'y' must be lowest and"),
        (lambda r: r.clip_outliers(limits={"y": 3}), "limits of 'y' must be lowest and"),
        (lambda r: r.detrend(levels={"x": 1}), "levels must name one of y, u, got x"),
        (lambda r: r.detrend(levels={"y": "much"}), "levels must be numbers"),
        (lambda r: r.detrend(levels=[1, 2]), "levels must give values by name"),
        (lambda r: replace(r, columns=["a"]).like(replace(r, columns=["b"]).detrend()), "got a"),
        (lambda r: r.detrend(1, levels={"y": 1}), "order must be left out where levels are given"),
    ],
)
def test_what_cannot_be_is_named(asked: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        asked(record())  # type: ignore[operator]


def test_planned_inputs_without_names_are_detrended_too() -> None:
    past = replace(record(), inputs=("pump",)).detrend()
    coming = sb.Record(U[:20], DT, u=U[:20], start=past.grid.after(1).start)
    np.testing.assert_allclose(
        inputs_after(past, coming, 10, "plan")[:10, 0], U[:10] - U.mean(), atol=1e-9
    )


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
