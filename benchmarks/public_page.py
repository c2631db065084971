"""The page and the picture of `benchmarks.public`, made of the files of results that are there."""

from __future__ import annotations

import re
import statistics
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from benchmarks import against, driven, pendulum
from benchmarks.jax_settings import SETTINGS
from benchmarks.plain import Facts, errors_of, read, spread
from benchmarks.sets import SETS, Benchmark
from splitband.runtime.files import replacing

AGAINST = "against.png"

Array = npt.NDArray[np.float64]
Runs = dict[str, list[Facts]]
"""Runs by what was asked for."""
Points = dict[str, list[against.Point]]
"""Errors of libraries after some time, by benchmark."""


def write(out: Path) -> None:
    """Draw the picture and write the page beside the folder of results."""
    points = _points(out)
    if points:
        _save(_over_time(points), out / AGAINST)
    with replacing(out.with_suffix(".md")) as temporary:
        temporary.write_text(made(out), encoding="utf-8")


def made(out: Path) -> str:
    """The page as Markdown."""
    parts = [
        "# Public benchmarks",
        "Free runs over test files that nothing was fitted to or chosen by: fitted and chosen on "
        "the training file, warmed up on the first samples of each test file (50 unless said "
        "otherwise), simulated to its end; RMSE of the median of all trainings. `python -m "
        "benchmarks.public` makes this page. Other scores are those that their authors published.",
        "Our errors are the median over seeds of the whole command, and their range. A budget is "
        'wall time on two cores. Rows "before the clock" are of commit c5ae2c0, whose search was '
        "limited by work, one seed each.",
    ]
    for name, benchmark in SETS.items():
        runs = _runs(out, name)
        parts += _benchmark(benchmark, runs) if runs else []
    parts += _side_by_side(_points(out), out) + _pendulum(out) + _drawn(out)
    return "\n\n".join(parts) + "\n"


def _runs(out: Path, name: str, last: str = "") -> Runs:
    """Return the runs of a record by what was asked for."""
    paths = sorted(out.glob(f"{name}-*{last}.json"), key=lambda path: path.stem)
    found = [read(path) for path in paths if last or not path.stem.endswith(driven.ALONE)]
    return {facts["asked"]: facts["runs"] for facts in found}


def _benchmark(benchmark: Benchmark, runs: Runs) -> list[str]:
    """What the command came to, beside what others have published."""
    rows = [
        [
            f"`splitband compare` {asked}",
            _usual(of),
            *(_spread(each, benchmark.scale) for each in zip(*map(errors_of, of), strict=True)),
            str(len(of)),
            _used(of),
        ]
        for asked, of in runs.items()
    ]
    rows += [[method, "", *errors, "", ""] for method, errors in benchmark.published.items()]
    networks = "; ".join(
        f"{asked}: {of[0]['description']} ({of[0]['trainings']} trainings)"
        for asked, of in runs.items()
    )
    return [
        f"## {benchmark.title}",
        f"{benchmark.source[0].upper()}{benchmark.source[1:]}.",
        _lines(["", "recommended", *_heads(benchmark), "seeds", "seconds"], rows),
        f"{benchmark.title}, the recommended network of the first seed, {networks}.",
    ]


def _usual(runs: Sequence[Facts]) -> str:
    """Return what is recommended, the most frequent first."""
    names = [run["recommended"] for run in runs]
    return ", ".join(sorted({*names}, key=lambda name: (-names.count(name), name)))


def _spread(values: Iterable[float], scale: float = 1.0) -> str:
    """Return the median, and the range of several values."""
    of = [*values]
    found = spread(scale * value for value in of)
    text = f"{found['median']:.3g}"
    return text if len(of) == 1 else f"{text} ({found['lowest']:.3g} to {found['highest']:.3g})"


def _used(runs: Sequence[Facts]) -> str:
    seconds = [run["time"]["used_seconds"] for run in runs if "time" in run]
    return f"{statistics.median(seconds):.0f}" if seconds else ""


def _side_by_side(points: Points, out: Path) -> list[str]:
    """Return how the error falls inside one command, beside other libraries."""
    if not points:
        return []
    said = {point["library"]: point["version"] for of in points.values() for point in of}
    sizes = "; ".join(
        f"on {_title(name)}: {s.states} states, {s.units} + {s.units} tanh units, `rho_th` "
        f"{s.penalty:g}, {s.adam:,} iterations of Adam, then L-BFGS"
        for name, s in SETTINGS.items()
        if name in points
    )
    described = {
        against.SPLITBAND: "the plain command, Python's start and everything else included: a "
        "point is the model that lies in OUT then.",
        against.JAX_SYSID: "a state-space network that begins as its own linear model, trained on "
        f"the whole record in one piece in float64: {sizes}. The state at the beginning of a test "
        "file is estimated from its first samples by `learn_x0`. One training, looked at on its "
        "way; its linear model and compilation are included.",
        against.TSFAST: "`RNNLearner(dls, n_skip=50).fit_flat_cos(epochs)` with its own defaults, "
        "which are a GRU of 100 units that is told the input alone, and with the windows and "
        "batches that it has for the benchmark. Its rate falls to 0 at the end, so that it is "
        "trained anew for each time; the training alone counts.",
    }
    listed = "\n".join(f"- {name} {said[name]}: {described[name]}" for name in said)
    return [
        "## Inside one command",
        "Error on the test files over time, median and range over seeds (`python -m "
        "benchmarks.against` with the extra `bench`). Of splitband it is wall time on two quiet "
        "cores, of the others CPU time of one thread. All train on the whole training file, the "
        "first 50 samples of a test file do not count, and nothing is chosen by it.",
        listed,
        f"![Error over time inside one command]({out.name}/{AGAINST})",
    ]


def _title(name: str) -> str:
    return SETS[name].title if name in SETS else f"{name}, 20,000 samples, drawn"


def _pendulum(out: Path) -> list[str]:
    """The record on which a fixed recipe learns nothing."""
    rows = [
        [asked, str(run["seed"]), run["recommended"], str(run["trainings"]),
         _spread(errors_of(run)), _share(run["covers"]), f"{best}, {_spread(run['errors'][best])}"]
        for asked, runs in _runs(out, "pendulum").items()
        for run in sorted(runs, key=lambda run: int(run["seed"]))
        for best in [min(run["errors"], key=run["errors"].__getitem__)]
    ]  # fmt: skip
    if not rows:
        return []
    heads = ["asked for", "draw", "recommended", "trainings", "NRMSE", "in the interval",
             "lowest NRMSE"]  # fmt: skip
    return [
        "## A pendulum on which a fixed recipe learns nothing",
        f"Simulated: θ'' = -{pendulum.STIFFNESS} sin θ - {pendulum.DAMPING} θ', from "
        f"{pendulum.ANGLE} rad at rest, a sample every {pendulum.STEP} s with noise of "
        f"{pendulum.NOISE} rad; {pendulum.TRAINING:,} of {pendulum.SAMPLES:,} samples are trained "
        "on, the others are forecast by `splitband compare` without a hint (`python -m "
        "benchmarks.pendulum`). With windows of 400 samples and no search, training stays on a "
        "plateau. It is a development record: the search was made on it. NRMSE is 1 for the mean; "
        "intervals are for nine tenths of the samples.",
        _lines(heads, rows),
    ]


def _drawn(out: Path) -> list[str]:
    """Records of drawn systems, beside a GRU that has the same time to itself."""
    rows, ratios = [], dict[str, list[float]]()
    for name, samples in driven.RECORDS:
        stem = driven.stem(name, samples)
        alone = _runs(out, stem, driven.ALONE)
        for asked, runs in _runs(out, stem).items():
            grus = {run["seed"]: run for run in alone.get(asked, [])}
            ratios.setdefault(asked, []).extend(
                errors_of(run)[0] / errors_of(grus[run["seed"]])[0]
                for run in runs
                if run["seed"] in grus
            )
            rows.append([
                name, f"{samples:,}", asked, _usual(runs), _spread(errors_of(r)[0] for r in runs),
                _spread(errors_of(gru)[0] for gru in grus.values()) if grus else "", str(len(runs)),
            ])  # fmt: skip
    if not rows:
        return []
    means = "; ".join(
        f"{statistics.geometric_mean(of):.2f} {asked} ({len(of)} records)"
        for asked, of in ratios.items()
        if of
    )
    heads = ["system", "samples", "asked for", "recommended", "error", "GRU alone", "draws"]
    return [
        "## Records of drawn systems",
        "Error of a simulation of 2,000 more samples, as a share of their standard deviation, by "
        "the recommended method and by a GRU alone that has the same time to itself; median and "
        "range over draws on which nothing was chosen (`python -m benchmarks.driven`). The "
        "geometric mean of the ratios of the recommended method's error to that of the GRU is "
        f"{means}.",
        _lines(heads, rows),
    ]


def _share(share: float) -> str:
    return f"{100 * share:.0f} %"


def _heads(benchmark: Benchmark) -> list[str]:
    return [f"{column}, {benchmark.unit}" for column in benchmark.columns]


def _lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(table(heads, rows))


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
                (line,) = axis.step(times, median, where="post", label=library)
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


def _save(figure: Figure, path: Path) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
    plt.close(figure)


def _points(out: Path) -> Points:
    found = {name: against.points(against.path_of(out, name)) for name in (*SETS, against.DRAWN)}
    return {name: of for name, of in found.items() if of}


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown, line by line; words to the left, numbers to the right."""
    rows = [*rows]
    columns = zip(*rows, strict=True) if rows else [[]] * len(header)
    number = re.compile(r"(-?\d+(\.\d+)?( \(.*\))?)?")
    ruled = ["---:" if all(map(number.fullmatch, column)) else "---" for column in columns]
    return ["| " + " | ".join(line) + " |" for line in (header, ruled, *rows)]
