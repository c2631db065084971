"""Define the command line, the only part of the package that prints."""

from __future__ import annotations

import signal
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperGroup
from typer.exceptions import TyperException

from splitband import __version__
from splitband.cli import clock
from splitband.runtime.errors import InputError
from splitband.runtime.system import expanded

COMMANDS = {
    "demo": "See what the package does, in about a minute.",
    "inspect": "Show what a record holds and which command to run.",
    "compare": "Compare models of a record and recommend one.",
    "summary": "Put the results of many records into one table.",
    "forecast": "Forecast beyond the end of a record, with an interval.",
    "fit": "Train one method on a record and save the model.",
    "simulate": "Predict with a saved model from the end of a measured history.",
    "check": "Check saved models on a record: fit, residuals, stability.",
    "export": "Export a saved model as C, FMU, ONNX or CasADi.",
    "methods": "List the methods and what each needs.",
    "data": "List or download the public records.",
    "doctor": "Check that this machine has what the package needs.",
}
"""A line about each command; the module of the same name is imported when the command runs."""


def _nothing(*_: Any, **__: Any) -> None:
    """Stand for a type that the help does not show."""


class Plain:
    """A command whose help shows neither the types of switches nor ranges of numbers."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, described plainly."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for each in parameters:
            each._get_number_range_help_str = _nothing
            if each.param_type_name == "argument" or each.is_flag:
                each.display_type_rich = _nothing
        return parameters


class LockedCommand(Plain, typer.core.TyperCommand):
    """A command that runs only if its --out replaces no input and is not in use."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; bad input is told with its options in place of arguments' names."""
        from splitband.cli import output  # noqa: PLC0415  which loads what commands need

        try:
            with output.claimed(ctx):
                return super().invoke(ctx)
        except EXPECTED as error:
            options = {p.name: p.opts[0] for p in self.params if p.param_type_name == "option"}
            raise TyperException(in_words(error, options)) from error


class Commands(Plain, TyperGroup):
    """The commands, listed without importing their modules: importing torch takes seconds."""

    listing = False

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands, in the order in which a new user needs them."""
        return [*COMMANDS]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for the list of commands, a placeholder with its name and line."""
        if cmd_name not in COMMANDS:
            return None
        if self.listing:
            return typer.core.TyperCommand(cmd_name, help=COMMANDS[cmd_name])
        command = getattr(import_module(f"splitband.cli.{cmd_name}"), cmd_name)
        alone = typer.Typer(add_completion=False, rich_markup_mode="markdown")
        alone.command(cmd_name, cls=LockedCommand)(command)
        return typer.main.get_command(alone)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands, without loading them."""
        self.listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self.listing = False


QUIET, JSON, VERBOSE = "--quiet", "--json", "--verbose"
"""Options of every command, accepted before and after its name."""


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"splitband {__version__}")
        raise typer.Exit


app = typer.Typer(
    name="splitband",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


@app.callback(
    help="Learn a dynamic model from measured data. Its simulations stay accurate over short and "
    "long horizons.\n\n"
    "Exit status: 0 done, 2 bad input, 130 stopped by Ctrl-C. Please report any other as a defect."
)
def splitband(
    context: typer.Context,
    quiet: Annotated[bool, typer.Option(QUIET, help="Print only warnings and errors.")] = False,
    json: Annotated[bool, typer.Option(JSON, help="Print results as JSON only.")] = False,
    verbose: Annotated[
        bool, typer.Option(VERBOSE, help="Also print reasons and details of each fit.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version)
    ] = False,
) -> None:
    """Set what holds for every command."""
    from splitband.cli import printing  # noqa: PLC0415  which loads what commands need

    context.with_resource(printing.saying(quiet, json, verbose))


INTERRUPTED = 130
"""Exit status after Ctrl-C: the convention of shells, and what typer returns."""


def main(arguments: Sequence[str] | None = None, began: float | None = None) -> int:
    """Run the command line; report bad input in one line on stderr, with exit status 2.

    `began`: when the process did, by `time.time`; by default now.
    """
    clock.begin(began)
    if arguments is None:  # SIGTERM, which ends batch jobs, is handled like Ctrl-C
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        _print_anything()
        arguments = expanded(sys.argv[1:])
    given = _global_first(arguments)
    try:
        status = typer.main.get_command(app).main(
            given, prog_name="splitband", standalone_mode=False
        )
    except TyperException as error:
        # Without a command typer has printed the help, and its message is empty.
        nothing = f"a command must be given: {' '.join(['splitband', *given])} COMMAND"
        said = error.format_message().strip()
        return _complain((said or nothing) + _value(error, given))
    except EXPECTED as error:
        return _complain(in_words(error))
    if status == INTERRUPTED:
        _complain("stopped; no file is half written")
    return status if isinstance(status, int) else 0


def _print_anything() -> None:
    """Print "?" for a sign that the encoding of a stream lacks, such as a Greek letter."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def _global_first(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with the options of every command moved to the front."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    of_all = (QUIET, JSON, VERBOSE)
    own = [word for word in arguments[:end] if word in of_all]
    rest = [word for word in arguments[:end] if word not in of_all]
    return [*own, *rest, *arguments[end:]]


def _value(error: TyperException, given: Sequence[str]) -> str:
    """Return ", got VALUE" for the option that an error is about; empty if there is none."""
    names = error.param.opts if isinstance(error, typer.BadParameter) and error.param else []
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


EXPECTED = (InputError, OSError, FloatingPointError, MemoryError, OverflowError)
"""Exceptions that bad input raises; any other is a defect of the package, with a traceback."""


def in_words(error: Exception, options: Mapping[str, str] | None = None) -> str:
    """Return an error's message in one line, with `options` in place of names of arguments."""
    said = " ".join(str(error).split())
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        said = f"{error.strerror}: {error.filename}"
    name, rule, rest = said.partition(" ")
    if rest.startswith(("must ", "needs ")):
        names = options or {}
        name = names.get(name) or names.get(name.removesuffix("s"), name)
    said = f"{name}{rule}{rest}"
    if isinstance(error, MemoryError | OverflowError):
        return f"a number is too large for this machine: {said}"
    return said
