"""`--parameters`: the simulator's parameters are fitted, by every command."""

import json
import os
import pickle  # noqa: TID251
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.cli.options import RecordOptions, SimulatorOrBaseOptions
from splitband.cli.requests import Request, planned
from tests.cli.support import assert_fails, call, process, results

PLANT = """
import splitband as sb


def lag(t, x, u, p):
    return [p.rate * (u[0] - x[0])]


def decay(time, u, p):
    return p.level * 2.718281828 ** (-time)


def slip(t, x, u, p):
    return [p.rat * (u[0] - x[0])]


def drag(t, x, u, p, w):
    return [p.rate * u[0] - w[0]]


plant = sb.Ode(lag, [0.0], parameters={"rate": (0.1, 1.0)})
number = 3
"""
LAG = "--simulator plant.py:lag --parameters rate=0.1:10,x0_1=0"
RIG = f"record.csv --inputs u {LAG}"
QUICK = "--recipe constant-rate --epochs 1 --hidden 3,4 --window 30 --warmup 10 --seeds 1 --jobs 1"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of x' = 2 (u - x), its input held by the measurement."""
    folder = tmp_path_factory.mktemp("rig")
    time = 0.1 * np.arange(100)
    u = np.sin(time) + np.sin(0.3 * time)
    exact, x = [], 0.0
    for n in range(100):
        exact.append(x)
        for i in range(100):  # Euler, as fine as it needs to be
            at = u[n] + i / 100 * (u[min(n + 1, 99)] - u[n])
            x += 0.1 / 100 * 2 * (at - x)
    noise = np.random.default_rng(0).normal(0, 0.01, 100)
    table = pd.DataFrame({"time": time, "y": exact + noise, "u": u})
    table.to_csv(folder / "record.csv", index=False)
    table[:80].to_csv(folder / "history.csv", index=False)
    table[["time", "u"]][80:].to_csv(folder / "coming.csv", index=False)
    (folder / "plant.py").write_text(PLANT)
    return folder


@pytest.fixture(autouse=True)
def inside_rig(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig)


def test_compare_puts_fitted_parameters_beside_other_methods(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"compare {RIG} {QUICK} --methods simulator,mean --verbose", tmp_path)
    found = results(tmp_path)["methods"]
    assert list(found) == ["grey-box", "mean"]
    assert found["grey-box"]["parameters"]["values"] == pytest.approx({"rate": 2.0}, rel=0.02)
    assert 0 < found["grey-box"]["parameters"]["standard_errors"]["rate"] < 0.02
    assert results(tmp_path)["recommended"] == "grey-box"
    said = capsys.readouterr().out
    assert "rate = " in said
    assert "--simulator plant.py:lag" in said


def test_an_ode_of_a_file_says_its_ranges_itself_to_every_process() -> None:
    reading, simulator = RecordOptions(inputs="u"), SimulatorOrBaseOptions("plant.py:plant")
    plan = planned(Request("record.csv", reading, simulator))
    methods = {method.name: method for method in plan.methods}
    assert {"simulator-as-given", "residual-grey-box-state-space-conditioned"} <= methods.keys()
    sent = pickle.loads(pickle.dumps(methods["grey-box"])).fit(plan.record)
    assert sent.estimate.remarks == ("rate is at its upper bound, 1",)


def test_unknown_terms_of_an_equation_stand_beside_it_and_beside_hybrids() -> None:
    how = {"parameters": "rate=0.1:10,x0_1=0", "unknown": ["y", "u"], "unknown_odd": True}
    simulator = SimulatorOrBaseOptions("plant.py:drag", **how)  # type: ignore[arg-type]
    plan = planned(Request("record.csv", RecordOptions(inputs="u"), simulator))
    methods: dict[str, Any] = {method.name: method for method in plan.methods}
    rows = ["simulator-as-given", "grey-box-without-terms", "grey-box"]
    assert [name for name in methods if name in rows] == rows
    found = {name: methods[name].simulator.matched(["y"], ["u"]).terms for name in rows}
    assert [[term.free for term in terms] for terms in found.values()] == [
        [False, False],
        [False, False],
        [True, True],
    ]
    assert [(term.label(0), term.odd) for term in found["grey-box"]] == [("y", True), ("u", True)]
    assert not any(methods["simulator-as-given"].simulator.known.free)
    outside = methods["residual-grey-box-state-space-conditioned"].base.simulator
    assert not any(term.free for term in outside.terms)
    sent = pickle.loads(pickle.dumps(methods["grey-box"])).simulator
    assert repr(sent.terms) == repr(methods["grey-box"].simulator.terms)


def test_a_saved_grey_box_simulates_with_its_values(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"fit {RIG} --method grey-box --train 80 --jobs 1", tmp_path / "model")
    line = f"simulate {tmp_path}/model --history history.csv --future-inputs coming.csv --steps 20"
    call(f"{line} --simulator plant.py:lag", tmp_path / "ahead.csv")
    found = pd.read_csv(tmp_path / "ahead.csv")["y"]
    expected = pd.read_csv("record.csv")["y"][80:]
    np.testing.assert_allclose(found, expected, atol=0.05)
    said = capsys.readouterr()
    assert "is another one than" not in said.out + said.err
    line = f"simulate {tmp_path}/model --history history.csv --future-inputs coming.csv --steps 5"
    says = ("no attribute 'rat' (plant.py, line 14)",)
    assert_fails(f"{line} --out other.csv --simulator plant.py:slip", says, capsys)


def test_a_saved_equation_knows_of_what_its_unknown_term_is_a_function(tmp_path: Path) -> None:
    how = "--simulator plant.py:drag --parameters rate=2,x0_1=0 --unknown y --unknown-odd"
    call(f"fit record.csv --inputs u {how} --method grey-box --train 80 --jobs 1", tmp_path / "m")
    low, high = results(tmp_path / "m")["parameters"]["unknown"][0]["in_training"]["y"]
    largest = pd.read_csv("record.csv")["y"][:80].abs().max()
    assert -low == high == pytest.approx(largest, rel=0.05)
    line = f"simulate {tmp_path}/m --history history.csv --future-inputs coming.csv --steps 20"
    call(f"{line} --simulator plant.py:drag", tmp_path / "ahead.csv")
    found = pd.read_csv(tmp_path / "ahead.csv")["y"]
    np.testing.assert_allclose(found, pd.read_csv("record.csv")["y"][80:], atol=0.1)


def test_held_inputs_are_doubted_where_they_fit_worse_and_kept_in_the_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"fit {RIG} --method grey-box --simulator-hold zoh --jobs 1", tmp_path / "held")
    said = capsys.readouterr().out
    assert "warning: the record favours inputs that are interpolated" in said
    assert said.count("the record favours") == 1
    found = results(tmp_path / "held")["parameters"]
    assert found["hold"] == "zoh"
    for name, hold in ("ahead", ""), ("zoh", "--simulator-hold zoh"):  # as fitted without it, too
        line = f"simulate {tmp_path}/held --history history.csv --future-inputs coming.csv"
        call(f"{line} --steps 5 --simulator plant.py:lag {hold}", tmp_path / f"{name}.csv")
    assert (tmp_path / "ahead.csv").read_text() == (tmp_path / "zoh.csv").read_text()
    capsys.readouterr()
    call(f"fit {RIG} --method grey-box --jobs 1", tmp_path / "straight")
    assert "the record favours" not in capsys.readouterr().out
    given = "--record record.csv --simulator plant.py:lag --simulator-hold zoh"
    line = f"check {tmp_path}/straight {given}"
    says = ("--simulator must have hold='linear'",)
    assert_fails(f"{line} --out {tmp_path}/check", says, capsys)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--simulator plant.py:decay --parameters level=1 --simulator-hold zoh", "inputs alone"),
        ("--simulator-hold zoh", "must be given where --simulator-hold is"),
        ("--simulator plant.py:lag --parameters rate=1:x", "parameters must be given as NAME="),
        ("--simulator plant.py:lag --parameters rate=0.1:1", "how many states"),
        ("--simulator plant.py:number --parameters rate=0.1:1", "must define a function"),
        ("--simulator record.csv --parameters rate=0.1:1", "--parameters must be left out but for"),
        ("--simulator plant.py:drag --parameters rate=1,x0_1=0", "--unknown must say of what"),
        (f"{LAG} --unknown x1", "rhs must take the outputs w of unknown terms"),
        (
            "--simulator plant.py:drag --parameters x0_1=0 --unknown v",
            "inputs of the record, u: got v",
        ),
        ("--simulator plant.py:decay --unknown y", "left out but for a differential equation"),
        (
            "--unknown x1",
            "unknown (--unknown) must be left out but for a simulator that is FILE.py",
        ),
        ("--unknown-odd", "--unknown must say of what"),
        ("--methods grey-box", "needs a simulator with parameters"),
        (f"{LAG} --test history.csv --test-simulator nothing.csv", "--test-simulator must be left"),
    ],
)
def test_what_cannot_be_fitted_is_refused(
    options: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_fails(f"compare record.csv --inputs u {options} {QUICK}", (message,), capsys)


LOUD = """
import ctypes, os


def loud(time, u, p):
    print("from Python")
    os.system("echo from a shell")
    ctypes.CDLL(None).puts(b"from C")
    return p.level * 2.718281828 ** (-time)
"""


@pytest.mark.skipif(os.name == "nt", reason="prints by the C library of a shell's system")
def test_what_a_simulator_prints_while_it_is_fitted_is_no_part_of_the_json(
    tmp_path: Path,
) -> None:
    (tmp_path / "loud.py").write_text(LOUD)
    line = f"fit record.csv --columns y --method grey-box --simulator {tmp_path}/loud.py:loud"
    line += f" --parameters level=0.1:10 --out {tmp_path}/model --json"
    found = process(sys.executable, "-m", "splitband", *line.split())
    assert json.loads(found.stdout) == results(tmp_path / "model")
    assert {"from Python", "from a shell", "from C"} <= {*found.stderr.splitlines()}
