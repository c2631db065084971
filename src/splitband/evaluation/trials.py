"""Try the candidates of a search on the held-out end of the training record, round by round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from splitband.data import Record
from splitband.evaluation.budget import MOST_FOR_ONE_TRAINING
from splitband.evaluation.candidates import SHORT, Candidate, combined
from splitband.evaluation.costs import training_cost
from splitband.evaluation.jobs import failed_seeds, run_all
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import (
    HELD_OUT_SHARE,
    Backtest,
    Question,
    check_held_out,
    for_trial,
    held_out_errors,
    held_out_origins,
    median_forecasts,
    root_mean_square,
)
from splitband.forecasters.network import Network
from splitband.metrics import spread

SEARCH_SHARE_OF_WORK = 0.55
"""Share of the work of a comparison that its search may take."""
TRIAL_SEEDS, CORE_SECONDS_A_SEED = 2, 120.0
"""Each candidate gets `TRIAL_SEEDS` seeds, whose median is scored; on records of up to `SHORT`
samples one per `CORE_SECONDS_A_SEED` of the work, if that is more, and at most `MOST_MEMBERS`."""
MOST_MEMBERS = 8
"""Largest number of trainings whose median is handed out."""
LEAST_MEMBERS = 3
"""Smallest number of them on records of up to `SHORT` samples: the median of fewer is their mean,
which one of them can spoil. On longer ones, held-out errors tell which training is best."""
KEPT = 0.5
"""Share of the candidates of a round that go on."""
MOST_OF_OWN_PREVIOUS = 1.1
"""A candidate does not go on if its error is above this multiple of that of its round before."""
MOST_OF_BEST = 2.0
"""A candidate does not go on if its error is above this multiple of the lowest of all."""
MOST_TIMES_LONGER = 4
"""If errors still fell when the budget ran out, final trainings may have this many times the
iterations of the longest trial."""
LONGER_TRAININGS_SHARE = 0.7
"""Share of the work left after the search that these longer final trainings may take."""
SETTLING = 0.25
"""Additional iterations of a training that continues on all samples, as a share of those before."""


@dataclass(frozen=True)
class SearchAttempt:
    """Hold the score of a candidate on the held-out samples.

    Attributes
    ----------
    method, training : Name of the method, and its training in words.
    seeds : Number of seeds that could be trained.
    score : RMSE, of channels scaled to a standard deviation of 1; None if no seed could be trained.
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
        """Return the key by which all rounds of one candidate and seed count as one training."""
        return self.candidate.first_label or self.candidate.label, self.seed


class Trials:
    """Try candidates on the held-out end of a training record.

    `attempts` are in order. `tried` has one entry per candidate and round that could be trained,
    `runs` one per seed of these. `spent` is the cost so far, in seconds of a reference core.
    """

    def __init__(
        self, record: Record, steps: int, work: Work, others: Sequence[Record], budget: float
    ) -> None:
        """Prepare trials on a record that is to be forecast for `steps` samples in the end."""
        self._record, self._end = replace(record, y_true=None), len(record) + steps
        self._work, self._others, self._most = work, others, SEARCH_SHARE_OF_WORK * budget
        # The most work that one training may take, by the time limit and by the limit of work.
        in_time = work.time.work_of_one(work.time.share(MOST_FOR_ONE_TRAINING))
        self._most_for_one = min(in_time, MOST_FOR_ONE_TRAINING * budget)
        by_work = round(budget / CORE_SECONDS_A_SEED) if len(record) <= SHORT else 0
        self._seeds = range(min(max(TRIAL_SEEDS, by_work), MOST_MEMBERS))
        self._rounds = 0
        self.attempts: list[SearchAttempt] = []
        self.tried: list[Candidate] = []
        self.runs: list[TrialRun] = []
        self.spent = 0.0

    def cost(self, candidate: Candidate) -> float:
        """Return the cost of a trial with all seeds, in seconds of a reference core."""
        whole = training_cost(candidate.network, self._record, self._others)
        return len(self._seeds) * (1 - HELD_OUT_SHARE) * whole

    def run(self, candidates: Sequence[Candidate], share: float) -> list[Candidate]:
        """Train candidates until a share of the search budget is used, and return them scored.

        The share includes what the search has spent so far. Candidates that are too expensive are
        left out, and cheaper ones after them are trained. A training that the deadline ends is
        scored with the weights that it has then.
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
        """Return the affordable candidates and their total cost."""
        time, left = self._work.time, share * self._most - self.spent
        if (in_time := time.work_until(self._work.deadline)) < left:
            if in_time < sum(map(self.cost, candidates)):
                time.narrowed("the search")
            left = in_time
        affordable, total = [], 0.0
        for candidate in candidates:
            cost = self.cost(candidate)
            if cost <= left and cost / len(self._seeds) <= self._most_for_one:
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
        worse = not done or score > MOST_OF_OWN_PREVIOUS * candidate.score
        return replace(scored, rung=-1) if worse else scored

    def promoted(self, last: Sequence[Candidate]) -> list[Candidate]:
        """Return the candidates that go on, the better ones of a round, best first."""
        able = sorted([c for c in last if c.done], key=lambda c: c.score)
        able = able[: math.ceil(KEPT * len(able))]
        return [c for c in able if c.rung >= 0 and self._competes(c)]

    def promising(self, method: str) -> bool:
        """Return whether a method deserves more than one candidate."""
        tried = [c for c in self.tried if c.method == method]
        return not tried or any(map(self._competes, tried))

    def _competes(self, candidate: Candidate) -> bool:
        return candidate.score <= MOST_OF_BEST * min(c.score for c in self.tried)

    def combinations(self, first: Candidate) -> list[Candidate]:
        """Combine the best candidate of a method with each other one that beat the first.

        This is for networks that begin as a linear model, whose candidates differ from the first
        one in size, window or penalty, or begin from random weights.
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
        """Return the trainings of a method whose median is handed out, the best one first.

        These are the n best trainings, whatever their settings, where n gives the median with the
        lowest held-out error; on short records at least three (`benchmarks.members`). A training of
        several rounds counts once, with its best round.
        """
        distinct: dict[tuple[str, int], TrialRun] = {}
        for run in sorted(self.runs, key=lambda run: run.score):
            if run.candidate.method == method:
                distinct.setdefault(run.key, run)
        ranked = [*distinct.values()][:MOST_MEMBERS]
        least = LEAST_MEMBERS if len(self._record) <= SHORT else 1
        medians = [ranked[:n] for n in range(min(least, len(ranked)), len(ranked) + 1) if n]
        return min(
            medians,
            key=lambda runs: held_out_score(self._record, [r.done for r in runs]),
            default=[],
        )

    def final(self, runs: Sequence[TrialRun], left: float) -> list[Network]:
        """Return a network for each final training, which continues from the trial's weights.

        Trainings without L-BFGS start anew. If errors still fell when the budget ran out, those of
        the best candidate are longer, as far as the work `left` allows, and on long records those
        of all candidates with as many iterations, as a median is no better than most of its
        members.
        """
        newest = max(self.tried, key=lambda candidate: candidate.iterations)
        long = len(self._record) > SHORT
        costs = {
            place: training_cost(
                run.candidate.continued(1, {place: run.done.weights}), self._record, self._others
            )
            for place, run in enumerate(runs)
            if run.candidate.rung >= 0 and run.candidate.iterations == newest.iterations
            if long or run.candidate.label == newest.label
        }
        paid = int(LONGER_TRAININGS_SHARE * left / max(sum(costs.values()), 1e-9))
        networks = []
        for place, run in enumerate(runs):  # the place is the seed of the final training
            candidate, weights = run.candidate, {place: run.done.weights}
            if not candidate.iterations:
                networks.append(candidate.network.clone())  # one for each seed
                continue
            more = max(round(SETTLING * candidate.iterations), 1)
            if 0 in costs and place in costs:
                more = max(more, min((MOST_TIMES_LONGER - 1) * candidate.iterations, paid))
            networks.append(candidate.continued(more, weights))
        return networks


def held_out_score(record: Record, done: Sequence[Backtest]) -> float:
    """Return the RMSE of the seeds' median forecast of a record's last quarter, channels scaled."""
    check_held_out(record)
    errors, scale = held_out_errors(record, median_forecasts(done)), spread(record.seen)
    return root_mean_square([error / scale for error in errors])
