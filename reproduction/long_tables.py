"""The tables of `python -m reproduction readings`, made of the files that are there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks import study
from reproduction import high_pass, published
from reproduction.bands import HIGH, LOW
from reproduction.evidence import HORIZONS, SOON, Runs, horizons, of_reading, of_table
from reproduction.jobs import ORACLE
from reproduction.published import Value
from reproduction.readings import (
    ABLATIONS,
    BASE,
    FALLING_RATE,
    GRU_READINGS,
    HP_READINGS,
    PRINTED,
    READINGS,
    Reading,
)
from reproduction.runs import final_losses
from reproduction.specs import DRAWS
from reproduction.system_i import NAIVE, NETWORKS
from reproduction.tables import spread

HEADING = """# System (i) under other readings of the paper's text

Made by `python -m reproduction readings`. Errors are the RMSE of free runs from the start, against
the noiseless signal; mean (standard deviation) over seeds, or as the heading says. The *nearest*
reading has noise of standard deviation 0.1, and the record is filtered as a whole. The
[claims](claims.md) say what follows from it.
"""
APART = 2.0
"""Standard errors by which two readings are called different."""
PAPER = published.LEARNING_BASED["i"]


def page(out: Path) -> str:
    """Return all tables in Markdown, made of the runs in the folder of results."""
    near, results = out / "system-i", out / "runs"
    sections = [
        ("(i) under the nearest reading, draw 0", block(near)),
        ("The same over noise draws", draws(near)),
        ("The oracle under both noises", oracle(near)),
        ("Split GRU under other readings", readings(near, "split-gru", READINGS)),
        ("GRU under other readings", readings(near, "gru", GRU_READINGS)),
        ('"+HP" under other readings', readings(near, "split-gru-hp", HP_READINGS)),
        ("Ablations under the nearest reading", ablations(near)),
        ('"+HP" on the double-torsion record', recipes(out / "high-pass", results)),
        ("Short and long term in the runs of Tables 1 to 3", soon_and_late(results)),
    ]
    tables = "\n\n".join("\n".join([f"## {title}", "", *lines]) for title, lines in sections)
    return f"{HEADING}\n{tables}\n"


def block(near: Path) -> list[str]:
    """Return the second block of Table 1."""
    rows = []
    for method in (*NETWORKS, *NAIVE, ORACLE):
        runs = of_reading(near, method, BASE)
        if runs:
            trained = ["", "", ""]
            if method in NETWORKS:
                trained = [_spread(runs, "late"), _spread(runs, "lowest"), str(len(runs))]
            rows.append((method, _spread(runs, "total_rmse"), str(PAPER.get(method, "")),
                         _spread(runs, "forecast_rmse"), *trained))  # fmt: skip
    header = ("method", "ours, last epoch", "paper", "forecast", "mean of the last tenth of epochs",
              "epoch of the lowest error", "seeds")  # fmt: skip
    return study.table(header, rows)


def draws(near: Path) -> list[str]:
    """Return the distribution over noise draws, one seed each."""
    best = _oracle_errors(near)
    rows = []
    for method, name, key in _DRAWN:
        by_draw = [of_reading(near, method, name, draw, seeds=1) for draw in range(DRAWS)]
        runs = [run for of_draw in by_draw for run in of_draw]
        if not runs:
            continue
        values = np.array([run[key] for run in runs])
        same = np.median(
            [best[f"variance {run['reading']['variance']:g}"][run["draw"]] for run in runs]
        )
        shown = [*np.quantile(values, (0.5, 0.1, 0.9, 1.0)), values.mean()]
        rows.append((method, name, _EPOCH[key],
                     *(f"{v:.3f}" for v in shown), str(PAPER.get(method, "")),
                     f"{shown[0] / same:.2f}", str(len(runs))))  # fmt: skip
    header = ("method", "reading", "epoch", "median", "10 %", "90 %", "worst", "mean",
              "paper, one draw", "median / oracle's", "draws")  # fmt: skip
    return study.table(header, rows)


_EPOCH = {"total_rmse": "last", "late": "mean of the last tenth", "lowest": "lowest error"}
_DRAWN = (
    *((method, BASE, "total_rmse") for method in (*NETWORKS, *NAIVE, ORACLE)),
    *((method, BASE, key) for method in NETWORKS for key in ("late", "lowest")),
    *(("split-gru", name, key) for name in (PRINTED, FALLING_RATE) for key in _EPOCH),
)


def _oracle_errors(near: Path) -> dict[str, list[float]]:
    """Return the oracle's errors by noise and draw."""
    path = near / "oracle-draws.json"
    found: dict[str, list[float]] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    return found


def oracle(near: Path) -> list[str]:
    """Return what is known best, over draws, beside the paper's split GRU."""
    rows = []
    for noise, errors in _oracle_errors(near).items():
        values = np.array(errors)
        shown = [*np.quantile(values, (0.5, 0.1, 0.9, 1.0)), values.mean()]
        below = f"{(values < PAPER['split-gru'].mean).mean():.0%}"
        rows.append((noise, *(f"{v:.3f}" for v in shown), below, str(len(values))))
    header = ("noise", "median", "10 %", "90 %", "worst", "mean",
              f"below {PAPER['split-gru'].mean:g}", "draws")  # fmt: skip
    return study.table(header, rows)


def readings(near: Path, method: str, of: Mapping[str, Reading]) -> list[str]:
    """Return what each reading comes to, beside the nearest one."""
    paper, base = PAPER[method], of_reading(near, method, BASE)
    rows, compared = [], {}
    for name in (BASE, *(name for name in of if name != BASE)):
        runs = of_reading(near, method, name)
        if not runs:
            continue
        compared[name] = nearer(base, runs, paper) if name != BASE else 0.0
        columns = ("total_rmse", "late", "late_deviation", "best", "lowest")
        rows.append((name, *(_spread(runs, key) for key in columns),
                     "" if name == BASE else f"{compared[name]:.1f}", *_of_bands(runs),
                     str(len(runs))))  # fmt: skip
    header = ("reading", "last epoch", "mean of the last tenth of epochs", "deviation over them",
              "epoch of the lowest loss", "epoch of the lowest error", "nearer", "low band",
              "high band", "seeds")  # fmt: skip
    closer = [name for name, by in compared.items() if by > APART]
    farther = [name for name, by in compared.items() if by < -APART]
    said = (
        f"The paper has {paper}. *Nearer* is in standard errors, of the mean of the last tenth of "
        f"epochs. By more than {APART:g}: {'; '.join(closer) or 'none'}. Farther by as much: "
        f"{'; '.join(farther) or 'none'}."
    )
    return [*study.table(header, rows), "", said]


def nearer(base: Runs, runs: Runs, paper: Value) -> float:
    """Return by how many standard errors (Welch's) the second runs are nearer to the paper's mean.

    Zero where there are fewer than two runs of each.
    """
    near, far = (np.array([abs(run["late"] - paper.mean) for run in of]) for of in (runs, base))
    if min(len(near), len(far)) < 2:
        return 0.0
    error = sum(np.var(values, ddof=1) / len(values) for values in (near, far)) ** 0.5
    return float((far.mean() - near.mean()) / error)


def ablations(near: Path) -> list[str]:
    """Return both ablations beside the paper's."""
    cutoffs: dict[str, Mapping[str, Value]] = {
        f"w = {w:g}": row for w, row in published.CUTOFF.items()
    }
    factors = {f"k = {k}": row for k, row in published.DOWNSAMPLING.items()}
    rows = []
    for label, row in (cutoffs | factors).items():
        for reading, name in ((BASE, label), (FALLING_RATE, f"{label}, {FALLING_RATE}")):
            for method in NETWORKS[1:]:
                runs = of_reading(near, method, name if name in ABLATIONS else reading)
                if runs:
                    shown = [_spread(runs, key) for key in _EPOCH]
                    rows.append((label, reading, method, *shown, str(row[method]), str(len(runs))))
    return study.table(("value", "reading", "method", *_EPOCH.values(), "paper", "seeds"), rows)


def recipes(out: Path, results: Path) -> list[str]:
    """Return the rows of both recipes beside those that are trained as the paper says."""
    rows: list[tuple[str, ...]] = []
    for row in high_pass.SYSTEM_ROWS:
        for method in ("split-gru", "split-gru-hp"):
            runs = of_table(results, row, method)
            high = [final_losses(dict(run))[high_pass.HIGH] for run in runs]
            rows.append((row, f"{method}, as in the paper", _spread(runs, "total_rmse"),
                         str(published.LEARNING_BASED[row][method]), _spread(runs, "forecast_rmse"),
                         "", spread(high), "", str(len(runs))))  # fmt: skip
        for name, runs in study.found(out / row, high_pass.RECIPES).items():
            if runs:
                rows.append((row, name, *_recipe_cells(row, name, runs)))
    header = ("system", "method", "ours", "paper", "forecast", "low band as in the paper",
              "loss of the high band", "left of it", "seeds")  # fmt: skip
    return study.table(header, rows)


def _recipe_cells(row: str, name: str, runs: Runs) -> tuple[str, ...]:
    method = "split-gru-hp" if high_pass.RECIPES[name].filtered else "split-gru"
    own_low = [run["low_as_in_the_paper"]["total_rmse"] for run in runs]
    high = [run["losses"][high_pass.HIGH] for run in runs]
    left = np.mean([run["losses"][high_pass.HIGH] / run["first_losses"][high_pass.HIGH]
                    for run in runs])  # fmt: skip
    return (_spread(runs, "total_rmse"), str(published.LEARNING_BASED[row][method]),
            _spread(runs, "forecast_rmse"), spread(own_low), spread(high), f"{left:.0%}",
            str(len(runs)))  # fmt: skip


def soon_and_late(results: Path) -> list[str]:
    """Return the errors of free runs soon after the warm-up and at the end of the record."""
    rows = []
    for system, methods in HORIZONS.items():
        for method in methods:
            errors = horizons(results, system, method)
            if errors["soon"]:
                shown = (spread(errors["soon"]), spread(errors["late"]), str(len(errors["soon"])))
                rows.append((system, method, *shown))
    header = ("system", "method", f"first {SOON} samples", "last quarter", "seeds")
    return study.table(header, rows)


def _of_bands(runs: Runs) -> tuple[str, str]:
    """Return the error of each band at the last epoch; nothing for a single network."""
    low, high = (
        [run["parts_rmse"][name] for run in runs if run.get("parts_rmse")] for name in (LOW, HIGH)
    )
    return (spread(low), spread(high)) if low else ("", "")


def _spread(runs: Runs, key: str) -> str:
    return spread([run[key] for run in runs])
