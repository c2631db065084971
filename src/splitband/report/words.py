"""Describe the results of a comparison in sentences, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.recommendation import WORTH_TRAINING, Trial
from splitband.forecasters.backtest import HELD_OUT_SHARE, first_held_out
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import NAMES
from splitband.metrics import Extrapolation
from splitband.report.numbers import number, percent
from splitband.report.table import Column, columns, leaving_range

POOR = 0.15
"""Largest shortfall of an interval's coverage that causes no warning. By eye."""
FEW = 20
"""Least number of held-out samples that causes no warning. By eye."""


def in_words(name: str, methods: Mapping[str, Forecaster] = NAMES) -> str:
    """Return the description of a method; empty for a method of the user that has none."""
    method = methods.get(name, NAMES.get(name))
    return "" if method is None else method.in_words()


def named(name: str, kind: str) -> str:
    """Return a method's kind in words, with its name."""
    return f"{kind} ({name})" if kind else name


def lead(record: Record) -> str:
    """Return a line that describes the record."""
    every = f"{record.sampling_time:.6g} s"
    said = f"{len(record):,} samples every {every}, measured: {', '.join(record.columns)}"
    return said + (f"; known inputs: {', '.join(record.inputs)}" if record.nu else "")


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def achieved(comparison: Comparison) -> list[str]:
    """Return the fit and the error of the recommended method, a line for each output and record.

    That is on the test records, or else on the samples after the training part.
    """
    return [f"{name}: {', '.join(said)}" for name, said in headline(comparison)]


def headline(comparison: Comparison) -> list[tuple[str, list[str]]]:
    """Return the same as pairs: the predicted output and record, and the numbers."""
    best = comparison.recommended
    listed = [column for column in columns(comparison) if best in column.values]
    side = "test" if any(c.heading == "test fit %" for c in listed) else "forecast"
    fits = [column for column in listed if column.heading == f"{side} fit %"]
    errors = [column for column in listed if column.heading == f"{side} RMSE"]
    held = {c.channel: c for c in listed if c.heading == "in interval"}
    ahead = len(comparison.record) - comparison.plan.train
    found = []
    for fit, error in zip(fits, errors, strict=True):
        of = f"test record {fit.record}" if fit.record else f"forecast of {ahead:,} samples"
        unit = f" {error.measure}" if error.measure else ""
        said = [f"fit {fit.entry(best)} %", f"RMSE {error.entry(best)}{unit}"]
        if fit.channel in held and side == "forecast":
            share = percent(comparison.require_trial().intervals[best].share)
            said.append(f"{held[fit.channel].entry(best)} of them in the {share} interval")
        found.append((f"{fit.channel}, {of}" if fit.channel else of, said))
    return found


def why(trial: Trial, train: int) -> list[str]:
    """Return sentences that say why a method is recommended, and by which criterion."""
    best = trial.recommended
    settled = [name for name in trial.errors if name in trial.final]
    if len(trial.errors) == 1:
        return [
            f"No other method was tried. Its held-out error is that of forecasts of the last "
            f"{percent(HELD_OUT_SHARE)} of the {train:,} training samples, fitted to the rest of "
            "them."
        ]
    able = [name for name in settled if name not in trial.left_out] or settled
    others = sorted((trial.worth(name), name) for name in able if name != best)
    words = [f"Lowest score, {number(trial.worth(best))}"]
    if others and len(able) < len(settled):
        words[0] += ", of the methods that could simulate the test records"
    if others:
        words[0] += f"; next: {others[0][1]}, {number(others[0][0])}"
    words[0] += "."
    words.append(
        f"The score uses the {train:,} training samples alone: every method was trained on the "
        f"first {percent(1 - HELD_OUT_SHARE)} of them and predicted the rest."
    )
    if trial.trained and set(trial.errors) - trial.trained:
        words.append(f"Networks carry a penalty of {percent(WORTH_TRAINING)}.")
    return words


def afterwards(comparison: Comparison) -> list[str]:
    """Return which methods had a better fit than the recommended one on unseen samples."""
    best, listed = comparison.recommended, columns(comparison)
    tests = [column for column in listed if column.heading == "test fit %"]
    ahead = [column for column in listed if column.heading == "forecast fit %"]
    fits = tests or ahead
    if not fits or best not in fits[0].values:
        return []
    better = [c for c in fits if c.best and c.values[c.best] > c.values[best]]
    if not better:
        return ["No other method had a better fit."]
    said = ", ".join(
        f"{c.best} {c.entry(c.best)} %" + (f" ({of})" if (of := c.record or c.channel) else "")
        for c in better
    )
    return [f"In hindsight, a better fit: {said}."]


def _listed(found: Sequence[Column], method: str) -> str:
    """Return a method's entries, each with its channel."""
    return " and ".join(
        column.entry(method) + (f" ({column.channel})" if column.channel else "")
        for column in found
    )


def doubts(comparison: Comparison) -> list[str]:
    """Return the methods' own warnings about their forecasts, each once."""
    said: dict[str, list[str]] = {}
    for name, run in comparison.medians.items():
        for doubt in () if run.forecast is None else run.forecast.doubts:
            said.setdefault(doubt, []).append(name)
    return [f"{', '.join(names)}: {doubt}" for doubt, names in said.items()]


def warnings(comparison: Comparison) -> list[str]:
    """Return what readers should know before they rely on the numbers."""
    best, record = comparison.recommended, comparison.record
    left = leaving_range(comparison, best)
    said = [f"{best}: {left}"] if left else []
    train = comparison.plan.train
    if (held_out := train - first_held_out(train)) < FEW:
        said.append(
            f"The method was chosen by {held_out} held-out samples, which are too few to tell "
            "methods apart: a longer record may lead to another choice."
        )
    said += [*of_inputs(comparison.inputs_beyond_training, record), *doubts(comparison)]
    share = comparison.require_trial().intervals[best].share
    held = [c for c in columns(comparison) if c.heading == "in interval"]
    missed = [c for c in held if c.values[best] < share - POOR]
    if missed:
        said.append(
            f"The {percent(share)} interval of {best} held only {_listed(missed, best)} of the "
            "samples after the training part. Either the system has changed, or the training part "
            "does not show how errors grow."
        )
    for test, prediction in zip(comparison.tests, comparison.medians[best].tests, strict=False):
        said += [f"{test.name}: {message}" for message in prediction.warnings]
    said += [
        f"{name}: {note}"
        for name, runs in comparison.fits.items()
        for note in dict.fromkeys(note for run in runs for note in run.report.notes)
    ]
    if comparison.left_out:
        said.append(
            f"Not tested: {', '.join(comparison.left_out)}; they go on from the training record, "
            "or need a simulator of the test record (--test-simulator)."
        )
    return said


def of_inputs(beyond: Sequence[Extrapolation], record: Record) -> list[str]:
    """Return a sentence for each input that leaves its training range."""
    return [
        each.describe(record.inputs[each.channel] if each.channel < record.nu else "")
        for each in beyond
    ]


def of_gaps(record: Record) -> list[str]:
    """Return a sentence about missing samples, if there are any."""
    missing = int((~record.complete).sum())
    if not missing:
        return []
    return [
        f"{missing:,} of {len(record):,} samples have missing values: curves break there, and "
        "errors leave them out."
    ]
