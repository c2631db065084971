"""Plan and run a comparison, or the fit of a single method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields, replace
from typing import Any

from splitband.comparison.clock import Clock
from splitband.comparison.jobs import Runner
from splitband.comparison.methods import Sizes, built
from splitband.comparison.plan import Plan, plan
from splitband.comparison.recommendation import judged
from splitband.comparison.request import PlanRequest
from splitband.comparison.result import Comparison
from splitband.comparison.running import RunningComparison, Watch
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.records import Record
from splitband.runtime.deadlines import within
from splitband.runtime.errors import InputError
from splitband.runtime.progress import progress_line
from splitband.simulators import Simulator
from splitband.simulators.parameters import Adjustable
from splitband.training import Progress, TrainingSettings
from splitband.training.settings import Recipe


def compare(  # noqa: PLR0913
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    horizon: int | None = None,
    ahead: int | None = None,
    others: Sequence[Record] = (),
    tests: Sequence[Record] = (),
    initial: int | None = None,
    settings: TrainingSettings | Mapping[str, Any] | None = None,
    recipe: Recipe = "default",
    bands: Bands | None = None,
    sizes: Sizes | None = None,
    simulator: Simulator | Adjustable | str | None = None,
    calibrate: bool = False,
    conditioned: bool = False,
    budget: float | None = None,
    rounds: int | None = None,
    seed: int = 0,
    seeds: int | None = None,
    refit: bool = False,
    device: str = "cpu",
    also: Mapping[str, Sequence[Simulator]] | None = None,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
) -> Comparison:
    """Compare forecasters on a record, as `splitband compare` does, and recommend one.

    Each one is fitted to the first `train` samples and, for the recommendation, to three quarters
    of them. Ctrl-C ends it early with the results so far. With `train=len(record)`,
    `result.model.predict(steps, level=0.9)` forecasts what comes after the record.

    Parameters
    ----------
    record : The measured record, with its inputs and simulator's output, if any.
    train : Samples to train on, by default three quarters; with `tests` all of them. With
        `len(record)` only the held-out forecasts are left to compare by.
    methods : Forecasters, or names (`splitband methods`). By default the methods worth comparing on
        such a record.
    horizon : Length of the free run after the training part, in samples, by default to the end of
        the record; with 0 the methods are only fitted.
    ahead : Number of samples that the model is to predict from any origin, with the measurements
        until then: for predictive control, plants that integrate or are unstable, and signals
        that wander. Networks are trained over windows of a warm-up and so many samples. Methods are
        chosen by forecasts of 1 to `ahead` samples from many origins in the held-out part; the
        table has their fit 1, ahead/10 and `ahead` samples ahead, from many origins after the
        training part or in the test records, and the interval is that of such forecasts. By
        default one free run counts, in each of these.
    others : Further records of the same system, to train on.
    tests : Records of the same system that nothing is fitted to; each is simulated to its end after
        a warm-up on its first samples. A simulator that inputs drive runs for them and `others`.
    initial : Measured samples at the beginning of a test record, by default the warm-up.
    settings : Training settings of the networks, or some of them, such as `{"epochs": 5}`. All but
        `warmup` fix how networks are trained. By default that is searched on the last quarter of
        the training part.
    recipe : Settings where none are given: "default", or "constant-rate", which is not searched.
    bands : Cut-off, order and down-sampling; what is not given is chosen from the training samples.
    sizes : Sizes of the networks given by name; by default they are searched.
    simulator : For methods without one: it is run beside the record, or, with parameters (`Ode`,
        `Fmu`, `Function`), fitted to it. A text is what `--simulator` takes: a file, FILE.py:NAME,
        or the name of a baseline that is fitted in place of a simulator, such as "linear".
    calibrate, conditioned : Whether methods given by name are also compared with their simulator
        calibrated first, and with the slow band as an input of their networks.
    budget : Wall time of the whole comparison in s, by default two minutes if there is something
        to search, and no limit otherwise. `math.inf` is no limit.
    rounds : Rounds of the search in place of a time limit: the same work and, on one machine, the
        same result in every run.
    seed : Of all random numbers.
    seeds : Number of trainings of each network, whose median is returned, by default three. After
        a search of settings, the largest number in the median of the best network, by default
        the number that does best; the other networks are trained once.
    refit : Whether the recommended method is refitted to the whole record at the end.
    device : The device that trains networks: cpu, cuda, cuda:1.
    also : Simulations made elsewhere, by name, as further rows of the table and the page. They are
        never recommended. Of each there is that of the record and, to be scored there, too, one of
        each test record: `{"mine": [sb.Recorded(y, 0.1), sb.Recorded(y_of_test, 0.1)]}`.
    cores : Trainings side by side, each in a process with one thread. With several, a script must
        keep its code under `if __name__ == "__main__":`, as each process begins by importing it.
    executor : Runs the trainings in place of processes of this machine: any executor of
        `concurrent.futures`, such as Dask's `Client.get_executor()`. It stays open.
    watch : Called in this process after each training, with where the comparison stands. By
        default a terminal or a notebook shows it on a line.

    Raises
    ------
    ValueError
        For invalid records, methods, settings or numbers of samples, before anything is computed;
        and if no method can be fitted.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> result = sb.compare(record, 300, [sb.Mean(), sb.Persistence(), sb.Harmonic()])
    >>> result.recommended
    'harmonic'
    >>> list(result.table["forecast fit %"].round(1))
    [100.0, -0.3, -77.9]
    """
    given = locals()
    asked = PlanRequest(**{each.name: given[each.name] for each in fields(PlanRequest)})
    with progress_line("fitting simple models") as show:

        def watched(state: RunningComparison) -> None:
            show(f"{state.clock.left_in_words()}; {state.in_words()}")

        return run(plan(asked), cores=cores, executor=executor, watch=watch or watched)


def run(
    plan: Plan,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    clock: Clock | None = None,
) -> Comparison:
    """Run a planned comparison; see `compare`.

    `clock` is that of a command that has already begun, by default the plan's budget from now on.
    """
    with Runner(cores, executor) as runner:
        running = RunningComparison(plan, runner, clock or Clock(plan.budget), watch)
        running.run()
        return running.result()


def fit(
    plan: Plan,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    progress: Callable[[Progress], None] | None = None,
    clock: Clock | None = None,
) -> Forecaster:
    """Fit the only method of a plan to its training part, and return it; see `run`.

    A search for its settings ends with the training that did best. `progress` is called after each
    epoch of a training whose settings are given. Raises ValueError for several methods, and as
    `Forecaster.fit`.
    """
    if len(plan.methods) != 1:
        raise InputError(f"methods must be one to be fitted, got {', '.join(plan.names)}")
    (forecaster,), clock = plan.methods, clock or Clock(plan.budget)
    if not plan.searched:
        how: dict[str, Any] = {"seed": plan.seed, "progress": progress}
        with within(clock.deadline):
            return built(forecaster).fit(plan.training, *plan.others, **how)
    with Runner(cores, executor) as runner:
        done = RunningComparison(replace(plan, seeds=1), runner, clock, watch)
        done.run()
    if clock.interrupted:
        raise KeyboardInterrupt
    model = done.finals[forecaster.name][0].fitted
    trial = judged(plan.training, done.trials, done.finals, {})
    model.held_out = trial.held_out.get(forecaster.name)
    return model
