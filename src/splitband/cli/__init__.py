"""The command line; the only part of the package that prints."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer
from rich.console import Console
from typer.exceptions import TyperException

from splitband.cli import compare, data, fit, forecast, paper, simulate, spectrum

app = typer.Typer(
    name="splitband",
    help="Learn a dynamics model from a measured record whose free-running predictions stay "
    "accurate, in the short term and in the long.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
app.command()(compare.demo)
app.command()(compare.compare)
app.command()(forecast.forecast)
app.command()(fit.fit)
app.command()(simulate.simulate)
app.command()(spectrum.spectrum)
app.add_typer(data.data, name="data")
app.add_typer(paper.paper, name="paper")


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
        # Called without a command it has printed the help, and has nothing else to say.
        nothing = f"a command must be given: {' '.join(['splitband', *given])} COMMAND"
        return _complain((error.format_message().strip() or nothing) + _value(error, given))
    except (ValueError, OSError, FloatingPointError) as error:
        return _complain(_in_one_line(error))
    except (MemoryError, OverflowError) as error:
        return _complain(f"a number is too large for this machine: {_in_one_line(error)}")
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


def _in_one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.strerror}: {error.filename}"
    return " ".join(str(error).split())
