"""What the default recipe is chosen by: the free-run error on the end of the training part.

    python -m benchmarks.recipe [--out docs/results/recipe] [--seeds 2] [--jobs 2] [VARIANT ...]

Each variant changes one thing of the recipe as it was before, with a highest learning rate of 3e-3;
the default is "rate 1e-2" now. A network is trained on three quarters of a training
part and forecasts the rest of it; no later sample is looked at. Each variant is a JSON file that is
made once; the page beside them, recipe.md, is made of all that are there.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from benchmarks.beyond import SYSTEMS
from benchmarks.comparing import forecasters, held_out, run_methods
from splitband.evaluation.plan import Plan
from splitband.evaluation.setup import Options, Setup
from splitband.evaluation.work import Work
from splitband.metrics import spread
from splitband.runtime.files import write_json
from splitband.training.recipes import constant_rate_settings

STUDIED = ("i, draw 0", "i, draw 1", "double-torsion record", "pendulum ii", "v", "vi")
HYBRID = ("gru", "filtered-gru-calibrated-conditioned")
LEARNED = ("gru", "split-gru-conditioned")
SECONDS = "seconds"

Found = dict[str, dict[str, list[float]]]
"""Of one variant: by system and method, in standard deviations of the training part, one a seed."""


def _training(setup: Setup, **changes: object) -> Setup:
    return replace(setup, settings=replace(setup.settings, **changes))  # type: ignore[arg-type]


def _window(setup: Setup, samples: int) -> Setup:
    """Windows of so many samples, and as many steps as before."""
    window = min(samples, 3 * setup.train // 5)
    old, new = (setup.train - w + 1 for w in (setup.settings.window, window))
    epochs = max(1, round(setup.settings.epochs * old / new))
    warmup = min(setup.settings.warmup, max(1, window // 3))
    return _training(setup, window=window, warmup=warmup, epochs=epochs)


def _steps(setup: Setup, factor: float) -> Setup:
    return _training(setup, epochs=max(1, round(factor * setup.settings.epochs)))


def _cutoff(setup: Setup, factor: float) -> Setup:
    """Another cut-off; above the old one with less down-sampling, as that one just allowed it."""
    cutoff, downsampling = setup.bands.cutoff, setup.bands.downsampling
    assert cutoff is not None
    assert downsampling is not None
    fewer = max(1, round(downsampling / max(1, factor)))
    return replace(setup, bands=replace(setup.bands, cutoff=factor * cutoff, downsampling=fewer))


def _hidden(setup: Setup, high: int, low: int) -> Setup:
    return replace(setup, sizes=replace(setup.sizes, hidden_high=high, hidden_low=low))


BASE = "rate 3e-3"
VARIANTS: dict[str, Callable[[Setup], Setup]] = {
    "rate 3e-3": lambda setup: setup,
    "hidden 16, 8": partial(_hidden, high=16, low=8),
    "hidden 64, 32": partial(_hidden, high=64, low=32),
    "windows of 150": partial(_window, samples=150),
    "windows of 400": partial(_window, samples=400),
    "half the steps": partial(_steps, factor=0.5),
    "twice the steps": partial(_steps, factor=2.0),
    "growth 0.3": partial(_training, growth=0.3),
    "no growth": partial(_training, growth=0.0),
    "no clipping": partial(_training, clip=None),
    "rate 6e-3": partial(_training, learning_rate=6e-3),
    "rate 1e-2": partial(_training, learning_rate=1e-2),
    "rate 2e-2": partial(_training, learning_rate=2e-2),
    "hidden 48, 24, rate 1e-2": lambda setup: _training(_hidden(setup, 48, 24), learning_rate=1e-2),
    "hidden 64, 32, rate 1e-2": lambda setup: _training(_hidden(setup, 64, 32), learning_rate=1e-2),
    "hidden 64, 32, no growth": lambda setup: _training(_hidden(setup, 64, 32), growth=0.0),
    "hidden 64, 32, rate 6e-3": lambda setup: _training(_hidden(setup, 64, 32), learning_rate=6e-3),
    "hidden 64, 32, no growth, rate 6e-3": lambda setup: _training(
        _hidden(setup, 64, 32), growth=0.0, learning_rate=6e-3
    ),
    "rate 1e-3": partial(_training, learning_rate=1e-3),
    "constant rate 1e-3": partial(_training, learning_rate=1e-3, one_cycle=False),
    "third of the cut-off": partial(_cutoff, factor=1 / 3),
    "3 times the cut-off": partial(_cutoff, factor=3.0),
    "filters of order 2": lambda setup: replace(setup, bands=replace(setup.bands, order=2)),
    "trained as in the paper": lambda setup: replace(
        setup, settings=constant_rate_settings(setup.train)
    ),
}


def measured(name: str, seeds: int, jobs: int) -> Found:
    """Train one variant on all systems."""
    found: Found = {}
    for system in STUDIED:
        record, train = SYSTEMS[system].record(), SYSTEMS[system].train
        methods = LEARNED if record.y_sim is None else HYBRID
        part, shorter = held_out(
            record, VARIANTS[name](_training(Options().decided(record, train), learning_rate=3e-3))
        )
        networks = forecasters(methods, shorter)
        plan = Plan.of(part, networks, shorter)
        runs = run_methods(plan, networks, range(seeds), Work(jobs))
        scale = float(spread(part.y).mean())
        found[system] = {m: [r.forecast_rmse / scale for r in of] for m, of in runs.items()}
        found[system][SECONDS] = [r.fit.seconds for of in runs.values() for r in of]
    return found


def page(found: dict[str, Found]) -> str:
    """All that was measured, in Markdown."""
    assert __doc__ is not None
    mean = {
        name: {system: _logarithm(of_system) for system, of_system in of_variant.items()}
        for name, of_variant in found.items()
    }
    lines = [
        f"# {__doc__.splitlines()[0]}\n",
        "Free-run RMSE on the last quarter of the training part from the rest of it, in standard "
        f"deviations of it: geometric mean over {' and '.join(LEARNED)}, where there is a "
        f"simulator {' and '.join(HYBRID)}, and over seeds. Last, the geometric mean over systems "
        "against that of the first row, and the time of a training, on a machine that had other "
        "work at times.\n",
        f"| variant | {' | '.join(STUDIED)} | to the first | fit (s) |",
        "|---|" + "---:|" * (len(STUDIED) + 2),
    ]
    for name, of_variant in found.items():
        seconds = [s for of_system in of_variant.values() for s in of_system[SECONDS]]
        ratio = math.exp(statistics.mean(mean[name][s] - mean[BASE][s] for s in STUDIED))
        cells = " | ".join(f"{math.exp(mean[name][system]):.3f}" for system in STUDIED)
        lines.append(f"| {name} | {cells} | {ratio:.2f} | {statistics.mean(seconds):.1f} |")
    return "\n".join(lines) + "\n"


def _logarithm(of_system: dict[str, list[float]]) -> float:
    errors = [e for method, of in of_system.items() if method != SECONDS for e in of]
    return statistics.mean(map(math.log, errors))


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help=", ".join(VARIANTS))
    parser.add_argument("--out", type=Path, default=Path("docs/results/recipe"))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in [*dict.fromkeys([BASE, *(arguments.variants or VARIANTS)])]:
        path = _path(arguments.out, name)
        if not path.exists():
            print(name, flush=True)
            write_json(path, measured(name, arguments.seeds, arguments.jobs))
    found = {
        name: json.loads(_path(arguments.out, name).read_text(encoding="utf-8"))
        for name in VARIANTS
        if _path(arguments.out, name).exists()
    }
    arguments.out.with_suffix(".md").write_text(page(found), encoding="utf-8")


def _path(out: Path, name: str) -> Path:
    return out / f"{name.replace(', ', '-').replace(' ', '-')}.json"


if __name__ == "__main__":
    main()
