"""Families of drawn records on which a filter should pay, or not, and what `compare` finds there.

    python -m benchmarks.families [--families crane "drifting sensor"] [--draws 10] [--development]
    python -m benchmarks.families --times 0.25 0.5 1 2 4 --budget 30s [--draws 3]
    python -m benchmarks.families --table

Each run is the plain command with a drawn record and its simulator's output, if any, as in
`benchmarks.clock`; a run is a line of OUT, and what is there is not run again. Errors are those of
the forecast of the last quarter. `--times` runs the filtered hybrid alone, with the chosen cut-off
times these factors; `--table` prints all of it as Markdown. Code is changed by what is found on
`--development` draws alone.
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

import numpy as np
import numpy.typing as npt
import scipy

from benchmarks import clock
from benchmarks.clock import Row
from benchmarks.commands import written
from benchmarks.kinds import DEVELOPMENT, KINDS, REPORTED
from splitband import Record, plan
from splitband.cli.options import seconds
from splitband.data.named import overhead_crane
from splitband.filters import Band
from splitband.forecasters.bands import Bands
from splitband.metrics import rmse

Array = npt.NDArray[np.float64]
Generator = np.random.Generator
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


def wrong_above(edge: float, rng: Generator) -> Record:
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


def without_simulator(kind: str, rng: Generator) -> Record:
    """A record without a simulator, for two networks or one."""
    return Record(KINDS[kind](rng)[:SAMPLES], STEP)


SPLIT = "five tones", "trend and season", "beating", "driven van der Pol", "Mackey-Glass"
"""Kinds of records without a simulator that have a slow and a fast part."""
FAMILIES: dict[str, Callable[[Generator], Record]] = {
    **{f"wrong above {edge:g} Hz": partial(wrong_above, edge) for edge in EDGES},
    "leaves its range": leaves_range,
    "drifting sensor": drifting_sensor,
    "crane": crane,
    "van der Pol": oscillator,
    **{kind: partial(without_simulator, kind) for kind in SPLIT},
}


def bands_of(settings: Row) -> dict[Band, Row]:
    """Return the bands of hybrids with the simulator in the low band, and in the high one."""
    chosen: dict[Band, Row] = {"low": settings, "high": settings.get("high") or {}}
    return {band: of for band, of in chosen.items() if of.get("cutoff")}


def floors(record: Record, settings: Row) -> dict[str, float]:
    """Return the forecast error with a perfect network: H(y) + L(y_s), and L(y) + H(y_s)."""
    if record.y_sim is None:
        return {}
    wrong, found = record.y_sim - record.y, dict[str, float]()
    for band, of in bands_of(settings).items():
        pair = Bands(of["cutoff"], of["order"]).one_way_pair(record.sampling_rate, band)
        left = (pair.lowpass if band == "low" else pair.highpass)(wrong)[-SAMPLES // 4 :]
        found[band] = rmse(left, np.zeros_like(left))
    return found


def measured(row: Row, folder: Path) -> Row:
    """Run the command, and return the row with the error of each method, regret and floors."""
    record = FAMILIES[row["family"]](np.random.default_rng(row["draw"]))
    words = written(record, folder / "record.csv")
    if record.y_sim is not None:
        simulated = Record(record.y_sim, record.sampling_time, columns=record.columns)
        words += ["--simulator", *written(simulated, folder / "simulator.csv")]
    if row["times"] is not None:
        planned = plan(record)
        method = next(name for name in planned.names if name.startswith("filtered"))
        cutoff = (planned.high if "-high-" in method else planned.bands).cutoff
        assert cutoff is not None
        words += ["--methods", method, "--cutoff", f"{row['times'] * cutoff:.4g}"]
    row = clock.measured(words, row, folder)
    found = json.loads((folder / "out" / "results.json").read_text(encoding="utf-8"))
    every = {name: of for name, of in found["methods"].items() if "failed" not in of}
    errors = {name: of["median_of_seeds"]["forecast_rmse"] for name, of in every.items()}
    regret = errors[row["recommended"]] / min(errors.values())
    cutoffs = {band: of["cutoff"] for band, of in bands_of(found["settings"]).items()}
    about = {"cutoffs": cutoffs, "floors": floors(record, found["settings"])}
    return row | {"errors": errors, "regret": regret} | about


def spread(values: Iterable[float]) -> str:
    """Return the median and the range of several values."""
    of = [*values]
    return f"{statistics.median(of):.3g} ({min(of):.3g} to {max(of):.3g})"


def costs_of_choice(rows: Sequence[Row]) -> list[float]:
    """Return, by draw, the hybrid's error at the chosen cut-off over that at the best one."""
    by_draw: dict[int, dict[float, float]] = {}
    for row in rows:
        if row["times"] is not None:
            by_draw.setdefault(row["draw"], {})[row["times"]] = min(row["errors"].values())
    return [of[1.0] / min(of.values()) for of in by_draw.values() if 1.0 in of and len(of) > 1]


def table(name: str, rows: Sequence[Row]) -> str:
    """Return what a family came to: errors, what was recommended, its regret, floors."""
    plain = [row for row in rows if row["times"] is None]
    methods = dict.fromkeys(method for row in plain for method in row["errors"])
    errors = {m: [row["errors"][m] for row in plain if m in row["errors"]] for m in methods}
    lines = ["| method | draws | error | recommended |", "|---|---:|---:|---:|"]
    for method, of in sorted(errors.items(), key=lambda each: statistics.median(each[1])):
        count = sum(row["recommended"] == method for row in plain)
        lines.append(f"| `{method}` | {len(of)} | {spread(of)} | {count or ''} |")
    said = [f"Regret of the recommendation: {spread(row['regret'] for row in plain)}."]
    for band in ("low", "high"):
        if of := [row["floors"][band] for row in plain if band in row["floors"]]:
            said.append(f"A perfect network beside the simulator's {band} band: {spread(of)}.")
    if costs := costs_of_choice(rows):
        said.append(f"Error at the chosen cut-off over that at the best: {spread(costs)}.")
    about = getattr(FAMILIES[name], "func", FAMILIES[name]).__doc__
    return "\n\n".join([f"## {name}", str(about), "\n".join(lines), " ".join(said)])


def main() -> None:
    """Run what is missing, or print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--families", nargs="+", default=[*FAMILIES], choices=[*FAMILIES])
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--times", nargs="+", type=float, default=[None], metavar="FACTOR")
    parser.add_argument("--budget", default="2m")
    parser.add_argument("--out", type=Path, default=Path("out/families.jsonl"))
    parser.add_argument("--table", action="store_true", help="print the tables, and run nothing")
    given = parser.parse_args()
    if given.table:
        rows = clock.read(given.out)
        of = {name: [row for row in rows if row["family"] == name] for name in FAMILIES}
        there = [name for name in FAMILIES if any(row["times"] is None for row in of[name])]
        print("\n\n".join(table(name, of[name]) for name in there))
        return
    draws = (DEVELOPMENT if given.development else REPORTED)[: given.draws]
    shared = {"asked": seconds(given.budget), "seed": 0, "beside": 0}
    # Draw by draw, so that an early end leaves all families.
    every: list[Row] = [
        {"family": family, "draw": draw, "times": times} | shared
        for draw, family, times in product(draws, given.families, given.times)
    ]
    clock.complete(given.out, every, measured)


if __name__ == "__main__":
    main()
