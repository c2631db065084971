"""Run the parts of a comparison: quick methods, rounds of the search, final trainings, result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from splitband.comparison import estimates
from splitband.comparison.backtest import BacktestSpec, Fit
from splitband.comparison.clock import Clock
from splitband.comparison.jobs import (
    GRACE,
    Bases,
    Job,
    Runner,
    held_out_job,
    late,
    run_until,
)
from splitband.comparison.method_state import MethodState, reason_of
from splitband.comparison.methods import BASES
from splitband.comparison.plan import Plan
from splitband.comparison.recommendation import Trial, by_reason, judged, without_failed
from splitband.comparison.result import Comparison
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import fitted_ensemble
from splitband.forecasters.held_out import HELD_OUT_SHARE, Origin, beginning
from splitband.forecasters.network import Network
from splitband.forecasters.simulation import with_simulators_of, with_simulators_run
from splitband.runtime.deadlines import NEVER, Deadline
from splitband.runtime.errors import InputError
from splitband.runtime.memory import return_freed
from splitband.runtime.threads import one_thread

if TYPE_CHECKING:
    from splitband.comparison.search import Search


Watch = Callable[["RunningComparison"], None]


class RunningComparison:
    """Run the parts of a comparison one after the other, and hold all fits so far.

    Attributes
    ----------
    plan, clock : Of the comparison.
    doing : What is computed now, in words.
    new_table : Whether a round, or the quick methods, have just ended.
    states : The methods by name, in the order of the plan.
    """

    def __init__(self, plan: Plan, runner: Runner, clock: Clock, watch: Watch | None) -> None:
        self.plan, self.clock, self._runner, self._watch = plan, clock, runner, watch
        clock.cores = runner.cores
        self.doing, self.new_table = "", False
        self.states = {method.name: MethodState(method) for method in plan.methods}
        self._trial: Trial | None = None  # of the trials so far
        self._search: Search | None = None
        self._bases = Bases(runner)
        self._ended_round = ""  # the last one, until its table is shown
        clock.enter("simulators")
        # Whether time is over before workers begin; they take as long as this process.
        self._brief = runner.executor is not None and clock.left < clock.parts["start"]
        ran: dict[Any, Any] = {}
        for state in self.states.values():
            self._simulate(state, ran)

    @property
    def trials(self) -> dict[str, Sequence[Fit]]:
        """Return the fits to three quarters of the training part, by method."""
        return self._useful({name: s.trial for name, s in self.states.items() if s.trial})

    @property
    def finals(self) -> dict[str, list[Fit]]:
        """Return the final fits by method; see `MethodState`."""
        found = {name: [*state.final.values()] for name, state in self.states.items()}
        return self._useful({name: fits for name, fits in found.items() if fits})

    def _useful(self, found: dict[str, Any]) -> dict[str, Any]:
        """Return results by method; none without one of a method that may be recommended."""
        return found if found.keys() - self.plan.also else {}

    @property
    def failed(self) -> dict[str, str]:
        """Return why methods have no final fit, in words, by name."""
        failures = {n: state.failure for n, state in self.states.items() if not state.final}
        return {name: fit.failure for name, fit in failures.items() if fit is not None}

    @property
    def _ready(self) -> list[Forecaster]:
        """Return the methods that can be fitted."""
        return [state.ready for state in self.states.values() if state.ready is not None]

    @property
    def _quick(self) -> list[Job]:
        """Return the jobs of methods without networks that have not ended."""
        return [state.job for state in self.states.values() if state.job is not None]

    @property
    def trial(self) -> Trial:
        """Return the results on held-out samples so far."""
        if self._trial is None:
            plan = self.plan
            self._trial = judged(plan.training, self.trials, {}, self.failed, plan.also)
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
        best, units = self.trial.recommended, self.plan.record.units
        errors = zip(self.trial.errors[best], units, strict=True)
        held_out = ", ".join(f"{error:.3g} {unit}".rstrip() for error, unit in errors)
        return f"{self.doing}; best so far: {self.methods[best].title}, held-out RMSE {held_out}"

    def __str__(self) -> str:
        """Return the same with the time that is left."""
        return f"{self.in_words()}; {self.clock.left_in_words()}"

    @property
    def methods(self) -> dict[str, Forecaster]:
        """Return the methods by name, fitted to three quarters where they have been tried."""
        states = self.states.items()
        return {name: s.trial[0].fitted if s.trial else s.method for name, s in states}

    def comparison(self) -> Comparison:
        """Return the comparison of the final fits so far."""
        attempts = () if self._search is None else tuple(self._search.attempts)
        found = Comparison(self.plan, self.fits(), None, attempts, self.clock)
        given = self.plan.training, self.trials, found.fits, self.failed
        left_out = self.plan.also.union(found.left_out)
        return replace(found, trial=judged(*given, left_out, self.plan.simulated))

    def result(self) -> Comparison:
        """Return the comparison at the end, with the refit if one is asked for."""
        found = self.comparison()
        if not self.plan.refit or self.clock.interrupted:
            return found
        return replace(found, refit=self._refitted(found.recommended, found.require_trial()))

    def run(self) -> None:
        """Run the plan to its end, or until Ctrl-C."""
        try:
            self.clock.enter("baselines")
            self._run_quick()
            self.clock.enter("rounds")
            self._run_rounds()
            self.clock.enter("finals")
            if not self.clock.interrupted:
                self._run_finals()
        except KeyboardInterrupt:
            if not self.trials:
                raise
            self._interrupt()
        self._complete()
        self.clock.enter("pages")

    def _run_quick(self) -> None:
        """Fit the methods without networks; workers go on with it while they train networks."""
        quick = [f for f in self._ready if not f.random]
        at_once = [f for f in quick if f.at_once]
        prepared = [f for f in self._ready if f.random or f.fits_simulator]
        self._try([f for f in quick if f not in [*at_once, *prepared]])
        # Workers load torch while the first table is shown and written.
        if not self._brief:
            self._runner.start([f for f in self._ready if f.random])
        self._try(at_once)
        if len(at_once) < len(self._ready):
            self._report("baselines", new_table=True)
        if self._runner.executor is None:
            self._await_quick()
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
        if job.forecaster.at_once:
            with one_thread():
                self._take(job, job.run())
            return
        job = replace(self._bases.given_to(job), limit=self._limit(job.forecaster))
        # One with a limit of its own may begin late, as its process does.
        until = self._half() if job.forecaster.fits_simulator else self.clock.deadline
        if self._brief:
            with one_thread():
                self._take(job, run_until(until, job))
            return
        self.states[job.method].job = job
        self._runner.begin([job], until, first=True)

    def _take(self, job: Job, fit: Fit) -> None:
        """Take a fit of a method without networks; after the trial, the final fit begins."""
        state = self.states[job.method]
        state.job, method = None, state.ready
        if fit.model is None or method is None:
            state.failure = fit
        elif state.trial:
            state.final = {job: fit}
        else:
            state.trial, self._trial = [fit], None
            job = Job(method, self.plan.spec(method))
            took = max(fit.seconds, fit.report.seconds)  # a simulator was fitted before its job
            # A fit with a limit of its own takes little from the networks beside it.
            until = self._half() if method.fits_simulator else self.clock.deadline
            if method.at_once or took < (1 - HELD_OUT_SHARE) * until.left:
                self._bases.fit(method, [self.plan.training, *self.plan.others], until)
            else:
                job = replace(job, start=fit.model, trains=False)
            self._begin(job)

    def _await_quick(self, trials_alone: bool = False) -> None:
        """Wait for the methods without networks: for all their fits, or for the trials alone."""
        while jobs := [*filter(self._untried, self._quick)] if trials_alone else self._quick:
            for _ in self._ended(jobs):
                pass

    def _untried(self, job: Job) -> bool:
        """Return whether a job is one of the trial."""
        return not self.states[job.method].trial

    def _ended(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Fit]]:
        """Yield jobs with their fits, as they end; methods without networks are taken meanwhile."""
        for job, fit in self._runner.ended(jobs):
            if self.states[job.method].job is not job:
                yield job, fit
                continue
            untried = self._untried(job)
            self._take(job, fit)
            last = untried and not any(map(self._untried, self._quick))
            if last and any(f.random for f in self._ready):
                self._report("baselines", new_table=True)

    def _interrupt(self) -> None:
        """End all jobs, after Ctrl-C."""
        self.clock.interrupted = True
        for state in self.states.values():
            state.job = None
        self._runner.drop()

    def _run_rounds(self) -> None:
        """Run rounds of the search until only the final trainings fit into the time."""
        networks = [f for f in self._ready if f.random]
        if self.trials and (self.clock.deadline.over or self._brief):
            self._fail(late(network.name) for network in networks)
            return
        if not networks:
            return
        from splitband.comparison.search import Search  # noqa: PLC0415  which loads torch

        ready = replace(self.plan, methods=tuple(self._ready))
        clock, most = self.clock, self.plan.rounds
        # Counted rounds are the same on any number of cores.
        search = self._search = Search(ready, self._runner.cores if most is None else 1)
        while most is None or search.round < most:
            reserve = self._reserve(search)
            if search.round and clock.left - reserve <= clock.least_round:
                break
            jobs = search.ask(clock.left - reserve)
            if not jobs:
                break
            if not self.trials and search.round == 1:
                jobs[0] = replace(jobs[0], needed=True)
            until = Deadline.after((clock.left - reserve) / search.cost_factor)
            search.tell(self._trained(jobs, until, f"round {search.round}"))
            for name, fits in search.trials.items():
                self.states[name].trial, self._trial = fits, None
            self._ended_round = "" if clock.interrupted else f"round {search.round}"
            if clock.interrupted:
                break
            if search.round == 1 and self.plan.extended and most != 1:
                self._await_quick(trials_alone=True)
                self._extend(search)
        self._fail(search.failed.values())
        clock.settled = search.converged

    def _fail(self, fits: Iterable[Fit]) -> None:
        """Take fits of methods that have no model."""
        for fit in fits:
            self.states[fit.method].failure = fit

    def _extend(self, search: Search) -> None:
        """Add a network on the best method, if that is a baseline which can have one on top."""
        several, scores = self.plan.tests or self.plan.others, self.trial.scores
        best = min(scores.keys() - self.plan.also, key=lambda name: scores[name])
        # What depends on the time since its training record began is for that record alone.
        if best in BASES and not (several and self.states[best].method.anchored):
            extended = self.plan.on_baseline(best)
            network = extended.methods[-1]
            if search.add(network):
                self.plan = extended
                self.states[network.name] = MethodState(network, network)

    def _run_finals(self) -> None:
        """Train the networks on the whole training part, the best one first."""
        jobs = [] if self._search is None else self._search.finals()
        for forecaster in {job.method: job.forecaster for job in jobs}.values():
            records = [self.plan.training, *self.plan.others]
            self._bases.fit(forecaster, records, self.clock.deadline)
        until = self.clock.deadline.earlier(self._forecasting())
        fits = dict(zip(jobs, self._trained(jobs, until, "final trainings"), strict=True))
        for name in dict.fromkeys(job.method for job in jobs):
            self.states[name].end({job: fit for job, fit in fits.items() if job.method == name})
        self._await_quick()

    def _complete(self) -> None:
        """Predict with the models of the trial where there is no final training."""
        self._predict_by_trials()
        self.clock.notes += by_reason({name: state.note for name, state in self.states.items()})
        self._note_untrained()
        if not self.finals:
            reasons = [*by_reason(self.failed), *self.clock.notes]
            raise InputError(f"no method could be fitted; {'; '.join(reasons)}")
        for state in self.states.values():
            for fit in state.final.values():
                with_simulators_of(fit.fitted, state.method)
                if isinstance(network := fit.fitted, Network):
                    # A copy that is fitted again is trained as long as all rounds together.
                    network.settings = network.untrained().settings

    def _note_untrained(self) -> None:
        """Note, with cause and cure, where the time was over before any network was trained."""
        networks = [state for state in self.states.values() if state.method.random]
        over = any(state.failure is not None and state.failure.cut for state in networks)
        limit, interrupted = self.clock.limit, self.clock.interrupted
        if limit is None or interrupted or not over or any(state.final for state in networks):
            return
        said = f"no network was trained in the time: raise budget (--budget), {limit:.0f} s"
        if self._runner.starting:
            said += (
                ". Worker processes were still loading, or compiling kernels, which is done once "
                "after an installation: `splitband doctor` does it, in about a minute"
            )
        self.clock.notes.append(said)

    def fits(self) -> dict[str, list[Fit]]:
        """Return the final fits, without failed trainings where their number was left open.

        A training fails by its simulation from the start, by which forecasts some samples ahead and
        models of an unstable plant are not judged.
        """
        plan = self.plan
        if not plan.simulated:
            return self.finals
        return {
            name: without_failed(plan.training, fits)
            if name in plan.searched or plan.seeds is None
            else fits
            for name, fits in self.finals.items()
        }

    def _refitted(self, name: str, trial: Trial) -> Forecaster | None:
        """Return a method fitted to the whole record, with the settings of its final trainings.

        None where that fails or there is no time for it, which a note of the clock says.
        """
        record, others = self.plan.record, self.plan.others
        samples = len(record)
        # One sample, the last one, is forecast, as a fit needs an origin.
        spec = BacktestSpec(record, [Origin(samples, samples - 1)], others)
        state, kept = self.states[name], {id(fit.model) for fit in self.fits()[name]}
        ready, final = state.ready or state.method, state.final.items()
        if ready.random:
            jobs = [
                Job(job.forecaster, spec, job.seed, None if job.start is None else fit.model)
                for job, fit in final
                if job.trains and id(fit.model) in kept
            ]
        else:
            jobs = [Job(ready, spec, needed=True, limit=self._limit(ready))]
        self._bases.fit(ready, [record, *others], self.clock.deadline)
        fits = self._trained(jobs, self.clock.deadline, "refit")
        models = [fit.model for fit in fits if fit.model is not None]
        if not models:
            self.clock.notes.append(
                f"{name}: could not be refitted to the whole record "
                f"{reason_of(fits[0] if fits else None)}; its model is that of the training part"
            )
            return None
        for model in models:
            with_simulators_of(model, state.method)
        return fitted_ensemble(models, trial.held_out.get(name))

    def _simulate(self, state: MethodState, ran: dict[Any, Any]) -> None:
        """Run a method's own simulator, once for all jobs.

        What `ran` for another method is not run again.
        """
        plan, others = self.plan, self.plan.others
        # It may fail for the test records only, which are then left out.
        for tests in dict.fromkeys([plan.tests, ()]):
            try:
                beside = plan.record, *others, *tests
                state.ready = with_simulators_run(state.method, *beside, ran=ran)
                return
            except ValueError as error:
                said = " ".join(str(error).split())
        state.failure = Fit(state.method.name, failure=said)

    def _predict_by_trials(self) -> None:
        """Predict with models that were fitted to three quarters of the training part."""
        jobs = list[Job]()
        for name, state in self.states.items():
            wrong = state.failure is not None and not state.failure.cut
            if not state.trial or state.final or state.ready is None:
                continue
            if wrong and not state.method.random:
                continue
            spec = self.plan.spec(state.trial[0].fitted)
            best = self._search is not None and name == next(iter(self._search.trials), None)
            models = [fit.model for fit in state.trial[: None if best else 1]]  # as in the end
            jobs += [Job(state.ready, spec, i, each, trains=False) for i, each in enumerate(models)]
        # Workers may have been ended with a job that was late, and begin anew within seconds.
        here = self.clock.interrupted or self._forecasting() < GRACE
        runner = Runner() if here else self._runner
        runner.begin(jobs, NEVER, NEVER)
        fits = dict(runner.ended(jobs))
        for job in jobs:
            if fits[job].model is not None:
                self.states[job.method].final[job] = fits[job]

    def _trained(self, jobs: Sequence[Job], until: Deadline, doing: str) -> list[Fit]:
        """Return the fits of jobs, in their order."""
        jobs = [self._bases.given_to(job) for job in jobs]
        fits: dict[Job, Fit] = {}
        try:
            patience = estimates.patience(until, self.clock.deadline, self._forecasting())
            self._runner.begin(jobs, until, patience)
            if self._ended_round:  # workers train while its table is written
                self._report(self._ended_round, new_table=True)
                self._ended_round = ""
            self._report(f"{doing}, 0 of {len(jobs)} trainings")
            for job, fit in self._ended(jobs):
                fits[job] = fit
                self.clock.trained += fit.seconds
                self.clock.first_training = min(self.clock.first_training, fit.began)
                self._report(f"{doing}, {len(fits)} of {len(jobs)} trainings")
        except KeyboardInterrupt:
            if not self.trials and not any(fit.model is not None for fit in fits.values()):
                raise
            self._interrupt()
        return [fits.get(job) or job.late() for job in jobs]

    def _report(self, doing: str, new_table: bool = False) -> None:
        return_freed()
        self.doing, self.new_table = doing, new_table and bool(self.trials)
        if self._watch is not None and (self.trials or not new_table):
            before = self.clock.enter("pages")
            self._watch(self)
            self.clock.enter(before)

    def _half(self) -> Deadline:
        """Return the deadline of what does not train networks, where others do."""
        return self.clock.shared if any(f.random for f in self._ready) else self.clock.deadline

    def _limit(self, forecaster: Forecaster) -> float:
        """Return the seconds of a fit without networks."""
        if forecaster.fits_simulator:
            return math.inf
        own = [f for f in self._ready if not (f.random or f.at_once or f.fits_simulator)]
        return self.clock.of_baseline(max(len(own), 1))

    def _reserve(self, search: Search) -> float:
        """Return the seconds that the final trainings of what is best so far will take."""
        jobs = search.finals()
        seconds = [job.seconds for job in jobs]
        if self.plan.refit:
            seconds += [job.seconds for job in jobs if job.method == jobs[0].method]
            if self.finals:
                seconds += [fit.seconds for fit in self.finals.get(self.trial.recommended, [])]
        longest = max(seconds, default=0.0)
        return max(longest, sum(seconds) / self._runner.cores) + self._forecasting()

    def _forecasting(self) -> float:
        """Return the seconds that the forecasts of a final training take."""
        return estimates.forecasting(self.plan, self.trials.values())
