"""The command line; the only part of the package that prints."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import typer
from rich.console import Console
from typer.core import TyperGroup
from typer.exceptions import TyperException

COMMANDS = {
    "demo": ("demo", "Show what the package does, in under a minute."),
    "compare": ("compare", "Compare models of a record with each other and with naive baselines."),
    "benchmark": ("benchmark", "Compare models of many records, and put them into one table."),
    "forecast": ("forecast", "Forecast a record beyond its end, with an interval."),
    "fit": ("fit", "Train one model on a record and save it."),
    "simulate": ("simulate", "Simulate a saved model beyond a measured history."),
    "spectrum": ("spectrum", "Show where the power of a record lies, and what a cut-off parts."),
    "data": ("data", "The public records of the paper."),
    "paper": ("paper", "Reproduce the tables and figures of the paper."),
}
"""The module of each command and a line about it; a module is loaded when its command is given."""


class Commands(TyperGroup):
    """The commands by name. Loading torch for a list of them would take seconds."""

    listing = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Their names, in the order of a first look."""
        return [*COMMANDS]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command, of a list just its name and a line about it."""
        if cmd_name not in COMMANDS:
            return None
        module, line = COMMANDS[cmd_name]
        if self.listing:
            return typer.core.TyperCommand(cmd_name, help=line)
        command = getattr(import_module(f"splitband.cli.{module}"), cmd_name)
        if isinstance(command, typer.Typer):
            return typer.main.get_group(command)
        alone = typer.Typer(add_completion=False, rich_markup_mode="markdown")
        alone.command(cmd_name)(command)
        return typer.main.get_command(alone)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The list of commands, without loading them."""
        self.listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self.listing = False


app = typer.Typer(
    name="splitband",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


@app.callback(
    help="Learn a dynamics model from a measured record whose free-running predictions stay "
    "accurate, in the short term and in the long."
)
def splitband() -> None:
    """All commands; there are no options of its own."""


INTERRUPTED = 130
"""Status after Ctrl-C, as shells have it and typer returns it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; bad input is one line on the error stream and exit status 2."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        status = typer.main.get_command(app).main(
            given, prog_name="splitband", standalone_mode=False
        )
    except TyperException as error:
        # Without a command typer has printed the help, and its message is empty.
        nothing = f"a command must be given: {' '.join(['splitband', *given])} COMMAND"
        return _complain((error.format_message().strip() or nothing) + _value(error, given))
    except EXPECTED as error:
        return _complain(in_words(error))
    if status == INTERRUPTED:
        _complain("stopped; no file is half written, and the same command goes on from here")
    return status if isinstance(status, int) else 0


def _value(error: TyperException, given: Sequence[str]) -> str:
    """What an option was given that the message does not repeat."""
    names = getattr(getattr(error, "param", None), "opts", [])
    values = ""
    for word, following in zip(given, [*given[1:], ""], strict=False):
        name, _, value = word.partition("=")
        if name in names:
            values = f", got {value or following}"
    return values


def _complain(message: str) -> int:
    console = Console(stderr=True, soft_wrap=True, markup=False, emoji=False, highlight=False)
    console.print(f"error: {message}")
    return 2


OPTIONS = (
    "calibrate", "columns", "conditioned", "cutoff", "downsampling", "epochs", "inputs", "level",
    "methods", "order", "steps", "train", "warmup", "window",
)  # fmt: skip
"""Arguments of the library that are options of the same name here."""


EXPECTED = (ValueError, OSError, FloatingPointError, MemoryError, OverflowError)
"""What bad input raises; other exceptions are errors of the package."""


def in_words(error: Exception) -> str:
    """What an error says to the user, in one line."""
    said = _in_options(_in_one_line(error))
    if isinstance(error, MemoryError | OverflowError):
        return f"a number is too large for this machine: {said}"
    return said if isinstance(error, EXPECTED) else f"{type(error).__name__}: {said}"


def _in_options(message: str) -> str:
    """A message of the library, which begins with an argument of its own, in the user's terms."""
    return re.sub(rf"^({'|'.join(OPTIONS)}) (?=must|needs)", r"--\1 ", message)


def _in_one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.strerror}: {error.filename}"
    return " ".join(str(error).split())
