"""What a model says of the unknown terms of its equation."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband.report import words

FORCE = np.sin(0.04 * np.arange(300.0))


def sliding(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
    return [x[1], u[0] - p.k * x[0] - 0.5 * x[1] - w[0] * w[1]]


def given(term: sb.Unknown, z: Any, seed: int = 0) -> sb.Unknown:
    state = term.begun(z, seed=seed)
    weights = 0.3 * np.random.default_rng(seed).normal(size=state.weights.shape)
    return replace(term, trained=replace(state, weights=weights)).holding(z)


ONE = given(sb.Unknown(["speed"], odd=True), np.linspace(-3, 3, 9)[:, None])
TWO = given(sb.Unknown(["x1", "force"]), np.linspace([-2, -1], [2, 3], 9), 1)
OTHERS = [given(replace(ONE, trained=None), np.linspace(-3, 3, 9)[:, None], 2), TWO]


@pytest.fixture(scope="module")
def model() -> sb.GreyBox:
    """An equation with two given terms, and a second training of the first one."""
    ode = sb.Ode(sliding, [0.5, 0.0], parameters={"k": (0.5, 2.0)}, unknown=[ONE, TWO])
    named = ["position [m]", "speed [m/s]"], ["force [N]"]
    y = np.asarray(ode.matched(*named).simulate(0.04 * np.arange(300.0), FORCE[:, None]))
    y = y + np.random.default_rng(0).normal(0, 0.001, y.shape)
    columns, inputs = map(tuple, named)
    record = sb.Record(y, 0.04, u=FORCE, columns=columns, inputs=inputs)
    fitted = sb.GreyBox(ode, starts=1).fit(record[:200])
    members: Any = tuple(term.trained for term in OTHERS)
    fitted.adjusted = replace(fitted.adjusted, members=members)
    return fitted


def test_the_curve_of_a_term_is_over_its_range_in_training(model: sb.GreyBox) -> None:
    curve = model.unknown_curve()
    assert (curve.quantity, curve.range, curve.trainings) == ("speed [m/s]", (-3.0, 3.0), 2)
    np.testing.assert_array_equal(curve.z, np.linspace(-3, 3, 101))
    values = np.stack([term.value(curve.z[:, None]) for term in (ONE, OTHERS[0])])
    np.testing.assert_allclose(curve.w, values[0])
    np.testing.assert_allclose([curve.low, curve.high], [values.min(0), values.max(0)])
    cut = model.unknown_curve(1, 1, at=[0.5, 0.0])
    assert (cut.quantity, cut.others) == ("force [N]", {"position [m]": 0.5})
    whole = np.stack([np.full(101, 0.5), cut.z], axis=1)
    np.testing.assert_allclose(cut.w, TWO.value(whole))
    assert [*cut.to_frame().columns] == ["w0", "w0 low", "w0 high"]
    assert cut.to_frame().index.name == "force [N]"


def test_outside_its_range_a_term_goes_on_straight_and_it_says_so(model: sb.GreyBox) -> None:
    with pytest.warns(sb.ExtrapolationWarning, match=r"speed \[m/s\] was from -3 to 3 in training"):
        curve = model.unknown_curve(z=[2.999, 3.0, 6.0, 9.0])
    slopes = np.diff(curve.w[:, 0]) / np.diff(curve.z)
    np.testing.assert_allclose(slopes, slopes[1], rtol=2e-3)
    with pytest.warns(sb.ExtrapolationWarning) as caught:
        prediction = model.predict(50, u=np.full((50, 1), 9.0))
    said = [str(each.message) for each in caught]
    assert any(
        "force [N] of an unknown term is 9 at sample 1 of the prediction, where it was -1 to 3" in s
        for s in said
    )
    assert any("speed [m/s] of an unknown term" in doubt for doubt in prediction.doubts)
    assert not model.predict(5, u=np.zeros((5, 1))).doubts
    for wrong in ({"term": 2}, {"quantity": 1}, {"at": [0.0, 0.0]}):
        with pytest.raises(sb.InputError, match=next(iter(wrong))):
            model.unknown_curve(**wrong)


def test_curves_and_ranges_are_saved(model: sb.GreyBox, tmp_path: Path) -> None:
    model.save(tmp_path)
    terms = [replace(term, trained=None) for term in (ONE, TWO)]
    loaded: Any = sb.load(tmp_path, simulator=replace(model.simulator, unknown=terms))
    for term in range(2):
        found, wanted = (each.unknown_curve(term).to_frame() for each in (loaded, model))
        np.testing.assert_array_equal(found, wanted)
    ranges = loaded.parameters["unknown"][0]["in_training"]
    assert ranges == {"speed [m/s]": (-3.0, 3.0)}
    assert "an unknown term of speed [m/s] from -3 to 3" in loaded.describe()


@pytest.mark.usefixtures("drawn")
def test_the_page_draws_them(model: sb.GreyBox, tmp_path: Path) -> None:
    result = sb.compare(model.require_fitted().record, 150, [sb.GreyBox(model.simulator, starts=1)])
    result.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Unknown terms" in page
    assert "w[0] over speed [m/s]" in page
    assert "w[1] over force [N], with position [m] = 0" in page


def test_it_is_said_where_a_state_is_missing() -> None:
    """A load that swings on a cart: no function of the cart's speed and force swings."""
    time, u = 0.1 * np.arange(240.0), np.repeat(np.random.default_rng(0).normal(size=24), 10)

    def swinging(t: float, x: Any, u: Any) -> list[Any]:
        return [u[0] - 0.5 * x[0], x[2], 9.0 * (x[0] - x[1]) - 0.3 * x[2]]

    y = sb.Ode(swinging, [0.0, 0.0, 0.0], lambda x: x[:, 1]).simulate(time, u[:, None])
    y = np.asarray(y)[:, 0] + np.random.default_rng(1).normal(0, 0.01, 240)
    record = sb.Record(y, 0.1, u=u)

    def cart(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
        return [u[0] - p.c * x[0] - w[0]]

    ode = sb.Ode(cart, [0.0], parameters={"c": (0.1, 2.0)}, unknown=sb.Unknown(hidden=3))
    without = sb.GreyBox(ode.without_terms(), starts=1, name="grey-box-without-terms")
    result = sb.compare(record, 180, ["grey-box", without, "linear"], simulator=ode)
    said = [each for each in words.warnings(result) if "unknown terms help little" in each]
    assert len(said) == (result.recommended == "linear") == 1
    trial = result.require_trial()
    left_out = {**trial.scores, "grey-box": trial.scores[without.name]}
    other = replace(result, trial=replace(trial, scores=left_out))
    assert any("unknown terms are left out of the model" in each for each in words.warnings(other))
