"""Plan a comparison: decide every default, and check everything, before anything runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from splitband.comparison.backtest import BacktestSpec, first_origin
from splitband.comparison.checks import (
    check,
    check_bands,
    check_limits,
    check_needs,
    check_train,
    check_trial,
)
from splitband.comparison.methods import (
    BASES,
    GREY_BOX,
    HYBRIDS,
    Sizes,
    known,
    named,
    with_base,
    with_variants,
)
from splitband.data import Record, require_records
from splitband.filters import Band
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster, all_parts, parts_of, with_parts_changed
from splitband.forecasters.fitted import unmoved
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.held_out import Origin, held_out_origins
from splitband.forecasters.network import Network, with_defaults
from splitband.runtime.arguments import check_device, whole
from splitband.runtime.errors import InputError
from splitband.simulators import Simulator
from splitband.simulators.base import matched
from splitband.simulators.identification import check_runs
from splitband.simulators.open_simulator import is_fitted, open_simulator, simulated
from splitband.simulators.parameters import Adjustable
from splitband.training import TrainingSettings, default_warmup
from splitband.training.settings import Recipe, recipe_settings

TRAINING_SHARE = 0.75
"""Default share of a record to train on."""
BUDGET = 120.0
"""Default wall time of a comparison that searches how to train its networks, in s."""
UNFITTED_SIMULATOR = "simulator-as-given"
"""Name of a simulator whose parameters are not fitted, but the middles of their ranges."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Hold all decisions of a comparison; `run` computes it.

    Attributes
    ----------
    record : The measured record, up to its last sample to predict.
    methods : Forecasters, complete but for what is searched.
    settings, bands, sizes : Training settings, bands and sizes of those that had none of their own.
    searched : Names of the networks whose settings are searched; True: their sizes, too.
    extended : Whether a network on the best baseline is a method, too, if it is the best one.
    tests : Records that nothing is fitted to, with distinct names.
    simulator : Simulator whose parameters are fitted, for methods without one.
    high : Bands of hybrids with the simulator in the high band.
    train, horizon, others, initial, budget, rounds, seed, seeds, refit : See `plan`; decided.
    """

    record: Record
    train: int
    horizon: int
    methods: tuple[Forecaster, ...]
    settings: TrainingSettings
    bands: Bands = field(default_factory=Bands)
    sizes: Sizes = field(default_factory=Sizes)
    searched: Mapping[str, bool] = field(default_factory=dict)
    extended: bool = False
    others: tuple[Record, ...] = ()
    tests: tuple[Record, ...] = ()
    initial: int | None = None
    simulator: Adjustable | None = None
    budget: float | None = None
    rounds: int | None = None
    seed: int = 0
    seeds: int | None = None
    refit: bool = False
    high: Bands = field(default_factory=Bands)

    @cached_property
    def training(self) -> Record:
        """Return the training part of the record."""
        return self.record[: self.train]

    @cached_property
    def held_out(self) -> Record:
        """Return the record of which the last quarter is held out, for all trials."""
        return replace(self.training, y_true=None)

    @property
    def names(self) -> list[str]:
        """Return the names of the methods."""
        return [method.name for method in self.methods]

    @cached_property
    def warnings(self) -> list[str]:
        """Return what seems wrong in the records, a sentence each; see `Record.warnings`."""
        others = (*self.others, *self.tests)
        found = [f"{each.name}: {said}" for each in others for said in each.warnings()]
        own = f"{self.record.name}: " if others and self.record.name else ""
        still = unmoved([self.training, *self.others])
        return [*(f"{own}{said}" for said in self.record.warnings()), *found, *still]

    def spec(self, forecaster: Forecaster) -> BacktestSpec:
        """Return the predictions by which methods are compared.

        *From the start*: warm up on the first samples, simulate to the end. *Forecast*: warm up on
        the last training samples, simulate beyond them. *Test record*: warm up on its first
        samples, simulate to its end.
        """
        train, warmup = self.train, self.settings.warmup
        first = first_origin(self.record, train, forecaster.warmup or warmup)
        origins = [first, Origin(train, train)][: 1 + (self.horizon > 0)]
        return BacktestSpec(
            self.record,
            origins,
            train + self.horizon,
            self.others,
            self.tests,
            warmup,
            self.initial,
        )

    def held_out_spec(self, forecaster: Forecaster) -> BacktestSpec:
        """Return the forecasts of the training part's last quarter, by a fit to the rest of it."""
        origins = held_out_origins(forecaster, self.held_out)
        end = self.train + self.horizon
        return BacktestSpec(self.held_out, origins, end, self.others, components=False)

    def on_baseline(self, base: str) -> Plan:
        """Return the plan with a network on this baseline, which learns what that leaves.

        Not in the paper.
        """
        (name,) = with_base(["residual-gru-conditioned"], base)
        network = with_defaults(named(name, self.sizes), self.settings, self.bands)
        return replace(
            self, methods=(*self.methods, network), searched={**self.searched, name: False}
        )

    def as_json(self) -> dict[str, Any]:
        """Return what was decided, for a result file."""
        bands, high = asdict(self.bands), asdict(self.high)
        choice, of_high = bands.pop("choice"), high.pop("choice")
        return (
            {"train": self.train, "settings": asdict(self.settings)}
            | bands
            | ({} if of_high is None else {"high": high})
            | asdict(self.sizes)
            | ({} if self.simulator is None else {"parameters": str(self.simulator.known)})
            | {"choice": choice, "searched": [*self.searched]}
            | {name: getattr(self, name) for name in ("budget", "rounds", "seed", "seeds")}
        )


def plan(  # noqa: PLR0913
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    horizon: int | None = None,
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
) -> Plan:
    """Plan a comparison, and check records, methods and settings.

    Parameters
    ----------
    record : The measured record, with its inputs and simulator's output, if any.
    train : Samples to train on, by default three quarters; with `tests` all of them. With
        `len(record)` nothing is left to compare with but the held-out forecasts.
    methods : Forecasters, or names (`splitband methods`). By default the methods worth comparing on
        such a record.
    horizon : Samples to predict after the training part, by default to the end of the record; 0 is
        for fitting alone.
    others : Further records of the same system, to train on.
    tests : Records of the same system that nothing is fitted to; each is simulated to its end after
        a warm-up on its first samples. A simulator that inputs drive runs for them and `others`.
    initial : Measured samples at the beginning of a test record, by default the warm-up.
    settings : Training settings of the networks, or some of them, such as `{"epochs": 5}`. All but
        `warmup` fix how networks are trained. By default that is searched on the last quarter of
        the training part.
    recipe : Settings where none are given: "default", or "constant-rate", which is not searched.
    bands : Cut-off, order and down-sampling; what is not given is chosen from the training samples.
    sizes : Of the networks given by name; by default they are searched.
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
    seeds : Trainings of each network, whose median is handed out, by default three. Where settings
        are searched, the most in the median of the best network, by default as many as do best;
        the others are trained once.
    refit : Whether the recommended method is refitted to the whole record at the end.
    device : That networks are trained on: cpu, cuda, cuda:1.

    Returns
    -------
    Plan
        For `run`; no method has been fitted yet.

    Raises
    ------
    ValueError
        For invalid records, methods, settings or numbers of samples.
    """
    require_records("record", record)
    for name, several in (("others", others), ("tests", tests)):
        if isinstance(several, Record):
            raise TypeError(f"{name} must be a list of records, got a single one: write [record]")
        require_records(name, *several)
    check_limits(budget, rounds, seed, seeds)
    check_device(device)
    if initial is not None and not tests:
        raise InputError(f"initial must be used with test records, got {initial}")
    if train is None:
        train = len(record) if tests else int(TRAINING_SHARE * len(record))
    if isinstance(simulator, str) and simulator not in BASES:
        simulator = open_simulator(simulator, record)
    elif record.y_sim is not None and not (simulator is None or is_fitted(simulator)):
        raise InputError(
            "simulator must be left out for a record that has a simulator's output (y_sim), or "
            "that output be taken out of the record: got both"
        )
    names = _asked(record, methods, simulator, calibrate, conditioned)
    fitted: Any = simulator if is_fitted(simulator) else None
    record = _with_output(record, simulator, names)
    others, tests = ([_driven(each, simulator) for each in several] for several in (others, tests))
    tried = horizon != 0 or bool(tests)
    record, horizon = _cut_to_horizon(record, train, horizon, refit)
    training, changes = record[:train], settings if isinstance(settings, Mapping) else {}
    given = settings if isinstance(settings, TrainingSettings) else None
    decided = _settings(given or recipe_settings(recipe, training, others), changes)
    if tests and given is None and "warmup" not in changes:
        shortest = default_warmup(min(map(len, tests)))
        decided = replace(decided, warmup=min(decided.warmup, shortest))
    searched = recipe == "default" and given is None and not {*changes} - {"warmup"}
    if names is None:
        asked, chosen, high = _default_methods(bands or OPEN, training, decided, fitted)
    else:
        asked, listed = names, [_known(each) for each in names]
        check_needs(listed, record, others)
        chosen = chosen_bands(bands or OPEN, training, listed, decided)
        above = _any_takes_bands(listed, "high")
        high = high_bands(bands or OPEN, training, decided) if above else OPEN
    usual = Sizes(hidden_high=32, hidden_low=16) if recipe == "default" else Sizes()
    if fitted is not None:
        check_runs(fitted, record)
    found = Plan(
        record, train, horizon, (), decided, chosen, sizes or usual, others=tuple(others),
        tests=tuple(tests), initial=initial, simulator=fitted, rounds=rounds, seed=seed,
        seeds=seeds, refit=refit, high=high,
    )  # fmt: skip
    found = _completed(found, asked, bands or OPEN, searched, sizes is None, device)
    check_limits(budget, rounds, seed, seeds, bool(found.searched))
    limit = BUDGET if budget is None and rounds is None and found.searched else budget
    found = replace(
        found,
        budget=None if limit is None or limit == math.inf else float(limit),
        extended=bool(names is None and fitted is None and found.searched),
    )
    check(found)
    if tried:
        check_trial(found)
    return replace(found, tests=_with_distinct_names(tests, record.name))


def _with_simulator(simulator: Any, part: Forecaster) -> Forecaster:
    """Return a part with this simulator, if it fits the parameters of one and has none."""
    lacks_it = isinstance(part, GreyBox) and part.simulator is None
    return part.clone().set_params(simulator=simulator) if lacks_it else part


def _known(method: Forecaster | str, sizes: Sizes | None = None) -> Forecaster:
    return known(method, sizes) if isinstance(method, str) else method


def _asked(
    record: Record,
    methods: Sequence[Forecaster | str] | str | None,
    simulator: Simulator | Adjustable | str | None,
    calibrate: bool,
    conditioned: bool,
) -> list[Forecaster | str] | None:
    """Return the methods that the options select; None if they select none."""
    base = GREY_BOX if is_fitted(simulator) else simulator
    if methods is None:
        if not (calibrate or conditioned or isinstance(simulator, str)):
            return None
        methods = default_names(simulator is not None or record.y_sim is not None, record.nu > 0)
    asked: list[Forecaster | str] = [methods] if isinstance(methods, str) else [*methods]
    if calibrate or conditioned:
        names = [each for each in asked if isinstance(each, str)]
        others = [each for each in asked if not isinstance(each, str)]
        asked = [*others, *with_variants(names, calibrate, conditioned)]
    if not isinstance(base, str):
        return asked
    on_base = {m: with_base([m], base)[0] if isinstance(m, str) else m for m in asked}
    return [*dict.fromkeys(on_base.values())]


def _with_output(
    record: Record,
    simulator: Simulator | Adjustable | str | None,
    names: Sequence[Forecaster | str] | None,
) -> Record:
    """Return the record with the output of a simulator, unless its parameters are fitted."""
    if simulator is None or isinstance(simulator, str) or is_fitted(simulator):
        return record
    expected = default_names(True, record.nu > 0) if names is None else names
    longer = any(_known(each)._calibrates for each in expected)
    running: Any = simulator
    return simulated(record, running, longer=longer)


def _driven(further: Record, simulator: Simulator | Adjustable | str | None) -> Record:
    """Return a further record with the output of a simulator that its inputs drive, if it lacks it.

    A function of time alone says nothing of another record.
    """
    no_output = simulator is None or isinstance(simulator, str) or is_fitted(simulator)
    if no_output or further.y_sim is not None:
        return further
    running: Any = matched(simulator, further.columns, further.inputs)
    return simulated(further, running, longer=True) if running.driven else further


def _completed(
    plan: Plan,
    asked: Sequence[Forecaster | str],
    given: Bands,
    searched: bool,
    sized: bool,
    device: str,
) -> Plan:
    """Return the plan with these methods, complete but for what is searched."""
    made, names = list[Forecaster](), dict[str, bool]()
    for each in asked:
        method = _known(each, plan.sizes)
        complete = with_defaults(method, plan.settings, plan.bands, given, plan.high)
        if isinstance(each, str) and plan.simulator is not None:
            complete = with_parts_changed(complete, partial(_with_simulator, plan.simulator))
        if searched and isinstance(complete, Network) and method.settings is None:
            names[complete.name] = isinstance(each, str) and sized
        made.append(complete if device == "cpu" else complete.to(device))
    return replace(plan, methods=tuple(made), searched=names)


def _settings(usual: TrainingSettings, changes: Mapping[str, Any]) -> TrainingSettings:
    """Return settings with some of them changed, and those that follow from the changes."""
    said = {**changes}
    if "window" in said:
        said.setdefault("warmup", default_warmup(said["window"], usual.warmup))
    if "milestones" in said:
        said.setdefault("one_cycle", False)
    try:
        return replace(usual, **said)
    except TypeError:
        known = ", ".join(vars(usual))
        raise InputError(f"settings must be out of {known}, got {', '.join(changes)}") from None


def chosen_bands(
    given: Bands,
    training: Record,
    methods: Sequence[Forecaster],
    settings: TrainingSettings | None = None,
) -> Bands:
    """Return the bands of these methods: of hybrids where the simulator helps, else of networks.

    What is given stays. Settings are by default the usual ones for such a record.
    """
    settings = settings or recipe_settings("default", training)
    if given.cutoff is None and not _any_takes_bands(methods, "low"):
        return given
    methods = [method for method in methods if not _any_takes_bands([method], "high")]
    below = [each for method in methods for part in parts_of(method) for each in all_parts(part)]
    y_sim, beside = None, [p for p in below if not parts_of(p) and "simulator" in p.needs]
    if training.y_sim is not None and beside:
        simulation = next((f for f in beside if f._calibrates), beside[0]).clone()
        y_sim = simulation.fit(training).on(training).y_sim
    # Where the record has no band to split off, the methods that need one report it.
    with nullcontext() if given.cutoff is not None else suppress(ValueError):
        return given.chosen(training.y, training.sampling_rate, settings.warmup, y_sim)
    return given


def high_bands(given: Bands, training: Record, settings: TrainingSettings | None = None) -> Bands:
    """Return the bands of hybrids with the record's simulator in the high band.

    What is given stays. The simulator is not calibrated: its drift would decide its gain. Settings
    are by default the usual ones for such a record.
    """
    y, rate, y_sim = training.y, training.sampling_rate, training.y_sim
    settings = settings or recipe_settings("default", training)
    with nullcontext() if given.cutoff is not None else suppress(ValueError):
        return given.chosen(y, rate, settings.warmup, y_sim, "high")
    return given


def _any_takes_bands(methods: Sequence[Forecaster], simulator_band: Band) -> bool:
    """Return whether one of the methods takes a comparison's bands, of hybrids of this kind."""
    every = [part for method in methods for part in all_parts(method)]
    networks = [part for part in every if isinstance(part, Network)]
    return any(p._takes_bands and p.simulator_band == simulator_band for p in networks)


def default_names(with_simulator: bool, with_inputs: bool = False) -> list[str]:
    """Return the names of the default methods, with a simulator that helps or without.

    Of the methods that ignore inputs, a record with inputs is compared with the mean and with the
    last value alone.
    """
    naive, first = ["mean", "persistence", "seasonal-naive", "periodic", "harmonic"], ["gru"]
    if with_inputs:
        naive, first = ["linear", "mean", "persistence"], ["state-space", "gru"]
    if not with_simulator:
        return [*first, *naive]
    hybrids = [f"{kind}-state-space-calibrated-conditioned" for kind in ("filtered", "residual")]
    trained = [hybrids[1], first[0], hybrids[0], *first[1:]] if with_inputs else [*first, *hybrids]
    return [*trained, "simulator", "simulator-calibrated", *naive]


def usual_names(names: list[str], bands: Bands, high: Bands) -> list[str]:
    """Return default names, with hybrids of the bands in which the record's simulator helps.

    A hybrid with the simulator in the high band, as of a sensor that drifts, is tried where a lower
    error is expected of it than of one with the low band. Without such a band, there are no
    hybrids.
    """
    if bands.choice is None or bands.choice.simulator_helps is None:
        return names
    below, above = bands.choice, high.choice
    at = next(i for i, name in enumerate(names) if name.startswith("filtered-"))
    hybrids = names[at : at + 1] if below.simulator_helps else []
    helps = above is not None and above.simulator_helps
    if above is not None and helps and (not hybrids or above.expected < below.expected):
        hybrids = ["filtered-high-state-space-conditioned", *hybrids]
    if hybrids:
        return [*names[:at], *hybrids, *names[at + 1 :]]
    return [name for name in names if name not in HYBRIDS]


def _default_methods(
    given: Bands, training: Record, settings: TrainingSettings, simulator: Adjustable | None
) -> tuple[Sequence[Forecaster | str], Bands, Bands]:
    """Return the default methods for a record, and their bands, low and high.

    A simulator with parameters is also compared before its fit.
    """
    driven = training.nu > 0
    if simulator is not None:
        names = with_base(default_names(True, driven), GREY_BOX)
        middle, at = simulator.fixed(simulator.known.middle()), names.index(GREY_BOX)
        unfitted = GreyBox(middle, name=UNFITTED_SIMULATOR)
        return [*names[:at], unfitted, *names[at:]], OPEN, OPEN
    names = default_names(training.y_sim is not None, driven)
    listed = [known(name) for name in names]
    check_bands(given, listed)
    low = chosen_bands(given, training, listed, settings)
    high = OPEN if low.choice is None else high_bands(given, training, settings)
    names = usual_names(names, low, high)
    if any(_any_takes_bands([known(name)], "low") for name in names):
        return names, low, high
    return names, Bands(choice=low.choice), high  # which says why the simulator does not help


def _cut_to_horizon(
    record: Record, train: int, horizon: int | None, refit: bool
) -> tuple[Record, int]:
    """Return the record up to its last sample to predict, and the horizon."""
    check_train(record, train)
    if horizon is None:
        return record, len(record) - train
    whole("horizon", horizon, 0)
    if train + horizon > len(record):
        raise InputError(
            f"horizon must end within the record: at most {len(record) - train} samples after the "
            f"{train} of train, got {horizon}; `splitband forecast` predicts beyond it"
        )
    if refit and train + horizon < len(record):
        raise InputError(
            f"refit must be left out where horizon leaves out samples of the record, got {horizon} "
            f"after the {train} of train: fit the recommended method to all {len(record)} "
            "afterwards (splitband fit)"
        )
    return record[: train + horizon], horizon


def _with_distinct_names(tests: Sequence[Record], record: str) -> tuple[Record, ...]:
    """Return the test records with distinct names, numbered where they are equal or missing.

    They differ from that of the `record`, too.
    """
    names = [record]
    for i, test in enumerate(tests):
        name, count = test.name or str(i + 1), 1
        while name in names:
            count += 1
            name = f"{test.name or i + 1} ({count})"
        names.append(name)
    return tuple(replace(test, name=name) for test, name in zip(tests, names[1:], strict=True))
