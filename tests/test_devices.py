"""Batches of nothing, and models on a GPU."""

import pickle  # noqa: TID251  as between processes

import numpy as np
import pytest
import torch

from splitband import GRU, Record, Single, TrainingSettings, compare
from splitband.comparison.methods import Sizes
from splitband.forecasters.bands import Bands
from splitband.models import Signals, Task
from splitband.networks import Backend, EulerMLP, rollout
from splitband.training import fit
from splitband.training.windows import targets
from tests.signals import Setup
from tests.support import simulated, untrained

SETTINGS = TrainingSettings.paper(30, 10, 2, 16)
SETUP = Setup(80, SETTINGS, bands=Bands(0.6, 1, 2), sizes=Sizes(hidden_high=4, hidden_low=3))
gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")


@pytest.mark.parametrize("nu", [0, 2])
@pytest.mark.parametrize("kind", ["gru", "euler"])
@pytest.mark.parametrize("backend", ["plain", "fused"])
def test_a_batch_of_nothing_has_gradients_of_zero(kind: str, nu: int, backend: Backend) -> None:
    cell = GRU(3, 1, nu) if kind == "gru" else EulerMLP(1, 4, 2, 5, 5, nu=nu)
    y = torch.zeros(0, 4, 1, requires_grad=True)
    found = rollout(cell, y, 6, torch.zeros(0, 10, nu) if nu else None, backend)
    assert found.shape == (0, 6, 1)
    found.sum().backward()
    for parameter in cell.parameters():
        assert not parameter.grad.any()


def test_what_was_measured_lies_where_the_target_does() -> None:
    """On a device without memory, as a GPU is not everywhere."""
    y = torch.zeros(40, 1, device="meta")
    task = Task("network", GRU(3, 1), Signals(y), y, lambda known, steps: (known.y, steps, None))
    assert targets(torch.ones(40, 1, dtype=torch.bool), task, 30, 10).device == y.device


def record(gaps: bool) -> Record:
    t = 0.1 * np.arange(120)[:, None]
    y = np.sin(1.3 * t) + 0.1 * np.random.default_rng(0).standard_normal(t.shape)
    if gaps:
        y[[25, 60]] = np.nan
    return Record.with_gaps(y, 0.1, y_sim=np.sin(1.3 * t))


@gpu
@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("method", ["gru", "split-gru-conditioned", "filtered-gru-conditioned"])
def test_a_model_on_a_gpu_is_trained_and_takes_and_gives_arrays(method: str, gaps: bool) -> None:
    found = []
    for device in ("cpu", "cuda"):
        r = record(gaps)
        model = untrained(method, r, SETUP, seed=0).to(device)
        fit(model, r[:80], SETTINGS)
        y_sim = r.y_sim[70:] if "filtered" in method and r.y_sim is not None else None
        found.append(simulated(model, r.y[70:80], 40, y_sim=y_sim))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-2, atol=1e-2)


def test_a_process_is_sent_a_model_on_the_cpu_and_puts_it_on_its_device() -> None:
    """A GPU's tensors cannot be sent on; a device without memory stands for it here."""
    fitted = Single(GRU(3), SETTINGS).fit(record(gaps=False))
    values = pickle.dumps(fitted)
    fitted._device = torch.device("meta")
    sent = pickle.dumps(fitted)
    assert len(sent) == pytest.approx(len(values), abs=100)  # the weights are in it
    found = pickle.loads(sent)
    assert {p.device.type for p in found.model.parameters()} == {"meta"}


@gpu
def test_trainings_on_a_gpu_go_on_in_other_processes() -> None:
    result = compare(
        record(gaps=False), 80, ["gru", "mean"], rounds=2, seeds=2, device="cuda", cores=2
    )
    assert "gru" in result.medians
