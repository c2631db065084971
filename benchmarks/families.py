"""Families of drawn records on which a filter should pay, or not, and what `compare` finds there.

    python -m benchmarks.families [--families crane "drifting sensor"] [--draws 10] [--development]
    python -m benchmarks.families --table

Each run is the plain command with a drawn record and its simulator's output, as in
`benchmarks.clock`; a run is a line of OUT, and what is there is not run again. Errors are those of
the forecast of the last quarter. `--table` prints all of it as Markdown and draws the picture. Code
is changed by what is found on `--development` draws alone.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import scipy
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, StrMethodFormatter

from benchmarks import claims, clock, page
from benchmarks.claims import Row
from benchmarks.commands import written
from benchmarks.kinds import DEVELOPMENT, REPORTED
from benchmarks.page import spread
from splitband import Record
from splitband.cli.options import seconds
from splitband.filters import Band
from splitband.forecasters.bands import Bands
from splitband.metrics import rmse
from splitband.records.named import overhead_crane

Array = npt.NDArray[np.float64]
Generator = np.random.Generator
FILE = "families.jsonl"
PICTURE = Path(__file__).parents[1] / "docs/img/filter-pays.png"
SAMPLES, STEP = 2000, 0.1
"""Of a drawn record: its samples, and its sampling time in s."""
EDGES = 0.25, 0.5, 1.0, 2.0
"""Frequencies in Hz above which a simulator is wrong."""
TIME = STEP * np.arange(SAMPLES)


def _noise(rng: Generator, edge: float, band: Band) -> Array:
    """Return noise of deviation 1 below an edge in Hz, or above it."""
    filters = scipy.signal.butter(4, edge, band, fs=1 / STEP, output="sos")
    settled = scipy.signal.sosfilt(filters, rng.standard_normal(2 * SAMPLES))[SAMPLES:]
    return np.asarray(settled / settled.std())


def _tones(rng: Generator, *tones: tuple[float, float, float]) -> Array:
    """Return a sum of tones, each between two frequencies in Hz and of an amplitude."""
    every = [
        size * np.sin(2 * np.pi * (rng.uniform(low, high) * TIME + rng.random()))
        for low, high, size in tones
    ]
    return np.sum(every, axis=0)


def _measured(y: Array, y_sim: Array, rng: Generator, step: float = STEP) -> Record:
    return Record(y + 0.02 * rng.standard_normal(SAMPLES), step, y_sim=y_sim, columns=("y",))


def _detail(rng: Generator) -> Array:
    return _tones(rng, (0.8, 1.2, 0.3), (1.4, 2.0, 0.15))


def noise_above(edge: float, rng: Generator) -> Record:
    """The simulator knows a slow random part; above an edge it is noise, and lacks two tones."""
    slow = _noise(rng, 0.15, "low")
    return _measured(slow + _detail(rng), slow + 0.4 * _noise(rng, edge, "high"), rng)


def leaves_range(rng: Generator) -> Record:
    """The slow part, which the simulator knows, goes on beyond its training range."""
    rise = rng.choice([-1, 1]) * rng.uniform(3, 6) * TIME / TIME[-1]
    slow = rise + 0.3 * _noise(rng, 0.1, "low")
    return _measured(slow + _detail(rng), slow, rng)


def drifting_sensor(rng: Generator) -> Record:
    """A tilt of slow roll and gusts; the simulator is its measured rate, integrated with a bias."""
    tilt = _tones(rng, (0.03, 0.06, 1.0), (0.07, 0.1, 0.5)) + 0.3 * _noise(rng, 0.8, "high")
    bias = rng.choice([-1, 1]) * rng.uniform(0.01, 0.03)
    walk = 5e-4 * rng.standard_normal(SAMPLES).cumsum()
    wrong = bias + walk + 0.01 * rng.standard_normal(SAMPLES)
    return _measured(tilt, tilt - tilt[0] + STEP * wrong.cumsum(), rng)


def crane(rng: Generator) -> Record:
    """The overhead crane, whose simulator knows no swing; its inputs tell what is missing."""
    record = overhead_crane(SAMPLES, seed=int(rng.integers(2**31)))
    return replace(record, columns=("load",), inputs=("speed", "rope"), y_true=None)


def oscillator(rng: Generator) -> Record:
    """System (v) with other parameters; the simulator's phase is wrong, and can be learned."""
    damping, force = 5 * rng.uniform(0.9, 1.1), 25 * rng.uniform(0.8, 1.2)
    speed, times = rng.uniform(6, 8), TIME / 2

    def solved(damping: float, force: float) -> Array:
        def slope(t: float, s: Array) -> list[float]:
            push = force * np.cos(speed * t)
            return [s[1], -s[0] + damping * (1 - s[0] ** 2) * s[1] + push]

        run = scipy.integrate.solve_ivp(slope, (0, times[-1]), [-2, 1], t_eval=times, rtol=1e-8)
        return np.asarray(run.y[0])

    return _measured(solved(damping, force), solved(0.76 * damping, 0.0), rng, STEP / 2)


COLUMNS = "filtered", "residual", "network", "simulator", "baseline"
"""Kinds of methods in the table; of several of a kind, the one with the lowest error counts."""
NETWORKS = "gru", "state-space"
LABELS = {
    "filtered": "simulator below the cut-off, network above",
    "residual": "simulator + network",
    "network": "network alone",
    "simulator": "simulator alone",
    "perfect network": "filtered, with a perfect network",
}
"""Curves of the picture."""


def above(edge: float) -> str:
    """Return the name of a family by the frequency in Hz above which its simulator is noise."""
    return f"noise above {edge:g} Hz"


FAMILIES: dict[str, Callable[[Generator], Record]] = {
    **{above(edge): partial(noise_above, edge) for edge in EDGES},
    "leaves its range": leaves_range,
    "drifting sensor": drifting_sensor,
    "crane": crane,
    "van der Pol": oscillator,
}


def bands_of(settings: Row) -> dict[Band, Row]:
    """Return the bands of hybrids with the simulator in the low band, and in the high one."""
    chosen: dict[Band, Row] = {"low": settings, "high": settings.get("high") or {}}
    return {band: of for band, of in chosen.items() if of.get("cutoff")}


def floors(record: Record, settings: Row) -> dict[str, float]:
    """Return the forecast error with a perfect network: H(y) + L(y_s), and L(y) + H(y_s)."""
    assert record.y_sim is not None
    wrong, found = record.y_sim - record.y, dict[str, float]()
    for band, of in bands_of(settings).items():
        pair = Bands(of["cutoff"], of["order"]).one_way_pair(record.sampling_rate, band)
        left = (pair.lowpass if band == "low" else pair.highpass)(wrong)[-SAMPLES // 4 :]
        found[band] = rmse(left, np.zeros_like(left))
    return found


def measured(row: Row, folder: Path) -> Row:
    """Run the command, and return the row: errors of the methods, also held out, regret, floors."""
    record = FAMILIES[row["family"]](np.random.default_rng(row["draw"]))
    words = written(record, folder / "record.csv")
    assert record.y_sim is not None
    simulated = Record(record.y_sim, record.sampling_time, columns=record.columns)
    words += ["--simulator", *written(simulated, folder / "simulator.csv")]
    row = clock.measured(words, row, folder)
    found = json.loads((folder / "out" / "results.json").read_text(encoding="utf-8"))
    every = {name: of for name, of in found["methods"].items() if "failed" not in of}
    errors = {name: of["median_of_seeds"]["forecast_rmse"] for name, of in every.items()}
    held_out = {name: of["held_out_rmse"] for name, of in every.items()}
    regret = errors[row["recommended"]] / min(errors.values())
    cutoffs = {band: of["cutoff"] for band, of in bands_of(found["settings"]).items()}
    about = {"cutoffs": cutoffs, "floors": floors(record, found["settings"])}
    return row | {"errors": errors, "held_out": held_out, "regret": regret} | about


def kind_of(method: str) -> str:
    """Return the column of a method."""
    first, *_ = method.split("-")
    if method in NETWORKS:
        return "network"
    return first if first in COLUMNS else "baseline"


def best_of(rows: Iterable[Row], kind: str) -> list[float]:
    """Return the lowest error of a kind of methods, in each run that has one."""
    every = (
        [error for name, error in row["errors"].items() if kind_of(name) == kind] for row in rows
    )
    return [min(errors) for errors in every if errors]


def filtered_over_residual(rows: Iterable[Row]) -> str:
    """Return the geometric mean of a ratio over draws that tried both, and Wilcoxon's p."""
    both = ([best_of([row], kind) for kind in ("filtered", "residual")] for row in rows)
    ratios = [np.log(ours[0] / other[0]) for ours, other in both if ours and other]
    if not ratios:
        return ""
    return f"{np.exp(np.mean(ratios)):.2f} (p = {scipy.stats.wilcoxon(ratios).pvalue:.1g})"


def middle(values: Sequence[float]) -> str:
    """Return the median of several values; nothing of none."""
    return f"{statistics.median(values):.3g}" if values else ""


def table(rows: Sequence[Row]) -> str:
    """Return what each family came to in Markdown: errors, what was recommended, and its regret."""
    found = {name: [row for row in rows if row["family"] == name] for name in FAMILIES}
    lines = []
    for name, of in found.items():
        if not of:
            continue
        chosen = statistics.multimode(kind_of(row["recommended"]) for row in of)
        floors = [min(row["floors"].values()) for row in of if row["floors"]]
        errors = [spread(best_of(of, kind)) for kind in COLUMNS]
        error = (row["errors"][row["recommended"]] for row in of)
        regret = spread(row["regret"] for row in of)
        advised = [", ".join(chosen), spread(error), regret, filtered_over_residual(of)]
        lines.append([name + claims.sign(of), *advised, *errors, middle(floors)])
    heads = ["family", "recommended", "its error", "regret", "filtered / residual", *COLUMNS]
    return page.table([*heads, "perfect network"], lines) + claims.note(rows)


def drawn(rows: Sequence[Row]) -> Figure:
    """Draw the errors over the frequency above which a simulator is wrong: median and range."""
    figure, axis = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    of_edge = {edge: [row for row in rows if row["family"] == above(edge)] for edge in EDGES}
    for kind, label in LABELS.items():
        points = [(edge, best_of(of, kind)) for edge, of in of_edge.items() if of]
        if kind == "perfect network":
            points = [(edge, [row["floors"]["low"] for row in of]) for edge, of in of_edge.items()]
        edges = [edge for edge, of in points if of]
        lowest, median, highest = np.transpose(
            [np.quantile(of, [0, 0.5, 1]) for _, of in points if of]
        )
        style = "--" if kind == "perfect network" else "-"
        (line,) = axis.plot(edges, median, style, marker="o", label=label)
        if style == "-":
            axis.fill_between(edges, lowest, highest, alpha=0.12, color=line.get_color())
    axis.set_xlabel("frequency above which the simulator is noise (Hz)")
    axis.set_ylabel("forecast RMSE (deviations of the slow part)")
    axis.set(xscale="log", yscale="log", xticks=EDGES, xticklabels=[f"{edge:g}" for edge in EDGES])
    axis.minorticks_off()
    axis.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.grid(alpha=0.3)
    figure.legend(fontsize="small", ncols=2, loc="outside lower center")
    return figure


def main() -> None:
    """Run what is missing, or print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--families", nargs="+", default=[*FAMILIES], choices=[*FAMILIES])
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--budget", default="2m")
    parser.add_argument("--out", type=Path, default=page.OUT / FILE)
    parser.add_argument("--table", action="store_true", help="print the table, and run nothing")
    given = parser.parse_args()
    if given.table:
        print(table(claims.read(given.out)))
        page.save(drawn(claims.read(given.out)), PICTURE)
        return
    draws = (DEVELOPMENT if given.development else REPORTED)[: given.draws]
    shared = {"asked": seconds(given.budget), "seed": 0, "beside": 0}
    # Draw by draw, so that an early end leaves all families.
    every: list[Row] = [
        {"family": family, "draw": draw} | shared for draw, family in product(draws, given.families)
    ]
    clock.complete(given.out, every, measured)


if __name__ == "__main__":
    main()
