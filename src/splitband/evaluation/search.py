"""Find out how to train networks, by forecasts of held-out samples: successive halving.

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
from splitband.evaluation.candidates import SHORT, candidates
from splitband.evaluation.costs import reference_seconds, training_cost
from splitband.evaluation.trials import MOST_MEMBERS, SearchAttempt, Trials
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import Backtest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.beginning import Earlier
from splitband.forecasters.network import Network
from splitband.runtime.threads import available_cores

CORE_SECONDS, SECONDS = 240.0, 120.0
"""The default limits of work, in seconds of a reference core, and of wall time. They belong
together: two cores of any recent machine do the work in less than that time."""
FIRST_ROUND, OF_OTHERS = 0.5, 0.15
"""Shares of the search for the first round of the first method, and of all others."""
GOOD = 1.5
"""A method whose error is at most this multiple of the lowest one gets more than one seed, as far
as the budget allows."""
SEEDS = 3
"""Trainings of each network, where nothing else decides how many."""


@dataclass(frozen=True)
class Search:
    """Say how much may go into finding out how to train, and into training.

    Attributes
    ----------
    core_seconds : Work for a whole comparison, in seconds of a reference core, estimated and not
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
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise ValueError(f"seconds must be positive or None, got {self.seconds}")
        if not 0 < self.core_seconds < float("inf"):
            raise ValueError(f"core_seconds must be positive, got {self.core_seconds}")

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
        return cls(reference_seconds(seconds, cores or available_cores()), seconds)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Hold how each network is to be trained, what has been tried, and what it has cost.

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

    def seeds(self, scores: Mapping[str, float], left: float | None = None) -> dict[str, range]:
        """Return the seeds of each method that are worth their training, by held-out `scores`.

        One of each; of the good ones all members, the best method first, and of this one more seeds
        up to `MOST_MEMBERS`, as long as what is `left` lasts, by default of the work.
        """
        ranked = sorted([name for name in self.costs if name in scores], key=lambda n: scores[n])
        counts = dict.fromkeys(ranked, 1)
        left = self.left if left is None else min(left, self.left)
        left -= sum(self.costs[name] for name in ranked)
        for name in ranked:
            wanted, cost = self.members.get(name, SEEDS), self.costs[name]
            if scores[name] > GOOD * scores[ranked[0]]:
                break
            while counts[name] < wanted and cost <= left:
                left -= cost
                counts[name] += 1
        for name in ranked[:1]:
            begun = counts[name] == self.members.get(name)
            more = self.more.get(name, math.inf)
            while begun and counts[name] < MOST_MEMBERS and more <= left:
                left -= more
                counts[name] += 1
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
        quarters, as in `recommendation.try_out`.
    forecasters : With the default settings and bands; the first network matters most.
    steps : How far beyond the record is to be forecast after all.
    budget : How much may be spent.
    work, others : Where the trials are computed, and the further training records.
    """
    tunable = [
        network
        for f in forecasters
        if (network := f.network) and network.tunable and _fits(network, record, others)
    ]
    if not tunable:
        return SearchResult([*forecasters], left=budget.core_seconds)
    trials = Trials(record, steps, work, others, budget.core_seconds)
    first, *rest = [candidates(f, record) for f in tunable]
    # One short training, so that there is a result; what it comes to is what all else has to beat.
    ladder = trials.run(first[:1], 1.0) + trials.run(first[1:], FIRST_ROUND if rest else 1.0)
    # Of the others those first that have not been tried at all.
    quickest = [sorted(each, key=trials.cost) for each in rest]
    ladder += trials.run([each[0] for each in quickest], FIRST_ROUND + OF_OTHERS)
    promising = [each[1:] for each in quickest if trials.promising(each[0].method)]
    others_first = [c for turn in zip_longest(*promising) for c in turn if c]
    # What has helped alone may help together.
    together = trials.combinations(first[0])
    ladder += trials.run(together + others_first, FIRST_ROUND + OF_OTHERS if rest else 1.0)
    while ladder:
        ladder = trials.run([c for each in trials.promoted(ladder) if (c := each.longer())], 1.0)
    best = {f.name: runs for f in tunable if (runs := trials.best(f.name))}
    left = budget.core_seconds - trials.spent
    last = {name: trials.last(runs, left) for name, runs in best.items()}
    # Of what the budget did not pay a trial for, what is done soonest.
    soonest = [min(each, key=trials.cost) for each in (first, *rest)]
    last = {each.method: [each.network] for each in soonest} | last
    done = {name: {i: run.done for i, run in enumerate(runs)} for name, runs in best.items()}
    found = SearchResult([*forecasters], tuple(trials.attempts), done, left=left)
    return _chosen(found, last, record, others)


def _fits(network: Network, record: Record, others: Sequence[Record]) -> bool:
    """Return whether it can be trained on these records; its row says why not."""
    try:
        network.check(record, *others)
    except ValueError:
        return False
    return True


def _chosen(
    found: SearchResult,
    last: Mapping[str, Sequence[Network]],
    record: Record,
    others: Sequence[Record],
) -> SearchResult:
    """Return the result with the networks of the `last` trainings, by name and seed."""
    costs, more, chosen = {}, {}, {}
    for name, (network, *further) in last.items():
        each = [training_cost(one, record, others) for one in (network, *further)]
        costs[name] = sum(each) / len(each)
        # Held-out errors of a long record tell which training is best: others only make it worse.
        if len(record) <= SHORT:
            more[name] = training_cost(network.going_on(Earlier()), record, others)
        network.by_seed = dict(enumerate(further, 1))
        chosen[name] = network
    return replace(
        found,
        forecasters=[chosen.get(f.name, f) for f in found.forecasters],
        costs=costs,
        members={name: len(networks) for name, networks in last.items()},
        more=more,
    )
