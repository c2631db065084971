"""Records with gaps: what is seen of them, and what stands in for the rest."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband import Record
from splitband.runtime.arrays import Array
from tests.signals import DT, NAN, TRAIN, holed, record, with_gaps

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
    np.testing.assert_array_equal(whole.y_with_gaps, expected)
    np.testing.assert_array_equal(whole.truth, expected)
    np.testing.assert_array_equal(with_gaps(y, y_true=whole.y).truth, whole.y)
    assert whole.complete.tolist() == [all(map(np.isfinite, row)) for row in y]
    assert (whole.measured is None) == np.isfinite(y).all()
    assert (whole.y >= np.nanmin(expected, axis=0)).all()
    assert (whole.y <= np.nanmax(expected, axis=0)).all()
    begin = min(begin, len(y) - 2)
    part = whole[begin : begin + samples]
    np.testing.assert_array_equal(part.y_with_gaps, expected[begin : begin + samples])


def test_straight_lines_and_held_ends_stand_in_for_gaps() -> None:
    y = np.array([NAN, 2.0, NAN, NAN, 8.0, np.inf])
    np.testing.assert_array_equal(with_gaps(y).y[:, 0], [2, 2, 4, 6, 8, 8])


def test_a_sample_whose_input_is_not_known_does_not_count_as_measured() -> None:
    y, u = np.arange(10.0).reshape(5, 2), np.array([[1, 0], [NAN, 0], [3, 0], [3, np.inf], [3, 1]])
    with pytest.warns(UserWarning, match=r"input 'u[01]' .* 1 of 5 .*row [13]\)"):
        found = with_gaps(holed(y, 4, channel=1), u=u)
    np.testing.assert_array_equal(found.y_with_gaps, [[0, 1], *[[NAN, NAN]] * 4])
    np.testing.assert_array_equal(found.u, [[1, 0], [1, 0], [3, 0], [3, 0], [3, 1]])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: with_gaps(np.full((5, 1), NAN)), "y must have a finite value in channel 0"),
        (lambda: with_gaps(np.ones(5), u=np.full(5, NAN)), "u must have a finite value"),
        (lambda: with_gaps(np.ones(5), u=np.ones(4)), r"u must have the shape \(5, any number\)"),
        (
            lambda: Record(np.ones(5), DT, measured=np.ones((5, 2), np.bool_)),
            r"the shape of y, \(5, 1\): it is \(5, 2\)",
        ),
    ],
)
def test_records_without_anything_to_go_by_are_refused(
    make: Callable[[], object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        make()


def test_a_filler_across_the_end_of_a_slice_knows_nothing_of_later_samples() -> None:
    y = holed(record().y, slice(TRAIN - 5, TRAIN + 5))
    later = y.copy()
    later[TRAIN + 5 :] += 1000
    first, other = (with_gaps(each)[:TRAIN] for each in (y, later))
    np.testing.assert_array_equal(first.y, other.y)
