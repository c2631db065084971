"""Commands whose trainings are done by the workers of a Dask scheduler, or end in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from splitband.cli.display import workers
from tests.cli.support import assert_fails, call, results

dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")

pytestmark = [
    pytest.mark.usefixtures("inside", "short_rounds"),
    pytest.mark.filterwarnings("default"),  # Dask has its own
]

COMPARE = "compare record.csv --columns a --methods gru,mean --hidden 3,4 --rounds 1 "


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler on this machine with two workers, each a process with one thread."""
    folder = str(tmp_path_factory.mktemp("dask"))
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        dask.config.set({"temporary-directory": folder}),
        distributed.LocalCluster(**options) as cluster,
    ):
        yield cluster.scheduler_address


def test_workers_find_the_numbers_of_this_machine(address: str, tmp_path: Path) -> None:
    call(f"{COMPARE} --jobs 1", tmp_path / "here")
    call(f"{COMPARE} --cluster {address}", tmp_path / "there")
    there, here = (results(tmp_path / name) for name in ("there", "here"))
    assert there["time"]["cores"] == 2
    assert there["recommended"] == here["recommended"]
    assert there["methods"].keys() == here["methods"].keys()
    for name, facts in here["methods"].items():
        for key in ("total_rmse", "forecast_rmse", "held_out_rmse", "score", "seeds"):
            assert there["methods"][name][key] == pytest.approx(facts[key], rel=1e-5)
    searched, expected = (pd.DataFrame(found["search"]) for found in (there, here))
    pd.testing.assert_frame_equal(searched, expected, rtol=1e-5)


def test_a_cluster_that_ends_before_the_command_is_told(address: str) -> None:
    """As Dask says it of a job that has ended four workers."""
    said = "--cluster must be there until the end: .* the workers are gone, got tcp://"
    with pytest.raises(ValueError, match=said), workers(None, address):
        raise distributed.KilledWorker("a job", None, 3)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense"])
def test_nobody_listening_is_one_line(
    address: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    client = distributed.Client
    soon = {"timeout": 0.5}
    monkeypatch.setattr(distributed, "Client", lambda *a, **given: client(*a, **given | soon))
    says = "--cluster must be the address of a Dask scheduler", f"got {address}"
    assert_fails(f"{COMPARE} --cluster {address} --out out", says, capsys)


def test_a_missing_extra_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    says = '--cluster needs Dask: pip install "splitband[cluster]"'
    assert_fails(f"{COMPARE} --cluster tcp://127.0.0.1:9", (says,), capsys)


def test_jobs_of_this_machine_and_a_cluster_exclude_each_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = f"{COMPARE} --jobs 2 --cluster tcp://127.0.0.1:9"
    assert_fails(line, ("--jobs must be left out with --cluster",), capsys)
