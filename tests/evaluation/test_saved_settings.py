"""settings.json: what is read is what was written, and what is wrong is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitband import GRU, Ensemble, Forecaster, Mean, Single
from splitband.data import Record
from splitband.evaluation.saved_settings import SavedSettings
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import Sizes
from splitband.training import Settings

METHODS = (
    *("gru", "rnn", "state-space", "split-gru", "split-gru-hp-conditioned"),
    *("filtered-gru-calibrated-conditioned", "residual-linear-gru", "residual-state-space"),
)
"""One of each kind, and pairs of the options."""
SAVED = SavedSettings(
    "split-gru-conditioned",
    Settings(60, 12, 3, 16, 2e-3, milestones=((2, 1e-4),), most_batches=4, quasi_newton=7),
    Bands(0.6, 2, 3),
    Sizes(12, 5),
)


def written(path: Path, *where: str, value: Any) -> Path:
    """A settings file with another value at a key, or without the key."""
    SAVED.save(path)
    facts = inner = json.loads(path.read_text())
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = value
    if value is KeyError:
        del inner[where[-1]]
    path.write_text(json.dumps(facts))
    return path


@pytest.mark.parametrize("method", METHODS)
def test_what_is_read_is_what_was_written(method: str, tmp_path: Path) -> None:
    saved = replace(SAVED, method=method)
    saved.save(tmp_path / "settings.json")
    read = SavedSettings.read(tmp_path / "settings.json")
    assert read == saved
    forecaster = read.forecaster()
    assert forecaster.name == method
    assert forecaster.settings == saved.settings
    assert not forecaster.tunable  # a comparison does not search for other settings


@pytest.mark.parametrize("method", METHODS)
def test_a_network_says_how_it_is_trained(method: str) -> None:
    """Whatever its cells have come to, as those of a search have."""
    network = replace(SAVED, method=method).forecaster().trained_as(SAVED.settings)
    for forecaster in (network, Ensemble(network, 3)):
        found = SavedSettings.of_forecaster(forecaster)
        assert found is not None
        assert found.method == method
        assert found.settings == SAVED.settings
        assert found.forecaster().training_in_words() == network.training_in_words()
        assert getattr(found.forecaster(), "bands", None) == getattr(network, "bands", None)


@pytest.mark.parametrize(
    "forecaster",
    [Mean(), Single(GRU(4)), Single(GRU(4), SAVED.settings, name="mine"),
     Ensemble(Mean(), 2), Single(GRU(1), SAVED.settings)],
)  # fmt: skip
def test_what_has_no_settings_or_another_name_says_nothing(forecaster: Forecaster) -> None:
    assert SavedSettings.of_forecaster(forecaster) is None


@pytest.mark.parametrize(
    ("where", "value", "says"),
    [
        (("format",), "other", "format must be splitband settings, version 1, got other"),
        (("version",), 2, "got splitband settings, version 2"),
        (("method",), "lstm", "method must name a network, got 'lstm'"),
        (("method",), 3, "method must be a name, got 3"),
        (("extra",), 1, "extra is unknown, the keys are bands, "),
        (("bands",), KeyError, "bands must be given"),
        (("bands",), [], "bands must be an object, got []"),
        (("training", "epoch"), 1, "training.epoch is unknown, the keys are batch_size, "),
        (("training", "epochs"), KeyError, "training.epochs must be given"),
        (("training", "epochs"), 2.5, "training.epochs must be a whole number, got 2.5"),
        (("training", "epochs"), True, "training.epochs must be a whole number, got true"),
        (("training", "epochs"), -1, "training: epochs must be at least 0, got -1"),
        (("training", "window"), 12, "training: window must be longer than the warm-up of 12"),
        (("training", "clip"), "1", 'training.clip must be a number or null, got "1"'),
        (("training", "one_cycle"), 1, "training.one_cycle must be true or false, got 1"),
        (("training", "milestones"), [[1.5, 2]], "training.milestones must be a list of [epoch"),
        (("bands", "order"), 0, "bands: order must be between 1 and 10000, got 0"),
        (("sizes", "hidden_low"), -3, "sizes: hidden_low must be between 1 and 10000, got -3"),
        (("training", "learning_rate"), float("nan"), "numbers must be finite, got NaN"),
        (("columns",), "y", 'columns must be a list of names, got "y"'),
        (("inputs",), [1], "inputs must be a list of names, got [1]"),
    ],
)
def test_what_is_wrong_is_named(
    where: tuple[str, ...], value: Any, says: str, tmp_path: Path
) -> None:
    path = written(tmp_path / "settings.json", *where, value=value)
    with pytest.raises(ValueError, match=r"settings .*settings\.json: ") as caught:
        SavedSettings.read(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "\ud800"])
def test_what_is_no_settings_file_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ValueError, match=r"settings"):
        SavedSettings.read(path)


def record(columns: tuple[str, ...], inputs: tuple[str, ...]) -> Record:
    y, u = np.zeros((9, len(columns))), np.zeros((9, len(inputs)))
    return Record(y, 1, u=u if inputs else None, columns=columns, inputs=inputs)


def test_settings_know_the_columns_and_inputs_they_are_for(tmp_path: Path) -> None:
    SAVED.for_record(record(("pos", "angle"), ("force", "valve"))).save(tmp_path / "s.json")
    saved = SavedSettings.read(tmp_path / "s.json")
    assert (saved.columns, saved.inputs) == (("pos", "angle"), ("force", "valve"))
    saved.check(record(("angle", "pos"), ("valve", "force")))
    saved.check(Record(np.zeros((9, 2)), 1, u=np.zeros((9, 2))))  # without names
    for columns, inputs in (
        (("pos", "angle"), ("force",)),
        (("pos", "angle", "valve"), ("force",)),
        (("pos", "temp"), ("force", "valve")),
        (("pos", "angle"), ("force", "rpm")),
    ):
        with pytest.raises(ValueError, match="inputs: force, valve; outputs: pos, angle") as caught:
            saved.check(record(columns, inputs))
        own = f"inputs: {', '.join(inputs)}; outputs: {', '.join(columns)}"
        assert f"the record has {own}" in str(caught.value)
    SAVED.check(record(("any",), ()))
