"""Where windows lie in records, with gaps and in several."""

import numpy as np
import numpy.typing as npt
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband import GRU
from splitband.models import Recurrent
from splitband.training.windows import joined, select, windows, windows_in
from tests.records import NAN, QUICK, SETUP, record, standing_in
from tests.support import untrained
from tests.training.support import starts_of

Array = npt.NDArray[np.float64]


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
            windows_in(records, window, warmup)
        return
    places = windows_in(records, window, warmup)
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


@pytest.mark.parametrize("method", ["gru", "split-gru", "filtered-gru-conditioned"])
def test_two_records_have_the_windows_of_both(method: str) -> None:
    whole = record(nu=1)
    halves = [whole[:65], whole[65:]]
    model = untrained(method, whole, SETUP, 0)
    model.adapt_to(halves)
    window, warmup = QUICK.window, QUICK.warmup
    together = zip(*(model.tasks(model.normalised(half)) for half in halves), strict=True)
    starts = windows_in(halves, window, warmup).starts
    assert len(starts) == sum(len(half) - window + 1 for half in halves)
    for tasks in together:
        known, target = windows(joined(tasks), window, warmup)
        alone = [windows(task, window, warmup) for task in tasks]
        found = select(known, starts)
        assert torch.equal(target[starts], torch.cat([of_one for _, of_one in alone]))
        for name in ("y", "u", "y_sim"):
            signals = [getattr(known_of_one, name) for known_of_one, _ in alone]
            assert torch.equal(getattr(found, name), torch.cat(signals))
