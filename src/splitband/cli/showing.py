"""Print tables and progress bars for people."""

from __future__ import annotations

import os
import sys
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from splitband.metrics import ExtrapolationWarning
from splitband.report.table import Column
from splitband.runtime.files import to_json
from splitband.runtime.outputs import FACTS

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
    """Hold the stream for results as JSON; None if a command prints tables, or nothing."""

    results: TextIO | None = None


_mode = _Mode()


@contextmanager
def saying(quiet: bool, json: bool) -> Iterator[None]:
    """Set what is printed; with `json`, standard output holds nothing but the results.

    A user's simulator then prints to the error stream, also from C and from other processes.
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
    """Return a stream to standard output for results; all else goes to the error stream meanwhile.

    A stream that replaces sys.stdout in Python has no descriptor, and is returned as it is.
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
    """Print a warning, on the error stream if standard output is quiet."""
    (_errors if console.quiet else console).print(f"warning: {message}", style="yellow")


def as_json(facts: object) -> None:
    """Print the results of a command as JSON, with --json only."""
    if _mode.results is not None:
        print(to_json(facts), file=_mode.results)


def results_of(out: Path, page: bool = True) -> None:
    """Print the path of the page of a result; with --json, print results.json."""
    if page:
        console.print(f"page: {out / 'report.html'}")
    if _mode.results is not None:
        print((out / FACTS).read_text(encoding="utf-8").rstrip(), file=_mode.results)


def methods(
    title: str, listed: Sequence[Column], said: Mapping[str, str], recommended: str
) -> None:
    """Print a table of columns with a row for each method; the best of each column is bold.

    With several outputs, a row has a line for each. If the terminal is too narrow, the last
    columns are left out. Remarks on the methods (`said`) follow the table.
    """
    table, left_out = fitting(title, listed, [*said], recommended)
    console.print(table)
    if left_out:
        more = ", ".join(dict.fromkeys(left_out[::-1]))
        console.print(f"Left out of a narrow terminal: {more}.", style="dim")
    for name, words in said.items():
        if words:
            console.print(f"{name}: {words}", style="dim")


def fitting(
    title: str, listed: Sequence[Column], names: Sequence[str], recommended: str
) -> tuple[Table, list[str]]:
    """Return a table as wide as the terminal, and the headings of the columns left out."""
    of_heading: dict[tuple[str, str], list[Column]] = {}
    for column in listed:
        of_heading.setdefault((column.heading, column.record), []).append(column)
    shown, left_out = [*of_heading.values()], list[str]()
    channels = [*dict.fromkeys(column.channel for column in listed if column.channel)]
    table = _table(title, shown, channels, names, recommended)
    everywhere = console.options.update(width=10_000)
    while len(shown) > 1 and Measurement.get(console, everywhere, table).maximum > console.width:
        left_out.append(shown.pop()[0].heading)
        table = _table(title, shown, channels, names, recommended)
    return table, left_out


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
        cells = [Text("\n".join(channels))] if channels else []
        for of_heading in listed:
            lines = [Text(c.entry(name), "bold" if c.best == name else "") for c in of_heading]
            cells.append(Text("\n").join(lines))
        mark = "* " if name == recommended else "  "
        table.add_row(Text(mark + name, style="bold" if mark.strip() else ""), *cells)
    return table


@contextmanager
def without_warnings() -> Iterator[None]:
    """Silence the library's extrapolation warnings, where the command reports them itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExtrapolationWarning)
        yield


def ordinal(k: int) -> str:
    """Return 1st, 2nd..."""
    suffix = {1: "st", 2: "nd", 3: "rd"}.get(k % 10 if k % 100 not in (11, 12, 13) else 0, "th")
    return f"{k}{suffix}"


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print warnings of the library as lines of the command."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for each in caught:
        warn(str(each.message))
