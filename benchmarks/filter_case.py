"""When does a complementary filter pay? An experiment whose comparisons were fixed beforehand.

    python -m benchmarks.filter_case --run [--jobs 2]     run what is missing
    python -m benchmarks.filter_case --table              print the tables of what is there

**Records.** Families of drawn records with a simulator, 2000 samples each, of which the last 500
are forecast. Each of 30 draws is an independent system: its own plant, its own noise and, where the
simulator is wrong above a frequency, *one* frequency, drawn log-uniformly from 0.25 to 2 Hz.

- noise above: the simulator knows the slow part; above the frequency it is noise, and it lacks two
  tones (`families.noise_above`). This is the first family.
- wrong above: a random force moves a resonance at the frequency, which the simulator has at another
  frequency and damping. Wrong in a systematic way, that a network can learn.
- leaves its range, drifting sensor, crane, van der Pol, as in `benchmarks.families`: the record
  leaves its range, the simulator drifts, or is wrong below.
- drill string: the one measured record, with the physical simulator that was published beside it,
  right in the low band once it is calibrated. Five seeds of one record are no five systems: no
  test, and constants of the package were chosen on it. (The published simulation of the torsion rig
  has 400 samples, 2.5 periods; a simulator that we filter is wrong where we made it so.)

**Arms.** (a) `simulator`; (b) `residual`: simulator + network; (c) `filtered`: L(simulator) +
H(network); (d) `control`: L(simulator) + network, see `NotHighPassed`; (e) `filtered high`:
H(simulator) + L(network), for the drifting sensor alone. (c) and (d) have the same filter, at the
cut-off that the package chooses on the training samples, and both are trained to the error of the
sum. Networks of (b), (c), (d) are conditioned on the same output, the simulator's as it is. They
warm up on y - simulator, y, and y - L(simulator). In the first family also `residual, smoothed`:
(b) with a simulator that was low-passed in both directions beforehand, as anybody can do.

**Networks.** Today's default, the conditioned state-space network, its settings searched as by
`compare --rounds 6` with one method, so that no arm takes time from another and the work is
independent of the machine; two seeds. In the first family also the paper's network, a GRU of 64
units that is not conditioned. The simulator is as given; on ten draws the arms are compared once
more with the simulator of all of them calibrated below the cut-off.

**Error.** RMSE of the forecast, in units of the record; a failed training counts as `WORST` times
the deviation of the training samples, and no error as more. Of a draw and an arm: the mean over
seeds of its logarithm. Effects are geometric means of ratios over draws, with the 95 % interval of
Student's t; p is of Wilcoxon's signed-rank test of the draws' logarithms of the ratio.

**Primary comparisons**, in the first family: filtered / residual, and filtered / control. All
others (`SECONDARY`, `TRENDS`) are corrected by Holm's method for their number. The verdict is
*undecided* where the interval includes 1 or p, corrected if secondary, is 0.05 or more; of ten
draws p is 0.002 at least. Draws 2000 to 2029 had been used for nothing before; development was on
draw 100.

A run is a line of OUT, appended as it ends; what is there is not run again. The primary comparisons
come first. Started by `setsid nohup nice -n 19 python -m ... &`, the whole group is paused by
`kill -STOP -- -PID`, goes on by `kill -CONT -- -PID` and ends by `kill -- -PID`, which loses the
runs in progress alone.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy
from torch import Tensor

import splitband as sb
from benchmarks import claims, families, page
from benchmarks.claims import Row
from benchmarks.families import SAMPLES, STEP, Array, Generator
from splitband import models
from splitband.comparison.defaults import chosen_bands, high_bands
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.comparison.run import run
from splitband.filters import Band
from splitband.forecasters.bands import OPEN
from splitband.forecasters.held_out import TRAINING_SHARE
from splitband.forecasters.network import Network
from splitband.metrics import rmse
from splitband.models.base import FreeRun, Signals
from splitband.records.public import drill_string
from splitband.report.environment import environment
from splitband.runtime.errors import InputError
from splitband.runtime.threads import use_one_thread
from splitband.training import TrainingSettings

FILE = page.OUT / "filter-case.jsonl"
DRAWS, CALIBRATED, SEEDS = range(2000, 2030), range(2000, 2010), range(2)
ROUNDS = 6
"""Rounds of the search: about 26 trainings from up to three seeds of weights."""
LOWEST, HIGHEST = 0.25, 2.0
"""Range of the frequency above which a simulator is wrong, in Hz."""
WORST = 10.0
"""Largest error that counts, in deviations of the training samples."""
MEASURED, MEASURED_SEEDS = "drill string", range(5)
GIVEN = "simulator", "L(simulator)", "perfect filtered"
"""Arms without a network. The second is (d) with a network that is zero, the third L(simulator) +
H(y), which is (c) with a perfect network."""
SMOOTHED = "residual, smoothed"
LEVEL, LEAST_DRAWS = 0.05, 6
_OF_PAIR = ("group", "family", "arm", "other", "cell", "calibrated")
_OF_EFFECT = ("ratio", "low", "high", "below 1", "n", "p", "rho", "p (Holm)")
COLUMNS = [*_OF_PAIR, *_OF_EFFECT, "verdict"]


def frequency(rng: Generator) -> float:
    """Draw the frequency in Hz above which a simulator is wrong."""
    return float(np.exp(rng.uniform(np.log(LOWEST), np.log(HIGHEST))))


def noise_above(rng: Generator) -> sb.Record:
    """Draw a record whose simulator is noise above a drawn frequency."""
    return families.noise_above(frequency(rng), rng)


def wrong_above(rng: Generator) -> sb.Record:
    """Draw a record of a resonance that its simulator has at another frequency, and damping."""
    at, slow = frequency(rng), families._noise(rng, 0.15, "low")
    force = slow + 0.3 * families._noise(rng, 0.15, "high")
    wrong = at * rng.uniform(1.1, 1.4) ** rng.choice([-1, 1])
    y, y_sim = (
        _resonance(force, each, damping)
        for each, damping in ((at, rng.uniform(0.1, 0.3)), (wrong, rng.uniform(0.1, 0.3)))
    )
    return families._measured(y, y_sim, rng)


def _resonance(force: Array, at: float, damping: float) -> Array:
    """Return the motion of a mass on a spring, 1 for a constant force of 1."""
    omega = 2 * np.pi * at
    system = [omega**2], [1.0, 2 * damping * omega, omega**2]
    return np.asarray(scipy.signal.lsim(system, force, STEP * np.arange(SAMPLES))[1])


_OTHERS = "leaves its range", "drifting sensor", "crane", "van der Pol"
FAMILIES: dict[str, Callable[[Generator], sb.Record]] = {
    "noise above": noise_above,
    "wrong above": wrong_above,
    **{name: families.FAMILIES[name] for name in _OTHERS},
}
FIRST, SECOND, DRIFTING = "noise above", "wrong above", "drifting sensor"


class NotHighPassed(models.FilteredModel):
    """Add L(simulator) and a network that is not high-passed, in one method other than (c)."""

    def _run(self, filtered: Signals, steps: int) -> FreeRun:
        """Warm up on y - L(simulator)."""
        assert filtered.y_sim is not None
        return filtered.y - filtered.y_sim[:, : filtered.y.shape[1]], steps, filtered.u

    def _high(self, network: Tensor, filtered: Signals) -> Tensor:
        """Return the network's output as it is."""
        return network

    def stepped(self) -> Any:
        """Refuse to run sample by sample, which no arm needs."""
        raise InputError("the control cannot be stepped")


class Control(sb.Filtered):  # type: ignore[misc]  # final; so all but the model is that of (c)
    """Train the control; parameters as for `sb.Filtered`, of which it uses the low band alone."""

    def _build(self, record: sb.Record, settings: TrainingSettings) -> models.Model:
        """Return a model with a network and a low-pass filter."""
        pair = self._bands_for(record, settings).one_way_pair(record.sampling_rate)
        cell = self._sized(self.cell, record, settings)
        return NotHighPassed(cell, pair, self.conditioned, record.nu > 0)


def record_of(row: Row) -> sb.Record:
    """Draw, or read, the record of a run."""
    if row["family"] == MEASURED:
        return drill_string()
    return FAMILIES[row["family"]](np.random.default_rng(row["draw"]))


def band_of(name: str) -> Band:
    """Return the band of the simulator in an arm."""
    return "high" if name == "filtered high" else "low"


def bands_of(training: sb.Record, calibrated: bool, band: Band) -> sb.Bands:
    """Return the bands that a comparison chooses on the training part."""
    if band == "high":
        return high_bands(OPEN, training)
    base = sb.Calibrated() if calibrated else sb.Simulation()
    return chosen_bands(OPEN, training, [sb.Filtered(base, sb.StateSpace(4, 10))])


def arm(row: Row, record: sb.Record, bands: sb.Bands) -> tuple[Network, sb.Record]:
    """Return the forecaster of an arm, and the record that it sees."""
    name, conditioned = row["arm"], row["cell"] != "gru"
    cell = sb.StateSpace(4, 10) if conditioned else sb.GRU(64)
    base = sb.Calibrated(below=bands.cutoff) if row["calibrated"] else sb.Simulation()
    if not name.startswith("residual"):
        kind, band = Control if name == "control" else sb.Filtered, band_of(name)
        return kind(base, cell, bands, conditioned, simulator_band=band), record
    if name == SMOOTHED:
        smooth = bands.pair(record.sampling_rate).lowpass
        record = replace(record, y_sim=smooth(without_network("simulator", record, bands)))
    return sb.Residual(base, cell, conditioned), record


def without_network(name: str, record: sb.Record, bands: sb.Bands) -> Array:
    """Return the output of an arm of `GIVEN`."""
    assert record.y_sim is not None
    low, wrong = bands.one_way_pair(record.sampling_rate).lowpass, record.y_sim - record.truth
    if name == "perfect filtered":
        return record.truth + low(wrong)
    return low(record.y_sim) if name == "L(simulator)" else record.y_sim


def measured(row: Row) -> Row:
    """Return the row with the error of the forecast, how it came about, or why it failed."""
    began, record = time.process_time(), record_of(row)
    training = record[: int(TRAINING_SHARE * len(record))]
    bands = bands_of(training, row["calibrated"], band_of(row["arm"]))
    helps = bands.choice is not None and bool(bands.choice.simulator_helps)
    told: Row = {"cutoff": bands.cutoff, "helps": helps, "deviation": float(training.y.std())}
    try:
        if row["arm"] in GIVEN:
            if row["calibrated"]:
                record = sb.Calibrated(below=bands.cutoff).fit(training).on(record)
            y, ahead = without_network(row["arm"], record, bands), slice(len(training), None)
            told["error"] = rmse(record.truth[ahead], y[ahead])
        else:
            method, seen = arm(row, record, bands)
            planned = plan(
                PlanRequest(seen, None, [method], rounds=row["rounds"], seed=row["seed"])
            )
            # Sizes are searched, as for the method that a name stands for.
            sized = {method.name: row["cell"] != "gru"}
            result = run(replace(planned, searched=sized))
            told["error"] = result.errors(result.medians[method.name]).forecast
            tried = result.attempts
            told |= {"trainings": len(tried), "weights": len({each.seed for each in tried})}
    except InputError as failure:
        told |= {"error": math.inf, "failed": str(failure)}
    return row | told | {"cpu_seconds": round(time.process_time() - began, 1)}


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Yield all runs; those of the primary comparisons first, draw by draw."""
    usual: Row = {"cell": "state-space", "calibrated": False}
    three = "residual", "filtered", "control"

    def of(name: str, arms: Sequence[str], draws: Iterable[int], **options: Any) -> Iterator[Row]:
        seeds = MEASURED_SEEDS if name == MEASURED else SEEDS
        for draw in draws:
            row = {"family": name, "draw": draw} | usual | options
            yield from (row | {"arm": each, "seed": 0, "rounds": 0} for each in GIVEN)
            for each, seed in product(arms, seeds):
                yield row | {"arm": each, "seed": seed, "rounds": rounds}

    yield from of(FIRST, three, DRAWS)
    for draw, name in product(DRAWS, [*FAMILIES][1:]):
        yield from of(name, (*three, *["filtered high"] * (name == DRIFTING)), [draw])
    yield from of(FIRST, three, DRAWS, cell="gru")
    yield from of(FIRST, (SMOOTHED,), DRAWS)
    yield from of(MEASURED, three, [0], calibrated=True)
    for draw, name in product(CALIBRATED, FAMILIES):
        yield from of(name, three, [draw], calibrated=True)


def key(row: Row) -> tuple[Any, ...]:
    """Return what tells a run from another."""
    return tuple(row[n] for n in ("family", "draw", "cell", "calibrated", "arm", "seed", "rounds"))


def missing(path: Path, every: Iterable[Row]) -> list[Row]:
    """Return the runs that are not in the file."""
    there = {key(row) for row in claims.read(path)}
    return [*{key(row): row for row in every if key(row) not in there}.values()]


def complete(path: Path, every: Iterable[Row], jobs: int) -> None:
    """Run what is missing, so many side by side, and append each run as it ends."""
    todo, commit = missing(path, every), environment()["commit"]
    print(f"{len(todo)} runs are missing", flush=True)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, use_one_thread) as pool:
        for done, future in enumerate(as_completed([pool.submit(measured, r) for r in todo]), 1):
            if (error := future.exception()) is not None:  # the next call tries it again
                print(f"{type(error).__name__}: {error}", flush=True)
                continue
            row = future.result() | {"commit": commit}
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(time.strftime("%H:%M:%S"), f"{done} of {len(todo)}", row, flush=True)


class Pair(NamedTuple):
    """Two arms to compare."""

    family: str
    arm: str
    other: str
    cell: str = "state-space"
    calibrated: bool = False


PRIMARY = Pair(FIRST, "filtered", "residual"), Pair(FIRST, "filtered", "control")
_THREE = ("filtered", "residual"), ("filtered", "control"), ("control", "residual")
SECONDARY = (
    Pair(FIRST, "control", "residual"),
    Pair(FIRST, "filtered", SMOOTHED),
    *(Pair(FIRST, arm, "simulator") for arm in ("residual", "filtered")),
    *(Pair(FIRST, *two, "gru") for two in _THREE),
    *(Pair(name, *two) for name in [*FAMILIES][1:] for two in _THREE),
    *(Pair(DRIFTING, "filtered high", other) for other in ("residual", "filtered")),
    Pair(FIRST, "filtered", "control", calibrated=True),
    *(Pair(name, "filtered", "residual", calibrated=True) for name in FAMILIES),
)
TRENDS = tuple(Pair(name, "filtered", "residual") for name in (FIRST, SECOND))
"""Ratios that are correlated (Spearman) with the draw's frequency; corrected with `SECONDARY`."""
OF_DRAW = ["family", "cell", "calibrated", "draw"]


def logs(found: Iterable[Row]) -> pd.DataFrame:
    """Return the mean over seeds of the logarithm of an error: a row a draw, a column an arm.

    NaN where a seed is not there yet.
    """
    table = pd.DataFrame([*found])
    table["log"] = np.log(np.minimum(table["error"].fillna(np.inf), WORST * table["deviation"]))
    of_arm = (
        table.groupby([*OF_DRAW, "arm"], sort=False)["log"].agg(["mean", "count"]).reset_index()
    )
    whole = of_arm["count"] == of_arm.groupby([*OF_DRAW[:3], "arm"])["count"].transform("max")
    return of_arm[whole].pivot(index=OF_DRAW, columns="arm", values="mean")


def ratios(table: pd.DataFrame, pair: Pair) -> pd.Series:
    """Return the logarithm of the ratio of two arms by draw, of the draws that have both."""
    try:
        of = table.xs((pair.family, pair.cell, pair.calibrated))
        return (of[pair.arm] - of[pair.other]).dropna().sort_index()
    except KeyError:  # none of them has been run
        return pd.Series(dtype=float)


def effect(of: pd.Series) -> dict[str, Any]:
    """Return ratio, interval, draws below 1, n and p of the logarithms of a ratio."""
    within = scipy.stats.ttest_1samp(of, 0.0).confidence_interval(0.95)
    ratio, low, high = (math.exp(each) for each in (of.mean(), within.low, within.high))
    p = float(scipy.stats.wilcoxon(of).pvalue)
    return {"ratio": ratio, "low": low, "high": high, "below 1": sum(of < 0), "n": len(of), "p": p}


def trend(of: pd.Series) -> dict[str, Any]:
    """Return Spearman's correlation of a ratio with the draw's frequency, n and p."""
    at = [frequency(np.random.default_rng(draw)) for draw in of.index]
    found = scipy.stats.spearmanr(at, of)
    return {"rho": float(found.statistic), "n": len(of), "p": float(found.pvalue)}


def holm(several: pd.Series) -> pd.Series:
    """Return p values corrected for their number (Holm, 1979)."""
    ranked = several.sort_values()
    return (ranked * np.arange(len(ranked), 0, -1)).cummax().clip(upper=1.0)


def comparisons(found: Iterable[Row]) -> pd.DataFrame:
    """Return effect, corrected p and verdict of each comparison of which there are six draws."""
    table, lines = logs(found), list[dict[str, Any]]()
    effects = ("primary", PRIMARY, effect), ("secondary", SECONDARY, effect)
    for group, pairs, told in (*effects, ("secondary", TRENDS, trend)):
        for pair in pairs:
            if len(of := ratios(table, pair)) >= LEAST_DRAWS:
                lines.append({"group": group, **pair._asdict(), **told(of)})
    all_of = pd.DataFrame(lines, columns=COLUMNS)
    others = all_of["group"] == "secondary"
    all_of["p (Holm)"] = holm(all_of.loc[others, "p"])
    all_of["verdict"] = "undecided"
    decisive = all_of["p (Holm)"].fillna(all_of["p"]) < LEVEL
    for verdict, outside in (("better", all_of["high"] < 1), ("worse", all_of["low"] > 1)):
        all_of.loc[decisive & outside, "verdict"] = verdict
    return all_of


def verdicts(found: Sequence[Row]) -> str:
    """Return the comparisons in Markdown, and which of them are not run yet."""
    table, every, lines = logs(found), comparisons(found), list[list[str]]()
    later = dict[str, dict[str, None]]()  # families by the draws that they have
    told = {tuple(row[list(Pair._fields)]): row for _, row in every[every["rho"].isna()].iterrows()}
    for pair in (*PRIMARY, *SECONDARY):
        notes = {"GRU": pair.cell == "gru", "calibrated": pair.calibrated}
        notes["smoothed simulator"] = pair.other == SMOOTHED
        of = ", ".join([pair.family, *(note for note, holds in notes.items() if holds)])
        if (row := told.get(pair)) is None:
            planned = len(CALIBRATED if pair.calibrated else DRAWS)
            done = f"{len(ratios(table, pair))} of {planned} draws"
            later.setdefault(done, {})[of] = None
            continue
        ratio = f"{row['ratio']:.2f} ({row['low']:.2f} to {row['high']:.2f})"
        p = row["p" if pair in PRIMARY else "p (Holm)"]
        below = f"{row['below 1']:.0f} of {row['n']}"
        lines.append([of, f"{pair.arm} / {pair.other}", ratio, below, f"{p:.1g}", row["verdict"]])
    heads = ["family", "methods", "ratio of errors", "draws below 1", "p", "verdict"]
    commits = sorted({str(row["commit"])[:8] for row in found})
    said = f"\nMeasured at commit {', '.join(commits)}.\n"
    if later:
        said += "\nNot run yet, and undecided until then:\n\n"
        said += "".join(f"- {done}: {'; '.join(names)}.\n" for done, names in later.items())
    return page.table(heads, lines) + said


def errors(found: Sequence[Row]) -> pd.DataFrame:
    """Return the geometric mean over draws of each arm's error.

    In a share of the draws the simulator `helps`; in the others the package would try no hybrid,
    and the cut-off is that for networks alone.
    """
    plain = pd.DataFrame([row for row in found if row["arm"] == "simulator"])
    helps = plain.groupby(OF_DRAW[:3], sort=False)["helps"].agg(["size", "mean"])
    helps.columns = pd.Index(["draws", "helps"])
    means: pd.DataFrame = logs(found).groupby(level=OF_DRAW[:3], sort=False).mean()
    return pd.DataFrame(np.exp(means)).join(helps)


def main() -> None:
    """Run what is missing, or print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    doing = parser.add_mutually_exclusive_group(required=True)
    doing.add_argument("--run", action="store_true", help="run what is missing")
    doing.add_argument("--table", action="store_true", help="print the tables")
    parser.add_argument("--jobs", type=int, default=1, help="runs side by side, one thread each")
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args()
    if given.run:
        complete(given.out, rows(), given.jobs)
        return
    found = claims.read(given.out)
    for each in (errors(found).reset_index(), comparisons(found)):
        told = each.map(lambda value: f"{value:.3g}" if isinstance(value, float) else f"{value}")
        print(page.table([*map(str, told)], told.replace("nan", "").to_numpy().tolist()))


if __name__ == "__main__":
    main()
