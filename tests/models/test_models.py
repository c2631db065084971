"""What models promise: no look into the future, parts that add up, units that do not matter."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal
import torch
from torch import Tensor

from splitband import GRU, ComplementaryPair, Record
from splitband.comparison.backtest import first_origin
from splitband.filters import butterworth
from splitband.forecasters.held_out import Origin
from splitband.models import FilteredModel, Model, Recurrent, ResidualModel, Signals, SplitModel
from splitband.training import fit
from tests.signals import DT, LENGTH, SETUP, TRAIN, WARMUP, record
from tests.support import Scripted, asked, simulated, untrained, with_other_samples


def y_sim_of(trajectory: Record) -> npt.NDArray[np.float64]:
    return trajectory.y_sim


BANDS = [ComplementaryPair.butterworth(cutoff, 1 / DT, 2) for cutoff in (0.3, 0.9)]


def trained(method: str, trajectory: Record) -> Model:
    model = untrained(method, trajectory, SETUP, seed=1)
    fit(model, trajectory[:TRAIN], SETUP.settings, seed=1)
    return model


NAMES = [
    *("gru", "state-space", "split-gru", "split-gru-hp", "split-gru-conditioned"),
    *("residual-gru", "filtered-gru-conditioned", "filtered-high-gru-conditioned"),
]
"""One of each kind of model."""


@cache
def model_of(method: str) -> Model:
    """Trained on the record's first samples, once in a process."""
    return trained(method, record())


def predict(model: Model, r: Record, begin: int, start: int) -> dict[str, Any]:
    """Warm up on `begin`..`start - 1`, simulate to the end of the record; by component."""
    u, y_sim = (None if s is None else s[begin:] for s in (r.u, r.y_sim))
    return model.simulate_components(r.y[begin:start], len(r) - start, u, y_sim)


@pytest.mark.parametrize(
    ("method", "start"),
    [*((name, TRAIN + 7) for name in NAMES), ("split-gru", WARMUP), ("residual-gru", TRAIN)],
)
def test_a_prediction_sees_the_samples_of_its_warm_up_and_no_other(method: str, start: int) -> None:
    def predicted(trajectory: Record) -> npt.NDArray[np.float64]:
        parts = predict(model_of(method), trajectory, start - WARMUP, start)
        return np.concatenate([*parts.values()])

    expected = predicted(record())
    np.testing.assert_array_equal(predicted(with_other_samples(record(), start)), expected)
    np.testing.assert_array_equal(
        predicted(with_other_samples(record(), 0, start - WARMUP)), expected
    )
    # Of the last samples, one that is filtered forwards and down-sampled sees one in k.
    seen = 2 if "high" in method else 1
    assert not np.array_equal(predicted(with_other_samples(record(), start - seen)), expected)


# Of the models on a fitted base one for each kind: choosing their bands takes seconds.
ON_A_BASE = ("filtered-linear-gru-conditioned", "residual-periodic-gru")


@pytest.mark.parametrize(
    "method",
    ["seasonal-naive", "linear", "simulator-calibrated", "split-gru-conditioned", *ON_A_BASE],
)
def test_no_method_learns_from_samples_after_the_training_part(method: Any) -> None:
    given, later = record(nu=1 if "linear" in method else 0), TRAIN + 5
    expected = asked(method, given, SETUP, later=[later]).forecasts
    found = asked(method, with_other_samples(given, TRAIN), SETUP).forecasts
    for origin in (first_origin(given, TRAIN, WARMUP), Origin(TRAIN, TRAIN)):
        np.testing.assert_array_equal(found[origin].y, expected[origin].y)
    found = asked(method, with_other_samples(given, later), SETUP, later=[later]).forecasts
    origin = Origin(TRAIN, later)
    np.testing.assert_array_equal(found[origin].y, expected[origin].y)


@pytest.mark.parametrize("kind", ["split", "filtered", "residual"])
def test_the_parts_of_a_simulation_add_up_in_the_units_of_the_record(kind: str) -> None:
    """Scripted networks say what is left of a known signal, in multiples of its deviation."""
    n = torch.arange(LENGTH, dtype=torch.float64)[:, None]
    slow, fast = torch.sin(n / 15), 0.3 * torch.sin(n / 2)
    y, y_sim = (3.0 + 2.0 * signal for signal in (slow + fast, slow))
    ahead = [signal[WARMUP:] for signal in (slow, fast)]
    model: Model
    if kind == "split":
        cells = [Scripted(signal, 0) for signal in ahead]
        model = SplitModel(cells, ComplementaryPair.butterworth(0.8, 10.0), downsampling=1)
    elif kind == "residual":
        model = ResidualModel(Scripted(ahead[1], 0))
    else:
        y_sim = y
        model = _filtered(ahead[0] + ahead[1], order=1)
    model = model.double()
    model.y_mean.fill_(3.0)
    model.y_std.fill_(2.0)
    warm, steps = y[:WARMUP].numpy(), LENGTH - WARMUP
    found = simulated(model, warm, steps, y_sim=y_sim.numpy())
    np.testing.assert_allclose(found, y[WARMUP:].numpy(), rtol=0, atol=1e-12)
    first, other = model.simulate_components(warm, steps, y_sim=y_sim.numpy()).values()
    np.testing.assert_allclose(first + other, found, rtol=0, atol=1e-12)
    if kind != "filtered":
        np.testing.assert_allclose(first, (3.0 + 2.0 * ahead[0]).numpy(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", NAMES)
def test_a_batch_is_simulated_like_each_of_its_members(method: Any) -> None:
    model = model_of(method)
    members = [model.normalised(record(seed=s)) for s in range(3)]

    def of(chosen: Any) -> Tensor:
        y = torch.stack([each.y[:WARMUP] for each in chosen])
        y_sim = torch.stack([each.y_sim for each in chosen])
        with torch.no_grad():
            parts = model.components(Signals(y, y_sim=y_sim), 40)
        return torch.stack([*parts.values()]).sum(dim=0)

    for each, found in zip(members, of(members), strict=True):
        torch.testing.assert_close(found, of([each])[0], atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("method", "unit", "offset"),
    [
        *((name, 1e3, 5e6) for name in NAMES),
        ("split-gru-conditioned", 1e60, 0.0),
        ("residual-gru", 1e-60, 0.0),
    ],
)
def test_units_do_not_matter(method: Any, unit: float, offset: float) -> None:
    """Not even those whose numbers are no float32."""
    r = record()
    other = replace(r, y=unit * r.y + offset, y_sim=unit * y_sim_of(r) + offset)
    expected = predict(model_of(method), r, 0, WARMUP)
    found = predict(trained(method, other), other, 0, WARMUP)
    for i, (name, part) in enumerate(expected.items()):
        shift = 0.0 if i else offset  # the first part carries the mean
        np.testing.assert_allclose((found[name] - shift) / unit, part, atol=2e-3)


def test_the_low_network_predicts_the_samples_it_is_up_sampled_to() -> None:
    """A network that knows the low band exactly gives it back, up to linear interpolation."""
    t = torch.arange(400, dtype=torch.float64)[:, None]
    slow = torch.sin(2 * torch.pi * t / 200)
    for k in (2, 3, 5):
        for warmup in (30, 31, 32):
            low = Scripted(slow[warmup % k :: k], after=(warmup - warmup % k) // k)
            high = Scripted(torch.zeros(400, 1, dtype=torch.float64), after=0)
            model = SplitModel(
                [low, high], ComplementaryPair.butterworth(0.8, 10.0), downsampling=k
            )
            found = model.double().components(Signals(slow[None, :warmup]), 101)["low band"]
            torch.testing.assert_close(found[0], slow[warmup : warmup + 101], rtol=0, atol=4e-3)


def told_of(slow: Tensor, scale: float, driven: bool = False) -> Tensor:
    """Value and slope of a signal `(time, 1)`, each row one sample ahead.

    The slope is from the neighbours, or for a system with inputs from the sample before alone.
    """
    slope = torch.gradient(slow, dim=0)[0]
    if driven:
        slope[1:] = slow[1:] - slow[:-1]
    return torch.cat([slow, slope / scale], dim=1)[1:]


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_high_network_of_a_conditioned_split_is_told_of_the_low_bands_prediction(
    k: Any,
) -> None:
    t = torch.arange(400, dtype=torch.float64)[:, None]
    slow, warmup, steps = torch.sin(t / 30), 31, 41
    low = Scripted(slow[warmup % k :: k], after=(warmup - warmup % k) // k)
    high = Scripted(torch.zeros_like(t), 0, nu=2)
    pair = ComplementaryPair.butterworth(0.8, 10.0)
    model = SplitModel([low, high], pair, k, conditioned=True).double()
    model.slope_scale.fill_(0.25)
    known = Signals(slow[None, :warmup] + 0.3)
    # The slope at the last sample is that between its neighbours, too.
    longer = model.components(known, steps + 1)["low band"][0]
    predicted = model.components(known, steps)["low band"][0]
    torch.testing.assert_close(predicted, slow[warmup : warmup + steps], rtol=0, atol=2e-3)
    whole = torch.cat([pair.lowpass(known.y)[0], longer])
    found = torch.cat(high.inputs)
    torch.testing.assert_close(found, told_of(whole, 0.25)[:-1], rtol=0, atol=1e-12)


def test_in_training_the_high_network_is_told_of_the_low_bands_prediction_too() -> None:
    low = Scripted(torch.linspace(-1, 1, 90, dtype=torch.float64)[:, None], after=15)
    high = Scripted(torch.zeros(90, 1, dtype=torch.float64), 0, nu=2)
    model = SplitModel([low, high], BANDS[1], 2, conditioned=True).double()
    task = model.tasks(Signals(torch.tensor(record().y)))[1]
    window = Signals(torch.tensor(record().y[None, :30]))
    trained = task.simulate(window, 41)
    inputs = high.inputs
    simulated = model.components(window, 41)["high band"]
    assert torch.equal(trained, simulated)
    assert torch.equal(torch.cat(inputs), torch.cat(high.inputs))
    assert not torch.cat(inputs).requires_grad


@pytest.mark.parametrize("nu", [0, 1])
@pytest.mark.parametrize("kind", ["filtered", "residual"])
def test_the_network_of_a_conditioned_hybrid_is_told_of_the_simulator_behind_its_inputs(
    kind: Any, nu: Any
) -> None:
    """Of the whole simulator, in training as in simulation, and not of its low band."""
    r, steps = record(nu=nu), 60
    cell = Scripted(torch.zeros(LENGTH, 1, dtype=torch.float64), 0, nu + 2)
    pair = ComplementaryPair.perfect(*butterworth(0.5, 10.0), 10.0)
    hybrid = FilteredModel(cell, pair, True) if kind == "filtered" else ResidualModel(cell, True)
    model = hybrid.double()
    model.slope_scale.fill_(0.1)
    y_sim, end = torch.tensor(y_sim_of(r)), WARMUP + steps
    u = None if r.u is None else torch.tensor(r.u)
    model.components(
        Signals(
            torch.tensor(r.y[None, :WARMUP]),
            None if u is None else u[None, :end],
            y_sim[None, : end + 1],
        ),
        steps,
    )
    expected = told_of(y_sim, 0.1, driven=nu > 0)[: end - 1]
    if u is not None:
        expected = torch.cat([u[: end - 1], expected], dim=1)
    torch.testing.assert_close(torch.cat(cell.inputs), expected, rtol=0, atol=1e-12)
    (task,) = model.tasks(Signals(torch.tensor(r.y), u, y_sim))
    torch.testing.assert_close(task.known.u[: end - 1], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["split-gru-conditioned", "residual-gru-conditioned"])
def test_slopes_have_unit_deviation_over_the_training_record(name: Any) -> None:
    r = record(ny=2)
    model = untrained(name, r, SETUP, seed=0)
    model.adapt_to([r[:TRAIN]])
    slow = y_sim_of(r)[:TRAIN] if "residual" in name else r.y[:TRAIN]
    slow = (slow - r.y[:TRAIN].mean(axis=0)) / r.y[:TRAIN].std(axis=0)
    if "split" in name:
        b, a = butterworth(0.6, r.sampling_rate, 2)
        slow = scipy.signal.filtfilt(b, a, slow, axis=0)
    expected = np.gradient(slow, axis=0).std(axis=0, ddof=1)
    found = model.get_buffer("slope_scale").numpy().ravel()
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def _filtered(script: Tensor, order: int, conditioned: bool = False) -> FilteredModel:
    b, a = butterworth(0.5, 20.0, order)
    cell = Scripted(script, 0, nu=2 if conditioned else 0)
    return FilteredModel(cell, ComplementaryPair.perfect(b, a, 20.0), conditioned).double()


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("slow", ["constant", "ramp"])
def test_the_low_band_of_the_network_cannot_move_the_hybrid_prediction(
    order: Any, slow: Any, conditioned: Any
) -> None:
    """What reaches the result is the high-pass filter's response to what was added, no more."""
    steps, warmup = 1500, 20
    n = torch.arange(steps, dtype=torch.float64)[:, None]
    added = 5.0 * torch.ones_like(n) if slow == "constant" else 0.01 * n
    detail = torch.sin(2 * torch.pi * n * 4 / 20)
    y_sim = torch.sin(2 * torch.pi * torch.arange(warmup + steps).double() / 300)[None, :, None]
    known = Signals(y_sim[:, :warmup] + 0.1, y_sim=y_sim)
    without, with_added = (
        torch.stack([*_filtered(script, order, conditioned).components(known, steps).values()])
        .sum(dim=0)[0, :, 0]
        .detach()
        .numpy()
        for script in (detail, detail + added)
    )
    pair = _filtered(detail, order).pair
    response = scipy.signal.lfilter(pair.b_high, pair.a, added[:, 0].numpy())
    np.testing.assert_allclose(with_added - without, response, atol=1e-9)
    # A constant dies out; a ramp leaves at most its slope over the cut-off's angular frequency,
    # times the order.
    settled = np.abs((with_added - without)[-200:]).max()
    bound = 1e-6 if slow == "constant" else order * 0.01 * 20.0 / (2 * np.pi * 0.5) * 1.01
    assert settled < bound


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: simulated(Recurrent(GRU(4, 1)), np.zeros((5, 2)), 3), "y_warmup must be"),
        (lambda: simulated(Recurrent(GRU(4, 1, 1)), np.zeros((5, 1)), 3), "u must be given"),
        (lambda: simulated(ResidualModel(GRU(4, 1)), np.zeros((5, 1)), 3), "y_sim must be given"),
        (
            lambda: SplitModel([GRU(4, 1), GRU(4, 1)], ComplementaryPair.butterworth(2, 10), 3),
            "downsampling by 3",
        ),
    ],
)
def test_errors_name_the_argument_and_the_value(call: Any, message: Any) -> None:
    with pytest.raises(ValueError, match=message):
        call()
