"""Searching for a network and its settings by held-out samples of the training part."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
import pytest

import splitband as sb
from splitband.evaluation import search as searching
from splitband.evaluation import space as spaces
from splitband.evaluation import study
from splitband.evaluation.space import Space, tunable_names, usual_networks
from splitband.evaluation.trials import SHARES, StudyTrial, hidden
from splitband.evaluation.tuned import Tuned
from splitband.forecasters.bands import Bands
from splitband.forecasters.network import Network
from tests.records import SETUP, TRAIN, record
from tests.support import with_other_samples

METHODS = ("gru", "split-gru")
forks = pytest.mark.skipif(
    not hasattr(os, "fork") or sys.platform == "darwin",
    reason="forks; on macOS forking after threads is unsafe",
)


def loss(network: Network) -> float:
    """An error that depends on the rate alone: lowest at 0.01, which is not the default."""
    assert network.settings is not None
    return 1 + abs(math.log(network.settings.learning_rate / 0.01))


def scored_by(function: Callable[[Network], float]) -> Callable[..., float]:
    return lambda record, share, network, *others: function(network)


@pytest.fixture
def untrained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is trained: the error is a function of the settings."""
    monkeypatch.setattr(study, "score", scored_by(loss))


def tuned(trials: int | None, storage: Path | str | None = None, **options: Any) -> sb.Tuning:
    address = f"sqlite:///{storage}" if isinstance(storage, Path) else storage
    effort = sb.Effort(trials, options.pop("seconds", None), options.pop("seed", 0), address)
    methods = options.pop("methods", METHODS)
    return sb.tune(record(), methods=methods, setup=SETUP, effort=effort, **options)


def facts(attempt: StudyTrial) -> StudyTrial:
    """What does not depend on the time it took."""
    return replace(attempt, seconds=0.0)


@pytest.mark.usefixtures("untrained")
def test_the_first_trial_is_the_default_recipe_and_the_result_no_worse() -> None:
    found = tuned(12)
    first = found.attempts[0]
    assert first.usual
    assert first.tuned == Tuned("gru", SETUP.settings, Bands(), SETUP.sizes)
    assert found.default is not None
    assert first.value == pytest.approx(loss(first.tuned.forecaster()))
    assert found.improved
    assert found.best.value == min(each.value for each in found.ranked if each.value)
    assert found.best.value < found.default.value  # type: ignore[operator]
    assert found.tuned.found["held_out_default"] == found.default.value
    assert len(found.table) == len(found.attempts) == 12
    assert [each.number for each in found.attempts] == [*range(12)]


def test_it_says_so_where_nothing_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = SETUP.settings.learning_rate

    def best_as_usual(network: Network) -> float:
        assert network.settings is not None
        same = network.settings == SETUP.settings and network.name == "gru"
        return 1.0 if same else 2 + abs(network.settings.learning_rate - usual)

    monkeypatch.setattr(study, "score", scored_by(best_as_usual))
    found = tuned(8)
    assert not found.improved
    assert found.best is found.default


def test_what_trails_is_given_up_but_never_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    def later_ones_are_worse(network: Network) -> float:
        assert network.settings is not None
        return 9.0 if network.settings == SETUP.settings else 1 / network.settings.learning_rate

    monkeypatch.setattr(study, "score", scored_by(later_ones_are_worse))
    monkeypatch.setattr(study, "BEFORE_PRUNING", 2)
    found = tuned(14)
    early = [each for each in found.attempts if each.value is None]
    assert early
    for each in early:
        assert len(each.scores) < len(SHARES)
        assert "given up" in each.failed
    assert all(each.value is not None for each in found.attempts if each.usual)


def test_a_trial_that_diverges_is_a_failed_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(network: Network) -> float:
        if network.name == "split-gru":
            raise FloatingPointError("training diverged")
        return loss(network)

    monkeypatch.setattr(study, "score", scored_by(fails))
    found = tuned(8)
    failed = [each for each in found.attempts if each.failed == "training diverged"]
    assert failed
    assert len(found.attempts) == 8
    with pytest.raises(ValueError, match="no trial could be finished: training diverged"):
        tuned(3, methods=["split-gru"])


def test_nothing_after_the_training_part_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, limits in (("STEPS", (2, 4)), ("ITERATIONS", (1, 3)), ("HIDDEN", (4, 6))):
        monkeypatch.setattr(spaces, name, limits)
    monkeypatch.setattr(searching, "LADDER", (2,))
    monkeypatch.setattr(study, "BEFORE_PRUNING", 1)
    setup = replace(SETUP, settings=replace(SETUP.settings, most_batches=1))
    known, changed = record(), with_other_samples(record(), TRAIN)
    effort = sb.Effort(2)
    first, second = (
        sb.tune(each, methods=METHODS, setup=setup, effort=effort) for each in (known, changed)
    )
    assert [*map(facts, first.attempts)] == [*map(facts, second.attempts)]
    assert len(first.record) == TRAIN
    earlier = sb.tune(
        with_other_samples(known, TRAIN - 5), methods=METHODS, setup=setup, effort=sb.Effort(1)
    )
    assert earlier.attempts[0].scores != first.attempts[0].scores


@pytest.mark.usefixtures("untrained")
def test_a_study_goes_on_as_if_it_had_not_been_stopped(tmp_path: Path) -> None:
    whole = tuned(7, tmp_path / "whole.db")
    assert len(tuned(3, tmp_path / "parts.db").attempts) == 3
    rest = tuned(7, tmp_path / "parts.db")
    assert [*map(facts, rest.attempts)] == [*map(facts, whole.attempts)]
    # Another seed, or another record, is another study.
    assert len(tuned(2, tmp_path / "parts.db", seed=1).attempts) == 2


@pytest.mark.usefixtures("untrained")
def test_the_first_trial_is_finished_whatever_the_time(tmp_path: Path) -> None:
    assert len(tuned(None, tmp_path / "a.db", seconds=1e-6).attempts) == 1


def in_a_process(work: Callable[[], Any]) -> int:
    child = os.fork()
    if child:
        return child
    status = 99
    try:
        work()
        status = 0
    finally:
        os._exit(status)


@forks
@pytest.mark.usefixtures("untrained")
def test_two_processes_at_one_study_end_with_the_number_that_was_asked_for(tmp_path: Path) -> None:
    children = [in_a_process(lambda: tuned(10, tmp_path / "a.db")) for _ in range(2)]
    assert [os.waitpid(child, 0)[1] for child in children] == [0, 0]
    found = tuned(10, tmp_path / "a.db")
    assert len(found.attempts) == 10
    assert len({each.tuned.in_words() for each in found.attempts if each.tuned}) == 10


@forks
def test_the_trial_of_a_killed_process_is_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "HEARTBEAT", 1)
    monkeypatch.setattr(study, "PATIENCE", 1)
    monkeypatch.setattr(study, "POLL", 0.2)
    tried: list[Network] = []

    def third_is_the_last(network: Network) -> float:
        tried.append(network)
        if len(tried) > 3 * len(SHARES):
            os.kill(os.getpid(), signal.SIGKILL)
        return loss(network)

    monkeypatch.setattr(study, "score", scored_by(third_is_the_last))
    child = in_a_process(lambda: tuned(5, tmp_path / "a.db"))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    monkeypatch.setattr(study, "score", scored_by(loss))
    found = tuned(5, tmp_path / "a.db")
    assert len(found.attempts) == 5
    assert all(each.value is not None or each.failed for each in found.attempts)
    whole = tuned(5, tmp_path / "whole.db")
    killed = whole.attempts[3]
    again = [each for each in found.attempts if each.tuned == killed.tuned]
    assert len(again) == 1
    assert again[0].number > 3
    assert again[0].scores == killed.scores


@pytest.mark.usefixtures("untrained")
def test_what_matters_is_said_to_matter() -> None:
    found = tuned(24, methods=["gru"])
    assert sum(found.importances.values()) == pytest.approx(1)
    ranked = sorted(found.importances, key=lambda name: found.importances[name])
    assert "learning_rate" in ranked[-2:]
    assert found.importances["method"] == 0  # there is one


def test_every_kind_begins_with_the_default_recipe_and_all_that_is_drawn_can_be_trained() -> None:
    known = record(nu=1)
    methods = tuple(tunable_names(known))
    assert {"gru", "split-gru", "filtered-gru-calibrated-conditioned", "residual-linear-gru"} <= {
        *methods
    }
    assert not [name for name in tunable_names(record()) if "linear" in name]
    training = known[:TRAIN]
    space = Space(methods, SETUP, known.sampling_rate)
    for method in methods:
        usual = space.drawn(optuna.trial.FixedTrial(space.usual(method)))
        assert (usual.settings, usual.sizes) == (SETUP.settings, SETUP.sizes)
    for point, _ in space.beginnings(training):
        space.drawn(optuna.trial.FixedTrial(point)).forecaster().check(training)
    drawing = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    for _ in range(60):
        drawn = space.drawn(drawing.ask())
        drawn.forecaster().check(training)
        assert Tuned.of(drawn.as_json()) == drawn
    assert usual_networks(known, methods)[0] == "gru"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"trials": 0}, "trials must be at least 1, got 0"),
        ({"seconds": 0.0}, "seconds must be positive, got 0"),
        ({"seed": -1}, "seed must be between 0 and 2147483647, got -1"),
    ],
)
def test_an_effort_that_cannot_be_is_refused(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        sb.Effort(**options)


def test_a_method_that_is_no_network_is_refused() -> None:
    with pytest.raises(ValueError, match=r"names of networks out of gru, .*, got mean"):
        tuned(1, methods=["gru", "mean"])


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("tune.db", "Could not parse"),
        ("sqlite:////nowhere/at/all.db", "unable to open database file"),
        ("sqlite:///damaged.db", "not a database"),
        ("postgresql://me:secret@127.0.0.1:1/tune", "refused"),
        ("mysql://me:secret@host/tune", "access module"),
        ("postgresql://me:secret@host:port/tune", "invalid literal"),
    ],
)
def test_a_storage_that_cannot_be_used_is_one_line_without_its_password(
    address: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "damaged.db").write_text("no database, but a text that is long enough" * 9)
    with pytest.raises(ValueError, match="storage must be a database such as") as caught:
        tuned(1, address)
    said = str(caught.value)
    assert says in said
    assert hidden(address) in said
    assert "secret" not in said
    assert "\n" not in said


def test_without_optuna_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.delitem(sys.modules, "splitband.evaluation.study")
    with pytest.raises(ValueError, match=r"pip install 'splitband\[tune\]'"):
        tuned(1)
