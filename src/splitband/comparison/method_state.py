"""Hold how far each method of a comparison is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from splitband.comparison.backtest import Fit
from splitband.comparison.jobs import Job
from splitband.forecasters.base import Forecaster


@dataclass(eq=False)
class MethodState:
    """Hold a method of a comparison, and how far it is.

    Attributes
    ----------
    method : As planned, with its own simulator.
    ready : The same with its simulator run and, once networks are trained, its cells built; None
        where the simulator fails.
    job : Of a method without networks the job that has begun and not ended.
    trial : Fits to three quarters of the training part.
    final : Fits by their jobs: to the whole training part or, where none of these has a model,
        those of the trial with forecasts beyond the training part.
    failure : The last fit that has no model.
    """

    method: Forecaster
    ready: Forecaster | None = None
    job: Job | None = None
    trial: Sequence[Fit] = ()
    final: dict[Job, Fit] = field(default_factory=dict)
    failure: Fit | None = None

    @property
    def note(self) -> str:
        """Return in words why results are of a fit to three quarters, if they are."""
        if all(job.trains for job in self.final):
            return ""
        how, why = "trained on" if self.method.random else "fitted to", reason_of(self.failure)
        said = f"could not be {how} the whole training part {why}"
        return f"{said}; its results are those of a model {how} three quarters of it"

    def end(self, fits: Mapping[Job, Fit]) -> None:
        """Take the fits of all final trainings; a note names those without a model."""
        self.final = {job: fit for job, fit in fits.items() if fit.model is not None}
        failed = [fit for fit in fits.values() if fit.model is None]
        if not self.final:
            self.failure = failed[-1]
        elif failed:
            said = [f"seed {f.seed} {'' if f.cut else 'failed: '}{f.failure}" for f in failed]
            job, first = next(iter(self.final.items()))
            self.final[job] = replace(first, notes=(*first.notes, *said))


def reason_of(failure: Fit | None) -> str:
    """Return in words why a fit could not be made; None and one that was cut: for lack of time."""
    return "in time" if failure is None or failure.cut else f"({failure.failure})"
