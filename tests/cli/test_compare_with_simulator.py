"""`splitband compare` with hybrid models and their simulator."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.cli.support import (
    DT,
    QUICK,
    SAMPLES,
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


def test_calibrated_and_conditioned_variants_follow_the_method(tmp_path: Path) -> None:
    call("compare record.csv --columns a --simulator simulated.csv --methods filtered-gru "
         f"--calibrate --conditioned {QUICK} --seeds 1 --jobs 1", tmp_path)  # fmt: skip
    found = results(tmp_path)["methods"]
    assert list(found) == [
        "filtered-gru", "filtered-gru-calibrated", "filtered-gru-conditioned",
        "filtered-gru-calibrated-conditioned",
    ]  # fmt: skip
    errors = [facts["total_rmse"][0] for facts in found.values()]
    assert np.isfinite(errors).all()
    assert len(set(errors)) == 4


def test_the_simulator_rows_are_its_error_raw_and_after_least_squares(hybrid: Path) -> None:
    found = results(hybrid)["methods"]
    gain, offset = np.polyfit(SIMULATED[:TRAIN], A[:TRAIN], 1)
    for name, y in (("simulator", SIMULATED), ("simulator-affine", gain * SIMULATED + offset)):
        assert found[name]["total_rmse"] == [pytest.approx(rms((A - y)[WARMUP:]))]
        assert found[name]["forecast_rmse"] == [pytest.approx(rms((A - y)[TRAIN:]))]


def test_what_a_simulation_does_not_reach_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its clock is a fiftieth too slow, and its output ends with the record."""
    time = DT * np.arange(2 * SAMPLES)
    for name, y in (("rig", np.sin(1.02 * time)), ("simulated", np.sin(time))):
        pd.DataFrame({"time": time, "y": y}).to_csv(tmp_path / f"{name}.csv", index=False)
    call(f"compare {tmp_path}/rig.csv --methods simulator-calibrated,mean "
         f"--simulator {tmp_path}/simulated.csv", tmp_path / "out")  # fmt: skip
    said = " ".join("".join(capsys.readouterr()).split())
    assert "warning: simulator-calibrated: the simulator's output ends too early" in said
