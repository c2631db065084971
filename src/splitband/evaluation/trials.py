"""Try the candidates of a search on the held-out end of the training record, round by round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from splitband.data import Record
from splitband.evaluation.budget import ONE
from splitband.evaluation.candidates import SHORT, Candidate, combined
from splitband.evaluation.costs import training_cost
from splitband.evaluation.jobs import failed_seeds, run_all
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import (
    HELD_OUT,
    Backtest,
    Question,
    check_held_out,
    for_trial,
    held_out_errors,
    held_out_origins,
    mean_forecasts,
    root_mean_square,
)
from splitband.forecasters.network import Network
from splitband.metrics import spread

SEARCHED = 0.55
"""Share of the budget for the search."""
TRIAL_SEEDS, CORE_SECONDS_A_SEED = 2, 120.0
"""Seeds of each candidate, whose mean is scored; on records of up to `SHORT` samples one for so
much of the budget, where that is more, and at most `MOST_MEMBERS`."""
MOST_MEMBERS = 8
"""Trainings whose mean is handed out, at most."""
KEPT = 0.5
"""Share of the candidates of a round that go on."""
WORSE = 1.1
"""A candidate whose error is above this multiple of what it was a round before does not go on."""
MAX_ERROR_RATIO = 2.0
"""A candidate does not go on if its error is above this multiple of the lowest of all."""
LONGER = 4
"""By how much the best candidate's last training may be longer than any trial was, where longer
trials were better and only the budget ended them."""
LAST = 0.7
"""Share of what is left of the budget that this may take."""
SETTLING = 0.25
"""Share of its iterations that a training gets on top of them when further samples are added."""


@dataclass(frozen=True)
class SearchAttempt:
    """Say what became of a candidate on the held-out samples.

    Attributes
    ----------
    method, training : Which it is.
    seeds : How many could be trained.
    score : RMSE, of channels scaled to a deviation of 1; None where it could not be trained.
    """

    method: str
    training: str
    seeds: int
    score: float | None


@dataclass(frozen=True, eq=False)
class TrialRun:
    """Hold one seed of a candidate: its forecasts of the held-out samples, and their RMSE."""

    candidate: Candidate
    seed: int
    done: Backtest
    score: float

    @property
    def key(self) -> tuple[str, int]:
        """Return what it has in common with the same training after other rounds."""
        return self.candidate.began_as or self.candidate.label, self.seed


class Trials:
    """Try candidates on the held-out end of a training record.

    `attempts` are in their order; `tried` those that could be trained, and `runs` all of their
    seeds; `spent` are seconds of a reference core.
    """

    def __init__(
        self, record: Record, steps: int, work: Work, others: Sequence[Record], budget: float
    ) -> None:
        """Begin with a record from which `steps` samples are to be forecast after all."""
        self._record, self._end = replace(record, y_true=None), len(record) + steps
        self._work, self._others, self._most = work, others, SEARCHED * budget
        alone = work.time.work_of_one(work.time.share(ONE))
        self._longest = min(alone, ONE * budget)
        paid = round(budget / CORE_SECONDS_A_SEED) if len(record) <= SHORT else 0
        self._seeds = range(min(max(TRIAL_SEEDS, paid), MOST_MEMBERS))
        self._rounds = 0
        self.attempts: list[SearchAttempt] = []
        self.tried: list[Candidate] = []
        self.runs: list[TrialRun] = []
        self.spent = 0.0

    def cost(self, candidate: Candidate) -> float:
        """Return the seconds of a reference core for all seeds of a trial."""
        whole = training_cost(candidate.network, self._record, self._others)
        return len(self._seeds) * (1 - HELD_OUT) * whole

    def run(self, candidates: Sequence[Candidate], share: float) -> list[Candidate]:
        """Train those that this share of the budget pays for, in their order; return them scored.

        What its deadline ends is scored with what it has come to.
        """
        affordable, cost = self._affordable(candidates, share)
        if not affordable:
            return []
        record, samples = self._record, len(self._record)
        networks = [
            for_trial(c.network, samples).clone().set_params(name=c.label) for c in affordable
        ]
        questions = {
            each.name: Question(record, held_out_origins(each, record), self._end, self._others)
            for each in networks
        }
        first, last = self._work.span
        shares = [min(spent / self._most, 1.0) for spent in (self.spent, self.spent + cost)]
        self._rounds, self.spent = self._rounds + 1, self.spent + cost
        before, after = (first + each * (last - first) for each in shares)
        work = self._work.for_stage(f"search {self._rounds}", span=(before, after))
        results, _ = run_all(networks, questions, self._seeds, work, need_one=False)
        return [self._scored(c, results[c.label]) for c in affordable]

    def _affordable(
        self, candidates: Sequence[Candidate], share: float
    ) -> tuple[list[Candidate], float]:
        """Return the candidates that can be paid for, and what they cost together."""
        time, left = self._work.time, share * self._most - self.spent
        if (in_time := time.work_until(self._work.deadline)) < left:
            if in_time < sum(map(self.cost, candidates)):
                time.narrowed("the search")
            left = in_time
        affordable, total = [], 0.0
        for candidate in candidates:
            cost = self.cost(candidate)
            if cost <= left and cost / len(self._seeds) <= self._longest:
                affordable.append(candidate)
                left, total = left - cost, total + cost
        return affordable, total

    def _scored(self, candidate: Candidate, done: dict[int, Backtest]) -> Candidate:
        failed = failed_seeds({seed: each.report for seed, each in done.items()})
        done = {seed: each for seed, each in done.items() if seed not in failed}
        score = held_out_score(self._record, [*done.values()]) if done else math.inf
        training, said = candidate.network.training_in_words(), score if done else None
        self.attempts.append(SearchAttempt(candidate.method, training, len(done), said))
        scored = replace(candidate, score=score, done=done)
        if done:
            self.tried.append(scored)
        for seed, each in done.items():
            self.runs.append(TrialRun(scored, seed, each, held_out_score(self._record, [each])))
        worse = not done or score > WORSE * candidate.score
        return replace(scored, rung=-1) if worse else scored

    def promoted(self, last: Sequence[Candidate]) -> list[Candidate]:
        """Return those that go on: the better ones of a round, the best one first."""
        able = sorted([c for c in last if c.done], key=lambda c: c.score)
        able = able[: math.ceil(KEPT * len(able))]
        return [c for c in able if c.rung >= 0 and self._competes(c)]

    def promising(self, method: str) -> bool:
        """Return whether a method deserves more than one candidate."""
        tried = [c for c in self.tried if c.method == method]
        return not tried or any(map(self._competes, tried))

    def _competes(self, candidate: Candidate) -> bool:
        return candidate.score <= MAX_ERROR_RATIO * min(c.score for c in self.tried)

    def combinations(self, first: Candidate) -> list[Candidate]:
        """Return the best candidate of a method together with what else was better than the first.

        It is for networks that begin as a linear model, whose candidates differ from the first one
        in size, window or penalty, or begin from random weights.
        """
        tried = {c.label: c for c in self.tried if c.method == first.method}
        usual = tried.get(first.label)
        if usual is None:
            return []
        better = [c for c in tried.values() if c.score < usual.score]
        best, *others = sorted(better, key=lambda c: c.score) or [usual]
        found = (combined(usual, best, other) for other in others)
        return [c for c in found if c is not None]

    def best(self, method: str) -> list[TrialRun]:
        """Return the trainings of a method whose mean is handed out, the best one first.

        They are as many of the best ones, whatever their settings, as have the mean with the lowest
        held-out error (`benchmarks.members`). Of the same training after several rounds it is the
        better one.
        """
        distinct: dict[tuple[str, int], TrialRun] = {}
        for run in sorted(self.runs, key=lambda run: run.score):
            if run.candidate.method == method:
                distinct.setdefault(run.key, run)
        ranked = [*distinct.values()][:MOST_MEMBERS]
        means = [ranked[: i + 1] for i in range(len(ranked))]
        return min(
            means, key=lambda runs: held_out_score(self._record, [r.done for r in runs]), default=[]
        )

    def last(self, runs: Sequence[TrialRun], left: float) -> list[Network]:
        """Return a network for each last training, which goes on from the trial.

        Where longer trials were better, and the budget alone has ended them, those of the best
        candidate are longer.
        """
        best = runs[0].candidate.label
        newest = max(self.tried, key=lambda candidate: candidate.trained)
        networks = []
        for seed, run in enumerate(runs):
            candidate, weights = run.candidate, {seed: run.done.weights}
            if not candidate.trained:
                networks.append(candidate.network)
                continue
            more = max(round(SETTLING * candidate.trained), 1)
            if candidate.label == best == newest.label and candidate.rung >= 0:
                each = training_cost(candidate.going_on(1, weights), self._record, self._others)
                alike = sum(other.candidate.label == best for other in runs)
                pays = int(LAST * left / (alike * max(each, 1e-9)))
                more = max(more, min((LONGER - 1) * candidate.trained, pays))
            networks.append(candidate.going_on(more, weights))
        return networks


def held_out_score(record: Record, done: Sequence[Backtest]) -> float:
    """Return the RMSE of the seeds' mean forecasts of a record's last quarter, channels scaled."""
    check_held_out(record)
    errors, scale = held_out_errors(record, mean_forecasts(done)), spread(record.seen)
    return root_mean_square([error / scale for error in errors])
