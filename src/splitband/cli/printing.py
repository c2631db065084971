"""Print tables and warnings for people, and results for programs."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console

from splitband.records.alignment import log
from splitband.records.signals import ReadingWarning
from splitband.report.page import NAME as PAGE
from splitband.report.page.parts import Usage
from splitband.report.table import Table
from splitband.runtime.files import to_json
from splitband.runtime.outputs import FACTS

LEAST_NAME = 12
"""Least width of the names of rows in a table. Layout."""
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
    """What a command prints, beside what the console's own switch says."""

    results: TextIO | None = None  # the stream for results as JSON, if these are asked for
    verbose: bool = False


_mode = _Mode()


@contextmanager
def saying(quiet: bool, json: bool, verbose: bool = False) -> Iterator[None]:
    """Set what is printed; with `json`, standard output holds nothing but the results.

    A user's simulator then prints to the error stream, also from C and from other processes.
    """
    with ExitStack() as stack:
        stack.callback(setattr, console, "quiet", console.quiet)
        console.quiet = quiet or json
        stack.callback(setattr, _mode, "verbose", _mode.verbose)
        _mode.verbose = verbose
        if json:
            _mode.results = _kept_stdout(stack)
            stack.callback(setattr, _mode, "results", None)
            stack.enter_context(redirect_stdout(sys.stderr))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("always", ReadingWarning)
        others, notes = warnings.showwarning, _Notes(logging.INFO)

        def show(message: Any, category: Any, *where: Any) -> None:
            if issubclass(category, ReadingWarning) or category is UserWarning:
                warn(str(message))
            else:
                others(message, category, *where)

        warnings.showwarning = show  # type: ignore[assignment]
        log.addHandler(notes)
        stack.callback(log.removeHandler, notes)
        stack.callback(log.setLevel, log.level)
        log.setLevel(logging.INFO)
        yield


class _Notes(logging.Handler):
    """Print what the library says about files that it puts together."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a note."""
        console.print(record.getMessage())


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


def verbose() -> bool:
    """Return whether reasons and remarks are wanted, too."""
    return _mode.verbose


def warn(message: str) -> None:
    """Print a warning, on the error stream if standard output is quiet."""
    (_errors if console.quiet else console).print(f"warning: {message}", style="yellow")


def warn_of(messages: Sequence[str], first: int) -> None:
    """Print the first warnings and, with --verbose, the others, else how many there are."""
    shown = len(messages) if verbose() else first
    for message in messages[:shown]:
        warn(message)
    if others := messages[shown:]:
        console.print(f"{len(others)} more warning{'s' if len(others) > 1 else ''}: --verbose")


def as_json(facts: object) -> None:
    """Print the results of a command as JSON, with --json only."""
    if _mode.results is not None:
        print(to_json(facts), file=_mode.results)


def results_of(out: Path) -> None:
    """Print the path of a result's page; with --json, print results.json."""
    if (out / PAGE).exists():
        console.print(f"page: {out / PAGE}")
    facts_of(out)


def facts_of(out: Path) -> None:
    """With --json, print results.json."""
    if _mode.results is not None:
        print((out / FACTS).read_text(encoding="utf-8").rstrip(), file=_mode.results)


def use_of(used: Usage) -> None:
    """With --verbose, print how to use a result."""
    for what, command in used.commands[:1] if verbose() else ():
        console.print(f"{what}:\n    {command}", soft_wrap=True)


def table(shown: Table) -> None:
    """Print a table, and below it what must be said of a row.

    With --verbose there are more columns, and what each fit has chosen.
    """
    if shown.title:
        console.print(shown.title, style="bold")
    drawn = shown.drawn(verbose())
    least = sum((column.min_width or LEAST_NAME) + 3 for column in drawn.columns) + 1
    if least > console.width:  # the terminal folds lines: numbers that are cut look like others
        drawn.width = least
    console.print(drawn, crop=False)
    for line in shown.remarks(verbose()):
        console.print(line, style="dim")


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print warnings of the library as lines of the command."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for each in caught:
        warn(str(each.message))
