"""What a trial of `tune` is: a network, trained and asked about held-out training samples."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from splitband.data import Record
from splitband.evaluation.search import held_out_score
from splitband.evaluation.space import Space
from splitband.evaluation.tuned import Tuned
from splitband.forecasters.backtest import Question, backtest, for_trial, held_out_origins
from splitband.forecasters.network import Network
from splitband.training import Progress

SHARES = 1.0, 7 / 8, 3 / 4
"""Beginnings of the training part that a network is tried on, one after the other: on its own last
quarter, fitted to the rest. What does badly on the first is not tried on the others."""


@dataclass(frozen=True)
class Limits:
    """When it is enough; infinite where there is no limit.

    Attributes
    ----------
    trials : How many.
    until : By the clock of `time.time`, in s.
    one : Seconds that a single trial may take; the default recipe may take longer.
    """

    trials: float = math.inf
    until: float = math.inf
    one: float = math.inf


@dataclass(frozen=True, eq=False)
class StudyTask:
    """What every process of a study knows.

    Attributes
    ----------
    record : The training part, and nothing else.
    shares : Beginnings of it, each of which is tried on its own last quarter.
    others : Further training records.
    space : What is searched.
    device : Of the networks.
    storage, study : The address, and the name of the study there.
    seed : Of what is drawn; that of a trial's networks is the number of the stage.
    limits : When it is enough.
    """

    record: Record
    shares: tuple[float, ...]
    others: tuple[Record, ...]
    space: Space
    device: str
    storage: str
    study: str
    seed: int
    limits: Limits


@dataclass(frozen=True)
class StudyTrial:
    """What became of a trial.

    Attributes
    ----------
    number : Of the trial.
    tuned : What was tried; None where it could not be made.
    scores : Of each beginning of the training part, see `held_out_score`.
    value : The root mean square of the scores; None for a trial that was given up or failed.
    seconds : It took.
    usual : Whether it is the default recipe.
    failed : Why it failed, or was given up.
    """

    number: int
    tuned: Tuned | None
    scores: tuple[float, ...]
    value: float | None
    seconds: float
    usual: bool = False
    failed: str = ""


def score(
    record: Record,
    share: float,
    network: Network,
    seed: int,
    others: Sequence[Record] = (),
    progress: Callable[[Progress], None] | None = None,
) -> float:
    """The held-out error of a network on the beginning of a training record.

    It is fitted to the first three quarters of that beginning, and forecasts the rest of it from
    several origins.
    """
    part = beginning(record, share)
    shorter = for_trial(network, len(part), len(record))
    question = Question(part, held_out_origins(shorter, part), len(part), others)
    return held_out_score(part, [backtest(shorter, question, seed, progress)])


def beginning(record: Record, share: float) -> Record:
    """The first samples of a training record, without the truth."""
    return replace(record[: round(share * len(record))], y_true=None)


def hidden(address: str) -> str:
    """An address without its password."""
    return re.sub(r"(?<=://)([^/@:]*):[^@]*@", r"\1:***@", address)
