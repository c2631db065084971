"""`splitband spectrum`, with SciPy for comparison."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.integrate
import scipy.signal

from tests.cli.support import DT, FAST, SAMPLES, SIMULATED, SLOW, A, call, results
from tests.signals import rms

pytestmark = pytest.mark.usefixtures("inside", "simulated_here")


@pytest.fixture(scope="module")
def spectra(workspace: Path) -> dict[str, Any]:
    out = workspace / "spectra"
    line = f"spectrum {workspace}/record.csv --columns a --cutoff 1 --order 2"
    call(f"{line} --simulator {workspace}/simulated.csv", out)
    return results(out)


def test_spectrum_finds_the_peaks_and_the_share_of_the_low_band(spectra: dict[str, Any]) -> None:
    """The share is that of the training samples, which `compare` says, too."""
    train = spectra["train"]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(train) / train)
    power = np.abs(np.fft.rfft((A[:train] - A[:train].mean()) * window)) ** 2
    power[0] = 0
    share = power[np.fft.rfftfreq(train, DT) <= 1].sum() / power.sum()
    assert train == 3 * SAMPLES // 4
    assert spectra["share_below"] == pytest.approx(share, rel=1e-3)
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
    assert (found["command"], found["arguments"]["columns"]) == ("spectrum", "a,b")
    assert SLOW <= found["cutoff"] < FAST
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(words in page for words in ("strongest peaks", "Spectrum; dashed", "order 1"))


def test_spectrum_and_compare_choose_the_same_cutoff(tmp_path: Path) -> None:
    """An input is no channel, and what follows the training part does not matter."""
    time = DT * np.arange(400)
    slow = np.sin(2 * np.pi * 0.2 * time) + 0.3 * np.sin(2 * np.pi * 1.1 * time)
    y = np.where(time < 30, slow, 3 * np.sin(2 * np.pi * 3.3 * time))
    force = np.sign(np.sin(2 * np.pi * 2.1 * time))
    record = tmp_path / "record.csv"
    pd.DataFrame({"time": time, "y": y, "force": force}).to_csv(record, index=False)
    call(f"spectrum {record} --inputs force", tmp_path / "spectrum")
    line = f"compare {record} --inputs force --methods split-gru --epochs 1 --hidden 2,2 --seeds 1"
    call(line, tmp_path / "compared")
    found, settings = results(tmp_path / "spectrum"), results(tmp_path / "compared")["settings"]
    assert [found[name] for name in ("cutoff", "order", "train")] == [
        settings[name] for name in ("cutoff", "order", "train")
    ]
    call(f"spectrum {record}", tmp_path / "channels")
    assert results(tmp_path / "channels")["cutoff"] != found["cutoff"]


def test_spectrum_and_compare_choose_the_same_cutoff_with_a_simulator(tmp_path: Path) -> None:
    options = "record.csv --columns a --simulator simulated.csv --train 120"
    call(f"spectrum {options}", tmp_path / "spectrum")
    methods = "filtered-gru-calibrated,simulator-calibrated"
    line = f"compare {options} --methods {methods} --seeds 1 --epochs 1 --hidden 2,2 --jobs 1"
    call(line, tmp_path / "compared")
    found, settings = results(tmp_path / "spectrum"), results(tmp_path / "compared")["settings"]
    assert found["choice"] == settings["choice"]


@pytest.mark.usefixtures("public_data")
def test_spectrum_gives_the_oracle_figures_of_the_papers_drill_string(tmp_path: Path) -> None:
    call("spectrum drill-string --cutoff 1 --order 1", tmp_path)
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
    call(f"spectrum '{record}' --columns a --simulator functions.py:constant", out)
    assert results(out)["simulator"]["total_rmse"] == pytest.approx(rms(A - 1))
    found = capsys.readouterr().out
    assert "run[a]: strongest peaks" in found
    assert str(out) in found
