"""Plan and check a whole comparison before anything is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splitband.data import Record, check_alike, require_records
from splitband.data.gaps import first_after
from splitband.evaluation.setup import Options, Setup
from splitband.forecasters.backtest import first_held_out, for_trial
from splitband.forecasters.base import Forecaster
from splitband.runtime.arguments import whole
from splitband.simulators.identification import check_runs

TRAINING_SHARE = 0.75
"""Default share of a record to train on."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Hold all decisions of a comparison; `run` computes it.

    Attributes
    ----------
    record : The measured record, up to its last sample to predict.
    methods : Forecasters, complete but for what a search may change.
    setup : Options that they share.
    horizon : Samples to forecast beyond the training part.
    others : Further records to train on.
    tests : Records that nothing is fitted to, with distinct names.
    seeds : Number of trainings of each network; None: the search decides.
    refit : Whether the recommended method is refitted to the whole record.
    """

    record: Record
    methods: tuple[Forecaster, ...]
    setup: Setup
    horizon: int
    others: tuple[Record, ...] = ()
    tests: tuple[Record, ...] = ()
    seeds: int | None = None
    refit: bool = False

    @classmethod
    def of(
        cls,
        record: Record,
        methods: Sequence[Forecaster],
        setup: Setup,
        others: Sequence[Record] = (),
        tests: Sequence[Record] = (),
    ) -> Plan:
        """Return an unchecked plan with the given parts and a forecast to the record's end."""
        horizon = len(record) - setup.train
        return cls(record, tuple(methods), setup, horizon, tuple(others), tuple(tests))

    @property
    def train(self) -> int:
        """Return the length of the training part, in samples."""
        return self.setup.train

    @property
    def training(self) -> Record:
        """Return the training part of the record."""
        return self.record[: self.train]

    @property
    def names(self) -> list[str]:
        """Return the names of the methods."""
        return [method.name for method in self.methods]


def plan(
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    horizon: int | None = None,
    others: Sequence[Record] = (),
    tests: Sequence[Record] = (),
    seeds: int | None = None,
    setup: Setup | Options | None = None,
    refit: bool = False,
) -> Plan:
    """Plan a comparison, and check records, methods and settings.

    Parameters
    ----------
    record : The measured record, with its inputs and simulator's output, if any.
    train : Samples to train on, by default those of `setup`, or three quarters; with `tests` all.
    methods : Forecasters, or names (`splitband methods`); `setup` supplies what they leave open. By
        default the methods worth comparing on such a record. The settings of the first network are
        searched most thoroughly.
    horizon : Samples to predict after the training part, by default to the end of the record. If
        the whole record is trained on, they lie beyond it, as far as its inputs and its simulator's
        output are known (`u_beyond`, `beyond`); 0 is for fitting alone.
    others : Further records of the same system, to train on.
    tests : Records of the same system that nothing is fitted to; each is simulated to its end after
        a warm-up on its first samples.
    seeds : Number of trainings of each network; by default as many as the budget of the search
        allows, and `SEEDS` without a search.
    setup : Settings, bands and sizes: all of them (`Setup`) or some (`Options`). The rest is chosen
        from the training samples; training settings by trials on the last quarter of them, within
        two minutes.
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
    methods = [methods] if isinstance(methods, str) else methods
    if train is None:
        train = getattr(setup, "train", None)
    if train is None:
        train = len(record) if tests else int(TRAINING_SHARE * len(record))
    record, horizon = _cut_to_horizon(record, train, horizon, bool(tests))
    decided = (setup or Options()).decided(record, train, methods, tests, others)
    if seeds is not None:
        whole("seeds", seeds)
    if methods is None:
        methods = decided.usual(record)
        if decided.search is not None and decided.simulator is None:
            decided = replace(decided, search=replace(decided.search, bases=True))
    if decided.simulator is not None:
        check_runs(decided.simulator, record)
    made = [decided.forecaster(each) if isinstance(each, str) else each for each in methods]
    made = [method.with_defaults(decided.settings, decided.bands) for method in made]
    found = Plan(record, tuple(made), decided, horizon, tuple(others), tuple(tests), seeds, refit)
    check(found)
    if horizon or tests:
        _check_trial(found)
    return replace(found, tests=_with_distinct_names(tests))


def check_train(record: Record, train: int, horizon: int = 1) -> None:
    """Check that there is something to train on and `horizon` samples to predict."""
    if not 2 <= whole("train", train, None) <= len(record) - horizon:
        raise ValueError(
            f"train must be between 2 and {len(record) - horizon} for a record of {len(record)} "
            f"samples, got {train}"
        )


def check(plan: Plan) -> None:
    """Check a plan, except for the trial on held-out samples.

    A method that cannot be fitted does not stop the others: its row gives the reason, which is
    raised only if no method can be fitted.
    """
    if not plan.methods:
        raise ValueError("methods must be one or several, got none")
    twice = next((name for name in plan.names if plan.names.count(name) > 1), None)
    if twice:
        raise ValueError(
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
                raise ValueError(
                    f"{what} must reach {horizon} samples beyond the record, got {reach}"
                )
        return record, horizon
    if train + horizon > len(record):
        raise ValueError(
            f"horizon must end within the record: at most {len(record) - train} samples after the "
            f"{train} of train, got {horizon}"
        )
    return record[: train + horizon], horizon


def _check_records(plan: Plan) -> None:
    record, train, warmup = plan.record, plan.train, plan.setup.settings.warmup
    for other in plan.others:
        check_alike(other, record, other.name or "another record")
    for test in plan.tests:
        _check_test(test, plan)
    if warmup >= train:
        raise ValueError(f"warmup must be shorter than the {train} training samples, got {warmup}")
    for name, part in (("training", slice(train)), ("predicted", slice(train, None))):
        predicted = record.truth[part]
        if len(predicted) and np.isnan(predicted).all(axis=0).any():
            raise ValueError(f"the {name} part must have a measured sample in every channel")


def _check_test(test: Record, plan: Plan) -> None:
    check_alike(test, plan.record, test.name or "a test record")
    name, samples = "initial", plan.setup.initial
    if samples is None:
        name = "warmup"
        samples = max(plan.setup.settings.warmup, *(f.warmup for f in plan.methods))
    begin = first_after(test.complete, max(whole(name, samples), 2))
    if begin in (None, len(test)):
        raise ValueError(
            f"{name} must fit into the test record {test.name} of {len(test)} samples, with "
            f"samples to predict after it, got {samples}"
        )
    if np.isnan(test.truth[begin:]).all(axis=0).any():
        raise ValueError(
            f"every channel of the test record {test.name} must be measured somewhere after "
            f"its first {begin} samples, on which methods warm up"
        )


def _check_trial(plan: Plan) -> None:
    """Check the trial on the last quarter of the training part."""
    part = replace(plan.training, y_true=None)
    setup = replace(plan.setup, train=first_held_out(plan.train))
    shorter = tuple(for_trial(f, plan.train) for f in plan.methods)
    try:
        check(Plan(part, shorter, setup, len(part) - setup.train, plan.others))
    except ValueError as error:
        raise ValueError(
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
