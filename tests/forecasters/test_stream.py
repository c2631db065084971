"""A stream says what `predict` says, from any origin."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor, nn

import splitband as sb
from splitband.forecasters.streaming import Asked

Array = npt.NDArray[np.float64]

pytestmark = pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")

SHORT = sb.Settings(window=60, warmup=20, epochs=1)
BANDS = sb.Bands(1.0, 2, 3)


def driven(samples: int = 260, channels: int = 2) -> sb.Record:
    """A linear system of two inputs, one of which acts late, and a simulator that is half right."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(samples, 2)).cumsum(axis=0)
    u -= u.mean(axis=0)
    late = np.concatenate([np.repeat(u[:1, 1], 6), u[:-6, 1]])
    y = np.zeros((samples, channels))
    for n in range(1, samples):
        y[n] = 0.9 * y[n - 1] + 0.2 * u[n, 0] + 0.3 * late[n] * np.arange(1, channels + 1)
    noisy = y + 0.05 * rng.normal(size=y.shape)
    return sb.Record(noisy, 0.1, u=u, y_sim=0.8 * y + 0.3, inputs=("force", "valve"))


def free(samples: int = 260) -> sb.Record:
    """Two tones, of which a simulator knows the slow one, on a slope."""
    time = 0.1 * np.arange(samples)
    rng = np.random.default_rng(1)
    slow = np.sin(time)
    y = slow + 0.2 * np.sin(9 * time) + 0.05 * time + 0.01 * rng.normal(size=samples)
    return sb.Record(y, 0.1, y_sim=1.1 * slow - 0.1)


class Leaky(nn.Module):
    """A cell of a user's own."""

    def __init__(self, ny: int = 1, nu: int = 0) -> None:
        super().__init__()
        self.ny, self.nu = ny, nu
        self.mix = nn.Linear(ny + nu, ny)

    def sized(self, ny: int, nu: int, warmup: int) -> "Leaky":
        return Leaky(ny, nu)

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        return y_warmup[:, -1]

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        return 0.9 * h + 0.1 * torch.tanh(self.mix(y if u is None else torch.cat([y, u], dim=-1)))

    def observe(self, h: Tensor) -> Tensor:
        return h


WITH_INPUTS: dict[str, Callable[[], sb.Forecaster]] = {
    "mean": sb.Mean,
    "persistence": sb.Persistence,
    "linear": sb.Linear,
    "simulator": lambda: sb.Calibrated(terms=("gain", "offset")),
    "gru": lambda: sb.Single(sb.GRU(5), SHORT),
    "rnn": lambda: sb.Single(sb.EulerMLP(hidden_size=7, recognition_size=5), SHORT),
    "state-space": lambda: sb.Single(sb.StateSpace(3, 4), SHORT),
    "own cell": lambda: sb.Single(Leaky(), SHORT),
    "split": lambda: sb.Split(sb.GRU(4), sb.GRU(5), BANDS, settings=SHORT),
    "split, conditioned, +HP": lambda: sb.Split(
        sb.GRU(4), sb.GRU(5), BANDS, True, True, settings=SHORT
    ),
    "split at one rate": lambda: sb.Split(
        sb.GRU(4), sb.GRU(5), sb.Bands(1.0, 1, 1), conditioned=True, settings=SHORT
    ),
    "filtered": lambda: sb.Filtered(None, sb.GRU(5), BANDS, conditioned=True, settings=SHORT),
    "residual of linear": lambda: sb.Residual(
        sb.Linear(), sb.GRU(5), conditioned=True, settings=SHORT
    ),
    "ensemble": lambda: sb.Ensemble(sb.Single(sb.GRU(4), SHORT), 2),
}
WITHOUT: dict[str, Callable[[], sb.Forecaster]] = {
    "seasonal-naive": sb.SeasonalNaive,
    "harmonic": sb.Harmonic,
    "periodic": sb.Periodic,
    "gru": lambda: sb.Single(sb.GRU(5), SHORT),
    "split, conditioned": lambda: sb.Split(
        sb.GRU(4), sb.GRU(5), BANDS, conditioned=True, settings=SHORT
    ),
    "filtered": lambda: sb.Filtered(None, sb.GRU(5), BANDS, conditioned=True, settings=SHORT),
    "filtered periodic": lambda: sb.Filtered(
        sb.Periodic(), sb.GRU(5), BANDS, conditioned=True, settings=SHORT
    ),
    "residual": lambda: sb.Residual(None, sb.GRU(5), settings=SHORT),
}


def in_double(forecaster: sb.Forecaster) -> None:
    """Networks in double precision, so that nothing but rounding differs."""
    for member in (forecaster, *getattr(forecaster, "members", [])):
        model = getattr(member, "model", None)
        if isinstance(model, nn.Module):
            model.double()


def rows(record: sb.Record, stream: Any) -> Callable[[int], dict[str, Any]]:
    """What a stream is given at each sample beside the measured one."""
    recursion = stream.recursion

    def at(n: int) -> dict[str, Any]:
        given: dict[str, Any] = {}
        if recursion.nu and record.u is not None:
            given["u"] = record.u[n]
        if recursion.simulated and record.y_sim is not None:
            given["y_sim"] = record.y_sim[n : n + 1 + recursion.ahead]
        return given

    return at


def forecast(forecaster: sb.Forecaster, history: sb.Record, record: sb.Record, steps: int) -> Array:
    """`predict` from the end of a history within a record; of one more step, for its slopes."""
    n = len(history)
    u = None if record.u is None else record.u[n : n + steps + 1]
    y_sim = None if record.y_sim is None else record.y_sim[n : n + steps + 1]
    return forecaster.predict(steps + 1, history, u, y_sim).y[:steps]


@pytest.mark.parametrize("name", [*WITH_INPUTS, *(f"{name}, no inputs" for name in WITHOUT)])
def test_a_stream_says_what_predict_says(name: str) -> None:
    of = name.removesuffix(", no inputs")
    record = driven() if name in WITH_INPUTS else free()
    make = WITH_INPUTS[name] if name in WITH_INPUTS else WITHOUT[of]
    forecaster = make().fit(record[:150], seed=1)
    in_double(forecaster)
    scale = np.std(record.y)

    # From the training record on.
    stream = forecaster.stream()
    assert not isinstance(stream.recursion, Asked)
    at = rows(record, stream)
    ahead = forecaster.predict(
        31,
        u=None if record.u is None else record.u[150:181],
        y_sim=None if record.y_sim is None else record.y_sim[150:181],
    ).y
    other = stream.copy()
    found = np.stack([other.step(**at(n)) for n in range(150, 180)])
    assert np.abs(found - ahead[:30]).max() < 1e-9 * scale

    # Measured, then predicted, from two origins, the second after a gap.
    y = record.y.copy()
    for n in range(150, 190):
        stream.observe(y[n], **at(n))
    copied = stream.copy()
    found = np.stack([stream.step(**at(n)) for n in range(190, 200)])
    wanted = forecast(forecaster, record[:190], record, 10)
    assert np.abs(found - wanted).max() < 1e-9 * scale
    again = np.stack([copied.step(**at(n)) for n in range(190, 200)])
    np.testing.assert_array_equal(found, again)

    y[190:200] = np.nan
    for end in (205, 230):  # within a warm-up after the gap, and after one
        for n in range(200 if end == 205 else 205, end):
            stream.observe(y[n], **at(n))
        gaps = sb.Record.with_gaps(y[:end], 0.1, u=None if record.u is None else record.u[:end],
                                   y_sim=None if record.y_sim is None else record.y_sim[:end],
                                   columns=record.columns, inputs=record.inputs)  # fmt: skip
        what_if = stream.copy()
        found = np.stack([what_if.step(**at(n)) for n in range(end, end + 15)])
        assert np.abs(found - forecast(forecaster, gaps, record, 15)).max() < 1e-9 * scale


def test_a_linear_model_finds_its_state_in_another_record() -> None:
    """Also where the history is shorter than what an input acts late by, or twice that."""
    record = driven(channels=1)
    assert record.u is not None
    forecaster = sb.Linear().fit(record[:150])
    assert max(forecaster.delays) == 6
    for samples in (4, 9, 40):
        other = record[170 : 170 + samples]
        stream = forecaster.stream(other, other_record=True)
        found = np.stack([stream.step(u) for u in record.u[170 + samples : 190 + samples]])
        wanted = forecaster.predict(20, other, other_record=True).y
        assert np.abs(found - wanted).max() < 1e-9 * np.std(record.y)


class Twice(sb.Forecaster):
    """A forecaster of a user's own: twice the last sample."""

    name = "twice"

    def extrapolate(self, known: sb.Known) -> Array:
        return np.tile(2 * known.y[-1], (known.steps, 1))


def test_what_has_no_form_sample_by_sample_is_asked() -> None:
    record = free()
    stream = Twice().fit(record).stream()
    stream.observe(1.5)
    assert stream.copy().step()[0] == stream.step()[0] == 3.0
    stream.observe(2.5)
    assert stream.step()[0] == 5.0
    # The output is filtered forwards and backwards: a forecast is that of its own length.
    split = sb.Split(sb.GRU(4), sb.GRU(4), BANDS, filter_output=True, settings=SHORT)
    stream = split.fit(record[:150]).stream()
    stream.step()
    assert stream.step() == pytest.approx(split.predict(2).y[1])


def test_what_a_stream_refuses() -> None:
    record = driven()
    model = sb.Filtered(None, sb.GRU(3), BANDS, settings=SHORT).fit(record[:150])
    stream = model.stream(record[:10])
    given = {"u": [0.0, 0.0], "y_sim": [0.0, 0.0]}
    for changed, message in (
        ({"u": None}, r"u must be given at every sample"),
        ({"y_sim": None}, r"y_sim must be given at every sample"),
        ({"u": [0.0]}, r"u must have the shape \(2,\), got \(1,\)"),
        ({"u": [0.0, np.nan]}, r"u must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            stream.observe([0.0, 0.0], **(given | changed))
    with pytest.raises(ValueError, match="20 measured sample"):
        stream.step(**given)
    with pytest.raises(ValueError, match="u must be left out"):
        sb.Mean().fit(free()).stream().step(u=1.0)
