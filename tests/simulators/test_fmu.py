"""FMUs against the equation that they were built from; what is left of them, and of failures."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitband.simulators import Fmu, run
from tests.simulators.test_simulators import DT, SAMPLES, oscillator


def test_an_fmu_follows_the_equation_it_was_built_from(van_der_pol_fmu: Path) -> None:
    with Fmu(van_der_pol_fmu) as fmu, Fmu(van_der_pol_fmu, ["v", "x"]) as swapped:
        assert fmu.outputs == ["x", "v"]
        found = run(fmu, SAMPLES, DT, ny=2)
        np.testing.assert_array_equal(run(swapped, SAMPLES, DT, ny=2)[:, ::-1], found)
    np.testing.assert_allclose(found, oscillator(1.0, (-2.0, 1.0)), atol=1e-8)


def test_an_fmpy_that_is_too_old_is_refused(
    van_der_pol_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fmpy.__version__", "0.3.9")
    with pytest.raises(ValueError, match=r"an FMU needs FMPy 0.3.29 or newer, not 0.3.9: pip"):
        Fmu(van_der_pol_fmu, ["x"])


def test_an_fmu_starts_afresh_in_every_run_from_its_start_values(van_der_pol_fmu: Path) -> None:
    with Fmu(van_der_pol_fmu, ["x"], {"mu": 3.0, "x": 0.5}) as fmu:
        first = run(fmu, SAMPLES, DT)
        assert len(run(fmu, 30, 2 * DT)) == 30
        np.testing.assert_array_equal(run(fmu, SAMPLES, DT), first)
    np.testing.assert_allclose(first, oscillator(3.0, (0.5, 1.0))[:, :1], atol=1e-7)


@pytest.mark.parametrize(
    "arguments", [(["x", "speed"], None), (None, {"speed": 1.0})], ids=["output", "start value"]
)
def test_an_unknown_variable_of_an_fmu_is_named_beside_the_known(
    van_der_pol_fmu: Path, arguments: tuple[Any, Any]
) -> None:
    with pytest.raises(ValueError, match=r"no variable speed; it has mu, .*x, v"):
        Fmu(van_der_pol_fmu, *arguments)


def unpacked(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.is_dir()]


def test_closing_an_fmu_removes_what_was_unpacked(
    van_der_pol_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fmu = Fmu(van_der_pol_fmu, ["x"])
    assert len(unpacked(tmp_path)) == 1
    run(fmu, 20, DT)
    fmu.close()
    fmu.close()
    assert not unpacked(tmp_path)
    with pytest.raises(ValueError, match="has been closed"):
        run(fmu, 20, DT)
    with pytest.raises(ValueError, match="no variable"):
        Fmu(van_der_pol_fmu, ["speed"])
    assert not unpacked(tmp_path)


_LEFT_OPEN = """
import multiprocessing
import os
import sys
from splitband.simulators import Fmu, run


def use():
    run(Fmu(sys.argv[1], ["x"]), 20, 0.1)
    global kept
    kept = Fmu(sys.argv[1], ["x"])


use()
worker = multiprocessing.get_context("fork").Process(target=use)
worker.start()
worker.join()
assert worker.exitcode == 0
assert os.path.isdir(kept._unit.folder)  # which the worker process has not removed
raise KeyboardInterrupt
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
def test_nothing_that_an_fmu_unpacked_is_left_after_the_process(
    van_der_pol_fmu: Path, tmp_path: Path
) -> None:
    """Not closed, forgotten or kept, in a worker process, and after Ctrl-C."""
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _LEFT_OPEN, van_der_pol_fmu],
        capture_output=True, text=True, check=False, timeout=120,
        env=os.environ | {"OMP_NUM_THREADS": "1", "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert found.stderr.endswith("KeyboardInterrupt\n"), found.stderr
    assert not [*tmp_path.iterdir()]


def test_an_fmu_that_is_absent_or_damaged_is_named_and_leaves_nothing_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"no such FMU.*none\.fmu"):
        Fmu(tmp_path / "none.fmu")
    (tmp_path / "bad.fmu").write_bytes(b"PK not a zip file")
    with pytest.raises(ValueError, match=r"bad\.fmu is not an FMU that can be run here"):
        Fmu(tmp_path / "bad.fmu")
    assert not unpacked(tmp_path)


def test_an_fmu_that_stops_early_is_refused(van_der_pol_fmu: Path) -> None:
    with (
        Fmu(van_der_pol_fmu, ["x"], {"stop_at": 2.0}) as fmu,
        pytest.raises(ValueError, match="Fmu"),
    ):
        run(fmu, SAMPLES, DT)


_FAILING = """
import sys
from splitband.simulators import Fmu, run

with Fmu(sys.argv[1], ["x"], {"raise_at": 1.0}) as fmu:
    try:
        run(fmu, 20, 0.1)
    except ValueError as error:
        print(error)
print("alive")
"""


def test_an_fmu_that_raises_does_not_take_the_process_with_it(
    van_der_pol_fmu: Path,
) -> None:
    found = subprocess.run(
        [sys.executable, "-c", _FAILING, van_der_pol_fmu],
        capture_output=True, text=True, check=False, timeout=600,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    raised, alive = found.stdout.splitlines()
    assert "DoStep failed" in raised
    assert (alive, found.returncode) == ("alive", 0)
