"""What the tables of the paper's experiments say, in words: for pages, out of docs/results/tables.

Each function without an argument is a figure of `docs.figures_in_text`, by its name.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from reproduction.tables import SETTLED_SHARE, full_seconds, spread

TABLES = Path(__file__).parents[1] / "docs" / "results" / "tables"
Row = Mapping[str, Any]
ERRORS = ("learning-based", "hybrid-gru", "hybrid-rnn", "pendulum")
"""Tables whose rows have one system and one method each."""
NAIVE = ("persistence", "seasonal-naive", "harmonic")
APART = 2.0
"""Standard errors by which two means are called different; standard deviations, from the paper."""


@cache
def _files() -> dict[str, dict[str, Any]]:
    paths = sorted(TABLES.glob("*.json"))
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}


def _rows() -> dict[tuple[str, str], Row]:
    """Return the rows of errors by system and method."""
    return {(r["system"], r["method"]): r for name in ERRORS for r in _files()[name]["rows"]}


def tables() -> dict[str, str]:
    """Return every table in Markdown, by its name."""
    return {name: facts["markdown"].strip() for name, facts in _files().items()}


def row() -> dict[str, dict[str, dict[str, str]]]:
    """Return texts of each row by system and method: its error, the paper's, each seed's."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    for (system, method), facts in _rows().items():
        if not facts["total_rmse"]:
            continue
        found.setdefault(system, {})[method] = {
            "error": spread(facts["total_rmse"]),
            "whole": spread(facts["whole_rmse"]),
            "sliced": spread(facts["sliced_rmse"]) if facts["sliced_rmse"] else "",
            "paper": facts["paper_text"],
            "each": _listed(f"{value:.2f}" for value in sorted(facts["total_rmse"])),
            **{f"loss of {name}": _range(of) for name, of in facts["losses"].items()},
            **{f"{part} alone": f"{value:.3f}" for part, value in facts["parts_rmse"].items()},
        }
    return found


def against() -> dict[str, dict[str, dict[str, str]]]:
    """Return on which systems a method is better than another: by both names and a group."""
    groups = {
        "two networks": ("i", "ii", "iii", "iv"),
        "simulated": ("ii-simulated", "iii-simulated", "iv-simulated"),
        "hybrid": ("v", "vi"),
    }
    rows, found = _rows(), dict[str, dict[str, dict[str, str]]]()
    methods = dict.fromkeys(method for _, method in rows)
    for ours in methods:
        for theirs in methods:
            for group, systems in groups.items():
                pairs = [
                    (system, rows[system, ours], rows[system, theirs])
                    for system in systems
                    if (system, ours) in rows and (system, theirs) in rows
                ]
                found.setdefault(ours, {}).setdefault(theirs, {})[group] = _tally(pairs)
    return found


def _tally(pairs: Iterable[tuple[str, Row, Row]]) -> str:
    found: dict[str, list[str]] = {"better": [], "level": [], "worse": []}
    for system, a, b in pairs:
        values = f"({system}) {_mean(a):.3f} against {_mean(b):.3f}"
        found[_verdict(a["total_rmse"], b["total_rmse"])].append(values)
    return "; ".join(f"{name} on {_listed(of)}" for name, of in found.items() if of)


def naive() -> str:
    """Return where the best network at the paper's settings beats the best naive baseline."""
    rows, won, lost = _rows(), list[str](), list[str]()
    for system in dict.fromkeys(system for system, _ in rows):
        of = [row for (each, _), row in rows.items() if each == system]
        baseline = min((r for r in of if r["method"] in NAIVE), key=_mean)
        network = min((r for r in of if r["epochs"] and r["total_rmse"]), key=_mean)
        text = f"({system}) {network['method']} {_mean(network):.3f} against " + (
            f"{baseline['method']} {_mean(baseline):.3f}"
        )
        (won if _mean(network) < _mean(baseline) else lost).append(text)
    return f"On {_listed(won or ['no record'])}. Not on {_listed(lost or ['any other'])}."


def noise_draws() -> dict[str, dict[str, str]]:
    """Return what the noise draws of (i) say, by the form of training."""
    found = {}
    every = {row["method"]: row["total_rmse"] for row in _files()["noise-draws"]["rows"]}
    for form, name in (("eq_10", "noise-draws"), ("own_warmup", "noise-draws-own-warmup")):
        rows = every | {row["method"]: row["total_rmse"] for row in _files()[name]["rows"]}
        better = sum(a < b for a, b in zip(rows["split-gru"], rows["gru"], strict=True))
        found[form] = {
            "better": f"{better} of {len(rows['gru'])}",
            **{method: f"{statistics.median(of):.3f}" for method, of in rows.items()},
        }
    paper = _rows()["i", "split-gru"]["paper"]["mean"]
    below = sum(value < paper for value in every["oracle"])
    found["oracle"] = {"below": f"{below} of {len(every['oracle'])}"}
    return found


def ablations() -> dict[str, dict[str, str]]:
    """Return the errors of an ablation by its table and method, and how far they are apart."""
    found: dict[str, dict[str, str]] = {}
    for name in ("cutoff", "cutoff-own-warmup", "downsampling", "downsampling-own-warmup"):
        for method in ("split-gru", "split-gru-hp"):
            rows = [row for row in _files()[name]["rows"] if row["method"] == method]
            values = _listed(f"{spread(r['total_rmse'])} at {r['value']:g}" for r in rows)
            means = [_mean(row) for row in rows]
            deviation = statistics.mean(statistics.stdev(row["total_rmse"]) for row in rows)
            apart = (max(means) - min(means)) / deviation
            found.setdefault(name, {})[method] = (
                f"{values}; the best and the worst are {apart:.1f} standard deviations over seeds "
                "apart"
            )
    return found


def time_shares() -> str:
    """Return the run time of split GRU against the GRU's, ours and the paper's, by system."""
    rows = {(r["system"], r["method"]): r for r in _files()["runtime-learning-based"]["rows"]}
    found = []
    for system in ("i", "ii", "iii", "iv"):
        a, b = (rows[system, method] for method in ("split-gru", "gru"))
        share = full_seconds(a) / full_seconds(b)
        papers = a["paper"]["mean"] / b["paper"]["mean"]
        found.append(f"({system}) {share:.2f}, in the paper {papers:.2f}")
    return _listed(found)


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


def unversioned() -> str:
    """Return the rows with runs that do not say their commit, or had changes on top of it."""
    rows = {
        (row["system"], row["method"]): row["unversioned"]
        for facts in _files().values()
        for row in facts["rows"]
        if row["unversioned"]
    }
    return _listed(f"({system}) {method} {count}" for (system, method), count in rows.items())


def settled_share() -> float:
    """Return what twice the epochs must leave of a loss that has settled."""
    return SETTLED_SHARE


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


def _listed(texts: Iterable[str]) -> str:
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


FIGURES = (
    tables, row, against, naive, noise_draws, ablations, time_shares, differing_table,
    settled_share, unversioned,
)  # fmt: skip
