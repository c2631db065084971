"""Check what a comparison is asked for, before anything runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from splitband.forecasters.base import Forecaster, all_parts
from splitband.forecasters.network import Network
from splitband.records import Record
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.optional import require_torch
from splitband.training.settings import default_warmup


def check_needs(methods: Sequence[Forecaster], record: Record, others: Sequence[Record]) -> None:
    """Raise ValueError if a method needs torch, or a signal, that is not there."""
    for method in methods:
        if any(isinstance(part, Network) for part in all_parts(method)):
            require_torch(method.name)
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


def check_train(record: Record, train: int) -> None:
    """Check that there is something to train on."""
    if not 2 <= whole("train", train, None) <= len(record):
        raise InputError(
            f"train must be between 2 and {len(record)}, the samples of the record, got {train}"
        )


def repeats_training(test: Record, training: Iterable[Record]) -> bool:
    """Return whether a test record and a training record share samples in a row, by their values.

    Two parts of one measurement overlap where one of them begins within the other.
    """
    a = _samples(test)
    return any(_begins_in(a, b) or _begins_in(b, a) for b in map(_samples, training))


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
