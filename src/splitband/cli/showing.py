"""Tables and progress bars for people."""

from __future__ import annotations

import os
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column as TableColumn
from rich.table import Table
from rich.text import Text

from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.protocols import Runs
from splitband.evaluation.work import RunProgress
from splitband.metrics import Extrapolation, ExtrapolationWarning
from splitband.report.table import NOTES, Column
from splitband.runtime.deadlines import now
from splitband.runtime.files import to_json

console = Console(
    soft_wrap=not sys.stdout.isatty(),
    width=None if sys.stdout.isatty() else 100,
    markup=False,  # brackets in names of files and columns are text
    emoji=False,
    highlight=False,
)
_errors = Console(stderr=True, soft_wrap=True, markup=False, emoji=False, highlight=False)


@dataclass
class _Mode:
    """Where results go as JSON; None where a command prints tables for people, or nothing."""

    results: TextIO | None = None


_mode = _Mode()


@contextmanager
def saying(quiet: bool, json: bool) -> Iterator[None]:
    """Set what is printed; results as JSON leave no room for anything else.

    What a user's simulator prints goes to the error stream then, in C and in other processes, too.
    """
    with ExitStack() as stack:
        stack.callback(setattr, console, "quiet", console.quiet)
        console.quiet = quiet or json
        if json:
            _mode.results = _kept_stdout(stack)
            stack.callback(setattr, _mode, "results", None)
            stack.enter_context(redirect_stdout(sys.stderr))
        yield


def _kept_stdout(stack: ExitStack) -> TextIO:
    """Return the output stream for results alone; its descriptor is the error stream's till then.

    One that has been put in its place in Python has no descriptor of its own.
    """
    stream = sys.__stdout__
    if stream is None or stream is not sys.stdout:
        return sys.stdout
    stream.flush()
    kept = os.dup(1)
    results = stack.enter_context(os.fdopen(kept, "w", encoding="utf-8"))
    os.dup2(2, 1)
    stack.callback(os.dup2, kept, 1)
    stack.callback(stream.flush)
    return results


def warn(message: str) -> None:
    """Print a warning, on the error stream where the other one is kept clean."""
    (_errors if console.quiet else console).print(f"warning: {message}", style="yellow")


def as_json(facts: object) -> None:
    """Print what a command came to, if that is wanted as JSON."""
    if _mode.results is not None:
        print(to_json(facts), file=_mode.results)


def results_file(path: Path) -> None:
    """Print a file of results, if these are wanted as JSON."""
    if _mode.results is not None:
        print(path.read_text(encoding="utf-8").rstrip(), file=_mode.results)


def methods(
    title: str, listed: Sequence[Column], said: Mapping[str, str], recommended: str
) -> None:
    """Print a table of columns with a row for each method; the best of each column is bold.

    Of several outputs each has a line in every row. Where the terminal is too narrow, the least
    important columns are left out. Below stands what is `said` of each method.
    """
    headings = [*dict.fromkeys((column.heading, column.record) for column in listed)]
    least = [*NOTES]
    headings.sort(key=lambda each: least.index(each[0]))
    channels = list(dict.fromkeys(column.channel for column in listed if column.channel))
    left_out = []
    while True:
        of = [[c for c in listed if (c.heading, c.record) == each] for each in headings]
        table = _table(title, of, channels, [*said], recommended)
        if len(headings) == 1 or _width(table) <= console.width:
            break
        left_out.append(headings.pop()[0])
    console.print(table)
    if left_out:
        more = ", ".join(dict.fromkeys(left_out[::-1]))
        console.print(f"Left out of a narrow terminal: {more}.", style="dim")
    for name, words in said.items():
        if words:
            console.print(f"{name}: {words}", style="dim")


def _table(
    title: str,
    listed: Sequence[Sequence[Column]],
    channels: Sequence[str],
    names: Sequence[str],
    recommended: str,
) -> Table:
    """Return a table; `listed` holds the columns of each heading, one for each output."""
    table = Table(title=title, title_justify="left", title_style="bold", show_lines=bool(channels))
    table.add_column("method", no_wrap=True)
    if channels:
        table.add_column("output", no_wrap=True)
    for of_heading in listed:
        single = f"{of_heading[0].heading} {of_heading[0].record}" if channels else ""
        heading = (single or of_heading[0].label).strip()
        widest = max(len(column.entry(name)) for column in of_heading for name in names)
        # A number in two lines would be taken for two outputs.
        header = textwrap.fill(heading, max(widest, 9), break_long_words=False)
        table.add_column(header, justify="right", no_wrap=True)
    for name in names:
        cells = [_lines(of_heading, name) for of_heading in listed]
        if channels:
            cells.insert(0, Text("\n".join(channels)))
        mark = "* " if name == recommended else "  "
        table.add_row(Text(mark + name, style="bold" if mark.strip() else ""), *cells)
    return table


def _width(table: Table) -> int:
    """Return how wide a table is where it has all the room there is."""
    return Measurement.get(console, console.options.update(width=10_000), table).maximum


def _lines(of_channels: Sequence[Column], method: str) -> Text:
    """Return a cell: a line for each channel."""
    said = [
        Text(column.entry(method), style="bold" if column.best == method else "")
        for column in of_channels
    ]
    return Text("\n").join(said)


@contextmanager
def progress(
    label: str = "training",
    time: TimeBudget | None = None,
    said: str = "",
    total: int | None = None,
) -> Iterator[Callable[[RunProgress], None]]:
    """One bar for the whole command, with the phase by name; silent where nobody watches.

    It shows what is done by reckoned costs, the time that has passed since the command began, and
    what remains by both: no more than is left until the deadline. Where there are a `total`
    of trainings, it shows their share. What is `said` is printed first.
    """
    watched = sys.stderr.isatty() and not console.quiet
    if said and not console.quiet:
        Console(stderr=True).print(said, markup=False, highlight=False)
    # What is done now comes last and is cut where the terminal ends: it may be longer than a line.
    bar = Progress(
        TextColumn(label),
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[times]}"),
        TextColumn(
            "{task.description}",
            table_column=TableColumn(ratio=1, no_wrap=True, overflow="ellipsis"),
        ),
        console=Console(stderr=True),
        expand=True,
        transient=True,
        disable=not watched,
    )
    began = now() if time is None else time.began
    with bar:
        whole = bar.add_task("", total=1.0, times=_clock(now() - began))
        shares: dict[tuple[str, str, int], float] = {}
        reached = 0.0

        def update(at: RunProgress) -> None:
            nonlocal reached
            shares[at.stage, at.method, at.seed] = at.share
            share = at.overall if total is None else sum([*shares.values()]) / total
            reached = max(reached, share)
            elapsed = now() - began
            remains = elapsed * (1 / reached - 1) if reached else None
            if remains is not None and time is not None and time.limited:
                remains = min(remains, max(time.deadline.left, 0.0))
            bar.update(
                whole,
                completed=reached,
                description=": ".join(filter(None, (at.stage, at.method))),
                times=_clock(elapsed) + _left(remains),
            )

        yield update


def kept(checkpoints: Path) -> str:
    """What is said where a command goes on from what an earlier one has left; else nothing."""
    # What begins with a dot was being written when a command was killed.
    count = len([path for path in checkpoints.rglob("*.safetensors") if path.name[0] != "."])
    return f"resuming: {count} training{'s' if count != 1 else ''} kept" if count else ""


def _left(seconds: float | None) -> str:
    """Words for the time that remains; after the deadline only what has begun is finished."""
    if seconds is None:
        return ""
    return f", {_clock(seconds)} left" if seconds >= 1 else ", finishing"


def _clock(seconds: float) -> str:
    """Minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02}"


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
