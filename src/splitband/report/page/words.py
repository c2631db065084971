"""What the page says in sentences."""

from __future__ import annotations

import numpy as np

from splitband.data import Trajectory
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.selection import WORTH_TRAINING, Trial
from splitband.forecasters.backtest import HELD_OUT
from splitband.forecasters.names import CALIBRATED, CONDITIONED, base
from splitband.metrics import Extrapolation, leaving
from splitband.report.page.parts import number, percent
from splitband.report.results import deviation

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
    """Why a method is recommended."""
    best = trial.recommended
    others = sorted((e, name) for name, e in trial.errors.items() if name != best)
    said = (
        f"It was chosen by the {train:,} training samples alone. Every method was fitted to the "
        f"first {percent(1 - HELD_OUT)} of them and asked for the rest: {best} was off by "
        f"{number(trial.errors[best])} (RMSE)"
    )
    if others:
        error, second = others[0]
        own = trial.errors[best]
        compared = f"{error / own:.2f} times that" if own and error >= own else number(error)
        said += f", {'the next one' if error >= own else 'the lowest'}, {second}, by {compared}"
    words = [said + "."]
    if ahead:
        words.append(
            f"Fitted again to all of them, its forecast of what follows changed by "
            f"{number(trial.change(best))}; a change that the error does not explain counts in the "
            "error's place."
        )
    if trial.trained and set(trial.errors) - trial.trained:
        words.append(
            f"A network is only recommended where it is {percent(WORTH_TRAINING)} better than what "
            "needs no training."
        )
    return words


def afterwards(comparison: Comparison) -> list[str]:
    """What the recommended method then did on samples that nothing had been fitted to."""
    best, record, train = comparison.recommended, comparison.record, comparison.setup.train
    mean = comparison.means[best]
    words = []
    if mean.forecast is not None:
        ahead = len(record) - train
        interval = comparison.require_trial().intervals[best]
        words.append(
            f"On the {ahead:,} samples after them its forecast had RMSE "
            f"{number(mean.forecast_rmse)}{_relative(mean.forecast_rmse, record)}, and its "
            f"interval, which should hold {percent(interval.share)} of the samples, held "
            f"{percent(comparison.covers(best))}."
        )
    for test, error in zip(comparison.tests, mean.errors.tests, strict=False):
        words.append(
            f"The test record {test.name or ''} it simulated with RMSE {number(error)}"
            f"{_relative(error, test)}."
        )
    return words + _hindsight(comparison)


def _relative(error: float, record: Trajectory) -> str:
    usual = deviation(record)
    return f", {percent(error / usual)} of the record's standard deviation" if usual else ""


def _hindsight(comparison: Comparison) -> list[str]:
    """Which method was better after all, which nobody knew before."""
    best, means = comparison.recommended, comparison.means
    errors = {n: m.forecast_rmse for n, m in means.items() if m.forecast is not None}
    if comparison.tests:
        errors = {n: float(np.mean(m.errors.tests)) for n, m in means.items() if m.tests}
    if best not in errors:
        return []
    lowest = min(errors, key=lambda name: errors[name])
    if errors[lowest] >= errors[best]:
        return ["No other method did better there."]
    return [
        f"{lowest} did better there (RMSE {number(errors[lowest])}), which could not be known "
        "before."
    ]


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
    covers = comparison.covers(best)
    share = comparison.require_trial().intervals[best].share
    if covers < share - POOR:
        said.append(
            f"The interval of {best} held {percent(covers)} of the samples after the training part "
            f"in place of {percent(share)}: the record changes, or is longer than what it was "
            "learned from tells."
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


def of_inputs(beyond: list[Extrapolation], record: Trajectory) -> list[str]:
    """Which inputs go beyond those that were trained on."""
    return [
        each.describe(record.inputs[each.channel] if each.channel < record.nu else "")
        for each in beyond
    ]


def of_gaps(record: Trajectory) -> list[str]:
    """What was not measured."""
    missing = int((~record.complete).sum())
    if not missing:
        return []
    return [
        f"{missing:,} of {len(record):,} samples were not measured in whole: lines break there, "
        "and they count in no error."
    ]
