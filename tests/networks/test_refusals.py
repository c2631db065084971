"""Sizes, inputs and backends that cannot be: the rule and the value are named."""

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from splitband.networks import GRU, EulerMLP, StateSpace, rollout
from tests.networks.test_rollout import (
    BATCH,
    NU,
    NY,
    STEPS,
    WARMUP,
    Make,
    euler_mlp,
    gru,
    inputs,
    lstm,
    noise,
)


@pytest.mark.parametrize(("make", "steps"), [(lstm, STEPS), (gru, 0)])
def test_a_fused_rollout_that_there_is_not_is_refused(make: Make, steps: int) -> None:
    cell = make()
    with pytest.raises(ValueError, match=rf'backend="fused" needs .* {type(cell).__name__} on cpu'):
        rollout(cell, noise(BATCH, WARMUP, NY), steps, backend="fused")


@pytest.mark.parametrize("given", [False, True])
def test_inputs_are_given_where_the_cell_takes_any(given: bool) -> None:
    cell = gru(nu=0 if given else NU)
    with pytest.raises(ValueError, match=rf"u must be given exactly .* nu = {cell.nu}$"):
        rollout(cell, noise(BATCH, WARMUP, NY), STEPS, inputs(NU) if given else None)


def rolled(cell: Any, shape: tuple[int, ...], steps: int = STEPS, u: Any = None, **of: Any) -> Any:
    return lambda: rollout(cell, noise(*shape), steps, u, **of)


WARM = (BATCH, WARMUP, NY)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (rolled(gru(), WARM, backend="plian"), r"backend must .* 'plian'"),
        (rolled(gru(), WARM, -1), "steps must not be negative, got -1"),
        (rolled(gru(), (WARMUP, NY)), r"y_warmup must be .* ny = 2\), got \(6, 2\)$"),
        (rolled(gru(), (BATCH, 0, NY)), r"y_warmup must be .* ny = 2\), got \(4, 0, 2\)$"),
        (
            rolled(gru(nu=NU), WARM, u=noise(BATCH + 1, 15, NU)),
            r"u must be \(batch = 4, time, nu = 3\), got \(5, 15, 3\)$",
        ),
        (rolled(gru(nu=NU), WARM, 0, inputs(NU, WARMUP - 1)), "^u must .* got 5$"),
        (rolled(gru(nu=NU), WARM, STEPS, inputs(NU, WARMUP + STEPS - 2)), "^u must .* got 13$"),
        (rolled(euler_mlp(), (BATCH, 3, NY)), "warm-up must have at least 4 samples, got 3"),
        (
            rolled(StateSpace(2, 3, encoded=5).double(), (1, 4, 1), 3),
            "must have at least 5 samples, got 4",
        ),
        (lambda: EulerMLP(ny=3, state_size=2), "state_size must be at least ny = 3, got 2"),
        (lambda: StateSpace(2, -1), "hidden must not be negative, got -1"),
        (lambda: StateSpace(3, 6, layers=9999), "layers must be between 1 and 100, got 9999"),
        *((partial(cell, nu=-1), "nu must .* got -1") for cell in (GRU, EulerMLP, StateSpace)),
        *(
            (partial(cell, **{name: 0}), rf"{name} must be between 1 and \d+, got 0")
            for cell, names in (
                (GRU, "ny hidden_size"),
                (EulerMLP, "ny warmup state_size hidden_size recognition_size"),
                (StateSpace, "ny states layers"),
            )
            for name in names.split()
        ),
    ],
)
def test_what_cannot_be_is_named(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        call()
