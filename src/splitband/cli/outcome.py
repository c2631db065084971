"""What the commands that compare say of a comparison."""

from __future__ import annotations

from pathlib import Path

from splitband.cli import showing, timing
from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.setup import Setup
from splitband.filters.spectrum import periodogram
from splitband.forecasters.names import HYBRIDS
from splitband.report.page import words
from splitband.report.page.usage import Usage
from splitband.report.results import MODEL
from splitband.report.table import columns, remarks


def show(result: Comparison, out: Path, used: Usage) -> None:
    """Print the table, what is recommended and why, what to be warned of, and how it is used."""
    record, setup, trial = result.record, result.setup, result.require_trial()
    best = result.recommended
    said = {
        name: "; ".join([kind, note] if name in trial.trained and note else [note or kind])
        for name, note in remarks(result).items()
        for kind in [words.in_words(name, result.forecasters)]
    }
    showing.methods(_title(record, setup), columns(result), said, best)
    showing.console.print(timing.in_words(result.time))
    why = words.why(trial, setup.train)
    kind = words.in_words(best, result.forecasters)
    recommended = f"{kind} ({best})" if kind else best
    showing.console.print(f"\nrecommended: {recommended}. {' '.join(why)}")
    if result.left_out:
        showing.console.print(
            f"not tested: {', '.join(result.left_out)}; they go on from the training record, or "
            "need a simulator of the test record (--test-simulator)"
        )
    bands = setup.bands
    if bands.cutoff is not None and bands.downsampling is not None:
        below = periodogram(record[: setup.train].y, record.sampling_rate).share_below(bands.cutoff)
        showing.console.print(
            f"cut-off {bands.cutoff:g} Hz, order {bands.order}, the "
            f"low band kept at every {showing.ordinal(bands.downsampling)} sample: "
            + (bands.choice.reason if bands.choice else f"{below:.0%} of the power lies below it")
        )
    unhelpful = bands.choice is not None and bands.choice.simulator_helps is False
    if unhelpful and not set(result.plan.names) & set(HYBRIDS):
        showing.console.print("hybrid models are left out; --methods brings them back")
    showing.warn_of_trainings(result.runs)
    showing.warn_of_inputs(result.inputs_beyond_training, record.inputs)
    for doubt in words.doubts(result):
        showing.warn(doubt)
    for test, prediction in zip(result.tests, result.means[best].tests, strict=False):
        for message in prediction.warnings:
            showing.warn(f"{test.name}: {message}")
    for line in words.achieved(result):
        showing.console.print(line, style="bold")
    for tested in result.residual_tests():
        showing.console.print(f"residual tests: {tested.verdict()}")
    for what, command in used.commands[:1]:
        showing.console.print(f"{what}:\n    {command}", soft_wrap=True)
    if result.model is not None:
        showing.console.print(f"trained model: {out / MODEL}/")
    showing.console.print(f"results and pictures: {out}/\npage: {out / 'report.html'}")
    showing.results_file(out / "results.json")


def _title(record: Record, setup: Setup) -> str:
    truth = "the noise-free signal" if record.y_true is not None else "what was measured"
    return (
        f"{record.name}: simulations and forecasts against {truth}; {setup.train:,} samples to "
        f"train on, {len(record) - setup.train:,} after them"
    )
