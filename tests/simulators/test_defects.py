"""Defects of a user's code end a fit at once; an equation is known by all that it says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband as sb

TIME = 0.1 * np.arange(60.0)
RECORD = sb.Record(np.exp(-TIME), 0.1, u=np.sin(TIME))


def lag(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [-p.k * x[0]]


@pytest.mark.parametrize(
    ("rhs", "message"),
    [
        (lambda t, x, u, p: [-p.k * x[0] + "1"], r"\(k = .*\): \w*TypeError.*test_defects.py"),
        (lambda t, x, u, p: [-p.k * x[0] + u[3]], "IndexError"),
        (lambda t, x, u, p: [-p["c"] * x[0]], "no parameter c: there are k"),
        (lambda t, x, u, p: [math.log(-1.0 - p.k)], "math domain error|nonnegative"),
        (lambda t, x, u, p: [-p.k * x[0], 0.0 * p.kk], "no attribute 'kk'"),
    ],
)
def test_an_equation_that_raises_wherever_a_search_begins_ends_at_once(
    rhs: Any, message: str
) -> None:
    ode = sb.Ode(rhs, [1.0], parameters={"k": (0.1, 10.0)})
    with pytest.raises(ValueError, match="must run at its start values.*(" + message + ")"):
        sb.GreyBox(ode).check(RECORD)
    with pytest.raises(ValueError, match=message):  # in place of a network that is trained
        sb.compare(RECORD, simulator=ode)


def test_a_run_with_other_results_than_numbers_is_a_failed_one() -> None:
    """For a parameter below 2.5 the root of Python's numbers is complex."""

    def root(t: float, x: Any, u: Any, p: Any) -> list[Any]:
        return [-((p.k - 2.5) ** 0.5) * x[0]]

    ode = sb.Ode(root, [1.0], parameters={"k": (1.0, 9.0)})
    assert sb.GreyBox(ode, starts=4).fit(RECORD).parameters["used"]["k"] == pytest.approx(3.5)


def test_a_defect_of_the_package_is_none_of_the_equation(monkeypatch: pytest.MonkeyPatch) -> None:
    ode = sb.Ode(lag, [1.0], parameters={"k": (0.1, 10.0)})
    monkeypatch.setattr("splitband.kernels.ode.WEIGHTS", None)
    with pytest.raises(TypeError, match="not subscriptable"):
        sb.GreyBox(ode).fit(RECORD)


def test_a_parameter_may_be_an_item() -> None:
    def by_item(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return [-p["k"] * x[0]]

    model = sb.GreyBox(sb.Ode(by_item, [1.0], parameters={"k": (0.1, 10.0)}), starts=1)
    assert model.fit(RECORD).parameters["used"]["k"] == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("channels", [1, 2])
def test_as_many_first_states_are_observed_as_there_are_channels(channels: int) -> None:
    def swing(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return [x[1], -p.k * x[0]]

    y = np.column_stack([np.cos(2 * TIME), -2 * np.sin(2 * TIME)])[:, :channels]
    ode = sb.Ode(swing, [1.0, 0.0], parameters={"k": (1.0, 9.0)})
    model = sb.GreyBox(ode, starts=2).fit(sb.Record(y[:40], 0.1))
    assert model.parameters["used"]["k"] == pytest.approx(4.0, rel=1e-6)
    np.testing.assert_allclose(model.predict(20).y, y[40:], atol=1e-6)


@pytest.mark.parametrize(
    ("simulator", "message"),
    [
        (sb.Ode(lag, [1.0], parameters={"k": (0.1, 9.0)}), r"the 1 state\(s\).* 2 channels"),
        (sb.Ode(lag, [1.0], lambda x: x[:, 0], {"k": (0.1, 9.0)}), r"2 channel\(s\).*got \(3, 1\)"),
        (sb.Function(lambda t, u, p: p.k * t, {"k": (0.1, 9.0)}), r"got \(3, 1\)"),
    ],
)
def test_another_number_of_channels_is_refused_before_a_fit(simulator: Any, message: str) -> None:
    record = sb.Record(np.column_stack([np.exp(-TIME), np.exp(-TIME)]), 0.1)
    with pytest.raises(ValueError, match=message):
        sb.GreyBox(simulator).fit(record)
    with pytest.raises(ValueError, match=message):
        sb.identify(simulator, record)


def test_a_loaded_model_goes_on_where_the_training_record_ended(tmp_path: Path) -> None:
    """Without time stamps, too: of the record only its end is saved."""
    function = sb.Function(lambda time, u, p: p.k * time, {"k": (0.1, 10.0)})
    model = sb.GreyBox(function, starts=1).fit(sb.Record(2 * TIME, 0.1))
    model.save(tmp_path)
    for each in (model, sb.load(tmp_path, function)):
        assert each.predict(3).y[:, 0] == pytest.approx([12.0, 12.2, 12.4])
        with pytest.raises(ValueError, match="its simulator cannot be written as equal steps"):
            each.stream()
