"""Plan a comparison: decide every default, and check everything, before anything runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from splitband.checks.inspection import of_unnamed, unnamed_inputs
from splitband.comparison.backtest import BacktestSpec, first_origin
from splitband.comparison.checks import check_needs, check_train
from splitband.comparison.defaults import bands_of, default_names, usual_methods
from splitband.comparison.methods import BASES, GREY_BOX, Sizes, built, forecasters, is_built
from splitband.comparison.request import PlanRequest
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster, with_parts_changed
from splitband.forecasters.fitted import unmoved
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.held_out import (
    Origin,
    beginning,
    first_held_out,
    held_out_origins,
    many_origins,
)
from splitband.forecasters.initialisation import reach_of
from splitband.forecasters.network import Network, with_defaults
from splitband.forecasters.simulation import Simulation
from splitband.records import Record, check_alike
from splitband.records.signals import first_after
from splitband.runtime.arguments import whole
from splitband.runtime.errors import InputError
from splitband.runtime.optional import LEFT_OUT, has_torch
from splitband.simulators import Simulator
from splitband.simulators.base import matched
from splitband.simulators.identification import check_runs
from splitband.simulators.open_simulator import is_fitted, open_simulator, simulated
from splitband.simulators.parameters import Adjustable
from splitband.training import TrainingSettings
from splitband.training.settings import default_warmup, recipe_settings, within_reach

BUDGET = 120.0
"""Default wall time of a comparison that searches how to train its networks, in s."""
UNFITTED_SIMULATOR = "simulator-as-given"
"""Name of a simulator whose parameters are not fitted, but the middles of their ranges."""
WITHOUT_TERMS = "grey-box-without-terms"
"""Name of an equation with fitted parameters whose unknown terms stay as before training."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All decisions of a comparison; `run` computes it.

    Attributes
    ----------
    record : The measured record, up to its last sample to predict.
    methods : Forecasters, complete but for what is searched.
    settings, bands, sizes : Training settings, bands and sizes of those that had none of their own.
    searched : Names of the networks whose settings are searched; True: their sizes, too.
    extended : Whether a network on the best baseline is a method, too, if it is the best one.
    reach : Samples ahead for which forecasts of an unstable plant are worth making, and which
        windows of trainings predict; None for any other record.
    tests : Records that nothing is fitted to, with distinct names.
    simulator : Simulator whose parameters are fitted, for methods without one.
    high : Bands of hybrids with the simulator in the high band.
    without_networks : Whether the default methods lack networks, for want of torch.
    elsewhere : By name of a simulation made elsewhere, the record and the test records with it.
    train, horizon, ahead, others, initial, budget, rounds, seed, seeds, refit : See `compare`;
        decided.
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
    ahead: int | None = None
    reach: int | None = None
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
    without_networks: bool = False
    elsewhere: Mapping[str, Sequence[Record]] = field(default_factory=dict)

    @property
    def also(self) -> frozenset[str]:
        """Return the names of methods that are never recommended."""
        return frozenset(self.elsewhere)

    @cached_property
    def training(self) -> Record:
        """Return the training part of the record."""
        return beginning(self.record, self.train)

    @cached_property
    def held_out(self) -> Record:
        """Return the record of which the last quarter is held out, for all trials."""
        return replace(self.training, y_true=None)

    @property
    def names(self) -> list[str]:
        """Return the names of the methods."""
        return [method.name for method in self.methods]

    @property
    def simulated(self) -> int:
        """Return the samples of the longest simulation; 0 where methods are not judged by one."""
        if self.ahead is not None or self.reach is not None:
            return 0
        held_out = self.train - first_held_out(self.train)
        return max([held_out, self.horizon, *map(len, self.tests)])

    @cached_property
    def warnings(self) -> list[str]:
        """Return what seems wrong in the records, a sentence each; see `Record.warnings`.

        Outputs that are probably inputs come first; that networks are left out comes last.
        """
        unnamed = of_unnamed(unnamed_inputs(self.record))
        if self.reach is not None:
            unnamed.append(
                "The plant is unstable, and a controller holds it: errors of a free run grow until "
                "it leaves the record. "
                + (
                    f"Judge forecasts instead: ahead={self.reach} (--ahead {self.reach})."
                    if self.ahead is None
                    else f"Methods are judged by forecasts {self.ahead} samples ahead."
                )
            )
        others = (*self.others, *self.tests)
        found = [f"{each.name}: {said}" for each in others for said in each.warnings()]
        own = f"{self.record.name}: " if others and self.record.name else ""
        rest = unmoved([self.training, *self.others])
        rest += [LEFT_OUT] * self.without_networks
        return [*unnamed, *(f"{own}{said}" for said in self.record.warnings()), *found, *rest]

    def spec(self, forecaster: Forecaster) -> BacktestSpec:
        """Return the predictions by which methods are compared.

        *From the start*: warm up on the first samples, simulate to the end. *Forecast*: warm up on
        the last training samples, simulate beyond them. *Test record*: warm up on its first
        samples, simulate to its end. With `ahead`, also from many origins after the training part
        and in test records.
        """
        train, warmup, ahead = self.train, self.settings.warmup, self.ahead
        first = first_origin(self.record, train, forecaster.warmup or warmup)
        origins = [first, Origin(train, train)][: 1 + (self.horizon > 0)]
        if ahead is not None:
            origins += many_origins(train, train, len(self.record), ahead)
        record, *tests = self.elsewhere.get(forecaster.name, (self.record, *self.tests))
        return BacktestSpec(record, origins, self.others, tests, warmup, self.initial, ahead)

    def held_out_spec(self, forecaster: Forecaster) -> BacktestSpec:
        """Return the forecasts of the training part's last quarter, by a fit to the rest of it."""
        origins = held_out_origins(forecaster, self.held_out, self.ahead)
        record, *_ = self.elsewhere.get(forecaster.name, (self.record,))
        return BacktestSpec(record, origins, self.others, components=False)

    def on_baseline(self, base: str) -> Plan:
        """Return the plan with a network on this baseline, which learns what that leaves.

        Not in the paper.
        """
        (learner,) = forecasters(["residual-gru-conditioned"], self.sizes, base)
        network = with_defaults(built(learner), self.settings, self.bands)
        searched = {**self.searched, network.name: False}
        return replace(self, methods=(*self.methods, network), searched=searched)

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
            | {name: getattr(self, name) for name in ("ahead", "budget", "rounds", "seed", "seeds")}
        )


def plan(asked: PlanRequest) -> Plan:
    """Plan a comparison, and check everything, before anything is fitted; see `compare`."""
    base, fitted, beside = _roles(asked.simulator, asked.record)
    of_paper = Sizes(hidden_low=32, hidden_high=64)
    sizes = asked.sizes or (Sizes() if asked.recipe == "default" else of_paper)
    train, named, default = asked.samples, asked.methods, False
    if named is None:
        with_simulator = asked.simulator is not None or asked.record.y_sim is not None
        named, default = default_names(with_simulator, asked.record.nu > 0), True
    listed = forecasters(named, sizes, base, asked.calibrate, asked.conditioned)
    if beside is not None:
        asked = _beside(asked, beside, longer=any(each.calibrates for each in listed))
    record, horizon = _cut_to_horizon(asked, train)
    training, given, others = beginning(record, train), asked.bands or OPEN, asked.others
    reach = reach_of(training, others)
    decided, search = _settings(asked, training, reach)
    usual = default and not (base or asked.calibrate or asked.conditioned)
    if usual:
        listed, low, high = usual_methods(given, training, decided, sizes)
    else:
        check_needs(listed, record, others)
        low, high = bands_of(listed, given, training, decided)
    if fitted is not None:
        check_runs(fitted, record)
        alone = fitted.without_terms()
        if default:
            at = [method.name for method in listed].index(GREY_BOX)
            if alone is not fitted and fitted.known.free:
                listed.insert(at, GreyBox(alone, name=WITHOUT_TERMS))
            middle = alone.fixed(fitted.known.middle())
            listed.insert(at, GreyBox(middle, name=UNFITTED_SIMULATOR))
        # Below a hybrid, a network outside of the equation is in place of the unknown terms.
        listed = [
            with_parts_changed(
                each, partial(_with_simulator, fitted if isinstance(each, GreyBox) else alone)
            )
            for each in listed
        ]
    searched = {
        method.name: asked.sizes is None and not is_built(method)
        for method in listed
        if search and isinstance(method, Network) and method.settings is None
    }
    budget = asked.budget
    if budget is None and asked.rounds is None and searched:
        budget = BUDGET
    every = *listed, *(Simulation(name=name) for name in asked.also or ())
    complete = (with_defaults(method, decided, low, given, high) for method in every)
    planned = Plan(
        record,
        train,
        horizon,
        tuple(each if asked.device == "cpu" else each.to(asked.device) for each in complete),
        decided,
        low,
        sizes,
        searched,
        extended=usual and bool(searched),
        ahead=asked.ahead,
        reach=reach,
        others=tuple(others),
        tests=tuple(asked.tests),
        initial=asked.initial,
        simulator=fitted,
        budget=None if budget in (None, math.inf) else float(budget),
        rounds=asked.rounds,
        seed=asked.seed,
        seeds=asked.seeds,
        refit=asked.refit,
        high=high,
        without_networks=default and not has_torch(),
        elsewhere={
            name: _with_each(name, runs, (record, *asked.tests))
            for name, runs in (asked.also or {}).items()
        },
    )
    check(planned)
    _check_ahead(planned)
    if asked.horizon != 0 or asked.tests:
        check_trial(planned)
    if reach is not None:
        reach = int(min(reach, _least_room(planned)[1]))
        free = asked.horizon is not None or asked.ahead is not None
        planned = replace(planned, reach=reach, ahead=asked.ahead if free else reach)
    return replace(planned, tests=_with_distinct_names(asked.tests, record.name))


def _roles(
    simulator: Simulator | Adjustable | str | None, record: Record
) -> tuple[str | None, Adjustable | None, Simulator | None]:
    """Return what a simulator is: a base, one whose parameters are fitted, one run beside a record.

    One with parameters is a base, too.
    """
    if isinstance(simulator, str):
        if simulator in BASES:
            return simulator, None, None
        opened = open_simulator(simulator, record)
        return (GREY_BOX, opened, None) if is_fitted(opened) else (None, None, opened)
    given: Any = simulator
    if is_fitted(given):
        return GREY_BOX, given, None
    if given is not None and record.y_sim is not None:
        raise InputError(
            "simulator must be left out for a record that has a simulator's output (y_sim), or "
            "that output be taken out of the record: got both"
        )
    return None, None, given


def _with_simulator(simulator: Adjustable, part: Forecaster) -> Forecaster:
    """Return a part with this simulator, if it fits the parameters of one and has none."""
    lacks_it = isinstance(part, GreyBox) and part.simulator is None
    return part.clone().set_params(simulator=simulator) if lacks_it else part


def _beside(asked: PlanRequest, simulator: Simulator, longer: bool) -> PlanRequest:
    """Return the request with the output of a simulator in its records.

    Further records have it where they lack one and the inputs drive the simulator: a function of
    time alone says nothing of another record.
    """

    def driven(further: Record) -> Record:
        if further.y_sim is not None:
            return further
        running: Any = matched(simulator, further.columns, further.inputs)
        return simulated(further, running, longer=True) if running.driven else further

    record = simulated(asked.record, simulator, longer=longer)
    others, tests = [driven(each) for each in asked.others], [driven(each) for each in asked.tests]
    return replace(asked, record=record, others=others, tests=tests)


def _with_each(
    name: str, runs: Sequence[Simulator], records: Sequence[Record]
) -> tuple[Record, ...]:
    """Return records with a simulation made elsewhere in place of any other, where it has a run."""
    alone = [replace(record, y_sim=None) for record in records]
    try:
        having = [simulated(record, run) for record, run in zip(alone, runs, strict=False)]
    except InputError as error:
        raise InputError(f"also (--also), {name}: {error}") from None
    return *having, *alone[len(runs) :]


def _settings(
    asked: PlanRequest, training: Record, reach: int | None
) -> tuple[TrainingSettings, bool]:
    """Return the settings of trainings, and whether more of them are searched.

    Where some are given, others follow from these. Windows of an unstable plant are short enough
    for the growth of their errors.
    """
    if isinstance(asked.settings, TrainingSettings):
        return asked.settings, False
    usual = recipe_settings(asked.recipe, training, asked.others)
    changes = {**(asked.settings or {})}
    searched = asked.recipe == "default" and not {*changes} - {"warmup"}
    if asked.ahead is not None and "window" not in changes:
        warmup = whole("warmup", changes.setdefault("warmup", usual.warmup))
        changes["window"] = min([warmup + asked.ahead, *map(len, asked.others)])
    longest = min(
        [default_warmup(len(test)) for test in asked.tests if "warmup" not in changes], default=None
    )
    if "window" in changes:
        changes.setdefault("warmup", default_warmup(changes["window"], usual.warmup))
    if "milestones" in changes:
        changes.setdefault("one_cycle", False)
    try:
        found = within_reach(replace(usual, **changes), None if "window" in changes else reach)
    except TypeError:
        known = ", ".join(vars(usual))
        raise InputError(f"settings must be out of {known}, got {', '.join(changes)}") from None
    return found if longest is None else replace(found, warmup=min(found.warmup, longest)), searched


def _cut_to_horizon(asked: PlanRequest, train: int) -> tuple[Record, int]:
    """Return the record up to its last sample to predict, and the horizon."""
    record, horizon = asked.record, asked.horizon
    check_train(record, train)
    if horizon is None:
        return record, len(record) - train
    whole("horizon", horizon, 0)
    if train + horizon > len(record):
        raise InputError(
            f"horizon must end within the record: at most {len(record) - train} samples after the "
            f"{train} of train, got {horizon}; `splitband forecast` predicts beyond it"
        )
    if asked.refit and train + horizon < len(record):
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


def check(plan: Plan) -> None:
    """Check a plan, except for the trial on held-out samples.

    A method that cannot be fitted does not stop the others: its row gives the reason, which is
    raised only if no method can be fitted.
    """
    if len(plan.methods) == len(plan.also):
        raise InputError("methods must be one or several, got none")
    twice = next((name for name in plan.names if plan.names.count(name) > 1), None)
    if twice:
        raise InputError(
            f"methods must have names that differ, two are {twice}; a forecaster takes another "
            "one as `name`"
        )
    _check_records(plan)
    wrong: list[ValueError] = []
    for forecaster in (each for each in plan.methods if each.name not in plan.also):
        try:
            forecaster.check(plan.training, *plan.others)
        except ValueError as error:
            wrong.append(error)
    if len(wrong) == len(plan.methods) - len(plan.also):
        raise wrong[0]


def _check_records(plan: Plan) -> None:
    record, train, warmup = plan.record, plan.train, plan.settings.warmup
    for other in plan.others:
        check_alike(other, record, other.name or "another record")
    for test in plan.tests:
        _check_test(test, plan)
    if warmup >= train:
        raise InputError(f"warmup must be shorter than the {train} training samples, got {warmup}")
    for name, part in (("training", slice(train)), ("predicted", slice(train, None))):
        measured = record.y_with_gaps[part]
        if len(measured) and np.isnan(measured).all(axis=0).any():
            raise InputError(f"the {name} part must have a measured sample in every channel")


def _least_room(plan: Plan) -> tuple[str, float]:
    """Return the fewest samples in which methods are judged, and where they are."""
    room = {
        "held-out last quarter of the training part": plan.train - first_held_out(plan.train),
        "part after the training part": len(plan.record) - plan.train or math.inf,
    }
    for test in plan.tests:
        begin = first_after(test.y_with_gaps, _warmup_on_tests(plan))
        room[f"part of the test record {test.name} after a warm-up"] = len(test) - (begin or 0)
    return min(room.items(), key=lambda each: each[1])


def _check_ahead(plan: Plan) -> None:
    """Check that there is an origin with `ahead` samples after it wherever methods are judged."""
    place, room = _least_room(plan)
    if plan.ahead is not None and plan.ahead > room:
        raise InputError(
            f"ahead must be at most {room}, the samples of the {place}, got {plan.ahead}"
        )


def _warmup_on_tests(plan: Plan) -> int:
    """Return how many samples at the beginning of a test record all methods need at most."""
    if plan.initial is not None:
        return max(whole("initial", plan.initial), 2)
    return max(plan.settings.warmup, 2, *(f.warmup for f in plan.methods))


def _check_test(test: Record, plan: Plan) -> None:
    check_alike(test, plan.record, test.name or "a test record")
    name, samples = "warmup" if plan.initial is None else "initial", _warmup_on_tests(plan)
    begin = first_after(test.y_with_gaps, samples)
    if begin in (None, len(test)):
        between = "" if test.measured is None else "between its gaps and "
        raise InputError(
            f"{name} must fit into the test record {test.name} of {len(test)} samples, {between}"
            f"with samples to predict after it, got {samples}"
        )
    if np.isnan(test.y_with_gaps[begin:]).all(axis=0).any():
        raise InputError(
            f"every channel of the test record {test.name} must be measured somewhere after "
            f"its first {begin} samples, on which methods warm up"
        )


def check_trial(plan: Plan) -> None:
    """Check the trial on the last quarter of the training part."""
    part = replace(plan.training, y_true=None)
    train = first_held_out(plan.train)
    shorter = tuple(f.for_trial(plan.train) for f in plan.methods)
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
