"""`splitband check`: text, JSON, pictures and page of a saved model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb
from benchmarks.closed_loop import pendulum
from splitband.metrics import tenths
from tests.cli.support import assert_fails, call, results


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of two runs, and a model of the first one."""
    folder = tmp_path_factory.mktemp("check")
    rng = np.random.default_rng(0)
    force = rng.standard_normal(900)
    x = scipy.signal.lfilter([0.5], [1.0, -0.8], force) + 0.02 * rng.standard_normal(900)
    table = pd.DataFrame({"time": 0.1 * np.arange(900), "force": force, "x (mm)": x})
    table[:600].to_csv(folder / "first.csv", index=False)
    table[600:].to_csv(folder / "second.csv", index=False)
    record = sb.read(folder / "first.csv", inputs=["force"])
    sb.Linear().fit(record).save(folder / "model")
    return folder


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No other test writes there, so that files are as they were."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("drawn")
def test_a_good_model_is_accepted_in_text_json_and_page(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"check {folder}/model --record {folder}/second.csv --time-column time", tmp_path / "out")
    said, found = capsys.readouterr().out, results(tmp_path / "out")
    assert found["command"] == "check"
    assert found["arguments"]["time_column"] == "time"
    assert found["accepted"]
    fit = found["fit"]["simulation"]["x (mm)"]
    assert fit > 90
    assert f"x (mm): fit {fit:.1f} % (simulation)" in said
    assert "do not depend on the inputs and are white noise" in " ".join(said.split())
    assert found["static_gain"]["x (mm)"]["force"] == pytest.approx(2.5, rel=0.02)
    (test,) = found["residuals"]
    assert test["inputs"][0]["of"] == "force"
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Linear model (linear): the tests find nothing that the model lacks" in page
    assert "Step, force to x (mm): static gain" in page
    assert "--time-column time" in page


@pytest.mark.usefixtures("drawn")
def test_compare_and_check_say_the_same_of_a_model_on_a_record(
    folder: Path, tmp_path: Path
) -> None:
    asked = f"compare {folder}/first.csv --inputs force --methods linear,mean"
    call(f"{asked} --test {folder}/second.csv", tmp_path / "compared")
    model = tmp_path / "compared" / "model"
    call(f"check {model} --record {folder}/second.csv", tmp_path / "checked")
    (one,) = results(tmp_path / "compared")["residual_tests"]
    (other,) = results(tmp_path / "checked")["residuals"]
    assert (one["outcome"], one["verdict"]) == (other["outcome"], other["verdict"])


@pytest.mark.usefixtures("drawn")
def test_several_models_are_drawn_over_one_record_with_their_fits_in_a_table(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = sb.read(folder / "first.csv", inputs=["force"])
    sb.Mean().fit(record).save(tmp_path / "level")
    names = [f"{folder}/model", f"{tmp_path}/level"]
    call(f"check {' '.join(names)} --record {folder}/second.csv", tmp_path / "out")
    said, found = capsys.readouterr().out, results(tmp_path / "out")["models"]
    assert [*found] == names
    alone = sb.check(sb.load(names[0]), sb.read(folder / "second.csv", inputs=["force"]))
    assert found[names[0]]["fit"]["simulation"]["x (mm)"] == alone.fits["simulation"][0]
    assert (found[names[0]]["outcome"], found[names[1]]["outcome"]) == ("accepted", "rejected")
    for each in found.values():
        assert tenths(each["fit"]["simulation"]["x (mm)"]) in said
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "2 models on second" in page
    assert all(name in page for name in names)
    assert page.count('aria-pressed="true">') == 3 + 2 + 2  # over time, residuals, bands
    assert 'aria-pressed="false">' not in page


@pytest.mark.usefixtures("drawn")
def test_several_models_are_compared_the_same_number_of_samples_ahead(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also an unstable one, of which no free run is demanded; `simulate` says that it is."""
    made = pendulum(0)
    table = pd.DataFrame({"time": made.sampling_time * np.arange(len(made)), **made.signals})
    table.to_csv(tmp_path / "record.csv", index=False)
    columns = [made.columns[0]]
    record = sb.read(tmp_path / "record.csv", columns=columns, inputs=[*made.inputs])
    for name, model in (("linear", sb.Linear()), ("held", sb.Persistence())):
        model.fit(record).save(tmp_path / name)
    line = f"check {tmp_path}/linear {tmp_path}/held --record {tmp_path}/record.csv"
    call(line, tmp_path / "out")
    unstable, held = (of["fit"] for of in results(tmp_path / "out")["models"].values())
    assert [*held] == ["simulation", *unstable]
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if "last value" in line and "│" in line)
    shown = [cell.strip() for cell in row.split("│")[2:-1]]
    assert shown == [tenths(fit) for of in held.values() for fit in of.values()]
    table[:200].to_csv(tmp_path / "history.csv", index=False)
    known = f"--history {tmp_path}/history.csv --future-inputs {tmp_path}/record.csv"
    call(f"simulate {tmp_path}/linear {known} --steps 5", tmp_path / "ahead.csv")
    assert "warning: linear is unstable: largest pole" in capsys.readouterr().out


@pytest.mark.usefixtures("drawn")
def test_a_model_with_a_simulator_says_how_to_give_it(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plant.py").write_text("def plant(time, u, p):\n    return p.gain * u[:, 0]\n")
    plant = f"--simulator {tmp_path}/plant.py:plant --parameters gain=0.1:10"
    call(f"fit {folder}/first.csv --inputs force --method grey-box {plant}", tmp_path / "model")
    line = f"check {tmp_path}/model --record {folder}/second.csv --out {tmp_path}/out"
    says = "--simulator must be given for grey-box, which runs", "--simulator FILE.py:NAME"
    assert_fails(line, says, capsys)
    call(f"{line} {plant}")
    assert results(tmp_path / "out")["fit"]["simulation"]["x (mm)"] > 10
    call(f"{line} --simulator {tmp_path}/plant.py:plant")


def test_models_of_differently_prepared_records_are_not_drawn_over_one(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = sb.read(folder / "first.csv", inputs=["force"])
    sb.Linear().fit(record.detrend()).save(tmp_path / "other")
    line = f"check {folder}/model {tmp_path}/other --record {folder}/second.csv"
    says = "MODEL_DIR must be models of the same outputs, prepared in the same way", "other"
    assert_fails(f"{line} --out {tmp_path}/out", says, capsys)
