"""What each of the paper's tables is made of, and the runs that its rows need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from reproduction import published
from reproduction.jobs import ORACLE, Job
from reproduction.published import Row
from splitband.forecasters.names import QUICK

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
    shows : What its columns are: errors, errors that count the warm-up too, errors with training
        losses, the spread of errors over noise draws, or run times.
    varied : The field of a job that an ablation varies, over `values`.
    """

    title: str
    systems: tuple[str, ...]
    methods: tuple[str, ...]
    published: Mapping[Any, Row]
    shows: Literal["errors", "whole errors", "losses", "quantiles", "seconds"] = "errors"
    varied: str = ""
    values: tuple[float, ...] = ()
    own_warmup: bool = False
    """Whether split models filter each warm-up alone in training."""


SPECS = {
    "learning-based": Spec(
        "Table 1: total RMSE, learned from the record alone",
        ("i", "ii", "iii", "iv"), (*_GRU, *_NAIVE, ORACLE), published.LEARNING_BASED,
    ),
    "own-warmup": Spec(
        "Table 1 with the warm-up of each training window filtered alone",
        ("i", "ii", "iii", "iv"), _GRU[1:], published.LEARNING_BASED, own_warmup=True,
    ),
    "hybrid-rnn": Spec(
        "Table 2: total RMSE, hybrid models with the RNN",
        ("v", "vi"),
        ("rnn", "residual-rnn", "simulator", "filtered-rnn", "simulator-affine", *_NAIVE),
        published.HYBRID_RNN, shows="whole errors",
    ),
    "hybrid-gru": Spec(
        "Table 3: total RMSE, hybrid models with the GRU",
        ("v", "vi"),
        ("gru", "residual-gru", "simulator", "filtered-gru", "simulator-affine", *_NAIVE),
        published.HYBRID_GRU, shows="whole errors",
    ),
    "hybrid-noise": Spec(
        "System (v) with noise of deviation 0.1 on the training data: total RMSE",
        ("v-noisy",), ("gru", "residual-gru", "simulator", "filtered-gru", *_NAIVE), {},
        shows="whole errors",
    ),
    "pendulum": Spec(
        "Rows (ii) to (iv) on the simulated pendulum, each with its own excitation",
        ("ii-simulated", "iii-simulated", "iv-simulated"), (*_GRU, *_NAIVE), {},
    ),
    "noise-draws": Spec(
        f"System (i) over {DRAWS} noise draws, one seed each",
        ("i",), (*_GRU, *_NAIVE[1:], ORACLE), published.LEARNING_BASED,
        varied="draw", values=tuple(range(DRAWS)), shows="quantiles",
    ),
    "noise-draws-own-warmup": Spec(
        f"The same {DRAWS} draws with the warm-up of each training window filtered alone",
        ("i",), _GRU[1:], published.LEARNING_BASED,
        varied="draw", values=tuple(range(DRAWS)), shows="quantiles", own_warmup=True,
    ),
    "epochs": Spec(
        "System (i), trained for longer",
        ("i",), _GRU, {}, shows="losses", varied="epochs", values=(300, 1000, 2000),
    ),
    "cutoff": Spec(
        "Ablation of the cut-off w on system (i), k = 2",
        ("i",), _GRU[1:], published.CUTOFF, varied="cutoff",
        values=(0.1, 0.2, 0.4, 0.5),
    ),
    "cutoff-own-warmup": Spec(
        "The same with the warm-up of each training window filtered alone",
        ("i",), _GRU[1:], published.CUTOFF, varied="cutoff", values=(0.2, 0.4, 0.5),
        own_warmup=True,
    ),
    "downsampling": Spec(
        "Ablation of the down-sampling k on system (i), w = 0.4",
        ("i",), _GRU[1:], published.DOWNSAMPLING, varied="downsampling", values=(2, 3, 4, 5, 10),
    ),
    "downsampling-own-warmup": Spec(
        "The same with the warm-up of each training window filtered alone",
        ("i",), _GRU[1:], published.DOWNSAMPLING, varied="downsampling", values=(2, 3, 4, 5, 10),
        own_warmup=True,
    ),
    "runtime-learning-based": Spec(
        "Run times in seconds, learned from the record alone",
        ("i", "ii", "iii", "iv"), _GRU, published.SECONDS, shows="seconds",
    ),
    "runtime-hybrid-rnn": Spec(
        "Run times in seconds, hybrid models with the RNN",
        ("v", "vi"), ("rnn", "residual-rnn", "filtered-rnn"), published.SECONDS_RNN,
        shows="seconds",
    ),
    "runtime-hybrid-gru": Spec(
        "Run times in seconds, hybrid models with the GRU",
        ("v", "vi"), ("gru", "residual-gru", "filtered-gru"), published.SECONDS_GRU,
        shows="seconds",
    ),
}  # fmt: skip
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
    epochs: int | None = None,
) -> list[Line]:
    """The rows of a table with the jobs that they need."""
    spec = SPECS[name]
    found = []
    for system in chosen("systems", systems, spec.systems):
        for value in _varied(spec, epochs):
            for method in chosen("methods", methods, spec.methods):
                if method == ORACLE and system != "i":
                    continue
                repeated = 1 if method in (*QUICK, ORACLE) else seeds
                change: dict[str, Any] = {"epochs": epochs, "own_warmup": spec.own_warmup}
                if spec.shows == "quantiles":
                    jobs = [Job(system, method, 0, int(d), **change) for d in spec.values]
                else:
                    change |= {spec.varied: value} if spec.varied else {}
                    jobs = [Job(system, method, s, **change) for s in range(repeated)]
                found.append(Line(system, method, value, tuple(jobs)))
    return found


def _varied(spec: Spec, epochs: int | None) -> Sequence[float | None]:
    """The values that a table has rows for; of a table over epochs those that are asked for."""
    if not spec.varied or spec.shows == "quantiles":
        return (None,)
    return (epochs,) if spec.varied == "epochs" and epochs is not None else spec.values


def chosen(what: str, given: Sequence[str] | None, possible: Iterable[str]) -> list[str]:
    """The names that were asked for, or all."""
    possible = list(possible)
    unknown = [name for name in given or () if name not in possible]
    if unknown:
        raise ValueError(f"{what} must be out of {', '.join(possible)}, got {', '.join(unknown)}")
    return possible if given is None else list(given)
