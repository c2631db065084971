"""Check what a comparison is asked for, before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from splitband.data import Record, check_alike
from splitband.data.signals import first_after
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster, all_parts
from splitband.forecasters.held_out import first_held_out
from splitband.forecasters.network import Network
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.training.settings import default_warmup

if TYPE_CHECKING:
    from splitband.comparison.plan import Plan

LARGEST_SEED = 2**32 - 1
"""Seeds of single trainings, which are multiples of it, must fit into 64 bits."""


def check_limits(
    budget: float | None, rounds: int | None, seed: int, seeds: int | None, searched: bool = True
) -> None:
    """Check limits of time and work, of which rounds are for what is `searched`, and seeds."""
    if budget is not None and not budget > 0:
        raise InputError(f"budget must be a positive number of seconds, got {budget}")
    if budget is not None and rounds is not None:
        raise InputError(
            f"budget and rounds exclude each other (the one limits the time, the other the work), "
            f"got {budget} and {rounds}"
        )
    if rounds is not None:
        whole("rounds", rounds)
        if not searched:
            raise InputError(f"rounds must be left out where no training is searched, got {rounds}")
    whole("seed", seed, 0, LARGEST_SEED)
    if seeds is not None:
        whole("seeds", seeds)


def check_needs(methods: Sequence[Forecaster], record: Record, others: Sequence[Record]) -> None:
    """Raise ValueError if a record lacks a signal that a method needs."""
    for need, given in (("simulator", record.y_sim), ("inputs", record.u)):
        lacking = next((m for m in methods if need in m.needs and given is None), None)
        if lacking is not None:
            raise InputError(
                f"{need} must be given for {lacking.name}, {record.name or 'the record'} has none"
            )
    hybrid = next((m for m in methods if m.random and "simulator" in m.needs), None)
    without = next((other for other in others if other.y_sim is None), None)
    if hybrid is not None and without is not None:
        raise InputError(
            f"further records (others, --more) must each have a simulator's output "
            f"(--more-simulator) for {hybrid.name}, {without.name or 'one'} has none"
        )


def check_bands(bands: Bands, methods: Sequence[Forecaster]) -> None:
    """Raise ValueError if parameters of two bands are given, and none of the methods has any."""
    parts = [part for method in methods for part in all_parts(method)]
    if any(isinstance(part, Network) and part.bands is not None for part in parts):
        return
    for name in ("cutoff", "order", "downsampling"):
        if (value := getattr(bands, name)) is not None:
            raise InputError(
                f"{name} must be left out where no default method has two bands, got {value}: "
                "methods (--methods) takes those that have, such as split-gru"
            )


def check_train(record: Record, train: int) -> None:
    """Check that there is something to train on."""
    if not 2 <= whole("train", train, None) <= len(record):
        raise InputError(
            f"train must be between 2 and {len(record)}, the samples of the record, got {train}"
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


def repeats_training(test: Record, plan: Plan) -> bool:
    """Return whether a test record and a training record share samples in a row, by their values.

    Two parts of one measurement overlap where one of them begins within the other.
    """
    a = _samples(test)
    each = [_samples(record) for record in (plan.training, *plan.others)]
    return any(_begins_in(a, b) or _begins_in(b, a) for b in each)


def _samples(record: Record) -> Array:
    """Return outputs and inputs, from the sample on at which they first change."""
    rows = record.y if record.u is None else np.column_stack([record.y, record.u])
    changes = np.flatnonzero(np.diff(rows, axis=0).any(axis=1))
    return rows[changes[0] :] if len(changes) else rows[:0]


def _begins_in(samples: Array, others: Array) -> bool:
    """Return whether the first samples, a warm-up of them, are in a row among others."""
    begin = samples[: default_warmup(len(samples))]
    at = np.flatnonzero((others == begin[0]).all(axis=1)) if len(samples) else ()
    return any(np.array_equal(others[row : row + len(begin)], begin) for row in at)


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
    if np.isnan(test.y_with_gaps[begin:]).all(axis=0).any():
        raise InputError(
            f"every channel of the test record {test.name} must be measured somewhere after "
            f"its first {begin} samples, on which methods warm up"
        )


def check_trial(plan: Plan) -> None:
    """Check the trial on the last quarter of the training part."""
    part = replace(plan.training, y_true=None)
    train = first_held_out(plan.train)
    shorter = tuple(f._for_trial(plan.train) for f in plan.methods)
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
