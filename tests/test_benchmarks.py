"""What the documentation says of benchmarks is what their files say."""

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def recommendation(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.recommendation")


def test_the_table_of_intervals_is_that_of_its_file(recommendation: Any) -> None:
    text = (ROOT / "docs/benchmarks/recommendation.json").read_text(encoding="utf-8")
    facts = json.loads(text)
    page = (ROOT / "docs/reliability.md").read_text(encoding="utf-8")
    shown = page.split(recommendation.BEGIN)[1].split(recommendation.END)[0]
    assert shown == recommendation.table(facts)
    assert facts["kinds"] == recommendation.by_kind(facts["found"])


def test_no_constant_is_judged_by_a_seed_it_was_chosen_by(recommendation: Any) -> None:
    facts = json.loads((ROOT / "docs/benchmarks/recommendation.json").read_text(encoding="utf-8"))
    first, last = facts["seeds"]
    assert {first, last} <= set(recommendation.REPORTED)
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
    job.path.write_text(json.dumps(facts | {"regret": 7.0}), encoding="utf-8")
    assert recommendation._measured(job, None)["regret"] == 7.0
