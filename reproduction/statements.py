"""What the tables of the paper's experiments say: for REPORT.md, out of docs/results/tables.

`docs.tables` writes what the functions of `FIGURES` return.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from reproduction.tables import full_seconds, spread

RESULTS = Path(__file__).parents[1] / "docs" / "results"
Row = Mapping[str, Any]
ERRORS = ("learning-based", "hybrid-gru", "hybrid-rnn", "pendulum")
"""Tables whose rows have one system and one method each."""
NAIVE = ("persistence", "seasonal-naive", "harmonic")
APART = 2.0
"""Standard errors by which two means are called different; standard deviations, from the paper."""


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
    """Return on which systems a method is better than another, level, or worse."""
    records, simulated = ("i", "ii", "iii", "iv"), ("ii-simulated", "iii-simulated", "iv-simulated")
    hybrids = ("v", "vi")
    rows, lines = _rows(), ["| methods | better | level | worse |", "|---|---|---|---|"]
    split, others = ("gru", "split-gru", "split-gru-hp"), ("{}", "residual-{}", "simulator")
    pairs: list[tuple[str, str, tuple[str, ...]]]
    pairs = [(a, b, of) for b, a in pairwise(split) for of in (records, simulated)]
    pairs += [(f"filtered-{n}", o.format(n), hybrids) for n in ("gru", "rnn") for o in others]
    for ours, theirs, systems in pairs:
        found: dict[str, list[str]] = {"better": [], "level": [], "worse": []}
        for system in systems:
            a, b = rows[system, ours], rows[system, theirs]
            values = f"({system.removesuffix('-simulated')}) {_mean(a):.3f} / {_mean(b):.3f}"
            found[_verdict(a["total_rmse"], b["total_rmse"])].append(values)
        first = f"{_short(ours)}, {_short(theirs)}"
        first = "the same, simulated pendulum" if systems is simulated else first
        lines.append(f"| {first} | {' | '.join(map(', '.join, found.values()))} |")
    return "\n".join(lines)


def _short(method: str) -> str:
    words = method.replace("gru", "GRU").replace("rnn", "RNN").replace("-hp", " + HP")
    return words.replace("-", " ")


def against_naive() -> str:
    """Return the best network at the paper's settings beside the best naive baseline."""
    rows = _rows()
    lines = ["| system | best network | best naive baseline |", "|---|---|---|"]
    for system in dict.fromkeys(system for system, _ in rows):
        of = [row for (each, _), row in rows.items() if each == system]
        baseline = min((r for r in of if r["method"] in NAIVE), key=_mean)
        network = min((r for r in of if r["epochs"] and r["total_rmse"]), key=_mean)
        better = network if _mean(network) < _mean(baseline) else baseline
        cells = [
            f"**{text}**" if each is better else text
            for each in (network, baseline)
            for text in [f"{each['method']} {_mean(each):.3f}"]
        ]
        name, _, kind = system.partition("-")
        lines.append(f"| ({name}){kind and f', {kind}'} | {' | '.join(cells)} |")
    return "\n".join(lines)


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


def noise_draws() -> dict[str, dict[str, str]]:
    """Return what the noise draws of (i) say, by the form of training."""
    found = {}
    every = {row["method"]: row["total_rmse"] for row in _files()["noise-draws"]["rows"]}
    for form, name in (("eq_10", "noise-draws"), ("own_warmup", "noise-draws-own-warmup")):
        rows = every | {row["method"]: row["total_rmse"] for row in _files()[name]["rows"]}
        better = sum(a < b for a, b in zip(rows["split-gru"], rows["gru"], strict=True))
        found[form] = {"better": f"{better} of {len(rows['gru'])}"}
    paper = _rows()["i", "split-gru"]["paper"]["mean"]
    below = sum(value < paper for value in every["oracle"])
    found["oracle"] = {"below": f"{below} of {len(every['oracle'])}"}
    return found


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
    for verdict, sign in (("worse", 1), ("better", -1)):
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


def _verdict(ours: Sequence[float], theirs: Sequence[float]) -> str:
    """By the difference of two means and its standard error (Welch's)."""
    errors = [statistics.variance(v) / len(v) if len(v) > 1 else 0.0 for v in (ours, theirs)]
    difference = statistics.mean(ours) - statistics.mean(theirs)
    if abs(difference) <= APART * sum(errors) ** 0.5:
        return "level"
    return "better" if difference < 0 else "worse"


def _range(values: Sequence[float]) -> str:
    lowest, highest = f"{min(values):.2f}", f"{max(values):.2f}"
    return lowest if lowest == highest else f"{lowest} to {highest}"


_OF_RUNS = tables, row, comparisons, against_naive, horizons, noise_draws
FIGURES = (*_OF_RUNS, time_shares, differing_table, unversioned)
