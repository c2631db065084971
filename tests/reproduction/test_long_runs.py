import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
import torch

from benchmarks.choices import FilteredAsAWhole
from reproduction import long_runs, long_tables
from reproduction.bands import networks_of
from reproduction.readings import BASE, COLUMN, READINGS, Filtering, Reading, Training
from reproduction.system_i import path_of, tried
from splitband.metrics import rmse
from splitband.training import fit

EPOCHS = 2
SHORT = Reading(training=Training(changes={"epochs": EPOCHS}))


def test_the_bands_are_scipys_filtered_signal() -> None:
    record = Reading().record(0)
    b, a = scipy.signal.iirfilter(3, 0.4, btype="low", ftype="butter", fs=10.0)
    low = scipy.signal.filtfilt(b, a, record.y[:250], axis=0)
    bands = Filtering().bands(record).y
    np.testing.assert_allclose(bands[:, :1], low, atol=1e-12)
    np.testing.assert_allclose(bands.sum(axis=1), record.y[:250, 0], atol=1e-12)


def test_clamped_bands_end_at_one_and_leave_the_rest_of_the_low_band_to_none() -> None:
    record = Reading().record(0)
    bands = Filtering(start="zeros", clamp=True, remainder=False).bands(record).y
    assert np.abs(bands).max() == 1.0
    middle = slice(60, 190)
    missing = rmse(record.y[:250, 0][middle], bands.sum(axis=1)[middle])
    assert 0.1 < missing < 0.2


def test_the_nearest_reading_trains_as_a_split_model_on_the_filtered_record() -> None:
    record = SHORT.record(0)
    setup = COLUMN.setup(record.sampling_rate, "split-gru")
    pair = Filtering().pair(record.sampling_rate)
    model = FilteredAsAWhole(networks_of("split-gru", SHORT, 3), pair, 2)
    told = replace(record, y_sim=pair.lowpass(record.y))
    fit(model, told[:250], replace(setup.settings, epochs=EPOCHS), seed=3)
    parts = model.simulate_components(record.y[:30], 970, None, told.y_sim)
    expected = rmse(record.truth[30:], sum(parts.values()))
    assert tried("split-gru", SHORT, 3)["total_rmse"] == pytest.approx(expected, rel=1e-5)


def moved(reading: Reading) -> list[str]:
    """What a reading takes in another way than the nearest one."""
    return [name for name, value in vars(reading).items() if value != vars(READINGS[BASE])[name]]


def test_every_reading_changes_the_result() -> None:
    """A run of one epoch cannot tell apart those alone that differ in later ones."""
    found = {}
    for name, reading in READINGS.items():
        if len(moved(reading)) > 1:  # each of them is moved by itself in another reading
            continue
        changes = reading.training.changes | {"epochs": 1}
        if "milestones" in changes:
            changes["milestones"] = ((0, 1e-4),)
        short = replace(reading, training=replace(reading.training, changes=changes))
        found[name] = tried("split-gru", short, 1)["total_rmse"]
    same = {name for name, error in found.items() if error == found[BASE]}
    assert same == {BASE, "1,000 epochs"}


def test_a_run_without_seeds_in_common_keeps_its_weights_or_its_order() -> None:
    def weights(fixed: Any, seed: int) -> torch.Tensor:
        reading = Reading(training=Training(fixed=fixed))
        return next(networks_of("split-gru", reading, seed)[0].parameters())

    assert torch.equal(weights("weights", 1), weights("weights", 2))
    assert not torch.equal(weights("order", 1), weights("order", 2))


def test_a_run_that_has_a_file_is_not_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []

    def one_run(method: str, reading: Reading, seed: int, draw: int = 0) -> dict[str, Any]:
        made.append(method)
        return {"total_rmse": 0.5}

    every = [
        long_runs.Item("seeds", path_of(tmp_path, "gru", BASE, seed), 1.0,
                       partial(one_run, "gru", Reading(), seed))
        for seed in range(2)
    ]  # fmt: skip
    monkeypatch.setattr(long_runs, "items", lambda _: iter([*every, *every]))
    said: list[str] = []
    assert long_runs.parts(tmp_path) == [long_runs.Part("seeds", 2, 0, 2.0)]
    long_runs.complete(tmp_path, said.append)
    long_runs.complete(tmp_path, said.append)
    assert len(made) == len(said) == len(every)
    assert long_runs.parts(tmp_path) == [long_runs.Part("seeds", 2, 2, 0.0)]


def test_the_tables_average_the_files(tmp_path: Path) -> None:
    for seed, error in enumerate((0.2, 0.3)):
        path = path_of(tmp_path / "system-i", "split-gru", BASE, seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        facts = tried("split-gru", SHORT, seed) | {"total_rmse": error}
        path.write_text(json.dumps(facts), encoding="utf-8")
    (tmp_path / "system-i" / "oracle-draws.json").write_text(
        json.dumps({"variance 0.01": [0.1] * 20}), encoding="utf-8"
    )
    page = long_tables.page(tmp_path)
    assert "| split-gru | 0.250 (0.071) | 0.127 (0.008) |" in page
    assert "| split-gru | nearest | last | 0.200 |" in page
