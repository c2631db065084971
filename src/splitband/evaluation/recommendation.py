"""Score methods on the held-out end of the training part, to recommend one, with its interval.

Not in the paper. No measured sample after the training part is used.
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
    held_out_errors,
    held_out_origins,
    interval_errors,
    median_forecasts,
)
from splitband.forecasters.base import Forecaster
from splitband.forecasters.intervals import HeldOut, Interval
from splitband.metrics import channel_rmse

Array = npt.NDArray[np.float64]

LEVEL = 0.9
"""Share of the samples that an interval should cover, 0 to 1. A convention."""
MOST_TRIAL_SEEDS = 2
"""Largest number of seeds of each network in the trial, which bounds its time. By eye."""
WORTH_TRAINING = 0.1
"""Share of its score by which a network must beat a baseline. By eye."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Hold the results of each method on the held-out last quarter of the training samples.

    Networks with several seeds are scored by the median of their forecasts.

    Attributes
    ----------
    errors : RMSE of each channel, by method: of all forecasts to the end of the training part, by
        a fit to the samples before. See `backtest.held_out_origins`.
    scores : RMSE of all channels together, each scaled to a standard deviation of 1.
    trained : Methods that are trained: networks.
    final : Median forecast over the seeds by each method fitted to the whole training part; see
        `settled`.
    failed : Why methods could not be fitted, now or, after `settled`, on the whole training part.
    left_out : Methods that cannot simulate the test records; they are recommended only if there is
        no other.
    held_out : Errors of these forecasts by method, for baselines also of earlier, longer ones:
        intervals of any level are computed from them. After `settled`, their `doubt` is, for a
        network, the root mean square of the change from `early` to `final`, combined with the
        standard deviation over seeds.
    early : Forecasts of the samples after the training part by each network fitted to the first
        three quarters, `(time, ny)`, one for each held-out origin.
    """

    errors: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    scores: Mapping[str, float] = field(default_factory=dict)
    trained: frozenset[str] = frozenset()
    final: Mapping[str, Array] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)
    left_out: frozenset[str] = frozenset()
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)
    early: Mapping[str, Sequence[Array]] = field(default_factory=dict)

    def settled(self, final: Mapping[str, Sequence[Array]], failed: Mapping[str, str]) -> Trial:
        """Return the trial with the final forecasts; only methods that have one are recommended.

        A network is trained only once for the trial, and may have been lucky. Its interval is
        therefore at least as wide as the change of its forecast by the final training requires.

        Parameters
        ----------
        final : The forecast `(time, ny)` of each seed of each method.
        failed : Why methods could not be fitted.
        """
        medians = {name: np.median(y, axis=0) for name, y in final.items() if name in self.errors}
        held_out = {**self.held_out}
        for name in self.early.keys() & medians:
            change = np.mean([(medians[name] - y) ** 2 for y in self.early[name]], axis=0)
            apart = np.var(final[name], axis=0, ddof=1) if len(final[name]) > 1 else 0.0
            held_out[name] = replace(held_out[name], doubt=np.sqrt(change + apart))
        failed = {**self.failed, **failed}
        return replace(self, final=medians, held_out=held_out, failed=failed)

    def joined(self, other: Trial) -> Trial:
        """Return the trial with the methods of another trial of the same record added."""
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
        """Return the interval around each method's forecast of the record, for `LEVEL`."""
        return {name: held_out.interval(LEVEL) for name, held_out in self.held_out.items()}

    @property
    def recommended(self) -> str:
        """Return the method of least held-out error; a network must win by `WORTH_TRAINING`.

        Of two methods that do equally well on a short held-out part, the simpler one is less likely
        to fail later. A penalty on how much a forecast changes when the held-out part is learned as
        well would change the result of one reported record only (docs/results/rules.md).
        """
        names = [*(self.final or self.scores)]
        able = [name for name in names if name not in self.left_out]
        return min(able or names, key=self.worth)

    @property
    def without_result(self) -> dict[str, str]:
        """Return why methods have no result, in words, by name."""
        return {name: f"no result: {reason}" for name, reason in self.failed.items()}

    @property
    def best_network(self) -> str | None:
        """Return the network with the lowest score."""
        networks = [method for method in self.scores if method in self.trained]
        return min(networks, key=lambda method: self.scores[method], default=None)

    def worth(self, method: str) -> float:
        """Return the score by which methods are ranked in `recommended`; lower is better."""
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
    record : The training part alone, with the inputs and simulator output that are known for the
        `steps` samples after it (`u_beyond`, `beyond`).
    forecasters : With settings and bands. Long training windows shrink with the record.
    steps : Samples beyond the record that the final forecast covers.
    seeds, work, others : Seeds of networks, how to compute, and further training records.
    done : Forecasts that exist already, by name and seed.
    need_one : Raise ValueError if no forecaster could be fitted.
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
    forecasts = {
        f.name: median_forecasts([*made[f.name].values()]) for f in shorter if made[f.name]
    }
    trained = frozenset(f.name for f in shorter if f.random)
    return Trial(
        {name: _of_channels(held_out_errors(record, y)) for name, y in forecasts.items()},
        {name: held_out_score(record, [*made[name].values()]) for name in forecasts},
        trained,
        failed=reasons(failures, forecasts),
        held_out={name: interval_errors(record, y) for name, y in forecasts.items()},
        early={
            name: [y[len(record) - at.at :] for at, y in sorted(forecasts[name].items())]
            for name in trained & forecasts.keys()
        },
    )


def _of_channels(errors: Sequence[Array]) -> tuple[float, ...]:
    """Return the RMSE of each channel over the errors `(time, ny)` of several forecasts."""
    every = np.concatenate(errors)
    return tuple(map(float, channel_rmse(every, np.zeros_like(every))))
