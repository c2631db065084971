"""The trials of `tune`: processes, on one machine or several, that share one study of Optuna.

This module alone imports Optuna, which is an extra; `evaluation.tuning` loads it when it is needed.
"""

from __future__ import annotations

import math
import re
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning, OptunaError, UpdateFinishedTrialError
from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import (
    ArgumentError,
    DBAPIError,
    IntegrityError,
    ProgrammingError,
    SQLAlchemyError,
)

from splitband.evaluation.runs import RunProgress
from splitband.evaluation.trials import Limits, StudyTask, StudyTrial, hidden, score
from splitband.evaluation.tuned import Tuned
from splitband.training import Progress

HEARTBEAT, PATIENCE = 15, 60
"""Seconds between signs of life of a trial, and without any until it is taken for dead."""
RETRIES = 2
"""How often a trial is begun again whose process has died."""
POLL = 1.0
"""Seconds between looks at trials that others still run."""
BEFORE_PRUNING = 5
"""Trials that are finished before any other one is given up."""
TIMEOUT, ATTEMPTS = 60, 5
"""Seconds that a process waits for a locked SQLite file, and times that tables are tried to be
made: two processes that begin at once may do so both."""
BEST = 0.25
"""Share of the trials that are the good ones, when it is said what mattered."""
STAGE = "trials"
_SETTINGS, _SCORES, _FAILED, _USUAL = "settings", "scores", "failed", "usual"


class _NotCountedError(Exception):
    """A trial that is one too many or there already, or that the time is over for."""


def begin(job: StudyTask) -> None:
    """Make the study if need be, with its first trials: the default recipe and short trainings."""
    with _study(job, new=True) as study:
        kept = [t for t in study.get_trials(deepcopy=False) if not _lost(t)]
        there = [*map(_fixed, kept)]
        for point, usual in job.space.beginnings(job.record):
            if point not in there:
                study.enqueue_trial(point, user_attrs={_USUAL: usual})
                there.append(point)


def run(job: StudyTask, index: int, report: Callable[[RunProgress], None]) -> None:
    """Try one after the other until there are enough, or the time is over.

    Trials that others run are waited for: where such a process has died, its trial is run again.
    """
    waited = 0.0
    with _study(job) as study:
        while True:
            trials = study.get_trials(deepcopy=False)
            begun = sum(map(_counts, trials))
            if begun and time.time() > job.limits.until:
                break
            if begun < job.limits.trials:
                waited = 0.0
                trying = _Trying(job, report)
                try:
                    study.optimize(trying, n_trials=1, catch=(Exception,))
                except ValueError as error:
                    # SQLite locks no rows: two processes may have taken the same trial at once,
                    # and the other one has finished it.
                    if "Cannot tell" not in str(error):
                        raise
                    continue
                if trying.broken is not None:
                    raise trying.broken
                continue
            if not any(t.state == TrialState.RUNNING for t in trials) or waited > _patience(trials):
                break
            time.sleep(POLL)
            waited += POLL
            optuna.storages.fail_stale_trials(study)


def outcome(job: StudyTask) -> tuple[list[StudyTrial], dict[str, float]]:
    """All that has been tried, in that order, and how much each parameter mattered.

    That is how much it has to do with which trials are the best quarter, together 1; empty where
    there are too few trials to say.
    """
    with _study(job) as study:
        trials = study.get_trials(deepcopy=False)
        tried = [_attempt(t) for t in trials if _counts(t) and t.state != TrialState.RUNNING]
        return tried, _importances(study)


class _Trying:
    """The objective: a training for each beginning of the record, each with a seed of its own."""

    def __init__(self, job: StudyTask, report: Callable[[RunProgress], None]) -> None:
        self._job, self._report = job, report
        self.broken: Exception | None = None
        """What concerns every trial: a full disk, or a storage that is gone."""

    def __call__(self, trial: optuna.Trial) -> float:
        """The root mean square of the scores."""
        try:
            return self._value(trial)
        except (optuna.TrialPruned, UpdateFinishedTrialError, _NotCountedError):
            raise
        except (OSError, SQLAlchemyError, OptunaError) as error:
            self.broken = error
            raise
        except Exception as error:
            said = " ".join(str(error).split())
            expected = isinstance(error, FloatingPointError | ValueError)
            reason = said if expected else f"{type(error).__name__}: {said}"
            trial.set_user_attr(_FAILED, reason)
            raise

    def _value(self, trial: optuna.Trial) -> float:
        job, usual = self._job, trial.user_attrs.get(_USUAL, False)
        trials = trial.study.get_trials(deepcopy=False)
        earlier = [each for each in trials[: trial.number] if _counts(each)]
        # Two processes that begin a study at once may both have put the first trials into it.
        first = _fixed(trials[trial.number])
        again = first is not None and any(_fixed(each) == first for each in earlier)
        if again or len(earlier) >= job.limits.trials:
            raise _NotCountedError
        # What is drawn depends on the trials before it alone, not on which process draws.
        seed = np.random.SeedSequence((job.seed, trial.number)).generate_state(1)
        trial.study.sampler = optuna.samplers.TPESampler(seed=int(seed[0]))
        tuned = job.space.drawn(trial)
        trial.set_user_attr(_SETTINGS, tuned.as_json())
        network = tuned.forecaster()
        if job.device != "cpu":
            network = network.to(job.device)
        scores: list[float] = []
        watch = _Watch(job.limits, trial, f"trial {trial.number}, {tuned.method}", self._report)
        for stage, share in enumerate(job.shares):
            watching = partial(watch, stage)
            scores.append(score(job.record, share, network, stage, job.others, watching))
            trial.set_user_attr(_SCORES, scores)
            value = math.sqrt(sum(each**2 for each in scores) / len(scores))
            trial.report(value, stage)
            if stage + 1 < len(job.shares) and not usual and trial.should_prune():
                trial.set_user_attr(_FAILED, f"given up after {stage + 1} of {len(job.shares)}")
                raise optuna.TrialPruned
        return value


class _Watch:
    """Reports the epochs of a trial, and ends it where there is no time left for it."""

    def __init__(
        self,
        limits: Limits,
        trial: optuna.Trial,
        label: str,
        report: Callable[[RunProgress], None],
    ) -> None:
        self._limits, self._trial, self._label, self._report = limits, trial, label, report
        self._usual = trial.user_attrs.get(_USUAL, False)
        self._began = time.time()

    def __call__(self, stage: int, at: Progress) -> None:
        """An epoch of a stage is over."""
        now = time.time()
        over = now > self._limits.until and not (self._usual and self._nothing_done())
        long = now - self._began > self._limits.one and not self._usual
        share = 1.0 if over or long else at.share
        self._report(RunProgress(self._label, stage, share, at.loss, STAGE))
        if over:
            raise _NotCountedError
        if long:
            self._trial.set_user_attr(_FAILED, "given up, as it took too long")
            raise optuna.TrialPruned

    def _nothing_done(self) -> bool:
        """Whether there would be no result at all."""
        trials = self._trial.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        return not trials


def _fixed(trial: FrozenTrial) -> Any:
    """What a trial was to begin with; None where everything is drawn."""
    return trial.system_attrs.get("fixed_params")


def _counts(trial: FrozenTrial) -> bool:
    """Whether it is one of the trials that were asked for: begun, and not lost."""
    return trial.state != TrialState.WAITING and not _lost(trial)


def _lost(trial: FrozenTrial) -> bool:
    """Whether its process has died, the time was over, or it was not needed."""
    return trial.state == TrialState.FAIL and _FAILED not in trial.user_attrs


def _patience(trials: Sequence[FrozenTrial]) -> float:
    """For how long others are waited for, in s: as long as a trial takes, or a heartbeat stays."""
    took = [trial.duration.total_seconds() for trial in trials if trial.duration is not None]
    return 2 * max([PATIENCE, *took])


def _attempt(trial: FrozenTrial) -> StudyTrial:
    known, settings = trial.user_attrs, trial.user_attrs.get(_SETTINGS)
    return StudyTrial(
        trial.number,
        None if settings is None else Tuned.of(settings),
        tuple(known.get(_SCORES, ())),
        trial.value if trial.state == TrialState.COMPLETE else None,
        0.0 if trial.duration is None else trial.duration.total_seconds(),
        known.get(_USUAL, False),
        known.get(_FAILED, ""),
    )


def _importances(study: optuna.Study) -> dict[str, float]:
    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if len({trial.value for trial in done}) < BEFORE_PRUNING:
        return {}
    evaluator = optuna.importance.PedAnovaImportanceEvaluator(target_quantile=BEST)
    with warnings.catch_warnings():  # of parameters that few trials have
        warnings.simplefilter("ignore")
        found = optuna.importance.get_param_importances(study, evaluator=evaluator)
    return found if all(map(math.isfinite, found.values())) else {}


@contextmanager
def _study(job: StudyTask, new: bool = False) -> Iterator[optuna.Study]:
    """The study, opened; Optuna says nothing meanwhile. A `new` one may have no tables yet."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            storage = _opened(job.storage, new)
            try:
                yield optuna.create_study(
                    storage=storage,
                    study_name=job.study,
                    pruner=optuna.pruners.MedianPruner(BEFORE_PRUNING),
                    load_if_exists=True,
                )
            finally:
                storage.remove_session()
                storage.engine.dispose()
    except (SQLAlchemyError, OptunaError) as error:
        raise _unusable(job.storage, error) from None
    finally:
        optuna.logging.set_verbosity(before)


def _opened(address: str, new: bool) -> RDBStorage:
    """The database, with its tables."""
    connecting: dict[str, Any] = {"pool_pre_ping": True}
    if address.startswith("sqlite"):
        connecting = {"connect_args": {"timeout": TIMEOUT}}
    # Which driver is meant where none is named depends on the version of SQLAlchemy.
    url = re.sub("^postgres(ql)?://", "postgresql+psycopg://", address)
    for left in reversed(range(ATTEMPTS)):
        try:
            return RDBStorage(
                url,
                connecting,
                skip_compatibility_check=not new,
                skip_table_creation=not new,
                heartbeat_interval=HEARTBEAT,
                grace_period=PATIENCE,
                heartbeat_stale_trial_callback=RetryHeartbeatStaleTrialCallback(RETRIES),
            )
        except DBAPIError as error:
            both = isinstance(error, IntegrityError | ProgrammingError) or "exists" in str(error)
            if not both or not left:
                raise
            time.sleep(POLL / 10)
        except (ArgumentError, ImportError, RuntimeError, ValueError) as error:
            raise _unusable(address, error) from None
    raise AssertionError("unreachable")


def _unusable(address: str, error: Exception) -> ValueError:
    reason = str(error).strip().splitlines()[0]
    return ValueError(
        f"storage must be a database such as sqlite:///tune.db or postgresql://HOST/NAME, got "
        f"{hidden(address)}: {reason}"
    )
