"""What `--simulator` takes, files, functions and FMUs, and the methods that it adds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import splitband as sb
from splitband.cli.options import RecordOptions, SimulatorOrBaseOptions
from splitband.cli.requests import Request, planned
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from tests.cli.support import QUICK, SIMULATED, TRAIN, WARMUP, A, call, results
from tests.signals import rms

pytestmark = pytest.mark.usefixtures("inside")


@pytest.mark.parametrize("options", ["simulated.csv", "simulated_names.csv --simulator-columns q"])
def test_the_columns_of_an_exported_trajectory_go_by_name_or_as_asked(
    options: str, tmp_path: Path
) -> None:
    call(f"inspect record.csv --columns b --simulator {options}", tmp_path)
    assert results(tmp_path)["simulator"]["total_rmse"] == pytest.approx(0.1)


@pytest.mark.parametrize("simulator", ["simulated.csv", "periodic"])
def test_python_takes_what_the_command_line_names(simulator: str) -> None:
    reading, methods = RecordOptions(columns="a", inputs=""), ["filtered-gru", "mean"]
    asked = Request("record.csv", reading, SimulatorOrBaseOptions(simulator))
    asked = replace(asked, methods=",".join(methods))
    record = sb.read("record.csv", columns="a")
    found = plan(PlanRequest(record, None, methods, simulator=simulator))
    expected = planned(asked)
    assert found.names == expected.names
    assert found.bands.cutoff == expected.bands.cutoff
    np.testing.assert_equal(found.record.y_sim, expected.record.y_sim)


def test_a_named_record_runs_its_own_simulator_for_a_calibration() -> None:
    plan = planned(Request("van-der-pol", methods="filtered-gru,simulator-calibrated"))
    assert plan.names == ["filtered-gru", "simulator-calibrated"]
    assert plan.record.y_sim is not None
    assert len(plan.record.y_sim) > len(plan.record)


def test_the_simulator_rows_are_its_error_raw_and_after_least_squares(tmp_path: Path) -> None:
    line = f"compare record.csv --columns a --simulator simulated.csv {QUICK} --seeds 1"
    methods = "residual-gru,residual-gru-calibrated,simulator,simulator-affine"
    call(f"{line} --methods {methods} --jobs 1", tmp_path)
    found = results(tmp_path)["methods"]
    gain, offset = np.polyfit(SIMULATED[:TRAIN], A[:TRAIN], 1)
    for name, y in (("simulator", SIMULATED), ("simulator-affine", gain * SIMULATED + offset)):
        assert found[name]["total_rmse"] == [pytest.approx(rms((A - y)[WARMUP:]))]
        assert found[name]["forecast_rmse"] == [pytest.approx(rms((A - y)[TRAIN:]))]
    assert found["residual-gru"]["total_rmse"] != found["residual-gru-calibrated"]["total_rmse"]
