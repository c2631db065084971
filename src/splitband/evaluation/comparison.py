"""Hold the results of forecasters on a record, and which of them is recommended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from splitband.data import Record
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.plan import Plan
from splitband.evaluation.protocols import Run, Runs, median_run
from splitband.evaluation.recommendation import Trial
from splitband.evaluation.setup import Setup
from splitband.evaluation.trials import SearchAttempt
from splitband.forecasters.base import Forecaster
from splitband.forecasters.checking import tests_of, tests_on
from splitband.forecasters.ensemble import fitted_ensemble, over_seeds
from splitband.forecasters.prediction import Prediction
from splitband.forecasters.residuals import ResidualTests
from splitband.metrics import Extrapolation, extrapolations, input_range
from splitband.runtime.provided import provided

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Hold the results of forecasters on a record, and which of them is recommended.

    Attributes
    ----------
    plan : Record, methods and setup of the comparison.
    runs : Runs of each method, one per seed.
    trial : Results on held-out training samples; None without a trial.
    attempts : Attempts of the search for training settings.
    forecasters : The unfitted methods with their chosen settings, by name.
    time : Time that was used, and what was left out for lack of time.
    refit : The recommended method refitted to the whole record, if `Plan.refit`.
    """

    plan: Plan
    runs: Runs
    trial: Trial | None = None
    attempts: tuple[SearchAttempt, ...] = ()
    forecasters: Mapping[str, Forecaster] = field(default_factory=dict)
    time: TimeBudget = field(default_factory=TimeBudget)
    refit: Forecaster | None = None

    @property
    def record(self) -> Record:
        """Return the whole record."""
        return self.plan.record

    @property
    def setup(self) -> Setup:
        """Return the options that the methods share."""
        return self.plan.setup

    @property
    def others(self) -> tuple[Record, ...]:
        """Return the further training records."""
        return self.plan.others

    @property
    def tests(self) -> tuple[Record, ...]:
        """Return the test records, to which nothing was fitted."""
        return self.plan.tests

    @property
    def recommended(self) -> str:
        """Return the name of the method to use, chosen on training samples alone."""
        return self.require_trial().recommended

    @cached_property
    def model(self) -> Forecaster:
        """Return the recommended method as it was trained here, ready to predict and to be saved.

        It is fitted to the training part, with `refit` to the whole record. A network predicts the
        median over its seeds.
        """
        return self.refit or self.trained()

    def trained(self, name: str | None = None) -> Forecaster:
        """Return a method, by default the recommended one, fitted to the training part.

        Raises
        ------
        ValueError
            For a method that is not among those compared, or could not be fitted.
        """
        name = self.recommended if name is None else name
        if not self.runs.models.get(name):
            raise ValueError(f"name must be one of {', '.join(self.runs.models)}, got {name}")
        return fitted_ensemble(self.runs.models[name], self.require_trial().held_out.get(name))

    def forecaster(self, name: str | None = None) -> Forecaster:
        """Return a method with its chosen settings, not fitted, to be fitted to a record and saved.

        A network is the median over the same seeds. Fitted with seed 0 to the training part, a
        method repeats its predictions of this comparison.

        Parameters
        ----------
        name : By default that of the recommended method.

        Raises
        ------
        ValueError
            For a method that is not among those compared, or could not be fitted.
        """
        name = self.recommended if name is None else name
        if name not in self.forecasters:
            raise ValueError(f"name must be one of {', '.join(self.forecasters)}, got {name}")
        return over_seeds(self.forecasters[name], [run.seed for run in self.runs[name]])

    @cached_property
    def medians(self) -> dict[str, Run]:
        """Return the median of each method's runs over its seeds, by name."""
        return {name: median_run(self.plan, runs) for name, runs in self.runs.items()}

    @property
    def left_out(self) -> list[str]:
        """Return the methods that cannot simulate the test records."""
        return [name for name, run in self.medians.items() if self.tests and not run.tests]

    @cached_property
    def predictions(self) -> dict[str, Prediction]:
        """Return the forecast of each method beyond the training part, with its interval."""
        intervals = {} if self.trial is None else self.trial.intervals
        return {
            name: intervals[name].around(run.forecast) if name in intervals else run.forecast
            for name, run in self.medians.items()
            if run.forecast is not None
        }

    @cached_property
    def table(self) -> pd.DataFrame:
        """Return a row for each method, with the columns that `splitband compare` shows.

        Errors are those of the median prediction over seeds, for each channel; columns that end in
        "spread" hold the standard deviation of the seeds' errors.
        """
        table: pd.DataFrame = provided("table")(self)
        return table

    def covers(self, name: str) -> float:
        """Return the share of the forecast's measured samples inside a method's interval, 0 to 1.

        NaN without a forecast.
        """
        errors = self.record.seen[self.setup.train :] - self.medians[name].ahead
        return self.require_trial().intervals[name].coverage(errors) if len(errors) else np.nan

    def coverages(self, name: str) -> tuple[float, ...]:
        """Return `covers` for each channel."""
        errors = self.record.seen[self.setup.train :] - self.medians[name].ahead
        return self.require_trial().intervals[name].coverages(errors)

    def residual_tests(self, name: str | None = None) -> tuple[ResidualTests, ...]:
        """Test the residuals of a method on samples that nothing was fitted to.

        These are those of the first test record, as `Forecaster.check_residuals` tests them, or
        else of the forecast. The result is empty where there are fewer than 2 `LAGS` of them.

        Parameters
        ----------
        name : By default that of the recommended method.
        """
        name = self.recommended if name is None else name
        if name not in self._tested:
            self._tested[name] = self._test_residuals(name)
        return self._tested[name]

    @cached_property
    def _tested(self) -> dict[str, tuple[ResidualTests, ...]]:
        """Return the tests so far, by method, as they may need a simulation."""
        return {}

    def _test_residuals(self, name: str) -> tuple[ResidualTests, ...]:
        run = self.medians[name]
        if run.tests and self.runs.models.get(name):
            return tests_on(self.trained(name), self.tests[0])
        if run.tests:
            return tests_of(self.tests[0], run.tests[0])
        return () if run.forecast is None else tests_of(self.record, run.forecast)

    @property
    def inputs_beyond_training(self) -> list[Extrapolation]:
        """Return the inputs after the training part that exceed their range in training."""
        u, training = self.record.u, [self.plan.training, *self.others]
        seen = [record.u for record in training if record.u is not None]
        return [] if u is None else extrapolations(*input_range(seen), u[self.setup.train :])

    def require_trial(self) -> Trial:
        """Return the trial; raises ValueError where none has been made."""
        if self.trial is None:
            raise ValueError("nothing has been tried on held-out samples in this comparison")
        return self.trial

    def __repr__(self) -> str:
        best = "" if self.trial is None else f", recommended: {self.recommended}"
        return f"<Comparison of {len(self.runs)} methods on {self.record!r}{best}>"

    def __str__(self) -> str:
        """Return the recommendation and the table, which is at most 100 characters wide."""
        text: str = provided("table as text")(self)
        return text

    def _repr_html_(self) -> str:
        """Return the recommendation and the table, for notebooks."""
        html: str = provided("table as HTML")(self)
        return html

    def plot(self) -> Figure:
        """Draw every method's predictions over the record, with intervals."""
        figure: Figure = provided("picture of a comparison")(self)
        return figure

    def save(self, folder: str | Path) -> None:
        """Write all files of `splitband compare`: results, predictions, pictures, the page."""
        provided("results")(self, Path(folder))

    def report(self, path: str | Path) -> None:
        """Write one self-contained HTML file with summary, table, zoomable plots and settings."""
        provided("page of a comparison")(self, path)
