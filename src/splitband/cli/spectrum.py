"""Define `splitband spectrum`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from splitband.cli import options, printing, records
from splitband.cli.usage import command_of, usage
from splitband.comparison.checks import check_train
from splitband.comparison.defaults import chosen_bands
from splitband.comparison.methods import forecasters
from splitband.comparison.request import TRAINING_SHARE
from splitband.filters.spectrum import coherence, oracle, oracle_cutoffs, periodogram
from splitband.forecasters.bands import Bands
from splitband.forecasters.held_out import beginning
from splitband.forecasters.simulation import Calibrated
from splitband.metrics import rmse
from splitband.records import Record
from splitband.records.named import RECORDS
from splitband.report import results
from splitband.report.numbers import number, percent
from splitband.report.table import Column, Table
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.open_simulator import is_fitted, open_simulator, simulated


@options.with_groups
def spectrum(
    context: typer.Context,
    record: options.RecordArgument,
    reading: options.RecordOptions,
    simulator: options.SimulatorOptions,
    train: Annotated[
        int | None,
        options.plain("Use the first N samples only.", usual="all; cut-off: three quarters"),
    ] = None,
    out: options.Out = Path("spectrum"),
    cutoff: options.Cutoff = None,
    order: options.Order = None,
) -> None:
    """Show the power spectrum of a record, and how a cut-off would split it.

    Prints the strongest peaks, the share of the power in the low band, and the error of the sum of
    both bands. With a simulator, also its error, its coherence with the record, and the oracle
    check: the RMSE that a hybrid could reach at each cut-off. OUT gets results.json and plots
    (report.html).

    The cut-off is the one that `compare` chooses with the same --train for methods of two bands:
    filtered hybrids, or without a simulator split-gru. With --test, `compare` trains on the whole
    record: give --train the number of all samples then.
    """
    whole = records.load_record(record, reading)
    opened = records.simulator_of(simulator, whole, reading.time_column)
    if isinstance(opened, str) or is_fitted(opened):
        raise InputError(
            f"--simulator must be one that is run as it is, got {simulator.simulator}, which is "
            "fitted to the record: compare, fit and forecast do that"
        )
    if opened is None and whole.y_sim is not None:  # a named record's own can run for longer
        opened = open_simulator(record, whole)
    if opened is not None:
        whole = simulated(whole, opened, longer=True)
    trained = RECORDS[record].train if train is None and record in RECORDS else train
    trained = int(TRAINING_SHARE * len(whole)) if trained is None else trained
    check_train(whole, trained)
    given = Bands(cutoff, order)
    method = "split-gru" if whole.y_sim is None else "filtered-gru-calibrated"
    bands = chosen_bands(given, beginning(whole, trained), forecasters(method))
    shown = whole[:train]
    rate = shown.sampling_rate
    pair = bands.pair(rate)
    chosen, choice = float(bands.cutoff or 0.0), bands.choice
    low, high = pair.split(shown.y)
    below = periodogram(shown.y[:trained], rate).share_below(chosen)
    error = rmse(shown.y, low + high)
    peaks = periodogram(shown.y, rate).peaks()
    tables = [_peaks(shown, peaks)]
    said = [
        f"cut-off {chosen:.4g} Hz of {rate / 2:g} Hz (Nyquist), order {pair.order}: "
        f"{percent(below)} of the power of the first {trained} samples lies below it",
        f"low and high band sum to the record with RMSE {error:.2g}, all of it at the ends",
    ]
    facts: dict[str, Any] = {
        "record": shown.name,
        "sampling_rate": rate,
        "cutoff": chosen,
        "order": pair.order,
        "train": trained,
        "share_below": below,
        "choice": None if choice is None else asdict(choice),
        "reconstruction_rmse": error,
        "peaks": [{"frequency": f, "share": s} for f, s in peaks],
    }
    warnings = whole.warnings()
    if shown.y_sim is not None:
        facts["simulator"], oracles, agreement = _beside(shown, shown.y_sim, chosen, pair.order)
        tables.append(oracles)
        said.append(agreement)
        training, nothing = _nothing_to_learn(shown[:trained], chosen, pair.order)
        warnings += nothing
        facts["simulator"]["training"] = training
    if choice is not None:
        said.append(
            f"chosen on the first {trained} samples: {choice.reason}; the low band keeps one of "
            f"{bands.downsampling} samples"
        )
    for each in tables:
        printing.table(each)
    for line in said:
        printing.console.print(line)
    for warning in warnings:
        printing.warn(warning)
    facts |= {"in_words": said, "warnings": warnings}
    asked = command_of(context)
    used = usage(asked["command"], asked["arguments"])
    results.save_spectrum(shown, bands, tables, asked | facts, out, used)
    printing.results_of(out)


def _peaks(record: Record, peaks: Sequence[tuple[float, float]]) -> Table:
    of = {f"{frequency:.4g} Hz": (1 / frequency, share) for frequency, share in peaks}
    periods, shares = ({name: each[i] for name, each in of.items()} for i in range(2))
    listed = [
        Column("period (s)", "record", periods, ranked=False),
        Column("share of power", "share", shares, ranked=False),
    ]
    return Table(f"{record.name}: strongest peaks", listed, dict.fromkeys(of, ""), "frequency")


def _beside(
    record: Record, y_sim: Array, cutoff: float, order: int
) -> tuple[dict[str, Any], Table, str]:
    """Return how a simulator compares with the record: as facts, as a table, in a sentence."""
    rate, total = record.sampling_rate, rmse(record.y_with_gaps, y_sim)
    cutoffs = {f"{each:g} Hz": each for each in (*oracle_cutoffs(len(record), rate), cutoff)}
    of = {
        name: oracle(record.y, y_sim, rate, each, order, record.y_with_gaps)
        for name, each in sorted(cutoffs.items(), key=lambda pair: pair[1])
    }
    perfect = {name: check.perfect_network for name, check in of.items()}
    without = {name: check.no_network for name, check in of.items()}
    listed = [
        Column("perfect network", "record", perfect, ranked=False),
        Column("no network", "record", without, ranked=False),
    ]
    title = (
        f"Oracle check: RMSE of a hybrid with a perfect network (measured high band, simulated low "
        f"band) and with none; the simulator alone has RMSE {number(total)}"
    )
    table = Table(title, listed, dict.fromkeys(of, ""), "cut-off", f"{cutoff:g} Hz")
    frequencies, coherences = coherence(record.y, y_sim, rate)
    below = frequencies <= cutoff
    agree = float(coherences[below].mean()) if below.any() else 0.0
    said = (
        "a lower cut-off leaves more to the network; mean coherence of simulator and record up to "
        f"{cutoff:.4g} Hz: {agree:.2f}"
    )
    checks = [asdict(check) for check in of.values()]
    facts = {"total_rmse": total, "mean_coherence_below_cutoff": agree, "oracle": checks}
    return facts, table, said


def _nothing_to_learn(
    record: Record, cutoff: float, order: int
) -> tuple[dict[str, Any], list[str]]:
    """Return the oracle check on training samples; if it fails, also a calibrated one, and why."""
    assert record.y_sim is not None
    rate = record.sampling_rate
    found = oracle(record.y, record.y_sim, rate, cutoff, order, record.y_with_gaps)
    facts: dict[str, Any] = {"oracle": asdict(found), "nothing_to_learn": found.nothing_to_learn}
    if not found.nothing_to_learn:
        return facts, []
    simulation = Calibrated()
    simulation.fit(record)
    y_sim = simulation.on(record).y_sim
    assert y_sim is not None
    mended = oracle(record.y, y_sim, rate, cutoff, order, record.y_with_gaps)
    return facts | {"oracle_calibrated": asdict(mended)}, [
        f"{found.describe()}; with the simulator calibrated (--calibrate) "
        f"{mended.no_network:.3g} and {mended.perfect_network:.3g}: "
        + ("the same" if mended.nothing_to_learn else "there is something to learn")
    ]
