"""Finding out how to train networks, by forecasts of held-out samples: successive halving.

Not in the paper. All candidates (sizes, windows, penalties) are trained for a few iterations, the
better half of them goes on for four times as many, and so on (Jamieson and Talwalkar, 2016), until
longer training makes the errors larger or the budget is used up. A candidate goes on from where it
stopped, and so does the last training, on all samples. So there is a result after the first short
training, and what is spent on it later makes it better.

What is tried depends on the record and on the work that may be done, counted in seconds of a
reference core, so that the same command tries the same on every run. A limit of wall time, where
there is one, comes before that: what would not be done by then on this machine is not begun, and
the time budget of the command (`evaluation.budget`) says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

from splitband.data import Record
from splitband.evaluation.budget import ONE
from splitband.evaluation.costs import reference_seconds, training_cost
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
from splitband.forecasters.base import Forecaster
from splitband.forecasters.beginning import Earlier
from splitband.forecasters.network import Network
from splitband.metrics import spread
from splitband.runtime.threads import available_cores
from splitband.training import Settings

SEARCHING = "search"
"""Name of the stage of the work, followed by the number of the round."""
CORE_SECONDS, SECONDS = 240.0, 120.0
"""The default: work that two cores of any recent machine do in less than these two minutes."""
SEARCHED, TRAINED = 0.55, 0.3
"""Shares of the budget: for this search, and at most for a single training of a candidate."""
FIRST_ROUND, OF_OTHERS = 0.5, 0.15
"""Shares of the search for the first round of the first method, and of all others."""
FIRST_STEPS = 300
"""Steps of Adam before L-BFGS takes over, from random weights."""
FREE_RUN, FREE_RUNS = 150, (100, 50)
"""Samples of the shorter windows that are predicted, from a linear model and from random weights;
the longest windows are the recipe's."""
SHORT = 3000
"""Samples of a record up to which windows of all of it are tried, too."""
PENALTIES = 1e-4, 1e-3
"""The penalties that are tried, the second one on records of up to `SHORT` samples."""
TRIAL_SEEDS, CORE_SECONDS_A_SEED = 2, 120.0
"""Seeds of each candidate, whose mean is scored; on records of up to `SHORT` samples one for so
much of the budget, where that is more, and at most `MOST_MEMBERS`."""
LADDER = 100, 400, 1600, 6400
"""Iterations of L-BFGS that a candidate has had after each round."""
KEPT = 0.5
"""Share of the candidates of a round that go on."""
WORSE = 1.1
"""A candidate whose error is above this multiple of what it was a round before does not go on."""
MAX_ERROR_RATIO = 2.0
"""A candidate does not go on if its error is above this multiple of the lowest of all."""
GOOD = 1.5
"""A method whose error is at most this multiple of the lowest one gets more than one seed, as far
as the budget allows."""
MOST_MEMBERS = 8
"""Trainings whose mean is handed out, at most."""
SEEDS = 3
"""Trainings of each network, where nothing else decides how many."""
LONGER = 4
"""By how much the best candidate's last training may be longer than any trial was, where longer
trials were better and only the budget ended them."""
LAST = 0.7
"""Share of what is left of the budget that this may take."""
SETTLING = 0.25
"""Share of its iterations that a training gets on top of them when further samples are added."""


@dataclass(frozen=True)
class Search:
    """How much may go into finding out how to train, and into training.

    Attributes
    ----------
    core_seconds : Work for a whole comparison, in seconds of a reference core, reckoned and not
        timed, so that the same comparison finds the same on every run.
    seconds : Of wall time for a whole comparison, however busy the machine is; None: no limit.
        Trainings that are not done by then end with what they have, and what has not begun is left
        out. See `within`.
    sizes : Whether networks that go by a name may have other sizes than usual.
    bases : Whether a network may be tried on top of a baseline that does better than all networks.
    """

    core_seconds: float = CORE_SECONDS
    seconds: float | None = None
    sizes: bool = True
    bases: bool = False

    def __post_init__(self) -> None:
        """Check ranges."""
        if not 0 < self.core_seconds < float("inf"):
            raise ValueError(f"core_seconds must be positive, got {self.core_seconds}")
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise ValueError(f"seconds must be positive or None, got {self.seconds}")

    @classmethod
    def usual(cls) -> Search:
        """Return the default: two minutes at most, of which a quiet machine needs less."""
        return cls(seconds=SECONDS)

    @classmethod
    def within(cls, seconds: float, cores: int | None = None) -> Search:
        """Return what fits into so many seconds of wall time, on cores of this machine.

        Its speed is measured once, and as much work is planned as is done well before the time is
        over.
        """
        if not 0 < seconds < float("inf"):
            raise ValueError(f"seconds must be positive, got {seconds}")
        return cls(reference_seconds(seconds, cores or available_cores()), seconds)


@dataclass(frozen=True)
class SearchAttempt:
    """What became of a candidate on the held-out samples.

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
class SearchResult:
    """How each network is to be trained, what has been tried, and what it has cost.

    Attributes
    ----------
    forecasters : Those that were given, each network as it is to be trained.
    attempts : All that has been tried, in that order.
    done : Of the chosen networks, the forecasts of held-out samples, by name and seed.
    costs : Of the chosen networks, seconds of a reference core for each last training.
    members : How many trainings the search has begun whose mean is to be handed out.
    more : Of networks that further seeds of the best setting may join, the cost of each.
    left : Of the budget.
    """

    forecasters: list[Forecaster]
    attempts: tuple[SearchAttempt, ...] = ()
    done: Mapping[str, Mapping[int, Backtest]] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    members: Mapping[str, int] = field(default_factory=dict)
    more: Mapping[str, float] = field(default_factory=dict)
    left: float = 0.0

    def cost(self, name: str) -> float:
        """Return the cost of a last training, 0 where nothing was searched."""
        return self.costs.get(name, 0.0)

    def seeds(self, scores: Mapping[str, float], left: float | None = None) -> dict[str, range]:
        """Return the seeds of each method that are worth their training, by held-out `scores`.

        One of each; of the good ones all members, the best method first, and of this one more seeds
        up to `MOST_MEMBERS`, as long as what is `left` lasts, by default of the work.
        """
        ranked = sorted([name for name in self.costs if name in scores], key=lambda n: scores[n])
        counts = dict.fromkeys(ranked, 1)
        left = self.left if left is None else min(left, self.left)
        left -= sum(self.cost(name) for name in ranked)
        for name in ranked:
            wanted = self.members.get(name, SEEDS)
            if scores[name] > GOOD * scores[ranked[0]]:
                break
            while counts[name] < wanted and self.cost(name) <= left:
                left -= self.cost(name)
                counts[name] += 1
        for name in ranked[:1]:
            begun = counts[name] == self.members.get(name)
            more = self.more.get(name, math.inf)
            while begun and counts[name] < MOST_MEMBERS and more <= left:
                left -= more
                counts[name] += 1
        return {name: range(count) for name, count in counts.items()}


@dataclass(frozen=True, eq=False)
class TrainingCandidate:
    """One way to train one method, and how far it has come.

    Attributes
    ----------
    method : Its name.
    network : The forecaster, with its settings.
    rung : Rounds of L-BFGS that it has had; -1 for a training without.
    score : RMSE of the mean of its seeds on the held-out samples; None where it failed or has not
        been tried.
    done : Forecasts of the held-out samples, by seed.
    began_as : Label of the candidate that it goes on from.
    """

    method: str
    network: Network
    rung: int = -1
    score: float | None = None
    done: Mapping[int, Backtest] = field(default_factory=dict)
    began_as: str = ""

    @property
    def label(self) -> str:
        """What progress bars and checkpoints call it."""
        return f"{self.method}, {self.network.training_in_words()}"

    @property
    def settings(self) -> Settings:
        """How the network is trained."""
        assert self.network.settings is not None
        return self.network.settings

    def longer(self) -> TrainingCandidate | None:
        """Return the candidate of the next round; None where there is none."""
        if not 0 <= self.rung < len(LADDER) - 1:
            return None
        settings = replace(self.settings, quasi_newton=LADDER[self.rung + 1])
        weights = {seed: done.weights for seed, done in self.done.items()}
        earlier = Earlier(self.settings.quasi_newton or 0, weights)
        network = self.network.trained_as(settings).going_on(earlier)
        began_as = self.began_as or self.label
        return replace(self, network=network, rung=self.rung + 1, done={}, began_as=began_as)


@dataclass(frozen=True, eq=False)
class TrialRun:
    """One seed of a candidate that has been trained.

    Attributes
    ----------
    candidate : Whose it is.
    done : Its forecasts of the held-out samples.
    score : Their RMSE.
    key : What it has in common with the same training after other rounds.
    """

    candidate: TrainingCandidate
    done: Backtest
    score: float
    key: tuple[str, int]

    def going_on(self, iterations: int, seed: int) -> Network:
        """Return the network, trained for more iterations, with these weights for a seed."""
        settings = self.candidate.settings
        trained = settings.quasi_newton or 0
        network = self.candidate.network.trained_as(
            replace(settings, quasi_newton=trained + iterations)
        )
        return network.going_on(Earlier(trained, {seed: self.done.weights}))


def search(
    record: Record,
    forecasters: Sequence[Forecaster],
    steps: int,
    budget: Search,
    work: Work,
    others: Sequence[Record] = (),
) -> SearchResult:
    """Choose how the networks among some forecasters are trained, where that has been left open.

    Parameters
    ----------
    record : The training part, and nothing else. What is tried is fitted to its first three
        quarters, as in `selection.try_out`.
    forecasters : With the default settings and bands; the first network matters most.
    steps : How far beyond the record is to be forecast after all.
    budget : How much may be spent.
    work, others : See `protocols.run_methods`.
    """
    tunable = [
        network
        for f in forecasters
        if (network := f.network) and network.tunable and _fits(network, record, others)
    ]
    if not tunable:
        return SearchResult([*forecasters], left=budget.core_seconds)
    trials = _Trials(record, steps, work, others, SEARCHED * budget.core_seconds)
    first, *rest = [ways(f, record) for f in tunable]
    # One short training, so that there is a result; what it comes to is what all else has to beat.
    ladder = trials.run(first[:1], 1.0) + trials.run(first[1:], FIRST_ROUND if rest else 1.0)
    # Of the others those first that have not been tried at all.
    quickest = [sorted(each, key=trials.cost) for each in rest]
    others_first = [c for turn in zip_longest(*quickest) for c in turn if c]
    ladder += trials.run(others_first, FIRST_ROUND + OF_OTHERS)
    while ladder:
        ladder = trials.run([c for each in trials.promoted(ladder) if (c := each.longer())], 1.0)
    best = {f.name: runs for f in tunable if (runs := trials.best(f.name))}
    left = budget.core_seconds - trials.spent
    last = {name: trials.last(runs, left) for name, runs in best.items()}
    if work.time.cut and not trials.tried:  # there is no time to try anything: what is done soonest
        soonest = [min(each, key=trials.cost) for each in (first, *rest)]
        last = {each.method: [each.network] for each in soonest}
    chosen = {name: networks[0] for name, networks in last.items()}
    for name, networks in last.items():
        chosen[name].by_seed = dict(enumerate(networks[1:], 1))
    return SearchResult(
        [chosen.get(f.name, f) for f in forecasters],
        tuple(trials.attempts),
        {name: {i: run.done for i, run in enumerate(runs)} for name, runs in best.items()},
        {
            name: sum(training_cost(each, record, others) for each in networks) / len(networks)
            for name, networks in last.items()
        },
        {name: len(networks) for name, networks in last.items()},
        # Held-out errors of a long record tell which training is best: others only make it worse.
        {}
        if len(record) > SHORT
        else {
            name: training_cost(network.going_on(Earlier()), record, others)
            for name, network in chosen.items()
        },
        left,
    )


def ways(forecaster: Network, record: Record) -> list[TrainingCandidate]:
    """Return candidates for a training record, the most promising one first.

    An iteration of a small state-space network is quick: on long records it has more of them.

    A network that begins as a linear model needs no steps of Adam, and differs in size, window and
    penalty from the first candidate, one at a time. From random weights there is also the default
    recipe, by Adam alone.
    """
    usual, samples = forecaster.settings, len(record)
    assert usual is not None
    steps = max(1, round(FIRST_STEPS / usual.batches_of(samples)))
    finished = replace(usual, epochs=steps, quasi_newton=LADDER[0])
    size, *sizes = forecaster.variants()
    if forecaster.starts_linear(record):
        window = min(usual.warmup + FREE_RUN, usual.window)
        rung = int(samples > SHORT)
        base = replace(finished, window=window, epochs=0, quasi_newton=LADDER[rung])
        settings = [base, replace(base, window=usual.window), replace(base, penalty=PENALTIES[0])]
        if samples <= SHORT:
            settings.append(replace(base, penalty=PENALTIES[1]))
            settings.append(replace(base, window=samples, penalty=PENALTIES[0]))
        settings.append(replace(base, epochs=steps, linear_start=False))
        every = [(size, each) for each in settings] + [(other, base) for other in sizes]
    else:
        rung = 0
        free_runs = sorted({*FREE_RUNS, usual.window - usual.warmup}, reverse=True)
        windows = {min(usual.warmup + free, usual.window) for free in free_runs}
        settings = [replace(finished, window=window) for window in sorted(windows)]
        every = [(other, each) for each in settings for other in (sizes or [size])]
        every += [(other, replace(settings[0], penalty=PENALTIES[0])) for other in sizes[-1:]]
    found = [TrainingCandidate(forecaster.name, n.trained_as(how), rung) for n, how in every]
    if not forecaster.starts_linear(record):
        found.insert(0, TrainingCandidate(forecaster.name, size.trained_as(usual)))
    return [*{candidate.label: candidate for candidate in found}.values()]


def _fits(network: Network, record: Record, others: Sequence[Record]) -> bool:
    """Whether it can be trained on these records; its row says why not."""
    try:
        network.check(record, *others)
    except ValueError:
        return False
    return True


class _Trials:
    """Candidates on the held-out end of a training record."""

    def __init__(
        self, record: Record, steps: int, work: Work, others: Sequence[Record], most: float
    ) -> None:
        self._record, self._end = replace(record, y_true=None), len(record) + steps
        self._work, self._others, self._most = work, others, most
        alone = work.time.reckoned_alone(work.time.share(ONE))
        self._longest = min(alone, TRAINED / SEARCHED * most)
        self.attempts: list[SearchAttempt] = []
        self.tried: list[TrainingCandidate] = []
        """Those that could be trained."""
        self.runs: list[TrialRun] = []
        """All of their seeds."""
        self.spent = 0.0
        self._rounds = 0
        paid = round(most / SEARCHED / CORE_SECONDS_A_SEED) if len(record) <= SHORT else 0
        self._seeds = range(min(max(TRIAL_SEEDS, paid), MOST_MEMBERS))

    def cost(self, candidate: TrainingCandidate) -> float:
        """Return the seconds of a reference core for all seeds of a trial."""
        whole = training_cost(candidate.network, self._record, self._others)
        return len(self._seeds) * (1 - HELD_OUT) * whole

    def run(self, candidates: Sequence[TrainingCandidate], share: float) -> list[TrainingCandidate]:
        """Train those that this share of the budget pays for, in their order; return them scored.

        What its deadline ends is scored with what it has come to.
        """
        time = self._work.time
        left = share * self._most - self.spent
        if (in_time := time.reckoned(self._work.deadline)) < left:
            if in_time < sum(map(self.cost, candidates)):
                time.narrowed("the search")
            left = in_time
        affordable, costs = [], []
        for candidate in candidates:
            cost = self.cost(candidate)
            if cost <= left and cost / len(self._seeds) <= self._longest:
                affordable.append(candidate)
                costs.append(cost)
                left -= cost
        if not affordable:
            return []
        samples = len(self._record)
        networks = {c.label: for_trial(c.network, samples).called(c.label) for c in affordable}
        questions = {
            label: Question(
                self._record, held_out_origins(network, self._record), self._end, self._others
            )
            for label, network in networks.items()
        }
        after = self.spent + sum(costs)
        self._rounds += 1
        work = self._work.for_stage(f"{SEARCHING} {self._rounds}", span=self._span(after))
        results, _ = run_all([*networks.values()], questions, self._seeds, work, need_one=False)
        self.spent = after
        return [self._scored(c, results[c.label]) for c in affordable]

    def _scored(self, candidate: TrainingCandidate, done: dict[int, Backtest]) -> TrainingCandidate:
        failed = failed_seeds({seed: each.report for seed, each in done.items()})
        done = {seed: each for seed, each in done.items() if seed not in failed}
        score = held_out_score(self._record, [*done.values()]) if done else None
        training = candidate.network.training_in_words()
        self.attempts.append(SearchAttempt(candidate.method, training, len(done), score))
        before, scored = candidate.score, replace(candidate, score=score, done=done)
        if score is not None:
            self.tried.append(scored)
        began_as = candidate.began_as or candidate.label
        for seed, each in done.items():
            own = held_out_score(self._record, [each])
            self.runs.append(TrialRun(scored, each, own, (began_as, seed)))
        worse = score is None or (before is not None and score > WORSE * before)
        return replace(scored, rung=-1) if worse else scored

    def promoted(self, last: Sequence[TrainingCandidate]) -> list[TrainingCandidate]:
        """Return those that go on: the better ones of a round, the best one first."""
        lowest = min((c.score for c in self.tried if c.score is not None), default=0.0)
        able = sorted([c for c in last if c.score is not None], key=lambda c: c.score or 0.0)
        able = able[: math.ceil(KEPT * len(able))]
        return [c for c in able if c.rung >= 0 and (c.score or 0.0) <= MAX_ERROR_RATIO * lowest]

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
        firsts = [ranked[: i + 1] for i in range(len(ranked))]
        return min(firsts, key=self._error_of_mean, default=[])

    def _error_of_mean(self, runs: Sequence[TrialRun]) -> float:
        return held_out_score(self._record, [run.done for run in runs])

    def last(self, runs: Sequence[TrialRun], left: float) -> list[Network]:
        """Return a network for each last training, which goes on from the trial.

        Where longer trials were better, and the budget alone has ended them, those of the best
        candidate are longer.
        """
        newest = max(self.tried, key=lambda c: c.settings.quasi_newton or 0)
        networks = []
        for seed, run in enumerate(runs):
            candidate, trained = run.candidate, run.candidate.settings.quasi_newton
            if not trained:
                networks.append(candidate.network)
                continue
            more = max(round(SETTLING * trained), 1)
            if candidate.label == runs[0].candidate.label == newest.label and candidate.rung >= 0:
                each = training_cost(run.going_on(1, seed), self._record, self._others)
                alike = sum(other.candidate.label == candidate.label for other in runs)
                pays = int(LAST * left / (alike * max(each, 1e-9)))
                more = max(more, min((LONGER - 1) * trained, pays))
            networks.append(run.going_on(more, seed))
        return networks

    def _span(self, spent: float) -> tuple[float, float]:
        """The shares of the command that are done before and after the next trials."""
        first, last = self._work.span
        before, after = (
            first + min(share / self._most, 1.0) * (last - first) for share in (self.spent, spent)
        )
        return before, after


def held_out_score(record: Record, done: Sequence[Backtest]) -> float:
    """RMSE of the seeds' mean forecasts of a training record's last quarter, channels scaled."""
    check_held_out(record)
    mean = mean_forecasts(done)
    scale = spread(record.seen)
    return root_mean_square([error / scale for error in held_out_errors(record, mean)])
