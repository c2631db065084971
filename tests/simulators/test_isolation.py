"""A user's own simulator may hang, crash or end its process, and this one goes on."""

from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitband.runtime.workers import result_of
from splitband.simulators import run
from splitband.simulators.isolation import Isolated
from tests.runtime.test_workers import alive, eventually

FUNCTIONS = """
import ctypes
import os
import threading
import time as clock

import helper


def good(time):
    print("a simulator may print")
    return helper.FACTOR * time


def crashing(time):
    ctypes.string_at(0)


def exiting(time):
    os._exit(3)


def raising(time):
    raise LookupError("no such\\nparameter")


def leaving_threads(time):
    threading.Thread(target=clock.sleep, args=(600,)).start()
    return time
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("simulators")
    (folder / "helper.py").write_text("FACTOR = 2.0\n")
    (folder / "mine.py").write_text(FUNCTIONS)
    return str(folder / "mine.py")


def test_a_function_finds_the_modules_beside_it_and_none_in_the_working_directory(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('taken')\n")
    monkeypatch.chdir(tmp_path)
    found = run(Isolated(file, "good"), 5, 0.5)
    np.testing.assert_array_equal(found[:, 0], 2.0 * 0.5 * np.arange(5))


def test_a_process_that_ends_before_it_is_known_to_have_begun_is_said_to_have_ended(
    file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = result_of

    def of_a_broken_pool(future: Any, seconds: float | None = None) -> Any:
        if seconds is None:  # who leads its processes
            return results(future)
        raise BrokenProcessPool("All workers expired")

    monkeypatch.setattr("splitband.simulators.isolation.result_of", of_a_broken_pool)
    with pytest.raises(ValueError, match=r"failed on 7 samples .*: it ended its process$"):
        run(Isolated(file, "exiting", timeout=60.0), 7, 0.1)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        # On a busy machine the pool may not know how it ended.
        ("crashing", r"ended its process( \(signal 11\))?$"),
        ("exiting", r"ended its process( \(exit status 3\))?$"),
        ("raising", "LookupError: no such parameter"),
        ("absent", "must define a function absent"),
    ],
)
def test_what_goes_wrong_is_named_with_the_simulator(
    file: str, function: str, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ValueError, match=rf"simulator torque failed on 7 samples .*{said}"):
        run(Isolated(file, function), 7, 0.1, name="torque")
    assert "Traceback" not in capfd.readouterr().err


def test_what_hangs_is_ended_with_all_that_it_has_started(file: str, tmp_path: Path) -> None:
    """Even what keeps the interpreter to itself."""
    mark = tmp_path / "pids"
    source = Path(file).with_name("starting.py")
    source.write_text(
        "import ctypes, os, subprocess\n\n\ndef starting(time):\n"
        "    child = subprocess.Popen(['sleep', '600'])\n"
        f"    open({str(mark)!r}, 'w').write(f'{{os.getpid()}} {{child.pid}}')\n"
        "    ctypes.PyDLL(None).sleep(600)\n"
    )
    with pytest.raises(ValueError, match=r"simulator torque has not returned within 1 s"):
        run(Isolated(str(source), "starting", timeout=1.0), 5, 0.1, name="torque")
    for pid in map(int, mark.read_text().split()):
        eventually(lambda pid=pid: not alive(pid))  # type: ignore[misc]


def test_threads_that_it_leaves_running_keep_nobody_waiting(file: str) -> None:
    assert len(run(Isolated(file, "leaving_threads"), 5, 0.5)) == 5


@pytest.mark.parametrize("name", ["metrics", "models", "data", "filters", "simulators"])
def test_a_users_module_may_have_the_name_of_one_of_ours(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.py").write_text("FACTOR = 3.0\n")
    rig = tmp_path / "rig.py"
    rig.write_text(f"from {name} import FACTOR\ndef good(time):\n    return FACTOR * time\n")
    found = run(Isolated(str(rig), "good", timeout=60.0), 5, 1.0)
    np.testing.assert_array_equal(found[:, 0], 3.0 * np.arange(5))
