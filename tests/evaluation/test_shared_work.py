"""What processes share: calibrations are fitted once, and thread counts are left as they were."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import threadpoolctl
import torch

import splitband.forecasters.simulation
from splitband import Record, Settings
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.plan import Plan
from splitband.evaluation.setup import Setup
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.caching import Cached
from splitband.forecasters.names import Sizes
from splitband.report.pictures import rollouts
from splitband.runtime.processes import map_jobs
from splitband.simulators.calibration import Calibration
from tests.support import compare, settled, try_out

DT, TRAIN, LENGTH = 0.1, 120, 200
TIME = DT * np.arange(LENGTH)[:, None]
SIMULATED = np.sin(2 * np.pi * 0.2 * TIME) + 0.4 * np.sin(2 * np.pi * 1.13 * TIME)
NOISE = 0.05 * np.random.default_rng(0).standard_normal((LENGTH, 1))
RECORD = Record(2 * SIMULATED + 1 + NOISE, DT, y_sim=SIMULATED)
SETUP = Setup(
    TRAIN, Settings(40, 10, 1, 16), bands=Bands(0.6, 1, 2), sizes=Sizes(hidden_high=4, hidden_low=3)
)
CALIBRATED = ["residual-gru-calibrated", "filtered-gru-calibrated", "simulator-calibrated"]


# ---------------------------------------------------------------- calibrations


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The training samples of each calibration that is fitted."""
    found: list[int] = []

    def counted(y_sim: object, y: np.ndarray, *others: object) -> Calibration:
        found.append(len(y))
        return Calibration(gain=(2.0,), offset=(1.0,))  # the right one

    remembered = Cached(counted)
    monkeypatch.setattr("splitband.forecasters.simulation.CALIBRATIONS", remembered)
    monkeypatch.setattr("splitband.evaluation.jobs.CACHES", (remembered,))
    return found


def test_a_calibration_is_fitted_once_for_all_methods_and_seeds(fitted: list[int]) -> None:
    try_out(RECORD, CALIBRATED, SETUP, seeds=(0, 1))
    assert sorted(fitted) == [60, 75, 90, 96, 102, 108]
    runs = compare(RECORD, CALIBRATED, SETUP, seeds=(0, 1))
    assert fitted[6:] == [TRAIN]
    said = [run.description.removeprefix("simulator: ") for r in runs.values() for run in r]
    assert all(each.startswith("gain 2; offset 1") for each in said)


def test_other_processes_are_sent_what_is_fitted(
    fitted: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would say so: it is not the counted function that they would call."""

    def sent(work: Callable[..., object], jobs: object, *_: object) -> list[object]:
        learned = splitband.forecasters.simulation.CALIBRATIONS.results
        splitband.forecasters.simulation.CALIBRATIONS.results = {}  # as in a new process
        assert len(learned) == 1
        return [work(job, lambda _: None) for job in jobs]  # type: ignore[attr-defined]

    monkeypatch.setattr("splitband.evaluation.jobs.map_jobs", sent)
    compare(RECORD, CALIBRATED, SETUP)
    assert fitted == [TRAIN]


def test_remembered_results_differ_where_any_argument_does() -> None:
    calls: list[int] = []

    def summed(x: np.ndarray, *others: float) -> float:
        calls.append(1)
        return float(x.sum()) + sum(others)

    remembered, x = Cached(summed, most=3), np.arange(4.0)
    for arguments in ((x,), (x, 1.0), (x[:3],)):
        assert remembered(*arguments) == remembered(*arguments) == summed(*arguments)
    assert len(calls) == 6
    remembered(x.reshape(2, 2))  # in place of the oldest
    assert len(remembered.results) == 3
    remembered(x)
    assert len(calls) == 8


# ---------------------------------------------------------------- threads


def blas() -> list[int]:
    return [pool["num_threads"] for pool in threadpoolctl.threadpool_info()
            if pool["user_api"] == "blas"]  # fmt: skip


def seen(_: int, report: Callable[[object], None]) -> tuple[int, list[int]]:
    return torch.get_num_threads(), blas()


def test_blas_and_torch_have_their_threads_again_afterwards() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    torchs = torch.get_num_threads()
    with threadpoolctl.threadpool_limits(3, user_api="blas"):
        torch.set_num_threads(2)
        before = 2, blas()
        inside = [*map_jobs(seen, [0, 1])]
        after = torch.get_num_threads(), blas()
    torch.set_num_threads(torchs)
    assert after == before
    assert inside == [(1, [1] * len(before[1]))] * 2


def test_they_have_them_after_a_failure_and_between_results_too() -> None:
    def failing(job: int, report: Callable[[object], None]) -> int:
        if job:
            raise ValueError("no")
        return job

    before = torch.get_num_threads(), blas()
    results = map_jobs(failing, [0, 1])
    next(results)
    assert (torch.get_num_threads(), blas()) == before
    with pytest.raises(ValueError, match="no"):
        next(results)
    assert (torch.get_num_threads(), blas()) == before


# ---------------------------------------------------------------- settings of one method


def test_a_method_with_settings_of_its_own_warms_up_as_they_say(tmp_path: Path) -> None:
    other = Settings(44, 14, 1, 16)
    otherwise = replace(SETUP, settings=other)
    methods: list[Forecaster | str] = [
        *(otherwise.forecaster(name) for name in ("rnn", "filtered-rnn")),
        "gru",
    ]
    trial = try_out(RECORD, methods, SETUP)
    runs = compare(RECORD, methods, SETUP)
    assert (trial.failed, runs.failed) == ({}, {})
    alone = compare(RECORD, methods, otherwise)
    for name, begin in (("rnn", 14), ("filtered-rnn", 14), ("gru", 10)):
        assert len(runs[name][0].from_start) == LENGTH - begin
        assert len(runs[name][0].ahead) == LENGTH - TRAIN
        if begin == 14:
            np.testing.assert_allclose(
                runs[name][0].ahead, alone[name][0].ahead, rtol=1e-5, atol=1e-6
            )
    comparison = Comparison(Plan.of(RECORD, (), SETUP), runs, settled(trial, runs))
    rollouts(comparison).canvas.draw()
