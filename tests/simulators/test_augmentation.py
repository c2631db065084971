"""Unknown terms of equations, trained with the parameters, which keep their meaning."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband.simulators import Effort, identify
from splitband.simulators.shooting import Shooting


@pytest.fixture(autouse=True)
def few_trainings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitband.simulators.identification.DECAYS", (1e-2,))
    monkeypatch.setattr("splitband.simulators.identification.MEMBERS", 1)


def rubbing(t: float, x: Any, u: Any, p: Any, w: Any) -> list[float]:
    return [(u[0] - w[0]) / p.inertia]


def friction(v: Any) -> Any:
    return 0.8 * np.tanh(v / 0.3) + 0.1 * v


def drive(samples: int = 200) -> sb.Record:
    """With an inertia of 0.5."""
    rng = np.random.default_rng(0)
    u: npt.NDArray[np.float64] = np.repeat(rng.normal(0, 1.5, samples // 20), 20)[:, None]
    rig = sb.Ode(lambda t, x, u: [2 * (u[0] - friction(x[0]))], [0.0])
    v = np.asarray(rig.simulate(0.05 * np.arange(float(samples)), u))
    return sb.Record(v + rng.normal(0, 0.005, v.shape), 0.05, u=u, y_true=v)


def test_a_friction_is_found_with_the_inertia() -> None:
    record = drive()
    ode = sb.Ode(
        rubbing,
        [0.0],
        parameters={"inertia": (0.1, 2.0)},
        unknown=sb.Unknown(lambda x, u: [x[0]], hidden=4, odd=True),
    )
    found = identify(ode, record, effort=Effort(1))
    inertia, error = found.values["inertia"], found.errors["inertia"]
    assert inertia == pytest.approx(0.5, rel=0.02)
    assert abs(inertia - 0.5) < 3 * error < 0.05
    (state,) = found.terms
    low, high = np.percentile(record.truth, [1, 99])
    z = np.linspace(low, high, 50)[:, None]
    (term,) = ode.taught(found.terms).terms
    np.testing.assert_allclose(term.value(z), friction(z), atol=0.1)
    assert state.low < low < high < state.high


def test_the_weight_decay_does_not_make_parameters_more_certain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It holds the term back, which is no knowledge of the friction."""
    term = sb.Unknown(lambda x, u: [x[0]], hidden=4, odd=True)
    ode = sb.Ode(rubbing, [0.0], parameters={"inertia": (0.1, 2.0)}, unknown=term)
    found = identify(ode, drive(), effort=Effort(1))
    monkeypatch.setattr(Shooting, "undecayed", lambda self, normal: normal)
    counted = identify(ode, drive(), effort=Effort(1))
    assert found.values == counted.values
    assert found.errors["inertia"] > 1.03 * counted.errors["inertia"]


def test_a_parameter_that_a_term_could_replace_takes_what_it_can() -> None:
    """The spring is known to be linear, the term is of the same position and finds the rest."""

    def hardening(t: float, x: Any, u: Any, p: Any, w: Any) -> list[float]:
        return [x[1], u[0] - p.k * x[0] - 0.5 * x[1] - w[0]]

    rng = np.random.default_rng(0)
    u: npt.NDArray[np.float64] = np.repeat(rng.normal(0, 3.0, 20), 15)[:, None]
    rig = sb.Ode(lambda t, x, u: [x[1], u[0] - 4 * x[0] - x[0] ** 3 - 0.5 * x[1]], [0.5, 0.0])
    x = np.asarray(rig.simulate(0.05 * np.arange(300.0), u))
    record = sb.Record(x + rng.normal(0, 0.005, x.shape), 0.05, u=u)
    term = sb.Unknown(lambda x, u: [x[0]], hidden=4, odd=True)
    ode = sb.Ode(hardening, [0.5, 0.0], parameters={"k": (1.0, 9.0)}, unknown=term)
    found = identify(ode, record, effort=Effort(1))
    z = np.linspace(0, 0.9 * np.abs(x).max(), 30)[:, None]
    (taught,) = ode.taught(found.terms).terms
    whole = found.values["k"] * z + taught.value(z)
    np.testing.assert_allclose(whole, 4 * z + z**3, atol=0.05 * whole.max())
    # The least squares of the whole force by a linear one: the term has no part of it.
    linear = float((x**2).sum() * 4 + (x**4).sum()) / float((x**2).sum())
    assert found.values["k"] == pytest.approx(linear, rel=0.15)
    assert "unknown terms could take the place of k: its value is the part" in str(found)


def test_a_term_that_does_not_help_on_held_out_samples_is_left_out() -> None:
    """A load swings below the trolley: its angle and its rate are no states of the equation."""

    def swinging(t: float, x: Any, u: Any) -> list[float]:
        return [x[1], u[0] - x[1], x[3], -4 * x[2] - 0.05 * x[3] - u[0] + x[1]]

    def trolley(t: float, x: Any, u: Any, p: Any, w: Any) -> list[float]:
        return [x[1], (u[0] - x[1]) / p.lag + w[0]]

    u = np.repeat(np.resize(np.random.default_rng(0).normal(size=8), 12), 25)[:, None]
    rig = sb.Ode(swinging, [0.0] * 4, lambda x: x[:, 0] + x[:, 2])
    y = np.asarray(rig.simulate(0.1 * np.arange(300.0), u))
    ode = sb.Ode(trolley, [0.0, 0.0], parameters={"lag": (0.1, 5.0)}, unknown=sb.Unknown(hidden=4))
    record = sb.Record(y, 0.1, u=u)
    model = sb.GreyBox(ode, starts=1).fit(record[:200])
    alone = sb.GreyBox(ode.without_terms(), starts=1).fit(record[:200])
    assert "the unknown terms were left out: with them, held-out" in model.describe()
    forecast, expected = (each.predict(100, u=u[200:]).y for each in (model, alone))
    np.testing.assert_allclose(forecast, expected)


def test_outputs_that_the_equation_does_not_use_are_refused() -> None:
    ode = sb.Ode(
        rubbing, [0.0], parameters={"inertia": (0.1, 2.0)}, unknown=sb.Unknown(outputs=2, hidden=2)
    )
    with pytest.raises(sb.InputError, match=r"outputs of unknown terms must .* w\[1\] changes"):
        identify(ode, drive(), effort=Effort(1))
    one = sb.Ode(
        lambda t, x, u, p, w: [(u[0] - w[1]) / p.inertia],
        [0.0],
        parameters={"inertia": (0.1, 2.0)},
        unknown=sb.Unknown(),
    )
    with pytest.raises(sb.InputError, match="index 1 is out of bounds"):
        identify(one, drive(), effort=Effort(1))
