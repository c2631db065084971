"""Trying methods out on the end of the training part: which to recommend, and how sure it is.

Not in the paper. No measured sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from splitband.comparison import Run, RunProgress, Runs, ahead_of, compare
from splitband.data import Trajectory
from splitband.intervals import Interval
from splitband.methods import FIXED, Setup, check
from splitband.metrics import rmse, spread
from splitband.training import Settings

Array = npt.NDArray[np.float64]

LEAST_FITTED = 20
"""Measured samples of each channel that a baseline is fitted to for the intervals."""
FAILED = 5.0
"""Times the usual error of a method's first forecast samples: such a fit says nothing of others."""
HELD_OUT = 0.25
"""Share of the training part by which the recommended method is chosen."""
CUTS = (0.25, 0.2, 0.15, 0.1)
"""Such shares for what needs no training and is fitted again for each, the first as above."""
LONGER_CUTS = (0.5, 0.375)
"""More of them for the intervals alone: how errors grow shows over long horizons."""
TRIED = 2
"""Seeds of each network that are tried out, where more are asked for in the end."""
WORTH_TRAINING = 0.1
"""By how much a network's score must be lower than that of what needs no training."""
CHANGE_COUNTS = 0.5
"""How much of a forecast's squared change is an error: two forecasts that are equally far from the
truth, in ways of their own, differ by twice the square of that."""


def hold_out(record: Trajectory, setup: Setup) -> tuple[Trajectory, Setup]:
    """The training part as a record of its own, its last `HELD_OUT` to be predicted from the rest.

    What a method does there can be known without a look at later samples. Training windows shrink
    with the training part.
    """
    train = setup.train - max(1, round(HELD_OUT * setup.train))

    def shorter(settings: Settings) -> Settings:
        window = round(settings.window * (1 - HELD_OUT))
        return replace(settings, window=min(max(window, settings.warmup + 1), settings.window))

    overrides = {name: shorter(settings) for name, settings in setup.overrides.items()}
    setup = replace(setup, settings=shorter(setup.settings), overrides=overrides)
    part = replace(record[: setup.train], y_true=None)
    return part, replace(setup, train=train)


@dataclass(frozen=True, eq=False)
class Trial:
    """What the methods did on the held-out part of the training samples; several seeds' mean did.

    Attributes
    ----------
    errors : RMSE of each method, fitted on the rest of the training part: of its forecasts to the
        end of the part, together. A network's are from its beginning, from a third and from two
        thirds of it, those of what needs no training from each of `CUTS`, to which it is fitted.
    scores : The same of channels scaled to a deviation of 1.
    intervals : Around each method's forecast of the record; from those forecasts and, for what
        needs no training, longer ones (`LONGER_CUTS`).
    early : What each method forecast of the samples after the training part, `(time, ny)`, fitted
        on all but `HELD_OUT` of it.
    scale : By which the channels are scaled, `(ny,)`.
    final : The same, once it is fitted on the whole training part; see `settled`.
    failed : Why methods could not be fitted, now or, after `settled`, on the whole training part.
    """

    errors: Mapping[str, float]
    scores: Mapping[str, float]
    intervals: Mapping[str, Interval]
    early: Mapping[str, Array]
    scale: Array
    final: Mapping[str, Array] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)

    def settled(self, runs: Runs) -> Trial:
        """With what the methods forecast after all, out of which one is recommended.

        The held-out part is short: a method may do well there and not know what comes much later.
        Then its forecast changes once it has seen all of the training part, by more than its errors
        explain, and its interval becomes wider. A smaller change holds the same errors once more,
        the noise that both forecasts repeat for instance, and widens nothing.
        """
        final = {
            m: np.mean([r.forecast for r in of_m], axis=0)
            for m, of_m in runs.items()
            if m in self.early
        }
        part = float(np.sqrt(CHANGE_COUNTS))
        changes = {m: part * (final[m] - self.early[m]) for m in final}
        intervals = {m: self.intervals[m].widened(change) for m, change in changes.items()}
        return replace(
            self, final=final, intervals=intervals, failed={**self.failed, **runs.failed}
        )

    def change(self, method: str) -> float:
        """RMSE between a method's early and final forecast, in the record's unit."""
        return _size([self.final[method] - self.early[method]])

    @property
    def recommended(self) -> str:
        """The method whose early forecast was least wrong; a network's by `WORTH_TRAINING`.

        How wrong it was on the held-out part is its score. Of what comes later nothing is known but
        by how much the forecast has changed since. A change no larger than the score is what
        learning from the held-out part looks like and is no fault; a larger one says that the early
        forecast was worse there. So the larger of the two counts, the change by `CHANGE_COUNTS`.

        Of two methods that do equally well on short held-out parts, the simpler one is the safer.
        """
        return min(self.final or self.scores, key=self._worth)

    @property
    def best_network(self) -> str | None:
        """Of the networks, the one with the lowest score."""
        networks = [method for method in self.scores if method not in FIXED]
        return min(networks, key=lambda method: self.scores[method], default=None)

    def _worth(self, method: str) -> float:
        change = 0.0
        if method in self.final:
            change = _size([(self.final[method] - self.early[method]) / self.scale])
        needed = 1.0 if method in FIXED else 1 + WORTH_TRAINING
        return max(self.scores[method], float(np.sqrt(CHANGE_COUNTS)) * change) * needed


def try_out(
    record: Trajectory,
    methods: Sequence[str],
    setup: Setup,
    seeds: Sequence[int] = (0,),
    jobs: int = 1,
    progress: Callable[[RunProgress], None] | None = None,
    checkpoints: Path | None = None,
    more: Sequence[Trajectory] = (),
) -> Trial:
    """Fit each method on the first part of the training samples and forecast the rest of them.

    Arguments and errors as for `compare`; no measured sample after the training part is looked at.
    """
    part, shorter = hold_out(record, setup)
    held = len(part) - shorter.train
    u = None if record.u is None else record.u[setup.train :]
    longer = ahead_of(part, len(record) - setup.train, u)
    # One beginning may suit a method by chance: the last sample, held, is now and then the mean.
    later = sorted({shorter.train + i * held // 3 for i in (1, 2)} - {shorter.train})
    cuts = sorted({len(part) - max(1, round(share * len(part))) for share in CUTS})
    cuts += _longer_cuts(part)
    runs = compare(longer, methods, shorter, seeds, jobs, progress, later, checkpoints, more, cuts)
    forecasts = {method: _forecasts(of_method, shorter.train) for method, of_method in runs.items()}
    seen, scale = part.seen, spread(part.seen)
    left = {
        method: {
            start: seen[start:] - forecast[: len(part) - start]
            for start, forecast in of_method.items()
        }
        for method, of_method in forecasts.items()
    }
    scored = {m: [e for at, e in of_m.items() if at >= shorter.train] for m, of_m in left.items()}
    longer_ones = {
        m: [e for at, e in sorted(of_m.items(), reverse=True) if at < shorter.train]
        for m, of_m in left.items()
    }
    return Trial(
        {m: _size(e) for m, e in scored.items()},
        {m: _size([error / scale for error in e]) for m, e in scored.items()},
        {m: Interval.fit(_sound(scored[m], longer_ones[m], scale), seen) for m in left},
        {m: of_m[shorter.train][held:] for m, of_m in forecasts.items()},
        scale,
        failed=runs.failed,
    )


def _sound(scored: Sequence[Array], longer: Sequence[Array], scale: Array) -> list[Array]:
    """All errors, but no `longer` ones from the first fit on that failed for want of samples.

    `longer` begins with the fit to the most samples. A fit that does not know the record's period
    yet is wrong from its first forecast samples on; growth alone shows later.
    """
    near = min(map(len, scored))
    usual = _size([e[:near] / scale for e in scored])
    sound = [_size([e[:near] / scale]) <= FAILED * usual for e in longer]
    return [*scored, *longer[: [*sound, False].index(False)]]


def _longer_cuts(part: Trajectory) -> list[int]:
    """By `LONGER_CUTS`, where there is enough before them to fit a baseline to."""
    cuts = [len(part) - round(share * len(part)) for share in LONGER_CUTS]
    measured = ~np.isnan(part.seen)
    return [cut for cut in cuts if (measured[:cut].sum(axis=0) >= LEAST_FITTED).all()]


def _forecasts(runs: Sequence[Run], begin: int) -> dict[int, Array]:
    """The mean over seeds, by the index of the first sample."""
    found = {begin: np.mean([r.forecast for r in runs], axis=0)}
    for start in runs[0].later:
        found[start] = np.mean([r.later[start] for r in runs], axis=0)
    return found


def _size(errors: Sequence[Array]) -> float:
    every = np.concatenate(errors)
    return rmse(every, np.zeros_like(every))


def check_trial(
    record: Trajectory, methods: Sequence[str], setup: Setup, more: Sequence[Trajectory] = ()
) -> None:
    """Find what is wrong with `try_out` before anything is computed."""
    part, shorter = hold_out(record, setup)
    try:
        check(part, methods, shorter, more)
    except ValueError as error:
        raise ValueError(
            f"{error} (a method is chosen on the last quarter of the {setup.train} training "
            "samples, trained on the rest)"
        ) from None
