"""Search for training settings by successive halving, scored by forecasts of held-out samples.

Not in the paper. All candidates (sizes, windows, penalties) are trained for a few iterations, the
better half of them continues for four times as many, and so on (Jamieson and Talwalkar, 2016),
until longer training makes the errors larger or the budget is used up. A candidate continues from
its last weights, and so does the final training, on all samples. The first short training already
gives a result, which later rounds improve.

The candidates depend on the record and on the allowed work, estimated in seconds of a reference
core (see `evaluation.costs`), so that the same command tries the same on every run. A limit of wall
time takes precedence: trainings that this machine would not finish in time are not started, and the
time budget of the command (`evaluation.budget`) reports it.
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
from splitband.forecasters.initialisation import Earlier
from splitband.forecasters.network import Network
from splitband.runtime.threads import available_cores

CORE_SECONDS, SECONDS = 240.0, 120.0
"""The default limits of work, in seconds of a reference core, and of wall time. They belong
together: two cores of any recent machine do the work in less than that time."""
FIRST_ROUND = 0.5
"""Share of the search budget for the first round of the first network, if there are others."""
OF_OTHERS = 0.15
"""Share that is added to it for the first round of all other networks, and for combinations of the
first one's changes."""
GOOD = 1.5
"""A method whose error is at most this multiple of the lowest one gets more than one training, as
far as the budget allows."""
SEEDS = 3
"""Default number of trainings (seeds) of each network."""


@dataclass(frozen=True)
class Search:
    """Limit the work and the wall time of the search and the trainings of a comparison.

    Attributes
    ----------
    core_seconds : Work for a whole comparison, in seconds of a reference core. It is estimated and
        not timed, so that the same comparison gives the same result on every run.
    seconds : Wall time for a whole comparison; None: no limit. Trainings that still run then stop
        with the weights that they have, and those that have not started are left out. See `within`.
    sizes : Whether the search may change the sizes of networks given by name.
    bases : Whether to try a network on top of a baseline that does better than all networks.
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
        """Return the default limits: at most two minutes; an idle machine needs less."""
        return cls(seconds=SECONDS)

    @classmethod
    def within(cls, seconds: float, cores: int | None = None) -> Search:
        """Return the limits for so many seconds of wall time on cores of this machine.

        The machine's speed is measured once, and the work is planned to end well before the time
        is over.
        """
        return cls(reference_seconds(seconds, cores or available_cores()), seconds)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Hold the chosen settings of each network, the attempts, and the costs.

    Attributes
    ----------
    forecasters : The given forecasters, networks with the chosen settings.
    attempts : All attempts, in order.
    done : Held-out forecasts of the chosen networks, by name and seed.
    costs : Cost of one final training of each chosen network, in seconds of a reference core.
    members : By network, how many trainings the search chose to combine by their median.
    more : By network, cost of one more training with the best settings, from scratch; only on short
        records.
    left : Work that is left, in seconds of a reference core.
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

        Every method gets one training. Good ones (see `GOOD`) get the number that the search chose
        (`members`), the best method first, which then gets more, up to `MOST_MEMBERS`. All of it
        must fit into the work `left`, by default that of the budget.
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
            all_chosen_fit = counts[name] == self.members.get(name)
            more = self.more.get(name, math.inf)
            while all_chosen_fit and counts[name] < MOST_MEMBERS and more <= left:
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
    """Choose the training settings of all tunable networks among some forecasters.

    Parameters
    ----------
    record : The training part alone. Candidates are fitted to its first three quarters, as in
        `recommendation.try_out`.
    forecasters : With default settings and bands; the first network is searched most thoroughly.
    steps : Samples beyond the record that the final forecast covers.
    budget : Limits of the search.
    work, others : How the trials are computed, and further training records.
    """
    tunable = [
        network
        for f in forecasters
        if (network := f.network) and network.tunable and _fits(network, record, others)
    ]
    if not tunable:
        return SearchResult([*forecasters], left=budget.core_seconds)
    trials = Trials(record, steps, work, others, budget.core_seconds)
    first, *rest = [candidates(f, record, others) for f in tunable]
    # One short training first: it gives a result, which all other candidates have to beat.
    ladder = trials.run(first[:1], 1.0) + trials.run(first[1:], FIRST_ROUND if rest else 1.0)
    # Then the cheapest candidate of each other network, so that all of them are tried.
    quickest = [sorted(each, key=trials.cost) for each in rest]
    ladder += trials.run([each[0] for each in quickest], FIRST_ROUND + OF_OTHERS)
    promising = [each[1:] for each in quickest if trials.promising(each[0].method)]
    others_first = [c for turn in zip_longest(*promising) for c in turn if c]
    # Changes that helped one by one may help together.
    together = trials.combinations(first[0])
    ladder += trials.run(together + others_first, FIRST_ROUND + OF_OTHERS if rest else 1.0)
    while ladder:
        ladder = trials.run([c for each in trials.promoted(ladder) if (c := each.longer())], 1.0)
    best = {f.name: runs for f in tunable if (runs := trials.best(f.name))}
    left = budget.core_seconds - trials.spent
    final = {name: trials.final(runs, left) for name, runs in best.items()}
    # Networks without an affordable trial are trained with their cheapest candidate.
    soonest = [min(each, key=trials.cost) for each in (first, *rest)]
    final = {each.method: [each.network] for each in soonest} | final
    done = {name: {i: run.done for i, run in enumerate(runs)} for name, runs in best.items()}
    found = SearchResult([*forecasters], tuple(trials.attempts), done, left=left)
    return _chosen(found, final, record, others)


def _fits(network: Network, record: Record, others: Sequence[Record]) -> bool:
    """Return whether a network can be trained on these records; the table says why not."""
    try:
        network.check(record, *others)
    except ValueError:
        return False
    return True


def _chosen(
    found: SearchResult,
    final: Mapping[str, Sequence[Network]],
    record: Record,
    others: Sequence[Record],
) -> SearchResult:
    """Return the result with the networks of the final trainings, and their costs."""
    costs, more, chosen = {}, {}, {}
    for name, (network, *further) in final.items():
        each = [training_cost(one, record, others) for one in (network, *further)]
        costs[name] = sum(each) / len(each)
        # On a long record, held-out errors tell which training is best; others would only make the
        # median worse.
        if len(record) <= SHORT:
            more[name] = training_cost(network.continued(Earlier()), record, others)
        network.by_seed = dict(enumerate(further, 1))
        chosen[name] = network
    return replace(
        found,
        forecasters=[chosen.get(f.name, f) for f in found.forecasters],
        costs=costs,
        members={name: len(networks) for name, networks in final.items()},
        more=more,
    )
