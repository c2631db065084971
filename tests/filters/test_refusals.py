"""Filters and pairs that cannot be: the rule and the value are named."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from splitband.filters import ComplementaryPair, butterworth, filtfilt, lfilter
from tests.filters.support import CUTOFF, RATE, noise

pair = ComplementaryPair.butterworth
B, A = butterworth(CUTOFF, RATE, 3)
ONE_WAY, BOTH_WAYS = (pair(CUTOFF, RATE, 3, zero_phase=both) for both in (False, True))
X = noise(30, 2)


@pytest.mark.parametrize(
    ("make", "cutoff", "order", "said"),
    [
        *((butterworth, cutoff, 1, r"cutoff must .* 5 Hz") for cutoff in (0.0, 5.0, np.nan)),
        (pair, 7.5, 1, r"cutoff must .* 5 Hz"),
        (butterworth, 2e-5, 3, "order 3 is too high"),
        (pair, 2.3e-4, 4, "order 4 is too high"),
    ],
)
def test_a_cutoff_that_cannot_be_is_named(make: Any, cutoff: float, order: int, said: str) -> None:
    with pytest.raises(ValueError, match=rf"{said}.* {cutoff:g} Hz"):
        make(cutoff, RATE, order)


@pytest.mark.parametrize("a", [[1.0, -1.2], [1.0, 0.0, 1.0]])
def test_an_unstable_filter_is_refused_with_its_pole(a: list[float]) -> None:
    largest = f"{abs(np.roots(a)).max():.6g}"
    with pytest.raises(ValueError, match=rf"must be stable, .* got one at \|z\| = {largest}"):
        ComplementaryPair.perfect([1.0], a, RATE)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (partial(butterworth, CUTOFF, 0.0), "sampling_rate must be positive, got 0 Hz"),
        (partial(butterworth, CUTOFF, RATE, 0), "order must be at least 1, got 0"),
        (lambda: lfilter([1.0], [0.0, 1.0], X), r"a\[0\] must not be zero, got 0"),
        *(
            (call, rf"first 3 outputs, .* got \({given}, 2\)")
            for given in (2, 4)
            for call in (
                partial(lfilter, B, A, X, first=X[:given]),
                partial(ONE_WAY.highpass_from, X, X[:given]),
                partial(ONE_WAY.combine, low=X, high=X, first=X[:given]),
            )
        ),
        *((partial(lfilter, B, A, X, first=noise(*shape)), "first") for shape in ((3,), (3, 1))),
        (lambda: lfilter(B, A, noise(2), first=noise(3)), r"\b2\b"),
        (lambda: BOTH_WAYS.combine(low=X, high=X, first=X[:3]), "zero_phase=False"),
        (partial(filtfilt, B, A, noise(12, 2)), "order 3 needs more than 12 samples, got 12"),
        *(
            (partial(run, X, dim=dim), "dim must name one of the 2 axes.*")
            for dim in (2, -3)
            for run in (BOTH_WAYS.lowpass, ONE_WAY.lowpass)
        ),
        (
            lambda: pair(CUTOFF, RATE, zero_phase=False, start="odd"),
            'start="odd" needs zero_phase=True',
        ),
        (
            lambda: ComplementaryPair(np.ones(2), np.ones(3), np.ones(2), RATE),
            r"one length, got \[2, 3\]",
        ),
    ],
)
def test_what_cannot_be_filtered_is_named(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        call()
