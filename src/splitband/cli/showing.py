"""Tables and progress bars for people."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from splitband.evaluation.protocols import Runs
from splitband.evaluation.runs import RunProgress
from splitband.metrics import Extrapolation, ExtrapolationWarning
from splitband.report.page.parts import entry
from splitband.report.table import Column
from splitband.runtime.files import to_json

console = Console(
    soft_wrap=not sys.stdout.isatty(),
    width=None if sys.stdout.isatty() else 120,
    markup=False,  # brackets in names of files and columns are text
    emoji=False,
    highlight=False,
)
_errors = Console(stderr=True, soft_wrap=True, markup=False, emoji=False, highlight=False)


@dataclass
class _Mode:
    """What a command prints: tables for people, nothing, or its results as JSON."""

    json: bool = False


_mode = _Mode()


def say(quiet: bool, json: bool) -> None:
    """Set what is printed from now on; results as JSON leave no room for anything else."""
    console.quiet = quiet or json
    _mode.json = json


def warn(message: str) -> None:
    """Print a warning, on the error stream where the other one is kept clean."""
    (_errors if console.quiet else console).print(f"warning: {message}", style="yellow")


def as_json(facts: object) -> None:
    """Print what a command came to, if that is wanted as JSON."""
    if _mode.json:
        print(to_json(facts))


def results_file(path: Path) -> None:
    """Print a file of results, if these are wanted as JSON."""
    if _mode.json:
        print(path.read_text(encoding="utf-8").rstrip())


def methods(
    title: str, listed: Sequence[Column], said: Mapping[str, str], recommended: str
) -> None:
    """Print a table of columns with a row for each method; the lowest error of each is bold.

    Of several channels each has a line in every row. Below stands what is `said` of each method:
    in a column of its own it would be broken into single words.
    """
    headings = list(dict.fromkeys((column.heading, column.record) for column in listed))
    channels = list(dict.fromkeys(column.channel for column in listed if column.channel))
    table = Table(title=title, title_justify="left", title_style="bold", show_lines=bool(channels))
    table.add_column("method", min_width=max(map(len, said)))
    if channels:
        table.add_column("channel")
    for heading, record in headings:
        # A number in two lines would be taken for two channels.
        table.add_column(f"{heading} {record}".strip(), justify="right", no_wrap=True)
    for name in said:
        cells = [
            _lines([c for c in listed if (c.heading, c.record) == of], name) for of in headings
        ]
        if channels:
            cells.insert(0, Text("\n".join(channels)))
        table.add_row(Text(name, style="bold" if name == recommended else ""), *cells)
    console.print(table)
    for name, words in said.items():
        if words:
            console.print(f"{name}: {words}", style="dim")


def _lines(of_channels: Sequence[Column], method: str) -> Text:
    """Return a cell: a line for each channel."""
    said = [
        Text(entry(column, method), style="bold" if column.best == method else "")
        for column in of_channels
    ]
    return Text("\n").join(said)


@contextmanager
def progress(
    label: str = "training", total: int | None = None
) -> Iterator[Callable[[RunProgress], None]]:
    """A bar over all trainings, and one for each that runs; silent where nobody watches.

    Where it depends on results how many there will be, the first bar counts those that are done.
    """
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[loss]}"),
        console=Console(stderr=True),
        transient=True,
        disable=console.quiet or not sys.stderr.isatty(),
    )
    with bar:
        overall = bar.add_task(label, total=total, loss="")
        rows: dict[tuple[str, str, int], TaskID] = {}
        shares: dict[tuple[str, str, int], float] = {}

        def update(at: RunProgress) -> None:
            key = at.stage, at.method, at.seed
            if key not in rows:
                rows[key] = bar.add_task(f"  {at.method}, seed {at.seed}", total=1.0, loss="")
            shares[key] = at.share
            bar.update(rows[key], completed=at.share, loss=f"loss {at.loss:.4g}")
            bar.update(rows[key], visible=at.share < 1)
            if total is None:
                done = sum(share >= 1 for share in shares.values())
                bar.update(overall, description=f"{label}: {at.stage}, {done} done")
            else:
                bar.update(overall, completed=sum(shares.values()))

        yield update


def warn_of_inputs(extrapolations: Sequence[Extrapolation], names: Sequence[str]) -> None:
    """Say which inputs of what is predicted go beyond their range in training."""
    for beyond in extrapolations:
        named = names[beyond.channel] if beyond.channel < len(names) else ""
        warn(beyond.describe(named))


def warn_of_trainings(runs: Runs) -> None:
    """Say what a training was not good for, each thing once."""
    for name, of_method in runs.items():
        for note in dict.fromkeys(note for run in of_method for note in run.fit.notes):
            warn(f"{name}: {note}")


@contextmanager
def without_warnings() -> Iterator[None]:
    """Without the library's warnings of extrapolation, where the command says so itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExtrapolationWarning)
        yield


def ordinal(k: int) -> str:
    """1st, 2nd..."""
    suffix = {1: "st", 2: "nd", 3: "rd"}.get(k % 10 if k % 100 not in (11, 12, 13) else 0, "th")
    return f"{k}{suffix}"


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Warnings of the library in lines of the command."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for each in caught:
        warn(str(each.message))
