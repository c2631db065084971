"""Run a plan: where its trainings run, and what is shown of it meanwhile."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from splitband.cli import clock, showing
from splitband.evaluation.clock import Clock
from splitband.evaluation.plan import Plan
from splitband.evaluation.run import Run
from splitband.report import results
from splitband.report.table import of_trial
from splitband.runtime.errors import InputError, missing
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.system import available_cores


class Display:
    """Show where a comparison stands, and keep its best model so far in OUT, if there are `facts`.

    In a terminal the table and a line below it change in place; elsewhere there is a line for each
    round. `facts` are the command and its options, for results.json.
    """

    def __init__(self, out: Path, facts: dict[str, Any] | None) -> None:
        self._out, self._facts, self._table = out, facts, Table()
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
        if state.new_table and state.clock.left:
            self._write(state)

    def _write(self, state: Run) -> None:
        """Write the whole result of the baselines, or the best model so far."""
        if self._facts is None:
            return
        began, loading = state.clock.used, state.clock.writing
        try:
            if state.finals and not self._written:
                self._written = True
                facts = self._facts | {"unfinished": state.doing}
                results.save(state.comparison(), self._out, facts)
                # The last one has more methods in it, and loads what runs the model.
                state.clock.writing = loading + state.clock.used - began
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
def running(plan: Plan, out: Path, facts: dict[str, Any] | None = None) -> Iterator[Any]:
    """Yield the arguments of `run` that show a comparison and keep its finished trainings."""
    kept = out / CHECKPOINTS
    found = len([path for path in kept.glob("*.safetensors") if path.name[0] != "."])
    if found:
        showing.console.print(f"going on: {found} finished training{'s' if found > 1 else ''} kept")
    display = Display(out, facts)
    time = Clock(plan.budget, clock.began())
    time.writing = time.used  # loading the libraries of pages takes about as long as these
    with display.shown():
        yield {"folder": kept, "watch": display, "clock": time}


@contextmanager
def workers(jobs: int | None, cluster: str | None = None) -> Iterator[dict[str, Any]]:
    """Yield the arguments of `run` that say where trainings run, as --jobs and --cluster ask."""
    if cluster is None:
        yield {"cores": jobs or available_cores()}
        return
    if jobs is not None:
        raise InputError(
            f"--jobs must be left out with --cluster, where each thread has one, got {jobs}"
        )
    try:
        from distributed import Client, KilledWorker  # noqa: PLC0415  an extra
        from distributed.client import ClosedClientError  # noqa: PLC0415
    except ImportError:
        raise missing("--cluster", "Dask", "cluster") from None
    try:
        client = Client(cluster, timeout=5, set_as_default=False)
    except (OSError, TimeoutError, ValueError):
        raise InputError(
            "--cluster must be the address of a Dask scheduler that answers, such as "
            f"tcp://10.0.0.5:8786, got {cluster}"
        ) from None
    with client:
        if not client.nthreads():
            showing.console.print(f"waiting for a worker of {cluster}; Ctrl-C stops")
        client.wait_for_workers(1)
        try:
            client.get_versions(check=True)
        except ValueError as error:
            raise InputError(f"--cluster must run the versions that are here: {error}") from None
        cores = sum(client.nthreads().values())
        try:
            yield {"cores": max(cores, 1), "executor": client.get_executor(pure=False)}
        except (KilledWorker, ClosedClientError, CancelledError):
            raise InputError(
                "--cluster must be there until the end (the same command goes on from what is "
                f"finished), the scheduler or the workers are gone, got {cluster}"
            ) from None
