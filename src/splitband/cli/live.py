"""Show a comparison while it runs: a table after every round, and where it stands."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from splitband.cli import clock, showing
from splitband.cli.usage import usage
from splitband.evaluation.clock import Clock
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.plan import Plan
from splitband.evaluation.run import Run, run
from splitband.report import results
from splitband.report.page.parts import Usage
from splitband.report.table import of_trial
from splitband.runtime.files import CHECKPOINTS


class Display:
    """Show where a comparison stands, and keep its best model so far in OUT.

    In a terminal the table and a line below it change in place; elsewhere there is a line for each
    round.

    Parameters
    ----------
    out : Folder of the results; None to write nothing before the end.
    facts : Command and options, for results.json.
    """

    def __init__(self, out: Path | None, facts: Mapping[str, Any]) -> None:
        self._out, self._facts, self._table = out, {**facts}, Table()
        self._written = False
        self._in_place = sys.stdout.isatty() and not showing.console.quiet
        console = Console() if self._in_place else showing.console
        self._live = Live(console=console, transient=True, auto_refresh=False)

    @contextmanager
    def shown(self) -> Iterator[Display]:
        """Show it in this context; what was changed in place is removed at the end."""
        if not self._in_place:
            yield self
            return
        with self._live:
            yield self

    def __call__(self, state: Run) -> None:
        """Take note of where the comparison stands."""
        if self._in_place:
            if state.new_table:
                record = state.plan.record
                table = of_trial(state.trial, record, f"{record.name}: held-out errors so far")
                self._table, _ = table.fitting(showing.console.width)
            self._live.update(Group(self._table, Text(in_words(state))), refresh=True)
        elif state.new_table:
            showing.console.print(in_words(state))
        if state.new_table:
            self._write(state)

    def _write(self, state: Run) -> None:
        """Write the whole result of the baselines, or the best model so far."""
        if self._out is None:
            return
        began = state.clock.used
        try:
            if state.finals and not self._written:
                self._written = True
                facts = self._facts | {"unfinished": state.doing}
                results.save(state.comparison(), self._out, facts)
                state.clock.writing = state.clock.used - began
            else:
                results.save_unfinished(state, self._out, self._facts)
        except OSError as error:  # what was there before is still there
            showing.warn(f"{self._out} could not be written: {error}")


def in_words(state: Run) -> str:
    """Return what is done, the best method so far and the time left, in a line."""
    said = [state.doing]
    if state.trials:
        trial = state.trial
        best = trial.recommended
        said.append(f"best so far: {best}, held-out score {trial.penalized_score(best):.3g}")
    if state.clock.limit is not None:
        said.append(f"{state.clock.left:.0f} s left")
    return "; ".join(said)


@contextmanager
def running(plan: Plan, out: Path, facts: Mapping[str, Any], partly: bool) -> Iterator[Any]:
    """Yield the arguments of `run` that show a comparison and keep its finished trainings."""
    kept = out / CHECKPOINTS
    found = len([path for path in kept.glob("*.safetensors") if path.name[0] != "."])
    if found:
        showing.console.print(f"going on: {found} finished training{'s' if found > 1 else ''} kept")
    display = Display(out if partly else None, facts)
    time = Clock(plan.budget, clock.began())
    time.writing = time.used  # loading the libraries of pages takes about as long as these
    with display.shown():
        yield {"folder": kept, "watch": display, "clock": time}


def compared(
    plan: Plan, where: Mapping[str, Any], out: Path, facts: Mapping[str, Any]
) -> Comparison:
    """Run a planned comparison, and show it while it runs."""
    with running(plan, out, facts, partly=True) as how:
        return run(plan, **where, **how)


def save(comparison: Comparison, out: Path, facts: Mapping[str, Any]) -> Usage:
    """Write the results, `facts` first, and remove the finished trainings; return the usage.

    The usage is the commands that use the recommended method, built from the options in `facts`.
    """
    plan = replace(comparison.plan, refit=comparison.refit is not None)
    used = usage(facts["command"], facts["arguments"], out, plan, comparison.model)
    results.save(comparison, out, dict(facts), used)
    if not comparison.interrupted:
        shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
    return used
