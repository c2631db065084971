"""The end of a training by L-BFGS."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
import torch
from torch import Tensor, nn

from splitband import Record, Single, StateSpace, TrainingSettings
from splitband.runtime.deadlines import Deadline
from splitband.training import fit, lbfgs
from splitband.training.lbfgs import Lbfgs, end_to_end
from tests.signals import SETUP, TRAIN, holed, record, standing_in
from tests.streams import Leaky
from tests.support import slowed, untrained
from tests.training.support import RECIPE, parameters, trained

FINISHED = replace(RECIPE, epochs=1, lbfgs_iterations=50)


def rosenbrock(at: nn.Parameter) -> Tensor:
    return (100 * (at[1:] - at[:-1] ** 2) ** 2 + (1 - at[:-1]) ** 2).sum()


def run(finish: Lbfgs, rounds: int = 30) -> list[float]:
    found: list[float] = []
    while not finish.settled and len(found) < rounds:
        found.append(finish.round())
    return found


def test_it_finds_the_minimum_that_scipy_finds() -> None:
    begin = np.array([-1.2, 1.0, 0.5, 2.0])
    at = nn.Parameter(torch.tensor(begin))
    losses = run(Lbfgs([at], lambda: rosenbrock(at)))
    assert losses == sorted(losses, reverse=True)  # a round never raises the error
    expected = scipy.optimize.minimize(scipy.optimize.rosen, begin, method="BFGS", tol=1e-10).x
    np.testing.assert_allclose(at.detach().numpy(), expected, atol=1e-5)


def test_where_the_error_is_not_finite_the_weights_stay() -> None:
    at = nn.Parameter(torch.tensor([3.0], dtype=torch.float64))

    def fails_below_two() -> Tensor:
        return torch.where(at > 2, at**2, torch.nan * at).sum()

    finish = Lbfgs([at], fails_below_two)
    run(finish)
    assert finish.settled
    assert at.item() > 2


def test_a_first_step_that_ends_at_an_infinite_slope_is_made_shorter() -> None:
    """As where a slow state grows without bound: the error is finite there, its slope is not."""
    w = nn.Parameter(torch.zeros(1))

    def grows_without_bound() -> Tensor:
        return torch.sum(1000 * (w - 1) ** 2 + torch.exp(1e5 * (w - 0.99912)))

    finish = Lbfgs([w], grows_without_bound)
    for _ in range(3):
        error = finish.round()
    assert error < 1
    assert w.item() == pytest.approx(0.999, abs=0.02)


@pytest.mark.parametrize("halved", [0, 10_000])
@pytest.mark.parametrize(("window", "warmup"), [(10, 3), (7, 6)])
@pytest.mark.parametrize("pieces", [[57], [40, 40, 40], [25, 57, 10], [12, 10, 11]])
def test_every_sample_after_a_warmup_is_in_a_window_before_a_gap_or_an_end_too(
    pieces: list[int], window: int, warmup: int, halved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lbfgs, "MAX_WINDOWS_WITH_OVERLAP", halved)
    begins = np.cumsum([0, *pieces[:-1]])
    starts = [b + np.arange(n - window + 1) for b, n in zip(begins, pieces, strict=True)]
    chosen = end_to_end(torch.from_numpy(np.concatenate(starts)), window, warmup, 10_000)
    predicted = {n for start in chosen.tolist() for n in range(start + warmup, start + window)}
    wanted = [range(b + warmup, b + n) for b, n in zip(begins, pieces, strict=True)]
    assert predicted == {n for piece in wanted for n in piece}


def test_of_a_long_record_some_windows_are_left_out_evenly() -> None:
    chosen = end_to_end(torch.arange(991), 10, 0, 100)
    assert len(chosen) == 10
    assert chosen[0] == 0
    assert chosen[-1] == 990
    assert np.ptp(np.diff(chosen.numpy())) <= 10


def test_it_gets_further_than_as_many_epochs() -> None:
    """By the mean square of the whole, not of some windows; at the end, not on average."""
    _, by_adam = trained(replace(RECIPE, epochs=4))
    _, finished = trained(replace(FINISHED, epochs=1, lbfgs_iterations=60))
    for name, losses in finished.losses.items():
        assert len(losses) <= 4
        assert losses[-1] < 0.9 * by_adam.losses[name][-1]


def test_where_rounding_ends_the_descent_in_float32_it_goes_on_in_float64() -> None:
    """Without noise, the error is otherwise a hundred times as large."""
    u = np.random.default_rng(0).standard_normal(200)
    y = scipy.signal.lfilter([0, 0.1], [1, -1.6, 0.8], np.tanh(u))
    recipe = TrainingSettings.paper(60, 20, 1, 16, lbfgs_iterations=1000)
    fitted = Single(StateSpace(2, 2), recipe).fit(Record(y, 0.1, u=u), seed=0)
    assert fitted.require_fitted().report.losses["network"][-1] < 1e-5
    assert {weight.dtype for weight in fitted.model.parameters()} == {torch.float32}


class InFloat32(Leaky):
    """A cell of a user's own that makes tensors without asking for their precision."""

    def __init__(self, ny: int = 1, nu: int = 0) -> None:
        super().__init__(ny, nu)
        self.remember = nn.Linear(ny, ny)

    def sized(self, ny: int, nu: int, warmup: int) -> "InFloat32":
        return InFloat32(ny, nu)

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        return torch.zeros(len(y_warmup), self.ny)

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        return torch.tanh(self.remember(h) + self.mix(y))


def test_a_cell_that_computes_in_float32_alone_ends_where_it_settles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lbfgs, "CONVERGED", 1.0)
    fitted = Single(InFloat32(), replace(RECIPE, epochs=1, lbfgs_iterations=200)).fit(
        record()[:TRAIN]
    )
    assert len(fitted.require_fitted().report.losses["network"]) == 3  # an epoch and two rounds
    assert len(fitted.predict(10)) == 10


def test_what_was_not_measured_counts_for_nothing() -> None:
    y = holed(record()[:TRAIN].y, slice(40, 44), 61)
    models = []
    for value in (-50.0, 50.0):
        training = standing_in(y, value)
        model = untrained("gru", training, SETUP, 3)
        fit(model, training, FINISHED)
        models.append(model)
    assert torch.equal(parameters(models[0]), parameters(models[1]))


def test_a_round_that_a_deadline_cuts_keeps_the_best_weights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = slowed(monkeypatch, 1.0)
    at = nn.Parameter(torch.tensor([-1.2, 1.0], dtype=torch.float64))
    before = float(rosenbrock(at).detach())
    finish = Lbfgs([at], lambda: rosenbrock(at), Deadline(clock.at + 12))
    reached = finish.round()
    assert finish.cut
    assert reached == pytest.approx(float(rosenbrock(at).detach()) ** 0.5)
    assert reached**2 < before
