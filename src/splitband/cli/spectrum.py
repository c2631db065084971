"""Define `splitband spectrum`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from rich.table import Column, Table

from splitband.cli import records, showing
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import AUTO, Cutoff, Order
from splitband.cli.options.records import RecordArgument, RecordOptions
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.simulators import with_simulator
from splitband.data import Record
from splitband.data.named import RECORDS
from splitband.evaluation.plan import TRAINING_SHARE, check_train, chosen_bands
from splitband.filters.spectrum import coherence, oracle, oracle_cutoffs, periodogram
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import BASES
from splitband.forecasters.simulation import Calibrated
from splitband.metrics import rmse
from splitband.runtime.outputs import staged, write_facts


@with_groups
def spectrum(
    record: RecordArgument,
    reading: RecordOptions,
    simulator: SimulatorOptions,
    train: Annotated[
        int | None,
        typer.Option(
            help="Samples at the beginning to look at.",
            show_default="all; the cut-off is chosen by three quarters of a file, as by `compare`",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for results and picture.")] = Path("out"),
    cutoff: Cutoff = None,
    order: Order = None,
) -> None:
    """Show the power spectrum of a record, and how a cut-off would split it.

    Prints the strongest peaks, the share of the power in either band and how well the filter pair
    puts the record together again. With a simulator, also how far it is off, where it is coherent
    with the record, and the oracle check: the RMSE a hybrid model could reach at each cut-off.

    The cut-off is the one that `compare` chooses with the same --train, for the paper's records
    that of its tables where --cutoff does not say auto. `compare --test` trains on the whole
    record: for its cut-off give --train the number of all samples.
    """
    if simulator.simulator in BASES:
        raise ValueError(
            f"--simulator must be a simulator for spectrum; got {simulator.simulator}, which is "
            "fitted to the record: for compare, fit and forecast"
        )
    whole = with_simulator(records.load_record(record, reading), simulator, reading, beyond=True)
    trained = train or (RECORDS[record].train if record in RECORDS else None)
    trained = trained or int(TRAINING_SHARE * len(whole))
    check_train(whole, trained, 0)
    given = Bands(None if cutoff == AUTO else cutoff, order)
    bands = chosen_bands(given, whole[:trained])
    shown = whole[:train]
    rate = shown.sampling_rate
    measured_spectrum = periodogram(shown.y, rate)
    training_spectrum = periodogram(shown.y[:trained], rate)
    pair = bands.pair(rate)
    chosen, choice = float(bands.cutoff or 0.0), bands.choice
    low, high = pair.split(shown.y)
    facts: dict[str, Any] = {
        "record": shown.name,
        "sampling_rate": rate,
        "cutoff": chosen,
        "order": pair.order,
        "train": trained,
        "share_below": training_spectrum.share_below(chosen),
        "choice": None if choice is None else asdict(choice),
        "reconstruction_rmse": rmse(shown.y, low + high),
        "peaks": [{"frequency": f, "share": s} for f, s in measured_spectrum.peaks()],
    }
    _show_peaks(shown, facts)
    if shown.y_sim is not None:
        facts["simulator"] = _show_simulator(shown, shown.y_sim, chosen, pair.order)
        training = shown[:trained]
        facts["simulator"]["training"] = _warn_of_nothing_to_learn(training, chosen, pair.order)
    if choice is not None:
        showing.console.print(
            f"by the first {trained} samples, the low band kept at every "
            f"{showing.ordinal(bands.downsampling or 1)} sample: {choice.reason}"
        )
    from splitband.report import pictures  # noqa: PLC0415  matplotlib is slow to load

    drawn = pictures.spectrum(shown, measured_spectrum, chosen, choice)
    with staged(out) as new:
        pictures.save(drawn, new / "spectrum.png")
        write_facts(new, facts)
    showing.console.print(f"picture: {out / 'spectrum.png'}")
    showing.results_of(out, page=False)


def _warn_of_nothing_to_learn(record: Record, cutoff: float, order: int) -> dict[str, Any]:
    """Return the oracle check on training samples; if it fails, warn and add a calibrated one."""
    assert record.y_sim is not None
    rate = record.sampling_rate
    found = oracle(record.y, record.y_sim, rate, cutoff, order, record.seen)
    facts: dict[str, Any] = {"oracle": asdict(found), "nothing_to_learn": found.nothing_to_learn}
    if not found.nothing_to_learn:
        return facts
    simulation = Calibrated()
    simulation.fit(record)
    y_sim = simulation.on(record).y_sim
    assert y_sim is not None
    mended = oracle(record.y, y_sim, rate, cutoff, order, record.seen)
    facts["oracle_calibrated"] = asdict(mended)
    showing.warn(
        f"{found.describe()}, to which training does not lead then; calibrated "
        f"(--calibrate), the simulator has {mended.no_network:.3g} and "
        f"{mended.perfect_network:.3g}: "
        + ("the same" if mended.nothing_to_learn else "there is something to learn")
    )
    return facts


def _show_peaks(record: Record, facts: dict[str, Any]) -> None:
    headings = [
        Column(h, justify="right") for h in ("frequency (Hz)", "period (s)", "share of power")
    ]
    table = Table(*headings, title=f"{record.name}: strongest peaks", title_justify="left")
    for peak in facts["peaks"]:
        frequency, share = peak["frequency"], peak["share"]
        table.add_row(f"{frequency:.4g}", f"{1 / frequency:.4g}", f"{share:.1%}")
    below, nyquist = facts["share_below"], record.sampling_rate / 2
    showing.console.print(table)
    showing.console.print(
        f"cut-off {facts['cutoff']:.4g} Hz of {nyquist:g} Hz (Nyquist), order {facts['order']}: "
        f"{below:.0%} of the power of the first {facts['train']} samples lies below it\n"
        f"low and high band add up to the record with RMSE {facts['reconstruction_rmse']:.2g}, "
        "all of it at the ends",
    )


def _show_simulator(
    record: Record, y_sim: npt.NDArray[np.float64], cutoff: float, order: int
) -> dict[str, Any]:
    """Print and return how the simulator compares with the record."""
    rate, total = record.sampling_rate, rmse(record.seen, y_sim)
    cutoffs = sorted({*oracle_cutoffs(len(record), rate), cutoff})
    checks = [oracle(record.y, y_sim, rate, c, order, record.seen) for c in cutoffs]
    title = f"oracle check of the hybrid model; the simulator itself has RMSE {total:.4f}"
    headings = "cut-off (Hz)", "H(record) + L(simulator)", "L(simulator) alone"
    columns = [Column(heading, justify="right") for heading in headings]
    table = Table(*columns, title=title, title_justify="left")
    for check in checks:
        style = "bold" if check.cutoff == cutoff else ""
        values = (check.perfect_network, check.no_network)
        table.add_row(f"{check.cutoff:g}", *(f"{v:.4f}" for v in values), style=style)
    showing.console.print(table)
    frequencies, coherences = coherence(record.y, y_sim, rate)
    below = frequencies <= cutoff
    agree = float(coherences[below].mean()) if below.any() else 0.0
    showing.console.print(
        f"a lower cut-off leaves more to the network; mean coherence of simulator and record up "
        f"to {cutoff:.4g} Hz: {agree:.2f}",
    )
    return {
        "total_rmse": total,
        "mean_coherence_below_cutoff": agree,
        "oracle": [asdict(check) for check in checks],
    }
