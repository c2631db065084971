"""A simulator is run, or fitted, once for each span of the records, whatever uses it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband.comparison.methods import Sizes
from splitband.simulators import identification

TIME = 0.1 * np.arange(240)
RECORD = sb.Record(np.exp(-0.3 * TIME) + 0.1 * np.sin(3 * TIME), 0.1)
SHORT = sb.TrainingSettings.paper(window=30, warmup=5, epochs=1)


def decay(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [-p.rate * x[0]]


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> Counter[int]:
    """How often parameters were fitted to so many samples."""
    found: Counter[int] = Counter()
    tried = identification.tried

    def counted(problem: Any, *arguments: Any) -> Sequence[Any]:
        found[problem.longest] += 1
        return tried(problem, *arguments)

    monkeypatch.setattr(identification, "tried", counted)
    return found


def test_a_grey_box_with_hybrids_on_it_is_fitted_once_a_span(fits: Counter[int]) -> None:
    ode = sb.Ode(decay, [1.0], parameters={"rate": (0.1, 1.0)})
    hybrids = ["residual-gru", "filtered-gru"]
    how: dict[str, Any] = {
        "settings": SHORT,
        "sizes": Sizes(hidden_low=2, hidden_high=2),
        "seeds": 2,
        "refit": True,
    }
    found = sb.compare(RECORD, 160, ["grey-box", *hybrids], simulator=ode, **how)
    assert len(found.fits) == 3
    # Of a trial, of the training part, and of the whole record for the recommended method.
    assert fits == {120: 1, 160: 1, 240: 1}
    alone = sb.compare(RECORD, 160, hybrids[:1], simulator=ode, **{**how, "refit": False})
    assert fits == {120: 2, 160: 2, 240: 1}
    (name,) = alone.fits
    for one, other in zip(alone.fits[name], found.fits[name], strict=True):
        np.testing.assert_array_equal(one.ahead, other.ahead)
        assert one.fitted.parameters == found.fits["grey-box"][0].fitted.parameters


def test_the_members_of_a_median_share_the_fit_of_their_base(fits: Counter[int]) -> None:
    ode = sb.Ode(decay, [1.0], parameters={"rate": (0.1, 1.0)})
    hybrid = sb.Residual(sb.GreyBox(ode), sb.GRU(2), settings=SHORT)
    several = sb.Ensemble(hybrid, 3).fit(RECORD[:160])
    assert fits == {160: 1}
    alone = hybrid.clone().fit(RECORD[:160], seed=1)
    np.testing.assert_array_equal(several.members[1].predict(9).y, alone.predict(9).y)
    # Of another record, and with other options, it is fitted anew.
    sb.Ensemble([hybrid, sb.Residual(sb.GreyBox(ode, starts=3), sb.GRU(2), settings=SHORT)]).fit(
        replace(RECORD, y=2 * RECORD.y)[:150]
    )
    assert fits == {160: 2, 150: 2}


def test_a_slow_simulator_is_run_once_for_all_methods() -> None:
    runs: list[int] = []

    def rig(time: Any) -> Any:
        runs.append(len(time))
        return np.exp(-0.3 * time)

    def methods() -> list[sb.Forecaster]:
        function = sb.Function(rig)
        base = sb.Calibrated(function)
        hybrid = sb.Residual(base, sb.GRU(2), settings=SHORT)
        return [
            sb.Simulation(function),
            base,
            hybrid,
            sb.Residual(function, sb.GRU(2), settings=SHORT),
        ]

    sb.compare(RECORD, 160, methods(), seeds=2)
    assert len(runs) == 2  # a calibrated delay needs more samples
    runs.clear()
    names = ["simulator", "simulator-calibrated", "residual-gru-calibrated"]
    sb.compare(RECORD, 160, names, simulator=sb.Function(rig), seeds=1, settings=SHORT)
    assert len(runs) == 1
