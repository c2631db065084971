"""Cells and free runs against torch's own layers and loops written out."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from examples.own_cell import LSTM
from splitband.networks import GRU, Backend, Cell, EulerMLP, StateSpace, free_run, rollout
from splitband.runtime.arrays import Array

NY, NU, HIDDEN = 2, 3, 5
BATCH, WARMUP, STEPS = 4, 6, 9
TIGHT = 1e-10


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """Networks this small are slower on several threads, by far where cores are busy."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


class Free(nn.Module):
    """A rollout as a module, so that its parameters can be exchanged."""

    def __init__(self, cell: nn.Module, steps: int, backend: Backend) -> None:
        super().__init__()
        self.cell, self.steps, self.backend = cell, steps, backend

    def forward(self, y_warmup: Tensor, u: Tensor | None) -> Tensor:
        assert isinstance(self.cell, Cell)
        return rollout(self.cell, y_warmup, self.steps, u, self.backend)


def gru(ny: int = NY, nu: int = 0) -> GRU:
    torch.manual_seed(1)
    return GRU(HIDDEN, ny, nu).double()


def euler_mlp(ny: int = NY, nu: int = 0) -> EulerMLP:
    torch.manual_seed(2)
    sizes = {"state_size": 3, "hidden_size": 8, "recognition_size": 7}
    return EulerMLP(ny, WARMUP - 2, step_size=0.3, nu=nu, **sizes).double()


def state_space(ny: int = NY, nu: int = 0) -> StateSpace:
    torch.manual_seed(4)
    return StateSpace(3, HIDDEN, ny, nu).double()


def lstm(ny: int = NY, nu: int = 0) -> LSTM:
    torch.manual_seed(3)
    return LSTM(HIDDEN, ny, nu).double()


CELLS = [gru, euler_mlp, state_space, lstm]
BACKENDS: list[Backend] = ["auto", "plain"]
Make = Callable[..., Any]


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(shape))


def inputs(nu: int, samples: int = WARMUP + STEPS) -> Tensor | None:
    return noise(BATCH, samples, nu, seed=5) if nu else None


def arrays(module: nn.Module) -> dict[str, Array]:
    return {name: p.detach().numpy() for name, p in module.named_parameters()}


def written_layers(layers: nn.Module, x: Array, last: Callable[[Array], Array]) -> Array:
    p = arrays(layers)
    for layer, activation in (("0", np.tanh), ("2", np.tanh), ("4", last)):
        x = activation(x @ p[f"{layer}.weight"].T + p[f"{layer}.bias"])
    return x


@pytest.mark.parametrize(
    ("ny", "nu", "backend"), [(1, 0, "auto"), (NY, NU, "auto"), (1, NU, "plain"), (NY, 0, "plain")]
)
def test_a_gru_rollout_is_a_loop_over_torch_s_own_cell(ny: int, nu: int, backend: Backend) -> None:
    cell, y_warmup, u = gru(ny, nu), noise(BATCH, WARMUP, ny), inputs(nu)
    torchs = nn.GRUCell(ny + nu, HIDDEN).double()
    torchs.load_state_dict(cell.transition.state_dict())
    known = noise(BATCH, WARMUP + STEPS, 0) if u is None else u
    h, samples = torch.zeros(BATCH, HIDDEN, dtype=torch.float64), []
    for n in range(WARMUP + STEPS):
        samples.append(y_warmup[:, n] if n < WARMUP else cell.observation(h))
        h = torchs(torch.cat([samples[-1], known[:, n]], dim=1), h)
    found = rollout(cell, y_warmup, STEPS, u, backend)
    expected = torch.stack(samples[WARMUP:], dim=1)
    torch.testing.assert_close(found, expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize("nu", [0, NU])
@pytest.mark.parametrize("backend", BACKENDS)
def test_an_euler_mlp_rollout_is_euler_s_method_written_out(nu: int, backend: Backend) -> None:
    cell = euler_mlp(nu=nu)
    y_warmup, u = noise(BATCH, WARMUP, NY), inputs(nu)
    known = np.zeros((BATCH, WARMUP + STEPS, 0)) if u is None else u.numpy()
    seen = np.concatenate([y_warmup.numpy(), known[:, :WARMUP]], axis=2)[:, -cell.warmup :]
    h = written_layers(cell.recognition, seen.reshape(BATCH, -1), np.tanh)
    samples = [h[:, :NY]]
    for n in range(WARMUP, WARMUP + STEPS - 1):
        f = written_layers(cell.dynamics, np.hstack([h, known[:, n]]), lambda x: x)
        h = h + 0.3 * f
        samples.append(h[:, :NY])
    found = rollout(cell, y_warmup, STEPS, u, backend).detach().numpy()
    np.testing.assert_allclose(found, np.stack(samples, axis=1), atol=TIGHT, rtol=0)


def test_the_euler_mlp_does_not_look_at_measurements() -> None:
    cell = euler_mlp()
    h = noise(BATCH, 3)
    for y in (noise(BATCH, NY), 100 * noise(BATCH, NY)):
        assert torch.equal(cell.step(h, y), cell.step(h, torch.zeros(BATCH, NY)))
    y = noise(BATCH, WARMUP, NY)
    changed = y.clone()
    changed[:, : WARMUP - cell.warmup] += 1
    assert torch.equal(cell.initial_state(y), cell.initial_state(changed))
    changed[:, WARMUP - cell.warmup] += 1
    assert not torch.equal(cell.initial_state(y), cell.initial_state(changed))


@pytest.mark.parametrize(
    ("make", "nu", "before"),
    [*((make, NU, 4) for make in CELLS), (gru, 0, 1), (gru, NU, STEPS - 1)],
)
def test_a_rollout_equals_two_with_the_state_carried_over(make: Make, nu: int, before: int) -> None:
    cell, y, u = make(nu=nu), noise(BATCH, WARMUP, NY), inputs(nu)
    past = None if u is None else u[:, :WARMUP]
    future = None if u is None else u[:, WARMUP:]
    h = cell.initial_state(y, past)
    first, h = free_run(cell, h, before, future)
    torch.testing.assert_close(cell.observe(h), first[:, -1], atol=TIGHT, rtol=0)
    row = None if future is None else future[:, before - 1]
    h = cell.step(h, cell.observe(h), row)
    second, _ = free_run(cell, h, STEPS - before, None if future is None else future[:, before:])
    together = torch.cat([first, second], dim=1)
    torch.testing.assert_close(together, rollout(cell, y, STEPS, u), atol=TIGHT, rtol=0)


@pytest.mark.parametrize("make", CELLS)
def test_a_rollout_leaves_nothing_behind_in_the_cell(make: Make) -> None:
    cell, y = make(), noise(BATCH, WARMUP, NY)
    attributes = set(vars(cell))
    state = {name: value.clone() for name, value in cell.state_dict().items()}
    once = rollout(cell, y, STEPS)
    rollout(cell, 10 * y, 3)
    assert torch.equal(rollout(cell, y, STEPS), once)
    assert set(vars(cell)) == attributes
    assert all(torch.equal(cell.state_dict()[name], value) for name, value in state.items())


@pytest.mark.parametrize("make", CELLS)
def test_an_input_acts_from_the_next_sample_on(make: Make) -> None:
    cell, y, u = make(nu=NU), noise(BATCH, WARMUP, NY), inputs(NU)
    before = rollout(cell, y, STEPS, u)
    assert torch.equal(rollout(cell, y, STEPS, u[:, :-1]), before)
    assert torch.equal(rollout(cell, y, STEPS, torch.cat([u, u], dim=1)), before)
    for n in range(WARMUP - 1, WARMUP + STEPS):
        changed = u.clone()
        changed[:, n] += 1
        differs = (rollout(cell, y, STEPS, changed) != before).any(dim=2)
        unaffected = n + 1 - WARMUP
        assert not differs[:, :unaffected].any()
        assert differs[:, unaffected:].all()


@pytest.mark.parametrize("make", CELLS)
@pytest.mark.parametrize("nu", [0, NU])
@pytest.mark.parametrize("backend", BACKENDS)
def test_gradients_reach_the_warmup_the_inputs_and_every_parameter(
    make: Make, nu: int, backend: Backend
) -> None:
    free = Free(make(nu=nu), 3, backend)
    names = [name for name, _ in free.named_parameters()]
    y = noise(2, WARMUP - 2, NY).requires_grad_()
    u = noise(2, WARMUP, nu, seed=1).requires_grad_() if nu else None

    def run(y: Tensor, u: Tensor | None, *parameters: Tensor) -> Tensor:
        exchanged = dict(zip(names, parameters, strict=True))
        result: Tensor = torch.func.functional_call(free, exchanged, (y, u))
        return result

    arguments: tuple[Tensor | None, ...] = (y, u, *free.parameters())
    assert torch.autograd.gradcheck(run, arguments, fast_mode=True)


class Damped(GRU):
    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        return 0.5 * super().step(h, y, u)


class Squashed(GRU):
    def observe(self, h: Tensor) -> Tensor:
        return torch.tanh(super().observe(h))


def altered(how: str) -> GRU:
    cell = GRU(HIDDEN, NY)
    if how == "other observation":
        cell.observation = nn.Sequential(nn.Linear(HIDDEN, NY), nn.Tanh())  # type: ignore[assignment]
    elif how == "no bias":
        cell.transition = nn.GRUCell(NY, HIDDEN, bias=False)
    elif how == "hook":
        cell.transition.register_forward_hook(lambda _, __, h: 0.5 * h)
    else:
        cell = {"own step": Damped, "own observe": Squashed}[how](HIDDEN, NY)
    return cell.double()


@pytest.mark.parametrize("how", ["own step", "own observe", "other observation", "no bias", "hook"])
def test_the_backend_never_changes_what_an_altered_gru_predicts(how: str) -> None:
    cell, y = altered(how), noise(BATCH, WARMUP, NY)
    expected = rollout(cell, y, STEPS, backend="plain")
    torch.testing.assert_close(rollout(cell, y, STEPS), expected, atol=TIGHT, rtol=0)
