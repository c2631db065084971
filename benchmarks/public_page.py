"""The page and the pictures of `benchmarks.public`, made of the files of results that are there."""

from __future__ import annotations

import json
import re
import statistics
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from benchmarks import against, pendulum
from benchmarks.jax_settings import SETTINGS
from benchmarks.sets import SETS, Benchmark
from splitband.evaluation.costs import FOR_TRAINING, STARTING
from splitband.evaluation.search import CORE_SECONDS
from splitband.runtime.files import replacing

DRIVEN = Path("docs/benchmarks/driven.json")
"""Results of `benchmarks.driven`."""
CORES = 2
"""Of the reference machine, which budgets are reckoned for."""
BUDGET, AGAINST = "budget.png", "against.png"
LONGER = 1.5
"""Budgets above this multiple of tsfast's longest training have none to be compared with."""
NARROW = 2.0
"""Highest to lowest error that an axis shows at least."""
IN_TRAINING = 0.8
"""Share of the time of these cores that a minute of these budgets counts as work: they are given as
work (`--effort`), so that the errors do not depend on the machine."""

Facts = dict[str, Any]
Found = dict[str, dict[float, Facts]]
"""Results of the command, by benchmark and budget in minutes."""
Points = dict[str, list[against.Point]]
"""Trainings of tsfast's network and of ours, by benchmark."""


def write(out: Path) -> None:
    """Draw the pictures and write the page beside the folder of results."""
    found, points = _found(out), _points(out)
    several = {
        name: of_budget for name, of_budget in found.items() if sum(map(bool, of_budget)) > 1
    }
    if several:
        _save(_over_budget(several), out / BUDGET)
    if points:
        _save(_over_time(points, found), out / AGAINST)
    with replacing(out.with_suffix(".md")) as temporary:
        temporary.write_text(made(out), encoding="utf-8")


def made(out: Path) -> str:
    """The page as Markdown."""
    found = _found(out)
    parts = [
        "# Public benchmarks",
        "Free runs over test files that nothing was fitted to or chosen by: fitted and chosen on "
        "the training file, warmed up on the first samples of each test file (50 unless said "
        "otherwise), simulated to its end; RMSE of the median of all trainings. `python -m "
        "benchmarks.public` makes this page. Other scores are those that their authors published.",
        "Work is limited, not time, so that the errors do not depend on the machine: "
        f"{', '.join(_limits(found))}, of a reference core. That is for training networks alone, "
        f"and as much as two cores of the reference machine do in {_listed(found)} minutes if "
        f"{IN_TRAINING:.0%} of the time go into it. `--budget 10m` plans "
        f"{_of_ten_minutes():.0f} s there, as it has to be done in time on a busy "
        "machine, too. The column of seconds is what it took on this machine, two cores; it is "
        "left out where the machine did other work.",
    ]
    for name, of_budget in found.items():
        parts += _benchmark(SETS[name], of_budget)
    if (out / BUDGET).exists():
        parts += [f"![Error over budget]({out.name}/{BUDGET})"]
    parts += _side_by_side(_points(out), out) + _pendulum(out) + _drawn()
    return "\n\n".join(parts) + "\n"


def errors_of(benchmark: Benchmark, facts: Facts) -> list[str]:
    """Of the recommended method, on the tests, in the benchmark's unit."""
    of_method = facts["methods"][facts["recommended"]]
    together = of_method.get("median_of_seeds") or of_method["mean_of_seeds"]  # before 0.3
    return _in_unit(benchmark, together["test_rmse"])


def _benchmark(benchmark: Benchmark, of_budget: dict[float, Facts]) -> list[str]:
    """What the command came to, beside what others have published."""
    rows = [
        [
            "`splitband compare`" + (f" {_effort(_work(facts))}" if minutes else ""),
            facts["recommended"],
            *errors_of(benchmark, facts),
            str(len(facts["methods"][facts["recommended"]]["seeds"])),
            "" if facts.get("disturbed") else f"{facts['seconds']:.0f}",
        ]
        for minutes, facts in sorted(of_budget.items())
    ]
    rows += [[method, "", *errors, "", ""] for method, errors in benchmark.published.items()]
    return [
        f"## {benchmark.title}",
        f"{benchmark.source[0].upper()}{benchmark.source[1:]}.",
        _lines(["", "recommended", *_heads(benchmark), "seeds", "seconds"], rows),
        f"{benchmark.title}, the recommended network: "
        + "; ".join(
            f"{_limit(_work(facts))} "
            f"{facts['methods'][facts['recommended']].get('description', '')}"
            for _, facts in sorted(of_budget.items())
        )
        + ".",
    ]


def _work(facts: Facts) -> float:
    """Return the limit of a result, in seconds of a reference core."""
    work: float = facts["settings"]["search"]["core_seconds"]
    return work


def _effort(work: float) -> str:
    return f"`--effort {work / 60:g}m`"


def _limit(work: float) -> str:
    return "by default" if work == CORE_SECONDS else f"with {_effort(work)}"


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
        "defaults did. With all of it, the dotted lines of the picture are `splitband compare "
        "--effort` from above.",
    ]
    found = _found(out)
    for name, of_set in points.items():
        parts += [f"{SETS[name].title}:", _trainings(SETS[name], of_set)]
        parts += _with_search(SETS[name], found.get(name, {}), of_set)
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
            "and so much work, on one core; time is that of the whole call."
        )
    return ["\n".join(listed)] if listed else []


def _with_search(
    benchmark: Benchmark, of_budget: dict[float, Facts], points: Iterable[against.Point]
) -> list[str]:
    """Whole commands beside the training of tsfast's network that took about as long, in words."""
    theirs = [point for point in points if point["library"] == "tsfast"]
    if not theirs:
        return []
    longest = max(point["cpu_seconds"] for point in theirs)
    said = []
    for _, facts in sorted(of_budget.items()):
        # By default a budget is in seconds of a core, of which a fifth of a command's time is not.
        seconds = facts["settings"]["search"]["core_seconds"] / IN_TRAINING
        near = min(theirs, key=lambda point: abs(point["cpu_seconds"] - seconds))
        if seconds > LONGER * longest:
            continue
        said.append(
            (
                seconds,
                f"{seconds / 60:.2g} CPU minutes "
                f"({_limit(_work(facts))}): "
                f"{' / '.join(errors_of(benchmark, facts))}, tsfast after "
                f"{near['cpu_seconds'] / 60:.2g}: "
                f"{' / '.join(_in_unit(benchmark, near['test_rmse']))}",
            )
        )
    if not said:
        return []
    listed = "\n".join(f"- {text}" for _, text in sorted(said))
    return [
        "With the search included the lead is smaller. `splitband compare` by its budget, and the "
        f"training of tsfast's network that took about as long ({benchmark.unit}; one run each):",
        listed,
    ]


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
    draws = [_read(path) for path in sorted(out.glob("pendulum-*.json"))]
    if not draws:
        return []
    rows = []
    for facts in draws:
        name, nrmse = facts["recommended"], facts["nrmse"]
        seeds = len(facts["methods"][name]["seeds"])
        best = min(nrmse, key=nrmse.__getitem__)
        rows.append(
            [
                str(facts["draw"]),
                f"{name}, {seeds} seed{'s' if seeds > 1 else ''}",
                f"{nrmse[name]:.2f}",
                f"{100 * facts['methods'][name]['interval']['covers']:.0f} %",
                f"{best}, {nrmse[best]:.2f}",
                f"{facts['cpu_seconds']:.0f}",
            ]
        )
    heads = ["draw", "recommended", "NRMSE", "in the interval", "lowest NRMSE", "CPU seconds"]
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


def _drawn() -> list[str]:
    """Records of drawn systems, the short ones beside a GRU that has the same work to itself."""
    if not DRIVEN.exists():
        return []
    rows: dict[tuple[str, int, int], dict[float, Facts]] = {}
    for name, of_system in _read(DRIVEN).items():
        for facts in of_system:
            rows.setdefault((name, facts["seed"], facts["samples"]), {})[facts["work"]] = facts
    works = sorted({work for of_record in rows.values() for work in of_record})
    lines, ratios = [], dict[float, list[float]]()
    for (name, _, samples), of_record in rows.items():
        alone = next((of["gru"]["gru"] for of in of_record.values() if "gru" in of), None)
        cells = [name, f"{samples:,}", "" if alone is None else _percent(alone)]
        for work in works:
            if work not in of_record:
                cells.append("")
                continue
            best = of_record[work]["default"]["recommended"]
            error = of_record[work]["default"][best]
            cells.append(f"{_percent(error)}, {best}")
            if alone is not None:
                ratios.setdefault(work, []).append(error / alone)
        lines.append(cells)
    means = " and ".join(
        f"{statistics.geometric_mean(of_work):.2f} {_limit(work)} ({len(of_work)} records)"
        for work, of_work in ratios.items()
    )
    return [
        "## Records of drawn systems",
        "Error of a simulation of 2,000 more samples, as a share of their standard deviation, by "
        "the recommended method and by a GRU alone that has the default's work to itself. Systems "
        "and seeds on which nothing was chosen (`python -m benchmarks.driven --alone`). The "
        "geometric mean of the ratios of the recommended method's error to that of the GRU is "
        f"{means}.",
        _lines(["system", "samples", "GRU alone", *map(_limit, works)], lines),
    ]


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _in_unit(benchmark: Benchmark, errors: Iterable[float]) -> list[str]:
    return [f"{benchmark.scale * error:.3g}" for error in errors]


def _heads(benchmark: Benchmark) -> list[str]:
    return [f"{column}, {benchmark.unit}" for column in benchmark.columns]


def _lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(table(heads, rows))


def _over_budget(found: Found) -> Figure:
    """Error over budget, a panel for each benchmark."""
    figure, axes = plt.subplots(1, len(found), figsize=(5.5 * len(found), 4), squeeze=False)
    for axis, (name, of_budget) in zip(axes[0], found.items(), strict=True):
        benchmark = SETS[name]
        budgets = sorted(minutes for minutes in of_budget if minutes)
        for i, column in enumerate(benchmark.columns):
            errors = [float(errors_of(benchmark, of_budget[minutes])[i]) for minutes in budgets]
            (line,) = axis.loglog(budgets, errors, "o-", label=column)
            if 0 in of_budget:
                default = float(errors_of(benchmark, of_budget[0])[i])
                at, color = _minutes(of_budget[0]), line.get_color()
                axis.loglog([at], [default], "*", ms=12, mfc="white", color=color, zorder=3)
        axis.set(title=benchmark.title, xlabel="effort (minutes of two cores; star: the default)")
        axis.set_xticks(budgets, [f"{minutes:g}" for minutes in budgets])
        low, high = axis.get_ylim()
        if high < NARROW * low:  # a change of a hundredth is not to look like a fall
            axis.set_ylim((low * high / NARROW) ** 0.5, (low * high * NARROW) ** 0.5)
        _for_errors(axis, benchmark)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=len(benchmark.tests))
    figure.tight_layout()
    return figure


def _minutes(facts: Facts) -> float:
    """Of two cores of the reference machine, for what a command reckons with."""
    seconds: float = facts["settings"]["search"]["core_seconds"]
    return seconds / (60 * CORES * IN_TRAINING)


def _over_time(points: Points, found: Found) -> Figure:
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
        whole = {
            facts["settings"]["search"]["core_seconds"] / IN_TRAINING / 60: facts
            for facts in found.get(name, {}).values()
        }
        errors = [float(errors_of(benchmark, whole[minutes])[i]) for minutes in sorted(whole)]
        axis.loglog(
            sorted(whole), errors, ".:", color="grey", label="splitband compare, search included"
        )
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


def _limits(found: Found) -> list[str]:
    """Return the limits of the results in words."""
    works = sorted({_work(facts) for of_budget in found.values() for facts in of_budget.values()})
    return [f"{work:.0f} s {_limit(work)}" for work in works]


def _of_ten_minutes() -> float:
    """Return the work that the command plans for ten minutes of the reference machine."""
    return FOR_TRAINING * (600 - STARTING) * CORES


def _listed(found: Found) -> str:
    """Return the same in minutes of two cores."""
    every = {_minutes(facts) for of_budget in found.values() for facts in of_budget.values()}
    return " and ".join(f"{minutes:g}" for minutes in sorted(every))


def _found(out: Path) -> Found:
    found = {name: [_read(path) for path in sorted(out.glob(f"{name}-*.json"))] for name in SETS}
    return {name: {facts["minutes"]: facts for facts in of} for name, of in found.items() if of}


def _points(out: Path) -> Points:
    """The means over seeds, by time and library; what was over before a time, once."""
    points = {}
    for name in SETS:
        path = against.path_of(out, name)
        seeds: dict[tuple[str, float], list[against.Point]] = {}
        for point in _read(path)["points"] if path.exists() else ():
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


def _read(path: Path) -> Facts:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown, line by line; words to the left, numbers to the right."""
    rows = [*rows]
    columns = zip(*rows, strict=True) if rows else [[]] * len(header)
    number = re.compile(r"(-?\d+(\.\d+)?( \(.*\))?)?")
    ruled = ["---:" if all(map(number.fullmatch, column)) else "---" for column in columns]
    return ["| " + " | ".join(line) + " |" for line in (header, ruled, *rows)]
