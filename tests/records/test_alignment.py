"""Signals are put together by their time stamps; the oracles are signals known at any time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband import Record, read
from splitband.records import Grid, aligned, resampled
from splitband.records.alignment import reach
from tests.records.support import SAMPLES, signal, times, write

DT = 0.1


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_time_stamps_go_through_slices_and_replacements() -> None:
    record = Record(np.arange(50.0), DT, start=20)
    np.testing.assert_allclose(record.time, times(20, samples=50))
    part = replace(record[10:40][5:-1], name="part")
    assert part.start == pytest.approx(21.5)
    np.testing.assert_array_equal(part.stamps, np.round(times(21.5, samples=24), 9))
    assert record[-3:].start == pytest.approx(24.7)
    assert Record(np.arange(5.0), DT)[2:].start is None


def test_dates_go_through_slices_and_time_counts_from_the_first() -> None:
    record = Record(np.arange(50.0), 0.25, start=pd.Timestamp("2024-02-29 23:59:59", tz="UTC"))
    part = record[6:]
    expected = pd.date_range("2024-03-01 00:00:00.5", periods=44, freq="250ms", tz="UTC")
    assert part.start == expected[0]
    assert part.time[0] == 0
    assert list(part.stamps) == list(expected)


def test_rows_do_not_drift_away_from_the_time_stamps_over_many_gaps() -> None:
    """Each time the logger starts again 2.4 samples later; rounded one by one, 8 samples by now."""
    stretches = [times(20 * DT * i + 1.4 * DT * i, samples=20) for i in range(21)]
    time = np.concatenate(stretches)
    found = read(write(Path("r.csv"), time, y=time), gaps="mask")
    seen = found.complete
    assert seen.sum() == len(time)
    assert np.abs(found.time[seen] - found.y[seen, 0]).max() <= 0.5 * DT + 1e-6


def test_stamps_that_wander_from_an_even_step_by_more_than_half_a_sample_are_refused() -> None:
    step = DT * (1 + 0.009 * np.sin(2 * np.pi * np.arange(2000) / 2000))
    write(Path("r.csv"), np.cumsum(step), y=np.cumsum(step))
    with pytest.raises(ValueError, match=r"wander by 2\.9 samples from an even step of 0\.1 s"):
        read("r.csv")


@pytest.mark.parametrize(
    ("start", "step", "note"),
    [
        (-3.0, 0.1, ""),
        (-0.03, 0.1, "0.3 of a step beside the record's: interpolated"),
        (-1.0, 0.1009, "every 0.1009 s, interpolated at the record's times, every 0.1 s"),
        (-1.0, 0.0999999, ""),
        (-2.0, 0.02, "every 0.02 s, taken at the record's times, every 0.1 s"),
        (-1.0, 0.2, "every 0.2 s, interpolated"),
    ],
)
def test_a_signal_is_aligned_by_its_time_stamps(start: float, step: float, note: str) -> None:
    own = Grid(20 + start, step, 3000)
    values = signal(times(20 + start, step, 3000))[:, None]
    found = aligned("it", values, own, Grid(20.0, DT, SAMPLES))
    # A cubic spline's error is of the fourth order in the step times the frequency.
    np.testing.assert_allclose(found.values[:, 0], signal(times(20)), atol=2e-2 * max(step, DT))
    assert note in found.note
    assert bool(note) == bool(found.note)


def test_dates_are_aligned_across_time_zones() -> None:
    utc = pd.Timestamp("2024-05-01 08:00", tz="UTC")
    own = Grid(utc - pd.Timedelta(3, unit="s"), DT, 300)
    onto = Grid(pd.Timestamp("2024-05-01 10:00", tz="Europe/Berlin"), DT, 200)
    found = aligned("it", times(-3, samples=300)[:, None], own, onto)
    np.testing.assert_allclose(found.values[:, 0], times(samples=200), atol=1e-12)


def test_dates_with_and_without_a_time_zone_are_not_mixed() -> None:
    zoned = Grid(pd.Timestamp("2024-05-01 10:00", tz="UTC+02:00"), DT, 200)
    naive = Grid(pd.Timestamp("2024-05-01 10:00"), DT, 200)
    for own, onto in ((naive, zoned), (zoned, naive)):
        with pytest.raises(ValueError, match=r"^it: dates .* a time zone, or none: got ") as caught:
            aligned("it", times(samples=200)[:, None], own, onto)
        assert str(caught.value).count("2024-05-01 10:00:00") == 2
        assert "2024-05-01 10:00:00+02:00" in str(caught.value)


@pytest.mark.parametrize(
    ("own", "both"),
    [
        (Grid(22.0, DT, 500), ("20 s to 29.9 s", "22 s to 71.9 s")),
        (Grid(15.0, DT, 100), ("20 s to 29.9 s", "15 s to 24.9 s")),
        (Grid(20.06, DT, 500), ("20 s to 29.9 s", "20.06 s to 69.96 s")),
        (Grid(pd.Timestamp("2024-05-01"), DT, 500), ("20 s", "2024-05-01")),
    ],
)
def test_what_does_not_cover_the_times_is_refused_with_both_time_stamps(
    own: Grid, both: tuple[str, str]
) -> None:
    with pytest.raises(ValueError, match=r"it must cover|must all be dates") as caught:
        aligned("it", np.zeros((own.samples, 1)), own, Grid(20.0, DT, 100))
    assert all(stamp in str(caught.value) for stamp in both)


@pytest.mark.parametrize("start", [20.04, 19.97])
def test_half_a_sample_may_lack_at_the_ends(start: float) -> None:
    found = aligned("it", np.ones((100, 1)), Grid(start, DT, 100), Grid(20.0, DT, 100))
    np.testing.assert_allclose(found.values, 1)


def test_without_time_stamps_on_both_sides_they_begin_together() -> None:
    values = times(samples=50)[:, None]
    for own, onto, note in (
        (None, None, ""),
        (5.0, None, "it has time stamps, the record has none"),
        (None, 5.0, "the record has time stamps, it has none"),
    ):
        found = aligned("it", values, Grid(own, DT, 50), Grid(onto, DT, 30))
        np.testing.assert_array_equal(found.values, values[:30])
        assert note in found.note
        assert bool(note) == bool(found.note)


def test_inputs_are_interpolated_by_straight_lines() -> None:
    steps = np.repeat([0.0, 1.0], 10)[:, None]
    found = aligned("u", steps, Grid(0.0, 0.2, 20), Grid(0.0, DT, 39), np.array([False]))
    wanted = np.interp(times(samples=39), times(step=0.2, samples=20), steps[:, 0])
    np.testing.assert_allclose(found.values[:, 0], wanted, atol=1e-12)


@pytest.mark.parametrize(("start", "step"), [(0.0, 0.1), (-3.0, 0.1), (0.0, 0.0999), (-2.0, 0.25)])
def test_what_is_in_reach_is_covered_and_no_more(start: float, step: float) -> None:
    own = Grid(start, step, 100)
    count = reach(own, Grid(0.0, DT, 1))
    end = start + step * 99
    assert DT * (count - 1) <= end + 0.01 * DT < DT * count + 0.01 * DT
    aligned("it", np.zeros((100, 1)), own, Grid(0.0, DT, count))


def test_a_record_is_resampled_with_all_its_signals() -> None:
    time = times(20, 0.1009)
    measured = np.ones((SAMPLES, 1), dtype=np.bool_)
    measured[100] = False
    y = signal(time)
    record = Record(y, 0.1009, time, y, 2 * y, measured=measured, start=20.0)
    found = resampled(record, DT)
    assert (found.start, found.sampling_time) == (20.0, DT)
    assert found.time[-1] <= time[-1] < found.time[-1] + DT
    for values, factor in ((found.y, 1), (found.y_true, 1), (found.y_sim, 2)):
        np.testing.assert_allclose(values[:, 0], factor * signal(found.time), atol=1e-3)
    np.testing.assert_allclose(found.u[:, 0], found.time, atol=1e-9)
    lost = found.time[~found.complete]
    assert len(lost) == 2
    assert (np.abs(lost - time[100]) < 0.1009).all()
