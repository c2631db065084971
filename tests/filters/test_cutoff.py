"""The choice of the filter pair: what it keeps to, and that it finds what anybody would."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband.filters.cutoff import (
    LEAST_PASSED,
    MOST_DOWNSAMPLING,
    MOST_LOST,
    ORDERS,
    Choice,
    CutoffCandidate,
    choose,
    choose_with_simulator,
)
from splitband.filters.resampling import check_downsampling
from splitband.filters.spectrum import periodogram
from splitband.runtime.arrays import Array

RATE, SAMPLES, WARMUP = 10.0, 600, 50
TIME = np.arange(SAMPLES) / RATE


def sine(frequency: float, amplitude: float = 1.0, phase: float = 0.0) -> Array:
    return amplitude * np.sin(2 * np.pi * frequency * TIME + phase)[:, None]


def noise(seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal((SAMPLES, 1))


def chosen(choice: Choice) -> CutoffCandidate:
    wanted = choice.cutoff, choice.order
    (candidate,) = [c for c in choice.candidates if (c.cutoff, c.order) == wanted]
    return candidate


@settings(max_examples=settings().max_examples // 8)
@given(
    y=hnp.arrays(
        np.float64,
        st.tuples(st.integers(20, 200), st.integers(1, 3)),
        elements=st.integers(-50, 50).map(float),
    ),
    warmup=st.integers(1, 20),
    downsampling=st.none() | st.integers(1, 20),
    order=st.none() | st.integers(1, 3),
)
def test_whatever_the_record_a_pair_is_chosen_that_can_be_used(
    y: Array, warmup: int, downsampling: int | None, order: int | None
) -> None:
    y[0], y[1] = 99.0, -99.0
    choice = choose(y, RATE, max(warmup, 3 * (order or 1) + 4), None, order, downsampling)
    assert chosen(choice).downsampling == choice.downsampling
    check_downsampling(choice.downsampling, choice.cutoff, RATE)
    assert choice.order == order if order else choice.order in ORDERS
    assert choice.downsampling == (downsampling or min(choice.downsampling, MOST_DOWNSAMPLING))
    hybrid = choose_with_simulator(y, y[::-1], RATE, 20, None, order, downsampling)
    check_downsampling(hybrid.downsampling, hybrid.cutoff, RATE)


@pytest.mark.parametrize(("offset", "slow", "fast"), [(0.0, 0.2, 2.0), (-300.0, 0.3, 4.0)])
def test_the_cutoff_lies_between_a_strong_slow_and_a_weak_fast_sinusoid(
    offset: float, slow: float, fast: float
) -> None:
    y = offset + sine(slow) + sine(fast, 0.3) + 0.01 * noise()
    choice = choose(y, RATE, WARMUP)
    assert slow < choice.cutoff < fast
    candidate = chosen(choice)
    assert candidate.passed > 0.75
    below = periodogram(y, RATE).share_below(choice.cutoff)  # what `spectrum` says, too
    assert f"{100 * below:.0f} % of the power lies below it" in choice.reason
    assert candidate.loss <= MOST_LOST


def test_a_low_band_that_would_be_aliased_is_not_thinned_out() -> None:
    assert choose(sine(0.1), RATE, 200).downsampling == MOST_DOWNSAMPLING
    assert choose(sine(0.1), RATE, 40).downsampling == 4  # of which a warm-up keeps ten
    assert choose(sine(0.1), RATE, 15).downsampling == 2
    k = choose(sine(0.1) + sine(0.9), RATE, WARMUP, cutoff=0.95).downsampling
    assert 1 < k < RATE / 2 / 0.9  # Nyquist stays above the faster one


def test_what_is_already_decided_stays() -> None:
    y = sine(0.2) + sine(2.0, 0.3)
    assert choose(y, RATE, WARMUP, cutoff=1.23).cutoff == 1.23
    assert choose(y, RATE, WARMUP, order=1).order == 1
    assert choose(y, RATE, WARMUP, downsampling=3).downsampling == 3
    assert choose_with_simulator(y, y, RATE, WARMUP, 1.23, 2, 3).cutoff == 1.23


def test_a_short_warmup_leaves_order_one() -> None:
    y = sine(0.2) + sine(2.0, 0.3)
    assert {c.order for c in choose(y, RATE, 9).candidates} == {1}
    assert {c.order for c in choose(y, RATE, 10).candidates} == {1, 2}


@pytest.mark.parametrize(
    ("decided", "message"),
    [
        ({"cutoff": 0.0}, "got 0 Hz"),
        ({"cutoff": float("nan")}, "got nan"),
        ({"cutoff": 1.0, "downsampling": 5}, "downsampling by 5"),
    ],
)
def test_what_cannot_be_used_is_refused(decided: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        choose(sine(0.2), RATE, WARMUP, **decided)
    with pytest.raises(ValueError, match=message):
        choose_with_simulator(sine(0.2), sine(0.2), RATE, WARMUP, **decided)


@pytest.mark.parametrize("constant", [0.0, 2.0, 0.1, 1 / 3])
def test_a_constant_record_has_no_cutoff(constant: float) -> None:
    y = np.full((SAMPLES, 2), constant)
    with pytest.raises(ValueError, match="the training samples are constant"):
        choose(y, RATE, WARMUP)
    with pytest.raises(ValueError, match="the training samples are constant"):
        choose_with_simulator(y, y, RATE, WARMUP)
    assert choose(y, RATE, WARMUP, cutoff=1.0).cutoff == 1.0  # for baselines beside it
    assert choose_with_simulator(y, y, RATE, WARMUP, cutoff=1.0).cutoff == 1.0


def test_constant_channels_do_not_count() -> None:
    constants = 9
    y = sine(0.2) + sine(2.0, 0.3) + 0.05 * noise()
    more = np.hstack([y, np.full((SAMPLES, constants), 1013.0)])
    assert choose(more, RATE, WARMUP) == choose(y, RATE, WARMUP)
    y_sim = sine(0.2)
    wrong = np.hstack([y_sim, np.full((SAMPLES, constants), 1010.0)])
    assert choose_with_simulator(more, wrong, RATE, WARMUP) == choose_with_simulator(
        y, y_sim, RATE, WARMUP
    )


def test_a_record_without_a_low_band_gets_the_most_of_it_that_there_is() -> None:
    choice = choose(sine(4.5) + 0.3 * sine(0.2), RATE, WARMUP)
    best = chosen(choice)
    assert best.passed == max(c.passed for c in choice.candidates)
    assert "no cut-off leaves half of the power in the low band" in choice.reason


def test_a_higher_order_is_for_bands_that_order_one_does_not_part() -> None:
    y = sine(0.25) + sine(1.0)
    assert choose(y, RATE, WARMUP, downsampling=4).order == 2
    found = choose(y, RATE, WARMUP, order=1, downsampling=4).candidates
    assert all(c.loss > MOST_LOST or c.passed < LEAST_PASSED for c in found)


def test_a_simulator_has_the_say_up_to_where_it_agrees() -> None:
    """Right at 0.2 Hz, and where it is wrong decides how far up the cut-off goes."""
    cutoffs = []
    for wrong in (0.5, 1.0, 2.0):
        y = sine(0.2) + sine(wrong, 0.5) + sine(4.0, 0.2)
        choice = choose_with_simulator(y, sine(0.2) + sine(wrong, 0.5, 2.0), RATE, WARMUP)
        assert choice.simulator_helps
        cutoffs.append(choice.cutoff)
    assert cutoffs == sorted(cutoffs)
    assert cutoffs[0] < cutoffs[-1]


def test_a_simulator_that_drifts_has_the_say_from_where_it_agrees() -> None:
    """Right at 2 Hz, and a slow error decides how far down the cut-off goes."""
    y, right = sine(0.05) + sine(2.0), sine(2.0) + 3 + 0.01 * TIME[:, None]
    slower, faster = (
        choose_with_simulator(y, right + wrong, RATE, WARMUP, simulator_band="high")
        for wrong in (0, sine(0.3, 0.3))
    )
    assert slower.simulator_helps
    assert faster.simulator_helps
    assert slower.cutoff < faster.cutoff < 2.0
    assert "Hz the simulator misses" in slower.reason


@pytest.mark.parametrize("seed", range(2))
def test_a_simulator_that_knows_nothing_is_said_to_be_no_help(seed: int) -> None:
    choice = choose_with_simulator(sine(0.2) + sine(1.5, 0.5), noise(seed), RATE, WARMUP)
    assert choice.simulator_helps is False
    assert "no band of the simulator is worth using" in choice.reason


def test_an_offset_of_the_simulator_counts() -> None:
    y = sine(0.2) + sine(1.5, 0.5)
    assert choose_with_simulator(y, y + 0.1, RATE, WARMUP).simulator_helps
    assert not choose_with_simulator(y, y + 2.0, RATE, WARMUP).simulator_helps


def test_the_choice_does_not_depend_on_the_unit() -> None:
    unit = 1e6
    y = sine(0.2) + sine(1.5, 0.5) + 0.1 * noise()
    y_sim = sine(0.2, 0.9)
    for one, other in (
        (choose(y, RATE, WARMUP), choose(unit * y, RATE, WARMUP)),
        (
            choose_with_simulator(y, y_sim, RATE, WARMUP),
            choose_with_simulator(unit * y, unit * y_sim, RATE, WARMUP),
        ),
    ):
        assert (one.cutoff, one.order) == (other.cutoff, other.order)
        assert one.reason == other.reason
