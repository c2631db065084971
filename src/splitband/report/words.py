"""Describe the results of a comparison in sentences, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Sequence

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.recommendation import WORTH_TRAINING, Trial
from splitband.filters.spectrum import periodogram
from splitband.forecasters.backtest import HELD_OUT_SHARE, first_held_out
from splitband.forecasters.bands import Bands
from splitband.forecasters.residuals import Outcome
from splitband.metrics import Extrapolation, leaving
from splitband.report.numbers import number, percent
from splitband.report.table import columns, leaving_range

POOR = 0.15
"""Largest shortfall of an interval's coverage that causes no warning. By eye."""
MIN_HELD_OUT = 20
"""Least number of held-out samples that causes no warning. By eye."""


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


def headline(comparison: Comparison) -> list[tuple[str, list[str]]]:
    """Return each predicted output and record, with fit and error of the recommended method.

    These are the test records, or else the samples after the training part.
    """
    best = comparison.recommended
    side = "test" if comparison.medians[best].tests else "forecast"
    fits, errors = (columns(comparison, f"{side} {what}") for what in ("fit %", "RMSE"))
    held = {c.channel: c for c in columns(comparison, "in interval")}
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
    if len(trial.errors) == 1:
        return [
            f"No other method was tried. Its held-out error is that of forecasts of the last "
            f"{percent(HELD_OUT_SHARE)} of the {train:,} training samples, fitted to the rest of "
            "them."
        ]
    ranked = trial.ranked(trial.final)
    able = [name for name in ranked if name not in trial.left_out] or ranked
    words = [f"Lowest score, {number(trial.penalized_score(best))}"]
    if 1 < len(able) < len(ranked):
        words[0] += ", of the methods that could simulate the test records"
    if len(able) > 1:
        words[0] += f"; next: {able[1]}, {number(trial.penalized_score(able[1]))}"
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
    best = comparison.recommended
    fits = columns(comparison, "test fit %") or columns(comparison, "forecast fit %")
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


def verdicts(comparison: Comparison) -> dict[str, Outcome]:
    """Return what the residual tests say of the recommended method, each with its outcome."""
    where = "the samples after the training part"
    if comparison.medians[comparison.recommended].tests:
        where = f"test record {comparison.tests[0].name or 1}"
    tests = comparison.residual_tests()
    return {f"{test.verdict()} (Tested on {where}.)": test.outcome for test in tests}


def warnings(comparison: Comparison) -> list[str]:
    """Return what readers should know before they rely on the numbers."""
    best, record = comparison.recommended, comparison.record
    left = leaving_range(comparison, best)
    said = [f"{best}: {left}"] if left else []
    train = comparison.plan.train
    if (held_out := train - first_held_out(train)) < MIN_HELD_OUT:
        said.append(
            f"The method was chosen by {held_out} held-out samples, which are too few to tell "
            "methods apart: a longer record may lead to another choice."
        )
    said += of_inputs(comparison.inputs_beyond_training, record)
    doubts: dict[str, list[str]] = {}
    for name, p in comparison.predictions.items():
        for doubt in p.doubts:
            doubts.setdefault(doubt, []).append(name)
    said += [f"{', '.join(names)}: {doubt}" for doubt, names in doubts.items()]
    share = comparison.require_trial().intervals[best].share
    missed = [
        c.entry(best) + (f" ({c.channel})" if c.channel else "")
        for c in columns(comparison, "in interval")
        if c.values[best] < share - POOR
    ]
    if missed:
        said.append(
            f"The {percent(share)} interval of {best} held only {' and '.join(missed)} of the "
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


def of_forecast(result: Forecast) -> list[str]:
    """Return what readers should know before they rely on a forecast."""
    said = [f"{result.method}: {leaving(result.leaves)}"] if result.leaves is not None else []
    said += of_inputs(result.inputs_beyond_training, result.record)
    return [*said, *result.prediction.warnings]


def of_bands(bands: Bands, training: Record) -> str:
    """Return how models of two bands split a signal, and why; empty where none was asked for."""
    if bands.cutoff is None:
        return ""
    below = periodogram(training.y, training.sampling_rate).share_below(bands.cutoff)
    choice = bands.choice
    reason = choice.reason if choice else f"{percent(below)} of the power lies below that"
    return (
        f"Models of two bands split the signal at {number(bands.cutoff)} Hz, with filters of "
        f"order {bands.order}; the low band keeps one of {bands.downsampling} samples. "
        f"{sentence(reason)}"
    )


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
