"""A stream runs a simulator of its own, and takes samples as they are measured."""

from copy import copy
from functools import cache
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband.runtime.arrays import Array
from tests.streams import BANDS, SHORT, free, in_double

TRAIN, SEEN, END = 150, 190, 240

pytestmark = pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")


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


def stepped(model: Any, record: sb.Record, begin: int, **options: Any) -> tuple[Array, Array]:
    """What a stream says after a history that ends at `begin`, and what `predict` says."""
    u = record.u
    stream = model.stream(record[:begin], **options)
    copied = stream.copy()
    found = [stream.step(None if u is None else u[n]) for n in range(begin, END)]
    copied.step(None if u is None else u[begin])  # two of them do not disturb each other
    # Longer, as slopes and splines end differently.
    ahead = None if u is None else u[begin : END + 20]
    wanted = model.predict(END - begin + 20, record[:begin], ahead, **options)
    return np.stack(found), wanted.y[: END - begin]


@pytest.mark.parametrize(("kind", "memory"), [*((kind, 30) for kind in MODELS), ("grey box", 0)])
def test_a_grey_box_is_integrated_sample_by_sample(kind: str, memory: int) -> None:
    record: Any = shaken(start=3.0)
    model = fitted(kind, 3.0)
    for each in (model, *getattr(model, "members", [])):
        if isinstance(each, sb.GreyBox):
            each.memory = memory
    for begin in (TRAIN, SEEN):
        found, wanted = stepped(model, record, begin)
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    stream = model.stream()
    found = np.stack([stream.step(u) for u in record.u[TRAIN:END]])
    np.testing.assert_allclose(found, model.predict(90, u=record.u[TRAIN:END]).y, atol=1e-6)


@pytest.mark.parametrize("memory", [0, 30])
def test_the_state_of_another_record_is_estimated_from_the_history(memory: int) -> None:
    model = copy(fitted("grey box"))
    model.memory = memory
    found, wanted = stepped(model, shaken(start=7.0), SEEN, other_record=True)
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("base", ["grey box", "linear"])
def test_a_base_that_was_fitted_beforehand_streams_what_it_predicts(base: str) -> None:
    """A comparison fits what several methods share once; by itself it forgets, or is corrected."""
    record = shaken()
    shared: Any = copy(fitted("grey box"))
    shared = shared if base == "grey box" else sb.Linear().fit(record[:TRAIN])
    shared.memory = 30
    hybrid = sb.Residual(shared, sb.GRU(4), conditioned=True, settings=SHORT)
    model = hybrid.fitted_copy([record[:TRAIN]], bases=[shared])
    in_double(model)
    found, wanted = stepped(model, record, SEEN, other_record=True)
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_an_equation_without_inputs_is_integrated_too() -> None:
    time = 0.1 * np.arange(260)
    record = sb.Record(np.cos(1.9 * time) + 0.2 * np.sin(7 * time), 0.1)
    pendulum = sb.Ode(swinging, [1.0, 0.0], parameters={"k": (1.0, 9.0)})
    model = sb.Residual(pendulum, sb.GRU(4), conditioned=True, settings=SHORT).fit(record[:TRAIN])
    in_double(model)
    found, wanted = stepped(model, record, SEEN)
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("terms", [None, ["gain", "offset"]])
def test_the_output_of_a_function_is_given_with_each_sample(terms: Any) -> None:
    record = free()
    simulator: Any = sb.Function(np.sin)
    slow = sb.Simulation(simulator) if terms is None else sb.Calibrated(simulator, terms)
    model = sb.Filtered(slow, sb.GRU(4), BANDS, conditioned=True, settings=SHORT)
    model.fit(record[:TRAIN])
    in_double(model)
    stream, output = model.stream(record[:SEEN]), np.sin(0.1 * np.arange(END + 1))
    found = np.stack([stream.step(y_sim=output[n : n + 2]) for n in range(SEEN, END)])
    wanted = model.predict(END - SEEN + 20, record[:SEEN]).y[: END - SEEN]
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    with pytest.raises(ValueError, match="y_sim must be given at every sample"):
        model.stream().step()


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
