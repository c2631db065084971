"""`splitband compare`: what it writes, draws and prints."""

import html
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband import load
from tests.cli.support import (
    DT,
    FAST,
    QUICK,
    SAMPLES,
    SLOW,
    TRAIN,
    WARMUP,
    A,
    B,
    assert_fails,
    call,
    files,
    results,
    written,
)
from tests.signals import rms

pytestmark = pytest.mark.usefixtures("inside")


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
    model = {f"model/{name}" for name in files(compared / "model")}
    assert {*files(compared)} == {"results.json", "predictions.csv", "report.html", *model}
    assert "forecaster.json" in files(compared / "model")
    assert set(found["methods"]["gru"]["final_loss"][0]) == {"network"}
    assert set(found["methods"]["split-gru-hp"]["final_loss"][0]) == {"low band", "high band"}


def test_compare_writes_what_is_needed_to_run_it_again(compared: Path) -> None:
    found = results(compared)
    time = {"samples": SAMPLES, "sampling_time": pytest.approx(DT), "start": 0.0, "gaps": 0}
    channels = {"columns": ["a"], "units": [""], "inputs": 0, "truth": "measured"}
    reading = found["record"].pop("reading")
    assert (reading["grid"], reading["hold"], reading["step"]) == (None, None, None)
    assert found["record"] == {"name": "record", **time, **channels}
    settings = found["settings"]
    choice, training = settings["choice"], settings["settings"]
    for name in ("cutoff", "order", "downsampling"):
        assert settings[name] == choice[name]
    assert choice["cutoff"] in [c["cutoff"] for c in choice["candidates"]]
    assert SLOW < settings["cutoff"] < FAST
    assert (settings["train"], settings["hidden_high"], settings["hidden_low"]) == (TRAIN, 4, 3)
    assert (training["window"], training["warmup"], training["epochs"]) == (30, WARMUP, 2)
    assert (found["arguments"]["columns"], found["arguments"]["hidden"]) == ("a", "3,4")
    assert found["environment"].keys() == {"versions", "machine", "commit"}
    assert found["environment"]["versions"]["numpy"] == np.__version__


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


def test_compare_prints_its_table_and_where_the_files_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "compare record.csv --columns a --methods persistence,seasonal-naive --horizon 20"
    call(line, tmp_path)
    said, found = capsys.readouterr(), results(tmp_path)
    row = next(line for line in said.out.splitlines() if "last value held (persistence) " in line)
    assert f"{found['methods']['persistence']['forecast_rmse'][0]:.2f}" in row
    (fit,) = (c["values"] for c in found["table"] if c["heading"] == "forecast fit %")
    assert f"fit {fit[found['recommended']]:.1f} %" in said.out
    assert str(tmp_path) in said.out
    assert said.err == ""


def test_the_answer_comes_first_and_reasons_only_where_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "compare record.csv --columns a --inputs force --methods linear,mean"
    call(line, tmp_path)
    said = capsys.readouterr().out
    parts = ["recommended: ", "fit ", "\nmodel: ", "┃ method", "time: "]
    places = [said.index(part) for part in parts]
    assert places == sorted(places)
    assert "order" not in said[places[3] :]
    call(f"--verbose {line}", tmp_path)
    loud = capsys.readouterr().out
    assert "linear model: " in loud[loud.index("┃ method") :]
    assert "Its score is the lowest" in " ".join(loud.split())
    assert "The residuals of a have an RMS of" in " ".join(loud.split())


def test_all_samples_train_and_held_out_forecasts_choose(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("compare record.csv --columns a --methods persistence,harmonic --train all", tmp_path)
    assert "a: held-out RMSE " in capsys.readouterr().out
    found = results(tmp_path)
    assert (found["settings"]["train"], found["recommended"]) == (SAMPLES, "harmonic")
    fitted = load(tmp_path / "model").require_fitted()
    assert fitted.begin + len(fitted.record) == SAMPLES
    assert not written(tmp_path / "predictions.csv").filter(like="forecast").size


def test_the_horizon_ends_both_protocols(tmp_path: Path) -> None:
    line = "compare record.csv --columns a --methods persistence --train 120 --horizon 30"
    call(f"{line} --warmup 10", tmp_path)
    found = results(tmp_path)
    assert found["record"]["samples"] == 150
    facts = found["methods"]["persistence"]
    assert facts["forecast_rmse"] == [pytest.approx(rms(A[120:150] - A[119]))]
    assert facts["total_rmse"] == [pytest.approx(rms(A[10:150] - A[9]))]


def test_compare_takes_several_channels_and_known_inputs(tmp_path: Path) -> None:
    line = (
        "compare record.csv --columns a,b --inputs force --methods euler-mlp,split-gru,persistence"
    )
    how = "--seeds 2 --jobs 1 --learning-rate 1e-4 --order 2 --cutoff 1"
    call(f"{line} {QUICK} {how}", tmp_path)
    found = results(tmp_path)
    assert (found["record"]["columns"], found["record"]["inputs"]) == (["a", "b"], 1)
    assert found["settings"]["settings"]["learning_rate"] == 1e-4
    assert (found["settings"]["cutoff"], found["settings"]["order"]) == (1.0, 2)
    held = [rms(*(y[n:] - y[n - 1] for y in (A, B))) for n in (WARMUP, TRAIN)]
    facts = found["methods"]["persistence"]
    assert [*facts["total_rmse"], *facts["forecast_rmse"]] == pytest.approx(held)
    seeds = found["methods"]["euler-mlp"]
    assert (seeds["seeds"], len({*seeds["total_rmse"]})) == ([0, 1], 2)
    assert seeds["total_rmse_std"] == pytest.approx(np.std(seeds["total_rmse"], ddof=1))


@pytest.mark.usefixtures("drawn")
def test_the_command_of_the_page_fits_the_recommended_method_again(tmp_path: Path) -> None:
    """With all its options, quoted, and the further records."""
    out = tmp_path / "my results"
    line = "compare record.csv --columns a --inputs force --more record.csv"
    call(f"{line} --methods gru {QUICK} --seeds 1 --jobs 1", out)
    page = html.unescape((out / "report.html").read_text(encoding="utf-8"))
    (line,) = set(re.findall(r"splitband (fit (?:[^\n<]*\\\n)*[^\n<]*)", page))
    words = shlex.split(line.replace("\\\n", " "))
    call(shlex.join(words[: words.index("--out")]), tmp_path / "model")
    assert results(tmp_path / "model")["more"] == ["record.csv"]


@pytest.mark.usefixtures("drawn")
def test_a_simulation_made_elsewhere_is_a_row_and_never_recommended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not even one that is exactly right."""
    record = pd.read_csv("record.csv")
    mine, half = tmp_path / "mine.csv", tmp_path / "half.csv"
    record[["time", "a"]].to_csv(mine, index=False)
    record[["time", "a"]][:100].to_csv(half, index=False)
    line = f"compare record.csv --columns a --methods mean,harmonic --jobs 1 --also {mine}"
    call(line, tmp_path / "out")
    said, found = capsys.readouterr().out, results(tmp_path / "out")
    fits = next(c["values"] for c in found["table"] if c["heading"] == "forecast fit %")
    assert fits[str(mine)] == pytest.approx(100)
    assert found["recommended"] == "harmonic"
    assert "100.0" in said
    assert f"a, {mine}, forecast" in pd.read_csv(tmp_path / "out" / "predictions.csv")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert str(mine) in page
    alone = f"compare record.csv --columns a --methods gru --window 300 --also {mine}"
    assert_fails(f"{alone} --out {tmp_path}/no", ("window",), capsys)
    says = "--also", "must cover"
    assert_fails(f"{line.replace('mine', 'half')} --out {tmp_path}/no", says, capsys)
    record.loc[[3, 5], "a"] = np.nan
    record[["time", "a"]].to_csv(tmp_path / "half.csv", index=False)
    says = "--also", "2 samples without one: rows 3, 5"
    assert_fails(f"{line.replace('mine', 'half')} --out {tmp_path}/no", says, capsys)
    # Both records begin at 0 s: the simulation of one is none of the other.
    call(f"{line} --test record.csv", tmp_path / "other")
    assert f"Not tested: harmonic, {mine}." in " ".join(capsys.readouterr().out.split())
    zero = tmp_path / "zero.csv"
    record[["time", "a"]].assign(a=0.0).to_csv(zero, index=False)
    call(f"{line},{zero} --test record.csv --initial 10", tmp_path / "both")
    fits = next(c for c in results(tmp_path / "both")["table"] if c["heading"] == "test fit %")
    after = pd.read_csv("record.csv")["a"].to_numpy()[10:]
    assert fits["values"][str(mine)] == pytest.approx(100 - 100 * rms(after) / after.std())
    says = "also (--also)", f"each of the 1 test records, got 3 of {mine}"
    assert_fails(f"{line},{zero},{zero} --test record.csv --out {tmp_path}/no", says, capsys)
