"""Rows of the benchmark's table, and what is said of all of them."""

import json

import pytest

from splitband.report.benchmark import Row, summary


def test_regret_is_known_where_both_errors_are() -> None:
    assert Row("x", error=3.0, best_error=2.0).regret == 1.5
    assert Row("x", error=0.0, best_error=0.0).regret == 1.0
    assert Row("x", error=1.0, best_error=0.0).regret is None
    assert Row("x", best_error=1.0).regret is None
    untested = Row("x", "test", "seasonal-naive", best="mean", best_error=1.0)
    assert untested.note.startswith("seasonal-naive was not tested")


def test_the_summary_counts_what_has_numbers() -> None:
    rows = [
        Row("a", error=1.0, best_error=1.0, held=0.9),
        Row("b", error=3.0, best_error=1.5, held=0.5),
        Row("c", error=None, best_error=1.0),
        Row("d", failed="it does"),
    ]
    assert summary(rows) == {
        "cases": 4, "failed": 1, "with_regret": 2, "recommended_is_best": 1, "median_fit": -100.0,
        "median_error": 2.0, "median_regret": 1.5, "worst_regret": 2.0,
        "median_held": pytest.approx(0.7),
    }  # fmt: skip
    assert summary(rows[3:])["median_regret"] is None


def test_json_of_a_row_has_no_number_that_json_lacks() -> None:
    json.dumps(Row("x", error=1.0, best_error=0.0).as_json(), allow_nan=False)
