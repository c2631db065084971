"""Records with gaps, and several records that train one model."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import scipy.optimize
import scipy.stats
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from splitband.evaluation.intervals import Interval
from splitband.forecasters.methods import FIXED, Setup, build, check
from torch import Tensor

from splitband import GRU, Progress, Settings, Trajectory, read
from splitband.baselines.harmonic import HarmonicRegression
from splitband.baselines.naive import LONGEST, Naive, recent
from splitband.baselines.periodic import PeriodicRegression
from splitband.baselines.seasonal import SeasonalNaive, _last_period
from splitband.cli.spectrum import _show_simulator
from splitband.evaluation.comparison import compare, run
from splitband.evaluation.selection import try_out
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import Sizes
from splitband.metrics import cumulative_rmse, leaves_range, nrmse, rmse, spread
from splitband.models import Model, Recurrent, Signals, Task
from splitband.models.saving import load
from splitband.simulators.calibration import Term, calibrate
from splitband.training import fit
from splitband.training.checkpoints import Checkpoint
from splitband.training.settings import MOST_BATCHES, STEPS
from splitband.training.windows import joined, places_in, select, windows
from tests.cli.test_cli import A, B, assert_fails, call, results, rms, written
from tests.data.test_data import iso, message, stamped, text_file
from tests.models.test_models import DT, LENGTH, QUICK, SETUP, TRAIN, WARMUP, record
from tests.training.test_training import parameters, seen_by_adam

Array = npt.NDArray[np.float64]
NAN = np.nan


def holed(y: Array, *rows: Any, channel: Any = slice(None)) -> Array:
    """A copy without the given rows."""
    y = y.copy()
    for row in rows:
        y[row, channel] = NAN
    return y


def with_gaps(y: Array, **others: Any) -> Trajectory:
    return Trajectory.with_gaps(y, DT, **others)


def standing_in(y: Array, value: float, **others: Any) -> Trajectory:
    """The record of `y`, with one value in all of its gaps."""
    known = np.isfinite(y)
    return Trajectory(np.where(known, y, value), DT, measured=known, **others)


# ---------------------------------------------------------------- the record

gappy = hnp.arrays(
    np.float64,
    st.tuples(st.integers(2, 20), st.integers(1, 3)),
    elements=st.one_of(st.integers(-50, 50).map(float), st.sampled_from([NAN, np.inf, -np.inf])),
)


@given(y=gappy, begin=st.integers(0, 8), samples=st.integers(2, 8))
def test_what_is_seen_is_what_is_finite(y: Array, begin: int, samples: int) -> None:
    y[begin % len(y)] = 1.0  # so that every channel has a value
    whole = with_gaps(y)
    expected = np.where(np.isfinite(y), y, NAN)
    np.testing.assert_array_equal(whole.seen, expected)
    np.testing.assert_array_equal(whole.truth, expected)
    assert whole.complete.tolist() == [all(map(np.isfinite, row)) for row in y]
    assert (whole.measured is None) == np.isfinite(y).all()
    assert (whole.y >= np.nanmin(expected, axis=0)).all()
    assert (whole.y <= np.nanmax(expected, axis=0)).all()
    begin = min(begin, len(y) - 2)
    part = whole[begin : begin + samples]
    np.testing.assert_array_equal(part.seen, expected[begin : begin + samples])


def test_straight_lines_and_held_ends_stand_in_for_gaps() -> None:
    y = np.array([NAN, 2.0, NAN, NAN, 8.0, np.inf])
    np.testing.assert_array_equal(with_gaps(y).y[:, 0], [2, 2, 4, 6, 8, 8])


def test_a_sample_whose_input_is_not_known_does_not_count_as_measured() -> None:
    y, u = (
        np.arange(10.0).reshape(5, 2),
        np.array([[1.0, 0], [NAN, 0], [3, 0], [3, np.inf], [3, 1]]),
    )
    found = with_gaps(holed(y, 4, channel=1), u=u)
    np.testing.assert_array_equal(
        found.seen, [[0, 1], [NAN, NAN], [NAN, NAN], [NAN, NAN], [NAN, NAN]]
    )  # fmt: skip
    np.testing.assert_array_equal(found.u, [[1, 0], [2, 0], [3, 0], [3, 0.5], [3, 1]])


def test_the_noise_free_signal_is_known_in_gaps_too() -> None:
    y = holed(np.arange(5.0)[:, None], 2)
    np.testing.assert_array_equal(with_gaps(y, y_true=np.ones(5)).truth, np.ones((5, 1)))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: with_gaps(np.full((5, 1), NAN)), "y must have a finite value in channel 0"),
        (lambda: with_gaps(holed(np.ones((5, 2)), slice(None), channel=1)), "in channel 1"),
        (lambda: with_gaps(np.ones(5), u=np.full(5, NAN)), "u must have a finite value"),
        (lambda: with_gaps(np.ones(5), u=np.ones(4)), "u must have as many samples as y"),
        (
            lambda: Trajectory(np.ones(5), DT, measured=np.ones((5, 2), np.bool_)),
            r"the shape of y, \(5, 1\): it is \(5, 2\)",
        ),
    ],
)
def test_records_without_anything_to_go_by_are_refused(
    make: Callable[[], object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        make()


# ---------------------------------------------------------------- reading


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "", "NA"])
def test_cells_without_a_number_are_gaps(tmp_path: Path, cell: str) -> None:
    path = text_file(tmp_path, f"t,a,b\n0.0,1,5\n0.1,{cell},6\n0.2,3,7\n0.3,5,8\n")
    found = read(path, gaps="mask")
    np.testing.assert_array_equal(found.seen, [[1, 5], [NAN, 6], [3, 7], [5, 8]])
    assert found.y[1, 0] == 2
    said = message(path)
    assert "column 'a' must be finite: 1 bad value" in said
    assert "row 1" in said
    assert "--gaps mask" in said


@pytest.mark.parametrize(
    ("name", "stamps", "step"),
    [
        ("t", [f"{0.25 * row:.2f}" for row in range(12)], 0.25),
        ("t [ms]", [f"{5000 + 4 * row}" for row in range(12)], 0.004),
        ("date", iso([60 * row for row in range(12)]), 60),
        ("date", iso([86400 * row for row in range(12)]), 86400),
    ],
)
def test_rows_missing_between_stamps_are_gaps(
    tmp_path: Path, name: str, stamps: Sequence[str], step: float
) -> None:
    missing = [3, 4, 9]
    kept = [row for row in range(12) if row not in missing]
    rows = "".join(f"{stamps[row]},{row},{100 - row}\n" for row in kept)
    path = text_file(tmp_path, f"{name},y,force\n{rows}")
    found = read(path, inputs="force", gaps="mask")
    assert found.sampling_time == pytest.approx(step, rel=1e-9)
    driven = [*missing, 5, 10]  # an input acts on the sample after it, too
    np.testing.assert_array_equal(found.seen, holed(np.arange(12.0)[:, None], *driven))
    np.testing.assert_allclose(found.y[:, 0], np.arange(12), rtol=1e-12)
    assert found.u is not None
    np.testing.assert_allclose(found.u[:, 0], 100 - np.arange(12), rtol=1e-12)
    said = message(path)
    assert "must be even" in said
    assert "at row 3" in said
    assert "--gaps mask" in said


def test_cells_and_rows_may_be_missing_from_one_file(tmp_path: Path) -> None:
    path = text_file(tmp_path, "t,y\n0,\n1,1\n4,nan\n5,5\n6,6\n7,7\n")
    found = read(path, gaps="mask")
    np.testing.assert_array_equal(found.seen[:, 0], [NAN, 1, NAN, NAN, NAN, 5, 6, 7])
    np.testing.assert_array_equal(found.y[:, 0], [1, 1, 2, 3, 4, 5, 6, 7])


def test_a_whole_record_reads_the_same_either_way(tmp_path: Path) -> None:
    path = stamped(tmp_path, [f"{0.1 * row:.1f}" for row in range(30)])
    masked, refused = read(path, gaps="mask"), read(path)
    np.testing.assert_array_equal(masked.y, refused.y)
    assert masked.sampling_time == refused.sampling_time
    assert masked.measured is None


def test_the_refusal_names_the_stretches(tmp_path: Path) -> None:
    cells = ["" if row in (3, 5, 6) else f"{row}" for row in range(9)]
    path = text_file(tmp_path, "t,y\n" + "".join(f"{i},{c}\n" for i, c in enumerate(cells)))
    said = message(path)
    assert "3 bad values, the first (nan) at row 3; rows 3, 5 to 6;" in said
    assert "--gaps mask" in said
    cells = ["" if row % 2 else f"{row}" for row in range(20)]
    path = text_file(tmp_path, "t,y\n" + "".join(f"{i},{c}\n" for i, c in enumerate(cells)))
    assert "rows 1, 3, 5, 7, 9, 11 and 4 more stretches;" in message(path)


@pytest.mark.parametrize("last", [100, 1e12, 1e100])
def test_a_stamp_far_away_is_refused_before_room_is_made_for_it(
    tmp_path: Path, last: float
) -> None:
    stamps: list[object] = [*range(9), f"{last:g}"]
    words = "must have a stamp for one row in ten at least"
    assert words in message(stamped(tmp_path, stamps), gaps="mask")
    assert len(read(stamped(tmp_path, [*range(9), 99]), gaps="mask")) == 100


@pytest.mark.parametrize("stamps", [[0, 1, 2, 2, 3, 5], [0, 1, 2, 1, 3, 5]])
def test_stamps_that_go_back_are_refused_with_gaps_too(
    tmp_path: Path, stamps: Sequence[object]
) -> None:
    assert "must increase" in message(stamped(tmp_path, stamps), gaps="mask")


def test_a_channel_without_any_value_is_refused(tmp_path: Path) -> None:
    path = text_file(tmp_path, "t,y,dead\n0,1,\n1,2,\n2,,\n3,4,\n")
    words = "must have a finite value in channel 1: it has none"
    assert words in message(path, columns=["y", "dead"], gaps="mask")
    assert words.replace("1", "0") in message(path, columns="y", inputs="dead", gaps="mask")
    path = text_file(tmp_path, "t,y,dead\n0,1,inf\n1,2,-inf\n")
    assert words in message(path, gaps="mask")


def test_a_word_is_no_gap(tmp_path: Path) -> None:
    path = text_file(tmp_path, "t,y\n0,1\n1,broken\n2,3\n")
    assert "row 1 holds 'broken'" in message(path, columns="y", gaps="mask")


@pytest.mark.parametrize("rate", [30, 60])
@pytest.mark.parametrize("missing", [1, 10, 100])
def test_rows_may_be_missing_between_rounded_stamps(
    tmp_path: Path, rate: int, missing: int
) -> None:
    kept = [row for row in range(400) if not 50 <= row < 50 + missing]
    rows = "".join(f"{row / rate:.3f},{row}\n" for row in kept)
    found = read(text_file(tmp_path, f"t,y\n{rows}"), gaps="mask")
    assert np.flatnonzero(~found.complete).tolist() == [*range(50, 50 + missing)]
    assert found.sampling_time == pytest.approx(1 / rate, rel=1e-4)


def test_coarse_stamps_of_a_whole_record_are_no_gaps(tmp_path: Path) -> None:
    path = stamped(tmp_path, [f"{row / 44:.2f}" for row in range(200)])
    assert len(read(path)) == 200
    assert read(path, gaps="mask").measured is None


# ---------------------------------------------------------------- windows


def starts_of(ys: Sequence[Array], window: int, warmup: int) -> list[int]:
    """Where windows begin by definition, the samples of all records counted through."""
    found, before = [], 0
    for y in ys:
        for start in range(len(y) - window + 1):
            warm = all(np.isfinite(y[start + n]).all() for n in range(warmup))
            something = any(np.isfinite(y[start + n]).any() for n in range(warmup, window))
            if warm and something:
                found.append(before + start)
        before += len(y)
    return found


@st.composite
def records_with_gaps(draw: st.DrawFn) -> tuple[list[Array], int, int]:
    """Some records of which each value tells record and sample, a window and a warm-up."""
    warmup = draw(st.integers(1, 4))
    window = warmup + draw(st.integers(1, 5))
    ny = draw(st.integers(1, 2))
    ys = []
    for i in range(draw(st.integers(1, 3))):
        length = window + draw(st.integers(0, 12))
        known = draw(hnp.arrays(np.bool_, (length, ny), elements=st.integers(0, 9).map(bool)))
        y = np.repeat(1000.0 * i + np.arange(length)[:, None], ny, axis=1)
        ys.append(np.where(known, y, NAN))
    return ys, window, warmup


@given(drawn=records_with_gaps())
def test_windows_begin_in_measured_samples_and_stay_in_their_record(
    drawn: tuple[list[Array], int, int],
) -> None:
    ys, window, warmup = drawn
    records = [standing_in(y, -7.0) for y in ys]
    expected = starts_of(ys, window, warmup)
    if not expected:
        with pytest.raises(ValueError, match=f"between the gaps .* got {warmup} samples"):
            places_in(records, window, warmup)
        return
    places = places_in(records, window, warmup)
    assert places.starts.tolist() == expected
    known = np.isfinite(np.concatenate(ys))
    assert (places.measured is None) == known.all()
    if places.measured is not None:
        np.testing.assert_array_equal(places.measured.numpy(), known)
    model = Recurrent(GRU(2, ys[0].shape[1]))
    task = joined([model.tasks(model.normalised(r))[0] for r in records])
    known_of_all, targets = windows(task, window, warmup)
    whole = np.concatenate([1000 * i + np.arange(len(y)) for i, y in enumerate(ys)])
    for start in expected:
        counted = whole[start] + np.arange(window)  # one record's samples, one after the other
        warm, rest = known_of_all.y[start].numpy(), targets[start].numpy()
        np.testing.assert_array_equal(warm, np.repeat(counted[:warmup, None], ys[0].shape[1], 1))
        for value, sample in zip(rest, counted[warmup:], strict=True):
            assert np.isin(value, [sample, -7.0]).all()


# ---------------------------------------------------------------- training

GAPS = (slice(30, 36), 70)


def fitted(
    records: Trajectory | Sequence[Trajectory], method: str = "gru", **changes: Any
) -> Model:
    one = records if isinstance(records, Trajectory) else records[0]
    model = build(method, one, SETUP, seed=2)
    fit(model, records, Settings(**{**vars(QUICK), "epochs": 3, **changes}), seed=2)
    return model


@pytest.mark.parametrize("channel", [slice(None), 1], ids=["both", "one"])
def test_what_stands_in_for_a_gap_moves_no_weight(channel: Any) -> None:
    r = record(ny=2, nu=1)[:TRAIN]
    y = holed(r.y, *GAPS, channel=channel)
    first, *others = (fitted(standing_in(y, value, u=r.u)) for value in (0.0, 2.0, -50.0))
    for other in others:
        assert torch.equal(parameters(other), parameters(first))
        assert torch.equal(other.y_mean, first.y_mean)
        assert torch.equal(other.y_std, first.y_std)
    without = fitted(Trajectory(np.where(np.isfinite(y), y, 2.0), DT, u=r.u))
    assert not torch.equal(parameters(without), parameters(first))


@pytest.mark.parametrize("several", [False, True])
def test_the_loss_counts_what_was_measured(several: bool) -> None:
    """Of a network that says nothing, it is the size of the samples that are there."""
    y = holed(holed(record(ny=2).y, *GAPS), 45, slice(100, 104), channel=0)
    ys = [y[:60], y[60:]] if several else [y]
    model = Recurrent(GRU(3, 2))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.zero_()
    window, warmup = 20, 5
    quiet = Settings(window, warmup, 2, 1, learning_rate=1e-30, normalize=False)
    history = fit(model, [with_gaps(each) for each in ys], quiet)
    whole = np.concatenate(ys)
    losses = [
        np.sqrt(np.nanmean(whole[start + warmup : start + window] ** 2))
        for start in starts_of(ys, window, warmup)
    ]
    assert history.losses["network"] == pytest.approx([np.mean(losses)] * 2, rel=1e-5)


def test_a_window_that_has_seen_nothing_yet_has_no_loss() -> None:
    """The free run grows: its first samples may all be in a gap."""
    y = holed(record().y[:30], slice(12, 20))
    history = fit(Recurrent(GRU(3, 1)), with_gaps(y), Settings(30, 12, 2, 4, growth=1.0))
    assert history.losses["network"][0] == 0
    assert 0 < history.losses["network"][1] < np.inf


@pytest.mark.parametrize("method", ["gru", "split-gru-conditioned", "residual-gru-conditioned"])
def test_a_record_by_itself_is_a_list_of_one(method: str) -> None:
    r = record()[:TRAIN]
    assert torch.equal(parameters(fitted(r, method)), parameters(fitted([r], method)))


def test_the_units_are_those_of_all_records() -> None:
    a, b = (holed(record(2, 1, seed).y, *GAPS, channel=seed) for seed in (0, 1))
    b = 3 * b + 5
    u = [np.arange(LENGTH) / 10, -np.ones(LENGTH)]
    model = Recurrent(GRU(3, 2, 1))
    model.adapt_to([with_gaps(a, u=u[0]), with_gaps(b[:100], u=u[1][:100])])
    for channel in range(2):
        seen = [v for y in (a, b[:100]) for v in y[:, channel] if np.isfinite(v)]
        # A gap has an input all the same.
        mean = sum(seen) / len(seen)
        deviation = np.sqrt(sum((v - mean) ** 2 for v in seen) / len(seen))
        assert float(model.y_mean[channel]) == pytest.approx(mean, rel=1e-12)
        assert float(model.y_std[channel]) == pytest.approx(deviation, rel=1e-12)
    both = [*u[0], *u[1][:100]]
    assert float(model.u_mean) == pytest.approx(np.mean(both), rel=1e-12)
    assert float(model.u_std) == pytest.approx(np.std(both), rel=1e-12)


@pytest.mark.parametrize("method", ["gru", "split-gru", "filtered-gru-conditioned"])
def test_two_records_have_the_windows_of_both(method: str) -> None:
    whole = record(nu=1)
    halves = [whole[:65], whole[65:]]
    model = build(method, whole, SETUP, seed=0)
    model.adapt_to(halves)
    window, warmup = QUICK.window, QUICK.warmup
    together = zip(*(model.tasks(model.normalised(half)) for half in halves), strict=True)
    starts = places_in(halves, window, warmup).starts
    assert len(starts) == sum(len(half) - window + 1 for half in halves)
    for tasks in together:
        known, target = windows(joined(tasks), window, warmup)
        alone = [windows(task, window, warmup) for task in tasks]
        found = select(known, starts)
        assert torch.equal(target[starts], torch.cat([of_one for _, of_one in alone]))
        for name in ("y", "u", "y_sim"):
            signals = [getattr(known_of_one, name) for known_of_one, _ in alone]
            assert torch.equal(getattr(found, name), torch.cat(signals))


def test_several_records_train_another_model_than_each_alone() -> None:
    a, b = record(seed=0)[:TRAIN], record(seed=1)[:TRAIN]
    both, alone = fitted([a, b]), fitted(a)
    assert not torch.equal(parameters(both), parameters(alone))
    found = run("gru", record(), SETUP, seed=0, more=[b])
    np.testing.assert_array_equal(
        found.forecast, compare(record(), ["gru"], SETUP, more=[b])["gru"][0].forecast
    )
    assert not np.array_equal(found.forecast, run("gru", record(), SETUP, seed=0).forecast)


def test_a_record_shorter_than_a_window_is_refused_with_its_length() -> None:
    with pytest.raises(ValueError, match="training record of 39 samples, got 40"):
        fitted([record()[:TRAIN], record()[:39]])
    fitted([record()[:TRAIN], record()[:40]])


def test_gaps_that_leave_no_warm_up_are_refused() -> None:
    y = holed(record().y, *range(5, LENGTH, 12))
    with pytest.raises(ValueError, match="between the gaps of the training record, got 12 samples"):
        fitted(with_gaps(y))
    fitted(with_gaps(y), warmup=11)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (record(2), r"record's 1 channel\(s\) and 0 input\(s\), got 2 and 0"),
        (record(1, 1), r"record's 1 channel\(s\) and 0 input\(s\), got 1 and 1"),
        (replace(record(), sampling_time=2 * DT), "every 0.1 s, got every 0.2 s"),
        (record()[:30], "of 30 samples, got 40"),
    ],
)
def test_other_records_must_be_of_the_same_kind(other: Trajectory, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check(record(), ["gru"], SETUP, [other])
    with pytest.raises(ValueError, match="are for networks, got mean"):
        check(record(), ["mean"], SETUP, [record()])


def test_a_network_without_a_simulator_trains_on_records_with_and_without_one() -> None:
    a = record()[:TRAIN]
    assert torch.equal(
        parameters(fitted([a, replace(a, y_sim=None, beyond=None)])), parameters(fitted([a, a]))
    )


def test_a_checkpoint_knows_all_records_and_their_gaps(tmp_path: Path) -> None:
    a, b, c = (record(seed=seed)[:TRAIN] for seed in range(3))
    measured = np.ones((TRAIN, 1), dtype=np.bool_)
    measured[-1] = False  # which no warm-up sees
    masked = replace(a, measured=measured)
    plain = replace(QUICK, normalize=False)
    checkpoint = Checkpoint(tmp_path / "training.safetensors")
    for records, epochs in (([a], 1), ([a], 0), ([masked], 1), ([a, b], 1), ([a, c], 1)):
        seen: list[Progress] = []
        fit(build("gru", a, SETUP, 0), records, plain, 0, seen.append, checkpoint)
        assert len(seen) == epochs


class _Watched(Recurrent):
    """Keeps the first samples of the windows in each batch."""

    def __init__(self) -> None:
        super().__init__(GRU(2, 1))
        self.batches: list[list[int]] = []

    def tasks(self, record: Signals) -> list[Task]:
        def watched(simulate: Callable[[Signals, int], Tensor], known: Signals, steps: int) -> Any:
            self.batches.append([round(float(y)) for y in known.y[:, 0, 0]])
            return simulate(known, steps)

        return [replace(t, simulate=partial(watched, t.simulate)) for t in super().tasks(record)]


def watched(most: int | None, epochs: int = 4) -> _Watched:
    torch.manual_seed(0)
    model = _Watched()
    count = Trajectory(np.arange(100.0), DT)
    few = Settings(20, 5, epochs, 10, 1e-4, normalize=False, most_batches=most)
    history = fit(model, count, few, seed=1)
    assert np.isfinite(history.losses["network"]).all()
    return model


def test_an_epoch_of_a_long_record_takes_other_windows_each_time() -> None:
    batches = watched(3).batches
    assert [len(batch) for batch in batches] == [10] * 12
    epochs = [[*chain(*batches[i : i + 3])] for i in range(0, 12, 3)]
    for taken in epochs:
        assert len(set(taken)) == 30
        assert set(taken) <= set(range(81))
    assert len({frozenset(taken) for taken in epochs}) == 4
    assert len({*chain(*epochs)}) > 50


def test_an_epoch_of_a_short_record_takes_every_window() -> None:
    for most in (None, 9, 1000):
        model = watched(most, epochs=2)
        assert len(model.batches) == 2 * 9
        for epoch in (model.batches[:9], model.batches[9:]):
            assert sorted(chain(*epoch)) == [*range(81)]
        assert torch.equal(parameters(model), parameters(watched(None, epochs=2)))


def test_the_loss_of_an_epoch_is_the_mean_of_the_windows_that_were_taken() -> None:
    """Each is 0.5 for a network that always says 0.5 too little."""
    model = Recurrent(GRU(2, 1))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.zero_()
    few = Settings(20, 5, 3, 10, learning_rate=1e-30, normalize=False, most_batches=2)
    history = fit(model, Trajectory(np.full(100, 0.5), DT), few)
    assert history.losses["network"] == pytest.approx([0.5] * 3, rel=1e-6)


def test_the_one_cycle_is_gone_through_once_by_the_steps_that_are_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rates = seen_by_adam(monkeypatch, lambda group: group["lr"])
    fitted(record()[:TRAIN], epochs=5, most_batches=2, one_cycle=True, learning_rate=0.01)
    schedule = Settings(learning_rate=0.01, one_cycle=True)
    assert rates == pytest.approx([schedule.rate(0, i / 10) for i in range(10)])


@pytest.mark.parametrize("samples", [100, 1000, 10_000, 1_000_000])
def test_the_default_recipe_takes_about_as_many_steps_of_any_record(samples: int) -> None:
    recipe = Settings.of(samples)
    whole = -(-(samples - recipe.window + 1) // recipe.batch_size)
    steps = recipe.epochs * min(whole, MOST_BATCHES)
    assert recipe.most_batches == min(whole, MOST_BATCHES)
    assert abs(steps - STEPS) <= 0.05 * STEPS


def test_no_batches_at_all_are_refused() -> None:
    with pytest.raises(ValueError, match="most_batches must be at least 1, got 0"):
        Settings(most_batches=0)


# ---------------------------------------------------------------- errors

with_missing = st.tuples(st.integers(1, 15), st.integers(1, 3)).flatmap(
    lambda shape: st.tuples(
        hnp.arrays(np.float64, shape, elements=st.floats(-1e3, 1e3)),
        hnp.arrays(np.float64, shape, elements=st.floats(-1e3, 1e3)),
        hnp.arrays(np.bool_, shape),
    )
)


def error_of(y: Array, prediction: Array) -> float:
    """By definition: each channel's mean square over what was measured of it, added up."""
    total = 0.0
    for channel in range(y.shape[1]):
        squares = [
            (a - b) ** 2
            for a, b in zip(y[:, channel], prediction[:, channel], strict=True)
            if not np.isnan(a)
        ]
        total += sum(squares) / len(squares) if squares else NAN
    return float(np.sqrt(total))


@given(drawn=with_missing)
def test_errors_count_what_was_measured(drawn: tuple[Array, Array, npt.NDArray[np.bool_]]) -> None:
    y, prediction, missing = drawn
    y = np.where(missing, NAN, y)
    assert rmse(y, prediction) == pytest.approx(error_of(y, prediction), nan_ok=True)
    cumulative = cumulative_rmse(y, prediction)
    expected = [error_of(y[:n], prediction[:n]) for n in range(1, len(y) + 1)]
    np.testing.assert_allclose(cumulative, expected, rtol=1e-9, atol=1e-9)


def test_a_prediction_that_is_no_number_is_no_gap() -> None:
    prediction = np.array([0.0, NAN, 0.0])
    assert np.isnan(rmse([0.0, 0.0, NAN], prediction))
    assert rmse([0.0, NAN, 3.0], prediction) == pytest.approx(np.sqrt(4.5))


def test_the_spread_is_that_of_what_was_measured() -> None:
    y = np.array([[1.0, 0.1, NAN], [NAN, NAN, 7.0], [2.0, 0.1, NAN], [6.0, 0.1, NAN]])
    seen = [[1.0, 2.0, 6.0], [0.1] * 3, [7.0]]
    means = [sum(values) / len(values) for values in seen]
    deviation = np.sqrt(sum((v - means[0]) ** 2 for v in seen[0]) / 3)
    np.testing.assert_allclose(spread(y), [deviation, 1, 1])  # 1 for what is constant
    assert nrmse(y[:, 0], np.full(4, 4.0)) == pytest.approx(np.sqrt((9 + 4 + 4) / 3) / deviation)


@pytest.mark.parametrize(
    ("training", "prediction", "leaves"),
    [
        ([0, 2], [1, 4, -2, 1], None),  # three times as far from 1 as the training samples
        ([0, 2], [1, 4.001, 0], 1),
        ([0, 2], [1, 1, 1, -2.001], 3),
        ([0, NAN, 2, NAN], [4, 4.001], 1),
        ([0, 2], [1, 1, NAN], 2),
        ([0, 2], [np.inf], 0),
        ([[0, 0], [2, 20]], [[4, 40], [1, 10], [1, -21]], 2),
        ([[0, 0], [2, 20]], [[4, 40], [-3, 10], [1, -21]], 1),
        ([[0, NAN], [NAN, 0], [2, 20]], [[4, 40], [5, 10]], 1),
    ],
)
def test_a_prediction_leaves_three_times_the_range_of_the_training_samples(
    training: Any, prediction: Any, leaves: int | None
) -> None:
    first, second = (np.array(values, dtype=np.float64) for values in (training, prediction))
    if first.ndim == 1:
        first, second = first[:, None], second[:, None]
    assert leaves_range(first, second) == leaves


@pytest.mark.parametrize(
    ("prediction", "leaves"),
    [([7, 7.001, -1e6], None), ([7, 8, NAN], 2), ([7, np.inf], 1), ([-np.inf], 0)],
)
def test_a_channel_that_was_constant_is_left_by_what_is_no_number(
    prediction: Any, leaves: int | None
) -> None:
    constant = np.array([[7.0], [NAN], [7.0]])
    assert leaves_range(constant, np.array(prediction, dtype=np.float64)[:, None]) == leaves


def test_a_run_says_when_its_forecast_leaves_the_range_of_what_was_measured() -> None:
    y = np.concatenate([np.tile([0.0, 1.0], 50), np.zeros(20)])[:, None]
    far = standing_in(holed(y, 3, 50), 1e6, y_sim=np.arange(120.0)[:, None] / 55)
    short = replace(SETUP, train=100, settings=replace(QUICK, warmup=2))
    found = compare(far, ["simulator", "persistence"], short)
    assert found["persistence"][0].leaves is None
    assert found["simulator"][0].leaves == 11  # at sample 111 it says more than 2


# ---------------------------------------------------------------- intervals


def forecast_errors(samples: int, ny: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((samples, ny)) * (1 + 0.01 * np.arange(samples))[:, None]


def test_an_interval_is_fitted_to_the_errors_that_are_known() -> None:
    y = 50 * np.random.default_rng(9).standard_normal((1000, 2))
    parts = [forecast_errors(150, 2, seed) for seed in range(3)]
    ends = [holed(part, slice(100 + i, None)) for i, part in enumerate(parts)]
    cut = Interval.fit([part[: 100 + i] for i, part in enumerate(parts)], y)
    found = Interval.fit(ends, y).half_widths(500)
    np.testing.assert_allclose(found, cut.half_widths(500), rtol=1e-9)
    # What is known counts at its own horizon: with holes it is nearly the same interval, which it
    # is not when the samples after a hole move into it.
    scattered = [holed(holed(p, slice(3, 40), channel=0), 0, 77, channel=1) for p in parts]
    found, whole = (Interval.fit(each, y).half_widths(150)[50:] for each in (scattered, parts))
    np.testing.assert_allclose(found, whole, rtol=0.05)
    closed = [p[~np.isnan(p[:, 0])][:, :1] for p in scattered]
    moved = Interval.fit(closed, y[:, :1]).half_widths(150)[50:, 0]
    assert (moved > 1.1 * whole[:, 0]).all()


def test_the_coverage_is_a_share_of_the_errors_that_are_known() -> None:
    interval = Interval((0, 100), ((1.0, 2.0), (1.5, 2.0)), (None, 9.0))
    errors = holed(holed(forecast_errors(80, 2, 5), slice(20, 33)), 60, channel=1)
    known = inside = 0
    for n, row in enumerate(errors):
        for error, half in zip(row, (1 + 0.005 * n, 2.0), strict=True):
            known += not np.isnan(error)
            inside += abs(error) <= half
    assert 0 < inside < known
    assert interval.coverage(errors) == pytest.approx(inside / known)


@pytest.mark.parametrize("channel", [slice(None), 1])
def test_a_channel_without_an_error_has_no_interval(channel: Any) -> None:
    errors = holed(np.ones((5, 2)), slice(None), channel=channel)
    with pytest.raises(ValueError, match="errors must have a sample at least, in every channel"):
        Interval.fit([errors], np.ones((9, 2)))


# ---------------------------------------------------------------- baselines


def sine(samples: int, seed: int = 0) -> tuple[Array, npt.NDArray[np.bool_]]:
    """A noisy sinusoid, and a mask that leaves out a fifth of it."""
    rng = np.random.default_rng(seed)
    y = 0.3 + np.sin(2 * np.pi * 0.0313 * np.arange(samples) + 0.4)
    measured = np.ones(samples, dtype=np.bool_)
    measured[rng.choice(samples, samples // 5, replace=False)] = False
    return (y + 0.1 * rng.standard_normal(samples))[:, None], measured[:, None]


def on_measured(frequency: float, y: Array, measured: npt.NDArray[np.bool_]) -> tuple[Any, float]:
    """Least squares of the measured rows alone: coefficients, and what they leave."""
    rows = np.flatnonzero(measured)
    phase = 2 * np.pi * frequency * rows
    basis = np.stack([np.ones(len(rows)), np.cos(phase), np.sin(phase)], axis=1)
    found, left, *_ = np.linalg.lstsq(basis, y[rows, 0], rcond=None)
    return found, float(left[0])


def test_a_sinusoid_comes_to_the_least_squares_of_what_was_measured() -> None:
    y, measured = sine(300)
    best = scipy.optimize.minimize_scalar(
        lambda f: on_measured(f, y, measured)[1],
        bounds=(0.0303, 0.0323),
        method="bounded",
        options={"xatol": 1e-10},
    ).x
    wanted = on_measured(best, y, measured)[0]
    found = HarmonicRegression.fit(np.where(measured, y, NAN), sinusoids=1, damped=False)
    phase = 2 * np.pi * best * np.arange(400)
    expected = wanted @ np.stack([np.ones(400), np.cos(phase), np.sin(phase)])
    np.testing.assert_allclose(found.predict(0, 400, y[-1])[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("fit", [HarmonicRegression.fit, PeriodicRegression.fit])
def test_what_has_no_noise_is_found_around_long_gaps(fit: Callable[[Array], Naive]) -> None:
    n = np.arange(900)
    y = 0.3 + np.sin(2 * np.pi * n / 50 + 1) + 0.4 * np.cos(4 * np.pi * n / 50)
    y = np.stack([y, 1e3 * y[::-1]], axis=1)
    seen = holed(holed(y[:600], slice(150, 230), slice(560, None)), slice(0, 60), channel=1)
    np.testing.assert_allclose(fit(seen).predict(600, 300, y[0]) / [1, 1e3], y[600:] / [1, 1e3],
                               atol=1e-5)  # fmt: skip


def test_what_is_missing_of_the_last_period_is_taken_from_the_one_before() -> None:
    y = np.arange(21.0)[:, None]
    y[[0, 3, 4, 18, 19]] = NAN
    period, error = _last_period(y, 4)
    np.testing.assert_array_equal(period[:, 0], [17, 14, 15, 20])
    # Of earlier samples of the same phases: 1, 5, 9, 13; 2, 6, 10; 7, 11; 8, 12, 16.
    left = [16, 12, 8, 4, 12, 8, 4, 8, 4, 12, 8, 4]
    assert error == pytest.approx(np.mean(np.square(left)))


def test_a_phase_that_was_never_measured_lies_on_a_straight_line() -> None:
    y = np.tile([0.0, 1, 2, 3, 4, 3, 2, 1], 6)[:, None]
    y[2::8] = NAN
    y[7::8] = NAN
    found = SeasonalNaive.fit(y)
    assert found.lag == 8
    np.testing.assert_allclose(found.predict(48, 8, y[0])[:, 0], [0, 1, 2, 3, 4, 3, 2, 1])


def test_of_a_long_record_that_ends_in_a_gap_the_last_measured_samples_are_fitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    longest = 400
    monkeypatch.setattr("splitband.baselines.naive.LONGEST", longest)
    n = np.arange(3 * longest)
    y = np.where(n < longest, 7.0, np.sin(2 * np.pi * n / 100))[:, None]
    y[2 * longest :] = NAN
    found = HarmonicRegression.fit(y)
    assert found.begin == longest
    expected = np.sin(2 * np.pi * np.arange(200) / 100)
    np.testing.assert_allclose(found.predict(len(n), 200, y[0])[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("terms", [["gain"], ["offset"], ["gain", "offset"]])
def test_a_simulator_is_calibrated_by_the_measured_samples_alone(terms: list[Term]) -> None:
    rng = np.random.default_rng(5)
    y_sim, y = rng.standard_normal((2, 200, 2))
    y = holed(holed(y, slice(50, 90)), slice(120, 160), channel=1)
    found = calibrate(y_sim, y, DT, terms=terms)
    for channel in range(2):
        rows = ~np.isnan(y[:, channel])
        basis = np.stack([y_sim[rows, channel], np.ones(rows.sum())], axis=1)
        wanted = y[rows, channel]
        if terms == ["offset"]:
            wanted = wanted - basis[:, 0]
        kept = [("gain", "offset").index(term) for term in terms]
        expected = np.linalg.lstsq(basis[:, kept], wanted, rcond=None)[0]
        given = [getattr(found, term)[channel] for term in terms]
        np.testing.assert_allclose(given, expected, rtol=1e-9)


def test_delay_and_clock_are_found_around_gaps() -> None:
    def signal(time: Array) -> Array:
        return np.sin(2 * np.pi * time / 83) + 0.5 * np.sin(2 * np.pi * time / 31 + 1)

    n: Array = np.arange(1000, dtype=np.float64)
    y_sim = signal(n)[:, None]
    y = 2 * signal(1.01 * n[:600] - 7.3)[:, None] + 0.5
    found = calibrate(y_sim, holed(y, slice(100, 180), slice(400, 450)), DT, 600)
    assert found.gain == pytest.approx((2.0,), rel=1e-3)
    assert found.offset == pytest.approx((0.5,), abs=1e-3)
    assert found.delay == pytest.approx(7.3 * DT, rel=1e-2)
    assert found.clock == pytest.approx(1.01, rel=1e-4)


@pytest.mark.parametrize("rows", [slice(790, None), slice(20, None), slice(980)])
def test_a_channel_that_is_hardly_measured_does_not_spoil_the_calibration(rows: slice) -> None:
    time = np.arange(1000)
    y_sim = np.stack([np.sin(time / 20), np.cos(time / 17)], axis=1)
    late = np.stack([np.sin((time - 3) / 20), np.cos((time - 3) / 17)], axis=1)
    noise = np.random.default_rng(0).standard_normal((1000, 2))
    y = holed(2 * late + 0.5 + 0.05 * noise, rows, channel=1)
    found = calibrate(y_sim, y, DT)
    assert found.gain[0] == pytest.approx(2, rel=0.02)
    assert found.offset[0] == pytest.approx(0.5, abs=0.02)
    assert found.delay == pytest.approx(3 * DT, rel=0.1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gap", [500, 800])
def test_a_season_is_none_that_a_few_pairs_agree_in(gap: int, seed: int) -> None:
    noise = 0.3 * np.random.default_rng(seed).standard_normal(1500)
    y = (np.sin(2 * np.pi * np.arange(1500) / 37) + noise)[:, None]
    found = SeasonalNaive.fit(holed(y[:1000], slice(gap)))
    assert rms(found.predict(1000, 500, y[0]) - y[1000:]) < 0.6


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("every", [7, 10])
def test_a_channel_that_is_measured_now_and_then_has_its_own_frequency(
    every: int, seed: int
) -> None:
    noise = 0.05 * np.random.default_rng(seed).standard_normal(1500)
    y = (np.sin(2 * np.pi * np.arange(1500) / 50) + noise)[:, None]
    seen = holed(y[:1000], np.arange(1000) % every > 0)
    assert rms(HarmonicRegression.fit(seen).predict(1000, 500, y[0]) - y[1000:]) < 0.2


def test_a_sparse_channel_does_not_make_the_others_longer() -> None:
    y = np.random.default_rng(0).standard_normal((5 * LONGEST, 2))
    begin, end = recent(holed(y, slice(3, None), channel=1))
    assert begin == 0
    assert (~np.isnan(end)).sum(axis=0).tolist() == [LONGEST, 3]


def test_a_calibration_needs_two_measured_samples() -> None:
    y = holed(np.ones((9, 1)), slice(1, None))
    with pytest.raises(ValueError, match="2 samples at least"):
        calibrate(np.ones((9, 1)), y, DT)


@pytest.mark.parametrize("name", ["mean", "seasonal-naive", "periodic"])
def test_a_baseline_of_a_record_without_gaps_is_that_of_its_samples(name: str) -> None:
    r = record()
    same = Trajectory(r.y, DT, measured=np.ones_like(r.y, dtype=np.bool_))
    a, b = (FIXED[name](each, TRAIN).predict(TRAIN, 20, r.y[0]) for each in (r, same))
    np.testing.assert_array_equal(a, b)


def test_the_mean_of_a_record_with_long_gaps_is_that_of_what_was_measured() -> None:
    y = holed(record().y, slice(20, 74))
    found = FIXED["mean"](with_gaps(y), TRAIN).predict(TRAIN, 1, y[0])
    assert found[0, 0] == pytest.approx(np.nanmean(y[:TRAIN]))


@pytest.mark.parametrize("channels", [1, 2], ids=["every other sample", "never both channels"])
def test_a_season_is_found_where_no_two_samples_follow_each_other(channels: int) -> None:
    rows = slice(None, None, 2), slice(1, None, 2)
    y = record(channels).y
    for channel in range(channels):
        y = holed(y, rows[channel], channel=channel)
    found = FIXED["seasonal-naive"](with_gaps(y), TRAIN).predict(TRAIN, 20, y[0])
    assert np.isfinite(found).all()


def test_a_gap_does_not_spoil_the_forecast_of_a_sinusoid() -> None:
    samples, train = 140, 100
    y = sine(samples)[0]
    rms_of = []
    for each in (y, holed(y, slice(40, 60))):
        ahead = FIXED["harmonic"](with_gaps(each), train).predict(train, samples - train, y[0])
        rms_of.append(rms(y[train:] - ahead))
    assert rms_of[1] < 1.5 * rms_of[0]


# ---------------------------------------------------------------- comparing


def test_errors_and_coverage_do_not_depend_on_what_stands_in_for_later_gaps() -> None:
    methods = ["gru", "mean", "persistence", "seasonal-naive"]
    y = holed(holed(record(ny=2).y, 25, slice(60, 66)), TRAIN, slice(100, 110), channel=1)
    records = []
    for value in (0.0, 300.0):
        standing = np.where(np.arange(LENGTH) < TRAIN, 0.0, value)[:, None]
        known = np.isfinite(y)
        records.append(Trajectory(np.where(known, y, standing), DT, measured=known))
    first, other = (compare(each, methods, SETUP) for each in records)
    trials = [try_out(each, methods, SETUP).settled(first) for each in records]
    for method in methods:
        a, b = first[method][0], other[method][0]
        np.testing.assert_array_equal(a.forecast, b.forecast)
        assert (a.total_rmse, a.forecast_rmse) == (b.total_rmse, b.forecast_rmse)
        assert a.total_rmse == pytest.approx(error_of(y[-len(a.from_start) :], a.from_start))
        assert a.forecast_rmse == pytest.approx(error_of(y[TRAIN:], a.forecast))
        left = y[TRAIN:] - a.forecast
        half = trials[0].intervals[method].half_widths(len(left))
        inside = [abs(e) <= h for e, h in zip(left.flat, half.flat, strict=True) if not np.isnan(e)]
        for each, trial in zip(records, trials, strict=True):
            covered = trial.intervals[method].coverage(each.seen[TRAIN:] - a.forecast)
            assert covered == pytest.approx(np.mean(inside))
    assert trials[0].errors == trials[1].errors
    assert trials[0].intervals == trials[1].intervals


def test_held_out_errors_count_what_was_measured() -> None:
    train = 80  # of which the last 20, 16, 12 and 8 are held out
    y = holed(record().y, 64, slice(70, 74))
    trial = try_out(with_gaps(y), ["persistence"], replace(SETUP, train=train))
    last = {60: y[59], 64: y[63], 68: y[67], 72: y[69]}
    left = np.concatenate([y[start:train] - value for start, value in last.items()])
    assert trial.errors["persistence"] == pytest.approx(np.sqrt(np.nanmean(left**2)))


def test_simulations_warm_up_before_a_gap_or_after_it() -> None:
    y = holed(record().y, 4, TRAIN - 3, TRAIN + 20)
    r = with_gaps(y)
    model = build("gru", r, SETUP, seed=0)
    fit(model, r[:TRAIN], QUICK, seed=0)
    found = run("gru", r, SETUP, seed=0, later=[TRAIN + 2, TRAIN + 20, TRAIN + 25])

    def ahead(start: int) -> Array:
        assert np.isfinite(y[start - WARMUP : start]).all()
        return model.simulate(y[start - WARMUP : start], LENGTH - start)

    for prediction, start, at in (
        (found.from_start, 5 + WARMUP, 5 + WARMUP),
        (found.forecast, TRAIN - 3, TRAIN),
        (found.later[TRAIN + 2], TRAIN - 3, TRAIN + 2),
        (found.later[TRAIN + 20], TRAIN + 20, TRAIN + 20),
        (found.later[TRAIN + 25], TRAIN + 20, TRAIN + 25),
    ):
        np.testing.assert_allclose(prediction, ahead(start)[at - start :], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (slice(TRAIN), "the training part must have a measured sample in every channel"),
        (slice(TRAIN, None), "the predicted part must have a measured sample in every channel"),
    ],
)
def test_a_channel_that_was_not_measured_in_a_part_is_refused(rows: slice, words: str) -> None:
    r = with_gaps(holed(record(ny=2).y, rows, channel=1))
    with pytest.raises(ValueError, match=words):
        compare(r, ["mean"], SETUP)


def test_gaps_that_leave_no_warm_up_for_a_forecast_are_refused() -> None:
    r = with_gaps(holed(record().y, *range(5, TRAIN, 12)))
    with pytest.raises(ValueError, match="between the gaps of the 90 training samples, got 12"):
        compare(r, ["gru"], SETUP)


def test_an_interval_is_limited_by_the_spread_of_what_was_measured() -> None:
    y = holed(np.random.default_rng(6).standard_normal((LENGTH, 1)), slice(20, 60))
    apart = np.sqrt(2) * scipy.stats.norm.ppf(0.95)
    interval = try_out(with_gaps(y), ["mean"], SETUP).intervals["mean"]
    assert interval.most[0] == pytest.approx(apart * np.nanstd(y[:TRAIN]))


# ---------------------------------------------------------------- the command line

QUICKLY = "--recipe paper --epochs 2 --hidden 4,3 --window 30 --warmup 10"
GRU_ON = f"--columns a --methods gru {QUICKLY} --seeds 1 --jobs 1 --out out"
FIT_ON = f"--columns a --method gru {QUICKLY} --out out"
BAD_ROWS = {*range(5), *range(80, 84), *range(140, 150), *range(160, 166)}
SEEN = np.where(np.isin(np.arange(200), [*BAD_ROWS]), NAN, A)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Records with gaps, and without."""
    found = tmp_path_factory.mktemp("gaps")
    whole = pd.DataFrame({"time": (DT * np.arange(200)).round(9), "a": A, "b": B})
    gappy = whole.copy()
    gappy.loc[:4, "a"] = NAN
    gappy.loc[140:149, "a"] = NAN
    gappy.loc[160:165, "a"] = np.inf
    history = whole.iloc[:60].copy()
    history.loc[52:59, "a"] = NAN
    slow = whole.iloc[:80].assign(time=(2 * DT * np.arange(80)).round(9))
    tables = {
        "gappy": gappy.drop(index=range(80, 84)), "whole": whole, "history": history, "slow": slow,
        "short": whole.iloc[:25], "renamed": whole.rename(columns={"a": "z"}),
        "ended": gappy.iloc[:166].drop(index=range(80, 84)), "wide": whole.assign(a=10 * A),
        "named": whole.rename(columns={"a": "y", "b": "z"}), "turned": whole[["time", "b", "a"]],
    }  # fmt: skip
    for name, table in tables.items():
        table.to_csv(found / f"{name}.csv", index=False)
    return found


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are made, but not written, which takes the longest."""
    monkeypatch.setattr("splitband.report.pictures.save", lambda figure, path: None)


@pytest.fixture(scope="module")
def compared(folder: Path) -> Path:
    line = f"compare {folder}/gappy.csv --gaps mask --columns a --more {folder}/whole.csv"
    call(f"{line} --methods gru,persistence,mean {QUICKLY} --seeds 2 --jobs 1", folder / "compared")
    return folder / "compared"


def test_compare_gives_finite_numbers_around_gaps_and_counts_them(compared: Path) -> None:
    found = results(compared)
    assert found["record"]["samples"] == 200
    assert found["record"]["gaps"] == len(BAD_ROWS)
    for facts in found["methods"].values():
        numbers = [facts["held_out_rmse"], facts["change"], facts["interval"]["covers"]]
        numbers += [*facts["total_rmse"], *facts["forecast_rmse"]]
        numbers += [half for row in facts["interval"]["half_width"] for half in row]
        assert np.isfinite(numbers).all()
    assert found["arguments"]["gaps"] == "mask"


def test_the_predictions_are_empty_in_gaps_of_the_record_alone(compared: Path) -> None:
    table, found = written(compared / "predictions.csv"), results(compared)["methods"]
    np.testing.assert_array_equal(table["a"], SEEN)
    for name in ("gru", "persistence", "mean"):
        from_start, forecast = (table[f"a, {name}, {p}"] for p in ("from start", "forecast"))
        # Warmed up on samples 5 to 14.
        assert np.flatnonzero(np.isfinite(from_start)).tolist() == [*range(15, 200)]
        assert np.flatnonzero(np.isfinite(forecast)).tolist() == [*range(150, 200)]
        mean = found[name]["mean_of_seeds"]
        for key, predicted in (("total_rmse", from_start), ("forecast_rmse", forecast)):
            error = (SEEN - predicted).dropna().to_numpy()
            reported = found[name][key][0] if mean is None else mean[key]
            assert reported == pytest.approx(rms(error))
    assert (table["a, persistence, forecast"].dropna() == A[139]).all()


def test_compare_trains_on_further_records_and_tries_out_with_them(
    folder: Path, compared: Path
) -> None:
    found = results(compared)["methods"]["gru"]
    setup = Setup(
        150, Settings(30, 10, 2), bands=Bands(1.0, 1, 2), sizes=Sizes(hidden_high=4, hidden_low=3)
    )
    gappy, whole = (
        read(folder / f"{name}.csv", columns="a", gaps="mask") for name in ("gappy", "whole")
    )
    runs = compare(gappy, ["gru"], setup, (0, 1), more=[whole])["gru"]
    assert found["total_rmse"] == [each.total_rmse for each in runs]
    trial = try_out(gappy, ["gru"], setup, (0, 1), more=[whole])
    assert found["held_out_rmse"] == trial.errors["gru"]
    assert trial.errors != try_out(gappy, ["gru"], setup, (0, 1)).errors
    assert found["total_rmse"] != [
        each.total_rmse for each in compare(gappy, ["gru"], setup, (0, 1))["gru"]
    ]


def test_fit_and_simulate_go_around_gaps(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"fit {folder}/gappy.csv --gaps mask --columns a,b --method split-gru {QUICKLY}"
    call(f"{line} --more {folder}/whole.csv --more {folder}/ended.csv", tmp_path / "model")
    said = capsys.readouterr().out
    assert "25 of 200 samples were not measured" in said
    assert "rows 0 to 4, 80 to 83, 140 to 149, 160 to 165" in said
    found = results(tmp_path / "model")
    assert found["more"] == [f"{folder}/whole.csv", f"{folder}/ended.csv"]
    assert np.isfinite(found["training_rmse"])
    ahead = f"simulate {tmp_path}/model --history {folder}/history.csv --steps 20"
    call(f"{ahead} --gaps mask", tmp_path / "ahead.csv")
    model, _ = load(tmp_path / "model")
    y = np.stack([A, B], axis=1)
    expected = model.simulate(y[42:52], 28)[8:]  # on the last measured samples, across the gap
    table = written(tmp_path / "ahead.csv")
    np.testing.assert_allclose(table["time"], DT * np.arange(60, 80))
    np.testing.assert_allclose(table[["a", "b"]], expected, rtol=1e-6, atol=1e-7)


@pytest.mark.usefixtures("undrawn")
def test_forecast_goes_on_from_a_record_that_ends_in_a_gap(folder: Path, tmp_path: Path) -> None:
    line = f"forecast {folder}/ended.csv --gaps mask --columns a --steps 7 --method mean"
    call(line, tmp_path / "out")
    assert results(tmp_path / "out")["gaps"] == len(BAD_ROWS)
    table = written(tmp_path / "out" / "forecast.csv")
    np.testing.assert_allclose(table["time"], DT * np.arange(166, 173))
    np.testing.assert_allclose(table["a"], np.nanmean(SEEN[:166]), atol=1e-3)


@pytest.mark.usefixtures("undrawn")
def test_forecast_trains_on_further_records(folder: Path, tmp_path: Path) -> None:
    line = f"forecast {folder}/ended.csv --gaps mask --columns a --steps 7 --method gru --seeds 1"
    found = []
    for more in ("", f"--more {folder}/wide.csv"):
        call(f"{line} --jobs 1 --epochs 1 {more}", tmp_path / "out")
        found.append(written(tmp_path / "out" / "forecast.csv")["a"].to_numpy())
    assert np.isfinite(found).all()
    assert not np.allclose(found[1], found[0], rtol=0.1)


HYBRID = f"--columns a --simulator whole.csv --method residual-gru {QUICKLY} --out out"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (f"compare history.csv {GRU_ON}", ("history.csv", "rows 52 to 59", "--gaps mask")),
        (f"compare gappy.csv {GRU_ON}", ("gappy.csv", "row 80", "--gaps mask")),
        (f"compare gappy.csv --gaps fill {GRU_ON}", ("--gaps", "fill")),
        (f"compare whole.csv --more renamed.csv {GRU_ON}", ("renamed.csv", "'a'", "'z'")),
        (f"compare whole.csv --more slow.csv {GRU_ON}", ("slow.csv", "every 0.1 s", "0.2 s")),
        (f"fit whole.csv --more slow.csv {FIT_ON}", ("slow.csv", "every 0.1 s", "0.2 s")),
        (f"fit whole.csv --more renamed.csv {FIT_ON}", ("renamed.csv", "'a'")),
        (f"fit whole.csv --more short.csv {FIT_ON}", ("window", "25 samples", "30")),
        (f"fit whole.csv --more nothing.csv {FIT_ON}", ("--more", "nothing.csv")),
        (f"fit whole.csv --more gappy.csv {FIT_ON}", ("gappy.csv", "--gaps mask")),
        (
            f"fit whole.csv --more slow.csv --more-simulator whole.csv {FIT_ON}",
            ("every 0.1 s", "every 0.2 s"),
        ),
        (
            f"fit whole.csv --more gappy.csv --gaps mask {HYBRID}",
            ("--more-simulator must be given once for each --more", "got 0 for 1"),
        ),
        (
            f"fit whole.csv --more-simulator whole.csv {HYBRID}",
            ("--more-simulator must be given once for each --more", "got 1 for 0"),
        ),
    ],
)
def test_what_cannot_be_is_one_line(
    line: str,
    says: tuple[str, ...],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(folder)
    assert_fails(line, says, capsys)


def test_each_further_record_has_its_own_simulator(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The network of a residual model learns nothing from simulators that are right."""
    monkeypatch.chdir(folder)
    line = f"fit whole.csv --gaps mask --more wide.csv --more gappy.csv {HYBRID}"
    line = line.replace("--out out", "")
    call(f"{line} --more-simulator wide.csv --more-simulator whole.csv", tmp_path / "right")
    call(f"{line} --more-simulator whole.csv --more-simulator wide.csv", tmp_path / "swapped")
    right, swapped = (
        results(tmp_path / name)["final_loss"]["network"] for name in ("right", "swapped")
    )
    assert right < 0.2 * swapped


def test_a_column_named_y_is_found_in_further_records(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    line = f"fit named.csv --more named.csv --columns y --method gru {QUICKLY}"
    call(line, tmp_path)


def test_the_columns_of_further_records_go_by_name(folder: Path, tmp_path: Path) -> None:
    for name in ("whole", "turned"):
        line = f"fit {folder}/whole.csv --more {folder}/{name}.csv --method gru {QUICKLY}"
        call(line, tmp_path / name)
    expected, found = (results(tmp_path / name)["final_loss"] for name in ("whole", "turned"))
    assert found == expected


def test_further_records_of_other_columns_are_refused_where_all_are_taken(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    line = f"fit whole.csv --more renamed.csv --method gru {QUICKLY} --out out"
    assert_fails(line, ("renamed.csv", "'a'"), capsys)


def test_the_range_of_a_model_is_that_of_all_its_records(folder: Path, tmp_path: Path) -> None:
    call(
        f"fit {folder}/whole.csv --more {folder}/wide.csv --columns a --method gru {QUICKLY}",
        tmp_path,
    )
    assert results(tmp_path)["range"] == [[10 * A.min()], [10 * A.max()]]


def test_the_error_of_a_simulator_counts_what_was_measured() -> None:
    found = _show_simulator(with_gaps(SEEN[:, None]), 10 * A[:, None], cutoff=1.0, order=1)
    assert found["total_rmse"] == pytest.approx(rms((SEEN - 10 * A)[np.isfinite(SEEN)]))


def test_what_stands_in_for_a_gap_across_the_end_of_a_slice_knows_nothing_of_later_samples() -> (
    None
):
    y = holed(record().y, slice(TRAIN - 5, TRAIN + 5))
    later = y.copy()
    later[TRAIN + 5 :] += 1000
    first, other = (with_gaps(each)[:TRAIN] for each in (y, later))
    np.testing.assert_array_equal(first.y, other.y)
    methods = ["mean", "persistence", "seasonal-naive"]
    found = [compare(with_gaps(each), methods, SETUP) for each in (y, later)]
    for method in methods:
        np.testing.assert_array_equal(found[0][method][0].forecast, found[1][method][0].forecast)


def test_a_logger_may_start_again_between_two_rows(tmp_path: Path) -> None:
    stamps = [0, 1, 2, 3, 7.4, 8.4, 9.4, 10.4]
    found = read(stamped(tmp_path, stamps), gaps="mask")
    assert found.sampling_time == 1
    np.testing.assert_array_equal(np.isnan(found.seen[:, 0]), [*[0] * 4, *[1] * 3, *[0] * 4])
