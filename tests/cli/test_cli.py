"""The command line: what its commands write, and one line and exit status 2 for bad input."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import scipy.integrate
import scipy.signal

from splitband import read
from splitband.cli import main
from splitband.evaluation.comparison import compare
from splitband.evaluation.setup import Setup
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import Sizes
from splitband.models import Filtered
from splitband.models.saving import load
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.processes import over
from splitband.simulators.calibration import Calibration
from splitband.training import Settings
from tests.runtime.test_processes import eventually

pytestmark = pytest.mark.xdist_group("command line")  # what its fixtures train is made once

Array = npt.NDArray[np.float64]
Files = dict[str, bytes]

SAMPLES, TRAIN, WARMUP, DT = 200, 150, 10, 0.1
TIME = DT * np.arange(SAMPLES)
SLOW, FAST = 0.3, 2.0  # Hz, both on a bin of the record's spectrum
A = np.sin(2 * np.pi * SLOW * TIME) + 0.3 * np.sin(2 * np.pi * FAST * TIME)
B = 2 + 0.5 * np.cos(2 * np.pi * SLOW * TIME)
FORCE = np.sign(np.sin(TIME))
SIMULATED = 0.8 * np.sin(2 * np.pi * SLOW * TIME + 0.2) + 0.3
QUICK = "--recipe paper --epochs 2 --hidden 4,3 --window 30 --warmup 10"

FUNCTIONS = """
import sys
import time as clock

import numpy as np

number = 3


def good(time):
    return 0.8 * np.sin(2 * np.pi * 0.3 * time + 0.2) + 0.3


def shifted(time):
    return good(time) + 5


def late(time):
    return good(0.97 * time)


def constant(time):
    return np.ones_like(time)


def raising(time):
    raise RuntimeError("no convergence\\nafter 7 steps")


def short(time):
    return time[:10]


def wide(time):
    return np.zeros((len(time), 3))


def holed(time):
    return np.where(np.arange(len(time)) == 17, np.nan, time)


def hanging(time):
    clock.sleep(1.5)
    return time


def leaving(time):
    sys.exit(0)


def interrupted(time):
    raise KeyboardInterrupt
"""


def write_records(folder: Path) -> None:
    """A good record and simulator, and what can be wrong with either."""
    stamps = TIME.round(9)
    record = pd.DataFrame({"time": stamps, "a": A, "b": B, "force": FORCE})
    simulated = pd.DataFrame({"time": stamps, "a": SIMULATED, "b": B + 0.1})
    holed, infinite, uneven, worded = (record.copy() for _ in range(4))
    holed.loc[7, "a"] = np.nan
    infinite.loc[8, "a"] = np.inf
    uneven.loc[50:, "time"] += 0.05
    worded["a"] = worded["a"].astype(object)
    worded.loc[9, "a"] = "oops"
    slow, holed_simulation = record.iloc[:50].copy(), simulated.copy()
    slow["time"] *= 2
    holed_simulation.loc[3, "a"] = np.nan
    tables = {
        "record": record, "holed": holed, "infinite": infinite, "uneven": uneven, "worded": worded,
        "untimed": record[["a"]], "tiny": record.iloc[:5], "empty": record.iloc[:0],
        "still": record[["time"]].assign(a=2.0), "simulated": simulated,
        "simulated_short": simulated.iloc[:190], "simulated_slow": simulated.iloc[::2],
        "simulated_holed": holed_simulation,
        "simulated_names": simulated.rename(columns={"a": "p", "b": "q"}),
        "history": record.iloc[:50], "history_short": record.iloc[:5],
        "history_renamed": record.iloc[:50].rename(columns={"a": "z"}), "history_slow": slow,
        "history_holed": holed.iloc[:50], "future": record.iloc[50:70][["time", "force"]],
        "future_short": record.iloc[50:60][["force"]],
    }  # fmt: skip
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    (folder / "functions.py").write_text(FUNCTIONS)
    (folder / "broken.py").write_text("def good(:\n")
    (folder / "folder").mkdir()
    (folder / "damaged.fmu").write_bytes(b"PK junk")
    with zipfile.ZipFile(folder / "hollow.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<fmi")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli")
    write_records(folder)
    return folder


@pytest.fixture(autouse=True)
def inside(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test runs in the folder of the records."""
    monkeypatch.chdir(workspace)


def call(line: str, folder: Path | None = None) -> None:
    """Run a command that must succeed."""
    assert main([*shlex.split(line), *(["--out", str(folder)] if folder else [])]) == 0


def results(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return found


def files(folder: Path) -> Files:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def written(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, dtype=str).astype(float)  # to the last bit


def rms(*errors: Array) -> float:
    return float(np.sqrt(np.mean(sum(e**2 for e in errors))))


def assert_pictures(folder: Path, *names: str) -> None:
    for name in names:
        height, width = matplotlib.image.imread(folder / name).shape[:2]
        assert 600 <= width <= 3000
        assert 250 <= height <= 6000
    assert sorted(p.name for p in folder.glob("*.png")) == sorted(names)


@pytest.fixture
def drawn() -> None:
    """For tests that look at pictures."""


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere pictures are made, but not written, which takes the longest."""
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr("splitband.report.pictures.save", lambda figure, path: None)


# ---------------------------------------------------------------- compare


@pytest.fixture(scope="module")
def compared(workspace: Path) -> Path:
    methods = "gru,split-gru-hp,persistence,seasonal-naive,harmonic"
    out = workspace / "compared"
    line = f"compare {workspace}/record.csv --columns a --methods {methods} {QUICK} --seeds 1"
    call(f"{line} --jobs 1", out)
    return out


def test_compare_writes_every_method_with_one_entry_a_seed(compared: Path) -> None:
    found = results(compared)
    names = ["gru", "split-gru-hp", "persistence", "seasonal-naive", "harmonic"]
    assert list(found["methods"]) == names
    for facts in found["methods"].values():
        for key in ("total_rmse", "forecast_rmse", "seconds"):
            assert [type(value) for value in facts[key]] == [float]
            assert facts[key][0] >= 0
    assert set(found["methods"]["gru"]["final_loss"][0]) == {"network"}
    assert set(found["methods"]["split-gru-hp"]["final_loss"][0]) == {"low band", "high band"}


def test_compare_writes_what_is_needed_to_run_it_again(compared: Path) -> None:
    found = results(compared)
    assert found["record"] == {
        "name": "record", "samples": SAMPLES, "sampling_time": pytest.approx(DT),
        "start": 0.0, "columns": ["a"], "inputs": 0, "gaps": 0, "truth": "measured",
    }  # fmt: skip
    settings = found["settings"]
    choice = settings["choice"]
    for name in ("cutoff", "order", "downsampling"):
        assert settings[name] == choice[name]
    assert [c["cutoff"] for c in choice["candidates"] if not c["rejected"]] == [choice["cutoff"]]
    assert settings["train"] == TRAIN
    assert (settings["hidden_high"], settings["hidden_low"]) == (4, 3)
    training = settings["settings"]
    assert (training["window"], training["warmup"], training["epochs"]) == (30, WARMUP, 2)
    assert SLOW < settings["cutoff"] < FAST
    assert found["command"] == "compare"
    assert (found["arguments"]["columns"], found["arguments"]["hidden"]) == ("a", "4,3")
    assert set(found["environment"]) == {"versions", "machine", "commit"}
    assert found["environment"]["versions"]["numpy"] == np.__version__


def test_compare_gives_the_numbers_of_the_library(compared: Path) -> None:
    facts = results(compared)
    chosen = {name: facts["settings"][name] for name in ("cutoff", "order", "downsampling")}
    setup = replace(
        Setup(
            TRAIN,
            Settings(30, WARMUP, 2),
            bands=Bands(1.0, 1, 2),
            sizes=Sizes(hidden_high=4, hidden_low=3),
        ),
        **chosen,
    )
    record = read("record.csv", columns="a")
    for name, (run,) in compare(record, ["gru", "split-gru-hp"], setup).items():
        assert facts["methods"][name]["total_rmse"] == [run.total_rmse]
        assert facts["methods"][name]["forecast_rmse"] == [run.forecast_rmse]


def test_compare_follows_both_protocols_to_the_letter(compared: Path) -> None:
    facts = results(compared)["methods"]
    held = facts["persistence"]
    assert held["total_rmse"] == [pytest.approx(rms(A[WARMUP:] - A[WARMUP - 1]))]
    assert held["forecast_rmse"] == [pytest.approx(rms(A[TRAIN:] - A[TRAIN - 1]))]
    assert facts["harmonic"]["total_rmse"][0] < 1e-6  # the record is two sinusoids


def test_compare_draws_its_pictures(compared: Path) -> None:
    assert_pictures(compared, "rollouts.png", "error.png", "spectrum.png", "components.png")


def test_compare_recommends_a_method_and_says_how_sure_it_is(compared: Path) -> None:
    found = results(compared)
    held_out = {name: facts["held_out_rmse"] for name, facts in found["methods"].items()}
    assert found["recommended"] == min(held_out, key=lambda name: held_out[name]) == "harmonic"
    table = written(compared / "predictions.csv").iloc[TRAIN:]
    lower, middle, upper = (table[f"a, harmonic, {s}"] for s in ("lower", "forecast", "upper"))
    assert (lower <= middle).all()
    assert (middle <= upper).all()
    inside = table["a"].between(lower, upper).mean()
    assert found["methods"]["harmonic"]["interval"]["covers"] == pytest.approx(inside)
    assert "a, gru, lower" not in table


def test_compare_leaves_nothing_but_results_and_pictures(compared: Path) -> None:
    pictures = {path.name for path in compared.glob("*.png")}
    assert set(files(compared)) == {"results.json", "predictions.csv", *pictures}


def test_the_predictions_beside_the_results_have_the_errors_in_them(compared: Path) -> None:
    table, found = written(compared / "predictions.csv"), results(compared)["methods"]
    np.testing.assert_allclose(table["time"], TIME)
    np.testing.assert_array_equal(table["a"], A)
    for name, facts in found.items():
        for protocol, key in (("from start", "total_rmse"), ("forecast", "forecast_rmse")):
            predicted = table[f"a, {name}, {protocol}"].dropna()
            assert len(predicted) == SAMPLES - (WARMUP if key == "total_rmse" else TRAIN)
            errors = (table["a"] - predicted).dropna().to_numpy()
            assert facts[key] == [pytest.approx(rms(errors))]


def test_compare_prints_its_table_and_where_the_files_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("compare record.csv --columns a --methods persistence,harmonic --horizon 20", tmp_path)
    found, facts = capsys.readouterr(), results(tmp_path)["methods"]
    row = next(line for line in found.out.splitlines() if "persistence" in line)
    assert f"{facts['persistence']['total_rmse'][0]:.3f}" in row
    assert f"{facts['persistence']['forecast_rmse'][0]:.3f}" in row
    assert "from the start" in found.out
    assert str(tmp_path) in found.out
    assert found.err == ""


def test_the_horizon_ends_both_protocols(tmp_path: Path) -> None:
    call("compare record.csv --columns a --methods persistence --train 120 --horizon 30 "
         "--warmup 10", tmp_path)  # fmt: skip
    found = results(tmp_path)
    assert found["record"]["samples"] == 150
    facts = found["methods"]["persistence"]
    assert facts["forecast_rmse"] == [pytest.approx(rms(A[120:150] - A[119]))]
    assert facts["total_rmse"] == [pytest.approx(rms(A[10:150] - A[9]))]


@pytest.mark.usefixtures("drawn")
def test_compare_takes_several_channels_and_known_inputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"compare record.csv --columns a,b --inputs force --methods rnn,split-gru,persistence "
         f"{QUICK} --seeds 1 --jobs 1 --lr-milestones 1:1e-4 --order 2 "
         "--cutoff 1", tmp_path)  # fmt: skip
    found = results(tmp_path)
    assert (found["record"]["columns"], found["record"]["inputs"]) == (["a", "b"], 1)
    assert found["settings"]["settings"]["milestones"] == [[1, 1e-4]]
    assert (found["settings"]["cutoff"], found["settings"]["order"]) == (1.0, 2)
    held = [rms(*(y[n:] - y[n - 1] for y in (A, B))) for n in (WARMUP, TRAIN)]
    facts = found["methods"]["persistence"]
    assert [*facts["total_rmse"], *facts["forecast_rmse"]] == pytest.approx(held)
    assert np.isfinite(found["methods"]["rnn"]["total_rmse"]).all()
    each = [[rms(y[n:] - y[n - 1]) for y in (A, B)] for n in (WARMUP, TRAIN)]
    expected = dict(zip(("total_rmse", "forecast_rmse"), each, strict=True))
    assert facts["by_channel"] == {name: pytest.approx(both) for name, both in expected.items()}
    assert "by channel: a " in capsys.readouterr().out
    assert_pictures(tmp_path, "rollouts.png", "error.png", "spectrum.png", "components.png")


def test_several_seeds_are_run_by_as_many_processes_as_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def in_this_process(work: Any, jobs: Any, processes: int, progress: Any) -> Any:
        asked.append((len(jobs), processes))
        return over(work, jobs, 1, progress)

    monkeypatch.setattr("splitband.evaluation.comparison.over", in_this_process)
    call(f"compare record.csv --columns a --methods gru {QUICK} --seeds 3 --jobs 2", tmp_path)
    assert asked == [(2, 2), (3, 2)]  # two seeds are tried out, three trained
    found = results(tmp_path)["methods"]["gru"]
    assert found["seeds"] == [0, 1, 2]
    assert len({*found["total_rmse"]}) == 3
    assert found["total_rmse_std"] == pytest.approx(np.std(found["total_rmse"], ddof=1))


# ---------------------------------------------------------------- compare with a simulator


@pytest.fixture(scope="module")
def hybrid(workspace: Path) -> Path:
    methods = "filtered-gru,residual-gru,gru,simulator,simulator-affine"
    out = workspace / "hybrid"
    call(f"compare {workspace}/record.csv --columns a --simulator {workspace}/simulated.csv "
         f"--methods {methods} --calibrate {QUICK} --seeds 1 --jobs 1", out)  # fmt: skip
    return out


def test_calibration_adds_a_row_to_each_hybrid_method_only(hybrid: Path) -> None:
    found = results(hybrid)["methods"]
    assert list(found) == [
        "filtered-gru", "filtered-gru-calibrated", "residual-gru", "residual-gru-calibrated",
        "gru", "simulator", "simulator-calibrated", "simulator-affine",
    ]  # fmt: skip
    for name in ("filtered-gru", "residual-gru"):
        assert found[name]["total_rmse"] != found[f"{name}-calibrated"]["total_rmse"]


def test_calibrated_and_conditioned_variants_follow_the_method(tmp_path: Path) -> None:
    call("compare record.csv --columns a --simulator simulated.csv --methods filtered-gru "
         f"--calibrate --conditioned {QUICK} --seeds 1 --jobs 1", tmp_path)  # fmt: skip
    found = results(tmp_path)["methods"]
    assert list(found) == [
        "filtered-gru", "filtered-gru-calibrated", "filtered-gru-conditioned",
        "filtered-gru-calibrated-conditioned",
    ]  # fmt: skip
    errors = [facts["total_rmse"][0] for facts in found.values()]
    assert np.isfinite(errors).all()
    assert len(set(errors)) == 4


def test_the_simulator_rows_are_its_error_raw_and_after_least_squares(hybrid: Path) -> None:
    found = results(hybrid)["methods"]
    gain, offset = np.polyfit(SIMULATED[:TRAIN], A[:TRAIN], 1)
    for name, y in (("simulator", SIMULATED), ("simulator-affine", gain * SIMULATED + offset)):
        assert found[name]["total_rmse"] == [pytest.approx(rms((A - y)[WARMUP:]))]
        assert found[name]["forecast_rmse"] == [pytest.approx(rms((A - y)[TRAIN:]))]


def test_hybrid_comparisons_show_the_components(hybrid: Path) -> None:
    assert_pictures(hybrid, "rollouts.png", "error.png", "spectrum.png", "components.png")


@pytest.mark.usefixtures("drawn")
def test_without_methods_of_several_parts_there_is_no_picture_of_components(tmp_path: Path) -> None:
    call("compare record.csv --columns a --methods persistence,simulator --warmup 10 "
         "--simulator functions.py:good", tmp_path)  # fmt: skip
    assert_pictures(tmp_path, "rollouts.png", "error.png", "spectrum.png")


def test_a_function_is_as_good_a_simulator_as_its_exported_trajectory(
    hybrid: Path, tmp_path: Path
) -> None:
    call("compare record.csv --columns a --methods simulator --warmup 10 "
         "--simulator functions.py:good --simulator-timeout 30", tmp_path)  # fmt: skip
    expected = results(hybrid)["methods"]["simulator"]
    found = results(tmp_path)["methods"]["simulator"]
    assert found["total_rmse"] == pytest.approx(expected["total_rmse"], rel=1e-9)


@pytest.mark.parametrize("options", ["simulated.csv", "simulated_names.csv --simulator-columns q"])
def test_the_columns_of_an_exported_trajectory_go_by_name_or_as_asked(
    options: str, tmp_path: Path
) -> None:
    call(f"spectrum record.csv --columns b --simulator {options}", tmp_path)
    assert results(tmp_path)["simulator"]["total_rmse"] == pytest.approx(0.1)


def test_an_fmu_serves_as_simulator(van_der_pol_fmu: Path, tmp_path: Path) -> None:
    call(f"spectrum record.csv --columns a --simulator {van_der_pol_fmu} --simulator-columns x",
         tmp_path)  # fmt: skip
    y = scipy.integrate.solve_ivp(
        lambda _, s: [s[1], (1 - s[0] ** 2) * s[1] - s[0]], (0, TIME[-1]), [-2, 1], t_eval=TIME,
        rtol=1e-9, atol=1e-9,
    ).y[0]  # fmt: skip
    assert results(tmp_path)["simulator"]["total_rmse"] == pytest.approx(rms(A - y), rel=1e-6)


# ---------------------------------------------------------------- fit and simulate


@pytest.fixture(scope="module")
def model(workspace: Path) -> Path:
    out = workspace / "gru"
    call(f"fit {workspace}/record.csv --columns a,b --method gru {QUICK}", out)
    return out


@pytest.fixture(scope="module")
def hybrid_model(workspace: Path) -> Path:
    out = workspace / "filtered"
    call(f"fit {workspace}/record.csv --columns a --method filtered-gru --calibrate {QUICK} "
         f"--simulator {workspace}/simulated.csv", out)  # fmt: skip
    return out


@pytest.fixture(scope="module")
def driven_model(workspace: Path) -> Path:
    out = workspace / "driven"
    call(f"fit {workspace}/record.csv --columns a --inputs force --method gru {QUICK}", out)
    return out


def test_fit_writes_a_model_and_what_it_reached(model: Path) -> None:
    assert set(files(model)) == {"model.json", "weights.safetensors", "results.json"}
    found = results(model)
    assert (found["method"], found["columns"], found["inputs"]) == ("gru", ["a", "b"], [])
    assert found["setup"]["train"] == SAMPLES
    loaded, _ = load(model)
    y = np.stack([A, B], axis=1)
    error = loaded.simulate(y[:WARMUP], SAMPLES - WARMUP) - y[WARMUP:]
    assert found["training_rmse"] == pytest.approx(rms(*error.T))


def test_the_same_seed_fits_the_same_model(model: Path, tmp_path: Path) -> None:
    line = f"fit record.csv --columns a,b --method gru {QUICK} --seed"
    for seed in (0, 1):
        call(f"{line} {seed}", tmp_path / str(seed))
    weights = [p / "weights.safetensors" for p in (model, tmp_path / "0", tmp_path / "1")]
    expected, same, other = (path.read_bytes() for path in weights)
    assert same == expected != other


def test_fit_sees_the_training_samples_only(model: Path, tmp_path: Path) -> None:
    pd.read_csv("record.csv").assign(a=lambda t: t["a"].where(t.index < 100, 50.0)).to_csv(
        tmp_path / "other.csv", index=False
    )
    for name in ("record.csv", str(tmp_path / "other.csv")):
        call(f"fit {name} --columns a --method split-gru --train 100 {QUICK}",
             tmp_path / Path(name).stem)  # fmt: skip
    found = [tmp_path / name / "weights.safetensors" for name in ("record", "other")]
    assert found[0].read_bytes() == found[1].read_bytes()


def test_simulate_writes_time_and_columns_of_the_loaded_model(model: Path, tmp_path: Path) -> None:
    call(f"simulate {model} --history history.csv --steps 25", tmp_path / "new" / "ahead.csv")
    table = written(tmp_path / "new" / "ahead.csv")
    assert list(table) == ["time", "a", "b"]
    np.testing.assert_allclose(table["time"], DT * np.arange(50, 75))
    history = read("history.csv", columns=["a", "b"]).y
    expected = load(model)[0].simulate(history[-WARMUP:], 25)
    np.testing.assert_array_equal(table[["a", "b"]], expected)


def test_simulate_needs_no_more_history_than_the_warmup(model: Path, tmp_path: Path) -> None:
    pd.read_csv("history.csv").iloc[-WARMUP:].to_csv(tmp_path / "end.csv", index=False)
    for name in ("history.csv", str(tmp_path / "end.csv")):
        call(f"simulate {model} --history {name} --steps 9", tmp_path / f"to-{Path(name).stem}.csv")
    assert (tmp_path / "to-history.csv").read_text() == (tmp_path / "to-end.csv").read_text()


def test_simulate_warms_up_on_one_sample_where_the_model_does(tmp_path: Path) -> None:
    call("fit record.csv --columns a --method gru --epochs 1 --hidden 4,3 --window 20 --warmup 1",
         tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 3", tmp_path / "ahead.csv")


def test_a_hybrid_model_simulates_on_with_any_simulator(hybrid_model: Path, tmp_path: Path) -> None:
    loaded, facts = load(hybrid_model)
    assert isinstance(loaded, Filtered)
    calibration = Calibration(**facts["calibration"])
    y, y_sim = A[40:50, None], calibration.apply(SIMULATED[:, None], 75, DT)[40:]
    for simulator in ("simulated.csv", "functions.py:good"):
        call(f"simulate {hybrid_model} --history history.csv --steps 25 --simulator {simulator}",
             tmp_path / "ahead.csv")  # fmt: skip
        table = written(tmp_path / "ahead.csv")
        assert table.shape == (25, 2)
        np.testing.assert_allclose(table[["a"]], loaded.simulate(y, 25, y_sim=y_sim), atol=1e-5)


def test_the_simulator_makes_the_low_band_of_a_hybrid_model(
    hybrid_model: Path, tmp_path: Path
) -> None:
    found = []
    for name in ("good", "shifted"):
        call(f"simulate {hybrid_model} --history history.csv --steps 150 "
             f"--simulator functions.py:{name}", tmp_path / f"{name}.csv")  # fmt: skip
        found.append(written(tmp_path / f"{name}.csv")["a"].to_numpy())
    (gain,) = load(hybrid_model)[1]["calibration"]["gain"] or (1.0,)
    assert (found[1] - found[0])[-1] == pytest.approx(5 * gain, rel=1e-3)


def test_a_fitted_calibration_and_conditioning_are_simulated_with(tmp_path: Path) -> None:
    """The simulator is 3 % too slow, and known in closed form at any time."""
    call(f"fit record.csv --columns a --method filtered-gru --calibrate --conditioned {QUICK} "
         "--simulator functions.py:late", tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 150 "
         "--simulator functions.py:late", tmp_path / "ahead.csv")  # fmt: skip
    model, facts = load(tmp_path / "model")
    assert isinstance(model, Filtered)
    assert (facts["method"], model.conditioned) == ("filtered-gru-calibrated-conditioned", True)
    saved = facts["calibration"]
    assert saved["clock"] == pytest.approx(1 / 0.97, abs=5e-3)
    (gain,), (offset,) = saved["gain"] or [1.0], saved["offset"] or [0.0]
    time = np.maximum(saved["clock"] * TIME - saved["delay"], 0)
    late = 0.8 * np.sin(2 * np.pi * SLOW * 0.97 * time + 0.2) + 0.3
    y_sim = (gain * late + offset)[40:, None]
    found = written(tmp_path / "ahead.csv")[["a"]].to_numpy()
    np.testing.assert_allclose(found, model.simulate(A[40:50, None], 150, y_sim=y_sim), atol=1e-3)
    raw = model.simulate(A[40:50, None], 150, y_sim=late[40:, None])
    assert np.abs(found - raw).max() > 0.05


def test_an_exported_trajectory_has_to_reach_the_last_step_and_no_further(tmp_path: Path) -> None:
    call(f"fit record.csv --columns a --method residual-gru --simulator simulated.csv {QUICK}",
         tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 150 "
         "--simulator simulated.csv", tmp_path / "ahead.csv")  # fmt: skip
    assert len(written(tmp_path / "ahead.csv")) == 150


def test_future_inputs_drive_a_model_that_has_inputs(driven_model: Path, tmp_path: Path) -> None:
    pd.DataFrame({"force": [9.0] * 20}).to_csv(tmp_path / "strong.csv", index=False)
    for name in ("future.csv", str(tmp_path / "strong.csv")):
        call(f"simulate {driven_model} --history history.csv --steps 20 --future-inputs {name}",
             tmp_path / f"to-{Path(name).stem}.csv")  # fmt: skip
    plain, strong = (written(tmp_path / f"to-{name}.csv") for name in ("future", "strong"))
    expected = load(driven_model)[0].simulate(A[40:50, None], 20, FORCE[40:70, None])
    np.testing.assert_allclose(plain[["a"]], expected, atol=1e-6)
    assert plain["a"][0] == strong["a"][0]  # an input acts from one sample to the next
    assert np.abs(plain["a"] - strong["a"])[1:].max() > 1e-3


# ---------------------------------------------------------------- spectrum, data, demo


@pytest.fixture(scope="module")
def spectra(workspace: Path) -> dict[str, Any]:
    out = workspace / "spectra"
    call(f"spectrum {workspace}/record.csv --columns a --cutoff 1 --order 2 "
         f"--simulator {workspace}/simulated.csv", out)  # fmt: skip
    assert_pictures(out, "spectrum.png")
    return results(out)


def test_spectrum_finds_the_peaks_and_the_share_of_the_low_band(spectra: dict[str, Any]) -> None:
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(SAMPLES) / SAMPLES)
    power = np.abs(np.fft.rfft((A - A.mean()) * window)) ** 2
    power[0] = 0
    frequencies = np.fft.rfftfreq(SAMPLES, DT)
    assert spectra["share_below"] == pytest.approx(power[frequencies <= 1].sum() / power[:-1].sum())
    assert [p["frequency"] for p in spectra["peaks"]] == pytest.approx([SLOW, FAST])
    shares = np.array([1, 0.3**2]) / (1 + 0.3**2)
    assert [p["share"] for p in spectra["peaks"]] == pytest.approx(shares, rel=1e-6)


def test_spectrum_says_how_well_the_pair_adds_up(spectra: dict[str, Any]) -> None:
    bands = [
        scipy.signal.filtfilt(*scipy.signal.butter(2, 1, band, fs=1 / DT), A)
        for band in ("low", "high")
    ]
    assert (spectra["cutoff"], spectra["order"]) == (1.0, 2)
    assert spectra["sampling_rate"] == pytest.approx(1 / DT)
    assert spectra["reconstruction_rmse"] == pytest.approx(rms(A - sum(bands)), rel=1e-6)


def test_spectrum_checks_the_simulator_as_scipy_does(spectra: dict[str, Any]) -> None:
    found = spectra["simulator"]
    assert found["total_rmse"] == pytest.approx(rms(A - SIMULATED))
    frequencies, agreement = scipy.signal.coherence(A, SIMULATED, 1 / DT, nperseg=SAMPLES // 8)
    expected = agreement[frequencies <= 1].mean()
    assert found["mean_coherence_below_cutoff"] == pytest.approx(expected)
    assert [check["cutoff"] for check in found["oracle"]].count(1.0) == 1
    for check in found["oracle"]:
        b, a = scipy.signal.butter(2, check["cutoff"], fs=1 / DT)
        low, own = (
            scipy.signal.lfilter(b, a, y, zi=scipy.signal.lfilter_zi(b, a) * y[0])[0]
            for y in (SIMULATED, A)
        )
        assert check["no_network"] == pytest.approx(rms(A - low), rel=1e-6)
        assert check["perfect_network"] == pytest.approx(rms(own - low), rel=1e-6)


@pytest.mark.usefixtures("drawn")
def test_spectrum_without_a_simulator_is_about_the_record_alone(tmp_path: Path) -> None:
    call("spectrum record.csv --columns a,b", tmp_path)
    found = results(tmp_path)
    assert "simulator" not in found
    assert SLOW <= found["cutoff"] < FAST
    assert_pictures(tmp_path, "spectrum.png")


@pytest.mark.parametrize("options", ["", "--train 120"])
def test_spectrum_and_compare_choose_the_same_cutoff(options: str, tmp_path: Path) -> None:
    """An input is no channel, and what follows the training part does not matter."""
    time = DT * np.arange(400)
    slow = np.sin(2 * np.pi * 0.2 * time) + 0.3 * np.sin(2 * np.pi * 1.1 * time)
    y = np.where(time < 30, slow, 3 * np.sin(2 * np.pi * 3.3 * time))
    force = np.sign(np.sin(2 * np.pi * 2.1 * time))
    record = tmp_path / "record.csv"
    pd.DataFrame({"time": time, "y": y, "force": force}).to_csv(record, index=False)
    call(f"spectrum {record} --inputs force {options}", tmp_path / "spectrum")
    call(f"compare {record} --inputs force --methods mean {options}", tmp_path / "compared")
    found, settings = results(tmp_path / "spectrum"), results(tmp_path / "compared")["settings"]
    assert [found[name] for name in ("cutoff", "order", "train")] == [
        settings[name] for name in ("cutoff", "order", "train")
    ]
    call(f"spectrum {record} {options}", tmp_path / "channels")
    assert results(tmp_path / "channels")["cutoff"] != found["cutoff"]


@pytest.mark.parametrize("simulator", ["functions.py:good", "simulated.csv"])
def test_spectrum_and_compare_choose_the_same_cutoff_with_a_simulator(
    simulator: str, tmp_path: Path
) -> None:
    options = f"record.csv --columns a --simulator {simulator} --train 120"
    call(f"spectrum {options}", tmp_path / "spectrum")
    methods = "filtered-gru-calibrated,simulator-calibrated"
    call(f"compare {options} --methods {methods} --seeds 1 --epochs 1 --hidden 2,2 --jobs 1",
         tmp_path / "compared")  # fmt: skip
    found, settings = results(tmp_path / "spectrum"), results(tmp_path / "compared")["settings"]
    assert found["choice"] == settings["choice"]


def test_spectrum_takes_a_constant_simulator(tmp_path: Path) -> None:
    call("spectrum record.csv --columns a --simulator functions.py:constant", tmp_path)
    assert results(tmp_path)["simulator"]["total_rmse"] == pytest.approx(rms(A - 1))


@pytest.mark.usefixtures("public_data")
@pytest.mark.parametrize(
    ("name", "cutoff", "total", "perfect", "nothing"),
    [("drill-string", 1.0, 0.7292, 0.659, 0.774), ("van-der-pol", 0.5, 0.405, 0.2996, 0.450)],
)
def test_spectrum_gives_the_oracle_figures_of_the_papers_systems(
    tmp_path: Path, name: str, cutoff: float, total: float, perfect: float, nothing: float
) -> None:
    call(f"spectrum {name}", tmp_path)
    found = results(tmp_path)
    assert found["cutoff"] == pytest.approx(cutoff)
    simulator = found["simulator"]
    assert simulator["total_rmse"] == pytest.approx(total, abs=5e-5)
    check = next(c for c in simulator["oracle"] if c["cutoff"] == found["cutoff"])
    assert check["perfect_network"] == pytest.approx(perfect, abs=1e-3)
    assert check["no_network"] == pytest.approx(nothing, abs=1e-3)


@pytest.mark.usefixtures("public_data")
def test_the_seasonal_baseline_finds_the_period_of_the_double_torsion_record(
    tmp_path: Path,
) -> None:
    call("compare double-torsion --recipe paper --methods seasonal-naive,persistence", tmp_path)
    facts = results(tmp_path)["methods"]["seasonal-naive"]
    assert "160 training samples" in facts["description"]
    assert facts["forecast_rmse"] == [pytest.approx(0.068, abs=5e-4)]
    assert facts["total_rmse"] == [pytest.approx(0.062, abs=1e-3)]


@pytest.mark.usefixtures("public_data")
def test_data_finds_and_lists_the_public_records(
    public_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("data list")
    listed = capsys.readouterr().out
    for name in ("drill_string_data", "double_torsion_phi2", "van-der-pol", "CC BY 4.0"):
        assert name in listed
    call("data fetch drill_string_sim")
    path = public_data / "drill_string" / "drill_string_sim.txt"
    assert capsys.readouterr().out == f"drill_string_sim: {path}\n"
    call("data fetch")
    assert len(capsys.readouterr().out.splitlines()) == 4


@pytest.mark.parametrize(
    ("command", "word"),
    [
        ("", "compare"),
        ("compare", "--simulator"),
        ("fit", "MODEL_DIR"),
        ("simulate", "--future-inputs"),
        ("spectrum", "--cutoff"),
        ("demo", "under a minute"),
        ("data", "fetch"),
    ],
)
def test_every_command_has_help(
    command: str, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"{command} --help")
    found = capsys.readouterr()
    assert word in found.out
    assert found.err == ""


# ---------------------------------------------------------------- as a process


def process(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "error"}
    return subprocess.run(
        arguments, capture_output=True, text=True, check=False, timeout=600, env=environment
    )


def complaints(said: str) -> list[str]:
    """Lines of the error stream, without what is said once after installation."""
    return [line for line in said.splitlines() if "compiling" not in line]


def test_the_entry_point_writes_results_and_no_warning(tmp_path: Path) -> None:
    script = shutil.which("splitband", path=str(Path(sys.executable).parent))
    assert script is not None
    found = process(script, "spectrum", "record.csv", "--columns", "a", "--out", str(tmp_path))
    assert (found.returncode, complaints(found.stderr)) == (0, [])
    assert results(tmp_path)["record"] == "record"


def test_as_a_module_it_fails_with_one_line_too() -> None:
    found = process(sys.executable, "-m", "splitband", "spectrum", "nothing.csv")
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith("error: RECORD must be a file")
    assert found.stderr.count("\n") == 1


# ---------------------------------------------------------------- bad input


SPLIT = f"compare record.csv --columns a --methods split-gru {QUICK} --seeds 1 --jobs 1 --out out "
GRU = SPLIT.replace("split-gru", "gru")
SIMULATOR = "compare record.csv --columns a --methods simulator --warmup 10 --out out --simulator "
FIT = f"fit record.csv --columns a --method gru {QUICK} --out out "
AHEAD = "simulate gru --steps 5 --out ahead.csv --history "
HYBRID_AHEAD = "simulate filtered --steps 20 --out ahead.csv --history history.csv "
DRIVEN_AHEAD = "simulate driven --steps 20 --out ahead.csv --history history.csv "


def bad(line: str, *says: str, id: str = "") -> Any:
    """A command line that must fail with a line that holds every one of `says`."""
    for prefix in (SPLIT, GRU, SIMULATOR, FIT, AHEAD, HYBRID_AHEAD, DRIVEN_AHEAD):
        id = id or (line.removeprefix(prefix) if line.startswith(prefix) else "")
    return pytest.param(line, says, id=id or line or "nothing")


RECORDS = [
    bad("compare nothing.csv --out out", "RECORD", "nothing.csv"),
    bad("compare folder --out out", "folder", "directory"),
    bad("compare record.csv --columns torque --out out", "record.csv", "'torque'", "'a'"),
    bad("compare record.csv --inputs torque --out out", "record.csv", "'torque'"),
    bad("compare record.csv --columns a --inputs a --out out", "column 'a'", "twice"),
    bad("compare record.csv --time-column stamp --out out", "record.csv", "'stamp'"),
    bad("compare worded.csv --columns a --out out", "worded.csv", "'a'", "row 9", "'oops'"),
    bad("compare holed.csv --columns a --out out", "holed.csv", "'a'", "row 7", "nan"),
    bad("compare infinite.csv --columns a --out out", "infinite.csv", "'a'", "row 8", "inf"),
    bad("spectrum infinite.csv --columns a --out out", "infinite.csv", "'a'", "row 8", "inf"),
    bad("compare uneven.csv --out out", "uneven.csv", "'time'", "row 50", "0.15"),
    bad("compare untimed.csv --out out", "untimed.csv", "--sampling-time", "--time-column"),
    bad("compare untimed.csv --sampling-time nan --out out", "untimed.csv", "sampling", "nan"),
    bad("compare untimed.csv --sampling-time 0 --out out", "untimed.csv", "sampling", "got 0"),
    bad("compare untimed.csv --sampling-time inf --out out", "untimed.csv", "sampling", "inf"),
    bad("compare record.csv --sampling-time 0.3 --out out", "record.csv", "0.3", "0.1 s"),
    bad("compare empty.csv --out out", "empty.csv", "at least 2 rows", "has 0"),
    bad("compare still.csv --out out", "constant"),
    bad("compare van-der-pol --columns a --out out", "--columns", "van-der-pol", "got a"),
    bad("compare tiny.csv --columns a --window 30 --out out", "window", "3 training", "got 30"),
]
SETTINGS = [
    bad(SPLIT + "--train 0", "train", "got 0"),
    bad(SPLIT + "--train -5", "train", "got -5"),
    bad(SPLIT + "--train 200", "train", "199", "got 200"),
    bad(SPLIT + "--train 20", "window", "20 training samples", "got 30"),
    bad(SPLIT + "--horizon 51", "--horizon", "at most 50", "got 51"),
    bad(SPLIT + "--methods gru,lstm", "methods", "split-gru-hp", "got lstm"),
    bad(SPLIT + "--cutoff 0", "cutoff", "5 Hz", "got 0 Hz"),
    bad(SPLIT + "--cutoff -1", "cutoff", "got -1 Hz"),
    bad(SPLIT + "--cutoff 5", "cutoff", "Nyquist", "got 5 Hz"),
    bad(SPLIT + "--cutoff nan", "cutoff", "got nan"),
    bad(SPLIT + "--cutoff inf", "cutoff", "got inf"),
    bad("spectrum record.csv --columns a --out out --cutoff 7", "cutoff", "got 7 Hz"),
    bad(GRU + "--cutoff 0", "cutoff", "got 0"),
    bad(GRU + "--cutoff 7", "cutoff", "got 7"),
    bad(GRU + "--cutoff nan", "cutoff", "nan"),
    bad(SPLIT + "--cutoff 1 --downsampling 5", "downsampling by 5", "1 Hz", "at most 4"),
    bad(SPLIT + "--downsampling 0", "downsampling", "got 0"),
    bad(SPLIT + "--cutoff 1 --downsampling 0", "downsampling", "got 0"),
    bad(SPLIT + "--downsampling -1", "downsampling", "got -1"),
    bad(SPLIT + "--order 0", "order", "got 0"),
    bad(SPLIT + "--order 40", "order", "40"),
    bad(GRU + "--order 0", "order", "got 0"),
    bad(SPLIT + "--warmup 30", "warm-up", "30", "window"),
    bad(SPLIT + "--warmup 0", "warmup", "got 0"),
    bad(SPLIT + "--window 1", "window", "got 1"),
    bad(SPLIT + "--lr-milestones 20", "--lr-milestones", "EPOCH:RATE", "got 20"),
    bad(SPLIT + "--lr-milestones 20:fast", "--lr-milestones", "20:fast"),
    bad(SPLIT + "--lr-milestones 1:-0.5", "learning rate", "-0.5"),
    bad(SPLIT + "--lr-milestones 1:nan", "learning rate", "nan"),
    bad(SPLIT + "--lr-milestones -5:1e-4", "milestones", "-5"),
    bad(SPLIT + "--hidden 4", "--hidden", "HIGH,LOW", "got 4"),
    bad(SPLIT + "--hidden 4,x", "--hidden", "got 4,x"),
    bad(SPLIT + "--hidden 4,0", "hidden", "got 0"),
    bad(GRU + "--hidden 4,-1", "hidden", "-1"),
    bad(SPLIT + "--learning-rate -1", "learning rate", "-1"),
    bad(SPLIT + "--learning-rate nan", "learning rate", "nan"),
    bad(SPLIT + "--learning-rate inf", "learning rate", "inf"),
    bad(GRU + "--learning-rate 1e30", "diverged", "learning rate", "1e+30"),
    bad(SPLIT + "--epochs 0", "epochs", "got 0"),
    bad(GRU + "--conditioned", "--conditioned", "split-gru", "filtered-gru", "got gru"),
    bad(GRU + "--calibrate", "--calibrate", "filtered-gru", "got gru"),
    bad(SPLIT + "--calibrate", "--calibrate", "residual-gru", "got split-gru"),
    bad(SPLIT + "--calibrate --conditioned", "--calibrate", "got split-gru"),
]
WORDS = [
    bad(SPLIT + "--train abc", "--train", "abc"),
    bad(SPLIT + "--cutoff low", "--cutoff", "low"),
    bad(SPLIT + "--horizon -7", "--horizon", "-7"),
    bad(SPLIT + "--seeds -7", "--seeds", "-7"),
    bad(SPLIT + "--jobs -7", "--jobs", "-7"),
    bad(SPLIT + "--speed 3", "--speed"),
    bad("compare", "RECORD"),
    bad("fit record.csv", "--out"),
    bad("learn record.csv", "learn"),
    bad("data learn", "learn"),
    bad("", "command"),
    bad("data", "command"),
    bad("data fetch moon", "'moon'", "drill_string_data"),
]
OUTPUTS = [
    bad(GRU + "--out record.csv", "--out", "record.csv"),
    bad(GRU + "--out record.csv/below", "--out", "record.csv/below"),
    bad(FIT + "--out record.csv/below", "--out", "record.csv/below"),
    bad("spectrum record.csv --columns a --out record.csv", "--out", "record.csv"),
    bad(f"{GRU} --out {'x' * 300}", "--out", "xxx"),
    bad(AHEAD + "history.csv --out record.csv/below.csv", "--out", "record.csv"),
    bad(AHEAD + "history.csv --out folder", "--out", "folder"),
]
SIMULATORS = [
    bad(f"{GRU} --methods filtered-gru", "filtered-gru", "--simulator"),
    bad(f"{FIT} --method residual-gru", "residual-gru", "--simulator"),
    bad(GRU + "--methods simulator-affine", "simulator-affine", "--simulator"),
    bad(SIMULATOR + "nothing.csv", "--simulator", "nothing.csv"),
    bad(SIMULATOR + "nothing.py:good", "nothing.py"),
    bad(SIMULATOR + "broken.py:good", "broken.py", "SyntaxError"),
    bad(SIMULATOR + "functions.py:number", "functions.py", "number"),
    bad(SIMULATOR + "functions.py:absent", "functions.py", "absent"),
    bad(SIMULATOR + "simulated_holed.csv", "simulated_holed.csv", "'a'", "row 3", "nan"),
    bad(SIMULATOR + "simulated_short.csv", "simulator", "0 s to 19.9 s", "0 s to 18.9 s"),
    bad(SIMULATOR + "simulated_short.csv", "simulated_short.csv", id="the file that is too short"),
    bad(SIMULATOR + "simulated_slow.csv", "simulated_slow.csv", "19.9 s", "19.8 s"),
    bad(SIMULATOR + "simulated_names.csv", "--simulator-columns", "1 column", "p, q"),
    bad(SIMULATOR + "simulated_names.csv --simulator-columns z", "simulated_names.csv", "'z'"),
    bad(SIMULATOR + "functions.py:raising", "simulator", "200 samples", "RuntimeError",
        "no convergence after 7 steps"),
    bad(SIMULATOR + "functions.py:short", "simulator", "(200, 1)", "(10, 1)"),
    bad(SIMULATOR + "functions.py:wide", "simulator", "(200, 1)", "(200, 3)"),
    bad(SIMULATOR + "functions.py:holed", "simulator", "finite", "1.7 s"),
    bad(SIMULATOR + "functions.py:holed", "functions.py", id="the function that is to blame"),
    bad(SIMULATOR + "functions.py:hanging --simulator-timeout 0.2", "simulator", "0.2 s"),
    bad(SIMULATOR + "functions.py:good --simulator-timeout -1", "--simulator-timeout"),
    bad(SIMULATOR + "functions.py:good --simulator-timeout inf", "timeout", "inf"),
    bad(SIMULATOR + "functions.py:leaving", "simulator", "SystemExit"),
    bad(SIMULATOR + "damaged.fmu", "damaged.fmu", "zip"),
    bad(SIMULATOR + "hollow.fmu", "hollow.fmu"),
    bad(SIMULATOR + "nothing.fmu", "nothing.fmu"),
]  # fmt: skip
MODELS = [
    bad(f"{FIT} --method lstm", "--method", "got lstm"),
    bad(f"{FIT} --method persistence", "--method", "got persistence"),
    bad(FIT + "--conditioned", "--conditioned", "split-gru", "got gru"),
    bad(FIT + "--calibrate", "--calibrate", "filtered-gru", "got gru"),
    bad(FIT + "--method filtered-gru --calibrate", "filtered-gru-calibrated", "--simulator"),
    bad(FIT + "--train 201", "train", "200", "got 201"),
    bad(FIT + "--seed 99999999999999999999", "seed", "9999"),
    bad("simulate nothing --history history.csv --steps 5 --out ahead.csv", "nothing"),
    bad(AHEAD + "nothing.csv", "nothing.csv"),
    bad(AHEAD + "history_short.csv", "--history", "10", "got 5"),
    bad(AHEAD + "history_renamed.csv", "history_renamed.csv", "'a'", "'z'"),
    bad(AHEAD + "history_slow.csv", "history_slow.csv", "0.1 s", "0.2 s"),
    bad(AHEAD + "history_holed.csv", "history_holed.csv", "'a'", "row 7", "nan"),
    bad(AHEAD + "history.csv --steps 0", "--steps"),
    bad(AHEAD + "history.csv --future-inputs future.csv", "--future-inputs", "none"),
    bad("forecast record.csv --columns a --out out", "--steps"),
    bad("forecast record.csv --columns a --out out --steps 0", "--steps", "got 0"),
    bad(
        "forecast record.csv --columns a --out out --steps 5 --method best", "--method", "got best"
    ),
    bad("forecast record.csv --columns a --out out --steps 5 --method simulator", "simulator"),
    bad("forecast record.csv --columns a --inputs force --out out --steps 5", "--future-inputs"),
    bad(
        "forecast record.csv --columns a --out out --steps 5 --method linear", "linear", "--inputs"
    ),
    bad("compare record.csv --columns a --out out --methods mean,linear", "linear", "--inputs"),
    bad(
        "forecast record.csv --columns a --out out --steps 5 --method filtered-gru "
        "--simulator simulated.csv",
        "0 s to 20.4 s",
        "0 s to 19.9 s",
    ),
    bad(HYBRID_AHEAD, "--simulator", "filtered-gru"),
    bad(HYBRID_AHEAD + "--simulator functions.py:holed", "simulator", "1.7 s"),
    bad(HYBRID_AHEAD + "--steps 190 --simulator simulated.csv", "must cover", "0 s to 19.9 s"),
    bad(DRIVEN_AHEAD, "--future-inputs", "force"),
    bad(DRIVEN_AHEAD + "--future-inputs nothing.csv", "nothing.csv"),
    bad(DRIVEN_AHEAD + "--future-inputs simulated.csv", "simulated.csv", "'force'"),
    bad(DRIVEN_AHEAD + "--future-inputs future_short.csv", "--future-inputs", "20", "got 10"),
]


def assert_fails(line: str, says: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2, one line that says what it must, and every file as it was."""
    before = files(Path())
    try:
        status = main(shlex.split(line))
    finally:
        found, after = capsys.readouterr(), files(Path())
        for name in after.keys() - before.keys():
            Path(name).unlink()
    assert status == 2
    assert found.err.startswith("error: ")
    assert found.err.count("\n") == 1
    assert "Traceback" not in found.err + found.out
    assert not [word for word in says if word not in found.err], found.err
    assert after == before


@pytest.mark.usefixtures("model", "hybrid_model", "driven_model")
@pytest.mark.parametrize(
    ("line", "says"), [*RECORDS, *SETTINGS, *WORDS, *OUTPUTS, *SIMULATORS, *MODELS]
)
def test_bad_input_is_one_line_and_leaves_no_file(
    line: str, says: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert_fails(line, says, capsys)


def change_json(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "model.json"
        description = json.loads(path.read_text())
        change(description)
        path.write_text(json.dumps(description))

    return damage


def cut_weights(folder: Path) -> None:
    path = folder / "weights.safetensors"
    path.write_bytes(path.read_bytes()[:-4])


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda f: (f / "model.json").write_text("{"), ("damaged/model.json", "damaged:")),
        (lambda f: (f / "model.json").unlink(), ("damaged", "model.json is missing")),
        (cut_weights, ("damaged/weights.safetensors", "damaged:")),
        (change_json(lambda d: d.update(format=9)), ("damaged/model.json", "format 9")),
        (change_json(lambda d: d["model"].update(type="eval")), ("model.json", "'eval'")),
        (change_json(lambda d: d.update(facts={})), ("`splitband fit`", "method")),
        pytest.param(
            change_json(lambda d: d["facts"]["setup"]["settings"].update(warmup=-3)), ("warm",)
        ),
        pytest.param(
            change_json(lambda d: d["facts"].update(columns=["a"])), ("columns",)
        ),
    ],
    ids=["json", "no json", "weights", "format", "type", "no facts", "warm-up", "columns"],
)  # fmt: skip
def test_a_damaged_model_is_one_line(
    damage: Callable[[Path], None],
    says: tuple[str, ...],
    model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copy("history.csv", tmp_path)
    shutil.copytree(model, tmp_path / "damaged")
    monkeypatch.chdir(tmp_path)
    damage(Path("damaged"))
    line = "simulate damaged --history history.csv --steps 5 --out ahead.csv"
    assert_fails(line, says, capsys)


@pytest.mark.parametrize(
    "calibration",
    [
        3, [1.0], {"speed": 1.0}, {"clock": "fast"}, {"clock": None}, {"delay": "late"},
        {"gain": ["high"]}, {"gain": [1.0, 2.0]}, {"clock": float("nan")},
    ],
    ids=str,
)  # fmt: skip
def test_a_damaged_calibration_is_one_line(
    calibration: Any,
    hybrid_model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(hybrid_model, tmp_path / "damaged")
    for name in ("history.csv", "simulated.csv"):
        shutil.copy(name, tmp_path)
    monkeypatch.chdir(tmp_path)
    change_json(lambda d: d["facts"].update(calibration=calibration))(Path("damaged"))
    line = HYBRID_AHEAD.replace("filtered", "damaged") + "--simulator simulated.csv"
    assert_fails(line, ("damaged",), capsys)


def test_a_folder_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.chmod(0o500)
    try:
        (tmp_path / "probe").touch()
    except OSError:
        assert_fails(f"{GRU} --out {tmp_path / 'below'}", ("--out", str(tmp_path)), capsys)
        assert_fails(f"{FIT} --out {tmp_path}", ("--out", str(tmp_path)), capsys)
    else:
        pytest.skip("this user can write into every folder")
    finally:
        tmp_path.chmod(0o700)


def test_a_fit_that_fails_leaves_the_old_model(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(model, tmp_path / "model")
    before = files(tmp_path)
    assert main(shlex.split(f"{FIT} --cutoff nan --out {tmp_path / 'model'}")) == 2
    assert files(tmp_path) == before


def test_an_interrupt_says_so_and_leaves_no_file(capsys: pytest.CaptureFixture[str]) -> None:
    before = files(Path())
    assert main(shlex.split(SIMULATOR + "functions.py:interrupted")) == 130
    said = capsys.readouterr().err
    assert said == (
        "error: stopped; no file is half written, and the same command goes on from here\n"
    )
    assert files(Path()) == before


@pytest.mark.parametrize(
    "name",
    [
        "price [EUR].csv",
        pytest.param("a :car: b.csv"),
    ],
)
def test_a_message_shows_file_names_as_they_are(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", name]) == 2
    assert name in capsys.readouterr().err


@pytest.mark.parametrize("name", ["run[a]", "[/b]"])
def test_square_brackets_in_names_are_printed(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy("record.csv", tmp_path / f"{name.replace('/', '')}.csv")
    record = tmp_path / f"{name.replace('/', '')}.csv"
    assert main(["spectrum", str(record), "--columns", "a", "--out", str(tmp_path / name)]) == 0
    found = capsys.readouterr().out
    assert f"{record.stem}: strongest peaks" in found
    assert str(tmp_path / name) in found


@pytest.mark.usefixtures("drawn")
def test_dollar_signs_in_names_are_drawn(tmp_path: Path) -> None:
    pd.read_csv("record.csv").rename(columns={"a": "US$_{1$"}).to_csv(tmp_path / "r.csv")
    call(f"spectrum {tmp_path / 'r.csv'} --columns 'US$_{{1$'", tmp_path / "out")


def test_a_slow_function_is_kept_by_its_content(tmp_path: Path) -> None:
    code = (
        "def simulate(time):\n    with open('calls', 'a') as file:\n        file.write('x')\n"
        "    return {} * time\n"
    )
    line = f"spectrum record.csv --columns a --simulator f.py:simulate --simulator-cache {tmp_path}"
    for slope in (1, 1, 2):
        Path("f.py").write_text(code.format(slope))
        call(line, tmp_path / "out")
    assert Path("calls").read_text() == "xx"
    Path("calls").unlink()
    Path("f.py").unlink()


@pytest.mark.usefixtures("drawn")
def test_forecast_goes_on_from_the_end_of_a_record(tmp_path: Path) -> None:
    pd.read_csv("record.csv").iloc[:150].to_csv(tmp_path / "begun.csv", index=False)
    call(
        f"forecast {tmp_path}/begun.csv --columns a --steps 50 --seeds 1 --jobs 1 --epochs 2",
        tmp_path / "out",
    )
    table, found = written(tmp_path / "out" / "forecast.csv"), results(tmp_path / "out")
    assert list(table) == ["time", "a", "a, lower", "a, upper"]
    np.testing.assert_allclose(table["time"], DT * np.arange(150, 200))
    assert found["method"] == min(found["held_out_rmse"], key=found["held_out_rmse"].get)
    assert found["method"] == "harmonic"
    np.testing.assert_allclose(table["a"], A[150:], atol=1e-4)  # the record is two sinusoids
    assert_pictures(tmp_path / "out", "forecast.png")


def test_forecast_by_a_linear_model_of_the_inputs(tmp_path: Path) -> None:
    n = np.arange(400)
    u = np.sign(np.sin(n**1.3 / 20))
    y = scipy.signal.lfilter([0.3, 0.1], [1, -1.6, 0.8], u)
    table = pd.DataFrame({"time": n * DT, "y": y, "force": u})
    table[:300].to_csv(tmp_path / "begun.csv", index=False)
    table[["force"]][300:].to_csv(tmp_path / "coming.csv", index=False)
    call(f"forecast {tmp_path}/begun.csv --columns y --inputs force --steps 100 --epochs 1 "
         f"--seeds 1 --jobs 1 --future-inputs {tmp_path}/coming.csv", tmp_path / "out")  # fmt: skip
    found = results(tmp_path / "out")
    assert found["method"] == "linear"
    np.testing.assert_allclose(written(tmp_path / "out" / "forecast.csv")["y"], y[300:], atol=1e-5)


def test_forecast_takes_known_inputs_and_several_seeds(tmp_path: Path) -> None:
    pd.DataFrame({"force": [1.0] * 20}).to_csv(tmp_path / "coming.csv", index=False)
    line = f"forecast record.csv --columns a,b --inputs force --steps 20 --future-inputs {tmp_path}"
    call(f"{line}/coming.csv --method gru --seeds 2 --jobs 1 --epochs 2", tmp_path / "out")
    found = results(tmp_path / "out")
    assert (found["method"], found["seeds"]) == ("gru", [0, 1])
    table = written(tmp_path / "out" / "forecast.csv")
    assert table.shape == (20, 7)
    assert np.isfinite(table.to_numpy()).all()


def test_forecast_asks_a_simulator_for_what_is_to_come(tmp_path: Path) -> None:
    call("forecast record.csv --columns a --steps 30 --method simulator-calibrated "
         "--simulator functions.py:good", tmp_path)  # fmt: skip
    time = DT * np.arange(SAMPLES, SAMPLES + 30)
    good = 0.8 * np.sin(2 * np.pi * 0.3 * time + 0.2) + 0.3
    found = written(tmp_path / "forecast.csv")["a"]
    assert rms(found - np.sin(2 * np.pi * SLOW * time)) < rms(
        good - np.sin(2 * np.pi * SLOW * time)
    )


# In a process that multiprocessing begins, it runs before anything else is loaded.
ANNOUNCE = """
import os, pathlib, sys
if "spawn_main" in " ".join(sys.orig_argv):
    pathlib.Path(__file__).with_name(f"{os.getpid()}.loading").touch()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
@pytest.mark.parametrize(
    ("jobs", "files"),
    [
        pytest.param(1, "out/*/*/*.safetensors", id="while it trains"),
        pytest.param(2, "*.loading", id="while its processes are loading"),
        pytest.param(2, "out/*/*/*.safetensors", id="while its processes train"),
    ],
)
def test_ctrl_c_stops_at_once_and_leaves_nothing_half_written(
    workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jobs: int, files: str
) -> None:
    (tmp_path / "sitecustomize.py").write_text(ANNOUNCE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    line = (
        f"compare {workspace}/record.csv --columns a --methods gru,split-gru --epochs 100000 "
        f"--seeds 2 --jobs {jobs} --out {tmp_path / 'out'}"
    )
    running = command_line(line)
    eventually(lambda: len([*tmp_path.glob(files)]) >= jobs)
    assert interrupted(running) == [
        "error: stopped; no file is half written, and the same command goes on from here"
    ]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINTS}


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
def test_ctrl_c_stops_it_while_it_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What takes long to load, by a module that does.
    (tmp_path / "typer.py").write_text(
        "import pathlib, time\npathlib.Path(__file__).with_name('here').touch()\ntime.sleep(600)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    running = command_line("data list")
    eventually((tmp_path / "here").exists)
    assert interrupted(running) == ["error: stopped before anything was begun"]


def command_line(line: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "splitband", *shlex.split(line)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
        # A shell's job in the background would pass on that Ctrl-C is nothing to it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )


def interrupted(running: subprocess.Popen[str]) -> list[str]:
    """What it says after Ctrl-C, and that it stops as shells expect."""
    os.killpg(running.pid, signal.SIGINT)
    try:
        _, said = running.communicate(timeout=300)
    finally:
        running.kill()
    # Python ends by the signal itself where it came in an `exec`: shells show 130 for both.
    assert running.returncode in (130, -signal.SIGINT)
    return complaints(said)
