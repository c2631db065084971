"""`splitband spectrum` and `splitband data`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from splitband import plots
from splitband.cli import options, showing
from splitband.data import PUBLIC, fetch
from splitband.files import output_folder, write_json
from splitband.filters import ComplementaryPair
from splitband.metrics import rmse
from splitband.spectrum import default_cutoff, periodogram
from splitband.systems import RECORDS

data = typer.Typer(help="The public records of the paper.", no_args_is_help=True)


def spectrum(
    record: options.Record,
    out: Annotated[Path, typer.Option(help="Folder for results and picture.")] = Path("out"),
    columns: options.Columns = None,
    time_column: options.TimeColumn = None,
    sampling_time: options.SamplingTime = None,
    cutoff: options.Cutoff = None,
    order: options.Order = None,
) -> None:
    """Show where the power of a record lies, and what a cut-off would part.

    Prints the strongest peaks, the share of the power in either band and how well the filter pair
    puts the record together again.
    """
    trajectory = options.load_record(record, columns, None, time_column, sampling_time)
    rate = trajectory.sampling_rate
    found = periodogram(trajectory.y, rate)
    chosen = default_cutoff(trajectory.y, rate, 1) if cutoff is None else cutoff
    pair = ComplementaryPair.butterworth(chosen, rate, 1 if order is None else order)
    low = pair.lowpass(trajectory.y)
    lost = rmse(trajectory.y, low + pair.highpass(trajectory.y))
    output_folder(out)

    table = Table(title=f"{trajectory.name}: strongest peaks", title_justify="left")
    table.add_column("frequency (Hz)", justify="right")
    table.add_column("period (s)", justify="right")
    table.add_column("share of power", justify="right")
    peaks = found.peaks()
    for frequency, share in peaks:
        table.add_row(f"{frequency:.4g}", f"{1 / frequency:.4g}", f"{share:.1%}")
    below = found.share_below(chosen)
    facts = {
        "record": trajectory.name,
        "sampling_rate": rate,
        "cutoff": chosen,
        "order": pair.order,
        "share_below": below,
        "reconstruction_rmse": lost,
        "peaks": [{"frequency": f, "share": s} for f, s in peaks],
    }
    write_json(out / "results.json", facts)
    plots.save(plots.spectrum(trajectory, found, chosen), out / "spectrum.png")
    showing.console.print(table)
    showing.console.print(
        f"cut-off {chosen:.4g} Hz of {rate / 2:g} Hz (Nyquist), order {pair.order}: {below:.1%} "
        f"of the power below, {1 - below:.1%} above\nlow and high band add up to the record with "
        f"RMSE {lost:.2g}, all of it at the ends\npicture: {out / 'spectrum.png'}",
        highlight=False,
    )


@data.command("list")
def list_records() -> None:
    """List the named records and the public files behind them."""
    table = Table()
    for heading in ("file", "what", "licence", "size"):
        table.add_column(heading, justify="right" if heading == "size" else "left")
    for public in PUBLIC.values():
        size = f"{public.size / 1000:.0f} kB"
        table.add_row(public.name, public.description, public.licence, size)
    showing.console.print(table)
    showing.console.print(f"named records: {', '.join(RECORDS)}", highlight=False)


@data.command("fetch")
def fetch_records(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Files to fetch.", show_default="all"),
    ] = None,
) -> None:
    """Download public files, or find them in SPLITBAND_DATA_DIR, and check them."""
    for name in names or PUBLIC:
        showing.console.print(f"{name}: {fetch(name)}", highlight=False)
