"""The end of a training by Levenberg-Marquardt."""

from typing import Any

import numpy as np
import pytest
import scipy
import torch

from splitband import ComplementaryPair, Record, StateSpace, TrainingSettings
from splitband.models import (
    FilteredHighModel,
    FilteredModel,
    Model,
    Recurrent,
    ResidualModel,
    Signals,
    SplitModel,
    Task,
)
from splitband.runtime.deadlines import NEVER, Deadline
from splitband.training.levenberg import FEWEST, Levenberg, Windows
from splitband.training.network import NetworkTraining
from splitband.training.windows import select, windows, windows_in

PAIR = ComplementaryPair.butterworth(0.05, 1.0, order=2)
WARMUP, STEPS = 12, 40


def cell(nu: int = 0) -> StateSpace:
    found = StateSpace(2, 3, 1, nu, encoded=2)
    for weight in found.parameters():
        weight.data += 0.1 * torch.randn_like(weight)
    return found


def models() -> list[Model]:
    torch.manual_seed(0)
    return [
        Recurrent(cell()),
        ResidualModel(cell(2), conditioned=True),
        FilteredModel(cell(2), PAIR.one_way(), conditioned=True),
        FilteredHighModel(cell(), PAIR.one_way(), 3),
        SplitModel([cell(), cell()], PAIR, 3, filter_output=True),
        SplitModel([cell(), cell(2)], PAIR, 3, conditioned=True),
    ]


def windows_of(task: Task, gap: bool = False) -> Windows:
    """Three windows of a task; if there are gaps, a third of their samples was not measured."""
    known, target = windows(task, WARMUP + STEPS, WARMUP)
    chosen = torch.tensor([0, 7, 30])
    known, target = select(known, chosen), target[chosen]
    return Windows(known, target, torch.rand_like(target) > 1 / 3 if gap else None)


@pytest.mark.parametrize("model", models(), ids=lambda model: type(model).__name__)
def test_the_gradient_is_that_of_torch(model: Model) -> None:
    """Through the filters and the interpolation of each model, too."""
    model = model.double()
    signals = Signals(torch.randn(90, 1).double(), y_sim=torch.randn(90, 1).double())
    for task in model.tasks(signals):
        some = windows_of(task, gap=True)
        weights = [*task.network.parameters()]
        point = Levenberg(task, some, 0.01, Deadline())._differentiated()
        assert some.measured is not None
        left = (task.simulate(some.known, some.target.shape[1]) - some.target)[some.measured]
        error = left.square().mean() + 0.01 * sum(
            w.square().sum()
            for w in task.network.penalised()  # type: ignore[operator]
        )
        assert point.mean_square == pytest.approx(error.item(), rel=1e-12)
        wanted = torch.cat([g.flatten() for g in torch.autograd.grad(error, weights)])
        np.testing.assert_allclose(2 * point.gradient, wanted.numpy(), rtol=1e-9, atol=1e-12)


def test_it_finds_the_minimum_that_scipy_finds() -> None:
    torch.manual_seed(1)
    model = Recurrent(cell(1)).double()
    u = torch.randn(1, 400, 1).double()
    truth = cell(1).double()
    with torch.no_grad():
        y = Recurrent(truth).components(Signals(torch.zeros(1, 4, 1).double(), u), 396)["network"]
    y = torch.cat([torch.zeros(1, 4, 1), y + 0.01 * torch.randn_like(y)], dim=1)
    known = Signals(y[:, :4], u)
    (task,) = model.tasks(Signals(y[0], u[0]))
    finish = Levenberg(task, Windows(known, y[:, 4:], None), 0.0, Deadline())
    errors: list[float] = []
    while not finish.settled and len(errors) < 200:
        errors.append(finish.round())
    assert errors == sorted(errors, reverse=True)  # a round never raises the error
    reached = finish._weights()

    def left(weights: Any) -> Any:
        finish._put(weights)
        return finish._errors().ravel()

    expected = scipy.optimize.least_squares(left, reached, method="lm")
    assert errors[-1] ** 2 == pytest.approx(2 * expected.cost / 396, rel=0.05)
    assert errors[-1] == pytest.approx(0.01, rel=0.2)  # the noise
    assert errors[-1] < 0.05 * errors[0]


@pytest.mark.parametrize("pole", [1.4, 1e8])
def test_where_a_state_grows_without_bound_the_error_does_not(pole: float) -> None:
    """With the larger pole the error, and its derivatives, are not finite to begin with."""
    torch.manual_seed(0)
    model = Recurrent(cell()).double()
    with torch.no_grad():
        model.cell.transition.weight[:, :2] = pole * torch.eye(2)  # type: ignore[attr-defined]
    (task,) = model.tasks(Signals(torch.randn(90, 1).double()))
    finish = Levenberg(task, windows_of(task), 0.0, Deadline())
    before = finish._weights()
    first = finish._mean_square(before)
    for _ in range(5):
        finish.round()
    assert finish.settled == np.isinf(first)
    assert finish._mean_square(finish._weights()) < first or finish.settled
    assert np.isfinite(finish._weights()).all()


def a_record(samples: int) -> Record:
    u = np.random.default_rng(0).standard_normal((samples, 1))
    y = scipy.signal.lfilter([0.0, 0.3], [1.0, -0.7], u + 0.1 * u**2, axis=0)
    return Record(y, 1.0, u=u)


def training(
    samples: int, template: StateSpace, driven: bool = True, deadline: Deadline = NEVER
) -> NetworkTraining:
    record = a_record(samples)
    torch.manual_seed(0)
    model = Recurrent(template.sized(1, 2, WARMUP), feedthrough=True)
    model.adapt_to([record])
    settings = TrainingSettings(
        window=50, warmup=WARMUP, epochs=1, max_batches=2, lbfgs_iterations=60
    )
    (task,) = model.tasks(model.normalised(record))
    chosen = windows_in([record], 50, WARMUP)
    return NetworkTraining(task, chosen, settings, 0, deadline, driven)


@pytest.mark.parametrize(
    ("samples", "template", "driven", "trained"),
    [
        (FEWEST, StateSpace(2, 2), True, True),
        (FEWEST - 1, StateSpace(2, 2), True, False),
        (800, StateSpace(6, 15), True, False),  # it has 630 weights
        (1000, StateSpace(6, 15), True, True),
        (4000, StateSpace(2, 2, layers=2), True, False),
        (4000, StateSpace(2, 2), False, False),
    ],
)
def test_it_trains_networks_with_inputs_a_kernel_and_enough_samples(
    samples: int, template: StateSpace, driven: bool, trained: bool
) -> None:
    found = training(samples, template, driven)
    while not found.over:
        found.advance()
    assert isinstance(found.finish, Levenberg) == trained
    assert len(found.losses) == 4  # an epoch, and three rounds
    found.end()
    assert {p.dtype for p in found.task.network.parameters()} == {torch.float32}


def test_at_the_deadline_it_ends_with_the_best_weights() -> None:
    found = training(4000, StateSpace(2, 2))
    for _ in range(2):
        found.advance()
    assert isinstance(found.finish, Levenberg)
    before = found.finish._weights()
    found.deadline = found.finish._deadline = Deadline(0.0)
    assert found.finish.round() == pytest.approx(found.losses[-1])
    assert found.finish.cut
    np.testing.assert_array_equal(found.finish._weights(), before)
