"""The page and the picture of `benchmarks.public`, made of the files of results that are there."""

from __future__ import annotations

import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from benchmarks import against, driven, pendulum
from benchmarks.jax_settings import SETTINGS
from benchmarks.plain import Facts, errors_of, read, spread
from benchmarks.sets import SETS, Benchmark
from splitband.runtime.files import replacing

AGAINST = "against.png"

Runs = dict[str, list[Facts]]
"""Runs by what was asked for."""
Points = dict[str, list[against.Point]]
"""Trainings of tsfast's network and of ours, by benchmark."""


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
    """Trainings of tsfast's network and of ours."""
    if not points:
        return []
    said = {point["library"]: point["version"] for of in points.values() for point in of}
    peers = [peer for peer in ("tsfast", "jax-sysid") if peer in said]
    parts = [
        f"## Training time, beside {' and '.join(peers)}",
        "Error on the test files against CPU time of the training alone, measured side by side on "
        "one machine that did other work too, one process of one thread each; `python -m "
        "benchmarks.against` with the extra `bench`. All train on the whole training file, "
        "the first 50 samples of a test file do not count, and nothing is chosen by it.",
        f"- tsfast {said.get('tsfast', '')}: `RNNLearner(dls, n_skip=50).fit_flat_cos(epochs)` "
        "with its own defaults, which are a GRU of 100 units that is told the input alone, and "
        "with the windows and batches that it has for the benchmark. Its learning rate falls to 0 "
        "at the end, so that it is trained anew for each time.\n"
        f"- splitband {said.get('splitband', '')}: the network that `compare` finds on the last "
        "quarter of the training file, warmed up on the first 50 samples: "
        + "; ".join(_network(name) for name in points)
        + ". One training, looked at on its way.",
        *_further(said),
        "What finding our network costs is not in these times, nor is what finding tsfast's "
        "defaults did.",
    ]
    for name, of_set in points.items():
        parts += [f"{SETS[name].title}:", _trainings(SETS[name], of_set)]
    return [*parts, f"![Error over CPU time of the training]({out.name}/{AGAINST})"]


def _further(said: Mapping[str, str]) -> list[str]:
    """Describe the settings of the curves that are there beside the GRUs."""
    listed = []
    if "jax-sysid" in said:
        sizes = "; ".join(
            f"on {SETS[name].title}: {s.states} states, {s.units} + {s.units} tanh units, `rho_th` "
            f"{s.penalty:g}, {s.adam:,} iterations of Adam, then L-BFGS"
            for name, s in SETTINGS.items()
        )
        listed.append(
            f"- jax-sysid {said['jax-sysid']}: a state-space network that begins as its own linear "
            f"model, trained on the whole record in one piece in float64: {sizes}. The state at "
            "the beginning of a test file is estimated from its first samples by `learn_x0`. One "
            "training, looked at on its way; time includes the linear model and compilation."
        )
    if against.STATE_SPACE in said:
        sizes = "; ".join(
            f"on {SETS[name].title}: {states} states, {units} + {units} tanh units, windows of "
            f"{window} samples, penalty {penalty:g}"
            for name, (states, units, window, penalty) in against.STATES.items()
        )
        listed.append(
            f"- {against.STATE_SPACE} {said[against.STATE_SPACE]}: `sb.StateSpace`, which begins "
            f"as the linear model, trained by L-BFGS alone: {sizes}."
        )
    if against.SEARCHED in said:
        listed.append(
            f"- {against.SEARCHED} {said[against.SEARCHED]}: `compare` with its default methods "
            "by its clock, on one core; time is that of the whole call."
        )
    return ["\n".join(listed)] if listed else []


def _network(name: str) -> str:
    units, window, epochs, most = against.FOUND[name]
    last = "for as long as there is time" if most == against.ENDLESS else f"{most} iterations"
    return (
        f"on {SETS[name].title}: {units} units, windows of {window} samples, {epochs} epochs of "
        f"Adam, then L-BFGS, {last}"
    )


def _trainings(benchmark: Benchmark, points: Iterable[against.Point]) -> str:
    rows = [
        [
            point["library"],
            f"{point['cpu_seconds'] / 60:.2g}",
            *_in_unit(benchmark, point["test_rmse"]),
            str(point["seeds"]),
            f"{point[what]:,} {words}{', then it settled' if 'settled' in point else ''}",
        ]
        for point in points
        for what, words in (("steps", "of Adam"), ("iterations", "of L-BFGS"))
        if what in point
    ] + [
        [
            point["library"],
            f"{point['cpu_seconds'] / 60:.2g}",
            *_in_unit(benchmark, point["test_rmse"]),
            str(point["seeds"]),
            point["recommended"],
        ]
        for point in points
        if "recommended" in point
    ]
    return _lines(["", "CPU minutes", *_heads(benchmark), "seeds", "steps"], rows)


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


def _in_unit(benchmark: Benchmark, errors: Iterable[float]) -> list[str]:
    return [f"{benchmark.scale * error:.3g}" for error in errors]


def _heads(benchmark: Benchmark) -> list[str]:
    return [f"{column}, {benchmark.unit}" for column in benchmark.columns]


def _lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(table(heads, rows))


def _over_time(points: Points) -> Figure:
    """Error over CPU time, a panel for each test file."""
    panels = [(name, i) for name in points for i in range(len(SETS[name].tests))]
    figure, axes = plt.subplots(
        1, len(panels), figsize=(4 * len(panels), 4), squeeze=False, sharey=len(points) == 1
    )
    for axis, (name, i) in zip(axes[0], panels, strict=True):
        benchmark = SETS[name]
        for library, label in against.CURVES.items():
            of = [point for point in points[name] if point["library"] == library]
            if not of:
                continue
            errors = [benchmark.scale * point["test_rmse"][i] for point in of]
            axis.loglog([point["cpu_seconds"] / 60 for point in of], errors, "o-", label=label)
        axis.set(
            title=f"{benchmark.title}, {benchmark.columns[i]}",
            xlabel="CPU time (minutes of a core)",
        )
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        _for_errors(axis, benchmark)
    figure.tight_layout(rect=(0, 0.08, 1, 1))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=6)
    return figure


def _for_errors(axis: Axes, benchmark: Benchmark) -> None:
    axis.set_ylabel(f"test RMSE ({benchmark.unit})")
    axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3, which="both")


def _save(figure: Figure, path: Path) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
    plt.close(figure)


def _points(out: Path) -> Points:
    """The means over seeds, by time and library; what was over before a time, once."""
    points = {}
    for name in SETS:
        path = against.path_of(out, name)
        seeds: dict[tuple[str, float], list[against.Point]] = {}
        for point in read(path)["points"] if path.exists() else ():
            seeds.setdefault((point["library"], point["minutes"]), []).append(point)
        once: dict[tuple[str, ...], against.Point] = {}
        for mean in sorted(map(_mean, seeds.values()), key=lambda p: p["minutes"]):
            errors = (mean["library"], *map(str, mean["test_rmse"]))
            if errors in once:
                once[errors]["settled"] = True
            once.setdefault(errors, mean)
        if once:
            points[name] = sorted(once.values(), key=lambda p: (p["minutes"], p["library"]))
    return points


def _mean(seeds: list[against.Point]) -> against.Point:
    """Of trainings by one library for one time."""
    errors = zip(*(point["test_rmse"] for point in seeds), strict=True)
    return seeds[0] | {
        "cpu_seconds": statistics.mean(point["cpu_seconds"] for point in seeds),
        "test_rmse": [statistics.mean(of_test) for of_test in errors],
        "seeds": len(seeds),
    }


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown, line by line; words to the left, numbers to the right."""
    rows = [*rows]
    columns = zip(*rows, strict=True) if rows else [[]] * len(header)
    number = re.compile(r"(-?\d+(\.\d+)?( \(.*\))?)?")
    ruled = ["---:" if all(map(number.fullmatch, column)) else "---" for column in columns]
    return ["| " + " | ".join(line) + " |" for line in (header, ruled, *rows)]
