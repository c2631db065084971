"""The search asks for jobs round by round, and is told their fits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from typing import Any

import pytest

from splitband import TrainingSettings
from splitband.comparison.backtest import Fit
from splitband.comparison.candidates import FINAL_SHARE, FIRST_ROUND
from splitband.comparison.jobs import Job
from splitband.comparison.methods import Sizes
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.comparison.search import SEEDS, Search
from splitband.forecasters.fitted import FitReport, Fitted
from splitband.forecasters.prediction import Prediction
from tests.signals import QUICK, TRAIN, record

RECORD = record(nu=1)
Error = Callable[[Job, int], float]
"""Gives the held-out error of a job, which is the n-th of its training."""


class Trainer:
    """Stands in for training: the forecasts of each job have a given error.

    `done` counts the rounds of the training that a model has had, by its identity.
    """

    def __init__(self, error: Error, seconds: float = 1.0) -> None:
        self.error, self.seconds = error, seconds
        self.done: dict[int, int] = {}
        self.models: list[object] = []
        self.rounds: list[list[Job]] = []

    def fit(self, job: Job) -> Fit:
        rounds = 1 + self.done.get(id(job.start), 0)
        model = job.forecaster.clone()
        settings = model.settings
        assert settings is not None
        model._trained_by = settings  # type: ignore[attr-defined]
        losses = [1.0] * (settings.epochs + settings.rounds)
        model.fitted = replace(
            Fitted.of([RECORD], job.seed),
            report=FitReport(seconds=0.9 * self.seconds, losses={"network": losses}),
        )
        self.models.append(model)  # so that no identity is used again
        self.done[id(model)] = rounds
        error, whole = self.error(job, rounds), job.spec.record
        forecasts = {
            at: Prediction(
                whole.y_with_gaps[at.at :] + error,
                replace(whole.grid, samples=len(whole) - at.at),
                ("y",),
            )
            for at in job.spec.origins
        }
        return Fit(job.method, job.seed, model, forecasts, seconds=self.seconds)

    def run(self, search: Search, most: int = 100, left: float = math.inf) -> None:
        while search.round < most and (jobs := search.ask(left)):
            self.rounds.append(jobs)
            search.tell([self.fit(job) for job in jobs])


def searching(methods: list[str], cores: int = 1, **options: object) -> Search:
    settings = {"warmup": 10}
    found = plan(PlanRequest(RECORD, TRAIN, methods, settings=settings, rounds=9, **options))  # type: ignore[arg-type]
    return Search(found, cores)


def settings_of(job: Job) -> TrainingSettings:
    settings = job.forecaster.settings
    assert settings is not None
    return settings


def test_every_method_has_a_round_before_any_has_two() -> None:
    search, trainer = searching(["state-space", "gru", "linear"]), Trainer(lambda job, n: 1 / n)
    trainer.run(search, 1)
    (first,) = trainer.rounds
    assert [job.method for job in first] == ["state-space", "gru"]
    assert all(job.start is None for job in first)
    assert {settings_of(job).lbfgs_iterations for job in first} == {FIRST_ROUND}


def test_the_better_half_goes_on_from_its_weights_for_four_times_as_long() -> None:
    search = searching(["state-space"])
    trainer = Trainer(lambda job, n: (1 + settings_of(job).window / 1000) * 0.5**n)
    trainer.run(search, 5)
    going_on = [jobs for jobs in trainer.rounds if jobs[0].start is not None]
    before = sum(len(jobs) for jobs in trainer.rounds if jobs[0].start is None)
    for number, jobs in enumerate(going_on):
        assert len(jobs) == math.ceil(before / 2)
        before = len(jobs)
        trained = FIRST_ROUND * 5**number  # by all rounds so far
        assert {settings_of(job).lbfgs_iterations for job in jobs} == {4 * trained}
        assert all(settings_of(job).epochs == 0 for job in jobs)
        assert all(trainer.done[id(job.start)] == number + 1 for job in jobs)
    assert len(going_on) >= 2


def test_as_many_go_on_as_keep_all_cores_busy() -> None:
    search, trainer = searching(["state-space"], cores=4), Trainer(lambda job, n: 0.5**n)
    trainer.run(search, 6)
    going_on = [len(jobs) for jobs in trainer.rounds if jobs[0].start is not None]
    assert going_on[-1] == 4


def test_cores_that_would_wait_for_the_last_candidate_begin_with_other_seeds() -> None:
    """Only the training with the longest window goes on improving, for five rounds."""
    longest = max(settings_of(job).window for job in _firsts(searching(["gru"])))

    def error(job: Job, done: int) -> float:
        only = settings_of(job).window == longest and job.seed == 0
        return 0.5 ** min(done, 5) if only else 1.0

    least = {}
    for cores in (1, 3):
        search, trainer = searching(["gru"], cores), Trainer(error)
        trainer.run(search)
        assert search.converged
        rounds = [jobs for jobs in trainer.rounds if any(error(job, 5) < 1 for job in jobs)]
        least[cores] = min(len(jobs) for jobs in rounds[2:])
    assert least[1] == 1
    assert least[3] >= 3


def test_what_does_not_improve_stops_and_other_seeds_follow_until_all_is_settled() -> None:
    search, trainer = searching(["gru"]), Trainer(lambda job, n: 1.0 - 0.001 * n)
    trainer.run(search)
    started = [job.start for jobs in trainer.rounds for job in jobs if job.start is not None]
    assert all(trainer.done[id(start)] == 1 for start in started)
    seeds = [{job.seed for job in jobs} for jobs in trainer.rounds if jobs[0].start is None]
    assert seeds[-1] == {SEEDS - 1}
    assert search.converged
    assert search.ask() == []


def test_what_was_left_behind_goes_on_when_all_seeds_are_done() -> None:
    """The worst training after one round is the best one after three."""
    search = searching(["gru"])
    longest = max(settings_of(job).window for job in _firsts(searching(["gru"])))

    def error(job: Job, n: int) -> float:
        return 1.5 * 0.5 ** min(n - 1, 2) if settings_of(job).window == longest else 1.0

    Trainer(error).run(search)
    assert search.trials["gru"][0].fitted.settings.window == longest
    assert search.converged


def _firsts(search: Search) -> list[Job]:
    trainer = Trainer(lambda job, n: 1.0)
    trainer.run(search, 3)
    return [job for jobs in trainer.rounds for job in jobs]


def test_a_search_that_was_cut_is_not_settled() -> None:
    search, trainer = searching(["gru"]), Trainer(lambda job, n: 1.0)
    jobs = search.ask(10.0)
    search.tell([replace(trainer.fit(job), cut=True) for job in jobs])
    while jobs := search.ask(0.0):
        search.tell([job.late() for job in jobs])
        if search.round > 20:
            break
    assert not search.converged


def test_a_late_or_failed_training_is_left_out_and_said() -> None:
    search = searching(["state-space", "gru"])
    jobs = search.ask()
    late, diverged = jobs[0].late(), Fit("gru", failure="diverged")
    search.tell([late, diverged])
    assert not search.trials
    assert search.failed == {"state-space": late, "gru": diverged}
    assert [attempt.score for attempt in search.attempts] == [None]
    assert search.finals() == []
    Trainer(lambda job, n: 1.0).run(search, 2)  # other choices may do better
    assert {*search.trials} == {"state-space", "gru"}


def test_the_median_of_the_best_is_handed_out_and_goes_on_on_all_samples() -> None:
    search, signs = searching(["state-space", "gru"]), cycle([1, -1])  # errors that cancel
    trainer = Trainer(lambda job, n: next(signs) * (0.1 if job.method == "gru" else 0.5) / n)
    trainer.run(search, 4)
    assert next(iter(search.trials)) == "gru"
    jobs = search.finals()
    of_gru = [job for job in jobs if job.method == "gru"]
    assert len(of_gru) > 1
    assert len(jobs) == len(of_gru) + 1
    for job in jobs:
        assert job.start is not None
        trained = FIRST_ROUND * 5 ** (trainer.done[id(job.start)] - 1)
        assert settings_of(job).lbfgs_iterations == FINAL_SHARE * trained
        assert job.spec.origins[-1].fitted == TRAIN
    assert all(job.seconds > 0 for job in search.finals())


def test_settings_that_are_given_are_trained_once_as_they_are() -> None:
    found = plan(PlanRequest(RECORD, TRAIN, ["gru"], settings=QUICK, seeds=3))
    assert found.budget is None
    search, trainer = Search(found), Trainer(lambda job, n: 1 / n)
    trainer.run(search)
    (jobs,) = trainer.rounds
    assert [job.seed for job in jobs] == [0, 1, 2]
    assert all(settings_of(job).epochs == QUICK.epochs for job in jobs)
    assert [job.seed for job in search.finals()] == [0, 1, 2]
    assert all(job.start is None for job in search.finals())


def test_the_seed_of_a_comparison_is_that_of_its_trainings() -> None:
    search = searching(["gru"], seed=7)
    assert {job.seed for job in search.ask()} == {7 * SEEDS}


@pytest.mark.parametrize("short", [True, False])
def test_sizes_are_searched_unless_given(short: bool) -> None:
    options: dict[str, Any] = {} if short else {"sizes": Sizes(hidden_high=4, hidden_low=2)}
    search, trainer = searching(["gru"], **options), Trainer(lambda job, n: 1 / n)
    trainer.run(search, 2)
    sizes = {job.forecaster.cell.hidden_size for jobs in trainer.rounds for job in jobs}  # type: ignore[attr-defined]
    assert (len(sizes) > 1) == short
