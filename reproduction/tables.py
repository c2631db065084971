"""The paper's tables, made of finished runs: ours beside the published values."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reproduction.jobs import ORACLE, SYSTEMS, Job
from reproduction.runs import (
    FEWEST_SEEDS,
    final_losses,
    finished,
    load,
    load_known,
    parts_rmse,
    training_seconds,
    unversioned,
    whole_rmse,
)
from reproduction.specs import SPECS, TITLES, Line, Spec
from splitband.comparison.methods import QUICK

SETTLED_SHARE = 0.9
"""A training loss has settled where at least twice the epochs leave so much of it."""


@dataclass(frozen=True)
class Table:
    """Text in rows, and the numbers behind it."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    facts: tuple[dict[str, Any], ...]

    @property
    def words(self) -> int:
        """How many columns are words: those up to the method."""
        return self.header.index("method") + 1

    def markdown(self) -> str:
        """For a document."""
        rule = ["---"] * self.words + ["---:"] * (len(self.header) - self.words)
        lines = [self.header, rule, *self.rows]
        body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"**{self.title}**\n\n{body}\n"


def table(name: str, of: Iterable[Line], folder: Path) -> Table:
    """Make a table of the runs in `folder`; raises what `load` does.

    A row whose jobs leave the epochs to the paper, but have not all been run, is made of those that
    have, see `finished`; its last columns say how many seeds and epochs these are. A table over
    epochs shows what has been run so far.
    """
    spec = SPECS[name]
    facts = [_facts(spec, line, folder) for line in of]
    if spec.shows == "losses":
        facts = [row | {"settled": settles(row, facts)} for row in facts]
    header, cells = _COLUMNS[spec.shows]
    own = spec.varied and spec.shows != "quantiles"
    rows = [
        (f"({f['system']})", *([f"{f['value']:g}"] if own else []), f["method"], *cells(f))
        for f in facts
    ]
    first = ("system", *([spec.varied] if own else []), "method")
    return Table(TITLES[name], (*first, *header), tuple(rows), tuple(facts))


def settles(row: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> bool | None:
    """Whether the row of the same method with the next more epochs has as low a training loss.

    That is `SETTLED_SHARE` of it at least, for every network; the loss is the median of
    `final_losses` over seeds. None for the row with the most epochs, and for one without runs.
    """
    alike = [other for other in rows if other["method"] == row["method"] and other["losses"]]
    more = [other for other in alike if other["epochs"] > row["epochs"]]
    if not more or not row["losses"]:
        return None
    longer = min(more, key=lambda other: other["epochs"])["losses"]
    return all(
        statistics.median(longer[name]) >= SETTLED_SHARE * statistics.median(losses)
        for name, losses in row["losses"].items()
    )


def _facts(spec: Spec, line: Line, folder: Path) -> dict[str, Any]:
    fewest = len(line.jobs) if spec.shows == "quantiles" else FEWEST_SEEDS
    jobs = finished(line.jobs, folder, fewest)
    if spec.shows == "losses":
        jobs = [job for job in jobs if (folder / job.path).exists()]
    first = (jobs or line.jobs)[0]
    runs = [load(job, folder) for job in jobs]
    good = [(job, run) for job, run in zip(jobs, runs, strict=True) if "diverged" not in run]
    timed = [(training_seconds(run), load_known(run)) for _, run in good]
    known = spec.published.get(line.system if line.value is None else line.value, {}).get(
        line.method
    )
    if not spec.varied and (first.cutoff or first.downsampling):
        known = None  # the paper has no such run
    losses = [final_losses(run) for _, run in good]
    fixed = line.method in (*QUICK, ORACLE)
    return {
        "system": line.system,
        "title": SYSTEMS[line.system].title,
        "method": line.method,
        "value": line.value,
        "total_rmse": [run["total_rmse"] for _, run in good],
        "forecast_rmse": [run["forecast_rmse"] for _, run in good],
        "whole_rmse": [whole_rmse(run, job) for job, run in good] if not spec.varied else [],
        "sliced_rmse": [run["sliced_rmse"] for _, run in good if "sliced_rmse" in run],
        "parts_rmse": parts_rmse(runs[0], jobs[0]) if good and not spec.varied else {},
        "losses": {name: [each[name] for each in losses] for name in (losses or [{}])[0]},
        "seconds": [seconds for seconds, _ in timed if seconds is not None],
        "seconds_unsure": not all(known for seconds, known in timed if seconds is not None),
        "runs": len(runs),
        "unversioned": sum(unversioned(run) for _, run in good),
        "asked": len(line.jobs),
        "diverged": len(runs) - len(good),
        "epochs": None if fixed else first.epochs or first.full_epochs,
        "paper_epochs": first.full_epochs,
        "paper": None if known is None else {"mean": known.mean, "std": known.std},
        "paper_text": "" if known is None else str(known),
        "oracle": _oracle(line, folder) if spec.shows == "quantiles" else None,
    }


def _oracle(line: Line, folder: Path) -> float:
    """The median of the oracle on the same draws."""
    return statistics.median(
        load(Job(job.system, ORACLE, draw=job.draw), folder)["total_rmse"] for job in line.jobs
    )


def _error_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    total, forecast = (spread(facts[name]) for name in ("total_rmse", "forecast_rmse"))
    sliced = spread(facts["sliced_rmse"]) if facts["sliced_rmse"] else ""
    paper = facts["paper_text"], _ratio(facts, "total_rmse")
    return (total, sliced, *paper, forecast, _seeds(facts), epochs(facts))


def _whole_error_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    total, _, *others = _error_cells(facts)
    return (total, spread(facts["whole_rmse"]), *others)


def _loss_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    if not facts["runs"]:
        return ("not run", "", "", "", _seeds(facts))
    losses = [f"{name} {statistics.median(values):.3f}" for name, values in facts["losses"].items()]
    settled = {None: "", True: "yes", False: "no"}[facts["settled"]]
    errors = spread(facts["total_rmse"]), spread(facts["forecast_rmse"])
    return (*errors, ", ".join(losses), settled, _seeds(facts))


def _seconds_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    """Of fewer epochs, the seconds are those of as many as the paper's."""
    counted = len(facts["seconds"])
    runs = f"{counted} of {facts['asked']}" + (", load unknown" if facts["seconds_unsure"] else "")
    if not counted:
        return ("-", facts["paper_text"], "", runs, epochs(facts))
    ours = full_seconds(facts)
    ratio = f"{facts['paper']['mean'] / ours:.2g}"
    return (f"{ours:.1f}", facts["paper_text"], ratio, runs, epochs(facts))


def _quantile_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    values = facts["total_rmse"]
    shown = [*np.quantile(values, (0.5, 0.1, 0.9, 1.0)), np.mean(values)]
    ratio = f"{shown[0] / facts['oracle']:.2f}"
    return (*(f"{v:.3f}" for v in shown), facts["paper_text"], ratio, epochs(facts))


_Cells = Callable[[dict[str, Any]], tuple[str, ...]]
_ERRORS = ("ours", "sliced", "paper", "ours / paper", "forecast", "seeds", "epochs")
_QUANTILES = ("median", "10 %", "90 %", "worst", "mean")
_COLUMNS: dict[str, tuple[tuple[str, ...], _Cells]] = {
    "errors": (_ERRORS, _error_cells),
    "whole errors": (("ours", "with warm-up", *_ERRORS[2:]), _whole_error_cells),
    "losses": (("ours", "forecast", "training loss", "settled", "seeds"), _loss_cells),
    "quantiles": ((*_QUANTILES, "paper, one draw", "median / oracle's", "epochs"), _quantile_cells),
    "seconds": (("ours (s)", "paper (s)", "paper / ours", "runs", "epochs run"), _seconds_cells),
}


def full_seconds(facts: Mapping[str, Any]) -> float:
    """The median over the runs of a row, of as many epochs as the paper's."""
    return statistics.median(facts["seconds"]) * facts["paper_epochs"] / facts["epochs"]


def spread(values: Sequence[float]) -> str:
    """Mean and, in brackets, standard deviation over seeds."""
    if not values:
        return "diverged"
    mean = statistics.mean(values)
    text = f"{mean:.3f}" if mean < 1e3 else f"{mean:.3g}"
    return text if len(values) == 1 else f"{text} ({statistics.stdev(values):.2g})"


def _seeds(facts: dict[str, Any]) -> str:
    if facts["epochs"] is None:
        return ""
    short = f" of {facts['asked']}" if facts["runs"] != facts["asked"] else ""
    lost = f", {facts['diverged']} diverged" if facts["diverged"] else ""
    return f"{facts['runs']}{short}{lost}"


def epochs(facts: Mapping[str, Any]) -> str:
    """How many were run, and of how many where the paper has others."""
    if facts["epochs"] is None:
        return ""
    short = facts["epochs"] != facts["paper_epochs"]
    return f"{facts['epochs']}" + (f" of {facts['paper_epochs']}" if short else "")


def _ratio(facts: dict[str, Any], name: str) -> str:
    if facts["paper"] is None or not facts[name]:
        return ""
    return f"{statistics.mean(facts[name]) / facts['paper']['mean']:.2g}"
