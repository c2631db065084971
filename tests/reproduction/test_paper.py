"""The paper's tables and figures, from small runs end to end."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import asdict, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.signal import butter, filtfilt

from reproduction import published
from reproduction.__main__ import main
from reproduction.costs import progress
from reproduction.jobs import SYSTEMS, Job
from reproduction.runs import as_fit, complete, load, whole_rmse
from reproduction.settings import HYBRID
from reproduction.specs import SPECS, lines
from reproduction.statements import comparisons
from reproduction.systems import MassSpringOracle, double_torsion_pendulum
from reproduction.tables import table
from splitband import Record
from splitband.forecasters.network import Network
from splitband.forecasters.prediction import ForecastContext
from splitband.metrics import rmse
from splitband.models import Signals, SplitModel
from splitband.records.named import double_mass_spring, van_der_pol
from splitband.runtime.arrays import Array

ROW = ["--systems", "i", "--seeds", "2", "--epochs", "2", "--jobs", "1"]
METHODS = ["--methods", "split-gru,harmonic,oracle"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A row of Table 1 at two epochs, run through the command line."""
    out = tmp_path_factory.mktemp("paper")
    assert main(["table", "learning-based", *ROW, *METHODS, "--out", str(out)]) == 0
    return out


def test_a_row_is_run_and_stands_beside_the_papers(folder: Path) -> None:
    facts = json.loads((folder / "tables" / "learning-based.json").read_text(encoding="utf-8"))
    text = facts["markdown"]
    assert "| (i) | split-gru |" in text
    assert "0.127 (0.008)" in text
    assert "2 of 300" in text
    runs = [json.loads(p.read_text()) for p in sorted((folder / "runs/i/split-gru").iterdir())]
    assert [run["job"]["seed"] for run in runs] == [0, 1]
    assert facts["rows"][0]["total_rmse"] == [run["total_rmse"] for run in runs]


def test_a_file_holds_what_was_predicted(folder: Path) -> None:
    job = Job("i", "split-gru", 1, epochs=2)
    record = job.record
    facts = load(job, folder / "runs")
    found = as_fit(facts, record)
    truth = record.y_true
    assert rmse(truth[30:], found.from_start.y) == pytest.approx(facts["total_rmse"], abs=1e-3)
    assert rmse(truth[250:], found.ahead) == pytest.approx(facts["forecast_rmse"], abs=1e-3)
    first = as_fit(load(replace(job, seed=0), folder / "runs"), record).from_start
    np.testing.assert_allclose(sum(first.components.values()), first.y, atol=2e-3)


def test_finished_runs_are_not_repeated(folder: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in (folder / "runs").rglob("*.json")}
    jobs = [
        job
        for line in lines("learning-based", ["i"], ["split-gru"], 2, epochs=2)
        for job in line.jobs
    ]
    assert complete(jobs, folder / "runs") == 0
    assert {p: p.stat().st_mtime_ns for p in (folder / "runs").rglob("*.json")} == before


@pytest.mark.usefixtures("drawn")
def test_what_is_stored_is_replaced_only_where_that_is_asked_for(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    stored = tmp_path / "tables" / "learning-based.json"
    before = stored.read_bytes()
    fewer = ["--methods", "harmonic", "--no-run", "--out", str(tmp_path)]
    assert main(["table", "Table 1", *ROW, *fewer]) == 0
    assert stored.read_bytes() == before
    assert "--update replaces it" in " ".join(capsys.readouterr().out.split())
    assert main(["table", "1", *ROW, *fewer, "--update"]) == 0
    assert [row["method"] for row in json.loads(stored.read_text())["rows"]] == ["harmonic"]
    picture = tmp_path / "figures" / "i-errors.png"
    picture.parent.mkdir()
    picture.write_text("mine")
    assert main(["figure", "Figure 2", *ROW, *fewer]) == 0
    assert picture.read_text() == "mine"
    assert main(["figure", "errors", *ROW, *fewer, "--update"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_another_cut_off_has_runs_and_a_table_of_its_own(tmp_path: Path) -> None:
    chosen = ["--methods", "split-gru,harmonic", "--seeds", "1", "--epochs", "1", "--jobs", "1"]
    change = ["--cutoff", "0.2", "--downsampling", "4", "--out", str(tmp_path)]
    assert main(["table", "Table 1", "--systems", "i", *chosen, *change]) == 0
    facts = json.loads((tmp_path / "tables/learning-based-w0.2-k4.json").read_text())
    assert facts["title"].endswith(", w = 0.2, k = 4")
    assert [row["paper"] for row in facts["rows"]] == [None, None]
    run = json.loads((tmp_path / "runs/i/split-gru/w0.2-k4-epochs1-seed0.json").read_text())
    assert (run["settings"]["cutoff"], run["settings"]["downsampling"]) == (0.2, 4)
    assert (tmp_path / "runs/i/harmonic/seed0.json").exists()


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("name", ["rollouts", "components", "errors", "spectrum"])
def test_figures_are_drawn_from_the_runs(name: str, folder: Path) -> None:
    chosen = ["--methods", "split-gru,harmonic"]
    assert main(["figure", name, *ROW, *chosen, "--out", str(folder)]) == 0
    assert (folder / "figures" / f"i-{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_missing_run_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--systems", "i", "--methods", "gru", "--no-run", "--out", str(folder)]
    assert main(["table", "learning-based", *arguments]) == 2
    error = capsys.readouterr().err
    assert "seed0.json is missing" in error.replace("\n", "")
    assert error.count("\n") == 1


def test_a_foreign_run_file_is_refused(folder: Path, tmp_path: Path) -> None:
    job = Job("i", "split-gru", 0, epochs=2)
    path = tmp_path / job.path
    path.parent.mkdir(parents=True)
    facts = json.loads((folder / "runs" / job.path).read_text(encoding="utf-8"))
    changes = {"settings": {"cutoff": 0.404}, "record": {"mean": 1e-3}, "job": {"seed": 3}}
    texts = {name: json.dumps(facts | {name: facts[name] | of}) for name, of in changes.items()}
    texts |= {"format": json.dumps(facts | {"format": 0}), "not JSON": "{"}
    for name, text in texts.items():
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=name):
            load(job, tmp_path)


def _copies(folder: Path, out: Path, job: Job, **changes: Any) -> None:
    """A finished run of two epochs as that of another job, with other results."""
    facts = json.loads((folder / "runs/i/split-gru/epochs2-seed0.json").read_text(encoding="utf-8"))
    setup = job.setup(job.record)
    settings = {k: v for k, v in setup.as_json().items() if k != "choice"}
    path = out / job.path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(facts | {"job": asdict(job), "settings": settings} | changes))


def test_a_split_model_s_run_says_what_a_sliced_warm_up_comes_to(folder: Path) -> None:
    """By the record's own bands, from the model that the run trained."""
    job = Job("i", "split-gru", 1, epochs=2)
    record, facts = job.record, load(job, folder / "runs")
    setup = job.setup(record)
    fitted = job.forecaster(setup).fit(record[: setup.train], seed=1)
    assert isinstance(fitted, Network)
    model = fitted.model
    assert isinstance(model, SplitModel)
    bands = [
        filtfilt(*butter(3, 0.4, kind, fs=10), record.y[:250], axis=0)[:30]
        for kind in ("low", "high")
    ]
    known = Signals(torch.from_numpy(np.hstack(bands))[None].float())
    with torch.no_grad():
        y = torch.stack([*model.components_of(known, 970).values()]).sum(dim=0)[0]
    assert facts["sliced_rmse"] == pytest.approx(rmse(record.truth[30:], y.numpy()), rel=1e-5)
    assert facts["sliced_rmse"] != facts["total_rmse"]


def test_more_epochs_than_the_papers_do_not_stand_in_for_them(folder: Path, tmp_path: Path) -> None:
    _copies(folder, tmp_path, Job("i", "split-gru", 0, epochs=400))
    with pytest.raises(FileNotFoundError, match=r"split-gru/seed0\.json is missing"):
        table("learning-based", lines("learning-based", ["i"], ["split-gru"], 1), tmp_path)


def test_the_gru_of_system_i_takes_the_epochs_of_the_papers_text() -> None:
    assert Job("i", "gru", epochs=2000) == Job("i", "gru")
    assert Job("i", "gru", epochs=300).path.name == "epochs300-seed0.json"
    for method, epochs in (("gru", 2000), ("split-gru", 300), ("split-gru-hp", 300)):
        job = Job("i", method)
        assert job.setup(job.record).settings.epochs == epochs
    assert Job("i", "split-gru", cutoff=0.4, downsampling=2, epochs=300) == Job("i", "split-gru")
    assert Job("i", "split-gru", cutoff=0.2).path.name == "w0.2-seed0.json"


class Killed(BaseException):
    """What nothing catches."""


def test_runs_that_were_stopped_go_on_after_the_finished_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    column = replace(HYBRID["v"], train=60, rnn_window=50)
    record = van_der_pol(120)
    short = replace(SYSTEMS["v"], column=column, record=lambda _: record)
    monkeypatch.setitem(SYSTEMS, "v", short)
    jobs = [Job("v", "filtered-rnn", seed=seed, epochs=2) for seed in range(2)]

    def kill(job: Job) -> None:
        raise Killed

    complete(jobs, tmp_path / "whole")
    with pytest.raises(Killed):
        complete(jobs, tmp_path / "killed", done=kill)
    first, second = (tmp_path / "killed" / job.path for job in jobs)
    written = first.read_bytes()
    assert not second.exists()
    assert complete(jobs, tmp_path / "killed") == 1
    assert first.read_bytes() == written
    for job in jobs:
        whole, went_on = (load(job, tmp_path / name) for name in ("whole", "killed"))
        for name in ("total_rmse", "forecast_rmse", "losses", "from_start", "components"):
            assert went_on[name] == whole[name]


@pytest.mark.usefixtures("public_data")
def test_the_whole_trajectory_counts_the_warm_up_too() -> None:
    for method in ("simulator", "residual-gru"):
        job = Job("vi", method)
        facts = load(job, RESULTS / "runs")
        record = job.record
        # A network takes the measured samples over; a simulator has its own there.
        start = record.y if method == "residual-gru" else record.y_sim
        whole = np.concatenate([start[:50], as_fit(facts, record).from_start.y])
        assert rmse(record.truth, whole) == pytest.approx(whole_rmse(facts, job), abs=1e-3)


def test_the_list_counts_the_runs_and_estimates_the_missing_ones(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in range(2):
        two = Job("i", "split-gru", seed, epochs=2)
        _copies(folder, tmp_path / "runs", two, seconds=9.0, cpu_seconds=2.0)  # they had to wait
    whole = Job("i", "split-gru", 0)
    _copies(folder, tmp_path / "runs", whole, seconds=300.0, cpu_seconds=300.0)
    row = lines("learning-based", ["i"], ["split-gru"], 5)
    state = progress(row[0].jobs, tmp_path / "runs")
    assert (state.there, state.needed, state.measured) == (1, 5, True)
    assert state.seconds == pytest.approx(4 * 300.0)  # the median is a second an epoch
    other = progress(lines("runtime-hybrid-rnn", ["v"], ["rnn"], 2)[0].jobs, tmp_path / "runs")
    assert (other.seconds, other.measured) == (2 * 1414, False)
    assert main(["list", "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert re.search(r"learning-based +1 of 73", text)
    assert re.search(r"runtime-hybrid-rnn +0 of 30 +\d+\.\d h \*", text)


def test_a_diverged_run_is_said_to_be(tmp_path: Path) -> None:
    job = Job("i", "gru", 0, epochs=1)
    complete([job], tmp_path)
    facts = json.loads((tmp_path / job.path).read_text(encoding="utf-8"))
    kept = {name: facts[name] for name in ("format", "job", "settings", "record")}
    (tmp_path / job.path).write_text(json.dumps(kept | {"diverged": "the loss is inf"}))
    made = table("learning-based", lines("learning-based", ["i"], ["gru"], 1, epochs=1), tmp_path)
    assert "diverged" in made.markdown()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["table", "4"], "table must be one of"),
        (["figure", "44"], "figure must be one of"),
        (["table", "cutoff", "--systems", "v"], "systems must be out of i"),
        (["table", "cutoff", "--methods", "rnn"], "methods must be out of"),
        (["table", "all", "--systems", "i"], "must be used with one table"),
        (["figure", "errors", "--systems", "x"], "systems must be out of"),
        (["table", "cutoff", "--seeds", "0"], "--seeds"),
    ],
)
def test_bad_arguments_are_named(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.json"))


def test_every_table_and_every_published_value_has_its_runs() -> None:
    for name, spec in SPECS.items():
        shown = [*lines(name)]
        found = {(x.system if x.value is None else x.value, x.method) for x in shown}
        wanted = {(key, method) for key, row in spec.published.items() for method in row}
        if spec.shows != "quantiles" and not spec.own_warmup:
            assert wanted <= found, name
    assert str(published.LEARNING_BASED["i"]["split-gru"]) == "0.127 (0.008)"
    assert {line.system for name in SPECS for line in lines(name)} == set(SYSTEMS)


def test_an_own_record_takes_the_place_of_an_unpublished_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    y = np.sin(np.arange(2100) / 10) + 3
    np.savetxt(tmp_path / "double_torsion_iii.csv", y, header="phi2", comments="")
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    record = Job("iii", "gru").record
    assert record.name == "double_torsion_iii"
    assert len(record) == 2000
    assert abs(record.y.mean()) < 1e-12


def oracle_on(record: Record) -> Array:
    """What the oracle that knows 250 samples says of the whole record."""
    known = ForecastContext(record.y[:0], len(record))
    return MassSpringOracle().fit(record[:250]).extrapolate(known)


def test_the_oracle_of_system_i_has_the_noise_floor() -> None:
    errors = []
    for draw in range(30):
        record = double_mass_spring(seed=draw)
        errors.append(rmse(record.y_true, oracle_on(record)))
    # 200 draws in the reading notes: mean 0.175, median 0.161.
    assert 0.14 < np.median(errors) < 0.2
    clean = double_mass_spring(noise_variance=0.0)
    np.testing.assert_allclose(oracle_on(clean), clean.y, atol=1e-6)


def test_the_simulated_pendulum_sticks_and_follows_its_drive() -> None:
    angles = {row: double_torsion_pendulum(row).truth[:, 0] for row in ("ii", "iv")}
    for row, period in (("ii", 160), ("iv", 1000 / 18)):
        spectrum = abs(np.fft.rfft(angles[row]))
        assert 2000 / np.argmax(spectrum) == pytest.approx(period, rel=0.05)
    speed = abs(np.diff(angles["ii"])) * 100
    assert (speed < 0.02 * speed.max()).mean() > 0.1


RESULTS = Path(__file__).parents[2] / "docs" / "results"
COMMITTED = sorted((RESULTS / "tables").glob("*.json"))


@pytest.mark.usefixtures("public_data")
@pytest.mark.parametrize("path", COMMITTED, ids=[path.stem for path in COMMITTED])
def test_the_committed_tables_are_those_of_the_committed_runs(path: Path) -> None:
    committed = json.loads(path.read_text(encoding="utf-8"))
    asked = committed["asked"]
    systems, methods = (asked[n] and asked[n].split(",") for n in ("systems", "methods"))
    change = {name: asked[name] for name in ("epochs", "cutoff", "downsampling")}
    rows = lines(path.stem, systems, methods, asked["seeds"], **change)
    made = table(path.stem, rows, RESULTS / "runs").markdown()
    assert made == committed["markdown"]


@pytest.mark.parametrize(
    ("name", "system", "methods", "said"),
    [
        ("hybrid-rnn", "v", ("filtered-rnn", "residual-rnn"), "filtered RNN, residual RNN"),
        ("learning-based", "iv", ("split-gru", "gru"), "split GRU, GRU"),
    ],
)
def test_a_verdict_is_that_of_all_choices_of_seeds(
    name: str, system: str, methods: tuple[str, str], said: str
) -> None:
    """Mann and Whitney's p by counting choices whose rank sums are as far apart."""
    facts = json.loads((RESULTS / "tables" / f"{name}.json").read_text(encoding="utf-8"))
    errors = {row["method"]: row for row in facts["rows"] if row["system"] == system}
    (line,) = (x for x in comparisons().splitlines() if x.startswith(f"| {said} | ({system}) "))
    cells = line.strip("| ").split(" | ")
    for protocol, (p, verdict) in (("total", cells[4:6]), ("forecast", cells[7:9])):
        ours, theirs = (errors[method][f"{protocol}_rmse"] for method in methods)
        ranks = np.argsort(np.argsort([*ours, *theirs])) + 1
        sums = np.array([sum(of) for of in combinations(ranks, 5)])
        expected = np.mean(abs(sums - 27.5) >= abs(sum(ranks[:5]) - 27.5))
        assert p == f"{expected:.2g}"
        lower = np.median(ours) < np.median(theirs)
        assert verdict == ("undecided" if expected >= 0.05 else "better" if lower else "worse")


def test_every_table_is_committed() -> None:
    assert {path.stem for path in COMMITTED} == {*SPECS}
