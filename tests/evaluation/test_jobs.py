"""A finished job is kept in a file, and found by whoever asks for the same."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event, Lock
from typing import Any

import numpy as np
import pytest

from splitband import GRU, ForecastContext, Ode, Residual, Simulation, Single
from splitband.evaluation.jobs import LATE, Job, Runner
from splitband.forecasters.backtest import BacktestSpec, Fit, Origin
from splitband.forecasters.base import Forecaster
from splitband.runtime.deadlines import NEVER, Deadline
from tests.records import LENGTH, QUICK, SETUP, TRAIN, record
from tests.support import slowed


def job(name: str = "filtered-gru", seed: int = 0, **changes: object) -> Job:
    origins = [Origin(TRAIN, 12), Origin(TRAIN, TRAIN)]
    spec = BacktestSpec(record(), origins, LENGTH, tests=[record(seed=1)], warmup=12)
    return Job(SETUP.forecaster(name), replace(spec, **changes), seed)  # type: ignore[arg-type]


def run(asked: Job, folder: Path, deadline: Deadline = NEVER) -> tuple[Fit, bool]:
    """The fit of a job, and whether it was found."""
    with Runner(folder=folder) as runner:
        found = runner._kept(asked) is not None
        runner.begin([asked], deadline)
        ((_, fit),) = runner.ended([asked])
        return fit, found


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Fit]:
    folder = tmp_path_factory.mktemp("jobs")
    return folder, run(job(), folder)[0]


def test_the_same_job_is_found_with_its_model_and_forecasts(kept: tuple[Path, Fit]) -> None:
    folder, fit = kept
    again, found = run(job(), folder)
    assert found
    assert [*again.forecasts] == [*fit.forecasts]
    for origin, prediction in fit.forecasts.items():
        np.testing.assert_array_equal(again.forecasts[origin].y, prediction.y)
        parts = again.forecasts[origin].components
        assert parts.keys() == prediction.components.keys()
    np.testing.assert_array_equal(again.tests[0].y, fit.tests[0].y)
    assert again.unfiltered.keys() == fit.unfiltered.keys()
    assert again.description == fit.description
    # The model is as good as new: it predicts from any history, and can be trained further.
    history = record()[:100]
    np.testing.assert_array_equal(
        again.fitted.predict(20, history).y, fit.fitted.predict(20, history).y
    )
    further = SETUP.forecaster("filtered-gru").fit(record()[:TRAIN], start=again.fitted)
    other = SETUP.forecaster("filtered-gru").fit(record()[:TRAIN], start=fit.fitted)
    np.testing.assert_array_equal(further.predict(20).y, other.predict(20).y)


def test_a_job_on_an_edited_equation_is_another_one() -> None:
    """Though it has no key, and the same name, arguments and ranges."""
    origins = [Origin(TRAIN, TRAIN)]
    keys = []
    for rate in (1.0, 2.0, 1.0):
        lag = Ode(lambda t, x, u, p, k=rate: [-k * p.c * x[0]], [1.0], parameters={"c": (0.1, 1.0)})
        network = Residual(lag, GRU(3), settings=QUICK)
        keys.append(Job(network, BacktestSpec(record(), origins, LENGTH)).key)
    assert keys[0] == keys[2] != keys[1]


@pytest.mark.parametrize("kind", ["cell", "method"])
def test_a_job_on_an_edited_cell_or_method_is_another_one(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though it has the same name and settings."""
    method = Single(Cell(3), settings=QUICK) if kind == "cell" else Own()
    edited, name = (Cell, "observe") if kind == "cell" else (Own, "extrapolate")
    keys = [replace(job(), forecaster=method).key]
    with monkeypatch.context() as patched:
        patched.setattr(edited, name, lambda *_: None)
        keys.append(replace(job(), forecaster=method).key)
    keys.append(replace(job(), forecaster=method).key)
    assert keys[0] == keys[2] != keys[1]


def test_a_job_on_code_that_cannot_be_told_from_another_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = replace(job(), forecaster=Own())
    assert run(asked, tmp_path / "kept")[0].model is not None
    assert [*(tmp_path / "kept").iterdir()]
    monkeypatch.setattr(Own, "lock", Lock(), raising=False)
    assert run(replace(asked), tmp_path / "new")[0].model is not None
    assert not (tmp_path / "new").exists()


def others() -> Iterator[tuple[str, Job]]:
    """Jobs that differ in one thing from the kept one."""
    y = record().y.copy()
    y[3] += 1e-9
    yield "seed", job(seed=1)
    yield "method", job("residual-gru")
    yield "sample", job(record=replace(record(), y=y))
    yield "gap", job(record=replace(record(), measured=y != y[50]))
    yield "test", job(tests=[record(seed=2)])
    yield "more", job(others=[record(seed=3)])
    yield "end", job(end=LENGTH - 1)
    yield "initial", job(initial=20)
    longer = SETUP.forecaster("filtered-gru").set_params(settings=replace(QUICK, epochs=2))
    yield "settings", replace(job(), forecaster=longer)
    start = SETUP.forecaster("filtered-gru").fit(record()[:TRAIN], seed=5)
    yield "start", replace(job(), start=start)


@pytest.mark.parametrize(
    "other", [each for _, each in others()], ids=[name for name, _ in others()]
)
def test_another_job_is_not(other: Job) -> None:
    assert other.key != job().key


def test_the_deadline_is_not_part_of_what_is_asked_and_a_cut_job_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    fit, _ = run(job(), tmp_path, Deadline(clock.at + 3))
    assert fit.cut
    assert not [*tmp_path.iterdir()]


def test_a_job_that_is_not_begun_in_time_says_so_unless_it_is_needed(tmp_path: Path) -> None:
    over = Deadline(0.0)
    assert run(job(), tmp_path, over)[0].failure == LATE
    needed, _ = run(replace(job(), needed=True), tmp_path, over)
    assert needed.cut
    assert needed.model is not None


@pytest.mark.parametrize("origin", [(80, LENGTH + 1), (0, 50), (80, 0)])
def test_an_origin_is_inside_of_the_record(origin: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="origins must have fitted > 0 and 0 < at <= "):
        BacktestSpec(record(), [Origin(*origin)], LENGTH + 50)


def test_a_damaged_file_is_no_result(kept: tuple[Path, Fit], tmp_path: Path) -> None:
    folder, _ = kept
    (path,) = folder.iterdir()
    for content in (b"", b"no safetensors", path.read_bytes()[:-1000]):
        (tmp_path / path.name).write_bytes(content)
        fit, found = run(job(), tmp_path)
        assert not found
        assert fit.model is not None


def test_a_full_disk_loses_the_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    fit, _ = run(job("gru"), tmp_path)
    assert fit.model is not None


class Own(Forecaster):
    """A method of a user that fails, or not."""

    name = "own"
    random = True

    def __init__(self, error: type[Exception] | None = None) -> None:
        self.error = error

    def learn(self, records: object, **_: object) -> None:
        if self.error is not None:
            raise self.error("it is\nbroken")

    def extrapolate(self, known: ForecastContext) -> np.ndarray:
        return np.zeros((known.steps, known.y.shape[1]))


class Cell(GRU):
    """A cell of a user."""

    def observe(self, h: Any) -> Any:
        return 2.0 * super().observe(h)


@pytest.mark.parametrize(
    ("error", "said"), [(ValueError, "it is broken"), (KeyError, "KeyError: 'it is\\nbroken'")]
)
def test_a_failure_is_one_line(error: type[Exception], said: str, tmp_path: Path) -> None:
    fit, _ = run(replace(job(), forecaster=Own(error)), tmp_path)
    assert fit.failure == said
    assert not [*tmp_path.iterdir()]


def test_a_simulator_that_cannot_be_told_from_another_is_not_kept(tmp_path: Path) -> None:
    class Theirs:
        def simulate(self, time: np.ndarray) -> np.ndarray:
            return np.sin(time)

    hybrid = SETUP.forecaster("filtered-gru").set_params(base=Simulation(Theirs()))
    asked = replace(job(), forecaster=hybrid)
    assert run(asked, tmp_path)[0].model is not None
    assert not [*tmp_path.iterdir()]


def test_nobody_waits_for_workers_to_load_and_compile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done = Event()
    monkeypatch.setattr("splitband.evaluation.jobs.compile_kernels", lambda *_: done.wait())
    with ThreadPoolExecutor(1) as executor:
        runner = Runner(2, executor)
        runner.start([SETUP.forecaster("gru")])
        assert runner.starting
        done.set()
    assert not runner.starting
