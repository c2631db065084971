"""Test records: nothing is fitted to them but the state that their first samples tell."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.signal

import splitband as sb
from splitband import Bands, Record, TrainingSettings
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.metrics import rmse
from tests.signals import Setup
from tests.support import compare, known_after

DT, TRAIN, WARMUP = 0.1, 160, 12
QUICK = TrainingSettings.paper(40, WARMUP, 1, 16)
SETUP = Setup(TRAIN, QUICK, Bands(0.6, 1, 2))


def driven(samples: int, seed: int, begin: float = 0.0) -> Record:
    """A second-order system under a random input, from a state of its own."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, (samples + 50, 1))
    y = scipy.signal.lfilter([0.0, 0.3, 0.1], [1.0, -1.5, 0.7], u[:, 0]) + 2.0
    return Record(y[50:, None], DT, u=u[50:], inputs=("force",), start=begin, name=f"rig {seed}")


TESTS = (driven(90, 1), driven(70, 2, begin=100.0))


@pytest.fixture(scope="module")
def usual() -> sb.Comparison:
    methods = [sb.Single(sb.GRU(4)), sb.Linear(), sb.Persistence(), sb.Mean(), sb.SeasonalNaive()]
    return compare(driven(TRAIN, 0), methods, SETUP, seeds=2, tests=TESTS)


def test_a_linear_system_is_known_from_another_record_and_its_first_samples(
    usual: sb.Comparison,
) -> None:
    """Its order and state are, as there is no noise."""
    (errors,) = [usual.errors(fit).tests for fit in usual.fits["linear"]]
    assert max(errors) < 1e-3 * float(np.std(TESTS[0].y))


@pytest.mark.parametrize(
    ("samples", "asked", "warmup"), [(500, {}, 50), (60, {}, 20), (60, {"warmup": 5}, 5)]
)
def test_a_warm_up_that_is_left_open_leaves_most_of_a_short_test_record(
    samples: int, asked: dict[str, int], warmup: int
) -> None:
    tests = [driven(samples, 1)]
    found = plan(PlanRequest(driven(400, 0), methods=[sb.Mean()], tests=tests, settings=asked))
    assert found.settings.warmup == warmup


@pytest.mark.filterwarnings("ignore:output y is beyond its range")
def test_what_a_network_says_is_its_free_run_from_the_first_samples(usual: sb.Comparison) -> None:
    model = sb.Single(sb.GRU(4), settings=QUICK).fit(driven(TRAIN, 0), seed=1)
    for test, said in zip(TESTS, usual.fits["gru"][1].tests, strict=True):
        known = known_after(test, WARMUP)
        expected = model.predict(len(test) - WARMUP, test[:WARMUP], **known, other_record=True)
        np.testing.assert_array_equal(said.y, expected.y)
        np.testing.assert_allclose(said.time, test.time[WARMUP:], atol=1e-9)


def test_fewer_samples_than_a_network_was_trained_with_can_start_a_simulation() -> None:
    """Errors count from the first unknown sample on."""
    network = sb.Single(sb.GRU(4), settings=QUICK)
    result = compare(driven(TRAIN, 0), [network, sb.Mean()], SETUP, tests=TESTS, initial=5)
    test = TESTS[0]
    assert test.u is not None
    model = result.trained("gru")
    with pytest.warns(sb.ExtrapolationWarning, match=f"the history has 5 of the {WARMUP}"):
        expected = model.predict(len(test) - 5, test[:5], u=test.u[5:], other_record=True)
    (fit,) = result.fits["gru"]
    np.testing.assert_array_equal(fit.tests[0].y, expected.y)
    assert [len(each.tests[0].y) for each in result.medians.values()] == [len(test) - 5] * 2
    error = rmse(test.y[5:], expected.y)
    assert result.errors(fit).tests[0] == pytest.approx(error)


def test_the_last_sample_of_the_warm_up_is_held_and_the_training_mean_kept(
    usual: sb.Comparison,
) -> None:
    held, mean = (usual.errors(usual.fits[name][0]) for name in ("persistence", "mean"))
    for i, test in enumerate(TESTS):
        truth = test.y[WARMUP:]
        last = np.full_like(truth, test.y[WARMUP - 1, 0])
        assert held.tests[i] == pytest.approx(rmse(truth, last))
        level = np.full_like(truth, driven(TRAIN, 0).y.mean())
        assert mean.tests[i] == pytest.approx(rmse(truth, level))


def test_what_goes_on_in_the_time_of_the_training_record_is_left_out_by_name(
    usual: sb.Comparison,
) -> None:
    assert usual.left_out == ["seasonal-naive"]
    assert not usual.fits["seasonal-naive"][0].tests


@pytest.mark.usefixtures("drawn")
def test_what_is_found_is_written_where_no_method_can_be_tested(tmp_path: Path) -> None:
    result = compare(driven(TRAIN, 0), ["seasonal-naive"], SETUP, tests=TESTS)
    assert result.left_out == ["seasonal-naive"]
    result.save(tmp_path)
    result.report(tmp_path / "report.html")
    assert {"results.json", "report.html"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize(("start", "said"), [("2024-05-01T10:00", 1), ("2024-05-01T10:00Z", 0)])
def test_dates_of_which_just_one_has_a_time_zone_are_named(start: str, said: int) -> None:
    """Another record's stamps are not compared; a reader should know that they could not be."""
    record = replace(driven(TRAIN, 0), start=pd.Timestamp("2024-03-01T10:00Z"))
    test = replace(TESTS[0], start=pd.Timestamp(start))
    (fit,) = compare(record, [sb.Linear()], SETUP, tests=[test]).fits["linear"]
    assert sum("just one has a time zone" in each for each in fit.tests[0].warnings) == said


def test_a_hybrid_model_needs_the_simulator_of_the_test_record() -> None:
    def simulated(record: Record) -> Record:
        return replace(record, y_sim=0.9 * record.y)

    tests = [simulated(test) for test in TESTS]
    methods = [sb.Residual(None, sb.GRU(4)), sb.Calibrated(terms=["gain", "offset"])]
    record = simulated(driven(TRAIN, 0))
    found = compare(record, methods, SETUP, tests=tests)
    assert found.left_out == []
    assert max(found.errors(found.medians["simulator-affine"]).tests) < 1e-6
    found = compare(record, methods, SETUP, tests=TESTS)
    assert found.left_out == ["residual-gru", "simulator-affine"]


def test_all_of_the_record_is_trained_on_and_nothing_is_learned_from_tests() -> None:
    def forecast(tests: tuple[Record, ...]) -> np.ndarray:
        methods = [sb.Single(sb.GRU(4), settings=QUICK)]
        found = sb.compare(driven(TRAIN, 0), methods=methods, tests=tests, seeds=1)
        assert found.plan.train == TRAIN
        assert found.medians["gru"].forecast is None
        return found.medians["gru"].tests[0].y

    changed = TESTS[0].y.copy()
    changed[WARMUP:] += 5.0
    later = replace(TESTS[0], y=changed)
    np.testing.assert_array_equal(forecast((TESTS[0],)), forecast((later,)))


@pytest.mark.usefixtures("drawn")
def test_the_files_hold_an_entry_for_each_seed_and_test(
    usual: sb.Comparison, tmp_path: Path
) -> None:
    usual.save(tmp_path)
    facts = json.loads((tmp_path / "results.json").read_text())
    gru = facts["methods"]["gru"]
    assert [len(of_seed) for of_seed in gru["test_rmse"]] == [2, 2]
    median = np.median([fit.tests[0].y for fit in usual.fits["gru"]], axis=0)
    expected = rmse(TESTS[0].y[WARMUP:], median)
    assert gru["median_of_seeds"]["test_rmse"][0] == pytest.approx(expected)
    assert (
        facts["methods"]["linear"]["median_of_seeds"]["test_rmse"]
        == (facts["methods"]["linear"]["test_rmse"][0])
    )
    assert "test_rmse" not in facts["methods"]["seasonal-naive"]
    assert "forecast_rmse" not in gru
    assert [test["name"] for test in facts["tests"]] == ["rig 1", "rig 2"]
    assert "report.html" in {path.name for path in tmp_path.iterdir()}


def test_errors_name_the_test_record() -> None:
    methods = [sb.Persistence()]
    short = TESTS[0][:WARMUP]
    with pytest.raises(ValueError, match="warmup must fit into the test record rig 1 of 12"):
        compare(driven(TRAIN, 0), methods, SETUP, tests=[short])
    holes = replace(TESTS[0], measured=np.arange(len(TESTS[0]))[:, None] % WARMUP > 0)
    with pytest.raises(ValueError, match="between its gaps and with samples to predict after it"):
        compare(driven(TRAIN, 0), methods, SETUP, tests=[holes])
    other = replace(TESTS[0], u=None, inputs=())
    with pytest.raises(ValueError, match="rig 1 must have the training record's 1 channel"):
        compare(driven(TRAIN, 0), methods, SETUP, tests=[other])
    lost = replace(TESTS[0], measured=np.arange(len(TESTS[0]))[:, None] < WARMUP)
    with pytest.raises(ValueError, match="every channel of the test record rig 1 must be measured"):
        compare(driven(TRAIN, 0), methods, SETUP, tests=[lost])


def test_a_test_record_that_a_method_cannot_warm_up_on_costs_no_other_result() -> None:
    """The network below runs freely from the first sample on, which was not measured here."""
    y = TESTS[0].y.copy()
    y[:5] = np.nan
    gap = Record.with_gaps(y, DT, TESTS[0].u, name="gap", inputs=("force",))
    below = sb.Residual(sb.Single(sb.GRU(3), QUICK), sb.GRU(3), settings=QUICK, name="below")
    record = driven(TRAIN + 40, 0)
    result = compare(record, [below, sb.Mean()], SETUP, tests=[gap])
    (fit,) = result.fits["below"]
    assert not fit.tests
    assert "not tested on gap: history must begin with 12 measured samples" in fit.description
    assert fit.forecast is not None
    assert result.left_out == ["below"]


def test_test_records_of_one_name_are_told_apart() -> None:
    tests = [replace(test, name="run") for test in TESTS]
    result = compare(driven(TRAIN, 0), [sb.Mean()], SETUP, tests=tests)
    assert [test.name for test in result.tests] == ["run", "run (2)"]
    (fit,) = result.fits["mean"]
    columns = [f"test RMSE {name}" for name in ("run", "run (2)")]
    assert [*result.table.loc["mean", columns]] == [*result.errors(fit).tests]


def test_a_test_record_is_told_apart_from_the_record_by_its_name() -> None:
    tests = [replace(test, name=name) for test, name in zip(TESTS, ("run", ""), strict=True)]
    planned = plan(PlanRequest(replace(driven(TRAIN, 0), name="run"), methods="mean", tests=tests))
    assert [test.name for test in planned.tests] == ["run (2)", "2"]


def test_what_can_be_tested_is_recommended() -> None:
    """Of a sine, harmonic regression knows more, but nothing of another record."""
    t = DT * np.arange(200)
    record, test = (Record(np.sin(1.3 * t + phase), DT) for phase in (0.0, 2.0))
    result = compare(record, [sb.Harmonic(), sb.Mean()], SETUP, tests=[test])
    assert result.require_trial().errors["harmonic"] < result.require_trial().errors["mean"]
    assert result.recommended == "mean"
