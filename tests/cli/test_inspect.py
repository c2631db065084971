"""`splitband inspect`, with SciPy for comparison."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.integrate
import scipy.signal

import splitband as sb
from tests.cli.support import DT, FAST, SAMPLES, SIMULATED, SLOW, A, call, results
from tests.signals import rms

pytestmark = pytest.mark.usefixtures("inside", "simulated_here")


@pytest.fixture(scope="module")
def spectra(workspace: Path) -> dict[str, Any]:
    out = workspace / "spectra"
    line = f"inspect {workspace}/record.csv --columns a --cutoff 1 --order 2"
    call(f"{line} --simulator {workspace}/simulated.csv", out)
    return results(out)


def test_inspect_finds_the_peaks_and_the_share_of_the_low_band(spectra: dict[str, Any]) -> None:
    """The share is that of the training samples, which `compare` says, too."""
    train = spectra["train"]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(train) / train)
    power = np.abs(np.fft.rfft((A[:train] - A[:train].mean()) * window)) ** 2
    power[0] = 0
    share = power[np.fft.rfftfreq(train, DT) <= 1].sum() / power.sum()
    assert train == 3 * SAMPLES // 4
    assert spectra["share_above"] == pytest.approx(1 - share, rel=1e-3)
    assert [p["frequency"] for p in spectra["peaks"]] == pytest.approx([SLOW, FAST])
    shares = np.array([1, 0.3**2]) / (1 + 0.3**2)
    assert [p["share"] for p in spectra["peaks"]] == pytest.approx(shares, rel=1e-6)


def test_inspect_checks_the_simulator_as_scipy_does(spectra: dict[str, Any]) -> None:
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
def test_inspect_without_a_simulator_is_about_the_record_alone(tmp_path: Path) -> None:
    call("inspect record.csv --columns a,b", tmp_path)
    found = results(tmp_path)
    assert "simulator" not in found
    assert (found["command"], found["arguments"]["columns"]) == ("inspect", "a,b")
    assert SLOW <= found["cutoff"] < FAST
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(words in page for words in ("Strongest frequencies", "Spectrum; dashed", "output"))


def test_inspect_and_compare_choose_the_same_cutoff(tmp_path: Path) -> None:
    """An input is no channel, and what follows the training part does not matter."""
    time = DT * np.arange(400)
    slow = np.sin(2 * np.pi * 0.2 * time) + 0.3 * np.sin(2 * np.pi * 1.1 * time)
    y = np.where(time < 30, slow, 3 * np.sin(2 * np.pi * 3.3 * time))
    force = np.sign(np.sin(2 * np.pi * 2.1 * time))
    record = tmp_path / "record.csv"
    pd.DataFrame({"time": time, "y": y, "force": force}).to_csv(record, index=False)
    call(f"inspect {record} --inputs force", tmp_path / "inspected")
    line = f"compare {record} --inputs force --methods split-gru --epochs 1 --hidden 2,2 --seeds 1"
    call(line, tmp_path / "compared")
    found, settings = results(tmp_path / "inspected"), results(tmp_path / "compared")["settings"]
    assert [found[name] for name in ("cutoff", "order", "train")] == [
        settings[name] for name in ("cutoff", "order", "train")
    ]
    call(f"inspect {record}", tmp_path / "channels")
    assert results(tmp_path / "channels")["cutoff"] != found["cutoff"]


def test_inspect_and_compare_choose_the_same_cutoff_with_a_simulator(tmp_path: Path) -> None:
    options = "record.csv --columns a --simulator simulated.csv --train 120"
    call(f"inspect {options}", tmp_path / "inspected")
    methods = "filtered-gru-calibrated,simulator-calibrated"
    line = f"compare {options} --methods {methods} --seeds 1 --epochs 1 --hidden 2,2 --jobs 1"
    call(line, tmp_path / "compared")
    found, settings = results(tmp_path / "inspected"), results(tmp_path / "compared")["settings"]
    assert found["choice"] == settings["choice"]


@pytest.mark.usefixtures("public_data")
def test_inspect_gives_the_oracle_figures_of_the_papers_drill_string(tmp_path: Path) -> None:
    call("inspect drill-string --cutoff 1 --order 1", tmp_path)
    found = results(tmp_path)
    simulator = found["simulator"]
    assert simulator["total_rmse"] == pytest.approx(0.7292, abs=5e-5)
    check = next(c for c in simulator["oracle"] if c["cutoff"] == found["cutoff"])
    assert check["perfect_network"] == pytest.approx(0.659, abs=1e-3)
    assert check["no_network"] == pytest.approx(0.774, abs=1e-3)


def test_a_constant_simulator_and_square_brackets_in_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, out = tmp_path / "run[a].csv", tmp_path / "[/b]"
    shutil.copy("record.csv", record)
    call(f"inspect '{record}' --columns a --simulator functions.py:constant", out)
    assert results(out)["simulator"]["total_rmse"] == pytest.approx(rms(A - 1))
    found = capsys.readouterr().out
    assert "run[a]" in found
    assert str(out) in found


def rig(folder: Path, names: str = "time,valve,level") -> Path:
    """A plant with a valve that moves in steps, and an output with gaps."""
    rng = np.random.default_rng(1)
    valve = np.repeat(rng.uniform(0, 1, 20).round(2), 30)
    level = scipy.signal.lfilter([0, 0.1], [1, -0.9], valve) + 0.01 * rng.normal(size=600)
    path = folder / "rig.csv"
    table = np.column_stack([DT * np.arange(600), valve, level])
    np.savetxt(path, table, "%.6g", ",", header=names, comments="")
    return path


@pytest.mark.filterwarnings("ignore:DataFrame. put on an even grid")
@pytest.mark.parametrize("jitter", [0.0, 0.03 * DT])
def test_the_command_that_inspect_prints_runs_with_these_inputs(
    jitter: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stamps that vary are put on an even grid, which the command then says."""
    path = rig(tmp_path, 'time,"valve, left",level')
    path.write_text(path.read_text() + "60,0.5,\n")
    table = pd.read_csv(path)
    table["time"] += jitter * np.sin(np.arange(len(table)))
    table.to_csv(path, index=False)
    call(f"--json inspect {path}")
    found = json.loads(capsys.readouterr().out)
    assert (found["inputs"], found["outputs"]) == (["valve, left"], ["level"])
    assert (f"--step {DT:g}" in found["run"], found["gaps"] > 0) == (jitter > 0, True)
    step = {"step": DT} if jitter else {}
    assert sb.inspect(table).options == {"inputs": ["valve, left"], "gaps": "mask", **step}
    command = found["run"].replace("\\\n", " ").removeprefix("splitband ")
    call(f"{command} --methods linear,mean --jobs 1", tmp_path / "out")
    assert results(tmp_path / "out")["recommended"] == "linear"


@pytest.mark.parametrize("command", ["compare", "fit", "forecast"])
def test_inputs_that_are_not_named_are_said_first_with_the_command(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = rig(tmp_path)
    method = {"compare": "--methods mean,persistence --jobs 1", "fit": "--method mean"}
    line = f"{command} {path} {method.get(command, '--method mean --steps 5 --jobs 1')}"
    call(line, tmp_path / "out")
    said = capsys.readouterr().out
    warning = "warning: probably inputs, not outputs: 'valve' (moves in 19 steps, leads level"
    assert warning in said
    assert said.index(warning) < said.index("to use them as inputs:\n    splitband " + command)
    assert "--inputs valve" in said.partition("as inputs:")[2].partition("\n\n")[0]
    assert warning.removeprefix("warning: ") in str(results(tmp_path / "out")["warnings"])


def test_inspect_needs_no_library_of_networks_or_pictures(tmp_path: Path) -> None:
    program = (
        f"import sys\nfrom splitband.cli import main\nmain(['inspect', {str(rig(tmp_path))!r}])"
    )
    found = "print([m for m in ('torch', 'numba', 'matplotlib', 'bokeh') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\n{found}"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"
