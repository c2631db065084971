"""What a record holds: likely inputs and why, dead times, bands; the oracle is how it was made."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.signal

import splitband as sb
from splitband.checks.inspection import Inspection, as_found, of_unnamed, unnamed_inputs
from splitband.records.signals import ReadingWarning
from splitband.runtime.arrays import Array

N = 3000
Made = tuple[dict[str, Any], set[str]]


def lag(pole: float, u: Array, late: int = 1) -> Array:
    """A first-order lag of gain 1, after a dead time."""
    numerator = [0.0] * late + [1 - pole]
    return np.asarray(scipy.signal.lfilter(numerator, [1, -pole], u))


def held(rng: np.random.Generator, samples: int) -> Array:
    return np.repeat(rng.uniform(-1, 1, N // samples), samples)


def stepped(rng: np.random.Generator) -> Made:
    u = held(rng, 60)
    return {"p": lag(0.95, u) + 0.02 * rng.normal(size=N), "q": u}, {"q"}


def smooth(rng: np.random.Generator) -> Made:
    u = lag(0.9, rng.normal(size=N))
    return {"p": u, "q": lag(0.8, u) + 0.01 * rng.normal(size=N)}, {"p"}


def slow(rng: np.random.Generator) -> Made:
    """In one sample, the effect is a tenth of the noise."""
    u = held(rng, 300)
    return {"p": lag(0.99, u) + 0.1 * rng.normal(size=N), "q": u}, {"q"}


def several(rng: np.random.Generator) -> Made:
    u, v = held(rng, 40), lag(0.9, rng.normal(size=N))
    y, z = lag(0.9, u) + lag(0.95, v, 5), lag(0.97, u - v)
    noise = 0.01 * rng.normal(size=(2, N))
    return {"p": u, "q": y + noise[0], "r": v, "s": z + noise[1]}, {"p", "r"}


def quantised(rng: np.random.Generator) -> Made:
    """The output moves by its smallest step only, and rests between."""
    u = lag(0.98, rng.normal(size=N))
    return {"p": np.round(lag(0.98, u) / 0.02) * 0.02, "q": u + 0.001 * rng.normal(size=N)}, {"q"}


def relay(rng: np.random.Generator) -> Made:
    """A thermostat: the heater follows the temperature, too."""
    on, t = np.zeros(N), np.full(N, 18.0)
    for k in range(1, N):
        on[k] = on[k - 1] if 19 < t[k - 1] < 21 else t[k - 1] <= 19
        t[k] = t[k - 1] + 0.01 * (10 - t[k - 1]) + 0.25 * on[k]
    return {"p": t + 0.05 * rng.normal(size=N), "q": on}, {"q"}


def vibrating(rng: np.random.Generator) -> Made:
    modes = [scipy.signal.lfilter([1], [1, -a, 0.95], rng.normal(size=N)) for a in (1.9, 1.6)]
    return {"p": modes[0] + modes[1], "q": modes[0] - modes[1]}, set()


def walking(rng: np.random.Generator) -> Made:
    return dict(zip("pq", np.cumsum(rng.normal(size=(2, N)), axis=1), strict=True)), set()


@pytest.mark.parametrize(
    "made", [stepped, smooth, slow, several, quantised, relay, vibrating, walking]
)
@pytest.mark.parametrize("seed", [1, 2])
def test_likely_inputs_are_found_without_their_names(
    made: Callable[[np.random.Generator], Made], seed: int
) -> None:
    columns, inputs = made(np.random.default_rng(seed))
    record = sb.Record(np.column_stack([*columns.values()]), 0.1, columns=tuple(columns))
    assert {column.name for column in unnamed_inputs(record)} == inputs


def inspected(**columns: Any) -> Inspection:
    rows = len(next(iter(columns.values())))
    return sb.inspect(pd.DataFrame({"time": 0.1 * np.arange(rows)} | columns))


def test_names_decide_where_nothing_else_does() -> None:
    white = np.random.default_rng(0).normal(size=(2, 500))
    found = inspected(motor_pwm=white[0], speed=white[1])
    assert (found.record.inputs, found.columns[0].reasons) == (("motor_pwm",), ("is named so",))
    assert not found.columns[0].clear
    (said,) = of_unnamed(found.columns[:1])
    assert said.startswith("perhaps inputs")


def test_text_that_does_not_act_is_no_input() -> None:
    valve = np.random.default_rng(3).random(N)
    columns = {"valve": valve, "level": lag(0.9, valve, 1), "Operator name": [*"ab"] * (N // 2)}
    with pytest.warns(ReadingWarning, match="left out: 'Operator name' .no numbers"):
        found = inspected(**columns)
    assert [column.name for column in found.columns] == ["valve", "level"]


def test_words_are_offered_as_inputs_only_where_no_columns_are_named(tmp_path: Path) -> None:
    rows = {"time": 0.1 * np.arange(N), "level": np.arange(N), "mode": [*"ab"] * (N // 2)}
    pd.DataFrame(rows).to_csv(tmp_path / "rig.csv", index=False)
    with pytest.warns(ReadingWarning):
        assert as_found(tmp_path / "rig.csv").inputs == ("mode",)
    assert as_found(tmp_path / "rig.csv", columns=["level"]).inputs == ()


def test_an_inspection_says_what_the_record_holds() -> None:
    rng = np.random.default_rng(3)
    valve = np.repeat(rng.integers(0, 2, N // 50), 50).astype(np.float64)
    level = lag(0.9, valve, 41) + 0.01 * rng.normal(size=N)
    level[[7, 8]] = np.nan
    word = np.where(valve, "open", "closed")
    columns = {"valve": word, "level [m]": level, "spare": np.zeros(N)}
    with pytest.warns(ReadingWarning, match="0 .closed. and 1 .open."):
        found = inspected(**columns)
    by_name = {column.name: column for column in found.columns}
    assert {name: column.role for name, column in by_name.items()} == {
        "valve": "input",
        "level [m]": "output",
        "spare": "constant",
    }
    assert by_name["valve"].reasons[0].endswith("times between closed and open")
    assert by_name["level [m]"].missing == 2
    assert by_name["level [m]"].range.endswith(" m")
    assert found.dead_times == {("valve", "level [m]"): pytest.approx(4.0)}
    assert found.options == {"inputs": ["valve"], "columns": ["level [m]"], "gaps": "mask"}
    assert "2 masked (rows 7 to 8)" in found.in_words()[0]
    with pytest.warns(ReadingWarning):
        again = sb.read(pd.DataFrame({"time": 0.1 * np.arange(N)} | columns), **found.options)
    np.testing.assert_array_equal(again.u, found.record.u)
    assert "dead time: valve to level [m] 4 s (40 samples)" in repr(found)


def test_bands_are_said_where_there_are_two() -> None:
    time = 0.01 * np.arange(N)
    slow = np.sin(2 * np.pi * 0.2 * time)
    both = slow + 0.5 * np.sin(2 * np.pi * 10 * time)
    assert inspected(p=slow).in_words()[-1].startswith("no high band: nothing to split")
    found = inspected(p=both)
    assert found.in_words()[-1].startswith("two bands: 20 % of the power")
    assert found.share_above == pytest.approx(0.2, rel=0.01)  # 0.5 ** 2 of 1 + 0.5 ** 2
    noise = np.random.default_rng(0).normal(size=N)
    assert inspected(p=noise).in_words()[-1].startswith("no two bands: nothing to split")


def test_inputs_that_are_given_stay_and_a_set_point_is_held() -> None:
    rng = np.random.default_rng(5)
    target = held(rng, 100)
    y = lag(0.95, target) + 0.01 * rng.normal(size=N)
    logged = np.where(np.diff(target, prepend=np.nan) != 0, target, np.nan)
    with pytest.warns(ReadingWarning, match="column 'goal' has a value in 30 of 3000 rows"):
        found = inspected(goal=logged, p=y)
    assert found.record.inputs == ("goal",)
    np.testing.assert_array_equal(found.record.u[:, 0], target)
    given = sb.Record(target, 0.1, u=y, columns=("goal",), inputs=("p",))
    assert sb.inspect(given).record.inputs == ("p",)


@pytest.mark.parametrize("bad", [np.zeros(9), None])
def test_what_is_no_record_is_refused(bad: Any) -> None:
    with pytest.raises(TypeError, match="record must be a Record"):
        sb.inspect(bad)


def test_a_column_that_counts_up_may_number_runs_and_is_asked_about() -> None:
    u = np.repeat(np.random.default_rng(4).uniform(-1, 1, N // 25), 25)
    run = 1.0 + np.arange(N) // (N // 3)
    found = inspected(run=run, force=u, level=lag(0.9, u, 1))
    assert {c.name: c.role for c in found.columns}["run"] == "label?"
    assert found.options == {"inputs": ["force"], "columns": ["level"]}
    (said,) = found.warnings
    assert "--runs run" in said
    assert "--inputs" in said
    step = (np.arange(N) > N // 2).astype(float)  # a step test has one step, too
    roles = {c.name: c.role for c in inspected(valve=step, level=lag(0.9, step, 1)).columns}
    assert roles["valve"] == "input"
    mode, gear = np.digitize(u, (-0.5, 0.5)), np.digitize(u, (-0.3, 0.3))
    found = inspected(Mode=1.0 * mode, gear=1.0 * gear, run=7.0 * run, level=lag(0.9, u, 1))
    roles = {c.name: c.role for c in found.columns}
    assert (roles["Mode"], roles["run"], roles["gear"]) == ("label?", "label?", "input")
    assert "inputs" not in found.options or "Mode" not in found.options["inputs"]


def test_the_delay_of_a_slow_nonlinear_response_is_called_uncertain(public_data: Path) -> None:
    """Of the cascaded tanks of the nonlinear benchmark a delay of 64 s was said; they have none."""
    path = public_data / "benchmarks" / "ct_test.csv"
    if not path.exists():
        pytest.skip("the benchmark is not there")
    found = sb.inspect(sb.read(path, inputs=["u"]))
    assert any("64 s (16 samples; uncertain, as neither half" in said for said in found.in_words())
