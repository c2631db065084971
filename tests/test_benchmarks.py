"""What the documentation says of benchmarks is what their files say."""

import importlib
import json
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def recommendation(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.recommendation")


PARSERS = "ArgumentParser(", "over_records("
SCRIPTS = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for folder in ("benchmarks", "docs", "tests/cli")
    for path in sorted((ROOT / folder).glob("*.py"))
    if any(parser in path.read_text(encoding="utf-8") for parser in PARSERS)
    and path.stem != "jax_peer"
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


def test_every_script_of_the_benchmarks_has_a_help() -> None:
    runs = {
        f"benchmarks.{path.stem}"
        for path in (ROOT / "benchmarks").glob("*.py")
        if "__main__" in path.read_text(encoding="utf-8")
    }
    assert runs <= {*SCRIPTS, "benchmarks.jax_peer"}


@pytest.mark.parametrize("methods", ["baselines", "default"])
def test_the_table_of_intervals_is_that_of_its_file(recommendation: Any, methods: str) -> None:
    facts = json.loads((ROOT / recommendation.FILES[methods]).read_text(encoding="utf-8"))
    page = (ROOT / recommendation.PAGE).read_text(encoding="utf-8")
    assert recommendation.on_page(page, facts) == page
    assert facts["methods"] == methods
    assert facts["kinds"] == recommendation.by_kind(facts["found"])


@pytest.mark.parametrize("methods", ["baselines", "default"])
def test_no_constant_is_judged_by_a_seed_it_was_chosen_by(
    recommendation: Any, methods: str
) -> None:
    facts = json.loads((ROOT / recommendation.FILES[methods]).read_text(encoding="utf-8"))
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
    facts = recommendation._measured(job, None)
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
    assert recommendation._measured(job, None)["regret"] == 7.0


def test_the_page_of_scaling_is_made_of_measured_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is not: `python -m benchmarks.scaling`."""
    monkeypatch.syspath_prepend(str(ROOT))
    scaling = importlib.import_module("benchmarks.scaling")
    facts = json.loads((ROOT / "docs/benchmarks/scaling.json").read_text(encoding="utf-8"))
    page = (ROOT / "docs/scaling.md").read_text(encoding="utf-8")
    before, _, rest = page.partition(scaling.BEGIN)
    shown, _, after = rest.partition(scaling.END)
    assert shown == scaling.table(facts)
    assert not [c for c in before + after if c.isdigit()]
    again = scaling.simulated(*scaling.costs())
    assert again["overhead, s"] == pytest.approx(facts["overhead, s"])
    for what in ("hours", "idle"):
        key = f"{what}, by records at once and workers"
        for at_once, of_workers in again[key].items():
            assert facts[key][at_once] == pytest.approx(of_workers)


def test_the_model_of_a_queue_has_the_times_that_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    scaling = importlib.import_module("benchmarks.scaling")
    records = scaling.RECORDS // scaling._FEWER
    rounds = records * scaling.STAGES
    # One worker does one job after the other, whatever the order; the scheduler adds its part.
    assert scaling.finished([3.0, 1.0], 0.0, 0.0, 1, 1) == pytest.approx((4 * rounds, 0))
    assert scaling.finished([3.0, 1.0], 0.5, 0.0, 1, 1) == pytest.approx((5 * rounds, 0.2))
    # The command reads a record before its jobs, and draws pictures after them.
    assert scaling.finished([4.0], 0.0, 2.0, 1, 1)[0] == pytest.approx(4 * rounds + 2 * records)
    # With as many as there are jobs, a stage takes as long as its longest one.
    assert scaling.finished([3.0, 1.0], 0.0, 0.0, 2, 1) == pytest.approx((3 * rounds, 1 / 3))
    # Two records at once keep two workers busy.
    assert scaling.finished([3.0], 0.0, 0.0, 2, 2) == pytest.approx((3 * rounds / 2, 0))
    # The scheduler alone, and the machine of the command alone: jobs that take no time.
    alone = scaling.finished([0.0] * 10, 0.01, 0.0, 1000, 100)
    assert alone[0] == pytest.approx(0.1 * rounds)
    of_command = scaling.finished([0.0], 0.0, 4.0, 1000, 1000)
    assert of_command[0] == pytest.approx(4 * records / scaling.COMMANDING, rel=0.1)


def test_the_page_of_public_benchmarks_is_made_of_their_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where it is not: `python -m benchmarks.public --no-run`."""
    monkeypatch.syspath_prepend(str(ROOT))
    page = importlib.import_module("benchmarks.public_page")
    folder = ROOT / "docs/results/benchmarks"
    assert folder.with_suffix(".md").read_text(encoding="utf-8") == page.made(folder)
