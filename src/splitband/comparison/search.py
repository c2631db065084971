"""Search how to train networks: successive halving, scored by forecasts of held-out samples.

Not in the paper. A candidate is a method with one choice of sizes, window, penalty, start and
seed. Each is trained for one round on the first three quarters of the training part, and forecasts
the rest of it. The better half goes on from its weights for four times as long, and so on (Jamieson
and Talwalkar, 2016). All methods get their first round before any gets another one. When no
candidate is left that further training improves, or fewer than there are cores, the better half of
the choices begins again with another seed; when all seeds are done, what was left behind goes on. A
search can be stopped after any round; the best candidates are then trained to the end, on all
samples of the training part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from splitband.comparison.backtest import WORTH_TRAINING, Fit, held_out_score
from splitband.comparison.candidates import (
    FINAL_SHARE,
    SHORT_RECORD,
    Candidate,
    candidates,
    combined,
)
from splitband.comparison.clock import MOST_OF_TIME_LEFT
from splitband.comparison.jobs import Job, held_out_job
from splitband.comparison.methods import built
from splitband.comparison.plan import Plan
from splitband.forecasters.base import Forecaster
from splitband.forecasters.held_out import HELD_OUT_SHARE
from splitband.forecasters.network import Network

SEEDS = 8
"""Seeds that each choice of settings is trained with at most, and trainings in a median at most."""
LEAST_MEMBERS = 3
"""Smallest number of trainings in the median on records of up to `SHORT_RECORD` samples: the median
of fewer is their mean, which one of them can spoil. On longer ones, held-out errors tell which
training is best (docs/developers/rules.md)."""
GIVEN_SEEDS = 3
"""Default number of trainings of a network whose settings are given."""


@dataclass(frozen=True)
class Attempt:
    """Hold the score of a candidate after a round."""

    round: int  # number of the round
    method: str  # its name
    training: str  # in words
    seed: int  # of the training
    score: float | None  # by which methods are ranked, of this training alone; None if it failed


class Search:
    """Search training settings by successive halving: `ask` returns jobs, `tell` takes their fits.

    Parameters
    ----------
    plan : Its methods are ready to be fitted. `plan.searched` names the networks whose settings are
        searched; others are trained in the first round only, as they are.
    cores : Trainings that run side by side.

    Attributes
    ----------
    round : Number of the last round that was asked for.
    attempts : All candidates after each of their rounds, in order.
    trials : Fits to three quarters of the training part by method, the best method first.
    failed : A fit without a model, of the methods that have no other one so far.
    converged : Whether further rounds would change nothing, and no deadline has cut a training.
    """

    def __init__(self, plan: Plan, cores: int = 1) -> None:
        plan = replace(plan, methods=tuple(built(method) for method in plan.methods))
        self._plan, self._cores = plan, cores
        self._record = plan.held_out
        self._choices: dict[str, list[Candidate]] = {}
        for method in plan.methods:
            if method.name in plan.searched and isinstance(method, Network):
                self._choose(method)
        self._given = [f for f in plan.methods if f.random and f.name not in self._choices]
        self._course = self._rounds()
        self._asked: list[Candidate] = []
        self._left = math.inf
        self._cut = False
        self._tried: list[Candidate] = []  # trained at least once
        # Of each method those whose median is its prediction, the best one first.
        self._members: dict[str, list[Candidate]] = {}
        self.round = 0
        self.attempts: list[Attempt] = []
        self.trials: dict[str, list[Fit]] = {}
        self.failed: dict[str, Fit] = {}
        self.converged = False

    def add(self, method: Forecaster) -> bool:
        """Add a method, if it can be trained; its first candidate is one of the next round."""
        return isinstance(method, Network) and self._choose(method)

    def _choose(self, network: Network) -> bool:
        """List the choices for a network; return whether it can be trained on the records."""
        plan = self._plan
        try:
            network.check(self._record, *plan.others)
        except ValueError:
            return False  # what its job then reports
        sized = plan.searched.get(network.name, False)
        # Comparisons with different seeds share no training seeds, and are independent.
        first = plan.seed * SEEDS
        found = candidates(network, sized, self._record, plan.others, first)
        limited = plan.ahead is not None or plan.reach is not None
        if limited and network.settings is not None:  # none over the whole record
            longest = network.settings.window
            found = [each for each in found if each.settings.window <= longest]
        self._choices[network.name] = found
        return True

    def ask(self, left: float = math.inf) -> list[Job]:
        """Return the jobs of the next round, the most promising first; none if all has settled.

        `left`: seconds until the deadline, by which the number of new candidates is limited.
        """
        self._left = left
        self._asked = next(self._course, [])
        self.converged = not self._asked and bool(self._tried) and not self._cut
        self.round += 1
        jobs = [self._job(candidate) for candidate in self._asked]
        if self.round == 1:
            jobs += [
                held_out_job(self._plan, method, seed)
                for method in self._given
                for seed in self._seeds()
            ]
        return jobs

    def tell(self, fits: Sequence[Fit]) -> None:
        """Take the fits of the jobs of the last round, in their order."""
        of_candidates, given = fits[: len(self._asked)], fits[len(self._asked) :]
        for candidate, fit in zip(self._asked, of_candidates, strict=True):
            self._take(candidate, fit)
        trials = {**self.trials}
        for fit in given:
            if fit.model is not None:
                trials.setdefault(fit.method, []).append(fit)
        self._members = {c.method: self._best_median(c.method) for c in self._tried}
        trials |= {name: [c.fits[c.best] for c in some] for name, some in self._members.items()}
        scores = {name: held_out_score(self._record, fits) for name, fits in trials.items() if fits}
        self.trials = {name: trials[name] for name in sorted(scores, key=lambda name: scores[name])}
        failed = {fit.method: fit for fit in reversed(fits) if fit.model is None} | self.failed
        self.failed = {name: fit for name, fit in failed.items() if name not in self.trials}

    def _take(self, candidate: Candidate, fit: Fit) -> None:
        """Take the fit of a candidate's round."""
        self._cut = self._cut or fit.cut
        if fit.model is None and fit.cut:
            return  # it was not started in time
        score = math.inf if fit.model is None else held_out_score(self._record, [fit])
        candidate.fits.append(fit)
        candidate.scores.append(score if math.isfinite(score) else math.inf)
        candidate.forget({candidate.best})
        trained = candidate.network if fit.model is None else fit.fitted
        said = candidate.method, trained.training_in_words(), candidate.seed
        shown = None if fit.model is None else (1 + WORTH_TRAINING) * score
        self.attempts.append(Attempt(self.round, *said, shown))
        if len(candidate.fits) == 1:
            self._tried.append(candidate)

    @property
    def cost_factor(self) -> float:
        """Return the time until the end that a second of this round costs, in seconds: more than 1.

        A candidate that has been trained for longer takes longer in its final training, too:
        a share `FINAL_SHARE` of the iterations before, on all samples.
        """
        members, jobs = len(next(iter(self.trials.values()), [None])), max(len(self._asked), 1)
        of_each = min(self._cores, jobs) / jobs
        return 1 + of_each * max(members / self._cores, 1) * FINAL_SHARE / (1 - HELD_OUT_SHARE)

    def _best_median(self, method: str) -> list[Candidate]:
        """Return the candidates of a method whose median is its prediction, the best one first.

        They are the n best ones, whatever their settings, where n gives the median with the lowest
        held-out error; on short records at least `LEAST_MEMBERS`.
        """
        ranked = _ranked(c for c in self._tried if c.method == method)
        for candidate in ranked[SEEDS:]:  # it is none again, unless it is trained further
            candidate.forget()
        ranked = ranked[:SEEDS]
        if self._plan.seeds is not None:
            return ranked[: self._plan.seeds]
        least = LEAST_MEMBERS if len(self._record) <= SHORT_RECORD else 1
        counts = range(min(least, len(ranked)), len(ranked) + 1)
        medians = [ranked[:n] for n in counts if n]
        return min(
            medians,
            key=lambda some: held_out_score(self._record, [c.fits[c.best] for c in some]),
            default=[],
        )

    def finals(self) -> list[Job]:
        """Return the final trainings, the best method first.

        The best method is trained as often as its median needs, the others once. A searched
        training goes on from its weights on all samples; one as given begins again.
        """
        found: list[Job] = []
        given = {method.name: method for method in self._given}
        for place, (name, fits) in enumerate(self.trials.items()):
            if name in given:
                spec, took = self._plan.spec(given[name]), fits[0].seconds / (1 - HELD_OUT_SHARE)
                found += [Job(given[name], spec, seed, seconds=took) for seed in self._seeds()]
                continue
            for number, candidate in enumerate(self._members[name][: None if place == 0 else 1]):
                network, start = candidate.final(), candidate.fits[candidate.best].model
                spec, seed = self._plan.spec(network), self._plan.seed * SEEDS + number
                found.append(Job(network, spec, seed, start, seconds=candidate.final_seconds))
        return found

    def _rounds(self) -> Iterator[list[Candidate]]:
        """Yield the candidates of each round; the caller trains them before it asks again."""
        firsts = [each[0] for each in self._choices.values()]
        yield firsts
        found = [*firsts]
        for new in (self._further_choices, self._combinations):
            if more := new(found):
                yield more
                found += more
        while found:
            pool = found
            while pool := _better([c for c in pool if c.progressed], self._cores):
                if len(pool) < self._cores:  # the others would wait for these
                    pool += self._with_new_seeds()
                yield pool
            found = self._with_new_seeds()
            if found:
                yield found
        while found := self._left_behind():
            yield found

    def _further_choices(self, firsts: Sequence[Candidate]) -> list[Candidate]:
        """Return further choices of the better half of the methods, as time allows."""
        # A method that was added has not had its first one yet.
        found = [own[0] for own in self._choices.values() if own[0] not in firsts]
        left = MOST_OF_TIME_LEFT * self._left * self._cores
        for first in _better(firsts):
            for choice in self._choices[first.method][1:]:
                left -= first.seconds
                if left < 0:
                    return found
                found.append(choice)
        return found

    def _combinations(self, tried: Sequence[Candidate]) -> list[Candidate]:
        """Return combinations of the best choice of each method with others that helped, too."""
        found: list[Candidate] = []
        for usual, *others in self._choices.values():
            better = [c for c in others if c in tried and c.score < usual.score]
            best, *rest = sorted(better, key=lambda c: c.score) or [usual]
            found += [c for other in rest if (c := combined(usual, best, other)) is not None]
        return found

    def _with_new_seeds(self) -> list[Candidate]:
        """Return the better half of the choices with the next seed."""
        seeds = {c.seed for c in self._tried}
        if not seeds or len(seeds) == SEEDS:
            return []
        choices: dict[Network, Candidate] = {}
        for candidate in _ranked(self._tried):
            choices.setdefault(candidate.network, candidate)
        newest = {c.network for c in self._tried if c.seed == max(seeds)}
        latest = [c for c in choices.values() if len(seeds) == 1 or c.network in newest]
        return [Candidate(c.network, max(seeds) + 1) for c in _better(latest, self._cores)]

    def _left_behind(self) -> list[Candidate]:
        """Return choices that were not tried yet, then the better half of what still improves."""
        every = [candidate for own in self._choices.values() for candidate in own]
        untried = [c for c in every if c not in self._tried]
        return untried or _better([c for c in self._tried if c.progressed], self._cores)

    def _job(self, candidate: Candidate) -> Job:
        start = candidate.fits[-1].model if candidate.fits else None
        return held_out_job(self._plan, candidate.next(), candidate.seed, start)

    def _seeds(self) -> range:
        first, count = self._plan.seed, self._plan.seeds or GIVEN_SEEDS
        return range(first * count, (first + 1) * count)


def _ranked(some: Iterable[Candidate]) -> list[Candidate]:
    """Return the candidates that have a score, the best one first."""
    return sorted((c for c in some if math.isfinite(c.score)), key=lambda c: c.score)


def _better(some: Iterable[Candidate], multiple: int = 1) -> list[Candidate]:
    """Return the better half of candidates, rounded up to a multiple of a number."""
    ranked = _ranked(some)
    half = math.ceil(len(ranked) / 2)
    return ranked[: -(-half // multiple) * multiple]
