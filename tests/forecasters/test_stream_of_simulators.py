"""A stream runs a simulator of its own, and takes samples as they are measured."""

from copy import copy
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from tests.streams import BANDS, SHORT, free, in_double

Array = npt.NDArray[np.float64]
TRAIN, SEEN, END = 150, 190, 240

pytestmark = [
    pytest.mark.usefixtures("compiled_soon"),
    pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning"),
]


def stiffening(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [x[1], p.k * (u[0] - x[0] - 0.3 * x[0] ** 3) - p.c * x[1]]


def swinging(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [x[1], -p.k * np.sin(x[0])]


def rig() -> sb.Ode:
    return sb.Ode(stiffening, [0.1, 0.0], parameters={"k": (1.0, 9.0), "c": (0.1, 2.0)})


def shaken(start: float | None = None) -> sb.Record:
    """A spring that stiffens, by the plain Runge-Kutta method, with noise."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.normal(size=26), 10)[:, None]
    x, y = np.array([0.2, 0.0]), np.empty(260)
    for n in range(260):
        y[n] = x[0]
        for _ in range(50):
            x = x + 0.002 * np.array([x[1], 4 * (u[n, 0] - x[0] - 0.3 * x[0] ** 3) - 0.5 * x[1]])
    return sb.Record(y + rng.normal(0, 0.01, 260), 0.1, u=u, start=start)


MODELS: dict[str, Any] = {
    "grey box": lambda: sb.GreyBox(rig(), starts=2),
    "residual": lambda: sb.Residual(
        sb.GreyBox(rig(), starts=2), sb.GRU(4), conditioned=True, settings=SHORT
    ),
    "filtered": lambda: sb.Filtered(sb.GreyBox(rig(), starts=2), sb.GRU(4), BANDS, settings=SHORT),
    "ensemble": lambda: sb.Ensemble(sb.GreyBox(rig(), starts=2), 2),
}


@cache
def fitted(kind: str, start: float | None = None) -> Any:
    """A model that is fitted once in a process."""
    model = MODELS[kind]().fit(shaken(start)[:TRAIN], seed=1)
    in_double(model)
    return model


def from_origin(model: sb.Forecaster, record: sb.Record, **options: Any) -> tuple[Array, Array]:
    """What a stream says after the samples up to `SEEN`, and what `predict` says."""
    u = record.u
    stream = model.stream(record[: SEEN - 20], **options)
    members = getattr(model, "members", [model])
    estimated = any(getattr(each, "memory", 0) for each in members)
    assert stream.recursion.repeats == estimated
    for n in range(SEEN - 20, SEEN):
        stream.observe(record.y[n], None if u is None else u[n])
    copied = stream.copy()
    said = [stream.step(None if u is None else u[n]) for n in range(SEEN, END)]
    copied.step(None if u is None else u[SEEN])  # two of them do not disturb each other
    # Longer, as slopes and splines end differently.
    ahead = None if u is None else u[SEEN : END + 20]
    wanted = model.predict(END - SEEN + 20, record[:SEEN], ahead, **options)
    return np.stack(said), wanted.y[: END - SEEN]


@pytest.mark.parametrize(("kind", "memory"), [*((kind, 30) for kind in MODELS), ("grey box", 0)])
def test_a_grey_box_is_integrated_sample_by_sample(kind: str, memory: int) -> None:
    record: Any = shaken(start=3.0)
    model = fitted(kind, 3.0)
    for each in (model, *getattr(model, "members", [])):
        if isinstance(each, sb.GreyBox):
            each.memory = memory
    found, wanted = from_origin(model, record)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    stream = model.stream()
    found = np.stack([stream.step(u) for u in record.u[TRAIN:END]])
    np.testing.assert_allclose(found, model.predict(90, u=record.u[TRAIN:END]).y, atol=1e-9)


def test_the_state_of_another_record_is_told_by_its_last_samples() -> None:
    model = copy(fitted("grey box"))
    model.memory = 30
    record: Any = shaken(start=7.0)
    found, wanted = from_origin(model, record, other_record=True)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    # Where all samples tell it, each forecast asks for all of them.
    model.memory = 0
    stream = model.stream(record[:SEEN], other_record=True)
    found = stream.step(record.u[SEEN])
    wanted = model.predict(1, record[:SEEN], record.u[SEEN:], other_record=True).y[0]
    np.testing.assert_allclose(found, wanted)


def test_a_gap_begins_a_forecast_anew() -> None:
    record: Any = shaken()
    model = copy(fitted("grey box"))
    model.memory = 30
    y = record.y.copy()
    y[170:180] = np.nan
    stream = model.stream(record[:160])
    for n in range(160, SEEN):
        stream.observe(y[n], record.u[n])
    gaps = sb.Record.with_gaps(y[:SEEN], 0.1, u=record.u[:SEEN])
    found = np.stack([stream.step(u) for u in record.u[SEEN:END]])
    wanted = model.predict(END - SEEN, gaps, record.u[SEEN:END]).y
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_an_equation_without_inputs_is_integrated_too() -> None:
    time = 0.1 * np.arange(260)
    record = sb.Record(np.cos(1.9 * time) + 0.2 * np.sin(7 * time), 0.1)
    pendulum = sb.Ode(swinging, [1.0, 0.0], parameters={"k": (1.0, 9.0)})
    model = sb.Residual(pendulum, sb.GRU(4), conditioned=True, settings=SHORT).fit(record[:TRAIN])
    in_double(model)
    found, wanted = from_origin(model, record)
    np.testing.assert_allclose(found, wanted, atol=1e-9)


@pytest.mark.parametrize("terms", [None, ["gain", "offset"], ["delay"]])
def test_a_function_is_run_ahead(terms: Any) -> None:
    record = free()
    simulator: Any = sb.Function(np.sin)
    slow = sb.Simulation(simulator) if terms is None else sb.Calibrated(simulator, terms)
    model = sb.Filtered(slow, sb.GRU(4), BANDS, conditioned=True, settings=SHORT)
    model.fit(record[:TRAIN])
    in_double(model)
    found, wanted = from_origin(model, record)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    with pytest.raises(ValueError, match="y_sim must be left out"):
        model.stream().step(y_sim=1.0)


def test_recorded_output_is_read_as_far_as_it_goes() -> None:
    record = free()
    assert record.y_sim is not None
    recorded = sb.Recorded(record.y_sim, 0.1)
    model = sb.Filtered(recorded, sb.GRU(4), BANDS, settings=SHORT).fit(record[:TRAIN])
    in_double(model)
    stream = model.stream(record[:SEEN])
    found = np.stack([stream.step() for _ in range(SEEN, len(record))])
    wanted = model.predict(len(record) - SEEN, record[:SEEN]).y
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    with pytest.raises(ValueError, match="the exported trajectory"):
        stream.step()


def test_a_step_response_integrates_the_equation() -> None:
    grey = fitted("grey box")
    found = sb.step_responses(grey, 300, at=[0.0], size=[1e-3]).y[-1, 0, 0]
    assert found == pytest.approx(1.0, abs=1e-3)  # x = u where both are small
    assert np.isfinite(sb.step_responses(fitted("residual", 3.0), 50).y).all()


def test_a_simulator_that_repeats_the_history_goes_on() -> None:
    """The output after the record may equal the one before."""
    periodic = np.tile(np.sin(2 * np.pi * np.arange(20) / 20), 8)
    simulator = sb.Simulation().fit(sb.Record(periodic[:40] + 0.01, 0.1, y_sim=periodic))
    np.testing.assert_array_equal(simulator.stream().step(y_sim=periodic[40]), periodic[:1])
    np.testing.assert_array_equal(simulator.predict(20).y[:, 0], periodic[:20])
