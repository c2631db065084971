"""What each of the paper's tables is made of, and the runs that its rows need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from reproduction import published
from reproduction.jobs import ORACLE, Job
from reproduction.published import Row
from splitband.comparison.methods import QUICK

_NAIVE = ("persistence", "seasonal-naive", "harmonic")
_GRU = ("gru", "split-gru", "split-gru-hp")
DRAWS = 20
_ALONE = " with the warm-up of each training window filtered alone"


@dataclass(frozen=True)
class Spec:
    """What a table is made of.

    Attributes
    ----------
    systems, methods : In the order of their rows; a method stays out where it makes no sense.
    published : The paper's values by system, or by the value that is varied.
    shows : What its columns are: errors, errors that count the warm-up too, errors with training
        losses, the spread of errors over noise draws, or run times.
    varied : The field of a job that an ablation varies, over `values`.
    """

    systems: tuple[str, ...]
    methods: tuple[str, ...]
    published: Mapping[Any, Row]
    shows: Literal["errors", "whole errors", "losses", "quantiles", "seconds"] = "errors"
    varied: str = ""
    values: tuple[float, ...] = ()
    own_warmup: bool = False
    """Whether split models filter each warm-up alone in training."""
    epochs: int | None = None
    """Of the runs, where they are not the paper's."""


TITLES = {
    "learning-based": "Table 1: total RMSE, learned from the record alone",
    "own-warmup": "Table 1 with the warm-up of each training window filtered alone",
    "hybrid-rnn": "Table 2: total RMSE, hybrid models with the RNN",
    "hybrid-gru": "Table 3: total RMSE, hybrid models with the GRU",
    "hybrid-noise": "System (v) with noise of deviation 0.1 on the training data: total RMSE",
    "pendulum": "Rows (ii) to (iv) on the simulated pendulum, each with its own excitation",
    "noise-draws": f"System (i) over {DRAWS} noise draws, one seed each",
    "noise-draws-300-epochs": f"The same {DRAWS} draws with the split models' epochs",
    "noise-draws-own-warmup": f"The same {DRAWS} draws{_ALONE}",
    "epochs": "System (i), trained for longer",
    "cutoff": "Table 10: cut-off w on system (i)",
    "cutoff-own-warmup": f"The same{_ALONE}",
    "downsampling": "Table 11: down-sampling k on system (i)",
    "downsampling-own-warmup": f"The same{_ALONE}",
    "runtime-learning-based": "Table 7: run times in seconds, learned from the record alone",
    "runtime-hybrid-rnn": "Table 8: run times in seconds, hybrid models with the RNN",
    "runtime-hybrid-gru": "Table 9: run times in seconds, hybrid models with the GRU",
}
"""What a table says, and which of the paper's tables it is, by its name."""
_OF_PAPER = 1, 2, 3, 7, 8, 9, 10, 11
_NAMES = (
    *("learning-based", "hybrid-rnn", "hybrid-gru"),
    *("runtime-learning-based", "runtime-hybrid-rnn", "runtime-hybrid-gru"),
    *("cutoff", "downsampling"),
)
NUMBERED = dict(zip(_OF_PAPER, _NAMES, strict=True))
"""Names by the paper's numbers, counted on through its supplement; 4 to 6 are settings."""
_FIRST, _RECORDS, _HYBRIDS = ("i",), ("i", "ii", "iii", "iv"), ("v", "vi")
_SIMULATED = ("ii-simulated", "iii-simulated", "iv-simulated")
_WITH_RNN = ("rnn", "residual-rnn", "simulator", "filtered-rnn")
_WITH_GRU = ("gru", "residual-gru", "simulator", "filtered-gru")
_OTHERS = ("simulator-affine", *_NAIVE)
_DRAWN = Spec(_FIRST, (), published.LEARNING_BASED, "quantiles", "draw", tuple(range(DRAWS)))
_CUTOFF = Spec(_FIRST, _GRU[1:], published.CUTOFF, varied="cutoff", values=(0.1, 0.2, 0.4, 0.5))
_FACTORS = (2, 3, 4, 5, 10)
_K = Spec(_FIRST, _GRU[1:], published.DOWNSAMPLING, varied="downsampling", values=_FACTORS)
SPECS = {
    "learning-based": Spec(_RECORDS, (*_GRU, *_NAIVE, ORACLE), published.LEARNING_BASED),
    "own-warmup": Spec(_RECORDS, _GRU[1:], published.LEARNING_BASED, own_warmup=True),
    "hybrid-rnn": Spec(_HYBRIDS, (*_WITH_RNN, *_OTHERS), published.HYBRID_RNN, "whole errors"),
    "hybrid-gru": Spec(_HYBRIDS, (*_WITH_GRU, *_OTHERS), published.HYBRID_GRU, "whole errors"),
    "hybrid-noise": Spec(("v-noisy",), (*_WITH_GRU, *_NAIVE), {}, "whole errors"),
    "pendulum": Spec(_SIMULATED, (*_GRU, *_NAIVE), {}),
    "noise-draws": replace(_DRAWN, methods=(*_GRU, *_NAIVE[1:], ORACLE)),
    "noise-draws-300-epochs": replace(_DRAWN, methods=_GRU[:1], epochs=300),
    "noise-draws-own-warmup": replace(_DRAWN, methods=_GRU[1:], own_warmup=True),
    "epochs": Spec(_FIRST, _GRU, {}, "losses", "epochs", (300, 1000, 2000)),
    "cutoff": _CUTOFF,
    "cutoff-own-warmup": replace(_CUTOFF, values=(0.2, 0.4, 0.5), own_warmup=True),
    "downsampling": _K,
    "downsampling-own-warmup": replace(_K, own_warmup=True),
    "runtime-learning-based": Spec(_RECORDS, _GRU, published.SECONDS, "seconds"),
    "runtime-hybrid-rnn": Spec(
        _HYBRIDS, ("rnn", "residual-rnn", "filtered-rnn"), published.SECONDS_RNN, "seconds"
    ),
    "runtime-hybrid-gru": Spec(
        _HYBRIDS, ("gru", "residual-gru", "filtered-gru"), published.SECONDS_GRU, "seconds"
    ),
}
"""By the name that the command line takes."""


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
    **changes: float | None,
) -> list[Line]:
    """Return the rows of a table with the jobs that they need.

    `changes`: `epochs`, `cutoff` or `downsampling` of all jobs, where they are not the table's.
    """
    spec = SPECS[name]
    change: dict[str, Any] = {"epochs": spec.epochs, "own_warmup": spec.own_warmup}
    change |= {key: value for key, value in changes.items() if value is not None}
    found = []
    for system in chosen("systems", systems, spec.systems):
        for value in _varied(spec, change):
            for method in chosen("methods", methods, spec.methods):
                if method == ORACLE and system != "i":
                    continue
                repeated = 1 if method in (*QUICK, ORACLE) else seeds
                if spec.shows == "quantiles":
                    jobs = [Job(system, method, 0, int(d), **change) for d in spec.values]
                else:
                    varied = {spec.varied: value} if spec.varied else {}
                    jobs = [Job(system, method, s, **change | varied) for s in range(repeated)]
                found.append(Line(system, method, value, tuple(jobs)))
    return found


def _varied(spec: Spec, change: Mapping[str, Any]) -> Sequence[float | None]:
    """Return the values that a table has rows for; where one is asked for, that alone."""
    if not spec.varied or spec.shows == "quantiles":
        return (None,)
    return (change[spec.varied],) if change.get(spec.varied) is not None else spec.values


def chosen(what: str, given: Sequence[str] | None, possible: Iterable[str]) -> list[str]:
    """The names that were asked for, or all."""
    possible = list(possible)
    unknown = [name for name in given or () if name not in possible]
    if unknown:
        raise ValueError(f"{what} must be out of {', '.join(possible)}, got {', '.join(unknown)}")
    return possible if given is None else list(given)
