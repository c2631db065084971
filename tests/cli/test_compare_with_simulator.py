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
from tests.drawing import nothing_drawn
from tests.records import rms

pytestmark = pytest.mark.usefixtures("inside")


@pytest.fixture(scope="module")
def hybrid(workspace: Path) -> Path:
    methods = "filtered-gru,residual-gru,gru,simulator,simulator-affine"
    out = workspace / "hybrid"
    with pytest.MonkeyPatch.context() as undrawn:
        nothing_drawn(undrawn)
        call(f"compare {workspace}/record.csv --columns a --simulator {workspace}/simulated.csv "
             f"--methods {methods} --calibrate {QUICK} --seeds 1 --jobs 1", out)  # fmt: skip
    return out


def test_calibration_adds_a_row_to_each_hybrid_method_only(hybrid: Path) -> None:
    found = results(hybrid)["methods"]
    assert list(found) == [
        "filtered-gru", "filtered-gru-calibrated", "residual-gru", "residual-gru-calibrated",
        "gru", "simulator", "simulator-calibrated", "simulator-affine",
    ]  # fmt: skip
    for name in ("filtered-gru", "residual-gru"):
        assert found[name]["total_rmse"] != found[f"{name}-calibrated"]["total_rmse"]


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


def test_the_simulator_rows_are_its_error_raw_and_after_least_squares(hybrid: Path) -> None:
    found = results(hybrid)["methods"]
    gain, offset = np.polyfit(SIMULATED[:TRAIN], A[:TRAIN], 1)
    for name, y in (("simulator", SIMULATED), ("simulator-affine", gain * SIMULATED + offset)):
        assert found[name]["total_rmse"] == [pytest.approx(rms((A - y)[WARMUP:]))]
        assert found[name]["forecast_rmse"] == [pytest.approx(rms((A - y)[TRAIN:]))]
