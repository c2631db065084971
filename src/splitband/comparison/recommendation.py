"""Recommend a method by its forecasts of held-out samples, and give its forecast an interval.

Not in the paper. No measured sample after the training part is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median_low

import numpy as np

from splitband.comparison.backtest import WORTH_TRAINING, Fit, held_out_score, median_forecasts
from splitband.forecasters.held_out import held_out_errors, interval_errors
from splitband.forecasters.intervals import HeldOut, Interval
from splitband.metrics import channel_rmse, rmse, spread
from splitband.records import Record
from splitband.runtime.arrays import Array

COVERAGE = 0.9
"""Share of the samples that an interval should cover, 0 to 1. A convention."""
RULE = (
    "the held-out RMSE in standard deviations, of several outputs the root of the sum of squares; "
    "of unstable networks that of their simulation of the training samples, where larger; "
    f"networks carry a penalty of {100 * WORTH_TRAINING:.0f} %; the lowest score is recommended"
)
"""How methods are ranked, in words."""
FAILED_RATIO = 2.0
"""A training whose error is above this multiple of the usual one of the seeds has failed."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Hold the results of each method on the held-out last quarter of the training samples.

    Networks with several trainings are scored by the median of their forecasts.

    The `doubt` of `held_out` is, for a method that is fitted once for its held-out forecasts, the
    root mean square of the change of its forecast by the final fit, combined with the standard
    deviation over seeds.
    """

    errors: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # RMSE of each channel
    scores: Mapping[str, float] = field(default_factory=dict)  # of all channels, each scaled
    trained: frozenset[str] = frozenset()  # methods that are trained: networks
    final: tuple[str, ...] = ()  # methods with a final fit; only these are recommended
    failed: Mapping[str, str] = field(default_factory=dict)  # why methods could not be fitted
    left_out: frozenset[str] = frozenset()  # not recommended, or as a last resort, see `judged`
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)  # errors, for intervals
    drifting: tuple[str, ...] = ()  # methods whose score is the error of a longer simulation

    @property
    def intervals(self) -> dict[str, Interval]:
        """Return the interval around each method's forecast of the record, for `COVERAGE`."""
        return {name: held_out.interval(COVERAGE) for name, held_out in self.held_out.items()}

    @property
    def recommended(self) -> str:
        """Return the method of least held-out error; a network must win by `WORTH_TRAINING`.

        Of two methods that do equally well on a short held-out part, the simpler one is less likely
        to fail later. A penalty on how much a forecast changes when the held-out part is learned as
        well would change the result of one reported record only (docs/developers/rules.md).
        """
        return self.ranked(self.final or self.scores)[0]

    def ranked(self, methods: Iterable[str]) -> list[str]:
        """Return methods, the best one first; those that are not recommended come last."""
        return sorted(methods, key=lambda name: (name in self.left_out, self.penalized_score(name)))

    @property
    def without_result(self) -> dict[str, str]:
        """Return why methods have no result, in words, by name."""
        return {name: f"no result: {reason}" for name, reason in self.failed.items()}

    def penalized_score(self, method: str) -> float:
        """Return the score by which methods are `ranked`; lower is better."""
        return self.scores[method] * (1 + WORTH_TRAINING if method in self.trained else 1.0)


def by_reason(reasons: Mapping[str, str]) -> list[str]:
    """Return each reason once, after all names that have it."""
    names = dict[str, list[str]]()
    for name, reason in reasons.items():
        names.setdefault(reason, []).append(name)
    return [f"{'; '.join(of)}: {reason}" for reason, of in names.items() if reason]


def judged(
    training: Record,
    held: Mapping[str, Sequence[Fit]],
    final: Mapping[str, Sequence[Fit]],
    failed: Mapping[str, str],
    left_out: frozenset[str] = frozenset(),
    asked: int = 0,
) -> Trial:
    """Return what held-out forecasts and final fits say of each method.

    The held-out part is short: a network that is unstable may forecast it well, and drift away in a
    simulation of all samples that are `asked` for. That of the training samples shows it, so its
    score is at least the error of that, over as many samples (docs/developers/rules.md).

    `held` and `final` are fits to three quarters of the training part, and to all of it. A
    method that is fitted once for its held-out forecasts, as a network is, may have been lucky.
    Its interval is therefore at least as wide as the change of its forecast by the final fit
    requires. Forecasts from many origins show by themselves how they vary. `left_out` are methods
    that cannot simulate test records, or that the user does not want to be recommended.
    """
    held = {name: fits for name, fits in held.items() if fits}
    forecasts = {name: median_forecasts(fits) for name, fits in held.items()}
    trained = frozenset(name for name, fits in held.items() if fits[0].fitted.random)
    finals = {name: fits for name, fits in final.items() if name in held}
    held_out = {name: interval_errors(training, said) for name, said in forecasts.items()}
    once = {
        name
        for name, fits in held.items()
        if not fits[0].fitted.refits and held_out[name].ahead is None
    }
    for name in once & finals.keys():
        ahead = [fit.ahead for fit in finals[name]]
        early = [y[len(training) - at.at :] for at, y in sorted(forecasts[name].items())]
        change = np.mean([(np.median(ahead, axis=0) - y) ** 2 for y in early], axis=0)
        apart = np.var(ahead, axis=0, ddof=1) if len(ahead) > 1 else 0.0
        held_out[name] = replace(held_out[name], doubt=np.sqrt(change + apart))
    scores = {name: held_out_score(training, fits) for name, fits in held.items()}
    longer = {
        name: _from_start(finals[name], training, asked)
        for name in (trained & finals.keys() if asked else ())
        if not all(fit.report.stable for fit in finals[name])
    }
    drifting = tuple(sorted(name for name in longer if longer[name] > scores[name]))
    scores |= {name: longer[name] for name in drifting}
    return Trial(
        {name: _of_channels(held_out_errors(training, said)) for name, said in forecasts.items()},
        scores,
        trained,
        tuple(finals),
        failed,
        left_out,
        held_out,
        drifting,
    )


def without_failed(training: Record, fits: Sequence[Fit]) -> list[Fit]:
    """Return the fits of a method without the trainings that failed; the first names those.

    A training fails if it is unstable, or by its error in simulating the training record from the
    start, which is compared with the median, of two seeds with the lower one. The lowest of many
    may be that of a training that has learned the noise. If all failed, all are kept.
    """
    if not fits or not fits[0].fitted.random:
        return [*fits]
    errors = [_from_start([fit], training) for fit in fits]
    stable = [error for fit, error in zip(fits, errors, strict=True) if fit.report.stable]
    usual = median_low(stable or errors)
    kept, said = list[Fit](), list[str]()
    for fit, error in zip(fits, errors, strict=True):
        if not fit.report.stable:
            said.append(f"seed {fit.seed} left out: it is unstable, and may grow without bound")
        elif usual and error > FAILED_RATIO * usual:
            times = f"{error / usual:.3g}"
            said.append(f"seed {fit.seed} left out: training error {times} times the usual one")
        else:
            kept.append(fit)
    if not kept:
        kept, said = [*fits], [fits[0].report.unstable()]
    return [replace(kept[0], notes=(*kept[0].notes, *said)), *kept[1:]]


def _from_start(fits: Sequence[Fit], training: Record, samples: int | None = None) -> float:
    """Return the RMSE of the simulation of the first training samples, channels scaled; 0 if empty.

    It is the median of several fits.
    """
    forecasts = median_forecasts(fits)
    at = min(origin.at for origin in forecasts)
    seen, scale = training.y_with_gaps[at:][:samples], spread(training.y_with_gaps)
    y = next(y for origin, y in forecasts.items() if origin.at == at)[: len(seen)]
    return rmse(seen / scale, y / scale) if len(y) else 0.0


def _of_channels(errors: Sequence[Array]) -> tuple[float, ...]:
    """Return the RMSE of each channel over the errors `(time, ny)` of several forecasts."""
    every = np.concatenate(errors)
    return tuple(map(float, channel_rmse(every, np.zeros_like(every))))
