"""Find where windows may begin in training records: they have no gap in their warm-up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from splitband.data import Record
from splitband.runtime.errors import InputError


def window_starts(records: Sequence[Record], window: int, warmup: int) -> npt.NDArray[np.int_]:
    """Return the first samples of all possible windows, counted over the records."""
    lengths = [len(record) for record in records]
    complete = np.concatenate([record.complete for record in records])
    something = np.concatenate([(~np.isnan(record.y_with_gaps)).any(axis=1) for record in records])
    inside = np.arange(len(complete)) + window <= np.repeat(np.cumsum(lengths), lengths)
    warm = _counts(complete, 0, warmup) == warmup
    return np.flatnonzero(inside & warm & (_counts(something, warmup, window) > 0))


def checked_starts(records: Sequence[Record], window: int, warmup: int) -> npt.NDArray[np.int_]:
    """Return the `window_starts`; raises ValueError where there are none."""
    shortest = min(records, key=len)
    if len(shortest) < window:
        named = f" {shortest.name}" if len(records) > 1 and shortest.name else ""
        raise InputError(
            f"window must fit into the training record{named} of {len(shortest)} samples, "
            f"got {window}"
        )
    starts = window_starts(records, window, warmup)
    if not len(starts):
        raise InputError(
            f"warmup must fit between the gaps of the training record, got {warmup} samples"
        )
    return starts


def _counts(true: npt.NDArray[np.bool_], begin: int, end: int) -> npt.NDArray[np.int_]:
    """Count how many of the values from `begin` to `end` after each index are true."""
    count = np.concatenate([[0], np.cumsum(true)])
    index, last = np.arange(len(true)), len(true)
    counted = count[np.minimum(index + end, last)] - count[np.minimum(index + begin, last)]
    return np.asarray(counted)
