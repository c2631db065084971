"""What the paper's models are trained on: Eqs. 10 and 12, by SciPy, NumPy and torch alone."""

from __future__ import annotations

from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
import torch

import splitband as sb
from splitband.models import FilteredModel, SplitModel
from splitband.models.base import Signals
from splitband.networks import rollout
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.training import TrainingSettings, fit
from splitband.training.windows import joined, windows, windows_in
from tests.signals import DT, NAN

WINDOW, R, K, ORDER, CUTOFF = 40, 12, 3, 2, 0.6
PAIR = sb.ComplementaryPair.butterworth(CUTOFF, 1 / DT, ORDER)


def drawn(samples: int, seed: int, gap: bool = False) -> Record:
    rng = np.random.default_rng(seed)
    y = np.cumsum(rng.standard_normal(samples)) + rng.standard_normal(samples)
    y[samples // 2 : samples // 2 + 3] = NAN if gap else y[0]
    return Record.with_gaps(y, DT) if gap else Record(y, DT)


def untrained(own_warmup: bool, filter_output: bool = False) -> SplitModel:
    torch.manual_seed(0)
    networks = [sb.GRU(3), sb.GRU(4)]
    return SplitModel(networks, PAIR, K, filter_output, own_warmup=own_warmup).double()


RECORDS = {
    "one": [drawn(130, 0)],
    "with a gap": [drawn(130, 1, gap=True)],
    "several": [drawn(130, 2), drawn(90, 3, gap=True)],
}


@pytest.mark.parametrize("records", RECORDS.values(), ids=RECORDS)
def test_eq_10_slices_the_filtered_training_record(records: list[Record]) -> None:
    model = untrained(own_warmup=False)
    tasks = zip(*(model.tasks(model.normalised(r)) for r in records), strict=True)
    starts = windows_in(records, WINDOW, R).starts
    whole = [np.concatenate(of) for of in zip(*map(scipys_bands, records), strict=True)]
    for task, band, step in zip(map(joined, tasks), whole, (K, 1), strict=True):
        known, target = windows(task, WINDOW, R)
        for start in starts:
            warm = np.column_stack([of_band[start : start + R] for of_band in whole])
            np.testing.assert_allclose(known.y[start], warm, rtol=0, atol=1e-12)
            wanted = band[start + R : start + WINDOW : step, None]
            np.testing.assert_allclose(target[start], wanted, rtol=0, atol=1e-12)


def scipys_bands(record: Record) -> list[Array]:
    """L and H of a whole record, whose gaps are filled by straight lines."""
    y, n = record.y[:, 0], np.arange(len(record))
    seen = ~np.isnan(record.y_with_gaps[:, 0])
    np.testing.assert_allclose(y, np.interp(n, n[seen], record.y_with_gaps[seen, 0]))
    kinds = (scipy.signal.butter(ORDER, CUTOFF, kind, fs=1 / DT) for kind in ("low", "high"))
    return [scipy.signal.filtfilt(b, a, y) for b, a in kinds]


@pytest.mark.parametrize("filter_output", [False, True])
def test_the_loss_of_eq_10_is_the_paper_s(filter_output: bool) -> None:
    """Free runs of torch's own GRU cell, from warm-ups cut from the filtered record."""
    (record,) = RECORDS["one"]
    model = untrained(False, filter_output)
    low, high = (torch.from_numpy(band.copy())[:, None] for band in scipys_bands(record))
    for task, band, step in zip(
        model.tasks(model.normalised(record)), (low, high), (K, 1), strict=True
    ):
        known, target = windows(task, WINDOW, R)
        chosen = Signals(known.y[:1])
        found = task.simulate(chosen, target.shape[1])[0].detach()
        cell = model.networks[0 if step == K else 1]
        expected = free_run(cell, band[:R][R % step :: step], target.shape[1])
        if filter_output and step == 1:
            b, a = scipy.signal.butter(ORDER, CUTOFF, "high", fs=1 / DT)
            fed = torch.cat([band[:R], expected])[:, 0].numpy()
            expected = torch.from_numpy(scipy.signal.filtfilt(b, a, fed)[R:, None].copy())
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)


def free_run(cell: Any, warm: torch.Tensor, steps: int) -> torch.Tensor:
    """Return a free run by torch.nn.GRUCell with the weights of a cell."""
    gru = torch.nn.GRUCell(1, cell.hidden_size).double()
    gru.load_state_dict(cell.transition.state_dict())
    h, found = torch.zeros(1, gru.hidden_size, dtype=torch.float64), list[torch.Tensor]()
    with torch.no_grad():
        for y in warm:
            h = gru(y[None], h)
        for _ in range(steps):
            found.append(cell.observation(h)[0])
            h = gru(found[-1][None], h)
    return torch.stack(found)


def test_the_loss_of_eq_12_is_the_paper_s() -> None:
    """The first epoch's loss of one window, whose weights are still the initial ones."""
    rng, steps = np.random.default_rng(0), WINDOW - R
    y, y_sim = rng.standard_normal((2, WINDOW)).cumsum(axis=1)
    torch.manual_seed(0)
    pair = sb.Bands(CUTOFF, 1).one_way_pair(1 / DT)
    model = FilteredModel(sb.GRU(3), pair).double()
    weights = deepcopy(model.cell)
    settings = TrainingSettings.paper(WINDOW, R, 1, normalize=False)
    history = fit(model, Record(y, DT, y_sim=y_sim), settings)
    b, a = scipy.signal.butter(1, CUTOFF, fs=1 / DT)
    low = scipy.signal.lfilter(b, a, y_sim, zi=scipy.signal.lfilter_zi(b, a) * y_sim[0])[0]
    network = free_run(weights, torch.from_numpy(y[:R, None]), steps)[:, 0].numpy()
    b, a = scipy.signal.butter(1, CUTOFF, "high", fs=1 / DT)
    begun = scipy.signal.lfiltic(b, a, [y[R - 1] - low[R - 1]], [y[R - 1]])
    high = scipy.signal.lfilter(b, a, network, zi=begun)[0]
    assert history.losses["network"] == pytest.approx([sb.rmse(y[R:], high + low[R:])], rel=1e-9)


def test_a_warm_up_without_a_sample_of_the_low_band_is_refused() -> None:
    settings = sb.TrainingSettings.paper(window=WINDOW, warmup=K - 1, epochs=1)
    said = rf"warmup must be at least {K} samples for the low band.* got {K - 1}"
    with pytest.raises(ValueError, match=said):
        fit(untrained(own_warmup=False), drawn(130, 0), settings)


def test_with_an_own_warm_up_the_bands_of_a_window_add_up_to_its_samples() -> None:
    (record,) = RECORDS["one"]
    model = untrained(own_warmup=True)
    for task in model.tasks(model.normalised(record)):
        known, _ = windows(task, WINDOW, R)
        np.testing.assert_array_equal(known.y[7, :, 0], record.y[7 : 7 + R, 0])
    low, high = (task.target for task in model.tasks(model.normalised(record)))
    np.testing.assert_allclose(low + high, record.y, rtol=0, atol=1e-12)


@pytest.mark.parametrize("own_warmup", [False, True])
def test_a_prediction_filters_its_warm_up_alone(own_warmup: bool) -> None:
    """Eq. 11, whichever way the model was trained."""
    (record,) = RECORDS["one"]
    model = untrained(own_warmup)
    warm = record.y[20 : 20 + R]
    b, a = scipy.signal.butter(ORDER, CUTOFF, "low", fs=1 / DT)
    low = scipy.signal.filtfilt(b, a, warm, axis=0)
    high = warm - low
    if not own_warmup:
        b, a = scipy.signal.butter(ORDER, CUTOFF, "high", fs=1 / DT)
        high = scipy.signal.filtfilt(b, a, warm, axis=0)
    slow = free_run(model.slow, torch.from_numpy(low[R % K :: K].copy()), 12)
    wanted = np.interp(np.arange(30) / K, np.arange(12), slow[:, 0])[:, None]
    wanted = wanted + free_run(model.fast, torch.from_numpy(high.copy()), 30).numpy()
    found = sum(model.simulate_components(warm, 30).values())
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)


def test_the_paper_s_up_sampling_is_torch_s() -> None:
    (record,) = RECORDS["one"]
    model = untrained(own_warmup=False)
    model.alignment = "paper"
    known = Signals(torch.tensor(record.y[None, :R]))
    slow = rollout(model.slow, *model.slow_run(model._bands(known), 11))
    wanted = torch.nn.functional.interpolate(
        slow.transpose(1, 2), scale_factor=K, mode="linear", align_corners=False
    )
    found = model.components(known, 30)["low band"]
    torch.testing.assert_close(found, wanted.transpose(1, 2)[:, :30], rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="cannot be stepped"):
        model.stepped()


@pytest.mark.parametrize("own_warmup", [False, True])
def test_both_forms_save_and_stream(own_warmup: bool, tmp_path: Path) -> None:
    record = drawn(160, 5)
    short = sb.TrainingSettings.paper(window=WINDOW, warmup=R, epochs=1)
    bands = sb.Bands(CUTOFF, ORDER, K)
    split = partial(sb.Split, sb.GRU(3), sb.GRU(4), bands, settings=short)
    model = split(own_warmup=own_warmup).fit(record[:120], seed=1)
    y = model.predict(30).y
    model.save(tmp_path)
    np.testing.assert_array_equal(sb.load(tmp_path).predict(30).y, y)
    stream = model.stream()
    np.testing.assert_allclose([stream.step() for _ in range(30)], y, rtol=0, atol=1e-5)
    other = split(own_warmup=not own_warmup).fit(record[:120], seed=1)
    assert np.abs(other.predict(30).y - y).max() > 1e-4
