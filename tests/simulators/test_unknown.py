"""Unknown terms of an equation: given to it, extrapolated, and run by every solver."""

import math
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband.simulators.isolation import adjustable_from

Array = npt.NDArray[np.float64]
TIME: Array = 0.02 * np.arange(300.0)
FORCE = np.sin(2 * TIME)[:, None]


def speed(x: Any, u: Any) -> list[Any]:
    return [x[1]]


def sliding(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
    return [x[1], u[0] - p.k * x[0] - w[0]]


def trained(term: sb.Unknown, low: float = -2.0, high: float = 2.0, seed: int = 0) -> sb.Unknown:
    """A term with random weights, on a range of its one quantity."""
    z = np.linspace(low, high, 50)[:, None]
    state = term.begun(z, seed=seed)
    weights = np.random.default_rng(seed).normal(size=state.weights.shape)
    return replace(term, trained=replace(state, weights=weights)).holding(z)


def rig(**options: Any) -> sb.Ode:
    options = {"unknown": trained(sb.Unknown(speed, odd=True)), **options}
    return sb.Ode(sliding, [0.5, 0.0], parameters={"k": (1.0, 9.0)}, **options)


def simulated(ode: sb.Ode) -> Array:
    return np.asarray(ode.simulate(TIME, FORCE), dtype=float)


def test_a_term_enters_the_equation() -> None:
    """Beside the equation with the term's formula written out."""
    term: Any = trained(sb.Unknown(speed, hidden=2), -6.0, 6.0)
    state, (a, b, c, d, e, f, g) = term.trained, term.trained.weights

    def whole(t: float, x: Any, u: Any, p: Any) -> list[float]:
        s = x[1] / 6
        w = e * math.tanh(a * s + c) + f * math.tanh(b * s + d) + g
        return [x[1], u[0] - p.k * x[0] - w]

    assert state.width == 6
    expected = simulated(sb.Ode(whole, [0.5, 0.0], parameters={"k": 3.0}))
    for method in ("RK45", "LSODA"):
        ode = replace(rig(unknown=term), method=method)
        found = simulated(ode.fixed({"k": 3.0}))
        np.testing.assert_allclose(found, expected, atol=1e-6)
        again = simulated(ode.matched(["x"], ["F"]).precise().fixed({"k": 3.0}))
        np.testing.assert_allclose(again, expected, atol=1e-6)


def test_before_training_it_is_the_equation_without_the_term() -> None:
    free = sb.Ode(lambda t, x, u, p: sliding(t, x, u, p, [0.0]), [0.5, 0.0], parameters={"k": 4.0})
    untrained = rig(unknown=sb.Unknown(speed)).fixed({"k": 4.0})
    found = simulated(untrained.without_terms())
    np.testing.assert_allclose(found, simulated(free), atol=1e-12)
    with pytest.raises(sb.InputError, match=r"terms must be trained before .* ode.without_terms()"):
        simulated(untrained)
    record = sb.Record(found, 0.02, u=FORCE)
    with pytest.raises(sb.InputError, match=r"terms must be trained .* sb.GreyBox\(ode\).fit"):
        sb.Simulation(untrained).fit(record[:200]).predict(100, u=FORCE[200:])
    same = sb.Simulation(untrained.without_terms()).fit(record[:200]).predict(100, u=FORCE[200:])
    np.testing.assert_allclose(same.y, found[200:, None] if found.ndim == 1 else found[200:])


def test_it_goes_on_straight_outside_the_range_of_the_record() -> None:
    for odd, ends in ((False, [-1.0, 3.0]), (True, [-3.0, 3.0])):
        term = trained(sb.Unknown(speed, odd=odd), -1.0, 3.0)
        for end, out in zip(ends, (-1.0, 1.0), strict=True):
            z = end + out * np.array([-1e-6, 0.0, 1.0, 50.0])
            slopes = np.diff(term.value(z[:, None])[:, 0]) / np.diff(z)
            np.testing.assert_allclose(slopes, slopes[1], rtol=1e-5)


def test_other_states_of_terms_replace_them() -> None:
    other: Any
    ode, other = rig(), trained(sb.Unknown(speed, odd=True), seed=1)
    taught = ode.taught([other.trained])
    found = simulated(taught)
    np.testing.assert_array_equal(found, simulated(rig(unknown=other)))
    with pytest.raises(
        sb.InputError, match=r"unknown must have 2 term\(s\), as in training, got 1"
    ):
        ode.taught([other.trained, other.trained])


def test_quantities_have_names_of_states_and_of_a_record() -> None:
    for name, label in (("x2", "speed [m/s]"), ("speed", "speed [m/s]"), ("F", "F [N]")):
        ode = rig(unknown=sb.Unknown([name]))
        (term,) = ode.matched(["angle", "speed [m/s]"], ["F [N]"]).terms
        assert [*term.quantities(np.array([[1.0, 2.0]]), np.array([[3.0]]))[0]] == [
            3.0 if name == "F" else 2.0
        ]
        assert term.label(0) == label
    with pytest.raises(sb.InputError, match=r"must name states, x1, x2, .* F: got x3$"):
        rig(unknown=sb.Unknown(["x3"])).matched(["angle"], ["F"])
    with pytest.raises(sb.InputError, match="got x2, which names several"):
        rig(unknown=sb.Unknown(["x2"])).matched(["angle"], ["x2"])
    by_name = rig(unknown=trained(sb.Unknown(["x2"], odd=True)))
    np.testing.assert_array_equal(simulated(by_name), simulated(rig()))


def test_an_equation_can_be_had_without_its_terms() -> None:
    free = simulated(rig(unknown=sb.Unknown(speed)).without_terms())
    np.testing.assert_array_equal(simulated(rig().without_terms()), free)


def test_other_processes_get_an_equation_of_a_file_as_it_was_changed(tmp_path: Path) -> None:
    """They open the file once more, whose functions no module has."""
    file = tmp_path / "plant.py"
    file.write_text(
        "import splitband as sb\n"
        "rhs = lambda t, x, u, p, w: [x[1], u[0] - p.k * x[0] - w[0]]\n"
        "term = sb.Unknown(lambda x, u: [x[1]], odd=True)\n"
        "plant = sb.Ode(rhs, [0.5, 0.0], parameters={'k': (1.0, 9.0)}, unknown=term)\n"
    )
    state: Any = trained(sb.Unknown(speed, odd=True)).trained
    opened: Any = adjustable_from(str(file), "plant", {})
    taught = opened.matched(["angle"], ["F"]).taught([state])
    for changed in (
        taught.fixed({"k": 2.0}),
        taught.coarse(),
        taught.coarse().precise(),
        taught.otherwise(),
        taught.weighted(2 * taught.weights),
        taught.without_terms(),
    ):
        again: Any = changed
        for _ in range(2):
            again = ForkingPickler.loads(ForkingPickler.dumps(again))
        assert (again.tolerances, again.hold) == (changed.tolerances, changed.hold)
        np.testing.assert_array_equal(simulated(again), simulated(changed))


def test_wrong_terms_are_refused() -> None:
    four: Any = lambda t, x, u, p: [x[1], p.k]  # noqa: E731
    with pytest.raises(sb.InputError, match=r"^unknown must say .* or that argument be left out"):
        sb.Ode(sliding, [0.5, 0.0], parameters={"k": 1.0})
    with pytest.raises(sb.InputError, match=r"rhs must take the outputs w .* or leave unknown out"):
        sb.Ode(four, [0.5, 0.0], parameters={"k": 1.0}, unknown=sb.Unknown())
    with pytest.raises(sb.InputError, match="unknown must be an Unknown or several"):
        rig(unknown=[speed])
    with pytest.raises(sb.InputError, match=r"must have the arguments \(t, x, u, p, w\)"):
        sb.Ode(lambda t, x, u, w, p: [p.k], [0.5], parameters={"k": 1.0}, unknown=sb.Unknown())
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"of": lambda x: [x[0]]}, r"of must be a function of \(x, u\)"),
        ({"hidden": -1}, "hidden must be a whole number from 0 on, got -1"),
        ({"bounded": (1.0, 0.0)}, r"bounded must be two numbers .* got \(1.0, 0.0\)"),
        ({"bounded": 3.0}, "bounded must be two numbers"),
        ({"bounded": (0.0, 1.0), "odd": True}, "bounded must be symmetric"),
        ({"names": "speed"}, "names must be a sequence"),
    )
    for options, message in wrong:
        with pytest.raises(sb.InputError, match=message):
            sb.Unknown(**options)
    with pytest.raises(sb.InputError, match=r"of must return a list of quantities, .* shape \(\)"):
        sb.Unknown(lambda x, u: x[1]).quantities(np.zeros((3, 2)), None)


def test_its_repr_is_the_code_that_makes_it() -> None:
    term = sb.Unknown(speed, odd=True, bounded=(-1.0, 1.0))
    assert repr(term) == "sb.Unknown(of=speed, odd=True, bounded=(-1.0, 1.0))"
