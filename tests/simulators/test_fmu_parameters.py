"""The parameters of an FMU that is compiled here from C: fitted, gone on with, side by side."""

from pathlib import Path

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.simulators import Effort, identify
from tests.simulators.fmus import COMPILES, built
from tests.support import known_after

pytest.importorskip("fmpy")
if not COMPILES:
    pytest.skip("no gcc to compile an FMU with", allow_module_level=True)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """x' = u - k x, which ends its process at k above 12."""
    slope = "r[K] > 12 ? (abort(), 0.0) : r[U] - r[K] * r[X]"
    return built(tmp_path_factory.mktemp("rig") / "rig.fmu", slope=slope)


def measured(samples: int = 150) -> sb.Record:
    """By SciPy: k = 4, from x = 1 on."""
    u = np.repeat(np.resize([2.0, -2.0, -2.0], samples // 10), 10)
    system = [[-4.0]], [[1.0]], [[1.0]], [[0.0]]
    _, y, _ = scipy.signal.lsim(system, u, 0.1 * np.arange(samples), X0=[1.0], interp=False)
    noise = np.random.default_rng(0).normal(0, 0.002, samples)
    return sb.Record(y + noise, 0.1, u=u)


def test_two_parameters_are_found_and_it_forecasts_with_inputs(rig: Path) -> None:
    record = measured()
    model = sb.GreyBox(sb.Fmu(rig, parameters={"k": (0.4, 11.0), "x": (-2.0, 2.0)}), starts=6)
    found = model.fit(record[:100]).predict(50, **known_after(record, 100))
    assert model.estimate.values == pytest.approx({"k": 4.0, "x": 1.0}, rel=0.01)
    assert sb.nrmse(record.y[100:], found.y) < 0.05


def test_of_starts_side_by_side_one_whose_simulator_ends_its_process_has_failed(rig: Path) -> None:
    fmu = sb.Fmu(rig, parameters={"k": (0.5, 50.0), "x": 1.0})
    found = identify(fmu, measured(60), effort=Effort(3, workers=2))
    assert found.values == pytest.approx({"k": 4.0}, rel=0.02)
    assert found.starts[1] < 3
