"""Hold the results of forecasters on a record, and which of them is recommended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from splitband.checks.model import runs_free, tests_of, tests_on
from splitband.checks.residuals import ResidualTests
from splitband.comparison.backtest import Fit
from splitband.comparison.clock import Clock
from splitband.comparison.plan import Plan
from splitband.comparison.recommendation import Trial
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import fitted_ensemble
from splitband.forecasters.held_out import Origin, distinct_samples
from splitband.forecasters.intervals import Misfit
from splitband.forecasters.prediction import Prediction, median_of
from splitband.metrics import Extrapolation, extrapolations, input_range, leaves_range, rmse
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from splitband.comparison.search import Attempt
    from splitband.report.table import Column, Table


@dataclass(frozen=True)
class Errors:
    """The RMSE of predictions, in the record's unit."""

    total: float  # from the start
    forecast: float  # of the forecast; NaN where the training part is the whole record
    tests: tuple[float, ...] = ()  # empty for methods that cannot simulate other records


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The results of a comparison: the recommended model, a table, a report, plots.

    Attributes
    ----------
    model : The recommended method, trained, ready to predict, to be saved and to be exported.
    recommended : Its name.
    table : A data frame with a row for each method.
    plan : Record, methods and settings of the comparison.
    fits : Final fits of each method, one for each seed; of an interrupted comparison perhaps those
        of networks that were trained on three quarters of the training part.
    trial : Results on held-out training samples; None without a trial.
    attempts : All trainings of the search, round by round.
    clock : Time that was used, and what the deadline has changed.
    refit : The recommended method refitted to the whole record, if `Plan.refit`.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> result = sb.compare(record, 300, [sb.Mean(), sb.Harmonic()])
    >>> result.recommended, result.model.predict(100).y.shape
    ('harmonic', (100, 1))
    >>> list(result.table.index)
    ['harmonic', 'mean']
    >>> result.report("rig.html")  # doctest: +SKIP
    >>> result.model.export("rig.fmu")  # doctest: +SKIP
    """

    plan: Plan
    fits: Mapping[str, Sequence[Fit]]
    trial: Trial | None = None
    attempts: tuple[Attempt, ...] = ()
    clock: Clock = field(default_factory=Clock)
    refit: Forecaster | None = None

    @cached_property
    def model(self) -> Forecaster:
        """Return the recommended method as it was trained here, ready to predict and to be saved.

        It is fitted to the training part, with `refit` to the whole record. A network predicts the
        median over its trainings.
        """
        return self.refit or self.trained()

    @property
    def recommended(self) -> str:
        """Return the name of the method to use, chosen on training samples alone."""
        return self.require_trial().recommended

    @cached_property
    def table(self) -> pd.DataFrame:
        """Return a row for each method, with the columns that `splitband compare` shows.

        Errors are those of the median prediction over seeds, for each channel; columns that end in
        "spread" hold the standard deviation of the seeds' errors.
        """
        return self._as_table().to_frame()

    def report(self, path: str | Path) -> None:
        """Write one self-contained HTML file with summary, table, zoomable plots and settings."""
        from splitband.report.page.document import of_comparison  # noqa: PLC0415  of a higher layer

        of_comparison(self, path)

    def plot(self) -> Figure:
        """Draw every method's predictions over the record, with intervals."""
        from splitband.report.pictures import rollouts  # noqa: PLC0415  of a higher layer

        return rollouts(self)

    def save(self, folder: str | Path) -> None:
        """Write all files of `splitband compare`: results, predictions, the page, the model."""
        from splitband.report.results import save  # noqa: PLC0415  of a higher layer

        save(self, Path(folder))

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C ended the comparison early."""
        return self.clock.interrupted

    @property
    def record(self) -> Record:
        """Return the whole record."""
        return self.plan.record

    @property
    def others(self) -> tuple[Record, ...]:
        """Return the further training records."""
        return self.plan.others

    @property
    def tests(self) -> tuple[Record, ...]:
        """Return the test records, to which nothing was fitted."""
        return self.plan.tests

    @property
    def warnings(self) -> list[str]:
        """Return what seems wrong in the records, a sentence each; see `Record.warnings`."""
        return self.plan.warnings

    @property
    def methods(self) -> dict[str, Forecaster]:
        """Return the methods by name, not fitted."""
        return {method.name: method for method in self.plan.methods}

    def trained(self, name: str | None = None) -> Forecaster:
        """Return a method, by default the recommended one, fitted to the training part.

        Raises
        ------
        ValueError
            For a method that is not among those compared, or could not be fitted.
        """
        name = self.recommended if name is None else name
        if name not in self.fits:
            raise InputError(f"name must be one of {', '.join(self.fits)}, got {name}")
        models = [fit.fitted for fit in self.fits[name]]
        return fitted_ensemble(models, self.require_trial().held_out.get(name))

    @cached_property
    def medians(self) -> dict[str, Fit]:
        """Return the median of each method's predictions over its trainings, by name."""
        return {name: median_fit(fits) for name, fits in self.fits.items()}

    def errors(self, fit: Fit) -> Errors:
        """Return the errors of predictions, against the noise-free truth where it is known."""
        truth = self.record.truth
        total = rmse(truth[-len(fit.from_start) :], fit.from_start.y)
        ahead = rmse(truth[self.plan.train :], fit.ahead) if fit.forecast is not None else np.nan
        of_tests = zip(self.tests if fit.tests else (), fit.tests, strict=True)
        return Errors(total, ahead, tuple(rmse(t.truth[-len(p) :], p.y) for t, p in of_tests))

    def leaves(self, name: str) -> int | None:
        """Return the samples of a method's forecasts before one leaves the training range.

        None where none does; see `metrics.leaves_range`.
        """
        fits = [fit for fit in self.fits[name] if fit.forecast is not None]
        left = [leaves_range(fit.fitted.require_fitted().y_range, fit.ahead) for fit in fits]
        return min((samples for samples in left if samples is not None), default=None)

    @property
    def left_out(self) -> list[str]:
        """Return the methods that cannot simulate the test records."""
        return [name for name, fit in self.medians.items() if self.tests and not fit.tests]

    @cached_property
    def predictions(self) -> dict[str, Prediction]:
        """Return the forecast of each method beyond the training part, with its interval.

        An interval of forecasts `Plan.ahead` is none of this free run.
        """
        unknown = self.trial is None or self.plan.ahead is not None
        intervals = {} if unknown else self.require_trial().intervals
        return {
            name: intervals[name].around(fit.forecast) if name in intervals else fit.forecast
            for name, fit in self.medians.items()
            if fit.forecast is not None
        }

    @cached_property
    def shown(self) -> dict[str, list[Column]]:
        """Return the columns of tables so far, by heading."""
        return {}

    def covers(self, name: str) -> float:
        """Return the share of the forecast's measured samples inside a method's interval, 0 to 1.

        With `Plan.ahead` these are all forecasts from many origins. NaN without a forecast.
        """
        errors, _ = self._errors_ahead(name)
        return self.require_trial().intervals[name].coverage(*errors) if errors else np.nan

    def coverages(self, name: str) -> tuple[float, ...]:
        """Return `covers` for each channel; empty without a forecast."""
        errors, _ = self._errors_ahead(name)
        return self.require_trial().intervals[name].coverages(*errors) if errors else ()

    def misfits(self, name: str) -> tuple[Misfit, ...]:
        """Return whether a method's interval is too narrow or too wide, for each channel."""
        errors, distinct = self._errors_ahead(name)
        interval = self.require_trial().intervals[name]
        return interval.misfits(*errors, distinct=distinct) if errors else ()

    def judging(self, name: str) -> list[tuple[Record, Mapping[Origin, Prediction]]]:
        """Return a method's forecasts that judge it on unseen samples, by record.

        This is the one after the training part or, with `Plan.ahead`, those from many origins after
        it and, by methods that can simulate them, in test records.
        """
        fit, train = self.medians[name], self.plan.train
        own = {origin: said for origin, said in fit.forecasts.items() if origin.steps}
        if self.plan.ahead is None and fit.forecast is not None:
            own = {Origin(train, train): fit.forecast}
        of_tests = zip(self.tests, fit.tests_ahead, strict=False)
        return [*of_tests, *([(self.record, own)] if own else [])]

    def steps_of_interval(self, name: str) -> int:
        """Return how many samples a method's interval is judged for; 0 without a forecast."""
        return max((len(p) for _, made in self.judging(name) for p in made.values()), default=0)

    def _errors_ahead(self, name: str) -> tuple[list[Array], int | None]:
        """Return the errors of the forecasts that judge a method, and their distinct samples."""
        every = self.judging(name)
        errors = [
            record.y_with_gaps[origin.at : origin.at + len(said)] - said.y
            for record, made in every
            for origin, said in made.items()
        ]
        return errors, sum(distinct_samples(made) or 0 for _, made in every) or None

    @cached_property
    def residual_tests(self) -> tuple[ResidualTests, ...]:
        """Return tests of the recommended method's residuals on samples that nothing was fitted to.

        These are those of the first test record, as `check` tests them, or else of the forecast.
        There is none where there are fewer than 2 `LAGS` of them, and with `Plan.ahead`, as they
        are residuals of a simulation.
        """
        if self.plan.ahead is not None:
            return ()
        fit = self.medians[self.recommended]
        if fit.tests:
            return tests_on(self.trained(), self.tests[0])
        if fit.forecast is None or not runs_free(fit.fitted, fit.forecast.y):
            return ()
        return tests_of(self.record, fit.forecast, late=False)

    @property
    def inputs_beyond_training(self) -> list[Extrapolation]:
        """Return the inputs after the training part that exceed their range in training."""
        u, training = self.record.u, [self.plan.training, *self.others]
        seen = [record.u for record in training if record.u is not None]
        return [] if u is None else extrapolations(*input_range(seen), u[self.plan.train :])

    def require_trial(self) -> Trial:
        """Return the trial; raises ValueError where none has been made."""
        if self.trial is None:
            raise InputError("nothing has been tried on held-out samples in this comparison")
        return self.trial

    def __repr__(self) -> str:
        best = "" if self.trial is None else f", recommended: {self.recommended}"
        ended = ", interrupted" if self.interrupted else ""
        return f"<Comparison of {len(self.fits)} methods on {self.record!r}{best}{ended}>"

    def __str__(self) -> str:
        """Return the recommendation and the table, which is at most 100 characters wide."""
        return f"{self!r}\n\n{self._as_table().as_text()}"

    def _repr_html_(self) -> str:
        """Return the recommendation and the table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self._as_table().as_html()}"

    def _as_table(self) -> Table:
        """Return the table that `splitband compare` prints, without its title."""
        from splitband.report.tables import of_comparison  # noqa: PLC0415  of a higher layer

        return replace(of_comparison(self), title="")


def median_fit(fits: Sequence[Fit]) -> Fit:
    """Return the median prediction over several fits of a method."""
    first = fits[0]
    if len(fits) == 1:
        return first
    forecasts = {
        origin: median_of([fit.forecasts[origin] for fit in fits]) for origin in first.forecasts
    }
    tests = [median_of(each) for each in zip(*(f.tests for f in fits), strict=True)]
    tests_ahead = [
        {origin: median_of([of[origin] for of in each]) for origin in each[0]}
        for each in zip(*(f.tests_ahead for f in fits), strict=True)
    ]
    both: dict[str, Any] = {"tests": tests, "tests_ahead": tests_ahead}
    return replace(first, forecasts=forecasts, **both, seconds=sum(f.seconds for f in fits))
