"""Make the picture of docs/results/benchmarks.md of the results that are there, and its tables.

    python -m benchmarks.page                              the picture; `docs.tables` has the tables
    python -m benchmarks.page --budget [--out FOLDER]      where the time of runs went

The results are those of `benchmarks.clock` and `benchmarks.against`.
"""

from __future__ import annotations

import argparse
import itertools
import re
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from benchmarks import against, claims, clock
from benchmarks.claims import Row
from benchmarks.commands import SHORT
from benchmarks.sets import SETS, Benchmark
from splitband.runtime.files import replacing

AGAINST = "against.png"
OUT = Path(__file__).parents[1] / "docs/results/benchmarks"
TABLES = {
    "benchmark-tanks5": "tanks5",
    "benchmark-tanks": "tanks",
    "benchmark-silverbox": "silverbox",
    "benchmark-time": None,
}
"""Tables by name, and their records; None for all records."""
GRU_ALONE = {
    "Bouc-Wen": 0.0804,
    "Wiener-Hammerstein": 0.1045,
    "motor": 0.4313,
    "tank that overflows": 0.1149,
    "Duffing": 0.0158,
}
"""Errors of a GRU that has the default's work to itself, at commit 8697b5f9 (`driven.json`)."""
LONGEST = 120
"""Seconds of the runs in the table below the picture."""

Array = npt.NDArray[np.float64]
Points = dict[str, list[against.Point]]
"""Errors of libraries after some time, by benchmark."""


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--budget", action="store_true", help="print where the time went alone")
    given = parser.parse_args()
    out = given.out
    if given.budget:
        print(budget(claims.read(out / clock.FILE)))
        return
    points = _points(out)
    if points:
        save(_over_time(points), out / AGAINST)


def table_of(name: str, out: Path = OUT) -> str:
    """Return one of `TABLES` in Markdown: of a public benchmark, or of what becomes of the time."""
    rows = claims.read(out / clock.FILE)
    record = TABLES[name]
    if record is None:
        return _all(rows)
    return _benchmark(SETS[record], [row for row in rows if row["record"] == record])


def of_libraries(out: Path = OUT) -> str:
    """Return the table of the picture's last errors, and where they were measured."""
    lines, ours = [], []
    for name, points in _points(out).items():
        benchmark = SETS.get(name)
        columns, scale = (benchmark.columns, benchmark.scale) if benchmark else (("test",), 1.0)
        ours += [point for point in points if point["library"] == against.SPLITBAND]
        for i, column in enumerate(columns):
            about = f"{_title(name)}, {column}" + (f", {benchmark.unit}" if benchmark else "")
            cells = [about]
            for library in against.LIBRARIES:
                last = _last([point for point in points if point["library"] == library])
                mark = claims.sign(last) if library == against.SPLITBAND else ""
                errors = spread((point["test_rmse"][i] for point in last), scale)
                cells.append(f"{errors}{mark}, n = {len(last)}" if last else "")
            lines.append(cells)
    return table(["error after two minutes", *against.LIBRARIES], lines) + claims.note(ours)


def _last(points: Iterable[against.Point]) -> list[against.Point]:
    """Return the last point of each seed that was asked for, or came, within the time."""
    found: dict[int, against.Point] = {}
    for point in sorted(points, key=lambda point: float(point["seconds"])):
        ends = point["library"] == against.SPLITBAND
        if ends or point.get("asked", int(point["seconds"])) <= LONGEST:
            found[point["seed"]] = point
    return [*found.values()]


def of_short(out: Path = OUT) -> str:
    """Return the errors on short records of drawn systems, beside a GRU alone, in Markdown."""
    rows = [row for row in claims.read(out / clock.FILE) if row["record"] in SHORT]
    runs = clock.groups(rows)
    budgets = sorted({asked for _, asked, _ in runs})
    lines, ratios = [], {asked: list[float]() for asked in budgets}
    for name, system in SHORT.items():
        cells = [system, f"{100 * GRU_ALONE[system]:.3g}"]
        for asked in budgets:
            of = runs.get((name, asked, 0), [])
            errors = [row["errors"][0] for row in of]
            ratios[asked] += [statistics.median(errors) / GRU_ALONE[system]] if errors else []
            cells += [spread(errors, 100) + claims.sign(of), clock.recommended(of), str(len(of))]
        lines.append(cells)
    means = [[f"{statistics.geometric_mean(ratios[asked]):.2f}", "", ""] for asked in budgets]
    lines.append(["geometric mean of the ratios to the GRU", "1", *itertools.chain(*means)])
    heads = [[f"`--budget {asked:g}s`, %", "recommended", "seeds"] for asked in budgets]
    of_heads = ["system", "GRU alone, %", *itertools.chain(*heads)]
    return table(of_heads, lines) + claims.note(rows)


def _benchmark(benchmark: Benchmark, rows: Sequence[Row]) -> str:
    """What the command came to, beside what others have published."""
    ours = [
        [
            f"`splitband compare --budget {asked:g}s`{_beside(beside)}{claims.sign(of)}",
            clock.recommended(of),
            *(spread(each, benchmark.scale) for each in zip(*_errors(of), strict=True)),
            str(len(of)),
        ]
        for (_, asked, beside), of in clock.groups(rows).items()
    ]
    others = [[method, "", *errors, ""] for method, errors in benchmark.published.items()]
    heads = ["", "recommended", *_heads(benchmark), "seeds"]
    return table(heads, ours + others) + claims.note(rows)


def _all(rows: Sequence[Row]) -> str:
    """What the command makes of its time, on all records."""
    lines = [
        [
            name + claims.sign(of),
            f"{asked:g} s{', busy' * bool(beside)}",
            spread(row["used"] for row in of),
            f"{100 * statistics.median(row['in_trainings'] for row in of):.0f} %",
            clock.recommended(of),
            "above" if name in SETS else spread(row["errors"][0] for row in of),
        ]
        for (name, asked, beside), of in clock.groups(rows).items()
    ]
    heads = ["record", "asked", "used (s)", "trains", "recommended", "error"]
    return table(heads, lines) + claims.note(rows)


def budget(rows: Sequence[Row]) -> str:
    """Return where the time of the command goes, as medians of the runs that say it.

    Seconds to the first training of a network; shares of the wall time of the parts that follow
    each other, `pages` being all that is written meanwhile, and of what is written at the end.
    `trains`: share of the time of all cores; `waits`: what is left of it after the first training.
    """
    parts = ("start", "simulators", "baselines", "rounds", "finals", "pages")
    lines = []
    for (name, asked, beside), every in clock.groups(rows).items():
        of = [row for row in every if row.get("parts")]
        if of:
            first = [row["first_training"] for row in of if row["first_training"] is not None]
            shares = {
                part: [row["parts"].get(part, 0) / row["took"] for row in of] for part in parts
            }
            shares["end"] = [1 - row["used"] / row["took"] for row in of]
            shares["trains"] = [row["in_trainings"] * row["used"] / row["took"] for row in of]
            began = [(row["first_training"] or row["took"]) / row["took"] for row in of]
            both = zip(began, shares["trains"], strict=True)
            shares["waits"] = [1 - before - trains for before, trains in both]
            found = [f"{100 * statistics.median(share):.0f} %" for share in shares.values()]
            about = f"{name}{', busy' * bool(beside)}", f"{asked:g} s", spread(first)
            lines.append([*about, *found])
    heads = ["record", "asked", "first training (s)", *parts, "end", "trains", "waits"]
    return table(heads, lines) + claims.note([row for row in rows if row.get("parts")])


def _beside(count: int) -> str:
    return f" beside {count} busy processes" if count else ""


def _errors(rows: Iterable[Row]) -> list[list[float]]:
    return [row["errors"] for row in rows]


def spread(values: Iterable[float], scale: float = 1.0) -> str:
    """Return the median, and the range of several values; nothing of none."""
    of = [scale * value for value in values]
    text = f"{statistics.median(of):.3g}" if of else ""
    return text if len(of) < 2 else f"{text} ({min(of):.3g} to {max(of):.3g})"


def _title(name: str) -> str:
    return SETS[name].title if name in SETS else f"{name}, 20,000 samples, drawn"


def _heads(benchmark: Benchmark) -> list[str]:
    return [f"{column}, {benchmark.unit}" for column in benchmark.columns]


def _over_time(points: Points) -> Figure:
    """Draw the error over time, a panel for each test file: the median and range over seeds."""
    panels = [(name, i) for name, of in points.items() for i in range(len(of[0]["test_rmse"]))]
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4 * columns, 3.4 * rows), squeeze=False)
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (name, i) in zip(axes.flat, panels, strict=False):
        benchmark = SETS.get(name)
        scale, unit = (benchmark.scale, f" ({benchmark.unit})") if benchmark else (1.0, "")
        title = f"{benchmark.title}, {benchmark.columns[i]}" if benchmark else _title(name)
        longest = max(point["seconds"] for point in points[name])
        for library in against.LIBRARIES:
            of = [point for point in points[name] if point["library"] == library]
            if of:
                times, errors = _steps(of, i, longest)
                lowest, median, highest = scale * np.quantile(errors, [0, 0.5, 1], axis=0)
                mark = claims.sign(of) if library == against.SPLITBAND else ""
                (line,) = axis.step(times, median, where="post", label=library + mark)
                axis.fill_between(
                    times, lowest, highest, step="post", alpha=0.15, color=line.get_color()
                )
        axis.set(title=title, xlabel="time in s", ylabel=f"test RMSE{unit}")
        axis.set_xscale("log")
        axis.set_yscale("log")
        for of_axis in (axis.xaxis, axis.yaxis):
            of_axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            of_axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            of_axis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3, which="both")
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=3)
    return figure


def _steps(of: Sequence[against.Point], i: int, longest: float) -> tuple[Array, Array]:
    """Return times, and for each seed the error of the last model before each of them."""
    seeds = [[p for p in of if p["seed"] == seed] for seed in sorted({p["seed"] for p in of})]
    first = max(min(p["seconds"] for p in each) for each in seeds)
    times = np.geomspace(first, max(longest, first), 200)
    errors = np.empty((len(seeds), len(times)))
    for errors_of_seed, each in zip(errors, seeds, strict=True):
        for point in sorted(each, key=lambda point: float(point["seconds"])):
            errors_of_seed[times >= point["seconds"] - 1e-9] = point["test_rmse"][i]
    return times, errors


def save(figure: Figure, path: Path) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
    plt.close(figure)


def _points(out: Path) -> Points:
    found = {name: against.points(against.path_of(out, name)) for name in (*SETS, against.DRAWN)}
    return {name: of for name, of in found.items() if of}


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown; words to the left, numbers to the right."""
    rows = [*rows]
    columns = zip(*rows, strict=True) if rows else [[]] * len(header)
    number = re.compile(r"(-?\d+(\.\d+)?( \(.*\))?)?")
    ruled = ["---:" if all(map(number.fullmatch, column)) else "---" for column in columns]
    return "".join(f"| {' | '.join(line)} |\n" for line in (header, ruled, *rows))


if __name__ == "__main__":
    main()
