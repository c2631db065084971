"""Run a plan: quick methods, rounds of the search, final trainings, recommendation, result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from splitband.comparison.backtest import BacktestSpec, Fit
from splitband.comparison.clock import (
    BASELINE_SHARE,
    MOST_OF_BASELINE,
    MOST_OF_TIME_LEFT,
    Clock,
)
from splitband.comparison.jobs import GRACE, LATE, Bases, Job, Runner, held_out_job
from splitband.comparison.methods import BASES, built
from splitband.comparison.plan import Plan, plan
from splitband.comparison.recommendation import Trial, by_reason, judged, without_failed
from splitband.comparison.result import Comparison
from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import fitted_ensemble
from splitband.forecasters.held_out import HELD_OUT_SHARE, Origin, beginning
from splitband.forecasters.network import Network
from splitband.forecasters.simulation import with_simulators_of, with_simulators_run
from splitband.runtime.deadlines import NEVER, Deadline, within
from splitband.runtime.errors import InputError
from splitband.runtime.memory import return_freed
from splitband.runtime.threads import one_thread

if TYPE_CHECKING:
    from splitband.comparison.search import Search
    from splitband.training import Progress


Watch = Callable[["RunningComparison"], None]


def compare(
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    **options: Any,
) -> Comparison:
    """Compare forecasters on a record, as `splitband compare` does: `run(plan(record, ...))`.

    Each one is fitted to the first `train` samples and, for the recommendation, to three quarters
    of them. Ctrl-C ends it early with the results so far. With `train=len(record)`,
    `result.model.predict(steps, level=0.9)` forecasts what comes after the record.

    Parameters
    ----------
    record, train, methods : See `plan`.
    cores, executor, watch : See `run`.
    options : Further arguments of `plan`, such as budget, seed, tests, settings.

    Raises
    ------
    ValueError
        As `plan`, before anything is computed; and if no method can be fitted.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> result = sb.compare(record, 300, [sb.Mean(), sb.Persistence(), sb.Harmonic()])
    >>> result.recommended
    'harmonic'
    >>> list(result.table["forecast fit %"].round(1))
    [100.0, -0.3, -77.9]
    """
    planned = plan(record, train, methods, **options)
    return run(planned, cores=cores, executor=executor, watch=watch)


def run(
    plan: Plan,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    clock: Clock | None = None,
) -> Comparison:
    """Run a planned comparison.

    Parameters
    ----------
    plan : From `plan`.
    cores : Trainings side by side, each in a process with one thread. With several, a script must
        keep its code under `if __name__ == "__main__":`, as each process begins by importing it.
    executor : Runs the trainings in place of processes of this machine: any executor of
        `concurrent.futures`, such as Dask's `Client.get_executor()`. It stays open.
    watch : Called in this process after each training, with where the comparison stands.
    clock : Time of a command that has already begun; by default the plan's budget from now on.

    Raises
    ------
    ValueError
        If no method can be fitted.
    """
    with Runner(cores, executor) as runner:
        return finished(plan, runner, watch, clock).result()


def finished(
    plan: Plan, runner: Runner, watch: Watch | None = None, clock: Clock | None = None
) -> RunningComparison:
    """Run a plan to its end, or until Ctrl-C, and return all fits."""
    found = RunningComparison(plan, runner, clock or Clock(plan.budget), watch)
    try:
        found.run_quick()
        found.run_rounds()
        if not found.clock.interrupted:
            found.run_finals()
    except KeyboardInterrupt:
        if not found.trials:
            raise
        found.interrupt()
    found.complete()
    return found


class RunningComparison:
    """Run the parts of a comparison one after the other, and hold all fits so far.

    Attributes
    ----------
    plan, clock : Of the comparison.
    doing : What is computed now, in words.
    new_table : Whether a round, or the quick methods, have just ended.
    trials : Fits to three quarters of the training part, by method.
    finals : Fits to all of it.
    failed : Why methods have no fit.
    """

    def __init__(self, plan: Plan, runner: Runner, clock: Clock, watch: Watch | None) -> None:
        self.plan, self.clock, self._runner, self._watch = plan, clock, runner, watch
        clock.cores = runner.cores
        self.doing, self.new_table = "", False
        self.trials: dict[str, Sequence[Fit]] = {}
        self.finals: dict[str, list[Fit]] = {}
        self.failed: dict[str, str] = {}
        self._final_jobs: dict[str, list[Job]] = {}
        self._trial: Trial | None = None  # of the trials so far
        self._quick: list[Job] = []  # of methods without networks, which have not ended
        self._partly: dict[str, str] = {}  # why finals are fits to three quarters
        ran: dict[Any, Any] = {}
        ready = (self._simulated(method, ran) for method in plan.methods)
        self._ready = [method for method in ready if method is not None]
        self._search: Search | None = None
        self._bases = Bases(runner)

    @property
    def trial(self) -> Trial:
        """Return the results on held-out samples so far."""
        if self._trial is None:
            self._trial = self._judged({})
        return self._trial

    @property
    def model(self) -> Forecaster:
        """Return the best model so far; a network was trained on three quarters of the samples."""
        best = self.trial.recommended
        fits = self.finals.get(best) or self.trials[best]
        return fitted_ensemble([fit.fitted for fit in fits], self.trial.held_out[best])

    def in_words(self) -> str:
        """Return what is computed now and the best method so far, in a line."""
        if not self.trials:
            return self.doing
        trial = self.trial
        best = trial.recommended
        score = f"score {trial.penalized_score(best):.3g}"
        return f"{self.doing}; best so far: {self.methods[best]._title}, {score}"

    def __str__(self) -> str:
        """Return the same with the time that is left."""
        return f"{self.in_words()}; {self.clock.left_in_words()}"

    @property
    def methods(self) -> dict[str, Forecaster]:
        """Return the methods by name, fitted to three quarters where they have been tried."""
        found = {method.name: method for method in self.plan.methods}
        return found | {name: fits[0].fitted for name, fits in self.trials.items() if fits}

    def comparison(self) -> Comparison:
        """Return the comparison of the final fits so far."""
        attempts = () if self._search is None else tuple(self._search.attempts)
        found = Comparison(self.plan, self.fits(), None, attempts, self.clock)
        return replace(found, trial=self._judged(found.fits, frozenset(found.left_out)))

    def _judged(
        self, final: Mapping[str, Sequence[Fit]], left_out: frozenset[str] = frozenset()
    ) -> Trial:
        """Return the results on held-out samples, in the order of the methods, not of the jobs."""
        names = self.plan.names
        trials = {name: self.trials[name] for name in names if name in self.trials}
        failed = {name: self.failed[name] for name in names if name in self.failed}
        return judged(self.plan.training, trials, final, failed, left_out)

    def result(self) -> Comparison:
        """Return the comparison at the end, with the refit if one is asked for."""
        found = self.comparison()
        if not self.plan.refit or self.clock.interrupted:
            return found
        return replace(found, refit=self._refitted(found.recommended, found.require_trial()))

    def run_quick(self) -> None:
        """Fit the methods without networks; workers go on with it while they train networks."""
        quick = [f for f in self._ready if not f.random]
        at_once = [f for f in quick if f._at_once]
        prepared = [f for f in self._ready if f.random or f._fits_simulator]
        self._try([f for f in quick if f not in [*at_once, *prepared]])
        # Workers load torch while the first table is shown and written.
        self._runner.start([f for f in self._ready if f.random])
        self._try(at_once)
        if len(at_once) < len(self._ready):
            self._report("baselines", new_table=True)
        until = self._half()
        for forecaster in prepared:
            spec = self.plan.held_out_spec(forecaster)
            for samples in sorted({origin.fitted for origin in spec.origins}):
                records = [beginning(spec.record, samples), *spec.others]
                self._bases.fit(forecaster, records, until)
        self._try([f for f in prepared if not f.random])
        if self._runner.executor is None:
            self._await_quick()

    def _try(self, forecasters: Sequence[Forecaster]) -> None:
        """Begin the fits of methods without networks to three quarters of the training part."""
        for forecaster in forecasters:
            self._begin(replace(held_out_job(self.plan, forecaster), needed=True))

    def _begin(self, job: Job) -> None:
        """Begin a job of a method without networks; one that takes no time is done here."""
        if job.forecaster._at_once:
            with one_thread():
                self._take(job, job.run())
            return
        job = replace(self._bases.given_to(job), limit=self._limit(job.forecaster))
        self._quick.append(job)
        self._runner.begin([job], self._half(), first=True)

    def _take(self, job: Job, fit: Fit) -> None:
        """Take a fit of a method without networks; after the trial, the final fit begins."""
        name = job.method
        if fit.model is None:
            self.failed[name] = fit.failure
        elif name in self.trials:
            self.finals[name] = [fit]
            if not job.trains:
                self._partly[name] = _of_three_quarters(job.forecaster)
        else:
            self.trials[name], self._trial = [fit], None
            method = next(f for f in self._ready if f.name == name)
            job = Job(method, self.plan.spec(method))
            if method._at_once or fit.seconds < (1 - HELD_OUT_SHARE) * self._half().left:
                self._bases.fit(method, [self.plan.training, *self.plan.others], self._half())
            else:
                job = replace(job, start=fit.model, trains=False)
            self._begin(job)

    def _await_quick(self, trials_alone: bool = False) -> None:
        """Wait for the methods without networks: for all their fits, or for the trials alone."""
        while jobs := [j for j in self._quick if not (trials_alone and j.method in self.trials)]:
            for _ in self._ended(jobs):
                pass

    def _ended(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Fit]]:
        """Yield jobs with their fits, as they end; methods without networks are taken meanwhile."""
        for job, fit in self._runner.ended(jobs):
            if job not in self._quick:
                yield job, fit
                continue
            self._quick.remove(job)
            tried = job.method in self.trials
            self._take(job, fit)
            left = any(other.method not in self.trials for other in self._quick)
            if not (tried or left) and any(f.random for f in self._ready):
                self._report("baselines", new_table=True)

    def interrupt(self) -> None:
        """End all jobs, after Ctrl-C."""
        self.clock.interrupted, self._quick = True, []
        self._runner.drop()

    def run_rounds(self) -> None:
        """Run rounds of the search until only the final trainings fit into the time."""
        networks = [f for f in self._ready if f.random]
        if self.trials and self.clock.deadline.over:
            self.failed |= dict.fromkeys((f.name for f in networks), LATE)
            return
        if not networks:
            return
        from splitband.comparison.search import Search  # noqa: PLC0415  which loads torch

        self._ready = [built(f) for f in self._ready]
        ready = replace(self.plan, methods=tuple(self._ready))
        clock, most = self.clock, self.plan.rounds
        # Counted rounds are the same on any number of cores.
        search = self._search = Search(ready, self._runner.cores if most is None else 1)
        while most is None or search.round < most:
            reserve = self._reserve(search)
            if search.round and clock.left <= reserve:
                break
            jobs = search.ask(clock.left - reserve)
            if not jobs:
                break
            if not self.trials and search.round == 1:
                jobs[0] = replace(jobs[0], needed=True)
            until = Deadline.after((clock.left - reserve) / search.cost_factor)
            search.tell(self._trained(jobs, until, f"round {search.round}"))
            self.trials, self._trial = self.trials | search.trials, None
            if not clock.interrupted:
                self._report(f"round {search.round}", new_table=True)
            if until.over or clock.interrupted:
                break
            if search.round == 1 and self.plan.extended and most != 1:
                self._await_quick(trials_alone=True)
                self._extend(search)
        self.failed |= search.failed
        clock.settled = search.converged

    def _extend(self, search: Search) -> None:
        """Add a network on the best method, if that is a baseline which can have one on top."""
        several, scores = self.plan.tests or self.plan.others, self.trial.scores
        best = min(scores, key=lambda name: scores[name])
        method = next(f for f in self._ready if f.name == best)
        # What depends on the time since its training record began is for that record alone.
        if best in BASES and not (several and method.anchored):
            extended = self.plan.on_baseline(best)
            if search.add(extended.methods[-1]):
                self.plan = extended
                self._ready.append(extended.methods[-1])

    def run_finals(self) -> None:
        """Train the networks on the whole training part, the best one first."""
        jobs = [] if self._search is None else self._search.finals()
        for forecaster in {job.method: job.forecaster for job in jobs}.values():
            records = [self.plan.training, *self.plan.others]
            self._bases.fit(forecaster, records, self.clock.deadline)
        until = self.clock.deadline.earlier(self._forecasting())
        fits = self._trained(jobs, until, "final trainings")
        for job, fit in zip(jobs, fits, strict=True):
            if fit.model is not None:
                self._final_jobs.setdefault(job.method, []).append(job)
                self.finals.setdefault(job.method, []).append(fit)
        for job, fit in zip(jobs, fits, strict=True):
            if fit.model is None and job.method in self.finals:
                first, *others = self.finals[job.method]
                said = f"seed {job.seed} {fit.failure if fit.cut else f'failed: {fit.failure}'}"
                self.finals[job.method] = [replace(first, notes=(*first.notes, said)), *others]
            elif fit.model is None:
                self.failed[job.method] = fit.failure
        self._await_quick()

    def complete(self) -> None:
        """Predict with the models of the trial where there is no final training."""
        self._predict_by_trials()
        self.clock.notes += by_reason(
            {name: self._partly[name] for name in self.plan.names if name in self._partly}
        )
        for name in [*self.failed]:
            if name in self.finals:
                del self.failed[name]
        self._note_untrained()
        if not self.finals:
            reasons = [*by_reason(self.failed), *self.clock.notes]
            raise InputError(f"no method could be fitted; {'; '.join(reasons)}")
        methods = {method.name: method for method in self.plan.methods}
        for name, fits in self.finals.items():
            for fit in fits:
                with_simulators_of(fit.fitted, methods[name])
                if isinstance(network := fit.fitted, Network):
                    # A copy that is fitted again is trained as long as all rounds together.
                    network.settings = network._trained_by

    def _note_untrained(self) -> None:
        """Note, with cause and cure, where the time was over before any network was trained."""
        names = [f.name for f in self.plan.methods if f.random]
        late = any(self.failed.get(name) == LATE for name in names)
        limit, interrupted = self.clock.limit, self.clock.interrupted
        if limit is None or interrupted or not late or {*names} & {*self.finals}:
            return
        said = f"no network was trained in the time: raise --budget ({limit:.0f} s)"
        if self._runner.starting:
            said += (
                ". Worker processes were still loading, or compiling kernels, which is done once "
                "after an installation: `splitband doctor` does it, in about a minute"
            )
        self.clock.notes.append(said)

    def fits(self) -> dict[str, list[Fit]]:
        """Return the final fits, without failed trainings where their number was left open."""
        plan = self.plan
        return {
            f.name: without_failed(plan.training, self.finals[f.name])
            if f.name in plan.searched or plan.seeds is None
            else self.finals[f.name]
            for f in plan.methods
            if f.name in self.finals
        }

    def _refitted(self, name: str, trial: Trial) -> Forecaster | None:
        """Return a method fitted to the whole record, with the settings of its final trainings.

        None where that fails or there is no time for it, which a note of the clock says.
        """
        record, others = self.plan.record, self.plan.others
        samples = len(record)
        # One sample, the last one, is forecast, as a fit needs an origin.
        spec = BacktestSpec(record, [Origin(samples, samples - 1)], others)
        kept = {id(fit.model) for fit in self.fits()[name]}
        jobs = [
            Job(job.forecaster, spec, job.seed, None if job.start is None else fit.model)
            for job, fit in zip(self._final_jobs.get(name, []), self.finals[name], strict=False)
            if id(fit.model) in kept
        ]
        ready = next(f for f in self._ready if f.name == name)
        if not ready.random:
            jobs = [Job(ready, spec, needed=True, limit=self._limit(ready))]
        self._bases.fit(ready, [record, *others], self.clock.deadline)
        fits = self._trained(jobs, self.clock.deadline, "refit")
        models = [fit.model for fit in fits if fit.model is not None]
        if not models:
            why = fits[0].failure if fits else LATE
            said = "in time" if why == LATE else f"({why})"
            self.clock.notes.append(
                f"{name}: could not be refitted to the whole record {said}; its model is that of "
                "the training part"
            )
            return None
        method = next(f for f in self.plan.methods if f.name == name)
        for model in models:
            with_simulators_of(model, method)
        return fitted_ensemble(models, trial.held_out.get(name))

    def _simulated(self, forecaster: Forecaster, ran: dict[Any, Any]) -> Forecaster | None:
        """Return a method with its own simulator run once for all jobs; None where that fails.

        What `ran` for another method is not run again.
        """
        plan, others = self.plan, self.plan.others
        try:
            try:
                return with_simulators_run(forecaster, plan.record, *others, *plan.tests, ran=ran)
            except ValueError:
                if not plan.tests:
                    raise
                # It may fail for the test records only, which are then left out.
                return with_simulators_run(forecaster, plan.record, *others, ran=ran)
        except ValueError as error:
            self.failed[forecaster.name] = " ".join(str(error).split())
            return None

    def _predict_by_trials(self) -> None:
        """Predict with models that were fitted to three quarters of the training part."""
        jobs = []
        for name, held in self.trials.items():
            method = next(f for f in self._ready if f.name == name)
            failed = not method.random and self.failed.get(name, LATE) != LATE
            if name in self.finals or failed:
                continue
            spec = self.plan.spec(held[0].fitted)
            best = self._search is not None and name == next(iter(self._search.trials), None)
            models = [fit.model for fit in held[: None if best else 1]]  # as many as in the end
            jobs += [Job(method, spec, i, each, trains=False) for i, each in enumerate(models)]
        # Workers may have been ended with a job that was late, and begin anew within seconds.
        here = self.clock.interrupted or self._forecasting() < GRACE
        runner = Runner() if here else self._runner
        runner.begin(jobs, NEVER, NEVER)
        fits = dict(runner.ended(jobs))
        for job in jobs:
            if fits[job].model is not None:
                self.finals.setdefault(job.method, []).append(fits[job])
                why = self.failed.pop(job.method, LATE)
                self._partly.setdefault(job.method, _of_three_quarters(job.forecaster, why))

    def _trained(
        self,
        jobs: Sequence[Job],
        until: Deadline,
        doing: str,
    ) -> list[Fit]:
        """Return the fits of jobs, in their order."""
        jobs = [self._bases.given_to(job) for job in jobs]
        fits: dict[Job, Fit] = {}
        try:
            self._runner.begin(jobs, until, self._patience(until))
            self._report(f"{doing}, 0 of {len(jobs)} trainings")
            for job, fit in self._ended(jobs):
                fits[job] = fit
                self.clock.trained += fit.seconds
                self._report(f"{doing}, {len(fits)} of {len(jobs)} trainings")
        except KeyboardInterrupt:
            if not self.trials and not any(fit.model is not None for fit in fits.values()):
                raise
            self.interrupt()
        return [fits.get(job) or job.late() for job in jobs]

    def _report(self, doing: str, new_table: bool = False) -> None:
        return_freed()
        self.doing, self.new_table = doing, new_table and bool(self.trials)
        if self._watch is not None and (self.trials or not new_table):
            self._watch(self)

    def _half(self) -> Deadline:
        """Return the deadline of what does not train networks, where others do."""
        share = MOST_OF_TIME_LEFT if any(f.random for f in self._ready) else 1.0
        return Deadline.after(share * self.clock.left)

    def _limit(self, forecaster: Forecaster) -> float:
        """Return the seconds of a fit without networks; results by --rounds do not depend on it."""
        if self.clock.limit is None or forecaster._fits_simulator:
            return math.inf
        return min(BASELINE_SHARE * self.clock.limit, MOST_OF_BASELINE)

    def _reserve(self, search: Search) -> float:
        """Return the seconds that the final trainings of what is best so far will take."""
        jobs = search.finals()
        again = [job for job in jobs if self.plan.refit and job.method == jobs[0].method]
        every = [job.seconds for job in [*jobs, *again]]
        if self.plan.refit and self.finals:
            every += [fit.seconds for fit in self.finals.get(self.trial.recommended, [])]
        longest = max(every, default=0.0)
        return max(longest, sum(every) / self._runner.cores) + self._forecasting()

    def _patience(self, until: Deadline) -> Deadline:
        """Return when trainings are ended that have not forecast yet; of the first, at the end."""
        took = self._forecasting()
        least = until.earlier(-max(GRACE, 2 * took))
        return least if took else max(least, self.clock.deadline)

    def _forecasting(self) -> float:
        """Return the seconds that the forecasts of a final training take, by those of the trial.

        There, three forecasts have together twice the length of the held-out part (1 + 2/3 + 1/3),
        and three horizons.
        """
        plan = self.plan
        took = [
            fit.seconds - fit.report.seconds
            for fits in self.trials.values()
            for fit in fits
            if fit.fitted.random
        ]
        samples = 2 * len(plan.record) + sum(map(len, plan.tests))
        # The least one, as the first forecasts of a process also load or compile what they need.
        return min(took, default=0.0) * samples / (plan.train / 2 + 3 * plan.horizon)


def _of_three_quarters(method: Forecaster, why: str = LATE) -> str:
    """Return in words why results are of a fit to three quarters of the training part."""
    return (
        f"could not be {'trained on' if method.random else 'fitted to'} the whole training "
        f"part {'in time' if why == LATE else f'({why})'}; results are of three quarters of it"
    )


def fit(
    plan: Plan,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    progress: Callable[[Progress], None] | None = None,
    clock: Clock | None = None,
) -> Forecaster:
    """Fit the only method of a plan to its training part, and return it.

    Parameters
    ----------
    plan : With one method. A search for its settings ends with the training that did best.
    cores, executor, watch, clock : See `run`.
    progress : Called after each epoch of a training whose settings are given.

    Raises
    ------
    ValueError
        For several methods, and as `Forecaster.fit`.
    """
    if len(plan.methods) != 1:
        raise InputError(f"methods must be one to be fitted, got {', '.join(plan.names)}")
    (forecaster,) = plan.methods
    if plan.searched:
        with Runner(cores, executor) as runner:
            done = finished(replace(plan, seeds=1), runner, watch, clock)
        if done.clock.interrupted:
            raise KeyboardInterrupt
        model = done.finals[forecaster.name][0].fitted
        trial = judged(plan.training, done.trials, done.finals, {})
        model.held_out = trial.held_out.get(forecaster.name)
        return model
    limit = (clock or Clock(plan.budget)).deadline
    with within(limit):
        return built(forecaster).fit(plan.training, *plan.others, seed=plan.seed, progress=progress)
