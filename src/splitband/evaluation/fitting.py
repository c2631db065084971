"""Fitting a single method, trained as a search finds best."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from splitband.evaluation.budget import SEARCH
from splitband.evaluation.choosing import timed
from splitband.evaluation.plan import Plan
from splitband.evaluation.runs import RunProgress, Work, file_name
from splitband.evaluation.search import search
from splitband.forecasters.base import Forecaster
from splitband.runtime import deadlines
from splitband.training import Checkpoint, Progress


def fit(plan: Plan, seed: int = 0, work: Work | None = None) -> Forecaster:
    """Fit the only method of a plan to its training part, and return it.

    Parameters
    ----------
    plan : With one method.
    seed : Of initial weights and order of windows.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        For several methods, and what `Forecaster.fit` raises.
    """
    if len(plan.methods) != 1:
        raise ValueError(f"methods must be one to be fitted, got {', '.join(plan.names)}")
    (forecaster,) = plan.methods
    work = timed(work or Work(), plan.setup.search)
    if plan.setup.search is not None:
        with work.staffed() as staff:
            stage = replace(staff, deadline=work.time.share(SEARCH), span=(0.0, SEARCH))
            found = search(plan.training, [forecaster], 0, plan.setup.search, stage, plan.others)
        forecaster = found.forecasters[0]

    def update(at: Progress) -> None:
        if work.progress is not None:
            label, overall = f"{forecaster.name}, {at.task}", SEARCH + at.share * (1 - SEARCH)
            work.progress(RunProgress(label, seed, at.share, at.loss, overall=overall))

    checkpoint = None
    if work.checkpoints is not None:
        folder = Path(work.checkpoints)
        folder.mkdir(parents=True, exist_ok=True)
        checkpoint = Checkpoint(folder / f"{file_name(forecaster.name)}-{seed}.safetensors")
    with deadlines.within(work.time.deadline):
        return forecaster.fit(
            plan.training, *plan.others, seed=seed, progress=update, checkpoint=checkpoint
        )
