"""What the page says in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.selection import WORTH_TRAINING, Trial
from splitband.forecasters.backtest import HELD_OUT
from splitband.forecasters.names import CALIBRATED, CONDITIONED, base
from splitband.metrics import Extrapolation, leaving
from splitband.report.page.parts import entry, number, percent
from splitband.report.table import Column, columns

_KINDS = {
    "gru": "a recurrent network (GRU) that learns the whole signal",
    "rnn": "a recurrent network (Euler MLP) that learns the whole signal",
    "split-gru": "two recurrent networks, one for the slow and one for the fast part of the "
    "signal, parted by a pair of complementary filters",
    "split-gru-hp": "two recurrent networks, one for each part of the signal, the output of the "
    "fast one high-passed, too",
    "filtered": "{base} for the slow part of the signal and a network for the fast one, put "
    "together by a pair of complementary filters",
    "residual": "{base}, and a network that learns what it leaves",
    "simulator": "the simulator of the record, as it comes",
    "simulator-affine": "the simulator with gain and offset fitted to the training samples",
    "mean": "the mean of the training samples",
    "persistence": "the last measured value, held",
    "seasonal-naive": "the last period, repeated",
    "harmonic": "a sum of sinusoids and a trend, fitted to the training samples",
    "periodic": "one waveform that repeats, fitted to the training samples",
    "linear": "a linear model of the known inputs",
}
_BASES = {"linear": "a linear model", "periodic": "a periodic waveform", "harmonic": "sinusoids"}
POOR = 0.15
"""By how much an interval may miss the share that it should hold before the page warns of it."""


def in_words(name: str) -> str:
    """What a method is; empty for one of the user's own."""
    plain = base(name)
    kind, _, rest = plain.partition("-")
    told = "; the network is told what the slower part says" if name.endswith(CONDITIONED) else ""
    if kind in ("filtered", "residual"):
        slow = next((said for b, said in _BASES.items() if rest.startswith(b)), "the simulator")
        slow = "the calibrated simulator" if CALIBRATED in name else slow
        return _KINDS[kind].format(base=slow) + told
    if plain == "simulator" and CALIBRATED in name:
        return "the simulator, calibrated on the training samples"
    return _KINDS[plain] + told if plain in _KINDS else ""


def why(trial: Trial, train: int, ahead: int) -> list[str]:
    """Return why a method is recommended, in sentences; what was chosen by, if anything was."""
    best = trial.recommended
    settled = [name for name in trial.errors if name in trial.final]
    if len(trial.errors) == 1:
        return [
            f"No other method was tried. Its held-out error is that of forecasts of the last "
            f"{percent(HELD_OUT)} of the {train:,} training samples, fitted to the rest of them."
        ]
    able = [name for name in settled if name not in trial.left_out] or settled
    others = sorted((trial.worth(name), name) for name in able if name != best)
    words = [f"It has the lowest score, {number(trial.worth(best))}"]
    if others and len(able) < len(settled):
        words[0] += ", of the methods that the test records could be simulated with"
    if others:
        words[0] += f"; the next one, {others[0][1]}, has {number(others[0][0])}"
    words[0] += "."
    words.append(
        f"Scores rest on the {train:,} training samples alone: every method was fitted to the "
        f"first {percent(1 - HELD_OUT)} of them and forecast the rest (held out)."
    )
    if ahead:
        words.append(
            "Then it was fitted to all of them. A change of its forecast of what follows that the "
            "held-out error does not explain is the score in that error's place."
        )
    if trial.trained and set(trial.errors) - trial.trained:
        words.append(f"{percent(WORTH_TRAINING)} are added to the score of a network.")
    return words


def afterwards(comparison: Comparison) -> list[str]:
    """Return what the recommended method did on samples that nothing had been fitted to."""
    best, record = comparison.recommended, comparison.record
    listed, words = columns(comparison), []
    ahead = len(record) - comparison.setup.train
    forecast = [column for column in listed if column.heading == "forecast"]
    if forecast:
        share = comparison.require_trial().intervals[best].share
        held = [column for column in listed if column.heading == "in interval"]
        words.append(
            f"On the {ahead:,} samples after them its forecast had RMSE "
            f"{_each(forecast, best, record)}; its interval, which should hold {percent(share)} of "
            f"the samples, held {_listed(held, best)}."
        )
    tested = [[c for c in listed if c.record == test.name] for test in comparison.tests]
    for test, of_test in zip(comparison.tests, tested, strict=True):
        if best in of_test[0].values:
            words.append(
                f"It simulated the test record {test.name} with RMSE {_each(of_test, best, test)}."
            )
    return words + _hindsight(best, [c for of_test in tested for c in of_test] or forecast)


def _each(errors: Sequence[Column], method: str, record: Record) -> str:
    """Return a method's errors, each with its share of the channel's standard deviation."""
    said = []
    for i, column in enumerate(errors):
        y = record.seen[:, i]
        of = f" ({column.channel})" if column.channel else ""
        value = column.values[method]
        if np.nanmax(y) > np.nanmin(y):
            of += f", {percent(value / float(np.nanstd(y)))} of the standard deviation"
        said.append(f"{number(value)}{of}")
    return " and ".join(said)


def _listed(found: Sequence[Column], method: str) -> str:
    """Return a method's entries with the channels they are of."""
    return " and ".join(
        entry(column, method) + (f" ({column.channel})" if column.channel else "")
        for column in found
    )


def _hindsight(best: str, errors: Sequence[Column]) -> list[str]:
    """Return which methods had a lower error after all; `errors` are of samples not fitted to."""
    if not errors or best not in errors[0].values:
        return []
    lower = [c for c in errors if c.values[c.best] < c.values[best]]
    if not lower:
        return ["No other method had a lower error there."]
    said = ", ".join(f"{c.best} {number(c.values[c.best])} ({c.title})" for c in lower)
    return [f"Lower errors there, which could not be known before: {said}."]


def doubts(comparison: Comparison) -> list[str]:
    """What methods themselves have to say against their forecasts, each thing once."""
    said: dict[str, list[str]] = {}
    for name, mean in comparison.means.items():
        for doubt in () if mean.forecast is None else mean.forecast.doubts:
            said.setdefault(doubt, []).append(name)
    return [f"{', '.join(names)}: {doubt}" for doubt, names in said.items()]


def warnings(comparison: Comparison) -> list[str]:
    """What readers should know before they rely on the numbers."""
    best, record = comparison.recommended, comparison.record
    said = [
        f"{best}: {leaving(min(left))}"
        for left in [[r.leaves for r in comparison.runs[best] if r.leaves is not None]]
        if left
    ]
    said += [*of_inputs(comparison.inputs_beyond_training, record), *doubts(comparison)]
    share = comparison.require_trial().intervals[best].share
    held = [c for c in columns(comparison) if c.heading == "in interval"]
    missed = [c for c in held if c.values[best] < share - POOR]
    if missed:
        said.append(
            f"The interval of {best} held {_listed(missed, best)} of the samples after the "
            f"training part in place of {percent(share)}: the record changes, or is longer than "
            "the training part shows."
        )
    for test, prediction in zip(comparison.tests, comparison.means[best].tests, strict=False):
        said += [f"{test.name}: {message}" for message in prediction.warnings]
    said += [
        f"{name}: {note}"
        for name, runs in comparison.runs.items()
        for note in dict.fromkeys(note for run in runs for note in run.fit.notes)
    ]
    if comparison.left_out:
        said.append(
            f"Not tested: {', '.join(comparison.left_out)}; they go on from the training record, "
            "or need a simulator of the test record."
        )
    said += of_gaps(record)
    failed = comparison.require_trial().failed
    return said + [f"{name} could not be fitted: {reason}" for name, reason in failed.items()]


def of_inputs(beyond: list[Extrapolation], record: Record) -> list[str]:
    """Which inputs go beyond those that were trained on."""
    return [
        each.describe(record.inputs[each.channel] if each.channel < record.nu else "")
        for each in beyond
    ]


def of_gaps(record: Record) -> list[str]:
    """What was not measured."""
    missing = int((~record.complete).sum())
    if not missing:
        return []
    return [
        f"{missing:,} of {len(record):,} samples were not measured in whole: lines break there, "
        "and they count in no error."
    ]
