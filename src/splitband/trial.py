"""Trying methods out on the end of the training part: which to recommend, and how sure it is.

Not in the paper. No sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from splitband.bands import Band
from splitband.comparison import RunProgress, compare
from splitband.data import Trajectory
from splitband.methods import FIXED, Setup, check
from splitband.metrics import rmse, spread
from splitband.training import Settings

Array = npt.NDArray[np.float64]

HELD_OUT = 0.25
"""Share of the training part by which the recommended method is chosen."""
WORTH_TRAINING = 0.1
"""By how much a network's held-out error must be lower than that of what needs no training."""


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
    """What the methods did on the held-out part of the training samples.

    Attributes
    ----------
    errors : RMSE of each method, fitted on the rest of the training part: of its forecasts to the
        end of the part from its beginning, from a third and from two thirds of it, together.
    scores : The same of channels scaled to a deviation of 1, by which methods are compared.
    bands : Around each method's forecast of the record, from those forecasts.

    All of it is of one training of each network, with seed 0.
    """

    errors: Mapping[str, float]
    scores: Mapping[str, float]
    bands: Mapping[str, Band]

    @property
    def recommended(self) -> str:
        """The method with the lowest score; a network has to be better by `WORTH_TRAINING`.

        Held-out parts are short: of two methods that do equally well there, the simpler one is the
        safer.
        """
        return min(
            self.scores,
            key=lambda m: self.scores[m] * (1 if m in FIXED else 1 + WORTH_TRAINING),
        )


def try_out(
    record: Trajectory,
    methods: Sequence[str],
    setup: Setup,
    jobs: int = 1,
    progress: Callable[[RunProgress], None] | None = None,
) -> Trial:
    """Fit each method on the first part of the training samples and forecast the rest of them.

    Arguments as for `compare`; samples after the training part are not looked at.
    """
    part, shorter = hold_out(record, setup)
    held = len(part) - shorter.train
    # One beginning may suit a method by chance: the last sample, held, is now and then the mean.
    later = sorted({shorter.train + i * held // 3 for i in (1, 2)} - {shorter.train})
    runs = compare(part, methods, shorter, (0,), jobs, progress, later)
    left = {
        method: [
            part.y[start:] - forecast
            for start, forecast in {shorter.train: r.forecast, **r.later}.items()
        ]
        for method, (r,) in runs.items()
    }
    scale = spread(part.y)

    def size(errors: Sequence[Array]) -> float:
        every = np.concatenate(errors)
        return rmse(every, np.zeros_like(every))

    return Trial(
        {m: size(e) for m, e in left.items()},
        {m: size([error / scale for error in e]) for m, e in left.items()},
        {m: Band.fit(e, part.y) for m, e in left.items()},
    )


def check_trial(record: Trajectory, methods: Sequence[str], setup: Setup) -> None:
    """Find what is wrong with `try_out` before anything is computed."""
    part, shorter = hold_out(record, setup)
    try:
        check(part, methods, shorter)
    except ValueError as error:
        raise ValueError(
            f"{error} (a method is chosen on the last quarter of the {setup.train} training "
            "samples, trained on the rest)"
        ) from None
