"""Sizes, inputs and backends that cannot be: the rule and the value are named."""

from collections.abc import Callable
from typing import Any

import pytest
from torch import nn

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


def test_an_unknown_backend_is_named() -> None:
    unknown: Any = "plian"
    with pytest.raises(ValueError, match=r"backend must .* 'plian'"):
        rollout(gru(), noise(BATCH, WARMUP, NY), STEPS, backend=unknown)


@pytest.mark.parametrize(("make", "steps"), [(lstm, STEPS), (gru, 0)])
def test_a_fused_rollout_that_there_is_not_is_refused(make: Make, steps: int) -> None:
    cell = make()
    with pytest.raises(ValueError, match=rf'backend="fused" needs .* {type(cell).__name__} on cpu'):
        rollout(cell, noise(BATCH, WARMUP, NY), steps, backend="fused")


@pytest.mark.parametrize("shape", [(WARMUP, NY), (BATCH, WARMUP, NY + 1), (BATCH, 0, NY)])
def test_a_warmup_of_a_wrong_shape_is_named(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"y_warmup must be .* ny = 2\), got ") as caught:
        rollout(gru(), noise(*shape), STEPS)
    assert str(caught.value).endswith(f"got {shape}")


def test_negative_steps_are_named() -> None:
    with pytest.raises(ValueError, match="steps must not be negative, got -1"):
        rollout(gru(), noise(BATCH, WARMUP, NY), -1)


@pytest.mark.parametrize("given", [False, True])
def test_inputs_are_given_where_the_cell_takes_any(given: bool) -> None:
    cell = gru(nu=0 if given else NU)
    with pytest.raises(ValueError, match=rf"u must be given exactly .* nu = {cell.nu}$"):
        rollout(cell, noise(BATCH, WARMUP, NY), STEPS, inputs(NU) if given else None)


@pytest.mark.parametrize(
    "shape", [(BATCH, WARMUP + STEPS, NU + 1), (BATCH + 1, WARMUP + STEPS, NU), (WARMUP, NU)]
)
def test_inputs_of_a_wrong_shape_are_named(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"u must be \(batch = 4, time, nu = 3\), got ") as caught:
        rollout(gru(nu=NU), noise(BATCH, WARMUP, NY), STEPS, noise(*shape))
    assert str(caught.value).endswith(f"got {shape}")


@pytest.mark.parametrize("steps", [1, STEPS])
def test_inputs_too_short_are_named(steps: int) -> None:
    rows = WARMUP + steps - 2
    with pytest.raises(ValueError, match=rf"u must cover .* got {rows}$"):
        rollout(gru(nu=NU), noise(BATCH, WARMUP, NY), steps, inputs(NU, rows))


def test_inputs_have_to_cover_the_warmup_even_without_steps() -> None:
    with pytest.raises(ValueError, match=rf"^u must .* got {WARMUP - 1}$"):
        rollout(gru(nu=NU), noise(BATCH, WARMUP, NY), 0, inputs(NU, WARMUP - 1))


def test_a_warmup_too_short_for_the_recognition_is_named() -> None:
    with pytest.raises(ValueError, match="warm-up must have at least 4 samples, got 3"):
        rollout(euler_mlp(), noise(BATCH, 3, NY), STEPS)


@pytest.mark.parametrize(
    ("cell", "name"),
    [
        (GRU, "ny"),
        (GRU, "hidden_size"),
        (EulerMLP, "ny"),
        (EulerMLP, "warmup"),
        (EulerMLP, "state_size"),
        (EulerMLP, "hidden_size"),
        (EulerMLP, "recognition_size"),
        (StateSpace, "ny"),
        (StateSpace, "states"),
        (StateSpace, "layers"),
    ],
)
def test_a_size_below_one_is_named(cell: Callable[..., nn.Module], name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} must be between 1 and \d+, got 0"):
        cell(**{name: 0})


@pytest.mark.parametrize("cell", [GRU, EulerMLP, StateSpace])
def test_a_negative_number_of_inputs_is_named(cell: Callable[..., nn.Module]) -> None:
    with pytest.raises(ValueError, match=r"nu must .* got -1"):
        cell(nu=-1)


def test_a_state_smaller_than_the_observation_is_named() -> None:
    with pytest.raises(ValueError, match="state_size must be at least ny = 3, got 2"):
        EulerMLP(ny=3, state_size=2)
