"""What `tune` writes: settings, results as JSON, and pictures."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from splitband.evaluation.trials import StudyTrial
from splitband.evaluation.tuned import FILE
from splitband.evaluation.tuning import Tuning
from splitband.report import pictures
from splitband.report.results import environment
from splitband.runtime.outputs import staged, write_facts

_DONE, _BEST, _GIVEN_UP, _DEFAULT = "#0072B2", "#009E73", "0.6", "#D55E00"
_ERROR = "held-out error (channels scaled to deviation 1)"


def save(tuning: Tuning, folder: Path, facts: dict[str, Any] | None = None) -> None:
    """Write settings.json, the pictures and results.json in place of an earlier result.

    On an error none of them is written. `facts` go into results.json before the others.
    """
    with staged(folder) as new:
        tuning.tuned.save(new / FILE)
        pictures.save(history(tuning), new / "history.png")
        pictures.save(importances(tuning), new / "importances.png")
        write_facts(new, (facts or {}) | results(tuning))


def results(tuning: Tuning) -> dict[str, Any]:
    """What `tune` writes to results.json."""
    default = tuning.default
    known = environment()
    known["versions"] |= {"optuna": version("optuna")}
    return {
        "record": {"name": tuning.record.name, "samples": len(tuning.record)},
        "settings": tuning.setup.as_json(),
        "best": tuning.best.number,
        "default": None if default is None else default.number,
        "improved": tuning.improved,
        "held_out": tuning.best.value,
        "held_out_default": None if default is None else default.value,
        "importances": dict(tuning.importances),
        "trials": [_trial(each) for each in tuning.attempts],
        "environment": known,
    }


def history(tuning: Tuning) -> Figure:
    """The held-out error of every trial in their order, and the lowest one so far."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    ax = figure.subplots()
    done = [each for each in tuning.attempts if each.value is not None]
    numbers, values = [each.number for each in done], [each.value or np.nan for each in done]
    ax.plot(numbers, values, "o", ms=4, color=_DONE, label="finished")
    lowest = np.minimum.accumulate(values)
    ax.step([*numbers, tuning.attempts[-1].number], [*lowest, lowest[-1]], where="post",
            color=_BEST, lw=1.4, label="lowest so far")  # fmt: skip
    early = [(each.number, each.scores[0]) for each in tuning.attempts
             if each.value is None and each.scores]  # fmt: skip
    if early:
        label = "given up, its first error"
        ax.plot(*zip(*early, strict=True), "x", ms=4, color=_GIVEN_UP, label=label)
    if tuning.default is not None and tuning.default.value is not None:
        label = "the best by the default recipe"
        ax.axhline(tuning.default.value, color=_DEFAULT, ls="--", lw=1, label=label)
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("{x:g}")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_ylim(top=4 * float(np.median(values)) + 1e-12 if values else None)
    ax.set_xlabel("trial")
    ax.set_ylabel(_ERROR)
    ax.set_title(f"{tuning.record.name}: what was tried".replace("$", r"\$"), fontsize=10)
    ax.grid(True, which="both", color="0.93", lw=0.6)
    ax.legend(fontsize=8, loc="upper right")
    return figure


def importances(tuning: Tuning) -> Figure:
    """How much each parameter had to do with a good result."""
    ranked = sorted(tuning.importances.items(), key=lambda pair: pair[1])
    figure = Figure(figsize=(8, 2.6 + 0.25 * len(ranked)), layout="constrained")
    ax = figure.subplots()
    ax.barh([name for name, _ in ranked], [share for _, share in ranked], color=_DONE)
    if not ranked:
        ax.text(0.5, 0.5, "too few trials to say", ha="center", transform=ax.transAxes)
        ax.set_yticks([])
    ax.set_xlabel("importance for being among the best quarter of the trials (PED-ANOVA)")
    ax.set_ylabel("parameter")
    ax.set_title(f"{tuning.record.name}: what mattered".replace("$", r"\$"), fontsize=10)
    ax.grid(True, axis="x", color="0.93", lw=0.6)
    ax.set_axisbelow(True)
    return figure


def _trial(attempt: StudyTrial) -> dict[str, Any]:
    tuned = attempt.tuned
    kept = asdict(attempt) | {"tuned": None, "scores": [*attempt.scores]}
    del kept["tuned"]
    if tuned is None:
        return kept
    settings = {name: value for name, value in tuned.as_json().items()
                if name not in ("format", "version", "found")}  # fmt: skip
    return kept | settings
