"""What the documentation says of benchmarks is what their files say."""

import importlib
import json
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def recommendation(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.recommendation")


SCRIPTS = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for folder in ("benchmarks", "docs", "tests/cli")
    for path in sorted((ROOT / folder).glob("*.py"))
    if "ArgumentParser(" in path.read_text(encoding="utf-8") and path.stem != "jax_peer"
]
"""But for the one that runs in an environment of its own."""


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_is_imported_and_shows_its_help(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(SystemExit) as left:
        runpy.run_module(name, run_name="__main__", alter_sys=True)
    assert left.value.code == 0
    assert capsys.readouterr().out.startswith("usage:")


def test_the_nano_drone_is_read_and_judged_as_its_authors_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On files of the published layout: flights that turn steadily about z, and accelerate."""
    monkeypatch.syspath_prepend(str(ROOT))
    drone = importlib.import_module("benchmarks.nanodrone")
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    folder, t = tmp_path / "benchmarks" / "nanodrone" / "test", 0.01 * np.arange(120)
    folder.mkdir(parents=True)
    still = dict.fromkeys(["y", "z", "vy", "vz", "qx", "qy", "wx", "wy"], 0 * t)
    turning = {"qz": np.sin(t / 2), "qw": np.cos(t / 2), "wz": 1 + 0 * t}  # 1 rad/s
    motors = {name: np.full(120, 60_000.0) for name in drone.MOTORS}
    moving = {"t": t, "x": t**2, "vx": 2 * t}
    pd.DataFrame(still | turning | motors | moving).to_csv(folder / "melon_run1.csv")
    (record,) = drone.flights("test")
    np.testing.assert_allclose(
        record.y[:, [0, 3, 8, 11]], np.column_stack([t**2, 2 * t, t, 1 + 0 * t])
    )
    np.testing.assert_allclose(record.u, 2 * np.pi * 60_000 / 360)  # six poles
    found = drone.judged(sb.Persistence().fit(record), [record], 20)
    ahead = 0.01 * np.arange(1, 51)
    np.testing.assert_allclose(found["rotation"], ahead, rtol=1e-9)
    np.testing.assert_allclose(found["velocity"], 2 * ahead, rtol=1e-9)
    np.testing.assert_allclose(found["rate"], 0, atol=1e-12)
    last = 0.01 * np.arange(19, 70)  # where the forecasts begin
    np.testing.assert_allclose(found["position"], ahead**2 + 2 * ahead * last.mean(), rtol=1e-9)


def test_every_script_of_the_benchmarks_has_a_help() -> None:
    runs = {
        f"benchmarks.{path.stem}"
        for path in (ROOT / "benchmarks").glob("*.py")
        if "__main__" in path.read_text(encoding="utf-8")
    }
    assert runs <= {*SCRIPTS, "benchmarks.jax_peer"}


@pytest.mark.parametrize("methods", ["baselines", "default"])
def test_the_table_of_intervals_is_of_all_records_and_of_reported_seeds(
    recommendation: Any, methods: str
) -> None:
    facts = json.loads((ROOT / recommendation.FILES[methods]).read_text(encoding="utf-8"))
    assert facts["methods"] == methods
    assert facts["kinds"] == recommendation.by_kind(facts["found"])
    first, last = facts["seeds"]
    assert {first, last} <= set(recommendation.REPORTED)
    assert facts["seeds_are"] == "reported"
    assert not set(recommendation.REPORTED) & set(recommendation.DEVELOPMENT)


def test_the_facts_of_a_record_are_made_once(recommendation: Any, tmp_path: Path) -> None:
    (job,) = (
        job
        for job in recommendation.jobs([100], False, "mean,persistence", tmp_path)
        if job.kind == "ramp"
    )
    facts = recommendation._measured(job)
    y = job.record().y
    errors = {
        "mean": y[job.train :] - y[: job.train].mean(),
        "persistence": y[job.train :] - y[job.train - 1],
    }
    of_methods = {name: np.sqrt(np.mean(left**2)) for name, left in errors.items()}
    found = {name: of_method["error"] for name, of_method in facts["methods"].items()}
    assert found == pytest.approx(of_methods)
    assert facts["regret"] == pytest.approx(
        of_methods[facts["recommended"]] / min(of_methods.values())
    )
    assert facts["over_baselines"] == 1.0
    job.path.write_text(json.dumps(facts | {"regret": 7.0}), encoding="utf-8")
    assert recommendation._measured(job)["regret"] == 7.0


def test_the_families_are_drawn_from_their_seeds_and_tabled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    families = importlib.import_module("benchmarks.families")
    for make in families.FAMILIES.values():
        one, again, other = (make(np.random.default_rng(seed)) for seed in (1000, 1000, 1001))
        assert np.array_equal(one.y, again.y)
        assert one.y_sim is None or np.array_equal(one.y_sim, again.y_sim)
        assert not np.array_equal(one.y, other.y)
        assert len(one) == families.SAMPLES
    row = {"family": "crane", "draw": 1000, "recommended": "gru", "regret": 2.0}
    errors = {"gru": 1.0, "filtered-gru": 0.5, "residual-gru": 0.8, "simulator": 3.0}
    _, _, line, *_ = families.table(
        [row | {"errors": errors, "floors": {"low": 0.25}}]
    ).splitlines()
    cells = [cell.split(" (")[0] for cell in line.strip("|").split(" | ")]
    assert cells == [" crane †", "network", "1", "2", "0.62", "0.5", "0.8", "1", "3", "", "0.25 "]


def test_constants_that_were_halved_and_doubled_are_no_worse_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    listed = importlib.import_module("docs.constants")
    rows: dict[tuple[str, str], list[float]] = {}
    path = ROOT / "docs/results/benchmarks/constants.jsonl"
    for row in map(json.loads, path.read_text(encoding="utf-8").splitlines()):
        rows.setdefault((row["path"], row["name"]), []).append(row["mean"])
    halved = [each for each in listed.constants() if "halving and doubling" in each.said]
    for constant in halved:
        path = constant.path.relative_to(listed.SOURCE).as_posix()
        means = [mean for name in constant.names for mean in rows[path, name]]
        assert len(means) == 2 * len(constant.names)
        assert min(means) > 0.97, (path, constant.names)
    assert len(halved) > 10


def test_a_run_of_todays_code_is_not_run_again_and_a_stale_one_is_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    clock, claims = map(importlib.import_module, ("benchmarks.clock", "benchmarks.claims"))
    monkeypatch.setattr(claims, "reference", lambda: 2.0)
    rows, seen = [{"record": name, "asked": 30.0} for name in ("a", "b")], list[str]()
    path = tmp_path / "runs.jsonl"
    path.write_text(json.dumps(rows[1] | {"errors": [9.0], "commit": "before"}) + "\n")

    def run(row: dict[str, Any], folder: Path) -> dict[str, Any]:
        seen.append(row["record"])
        return row | {"errors": [1.0]}

    for some in (rows[:1], rows, [rows[0] | {"asked": 60.0}]):
        clock.complete(path, some, run)
    assert seen == ["a", "b", "a"]
    found = claims.read(path)
    assert [row["errors"] for row in found] == [[1.0]] * 3
    assert {row["sources"] for row in found} == {claims.sources()}
    assert found[0]["computer"]["reference_seconds"] == [2.0, 2.0]


@pytest.fixture
def filter_case(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.filter_case")


def test_a_run_of_the_filters_case_is_made_and_not_made_again(
    filter_case: Any, tmp_path: Path
) -> None:
    runs = [r for r in filter_case.rows(1) if r["arm"] in ("L(simulator)", "control")][:2]
    found = [filter_case.measured(row | {"draw": 100}) for row in runs]
    # An independent low-pass filter, by SciPy; the whole simulation is known.
    record, low = filter_case.record_of(found[0]), found[0]["cutoff"]
    b, a = scipy.signal.butter(1, low, fs=record.sampling_rate)
    y_sim = record.y_sim[:, 0]
    filtered, _ = scipy.signal.lfilter(b, a, y_sim, zi=scipy.signal.lfilter_zi(b, a) * y_sim[0])
    left = (filtered - record.y[:, 0])[1500:]
    assert found[0]["error"] == pytest.approx(np.sqrt(np.mean(left**2)))
    assert found[1]["trainings"] == 1
    assert 0 < found[1]["error"] < found[0]["error"]
    (tmp_path / "runs.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in found))
    again = [runs[0] | {"draw": 100}, runs[1]]
    assert filter_case.missing(tmp_path / "runs.jsonl", again) == [runs[1]]


def test_the_control_without_a_network_is_the_low_passed_simulator(filter_case: Any) -> None:
    torch, models = importlib.import_module("torch"), importlib.import_module("splitband.models")
    networks, filters = map(importlib.import_module, ("splitband.networks", "splitband.filters"))
    pair = filters.ComplementaryPair.perfect([0.1, 0.1], [1.0, -0.8], 1.0, "low")
    cell = networks.GRU(3).sized(1, 0, 5)
    control, hybrid = filter_case.NotHighPassed(cell, pair), models.FilteredModel(cell, pair)
    with torch.no_grad():
        for weight in cell.parameters():
            weight.zero_()
    rng = np.random.default_rng(0)
    y, y_sim = rng.standard_normal((5, 1)), rng.standard_normal((25, 1))
    runs = [model.simulate_components(y, 20, None, y_sim) for model in (control, hybrid)]
    (low, network), (same, high) = (run.values() for run in runs)
    assert low == pytest.approx(same)
    assert not network.any()
    assert high.any()  # that of (c) goes on from the warm-up's high band


def test_ratios_of_the_filters_case_are_geometric_means_over_draws(filter_case: Any) -> None:
    rng, rows, logs = np.random.default_rng(0), list[dict[str, Any]](), list[float]()
    for draw in range(2000, 2012):
        own = {arm: rng.normal(size=2) for arm in ("filtered", "residual", "control")}
        own["filtered"] -= 2.0
        logs.append(own["filtered"].mean() - own["residual"].mean())
        row = {"family": "noise above", "cell": "state-space", "calibrated": False, "draw": draw}
        rows += [
            row | {"arm": arm, "seed": i, "error": float(np.exp(each)), "deviation": 100.0}
            for arm, of in own.items()
            for i, each in enumerate(of)
        ]
    unfinished = rows[-1] | {"draw": 2012}  # one seed of two
    table = filter_case.comparisons([*rows, unfinished])
    primary = table[table["group"] == "primary"].set_index("other")
    first = primary.loc["residual"]
    assert first["ratio"] == pytest.approx(np.exp(np.mean(logs)))
    assert first["p"] == pytest.approx(scipy.stats.wilcoxon(logs).pvalue)
    half = scipy.stats.sem(logs) * scipy.stats.t.ppf(0.975, 11)
    assert np.log(first["high"] / first["low"]) == pytest.approx(2 * half)
    assert first["n"] == 12
    assert [*primary["verdict"]] == ["better", "better"]
    other = table[(table["arm"] == "control") & (table["other"] == "residual")].iloc[0]
    assert other["verdict"] == "undecided"
    assert other["p (Holm)"] >= other["p"]


def test_p_values_are_corrected_as_holm_did(filter_case: Any) -> None:
    found = filter_case.holm(filter_case.pd.Series([0.04, 0.01, 0.03, 0.5]))
    assert [found[i] for i in range(4)] == pytest.approx([0.09, 0.04, 0.09, 0.5])
