"""`tune`: which network, trained how, forecasts held-out training samples best."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from splitband.data import Record
from splitband.evaluation.protocols import TRAINING_SHARE, check_train
from splitband.evaluation.runs import Work
from splitband.evaluation.setup import Setup, default_setup
from splitband.evaluation.space import Space, tunable_names, usual_networks
from splitband.evaluation.trials import SHARES, Limits, StudyTask, StudyTrial, beginning
from splitband.evaluation.tuned import Tuned
from splitband.forecasters.backtest import check_held_out, for_trial, held_out_from
from splitband.forecasters.names import TRAINED
from splitband.forecasters.network import Network
from splitband.runtime.processes import over

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SECONDS = 600.0
"""Where neither a number of trials nor a time is given."""
LONGEST = 0.25
"""Share of the time that a single trial may take."""
STUDY = "study.db"


@dataclass(frozen=True)
class Effort:
    """How much is tried, and where the trials are kept.

    Attributes
    ----------
    trials : How many, with those that the storage has already.
    seconds : Of wall time; without `trials` `SECONDS`. The first trial may take longer.
    seed : Of what is tried.
    storage : Address of a database, such as "sqlite:///tune.db" or "postgresql://host/name", which
        processes on several machines share and a later call goes on from; by default a file of
        one's own.
    """

    trials: int | None = None
    seconds: float | None = None
    seed: int = 0
    storage: str | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.trials is not None and self.trials < 1:
            raise ValueError(f"trials must be at least 1, got {self.trials}")
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise ValueError(f"seconds must be positive, got {self.seconds}")
        if not 0 <= self.seed < 2**31:
            raise ValueError(f"seed must be between 0 and {2**31 - 1}, got {self.seed}")

    def limits(self) -> Limits:
        """From now on."""
        seconds = self.seconds
        if seconds is None:
            seconds = SECONDS if self.trials is None else float("inf")
        trials = float("inf") if self.trials is None else self.trials
        return Limits(trials, time.time() + seconds, LONGEST * seconds)


@dataclass(frozen=True, eq=False)
class Tuning:
    """What has been tried, and what is best.

    Attributes
    ----------
    record : The training part.
    setup : The default recipe for it.
    attempts : All trials.
    importances : How much each parameter has to do with a good result, together 1; empty after too
        few trials.
    """

    record: Record
    setup: Setup
    attempts: tuple[StudyTrial, ...]
    importances: Mapping[str, float] = field(default_factory=dict)

    @property
    def ranked(self) -> list[StudyTrial]:
        """The trials that were not given up, the best one first; of equal ones the earliest."""
        done = [each for each in self.attempts if each.value is not None]
        return sorted(done, key=lambda each: (each.value or 0.0, each.number))

    @property
    def best(self) -> StudyTrial:
        """The trial with the lowest held-out error."""
        return self.ranked[0]

    @property
    def default(self) -> StudyTrial | None:
        """The best one of the trials by the default recipe; None where these failed."""
        return next((each for each in self.ranked if each.usual), None)

    @property
    def improved(self) -> bool:
        """Whether something is better than the default recipe."""
        return not self.best.usual

    @cached_property
    def tuned(self) -> Tuned:
        """The best settings, with what they were found on."""
        best, default = self.best, self.default
        assert best.tuned is not None
        found = {
            "record": self.record.name,
            "samples": len(self.record),
            "held_out": best.value,
            "held_out_default": None if default is None else default.value,
            "trial": best.number,
            "trials": len(self.attempts),
        }
        return replace(best.tuned, found=found).for_record(self.record)

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for each trial: method, settings, held-out error, seconds and why it ended."""
        rows = [
            {
                "trial": each.number,
                "held out": np.nan if each.value is None else each.value,
                "method": "" if each.tuned is None else each.tuned.method,
                "settings": "" if each.tuned is None else each.tuned.in_words(),
                "default": each.usual,
                "seconds": each.seconds,
                "note": each.failed,
            }
            for each in self.attempts
        ]
        return pd.DataFrame(rows).set_index("trial")

    def plot(self) -> Figure:
        """The held-out error of every trial, in the order of the trials."""
        # The module of pictures imports this one, so that it is imported only here.
        return import_module("splitband.report.tuning").history(self)

    def save(self, folder: str | Path) -> None:
        """Write settings.json, results.json and the pictures that `splitband tune` writes."""
        import_module("splitband.report.tuning").save(self, Path(folder))


def tune(
    record: Record,
    train: int | None = None,
    methods: Sequence[str] | None = None,
    *,
    others: Sequence[Record] = (),
    effort: Effort | None = None,
    setup: Setup | None = None,
    work: Work | None = None,
    device: str = "cpu",
) -> Tuning:
    """Search for a network and its settings by held-out training samples.

    Each trial trains one network on the first three quarters of the training part, to forecast the
    rest of it from several origins; then likewise on shorter beginnings of the training part, each
    with another seed. Its value is the root mean square of these errors, of channels scaled to a
    deviation of 1. A trial that trails the others is given up after the first of them. The first
    trials are the default recipe's, so that the result is no worse on held-out samples. Nothing
    after the training part is looked at.

    Parameters
    ----------
    record, train, others : See `compare`.
    methods : Names of networks; by default every kind that the record has what it needs for.
    effort : How much is tried.
    setup : The usual settings, bands and sizes, and `train`; by default those of `compare`.
    work : Processes, progress, and the folder of the study where `effort` names no storage.
    device : Of the networks.

    Raises
    ------
    ValueError
        Without Optuna; for a record or methods that do not fit; a storage that cannot be used; when
        every trial fails.
    """
    effort, work = effort or Effort(), work or Work()
    try:
        study = import_module("splitband.evaluation.study")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("optuna", "sqlalchemy"):
            raise
        raise ValueError("tune needs Optuna: pip install 'splitband[tune]'") from None
    if setup is None:
        train = int(TRAINING_SHARE * len(record)) if train is None else train
        check_train(record, train, 0)
        setup = default_setup(record, train)
    elif train not in (None, setup.train):
        raise ValueError(f"train must be that of setup, {setup.train}, got {train}")
    training = replace(record[: setup.train], y_true=None)
    space = Space(_methods(training, methods), setup, record.sampling_rate)
    shares = _shares(training, space, others)
    limits = effort.limits()
    with _storage(effort, work) as storage:
        job = StudyTask(
            training, shares, tuple(others), space, device, storage,
            _name(training, shares, others, space, effort), effort.seed, limits,
        )  # fmt: skip
        study.begin(job)
        workers = work.executor or work.jobs
        at_once = max(work.jobs, getattr(work.executor, "cores", 1))
        for _ in over(partial(study.run, job), range(at_once), workers, work.progress):
            pass
        found, importances = study.outcome(job)
    if all(each.value is None for each in found):
        raise ValueError(f"no trial could be finished: {_why(found)}")
    return Tuning(training, setup, tuple(found), importances)


def _methods(record: Record, methods: Sequence[str] | None) -> tuple[str, ...]:
    if methods is None:
        return tuple(tunable_names(record))
    methods = [methods] if isinstance(methods, str) else methods
    unknown = [str(name) for name in methods if name not in TRAINED]
    if unknown or not methods:
        raise ValueError(f"methods must be names of networks out of {', '.join(TRAINED)}, got "
                         f"{', '.join(unknown) or 'none'}")  # fmt: skip
    return tuple(dict.fromkeys(methods))


def _shares(record: Record, space: Space, others: Sequence[Record]) -> tuple[float, ...]:
    """The beginnings of the training part that are long enough for the default recipe."""
    shares: list[float] = []
    for share in SHARES:
        part = beginning(record, share)
        fitted = part[: held_out_from(len(part))]
        try:
            check_held_out(part)
            for method in usual_networks(record, space.methods):
                network = space.setup.forecaster(method)
                assert isinstance(network, Network)
                for_trial(network, len(part), len(record)).check(fitted, *others)
        except ValueError:
            if not shares:
                raise
            continue
        shares.append(share)
    return tuple(shares)


def _name(
    record: Record,
    shares: Sequence[float],
    others: Sequence[Record],
    space: Space,
    effort: Effort,
) -> str:
    """The name of the study: the same command has the same one, another record another one."""
    digest = hashlib.sha256()
    for each in (record, *others):
        for values in (each.seen, each.u, each.u_beyond, each.y_sim, each.beyond):
            digest.update(b"-" if values is None else np.ascontiguousarray(values).tobytes())
        digest.update(repr((each.y.shape, each.sampling_time)).encode())
    setup = space.setup
    usual = setup.settings, setup.bands, setup.sizes
    digest.update(repr((space.methods, usual, shares, effort.seed)).encode())
    return f"{Path(record.name).stem or 'record'}-{digest.hexdigest()[:16]}"


@contextmanager
def _storage(effort: Effort, work: Work) -> Iterator[str]:
    """The address of the trials: of one's own file where none is given."""
    if effort.storage is not None:
        yield effort.storage
    elif work.checkpoints is not None:
        below = Path(work.checkpoints)
        below.mkdir(parents=True, exist_ok=True)
        yield f"sqlite:///{(below / STUDY).resolve()}"
    else:
        with tempfile.TemporaryDirectory(prefix="splitband-tune-") as folder:
            yield f"sqlite:///{folder}/{STUDY}"


def _why(attempts: Sequence[StudyTrial]) -> str:
    reasons = dict.fromkeys(each.failed for each in attempts if each.failed)
    return "; ".join(reasons) or "the time was over before"
