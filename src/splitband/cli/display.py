"""Run a plan: where its trainings run, and what is shown of it meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from splitband.cli import clock, printing
from splitband.cli.usage import usage
from splitband.comparison.clock import Clock
from splitband.comparison.plan import Plan
from splitband.comparison.running import RunningComparison
from splitband.report import results
from splitband.report.tables import of_trial
from splitband.runtime.errors import InputError, missing
from splitband.runtime.progress import in_place
from splitband.runtime.system import available_cores


class Display:
    """A display of a running comparison, which keeps its best model so far in OUT, given `facts`.

    In a terminal a line, each second with the time left, and the table below it change in place;
    elsewhere there is a line for each round. `facts` are the command and its options, for
    results.json.
    """

    def __init__(self, out: Path, facts: dict[str, Any] | None, clock: Clock) -> None:
        self._out, self._facts, self._table = out, facts, Group()
        self._said, self._clock = "fitting simple models", clock
        self._written = False
        self._in_place = in_place() and not printing.console.quiet
        console = Console(markup=False, emoji=False) if self._in_place else printing.console
        self._live = Live(
            console=console, transient=True, refresh_per_second=1, get_renderable=self._now
        )

    @contextmanager
    def shown(self) -> Iterator[Display]:
        """Show it in this context; what was changed in place is removed at the end."""
        if not self._in_place:
            printing.console.print(self._said)
            yield self
            return
        with self._live:
            yield self

    def _now(self) -> Group:
        """Return what is shown now; a thread calls it, so that nothing is computed here."""
        return Group(Text(f"{self._clock.left_in_words()}; {self._said}"), self._table)

    def __call__(self, state: RunningComparison) -> None:
        """Take note of where the comparison stands."""
        self._said = state.in_words()
        if self._in_place:
            if state.new_table:
                record = state.plan.record
                title = f"{record.name}: held-out errors so far"
                table = of_trial(state.trial, record, state.methods, title)
                self._table = Group(Text(title, "bold"), table.drawn(printing.verbose()))
            self._live.refresh()
        elif state.new_table:
            printing.console.print(str(state))
        # The whole result once, which takes its time, after workers were given their trainings.
        whole = bool(state.finals) and not (state.new_table or self._written)
        whole &= state.clock.allows_pages
        if (state.new_table or whole) and state.clock.left:
            self._write(state, whole)

    def _write(self, state: RunningComparison, whole: bool) -> None:
        """Write the whole result of the baselines, or the best model so far."""
        if self._facts is None:
            return
        try:
            if whole:
                self._written = True
                found, facts = state.comparison(), self._facts | {"unfinished": state.doing}
                asked = facts["command"], facts["arguments"], self._out
                results.save(found, self._out, facts, usage(*asked, state.plan, found.model))
                if (cores := state.clock.cores) > 1:  # workers trained meanwhile, unlike later
                    state.clock.writing *= cores / (cores + 1)
            else:
                results.save_unfinished(state, self._out, self._facts)
        except OSError as error:  # what was there before is still there
            printing.warn(f"{self._out} could not be written: {error}")


@contextmanager
def running(plan: Plan, out: Path, facts: dict[str, Any] | None = None) -> Iterator[Any]:
    """Yield the arguments of `run` that show a comparison and keep its best model so far."""
    time = Clock(plan.budget, clock.began())
    time.writing = time.used  # loading the libraries of pages takes about as long as these
    display = Display(out, facts, time)
    with display.shown():
        yield {"watch": display, "clock": time}


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
            printing.console.print(f"waiting for a worker of {cluster} (Ctrl-C stops)")
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
                "--cluster must be there until the end: the scheduler or the workers are gone, got "
                f"{cluster}"
            ) from None
