"""What `compare` and `forecast` have in common: what is tried, how it is trained, with which seeds.

No measured sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from splitband.data import Trajectory
from splitband.evaluation.bases import on_baseline
from splitband.evaluation.runs import Work
from splitband.evaluation.search import SearchResult, search
from splitband.evaluation.selection import TRIED, Trial, try_out
from splitband.evaluation.setup import Setup, trying_bases, usual_names
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import Ensemble
from splitband.runtime.arguments import whole

TRIAL, FINAL = "three quarters", "whole"
"""The stages of the work: on how much of the training part the methods are fitted."""
SEEDS = 3
"""Trainings of each network, where nothing else decides how many."""


def candidates(
    record: Trajectory, setup: Setup, methods: Sequence[Forecaster | str] | None
) -> tuple[list[Forecaster], Setup]:
    """The methods with what they leave open taken from the setup, and the setup they are for.

    A method may be given by its name. Without methods they are what is worth trying on such a
    record, and the setup allows for more.
    """
    if methods is None:
        methods, setup = usual_names(record, setup), trying_bases(setup)
    made = [setup.forecaster(each) if isinstance(each, str) else each for each in methods]
    return [method.with_defaults(setup.settings, setup.bands) for method in made], setup


def choose(
    record: Trajectory,
    forecasters: Sequence[Forecaster],
    ahead: int,
    setup: Setup,
    seeds: int | None,
    work: Work,
    others: Sequence[Trajectory],
    tested: bool = False,
) -> tuple[Trial, SearchResult]:
    """How networks are to be trained, and what all methods do on held-out samples.

    Parameters
    ----------
    record : The training part, and nothing else.
    forecasters : The `candidates`.
    ahead : Samples to be forecast after all.
    setup : Its `search` says how much may go into finding out how to train.
    seeds : Trainings of each network, if that has been decided.
    work, others : See `compare`.
    tested : Whether methods are asked about other records, too.
    """
    if seeds is not None:
        whole("seeds", seeds)
    searched = SearchResult([*forecasters])
    if setup.search is not None:
        searched = search(record, forecasters, ahead, setup.search, work, others)
    tried = range(SEEDS if seeds is None else seeds)[:TRIED]
    trial = try_out(
        record, searched.forecasters, ahead, tried, work.for_stage(TRIAL), others, searched.done
    )
    if tested or others:  # what goes on in the time of one record is no base for several
        anchored = frozenset(f.name for f in searched.forecasters if f.anchored)
        trial = replace(trial, left_out=anchored)
    trial, searched = on_baseline(record, trial, searched, setup, ahead, tried, work, others)
    return replace(trial, left_out=frozenset()), searched


def seeds_of(
    searched: SearchResult, scores: Mapping[str, float], seeds: int | None
) -> dict[str, range]:
    """Of each method that has a held-out score, for the training on all of the training part."""
    usual = range(SEEDS if seeds is None else seeds)
    return dict.fromkeys(scores, usual) | (searched.seeds(scores) if seeds is None else {})


def as_trained(forecaster: Forecaster, seeds: Sequence[int]) -> Forecaster:
    """The forecaster of these seeds, not fitted: what is random is the mean over them."""
    if not forecaster.random or [*seeds] == [0]:
        return forecaster.copy()
    usual = [*seeds] == [*range(len(seeds))]
    return Ensemble(forecaster.copy(), len(seeds), seeds=None if usual else seeds)
