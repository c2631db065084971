"""Finding out how to train networks: window, size and steps, by forecasts of held-out samples.

Not in the paper. The first network is trained in several ways for a short time; the better half of
them is trained for four times as long, and so on (successive halving: Jamieson and Talwalkar,
2016), until longer training makes the errors larger or the budget is used up. The other networks
are trained in the two ways that gave the first one its lowest errors, and likewise for longer.

What is tried depends on the record and on the work that may be done, counted in seconds of a
reference core, so that the same command tries the same on every run. A limit of wall time, where
there is one, comes before that: what would not be done by then on this machine is not begun, and
the time budget of the command (`evaluation.budget`) says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from splitband.data import Record
from splitband.evaluation.budget import ONE
from splitband.evaluation.costs import reference_seconds, training_cost
from splitband.evaluation.runs import Work, run_all
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
FREE_RUNS = 50, 100
"""Samples of the shortest windows that are predicted; the longest window is the recipe's."""
SIZES = 1 / 3, 2 / 3
"""Of the networks' usual sizes, those that L-BFGS is tried with."""
FIRST_STEPS = 300
"""Steps of Adam before L-BFGS takes over."""
TRIAL_SEEDS = 0, 1
"""Seeds of each candidate, whose mean is scored; the first one alone where that is too much."""
SEVERAL = 0.6
"""Share of what is left for the search that several seeds of each candidate may take."""
OF_FIRST = 0.8
"""Share of the search that may go into the network that stands first among the methods."""
TRANSFERRED = 2
"""How many of the first network's best candidates the other networks take settings from."""
LADDER = 100, 400, 1600, 6400
"""Iterations of L-BFGS that are tried, one after the other."""
WORSE = 1.1
"""A candidate is trained even longer if its error is at most this multiple of the lowest error of
its method."""
MAX_ERROR_RATIO = 2.0
"""A method is not trained longer if its error is above this multiple of the lowest of all."""
GOOD = 1.5
"""A method whose error is at most this multiple of the lowest one gets more than one seed, as far
as the budget allows."""
USUAL_SEEDS, MOST_SEEDS = 3, 8
"""Seeds of a good method, and of the best one with the default budget; a larger one allows for as
many more."""


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
    sizes : Whether networks that go by a name may be smaller than usual.
    bases : Whether a network may be tried on top of a baseline that does better than all networks.
    """

    core_seconds: float = field(default_factory=lambda: CORE_SECONDS)
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


@dataclass(frozen=True, eq=False)
class TrainingCandidate:
    """One way to train one method.

    Attributes
    ----------
    method : Its name.
    network : The forecaster, with its settings.
    size : Of its cells, relative to the usual one.
    cost : Seconds of a reference core for a training on the whole training part.
    """

    method: str
    network: Network
    size: float
    cost: float

    @property
    def label(self) -> str:
        """What progress bars and checkpoints call it."""
        return f"{self.method}, {self.network.training_in_words()}"

    @property
    def settings(self) -> Settings:
        """How the network is trained."""
        assert self.network.settings is not None
        return self.network.settings


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
    costs : Of the chosen networks, seconds of a reference core for one more training.
    left : Of the budget.
    most_seeds : Of the best network.
    """

    forecasters: list[Forecaster]
    attempts: tuple[SearchAttempt, ...] = ()
    done: Mapping[str, Mapping[int, Backtest]] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    left: float = 0.0
    most_seeds: int = MOST_SEEDS

    def seeds(self, scores: Mapping[str, float], left: float | None = None) -> dict[str, range]:
        """How many seeds of each method are worth their training, by held-out `scores`.

        One of each; of the good ones more, as the mean of several is better than one, as long as
        what is `left` lasts, by default of the work.
        """
        ranked = sorted([name for name in self.costs if name in scores], key=lambda n: scores[n])
        counts = dict.fromkeys(ranked, 1)
        left = self.left if left is None else min(left, self.left)
        left -= sum(self.costs[name] for name in ranked)
        good = [name for name in ranked if scores[name] <= GOOD * scores[ranked[0]]]
        for names, most in ((good, USUAL_SEEDS), (ranked[:1], self.most_seeds)):
            for name in names:
                more = min(most - counts[name], int(max(left, 0) / self.costs[name]))
                counts[name] += max(more, 0)
                left -= max(more, 0) * self.costs[name]
        return {name: range(count) for name, count in counts.items()}


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
    forecasters : With the default settings and bands.
    steps : How far beyond the record is to be forecast after all.
    budget : How much may be spent.
    work, others : See `protocols.compare_methods`.
    """
    free = [
        f for f in forecasters if isinstance(f, Network) and f.tunable and _fits(f, record, others)
    ]
    if not free:
        return SearchResult([*forecasters], left=budget.core_seconds)
    makes = {f.name: partial(_candidate, f, record, others) for f in free}
    for_search, for_one = (share * budget.core_seconds for share in (SEARCHED, TRAINED))
    trials = _Trials(record, steps, work, others, for_search)
    time, until = work.time, work.deadline
    for_one = min(for_one, time.reckoned_alone(time.share(ONE)))

    tried: list[TrainingCandidate] = []

    def climb(candidates: Sequence[TrainingCandidate], allowed: float) -> None:
        """Try them, then the promising ones for longer, and so on."""
        while candidates:
            left = allowed - trials.spent
            in_time = time.reckoned(until)
            if in_time < min(left, sum(_in_trials(c, len(TRIAL_SEEDS)) for c in candidates)):
                time.narrowed("the search")
                left = min(left, in_time)
                candidates = sorted(candidates, key=lambda c: c.cost)
            affordable = _within(candidates, len(TRIAL_SEEDS), SEVERAL * left, for_one)
            seeds: Sequence[int] = TRIAL_SEEDS
            if len(affordable) < len(candidates):
                affordable, seeds = _within(candidates, 1, left, for_one), TRIAL_SEEDS[:1]
            if affordable:
                trials.run(affordable, seeds)
                tried.extend(affordable)
            candidates = [
                makes[c.method](replace(c.settings, quasi_newton=longer), c.size)
                for c in _promoted(affordable, tried, trials.scores)
                for longer in [n for n in LADDER if n > (c.settings.quasi_newton or 0)][:1]
            ]

    first, *rest = free
    of_usual = ways(first, len(record))
    of_first = [makes[first.name](*way) for way in of_usual]
    climb(of_first, (OF_FIRST if rest else 1.0) * for_search)
    best = _ranked(tried, trials.scores)[:TRANSFERRED]
    climb([makes[f.name](c.settings, c.size) for c in best for f in rest], for_search)
    # What suits the first one may take too long for the others: then the shortest of its kind.
    late = [f for f in rest if not any(c.method == f.name for c in tried)]
    short = [c for c in best if c.settings.quasi_newton][:1]
    climb(
        [
            makes[f.name](replace(c.settings, quasi_newton=LADDER[0]), c.size)
            for c in short
            for f in late
        ],
        for_search,
    )
    ranked = _ranked(tried, trials.scores)
    chosen = {c.method: c for c in reversed(ranked)}
    if time.cut and not tried:  # there is no time to try anything: what is done soonest
        chosen = {
            f.name: min((makes[f.name](*w) for w in of_usual), key=lambda c: c.cost) for f in free
        }
    return SearchResult(
        [chosen[f.name].network if f.name in chosen else f for f in forecasters],
        tuple(trials.attempts),
        {name: trials.done.get(candidate.label, {}) for name, candidate in chosen.items()},
        {name: candidate.cost for name, candidate in chosen.items()},
        budget.core_seconds - trials.spent,
        max(MOST_SEEDS, round(MOST_SEEDS * budget.core_seconds / CORE_SECONDS)),
    )


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
        self,
        record: Record,
        steps: int,
        work: Work,
        others: Sequence[Record],
        most: float,
    ) -> None:
        self._record, self._end = replace(record, y_true=None), len(record) + steps
        self._work, self._others = work, others
        self.attempts: list[SearchAttempt] = []
        self.done: dict[str, dict[int, Backtest]] = {}
        """Forecasts by label and seed."""
        self.scores: dict[str, float] = {}
        """By label: of the mean of the seeds; none of what could not be trained."""
        self.spent = 0.0
        self._rounds = 0
        self._most = most

    def run(self, candidates: Sequence[TrainingCandidate], seeds: Sequence[int]) -> None:
        """Train each with all seeds, and score the mean of their forecasts."""
        samples = len(self._record)
        networks = {c.label: for_trial(c.network, samples).called(c.label) for c in candidates}
        questions = {
            label: Question(
                self._record, held_out_origins(network, self._record), self._end, self._others
            )
            for label, network in networks.items()
        }
        self._rounds += 1
        spent = self.spent + sum(_in_trials(c, len(seeds)) for c in candidates)
        work = self._work.for_stage(f"{SEARCHING} {self._rounds}", span=self._span(spent))
        results, _ = run_all([*networks.values()], questions, seeds, work, need_one=False)
        self.spent = spent
        for c in candidates:
            self.done[c.label] = results[c.label]
            if results[c.label]:
                self.scores[c.label] = held_out_score(self._record, [*results[c.label].values()])
            score = self.scores.get(c.label)
            training = c.network.training_in_words()
            self.attempts.append(SearchAttempt(c.method, training, len(results[c.label]), score))

    def _span(self, spent: float) -> tuple[float, float]:
        """The shares of the command that are done before and after the next trials."""
        first, last = self._work.span
        before, after = (
            first + min(share / self._most, 1.0) * (last - first) for share in (self.spent, spent)
        )
        return before, after


def ways(forecaster: Network, samples: int) -> list[tuple[Settings, float]]:
    """The usual training, and shorter ones with L-BFGS, of windows and sizes that differ.

    It is for a training part of so many samples.
    """
    usual = forecaster.settings
    assert usual is not None
    epochs = max(1, round(FIRST_STEPS / usual.batches_of(samples)))
    short = [min(usual.warmup + free, usual.window) for free in FREE_RUNS]
    sizes = SIZES if forecaster.resizable else (1.0,)
    return [(usual, 1.0)] + [
        (replace(usual, window=window, epochs=epochs, quasi_newton=LADDER[0]), size)
        for window in sorted({*short, usual.window})
        for size in sizes
    ]


def _candidate(
    forecaster: Network,
    record: Record,
    others: Sequence[Record],
    settings: Settings,
    size: float,
) -> TrainingCandidate:
    network = forecaster.trained_as(settings, size)
    return TrainingCandidate(forecaster.name, network, size, training_cost(network, record, others))


def _in_trials(candidate: TrainingCandidate, seeds: int) -> float:
    """What it costs to try a candidate with so many seeds."""
    return seeds * (1 - HELD_OUT) * candidate.cost


def _within(
    candidates: Sequence[TrainingCandidate], seeds: int, left: float, for_one: float
) -> list[TrainingCandidate]:
    """The candidates that what is left of the budget pays for, taken in their order."""
    kept = []
    for candidate in candidates:
        cost = _in_trials(candidate, seeds)
        if cost <= left and candidate.cost <= for_one:
            kept.append(candidate)
            left -= cost
    return kept


def _ranked(
    candidates: Sequence[TrainingCandidate], scores: Mapping[str, float]
) -> list[TrainingCandidate]:
    """Those that could be trained, the best one first."""
    scored = [candidate for candidate in candidates if candidate.label in scores]
    return sorted(scored, key=lambda candidate: scores[candidate.label])


def _promoted(
    last: Sequence[TrainingCandidate],
    tried: Sequence[TrainingCandidate],
    scores: Mapping[str, float],
) -> list[TrainingCandidate]:
    """The better half of each method's last candidates, to be trained longer; the best one first.

    Candidates that more iterations have made worse (`WORSE`) are left out, and so are methods that
    are far from the best one (`MAX_ERROR_RATIO`).
    """
    lowest = scores[_ranked(tried, scores)[0].label] if scores else 0.0
    kept = []
    for method in dict.fromkeys(candidate.method for candidate in last):
        ranked = _ranked([c for c in tried if c.method == method], scores)
        best = scores[ranked[0].label] if ranked else 0.0
        if best > MAX_ERROR_RATIO * lowest:
            continue
        better = [c for c in ranked if c in last and c.settings.quasi_newton]
        kept += [c for c in better[: -(-len(better) // 2)] if scores[c.label] <= WORSE * best]
    return _ranked(kept, scores)


def held_out_score(record: Record, done: Sequence[Backtest]) -> float:
    """RMSE of the seeds' mean forecasts of a training record's last quarter, channels scaled."""
    check_held_out(record)
    mean = mean_forecasts(done)
    scale = spread(record.seen)
    return root_mean_square([error / scale for error in held_out_errors(record, mean)])
