"""`splitband compare` with hybrid models and their simulator."""

from pathlib import Path

import numpy as np
import pytest

from splitband.cli.comparing import Request, planned
from splitband.cli.options.records import RecordOptions
from splitband.cli.options.simulators import SimulatorOrBaseOptions
from tests.cli.support import (
    QUICK,
    SIMULATED,
    TRAIN,
    WARMUP,
    A,
    call,
    results,
)
from tests.records import rms

pytestmark = pytest.mark.usefixtures("inside")


def test_calibrated_and_conditioned_variants_follow_the_method() -> None:
    asked = Request(
        "record.csv",
        RecordOptions(columns="a"),
        SimulatorOrBaseOptions("simulated.csv"),
        methods="filtered-gru",
        calibrate=True,
        conditioned=True,
    )
    assert [method.name for method in planned(asked).methods] == [
        "filtered-gru", "filtered-gru-calibrated", "filtered-gru-conditioned",
        "filtered-gru-calibrated-conditioned",
    ]  # fmt: skip


def test_the_simulator_rows_are_its_error_raw_and_after_least_squares(tmp_path: Path) -> None:
    call(f"compare record.csv --columns a --simulator simulated.csv --calibrate {QUICK} --seeds 1 "
         "--methods residual-gru,simulator,simulator-affine --jobs 1", tmp_path)  # fmt: skip
    found = results(tmp_path)["methods"]
    gain, offset = np.polyfit(SIMULATED[:TRAIN], A[:TRAIN], 1)
    for name, y in (("simulator", SIMULATED), ("simulator-affine", gain * SIMULATED + offset)):
        assert found[name]["total_rmse"] == [pytest.approx(rms((A - y)[WARMUP:]))]
        assert found[name]["forecast_rmse"] == [pytest.approx(rms((A - y)[TRAIN:]))]
    assert found["residual-gru"]["total_rmse"] != found["residual-gru-calibrated"]["total_rmse"]
