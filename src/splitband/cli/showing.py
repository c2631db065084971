"""Tables and progress bars for people."""

from __future__ import annotations

import statistics
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from splitband.evaluation.comparison import Comparison
from splitband.evaluation.protocols import Run, Runs, by_channel
from splitband.evaluation.runs import RunProgress
from splitband.metrics import Extrapolation, ExtrapolationWarning, leaving, spread
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


def comparison(title: str, result: Comparison) -> Table:
    """Errors by method, mean and standard deviation over seeds; the lowest of each is bold.

    What could not be fitted comes last, without numbers.
    """
    runs, trial = result.runs, result.require_trial()
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("method", min_width=max(map(len, [*runs, *trial.failed])))
    ahead = any(run.forecast is not None for of_method in runs.values() for run in of_method)
    tests = [_tested(test.name, i) for i, test in enumerate(result.tests)]
    forecast = ["changed", "from the start", "forecast", "in interval"]
    headings = ["held out", *(forecast if ahead else ["from the start"]), *tests, "fit (s)"]
    for heading in headings:
        table.add_column(heading, justify="right")
    table.add_column("", style="dim")
    first = min(trial.errors[name] for name in runs)
    steadiest = min(trial.change(name) for name in runs)
    best = [
        min(statistics.mean(values(r)) for r in runs.values()) for values in (_total, _forecast)
    ]
    best_tests = [
        min((mean.errors.tests[i] for mean in result.means.values() if mean.tests), default=0.0)
        for i in range(len(tests))
    ]
    for name, of_method in runs.items():
        total, forecast_error = (
            _spread(values(of_method), lowest)
            for values, lowest in zip((_total, _forecast), best, strict=True)
        )
        cells: list[str | Text] = [total]
        if ahead:
            covers = f"{result.covers(name):.0%}"
            cells = [_spread([trial.change(name)], steadiest), total, forecast_error, covers]
        # Tests are of the mean over seeds, as that is the prediction that users get.
        cells += [
            _spread([error], lowest)
            for error, lowest in zip(result.means[name].errors.tests, best_tests, strict=False)
        ] or ["-"] * len(tests)
        table.add_row(
            name,
            _spread([trial.errors[name]], first),
            *cells,
            f"{statistics.mean(r.fit.seconds for r in of_method):.1f}",
            _remarks(result, name),
        )
    for name, reason in trial.failed.items():
        table.add_row(name, *["-"] * len(headings), f"could not be fitted: {reason}")
    return table


def _tested(name: str, i: int) -> str:
    """The heading of a test record's errors."""
    return f"test: {name or i + 1}"


def _remarks(result: Comparison, name: str) -> str:
    """What a row says beside its numbers."""
    runs, mean = result.runs[name], result.means[name]
    said = [runs[0].description]
    if len(runs) > 1 and runs[0].fit.losses:
        errors = (
            [mean.total_rmse] if mean.forecast is None else [mean.total_rmse, mean.forecast_rmse]
        )
        said.insert(0, f"their mean {', '.join(f'{error:.3f}' for error in errors)}")
    left = [run.leaves for run in runs if run.leaves is not None]
    if left:
        said.insert(0, leaving(min(left)))
    return "; ".join(filter(None, said))


def channels(result: Comparison, name: str) -> str:
    """The errors of a method's mean, each channel by itself, as channels may differ in unit."""
    record, mean = result.record, result.means[name]
    each = [by_channel(record, mean.from_start.y)]
    if mean.forecast is not None:
        each.append(by_channel(record, mean.forecast.y))
    deviations = spread(record.seen[: result.setup.train])
    parts = [
        f"{column} {' and '.join(f'{e:.3g}' for e in errors)} (its deviation is {deviation:.3g})"
        for column, deviation, *errors in zip(record.columns, deviations, *each, strict=True)
    ]
    what = "from the start" + (" and of the forecast" if mean.forecast is not None else "")
    return f"RMSE {what}, by channel: " + "; ".join(parts)


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


def _total(runs: Sequence[Run]) -> list[float]:
    return [r.total_rmse for r in runs]


def _forecast(runs: Sequence[Run]) -> list[float]:
    return [r.forecast_rmse for r in runs]


def _spread(values: Sequence[float], lowest: float) -> Text:
    mean = statistics.mean(values)
    text = f"{mean:.3g}" if mean >= 1e3 else f"{mean:.3f}" if mean >= 0.01 else f"{mean:.2e}"
    if len(set(values)) > 1:
        text += f" ± {statistics.stdev(values):.2g}"
    return Text(text, style="bold" if mean == lowest else "")


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
