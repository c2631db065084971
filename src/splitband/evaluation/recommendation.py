"""Try methods out on the end of the training part, to recommend one and say how sure it is.

Not in the paper. No measured sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from splitband.data import Record
from splitband.evaluation.jobs import reasons, run_all
from splitband.evaluation.trials import held_out_score
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import (
    Backtest,
    Question,
    for_trial,
    held_out,
    held_out_errors,
    held_out_origins,
    mean_forecasts,
)
from splitband.forecasters.base import Forecaster
from splitband.forecasters.intervals import HeldOut, Interval
from splitband.metrics import channel_rmse

Array = npt.NDArray[np.float64]

LEVEL = 0.9
"""Share of the samples that an interval should hold, 0 to 1. A convention."""
MOST_TRIAL_SEEDS = 2
"""Seeds of each network that are tried out, where more are asked for in the end. It bounds the
time. By eye."""
WORTH_TRAINING = 0.1
"""By how much a network's score must be lower than that of what needs no training. By eye."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Say how each method did on the held-out last quarter of the training samples.

    Of a network that is trained with several seeds, the mean of their forecasts counts.

    Attributes
    ----------
    errors : RMSE of each channel by method, fitted on the rest of the training part: of its
        forecasts to the end of the part, together. See `backtest.held_out_origins`.
    scores : RMSE of all channels together, each scaled to a deviation of 1.
    trained : Which methods are.
    final : What they forecast fitted on the whole training part, the mean of the seeds; see
        `settled`.
    failed : Why methods could not be fitted, now or, after `settled`, on the whole training part.
    left_out : Methods that are not recommended if there is another one: they have nothing to say
        about the test records.
    held_out : Errors of those forecasts and, of what needs no training, of longer ones, by method:
        intervals of any level follow from them.
    early : What each network forecast of the samples after the training part, `(time, ny)` from
        each beginning, fitted on what comes before.
    doubt : After `settled`, by network: the size of its forecast's change since, `(time, ny)`,
        together with the deviation of its seeds.
    """

    errors: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    scores: Mapping[str, float] = field(default_factory=dict)
    trained: frozenset[str] = frozenset()
    final: Mapping[str, Array] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    left_out: frozenset[str] = frozenset()
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)
    early: Mapping[str, Sequence[Array]] = field(default_factory=dict)
    doubt: Mapping[str, Array] = field(default_factory=dict)

    def settled(self, final: Mapping[str, Sequence[Array]], failed: Mapping[str, str]) -> Trial:
        """Return it with what the methods forecast in the end, out of which one is recommended.

        Parameters
        ----------
        final : The forecast `(time, ny)` of each seed of each method.
        failed : Why methods could not be fitted.
        """
        means = {name: np.mean(y, axis=0) for name, y in final.items() if name in self.errors}
        doubt = {}
        for name in self.early.keys() & means:
            change = np.mean([(means[name] - y) ** 2 for y in self.early[name]], axis=0)
            apart = np.var(final[name], axis=0, ddof=1) if len(final[name]) > 1 else 0.0
            doubt[name] = np.sqrt(change + apart)
        return replace(self, final=means, doubt=doubt, failed={**self.failed, **failed})

    def joined(self, other: Trial) -> Trial:
        """Return it with the methods of another trial of the same record."""
        return replace(
            self,
            errors={**self.errors, **other.errors},
            scores={**self.scores, **other.scores},
            trained=self.trained | other.trained,
            failed={**self.failed, **other.failed},
            held_out={**self.held_out, **other.held_out},
            early={**self.early, **other.early},
        )

    @property
    def intervals(self) -> dict[str, Interval]:
        """Return the interval around each method's forecast of the record, for `LEVEL`.

        A network is tried out from one training only, which may have been a lucky one. Its interval
        is at least as wide as its `doubt` calls for.
        """
        found = {name: held_out.interval(LEVEL) for name, held_out in self.held_out.items()}
        return found | {name: found[name].widened(doubt) for name, doubt in self.doubt.items()}

    @property
    def recommended(self) -> str:
        """Return the method of least held-out error; a network needs `WORTH_TRAINING` to win.

        Of two methods that do equally well on a short held-out part, the simpler one is less likely
        to fail later. Counting also how much a forecast changes when the held-out part is learned,
        too, would change the result of one reported record only (docs/results/rules.md).
        """
        names = [*(self.final or self.scores)]
        able = [name for name in names if name not in self.left_out]
        return min(able or names, key=self.worth)

    @property
    def without_result(self) -> dict[str, str]:
        """Return in words why methods have no result, failed or left out."""
        return {name: f"no result: {reason}" for name, reason in self.failed.items()}

    @property
    def best_network(self) -> str | None:
        """Return the network with the lowest score."""
        networks = [method for method in self.scores if method in self.trained]
        return min(networks, key=lambda method: self.scores[method], default=None)

    def worth(self, method: str) -> float:
        """Return what methods are compared by, see `recommended`: the lower the better."""
        return self.scores[method] * (1 + WORTH_TRAINING if method in self.trained else 1.0)


def try_out(
    record: Record,
    forecasters: Sequence[Forecaster],
    steps: int,
    seeds: Sequence[int] = (0,),
    work: Work | None = None,
    others: Sequence[Record] = (),
    done: Mapping[str, Mapping[int, Backtest]] | None = None,
    need_one: bool = True,
) -> Trial:
    """Fit each forecaster to the first part of a training record, to forecast the rest of it.

    Parameters
    ----------
    record : The training record, and nothing else; what is known of the inputs and the
        simulator's output of the `steps` samples after it (`u_beyond`, `beyond`).
    forecasters : With settings and bands. Long training windows shrink with the record.
    steps : How far beyond the record is to be forecast after all.
    seeds, work, others : Of networks, how it is computed, and the further training records.
    done : Forecasts that have been made already, by name and seed.
    need_one : Raise ValueError where nothing could be fitted.
    """
    record, done = replace(record, y_true=None), done or {}
    shorter = [for_trial(f, len(record)) for f in forecasters]
    todo = [f for f in shorter if not done.get(f.name)]
    end = len(record) + steps
    questions = {f.name: Question(record, held_out_origins(f, record), end, others) for f in todo}
    fitted, failures = run_all(
        todo, questions, seeds, work or Work(), need_one=need_one and not any(done.values())
    )
    made = {**done, **fitted}
    forecasts = {f.name: mean_forecasts([*made[f.name].values()]) for f in shorter if made[f.name]}
    trained = frozenset(f.name for f in shorter if f.random)
    return Trial(
        {name: _of_channels(held_out_errors(record, y)) for name, y in forecasts.items()},
        {name: held_out_score(record, [*made[name].values()]) for name in forecasts},
        trained,
        failed=reasons(failures, forecasts),
        held_out={name: held_out(record, y) for name, y in forecasts.items()},
        early={
            name: [y[len(record) - at.at :] for at, y in sorted(forecasts[name].items())]
            for name in trained & forecasts.keys()
        },
    )


def _of_channels(errors: Sequence[Array]) -> tuple[float, ...]:
    """Return the RMSE of each channel, of the errors `(time, ny)` of several forecasts."""
    every = np.concatenate(errors)
    return tuple(map(float, channel_rmse(every, np.zeros_like(every))))
