"""What the default command reaches on the paper's systems, and what each ingredient is worth.

    python -m benchmarks.beyond [--out docs/results/beyond] [--seeds 5] [--jobs 2] [SYSTEM ...]

Each system is two JSON files that are made once: what `compare` does by default (-default), and the
ingredients one by one, trained by the default recipe, nothing searched. The page beside them,
beyond.md, is made of all that are there. Every choice is made on training samples.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.comparing import compared, forecasters, run_methods
from reproduction.settings import HYBRID, LEARNING_BASED
from reproduction.systems import MassSpringOracle, double_torsion_pendulum
from splitband.data import Record, double_torsion, drill_string
from splitband.data.named import double_mass_spring, van_der_pol
from splitband.evaluation.plan import Plan
from splitband.evaluation.protocols import Run
from splitband.evaluation.run import compare
from splitband.evaluation.setup import Options, Setup, default_names
from splitband.evaluation.work import Work
from splitband.forecasters.names import with_variants
from splitband.metrics import rmse
from splitband.report.results import results
from splitband.runtime.files import write_json
from splitband.simulators import run as simulate
from splitband.simulators.calibration import samples_needed
from splitband.simulators.named import van_der_pol_simulator
from splitband.training.recipes import constant_rate_settings

DRAWS = 20
DEFAULT = "-default"
"""What the files end in that say what `compare` does by default."""
Array = npt.NDArray[np.float64]
Facts = dict[str, Any]


@dataclass(frozen=True)
class System:
    """A record, its training part, and what the paper reached."""

    record: Callable[[], Record]
    train: int
    column: str = ""
    paper: str = ""


def _van_der_pol() -> Record:
    """With more of its simulator than the record is long, for the clock."""
    record = van_der_pol()
    samples = samples_needed(len(record), len(record))
    y_sim = simulate(van_der_pol_simulator(), samples, record.sampling_time)
    return replace(record, y_sim=y_sim[: len(record)], beyond=y_sim[len(record) :])


SYSTEMS = {
    **{f"i, draw {d}": System(partial(double_mass_spring, seed=d), 250) for d in range(DRAWS)},
    "double-torsion record": System(double_torsion, 600, "ii", "0.331"),
    **{
        f"pendulum {row}": System(partial(double_torsion_pendulum, row), 600, row)
        for row in ("ii", "iii", "iv")
    },
    "v": System(_van_der_pol, 600, "v", "0.347"),
    "vi": System(drill_string, 2000, "vi", "0.487"),
}


def by_default(name: str, jobs: int) -> Facts:
    """Everything that `compare` writes by default, its search for a training included."""
    system = SYSTEMS[name]
    record = system.record()
    comparison = compare(record, system.train, work=Work(jobs))
    facts = results(comparison)
    if name.startswith("i,"):
        (oracle,) = _oracle(record, comparison.setup)
        facts["oracle"] = {"total_rmse": oracle.total_rmse, "forecast_rmse": oracle.forecast_rmse}
    return facts


def _oracle(record: Record, setup: Setup) -> list[Run]:
    """What the true masses and springs come to."""
    methods = [MassSpringOracle()]
    return run_methods(Plan.of(record, methods, setup), methods)["oracle"]


def measured(name: str, seeds: int, jobs: int) -> Facts:
    """The default methods by the default recipe, with variants that leave an ingredient out."""
    system = SYSTEMS[name]
    record = system.record()
    hybrid = record.y_sim is not None
    many = name.startswith("i,")
    base = ["filtered-gru"] if hybrid else ["split-gru"]
    methods = default_names(hybrid)
    if not many:
        plain = ["residual-gru"] if hybrid else []
        methods = [*dict.fromkeys([*methods, *with_variants(base, hybrid, True), *plain])]
    setup = Options().decided(record, system.train)
    chosen = range(1 if many else seeds)
    comparison = compared(record, methods, setup, chosen, jobs)
    facts = results(comparison)
    facts["same samples"] = {
        method: {
            "from_start": statistics.mean(_after(record, setup, r.from_start.y) for r in of_method),
            "forecast": statistics.mean(_after(record, setup, r.ahead) for r in of_method),
        }
        for method, of_method in comparison.runs.items()
        if of_method[0].fit.losses
    }
    if many:
        (oracle,) = _oracle(record, setup)
        facts["oracle"] = {"total_rmse": oracle.total_rmse, "forecast_rmse": oracle.forecast_rmse}
    else:
        column = (LEARNING_BASED | HYBRID)[system.column].setup(record.sampling_rate, "gru")
        left_out = {
            "the paper's recipe": replace(setup, settings=constant_rate_settings(system.train)),
            "the paper's cut-off": replace(setup, bands=column.bands),
        }
        best = default_names(hybrid)[1:3]
        facts["variants"] = {
            f"{method}, {name}": [run.total_rmse for run in of_method]
            for name, variant in left_out.items()
            for method, of_method in run_methods(
                Plan.of(record, (), variant), forecasters(best, variant), chosen[:3], Work(jobs)
            ).items()
        }
    return facts


def _after(record: Record, setup: Setup, predicted: Array) -> float:
    """RMSE over the samples after the training part, whenever the prediction began."""
    steps = len(record) - setup.train
    return rmse(record.truth[-steps:], predicted[-steps:])


def page(found: dict[str, Facts], defaults: dict[str, Facts]) -> str:
    """All that was measured, in Markdown."""
    parts = [
        __doc__.strip().splitlines()[0],
        _made({**found, **{f"{name}, default": facts for name, facts in defaults.items()}}),
        _recommended(defaults),
        _draws(defaults),
        _shares(found),
        _right_edge(found),
    ]
    return "# Beyond the paper\n\n" + "\n\n".join(part for part in parts if part) + "\n"


def _made(found: dict[str, Facts]) -> str:
    """By which commits: what has changed since then is not in the figures."""
    commits = sorted({str(facts["environment"]["commit"]) for facts in found.values()})
    return f"The files behind it were made at commit {', '.join(commits)}."


def _recommended(found: dict[str, Facts]) -> str:
    lines = [
        "## The recommended method\n",
        "What the default command does. "
        "Total RMSE from the start and of the forecast, mean over seeds, and from the start that "
        "of the median of their predictions, which is what a user gets; *best row* is that of all "
        "methods compared which did best on the test samples, which nobody knows before; *ratio* "
        "is the recommended one's over it. Older files have the mean of the predictions.\n",
        "| system | recommended | from the start | forecast | seeds together | the paper's best "
        "| best row | ratio | in interval |",
        "|---|---|---:|---:|---:|---:|---|---:|---:|",
    ]
    for name, facts in found.items():
        if "oracle" in facts:
            continue
        methods = facts["methods"]
        chosen = methods[facts["recommended"]]
        best = min(methods, key=lambda m: _handed_out(methods[m]))
        ratio = _handed_out(chosen) / _handed_out(methods[best])
        lines.append(
            f"| {name} | {facts['recommended']} | {_mean(chosen):.3f} "
            f"| {chosen['forecast_rmse_mean']:.3f} "
            f"| {_handed_out(chosen):.3f} "
            f"| {SYSTEMS[name].paper} "
            f"| {best} {_handed_out(methods[best]):.3f} | {ratio:.2f} "
            f"| {_interval(chosen)['covers']:.0%} |"
        )
    return "\n".join(lines)


def _draws(found: dict[str, Facts]) -> str:
    draws = [facts for facts in found.values() if "oracle" in facts]
    if not draws:
        return ""
    errors = [_handed_out(facts["methods"][facts["recommended"]]) for facts in draws]
    oracle = [facts["oracle"]["total_rmse"] for facts in draws]
    ratios = [error / best for error, best in zip(errors, oracle, strict=True)]
    covers = [_interval(facts["methods"][facts["recommended"]])["covers"] for facts in draws]
    return (
        f"## System (i), {len(draws)} noise draws\n\n"
        f"The recommended method's total RMSE has a median of {statistics.median(errors):.3f}, the "
        f"oracle's (least squares on the true form) {statistics.median(oracle):.3f}: "
        f"{statistics.median(errors) / statistics.median(oracle):.2f} times. Draw by draw the "
        f"ratio is {statistics.median(ratios):.2f} in the median and {max(ratios):.2f} at worst. "
        f"Intervals hold {statistics.mean(covers):.0%} of what is measured."
    )


def _shares(found: dict[str, Facts]) -> str:
    lines = [
        "## Each ingredient\n",
        "| system | method | total RMSE | seeds |",
        "|---|---|---:|---:|",
    ]
    for name, facts in found.items():
        if "oracle" in facts:
            continue
        rows: dict[str, list[float]] = {}
        for method, of_method in facts["methods"].items():
            if of_method.get("final_loss"):
                rows[method] = of_method["total_rmse"]
                rows[f"{method}, its seeds together"] = [_handed_out(of_method)]
        rows |= facts["variants"]
        lines += [
            f"| {name} | {method} | {statistics.mean(values):.3f}"
            f"{f' ({statistics.stdev(values):.2g})' if len(values) > 1 else ''} | {len(values)} |"
            for method, values in rows.items()
        ]
    return "\n".join(lines)


def _right_edge(found: dict[str, Facts]) -> str:
    lines = [
        "## Warm-ups at the right edge\n",
        "RMSE over the samples after the training part: of the run that began at the start of the "
        "record, and of the one that warmed up on the last training samples, whose filtered end is "
        "the distorted one. Mean over seeds.\n",
        "| system | method | from the start | forecast | ratio |",
        "|---|---|---:|---:|---:|",
    ]
    ratios = []
    for name, facts in found.items():
        for method, sides in facts["same samples"].items():
            ratios.append(sides["forecast"] / sides["from_start"])
            if "oracle" not in facts:
                lines.append(
                    f"| {name} | {method} | {sides['from_start']:.3f} | {sides['forecast']:.3f} "
                    f"| {ratios[-1]:.2f} |"
                )
    geometric = statistics.geometric_mean(ratios)
    lines.append(f"\nOver all of these and the draws of (i), {geometric:.2f} on geometric average.")
    return "\n".join(lines)


def _interval(facts: Facts) -> Facts:
    """Of a method; the results of older runs call it a band."""
    found: Facts = facts.get("interval") or facts["band"]
    return found


def _handed_out(facts: Facts) -> float:
    """The error of the median of the seeds' predictions, or of their mean in old files."""
    found = facts.get("median_of_seeds") or facts.get("mean_of_seeds")
    return float((found or {"total_rmse": _mean(facts)})["total_rmse"])


def _mean(facts: Facts) -> float:
    return float(facts["total_rmse_mean"])


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("systems", nargs="*", metavar="SYSTEM", help=f"out of {', '.join(SYSTEMS)}")
    parser.add_argument("--out", type=Path, default=Path("docs/results/beyond"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.systems or SYSTEMS:
        for path, made in (
            (_path(arguments.out, name, DEFAULT), partial(by_default, name, arguments.jobs)),
            (_path(arguments.out, name), partial(measured, name, arguments.seeds, arguments.jobs)),
        ):
            if not path.exists():
                print(path.stem, flush=True)
                write_json(path, made())
    found, defaults = (
        {
            name: json.loads(_path(arguments.out, name, kind).read_text(encoding="utf-8"))
            for name in SYSTEMS
            if _path(arguments.out, name, kind).exists()
        }
        for kind in ("", DEFAULT)
    )
    (arguments.out.parent / "beyond.md").write_text(page(found, defaults), encoding="utf-8")


def _path(out: Path, name: str, kind: str = "") -> Path:
    return out / f"{name.replace(', ', '-').replace(' ', '-')}{kind}.json"


if __name__ == "__main__":
    main()
