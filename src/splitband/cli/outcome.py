"""What the commands that compare say of a comparison."""

from __future__ import annotations

from pathlib import Path

from splitband.cli import showing
from splitband.data import Trajectory
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.selection import WORTH_TRAINING
from splitband.evaluation.setup import Setup
from splitband.filters.spectrum import periodogram
from splitband.forecasters.backtest import HELD_OUT
from splitband.forecasters.names import HYBRIDS
from splitband.report.page import words
from splitband.report.results import FOUND


def show(result: Comparison, names: list[str], out: Path) -> None:
    """Print the table, what is recommended and why, and what to be warned of."""
    record, setup, trial = result.record, result.setup, result.require_trial()
    best = result.recommended
    showing.console.print(showing.comparison(_title(record, setup), result))
    chosen_by = f"the error of its forecast of the last {HELD_OUT:.0%} of the training part"
    if setup.train < len(record):
        chosen_by += (
            f" (held out: RMSE {trial.errors[best]:.3g}) and by the change of its forecast of what "
            f"follows once these are known, too ({trial.change(best):.3g})"
        )
    else:
        chosen_by += f" (held out: RMSE {trial.errors[best]:.3g})"
    needed = (
        f"; a network has to be {WORTH_TRAINING:.0%} better than what needs no training"
        if trial.trained and set(trial.errors) - trial.trained
        else ""
    )
    showing.console.print(f"recommended: {best}, chosen by {chosen_by}{needed}")
    if result.left_out:
        showing.console.print(
            f"not tested: {', '.join(result.left_out)}; they go on from the training record, or "
            "need a simulator of the test record (--test-simulator)"
        )
    if record.ny > 1:
        showing.console.print(f"{best}: {showing.channels(result, best)}")
    bands = setup.bands
    if bands.cutoff is not None and bands.downsampling is not None:
        below = periodogram(record[: setup.train].y, record.sampling_rate).share_below(bands.cutoff)
        showing.console.print(
            f"cut-off {bands.cutoff:g} Hz, order {bands.order}, the "
            f"low band kept at every {showing.ordinal(bands.downsampling)} sample: "
            + (bands.choice.reason if bands.choice else f"{below:.0%} below")
        )
    unhelpful = bands.choice is not None and bands.choice.simulator_helps is False
    if unhelpful and not set(names) & set(HYBRIDS):
        showing.console.print("hybrid models are left out; --methods brings them back")
    showing.warn_of_trainings(result.runs)
    showing.warn_of_inputs(result.inputs_beyond_training, record.inputs)
    for doubt in words.doubts(result):
        showing.warn(doubt)
    for test, prediction in zip(result.tests, result.means[best].tests, strict=False):
        for message in prediction.warnings:
            showing.warn(f"{test.name}: {message}")
    if (out / FOUND).is_file():
        showing.console.print(
            f"how {best} was trained: {out / FOUND}; to train it so again: splitband fit "
            f"{record.name} ... --settings {out / FOUND}"
        )
    showing.console.print(f"results and pictures: {out}/\npage: {out / 'report.html'}")
    showing.results_file(out / "results.json")


def _title(record: Trajectory, setup: Setup) -> str:
    truth = "the noise-free signal" if record.y_true is not None else "the measurement"
    return (
        f"{record.name}: free-run RMSE against {truth}, {setup.train} samples to train on, "
        f"{len(record) - setup.train} beyond"
    )
