"""The paper's tables, made of finished runs: ours beside the published values."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitband.methods import FIXED
from splitband.paper import published
from splitband.paper.published import Row
from splitband.paper.runs import ORACLE, SYSTEMS, Job, finished, load

_NAIVE = ("persistence", "seasonal-naive", "harmonic")
_GRU = ("gru", "split-gru", "split-gru-hp")
DRAWS = 20


@dataclass(frozen=True)
class Spec:
    """What a table is made of.

    Attributes
    ----------
    title : Says which of the paper's tables it is.
    systems, methods : In the order of their rows; a method stays out where it makes no sense.
    published : The paper's values by system, or by the value that is varied.
    seconds : Whether the table is of run times.
    varied : The field of a job that an ablation varies, over `values`.
    quantiles : Show the spread over noise draws in place of mean and standard deviation.
    """

    title: str
    systems: tuple[str, ...]
    methods: tuple[str, ...]
    published: Mapping[Any, Row]
    seconds: bool = False
    varied: str = ""
    values: tuple[float, ...] = ()
    quantiles: bool = False


SPECS = {
    "learning-based": Spec(
        "Table 1: total RMSE, learned from the record alone",
        ("i", "ii", "iii", "iv"), (*_GRU, *_NAIVE, ORACLE), published.LEARNING_BASED,
    ),
    "hybrid-rnn": Spec(
        "Table 2: total RMSE, hybrid models with the RNN",
        ("v", "vi"),
        ("rnn", "residual-rnn", "simulator", "filtered-rnn", "simulator-affine", *_NAIVE),
        published.HYBRID_RNN,
    ),
    "hybrid-gru": Spec(
        "Table 3: total RMSE, hybrid models with the GRU",
        ("v", "vi"),
        ("gru", "residual-gru", "simulator", "filtered-gru", "simulator-affine", *_NAIVE),
        published.HYBRID_GRU,
    ),
    "pendulum": Spec(
        "Rows (ii) to (iv) on the simulated pendulum, each with its own excitation",
        ("ii-simulated", "iii-simulated", "iv-simulated"), (*_GRU, *_NAIVE), {},
    ),
    "noise-draws": Spec(
        f"System (i) over {DRAWS} noise draws, one seed each",
        ("i",), (*_GRU, *_NAIVE[1:], ORACLE), published.LEARNING_BASED,
        varied="draw", values=tuple(range(DRAWS)), quantiles=True,
    ),
    "cutoff": Spec(
        "Ablation of the cut-off w on system (i), k = 2",
        ("i",), _GRU[1:], published.CUTOFF, varied="cutoff", values=(0.2, 0.4, 0.5),
    ),
    "downsampling": Spec(
        "Ablation of the down-sampling k on system (i), w = 0.4",
        ("i",), _GRU[1:], published.DOWNSAMPLING, varied="downsampling", values=(2, 3, 4, 5, 10),
    ),
    "runtime-learning-based": Spec(
        "Run times in seconds, learned from the record alone",
        ("i", "ii", "iii", "iv"), _GRU, published.SECONDS, seconds=True,
    ),
    "runtime-hybrid-rnn": Spec(
        "Run times in seconds, hybrid models with the RNN",
        ("v", "vi"), ("rnn", "residual-rnn", "filtered-rnn"), published.SECONDS_RNN, seconds=True,
    ),
    "runtime-hybrid-gru": Spec(
        "Run times in seconds, hybrid models with the GRU",
        ("v", "vi"), ("gru", "residual-gru", "filtered-gru"), published.SECONDS_GRU, seconds=True,
    ),
}  # fmt: skip
"""By the name that the command line takes."""


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


@dataclass(frozen=True)
class Line:
    """A row of a table: one method on one system, and its runs."""

    system: str
    method: str
    value: float | None
    jobs: tuple[Job, ...]


def lines(
    name: str,
    systems: Sequence[str] | None = None,
    methods: Sequence[str] | None = None,
    seeds: int = 5,
    epochs: int | None = None,
) -> list[Line]:
    """The rows of a table with the jobs that they need."""
    spec = SPECS[name]
    found = []
    for system in chosen("systems", systems, spec.systems):
        for value in spec.values if spec.varied and not spec.quantiles else (None,):
            for method in chosen("methods", methods, spec.methods):
                if method == ORACLE and system != "i":
                    continue
                repeated = 1 if method in (*FIXED, ORACLE) else seeds
                if spec.quantiles:
                    jobs = [Job(system, method, 0, int(d), epochs=epochs) for d in spec.values]
                else:
                    change: dict[str, Any] = {spec.varied: value} if spec.varied else {}
                    jobs = [
                        Job(system, method, s, epochs=epochs, **change) for s in range(repeated)
                    ]
                found.append(Line(system, method, value, tuple(jobs)))
    return found


def table(name: str, of: Iterable[Line], folder: Path) -> Table:
    """Make a table of the runs in `folder`; raises what `load` does.

    A row whose jobs leave the epochs to the paper, but have not all been run, is made of the runs
    with the most epochs of which there are as many.
    """
    spec = SPECS[name]
    facts = [_facts(spec, line, folder) for line in of]
    header: tuple[str, ...]
    if spec.quantiles:
        header, cells = _QUANTILES, _quantile_cells
    elif spec.seconds:
        header, cells = _SECONDS, _seconds_cells
    else:
        header, cells = _ERRORS, _error_cells
    first = ("system", *((spec.varied,) if spec.varied and not spec.quantiles else ()), "method")
    rows = [
        (f"({f['system']})", *([f"{f['value']:g}"] if len(first) == 3 else []),
         f["method"], *cells(f))
        for f in facts
    ]  # fmt: skip
    return Table(spec.title, (*first, *header), tuple(rows), tuple(facts))


_ERRORS = ("ours", "paper", "ours / paper", "forecast", "seeds", "epochs")
_SECONDS = ("ours (s)", "paper (s)", "paper / ours", "seeds", "epochs run")
_QUANTILES = ("median", "10 %", "90 %", "worst", "mean", "paper, one draw", "median / oracle's")


def chosen(what: str, given: Sequence[str] | None, possible: Iterable[str]) -> list[str]:
    """The names that were asked for, or all."""
    possible = list(possible)
    unknown = [name for name in given or () if name not in possible]
    if unknown:
        raise ValueError(f"{what} must be out of {', '.join(possible)}, got {', '.join(unknown)}")
    return possible if given is None else list(given)


def _facts(spec: Spec, line: Line, folder: Path) -> dict[str, Any]:
    jobs = finished(line.jobs, folder)
    runs = [load(job, folder) for job in jobs]
    good = [run for run in runs if "diverged" not in run]
    paper = spec.published.get(line.system if line.value is None else line.value, {})
    known = paper.get(line.method)
    column = SYSTEMS[line.system].column
    usual = column.epochs_of(line.method)
    return {
        "system": line.system,
        "title": SYSTEMS[line.system].title,
        "method": line.method,
        "value": line.value,
        "total_rmse": [run["total_rmse"] for run in good],
        "forecast_rmse": [run["forecast_rmse"] for run in good],
        "seconds": [run["seconds"] for run in good],
        "runs": len(runs),
        "diverged": len(runs) - len(good),
        "epochs": None if line.method in (*FIXED, ORACLE) else jobs[0].epochs or usual,
        "paper_epochs": usual,
        "paper": None if known is None else {"mean": known.mean, "std": known.std},
        "paper_text": "" if known is None else str(known),
        "oracle": _oracle(line, folder) if spec.quantiles else None,
    }


def _oracle(line: Line, folder: Path) -> float:
    """The median of the oracle on the same draws."""
    return statistics.median(
        load(Job(job.system, ORACLE, draw=job.draw), folder)["total_rmse"] for job in line.jobs
    )


def _error_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    total, forecast = (_spread(facts[name]) for name in ("total_rmse", "forecast_rmse"))
    return (total, facts["paper_text"], _ratio(facts, "total_rmse", _ours_over_paper), forecast,
            _seeds(facts), _epochs(facts))  # fmt: skip


def _seconds_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    """Of fewer epochs, the ratio is that of as many as the paper's."""
    more = facts["paper_epochs"] / facts["epochs"]
    facts = facts | {"seconds": [more * seconds for seconds in facts["seconds"]]}
    ours = f"{statistics.mean(facts['seconds']):.1f}" if facts["seconds"] else "-"
    return (ours, facts["paper_text"], _ratio(facts, "seconds", _paper_over_ours),
            _seeds(facts), _epochs(facts))  # fmt: skip


def _quantile_cells(facts: dict[str, Any]) -> tuple[str, ...]:
    values = facts["total_rmse"]
    shown = [*np.quantile(values, (0.5, 0.1, 0.9, 1.0)), np.mean(values)]
    ratio = f"{shown[0] / facts['oracle']:.2f}"
    return (*(f"{v:.3f}" for v in shown), facts["paper_text"], ratio)


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "diverged"
    mean = statistics.mean(values)
    text = f"{mean:.3f}" if mean < 1e3 else f"{mean:.3g}"
    return text if len(values) == 1 else f"{text} ({statistics.stdev(values):.2g})"


def _seeds(facts: dict[str, Any]) -> str:
    if facts["epochs"] is None:
        return ""
    lost = f", {facts['diverged']} diverged" if facts["diverged"] else ""
    return f"{facts['runs']}{lost}"


def _epochs(facts: dict[str, Any]) -> str:
    if facts["epochs"] is None:
        return ""
    short = facts["epochs"] != facts["paper_epochs"]
    return f"{facts['epochs']}" + (f" of {facts['paper_epochs']}" if short else "")


def _ratio(facts: dict[str, Any], name: str, of: Callable[[float, float], float]) -> str:
    if facts["paper"] is None or not facts[name]:
        return ""
    return f"{of(statistics.mean(facts[name]), facts['paper']['mean']):.2g}"


def _ours_over_paper(ours: float, paper: float) -> float:
    return ours / paper


def _paper_over_ours(ours: float, paper: float) -> float:
    return paper / max(ours, 1e-9)
