"""What the tables of the paper's experiments say: for REPORT.md, out of docs/results/tables.

`docs.tables` writes what the functions of `FIGURES` return.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from reproduction.tables import full_seconds, spread

RESULTS = Path(__file__).parents[1] / "docs" / "results"
Row = Mapping[str, Any]
ERRORS = ("learning-based", "hybrid-gru", "hybrid-rnn", "pendulum")
"""Tables whose rows have one system and one method each."""
NAIVE = ("persistence", "seasonal-naive", "harmonic")
DRAWN = "-300-epochs", "-own-warmup"
"""Further tables over noise draws."""
PROTOCOLS = "total_rmse", "forecast_rmse"
APART = 2.0
"""Standard deviations of the paper, or standard errors of a difference, that are worth a row."""
LEVEL = 0.05
"""Largest p of a verdict. A convention."""


@cache
def _files() -> dict[str, dict[str, Any]]:
    paths = sorted((RESULTS / "tables").glob("*.json"))
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}


def _rows() -> dict[tuple[str, str], Row]:
    """Return the rows of errors by system and method."""
    return {(r["system"], r["method"]): r for name in ERRORS for r in _files()[name]["rows"]}


def tables() -> dict[str, str]:
    """Return every table in Markdown, by its name."""
    return {name: facts["markdown"].strip() for name, facts in _files().items()}


def row() -> dict[str, dict[str, dict[str, str]]]:
    """Return ranges over seeds of the error and of each network's loss, by system and method."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    for (system, method), facts in _rows().items():
        if not facts["total_rmse"]:
            continue
        found.setdefault(system, {})[method] = {
            "seeds": _range(facts["total_rmse"]),
            **{f"loss of {name}": _range(of) for name, of in facts["losses"].items()},
        }
    return found


def comparisons() -> str:
    """Return the verdicts on pairs of methods, under both protocols."""
    learned, hybrids = ("i", "ii", "iii", "iv"), ("v", "vi")
    split, others = ("gru", "split-gru", "split-gru-hp"), ("{}", "residual-{}", "simulator")
    pairs: list[tuple[str, str, tuple[str, ...]]]
    pairs = [(ours, theirs, learned) for theirs, ours in pairwise(split)]
    for cell in ("gru", "rnn"):
        pairs += [(f"filtered-{cell}", other.format(cell), hybrids) for other in others]
        pairs.append((f"residual-{cell}", "simulator", hybrids))
    rows, lines = _rows(), [*_heads("system", "n")]
    for ours, theirs, systems in pairs:
        for system in systems:
            a, b = rows[system, ours], rows[system, theirs]
            cells = [cell for name in PROTOCOLS for cell in _compared(a[name], b[name])]
            n = " and ".join(dict.fromkeys(str(len(row["total_rmse"])) for row in (a, b)))
            lines.append([f"{_short(ours)}, {_short(theirs)}", f"({system})", n, *cells])
    for system in hybrids:
        path = RESULTS / "beyond" / f"{system}.json"
        of = json.loads(path.read_text(encoding="utf-8"))["methods"]
        a, b = (of[f"{kind}-gru-calibrated-conditioned"] for kind in ("filtered", "residual"))
        cells = [cell for name in PROTOCOLS for cell in _compared(a[name], b[name])]
        said = "filtered GRU, residual GRU, both calibrated and conditioned"
        lines.append([said, f"({system})", str(len(a["total_rmse"])), *cells])
    return _markdown(lines)


def draws() -> str:
    """Return the verdicts on split models and the GRU over noise draws of (i), paired by draw."""
    files = {name: _files()[f"noise-draws{name}"]["rows"] for name in ("", *DRAWN)}
    rows = {(name, row["method"]): row for name, of in files.items() for row in of}
    lines = [*_heads("training of split models", "epochs of the GRU", "draws")]
    for form, split in (("Eq. 10, training", ""), ("own warm-ups", "-own-warmup")):
        for gru in ("-300-epochs", ""):
            for method in ("split-gru", "split-gru-hp"):
                a, b = rows[split, method], rows[gru, "gru"]
                cells = [c for name in PROTOCOLS for c in _compared(a[name], b[name], paired=True)]
                n = str(len(a["total_rmse"]))
                lines.append([f"{_short(method)}, GRU", form, str(b["epochs"]), n, *cells])
    return _markdown(lines)


def _heads(*of_pair: str) -> list[list[str]]:
    heads = ["methods", *of_pair]
    return [
        [*heads, *("from the start", "p", "verdict", "forecast", "p", "verdict")],
        ["---"] * len(heads) + ["---:", "---:", "---"] * 2,
    ]


def _markdown(lines: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _compared(ours: Sequence[float], theirs: Sequence[float], paired: bool = False) -> list[str]:
    """Return both medians, p and the verdict on two methods: the one rule of the report.

    Seeds are compared by Mann and Whitney's exact test, draws by Wilcoxon's, of the logarithms of
    ratios. A method that needs no seed has the same error with each of them.
    """
    theirs = [*theirs] * (1 if len(theirs) > 1 else len(ours))
    if paired:
        p = scipy.stats.wilcoxon(np.log(ours) - np.log(theirs)).pvalue
    else:
        p = scipy.stats.mannwhitneyu(ours, theirs, method="exact").pvalue
    a, b = statistics.median(ours), statistics.median(theirs)
    verdict = "undecided" if p >= LEVEL else "better" if a < b else "worse"
    return [f"{a:.3f} / {b:.3f}", f"{p:.2g}", verdict]


def _short(method: str) -> str:
    words = method.replace("gru", "GRU").replace("rnn", "RNN").replace("-hp", " + HP")
    return words.replace("-", " ")


def against_naive() -> str:
    """Return the best network at the paper's settings beside the best naive baseline."""
    rows, found = _rows(), list[list[str]]()
    for system in ("i", "ii", "iii", "iv", "v", "vi"):
        of = [row for (each, _), row in rows.items() if each == system]
        baseline = min((r for r in of if r["method"] in NAIVE), key=_mean)
        network = min((r for r in of if r["epochs"] and r["total_rmse"]), key=_mean)
        compared = _compared(network["total_rmse"], baseline["total_rmse"])
        found.append([f"({system})", network["method"], baseline["method"], *compared])
    heads = ["system", "best network", "best naive baseline", "median errors", "p", "network is"]
    return _markdown([heads, ["---"] * 3 + ["---:", "---:", "---"], *found])


def readings() -> str:
    """Return the readings of (i) that differ from the nearest, by the mean of the last epochs."""
    lines = [["method", "paper", "reading", "last epoch", "mean of the last tenth", ""]]
    lines.append(["---", "---:", "---", "---:", "---:", "---"])
    every = json.loads((RESULTS / "readings.json").read_text(encoding="utf-8"))["readings"]
    for method, of in every.items():
        paper, nearest = _rows()["i", method]["paper"]["mean"], of["nearest"]["late"]
        for name, row in of.items():
            late = row["late"]
            error = sum(each["deviation"] ** 2 / each["runs"] for each in (late, nearest)) ** 0.5
            if name != "nearest" and abs(late["mean"] - nearest["mean"]) <= APART * error:
                continue
            nearer = abs(late["mean"] - paper) < abs(nearest["mean"] - paper)
            said = "" if name == "nearest" else "nearer" if nearer else "farther"
            told = (row[each] for each in ("total_rmse", "late"))
            cells = [f"{each['mean']:.3f} ({each['deviation']:.2g})" for each in told]
            lines.append([method, f"{paper:.3f}", name, *cells, said])
    return _markdown(lines)


def horizons() -> str:
    """Return the errors of free runs in the short and in the long term."""
    found = json.loads((RESULTS / "horizons.json").read_text(encoding="utf-8"))
    lines = ["| system | method | first 100 | last quarter |", "|---|---|---:|---:|"]
    rows = [
        *(
            (s, name, of)
            for s, methods in found["horizons"].items()
            for name, of in methods.items()
        ),
        *((s, "low band of split-gru, seed 0", of) for s, of in found["low band"].items()),
    ]
    for system, name, of in rows:
        soon, late = of["soon"]["mean"], of["late"]["mean"]
        lines.append(f"| ({system}) | {name} | {soon:.3f} | {late:.3f} |")
    return "\n".join(lines)


def noise_draws() -> dict[str, str]:
    """Return on how many draws of (i) the oracle is below the paper's error."""
    errors = next(r for r in _files()["noise-draws"]["rows"] if r["method"] == "oracle")
    paper = _rows()["i", "split-gru"]["paper"]["mean"]
    below = sum(value < paper for value in errors["total_rmse"])
    return {"below": f"{below} of {len(errors['total_rmse'])}"}


def seconds_by_factor() -> dict[str, float]:
    """Return the run time of split GRU on (i) by the down-sampling k."""
    rows = (r for r in _files()["downsampling"]["rows"] if r["method"] == "split-gru")
    return {f"k{row['value']}": full_seconds(row) for row in rows}


def time_shares() -> dict[str, dict[str, float]]:
    """Return the run time of split GRU over the GRU's, ours and the paper's, by system."""
    rows = {(r["system"], r["method"]): r for r in _files()["runtime-learning-based"]["rows"]}
    found: dict[str, dict[str, float]] = {"ours": {}, "paper": {}}
    for system in ("i", "ii", "iii", "iv"):
        a, b = (rows[system, method] for method in ("split-gru", "gru"))
        found["ours"][system] = full_seconds(a) / full_seconds(b)
        found["paper"][system] = a["paper"]["mean"] / b["paper"]["mean"]
    return found


def differing_table() -> str:
    """Return the rows of the paper's tables that differ by more than `APART` deviations."""
    lines = ["| | system | method | ours | paper | deviations |", "|---|---|---|---:|---:|---:|"]
    for verdict, sign in (("higher", 1), ("lower", -1)):
        for (system, method), facts in _rows().items():
            if not (facts["paper"] and facts["paper"]["std"] and facts["total_rmse"]):
                continue
            deviations = (_mean(facts) - facts["paper"]["mean"]) / facts["paper"]["std"]
            if sign * deviations > APART:
                ours, paper = spread(facts["total_rmse"]), facts["paper_text"]
                lines.append(
                    f"| {verdict} | ({system}) | {method} | {ours} | {paper} "
                    f"| {abs(deviations):.1f} |"
                )
    return "\n".join(lines)


def unversioned() -> dict[str, dict[str, int]]:
    """Return how many runs do not say their commit, or had changes on top of it, by row."""
    found: dict[str, dict[str, int]] = {}
    for facts in _files().values():
        for row in facts["rows"]:
            if row["unversioned"]:
                found.setdefault(row["system"], {})[row["method"]] = row["unversioned"]
    return found


def _mean(row: Row) -> float:
    return statistics.mean(row["total_rmse"]) if row["total_rmse"] else float("inf")


def _range(values: Sequence[float]) -> str:
    lowest, highest = f"{min(values):.2f}", f"{max(values):.2f}"
    return lowest if lowest == highest else f"{lowest} to {highest}"


_OF_RUNS = tables, row, comparisons, draws, against_naive, horizons, noise_draws, readings
FIGURES = (*_OF_RUNS, time_shares, seconds_by_factor, differing_table, unversioned)
