"""Plan a comparison: decide every default, and check everything, before anything runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from splitband.data import Record, check_alike, require_records
from splitband.data.signals import first_after
from splitband.forecasters.backtest import (
    BacktestSpec,
    Origin,
    first_held_out,
    first_origin,
    for_trial,
    held_out_origins,
)
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster, all_parts, parts_of, with_parts_changed
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.names import GREY_BOX, NAMES, QUICK, Sizes, known, named, with_base
from splitband.forecasters.network import Network, with_defaults
from splitband.runtime.arguments import whole
from splitband.runtime.errors import InputError
from splitband.simulators.identification import check_runs
from splitband.simulators.parameters import Adjustable
from splitband.training import Settings, default_warmup
from splitband.training.settings import Recipe, recipe_settings

TRAINING_SHARE = 0.75
"""Default share of a record to train on."""
BUDGET = 120.0
"""Default wall time of a comparison that searches how to train its networks, in s."""
LARGEST_SEED = 2**32 - 1
"""Seeds of single trainings, which are multiples of it, must fit into 64 bits."""
UNFITTED_SIMULATOR = "simulator-as-given"
"""Name of a simulator whose parameters are not fitted, but the middles of their ranges."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Hold all decisions of a comparison; `run` computes it.

    Attributes
    ----------
    record : The measured record, up to its last sample to predict.
    train : Length of the training part, in samples.
    horizon : Samples to forecast beyond the training part.
    methods : Forecasters, complete but for what is searched.
    settings, bands, sizes : Training settings, bands and sizes of those that had none of their own.
    searched : Names of the networks whose settings are searched; True: their sizes, too.
    extended : Whether a network on the best baseline is a method, too, if it is the best one.
    others : Further records to train on.
    tests : Records that nothing is fitted to, with distinct names.
    initial : ForecastContext samples at the beginning of a test record; None: the warm-up.
    simulator : Simulator whose parameters are fitted, for methods without one.
    budget : Wall time of the whole comparison in s; None: no limit.
    rounds : Rounds of the search, in place of a time limit; None: as many as the time allows.
    seed : Of all random numbers.
    seeds : Trainings of each network that is not searched; of the others the median of as many,
        or, with None, of those that did best together.
    refit : Whether the recommended method is refitted to the whole record.
    """

    record: Record
    train: int
    horizon: int
    methods: tuple[Forecaster, ...]
    settings: Settings
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

    @property
    def training(self) -> Record:
        """Return the training part of the record."""
        return self.record[: self.train]

    @property
    def names(self) -> list[str]:
        """Return the names of the methods."""
        return [method.name for method in self.methods]

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
        record = replace(self.training, y_true=None)
        origins = held_out_origins(forecaster, record)
        return BacktestSpec(record, origins, self.train + self.horizon, self.others)

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
        bands = asdict(self.bands)
        return (
            {"train": self.train, "settings": asdict(self.settings)}
            | {name: bands[name] for name in ("cutoff", "order", "downsampling")}
            | asdict(self.sizes)
            | ({} if self.simulator is None else {"parameters": str(self.simulator.known)})
            | {"choice": bands["choice"], "searched": [*self.searched]}
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
    settings: Settings | Mapping[str, Any] | None = None,
    recipe: Recipe = "default",
    bands: Bands | None = None,
    sizes: Sizes | None = None,
    simulator: Adjustable | None = None,
    budget: float | None = None,
    rounds: int | None = None,
    seed: int = 0,
    seeds: int | None = None,
    refit: bool = False,
) -> Plan:
    """Plan a comparison, and check records, methods and settings.

    Parameters
    ----------
    record : The measured record, with its inputs and simulator's output, if any.
    train : Samples to train on, by default three quarters; with `tests` all of them.
    methods : Forecasters, or names (`splitband methods`). By default the methods worth comparing on
        such a record.
    horizon : Samples to predict after the training part, by default to the end of the record. If
        the whole record is trained on, they lie beyond it, as far as its inputs and its simulator's
        output are known (`u_beyond`, `beyond`); 0 is for fitting alone.
    others : Further records of the same system, to train on.
    tests : Records of the same system that nothing is fitted to; each is simulated to its end after
        a warm-up on its first samples.
    initial : ForecastContext samples at the beginning of a test record, by default the warm-up.
    settings : Training settings of the networks, or some of them, such as `{"epochs": 5}`. All but
        `warmup` fix how networks are trained. By default that is searched on the last quarter of
        the training part.
    recipe : Settings where none are given: "default", or "constant-rate", which is not searched.
    bands : Cut-off, order and down-sampling; what is not given is chosen from the training samples.
    sizes : Of the networks given by name; by default they are searched.
    simulator : Simulator whose parameters are fitted, for methods without one.
    budget : Wall time of the whole comparison in s, by default two minutes if there is something
        to search, and no limit otherwise. `math.inf` is no limit.
    rounds : Rounds of the search in place of a time limit: the same work, and the same result, on
        every machine.
    seed : Of all random numbers.
    seeds : Trainings of each network, whose median is handed out; by default three where settings
        are given, and as many as do best where they are searched.
    refit : Whether the recommended method is refitted to the whole record at the end.

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
    _check_limits(budget, rounds, seed, seeds)
    if train is None:
        train = len(record) if tests else int(TRAINING_SHARE * len(record))
    record, horizon = _cut_to_horizon(record, train, horizon, bool(tests))
    training, changes = record[:train], settings if isinstance(settings, Mapping) else {}
    given = settings if isinstance(settings, Settings) else None
    decided = _settings(given or recipe_settings(recipe, training, others), changes)
    if tests and given is None and "warmup" not in changes:
        shortest = default_warmup(min(map(len, tests)))
        decided = replace(decided, warmup=min(decided.warmup, shortest))
    usual = recipe == "default" and given is None and not {*changes} - {"warmup"}
    names = [methods] if isinstance(methods, str) else methods
    asked = default_names(record.y_sim is not None, record.nu > 0) if names is None else [*names]
    with_bands = [known(each) if isinstance(each, str) else each for each in asked]
    chosen = chosen_bands(bands or Bands(), training, decided, with_bands)
    small = Sizes(hidden_high=32, hidden_low=16) if recipe == "default" else Sizes()
    of_names = sizes or small
    if names is None:
        asked = _usual(record, chosen, simulator)
    if simulator is not None:
        check_runs(simulator, record)
    made, searched = list[Forecaster](), dict[str, bool]()
    for each in asked:
        method = known(each, of_names) if isinstance(each, str) else each
        complete = with_defaults(method, decided, chosen)
        if isinstance(each, str) and simulator is not None:
            complete = with_parts_changed(complete, partial(_given, simulator))
        if usual and isinstance(complete, Network) and method.settings is None:
            searched[complete.name] = isinstance(each, str) and sizes is None
        made.append(complete)
    if rounds is not None and not searched:
        raise InputError(f"rounds must be left out where no training is searched, got {rounds}")
    limit = BUDGET if budget is None and rounds is None and searched else budget
    found = Plan(
        record, train, horizon, tuple(made), decided, chosen, of_names, searched,
        bool(names is None and simulator is None and searched),
        tuple(others), tuple(tests), initial, simulator,
        None if limit in (None, math.inf) else float(limit or 0), rounds, seed, seeds, refit,
    )  # fmt: skip
    check(found)
    if horizon or tests:
        _check_trial(found)
    return replace(found, tests=_with_distinct_names(tests))


def _given(simulator: Any, part: Forecaster) -> Forecaster:
    """Return a part with this simulator, if it fits the parameters of one and has none."""
    open_ = isinstance(part, GreyBox) and part.simulator is None
    return part.clone().set_params(simulator=simulator) if open_ else part


def _check_limits(budget: float | None, rounds: int | None, seed: int, seeds: int | None) -> None:
    if budget is not None and not budget > 0:
        raise InputError(f"budget must be a positive number of seconds, got {budget}")
    if budget is not None and rounds is not None:
        raise InputError(
            f"budget and rounds exclude each other (the one limits the time, the other the work), "
            f"got {budget} and {rounds}"
        )
    if rounds is not None:
        whole("rounds", rounds)
    whole("seed", seed, 0, LARGEST_SEED)
    if seeds is not None:
        whole("seeds", seeds)


def _settings(usual: Settings, changes: Mapping[str, Any]) -> Settings:
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
    settings: Settings | None = None,
    methods: Sequence[Forecaster] | None = None,
) -> Bands:
    """Return the bands: for hybrids where the simulator helps, else for networks alone.

    Parameters
    ----------
    given : What is not None stays.
    training : The training part of the record.
    settings, methods : By default the usual ones for such a record.
    """
    settings = settings or recipe_settings("default", training)
    if methods is None:
        usual = default_names(training.y_sim is not None, training.nu > 0)
        methods = [known(name) for name in usual]
    every = [part for method in methods for part in all_parts(method)]
    if given.cutoff is None and not any(isinstance(p, Network) and p._takes_bands for p in every):
        return given
    below = [each for method in methods for part in parts_of(method) for each in all_parts(part)]
    y_sim, beside = None, [p for p in below if not parts_of(p) and "simulator" in p.needs]
    if training.y_sim is not None and beside:
        simulation = next((f for f in beside if f._calibrates), beside[0]).clone()
        y_sim = simulation.fit(training).on(training).y_sim
    # Where the record has no band to split off, the methods that need one report it.
    with nullcontext() if given.cutoff is not None else suppress(ValueError):
        return given.chosen(training.y, training.sampling_rate, settings.warmup, y_sim)
    return given


def default_names(with_simulator: bool, with_inputs: bool = False) -> list[str]:
    """Return the names of the default methods, with a simulator that helps or without.

    Of the methods that ignore inputs, a record with inputs is compared with the mean and with the
    last value alone.
    """
    naive = ["mean", "persistence", "seasonal-naive", "periodic", "harmonic"]
    first, cell = ["gru"], "gru"
    if with_inputs:
        naive = ["linear", "mean", "persistence"]
        first, cell = ["state-space", "gru"], "state-space"
    if not with_simulator:
        return [*first, "split-gru", "split-gru-conditioned", *naive]
    hybrids = [f"filtered-{cell}-calibrated-conditioned", f"residual-{cell}-calibrated-conditioned"]
    trained = [hybrids[1], first[0], hybrids[0], *first[1:]] if with_inputs else [*first, *hybrids]
    return [*trained, "simulator", "simulator-calibrated", *naive]


def usual_names(record: Record, bands: Bands) -> list[str]:
    """Return `default_names`, without hybrids where the record's simulator does not help."""
    names = default_names(record.y_sim is not None, record.nu > 0)
    if bands.choice is None or bands.choice.simulator_helps is not False:
        return names
    kept = [name for name in names if name in QUICK and "simulator" in NAMES[name].needs]
    learned = default_names(False, record.nu > 0)
    trained = next(i for i, name in enumerate(learned) if name in QUICK)
    return [*learned[:trained], *kept, *learned[trained:]]


def _usual(record: Record, bands: Bands, simulator: Adjustable | None) -> list[Forecaster | str]:
    """Return the default methods for a record; a simulator is also compared before its fit."""
    if simulator is None:
        return [*usual_names(record, bands)]
    middle = simulator.fixed(simulator.known.middle())
    names = with_base(default_names(True, record.nu > 0), GREY_BOX)
    at = names.index(GREY_BOX)
    return [*names[:at], GreyBox(middle, name=UNFITTED_SIMULATOR), *names[at:]]


def check_train(record: Record, train: int, horizon: int = 1) -> None:
    """Check that there is something to train on and `horizon` samples to predict."""
    if not 2 <= whole("train", train, None) <= len(record) - horizon:
        raise InputError(
            f"train must be between 2 and {len(record) - horizon} for a record of {len(record)} "
            f"samples, got {train}"
        )


def check(plan: Plan) -> None:
    """Check a plan, except for the trial on held-out samples.

    A method that cannot be fitted does not stop the others: its row gives the reason, which is
    raised only if no method can be fitted.
    """
    if not plan.methods:
        raise InputError("methods must be one or several, got none")
    twice = next((name for name in plan.names if plan.names.count(name) > 1), None)
    if twice:
        raise InputError(
            f"methods must have names that differ, two are {twice}; a forecaster takes another "
            "one as `name`"
        )
    _check_records(plan)
    wrong: list[ValueError] = []
    for forecaster in plan.methods:
        try:
            forecaster.check(plan.training, *plan.others)
        except ValueError as error:
            wrong.append(error)
    if len(wrong) == len(plan.methods):
        raise wrong[0]


def _cut_to_horizon(
    record: Record, train: int, horizon: int | None, tested: bool
) -> tuple[Record, int]:
    """Return the record up to its last sample to predict, and the horizon."""
    beyond = horizon is not None and train == len(record)
    check_train(record, train, 0 if tested or beyond or horizon == 0 else 1)
    if horizon is None:
        return record, len(record) - train
    whole("horizon", horizon, 0)
    if beyond:
        for what, known, coming in (
            ("known inputs", record.u, record.u_beyond),
            ("the simulator", record.y_sim, record.beyond),
        ):
            reach = 0 if coming is None else len(coming)
            if known is not None and reach < horizon:
                raise InputError(
                    f"{what} must reach {horizon} samples beyond the record, got {reach}"
                )
        return record, horizon
    if train + horizon > len(record):
        raise InputError(
            f"horizon must end within the record: at most {len(record) - train} samples after the "
            f"{train} of train, got {horizon}"
        )
    return record[: train + horizon], horizon


def _check_records(plan: Plan) -> None:
    record, train, warmup = plan.record, plan.train, plan.settings.warmup
    for other in plan.others:
        check_alike(other, record, other.name or "another record")
    for test in plan.tests:
        _check_test(test, plan)
    if warmup >= train:
        raise InputError(f"warmup must be shorter than the {train} training samples, got {warmup}")
    for name, part in (("training", slice(train)), ("predicted", slice(train, None))):
        predicted = record.truth[part]
        if len(predicted) and np.isnan(predicted).all(axis=0).any():
            raise InputError(f"the {name} part must have a measured sample in every channel")


def _check_test(test: Record, plan: Plan) -> None:
    check_alike(test, plan.record, test.name or "a test record")
    name, samples = "initial", plan.initial
    if samples is None:
        name = "warmup"
        samples = max(plan.settings.warmup, *(f.warmup for f in plan.methods))
    begin = first_after(test.complete, max(whole(name, samples), 2))
    if begin in (None, len(test)):
        raise InputError(
            f"{name} must fit into the test record {test.name} of {len(test)} samples, with "
            f"samples to predict after it, got {samples}"
        )
    if np.isnan(test.truth[begin:]).all(axis=0).any():
        raise InputError(
            f"every channel of the test record {test.name} must be measured somewhere after "
            f"its first {begin} samples, on which methods warm up"
        )


def _check_trial(plan: Plan) -> None:
    """Check the trial on the last quarter of the training part."""
    part = replace(plan.training, y_true=None)
    train = first_held_out(plan.train)
    shorter = tuple(for_trial(f, plan.train) for f in plan.methods)
    try:
        check(
            replace(
                plan, record=part, train=train, horizon=len(part) - train, methods=shorter, tests=()
            )
        )
    except ValueError as error:
        raise InputError(
            f"{error} (a method is chosen on the last quarter of the {plan.train} training "
            "samples, trained on the rest)"
        ) from None


def _with_distinct_names(tests: Sequence[Record]) -> tuple[Record, ...]:
    """Return the test records with distinct names, numbered where names are equal or missing."""
    names: list[str] = []
    for i, test in enumerate(tests):
        name, count = test.name or str(i + 1), 1
        while name in names:
            count += 1
            name = f"{test.name} ({count})"
        names.append(name)
    return tuple(replace(test, name=name) for test, name in zip(tests, names, strict=True))
