"""A job ends in time and says in one line why it failed; nobody waits for workers to load."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from splitband import Mean, Record
from splitband.comparison.backtest import BacktestSpec, Fit
from splitband.comparison.jobs import Job, Runner
from splitband.forecasters.base import Forecaster
from splitband.forecasters.held_out import Origin
from splitband.forecasters.prediction import ForecastContext
from splitband.runtime.deadlines import NEVER, Deadline
from tests.signals import LENGTH, SETUP, TRAIN, record
from tests.support import slowed


def job() -> Job:
    origins = [Origin(TRAIN, 12), Origin(TRAIN, TRAIN)]
    spec = BacktestSpec(record(), origins, tests=[record(seed=1)], warmup=12)
    return Job(SETUP.forecaster("filtered-gru"), spec)


def run(asked: Job, deadline: Deadline = NEVER) -> Fit:
    with Runner() as runner:
        runner.begin([asked], deadline)
        ((_, fit),) = runner.ended([asked])
        return fit


def test_a_job_that_its_deadline_ends_is_marked(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = slowed(monkeypatch, 1.0)
    assert run(job(), Deadline(clock.at + 3)).cut


def test_a_job_that_is_not_begun_in_time_says_so_unless_it_is_needed() -> None:
    over = Deadline(0.0)
    late = run(job(), over)
    assert late.cut
    assert "time was over" in late.failure
    needed = run(replace(job(), needed=True), over)
    assert needed.cut
    assert needed.model is not None


@pytest.mark.parametrize("origin", [(80, LENGTH + 1), (0, 50), (80, 0)])
def test_an_origin_is_inside_of_the_record(origin: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="origins must have fitted > 0 and 0 < at <= "):
        BacktestSpec(record(), [Origin(*origin)])


def test_a_model_from_a_worker_holds_the_record_and_no_copy_of_it() -> None:
    """Of a million samples, a copy for each training was most of the memory."""
    long = Record(np.arange(150_000.0), 0.1)
    spec = BacktestSpec(long, [Origin(140_000, 100), Origin(140_000, 140_000)])
    asked = Job(Mean(), spec)
    with Runner(2) as runner:
        runner.begin([asked], NEVER)
        ((_, fit),) = runner.ended([asked])
    fitted = fit.fitted.require_fitted()
    assert len(fitted.record) == 140_000
    assert np.shares_memory(fitted.record.y, long.y)
    assert fit.ahead.mean() == pytest.approx(long.y[:140_000].mean())


class Own(Forecaster):
    """A method of a user that fails, or not."""

    name = "own"
    random = True

    def __init__(self, error: type[Exception] | None = None) -> None:
        self.error = error

    def learn(self, records: object, **_: object) -> None:
        if self.error is not None:
            raise self.error("it is\nbroken")

    def extrapolate(self, known: ForecastContext) -> np.ndarray:
        return np.zeros((known.steps, known.y.shape[1]))


@pytest.mark.parametrize(
    ("error", "said"), [(ValueError, "it is broken"), (KeyError, "KeyError: 'it is\\nbroken'")]
)
def test_a_failure_is_one_line(error: type[Exception], said: str) -> None:
    assert run(replace(job(), forecaster=Own(error))).failure == said


def test_nobody_waits_for_workers_to_load_and_compile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done = Event()
    monkeypatch.setattr("splitband.comparison.jobs.compile_kernels", lambda *_: done.wait())
    with ThreadPoolExecutor(1) as executor:
        runner = Runner(2, executor)
        runner.start([SETUP.forecaster("gru")])
        assert runner.starting
        done.set()
    assert not runner.starting
