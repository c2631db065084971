"""Saved forecasters: the same to the bit when loaded, whole or not at all, and never code."""

from __future__ import annotations

import contextlib
import hashlib
import json
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import safetensors.numpy
import torch
from torch import nn

import splitband as sb
from splitband.forecasters import saving
from splitband.forecasters.prediction import ForecastContext
from splitband.runtime.arrays import Array
from tests.streams import Leaky
from tests.support import edit, known_after

DT, STEPS = 0.1, 20
TIME = DT * np.arange(160)
RECORD = sb.Record(
    np.sin(TIME) + 0.2 * np.sin(9 * TIME) + 5, DT, u=np.cos(0.7 * TIME), y_sim=np.sin(TIME + 0.2)
)
TRAIN = RECORD[:120]
SHORT = sb.TrainingSettings.paper(window=30, warmup=12, epochs=1)


def ahead(model: sb.Forecaster, level: float | None = None) -> sb.Prediction:
    """Return a forecast from the end of the training record."""
    return model.predict(STEPS, **known_after(RECORD, 120), level=level)


EVERY: dict[str, Callable[[], sb.Forecaster]] = {
    "mean": sb.Mean,
    "periodic": sb.Periodic,
    "linear": lambda: sb.Linear(1),
    "gru": lambda: sb.Single(sb.GRU(2), SHORT),
    "calibrated": sb.Calibrated,
    "residual": lambda: sb.Residual(sb.Periodic(), sb.GRU(2), settings=SHORT),
    "ensemble": lambda: sb.Ensemble(sb.Single(sb.GRU(2), SHORT), 2),
    "split": lambda: sb.Split(sb.GRU(2), sb.GRU(3), sb.Bands(0.5, 1, 2), settings=SHORT),
}


@cache
def fitted(kind: str) -> sb.Forecaster:
    return EVERY[kind]().fit(TRAIN, seed=0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    fitted("gru").save(tmp_path / "model")
    return tmp_path / "model"


def other() -> sb.Forecaster:
    return EVERY["gru"]().fit(TRAIN, seed=5)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def weights(folder: Path) -> Path:
    (path,) = folder.glob("weights-*.safetensors")
    return path


@pytest.mark.parametrize("kind", ["residual", "ensemble"])
def test_what_was_loaded_can_be_fitted_again(kind: str, tmp_path: Path) -> None:
    fitted(kind).save(tmp_path)
    again = sb.load(tmp_path).fit(TRAIN, seed=0)
    np.testing.assert_array_equal(ahead(again).y, ahead(fitted(kind)).y)


def test_a_network_in_double_precision_stays_in_it(tmp_path: Path) -> None:
    model: Any = EVERY["gru"]().fit(TRAIN)
    model.model.double()
    model.save(tmp_path)
    np.testing.assert_array_equal(ahead(sb.load(tmp_path)).y, ahead(model).y)


class Own(Leaky):
    """A cell of the user's own that computes when it is made, and drops out in training."""

    def __init__(self, ny: int = 1, nu: int = 0, scales: Any = None) -> None:
        super().__init__(ny, nu)
        self.scales, self.again = scales, nn.Linear(ny + nu, ny)
        self.again.weight = self.mix.weight  # two names for one matrix
        self.first = float(torch.ones(3).sum())

    def sized(self, ny: int, nu: int, warmup: int) -> Own:
        return Own(ny, nu, self.scales)

    def step(self, state: Any, y: Any, u: Any = None) -> Any:
        return nn.functional.dropout(super().step(state, y, u), training=self.training)


class OwnForecaster(sb.Forecaster):
    """A forecaster of the user's own, around another one."""

    state_types: ClassVar[Mapping[str, Any]] = {"of_inner": "inner"}

    def __init__(self, inner: sb.Forecaster, factor: float = 1.0) -> None:
        self.inner, self.factor = inner, factor

    @property
    def name(self) -> str:
        return f"own-{self.inner.name}"

    @property
    def warmup(self) -> int:
        return self.inner.warmup

    def in_words(self) -> str:
        return f"{self.factor:g} times the last value"

    def learn(self, records: Any, **_: Any) -> None:
        self.levels, self.limit, self.said = np.array([[np.nan, 2.0]]), float("inf"), "fine"
        self.of_inner = self.inner.clone().fit(*records)

    def extrapolate(self, known: ForecastContext) -> Array:
        parts = self.of_inner.extrapolate(known)
        values = sum(parts.values()) if isinstance(parts, dict) else parts
        return self.factor * np.asarray(values)


def test_what_is_ones_own_is_saved_and_loaded_without_being_registered(tmp_path: Path) -> None:
    scales = {"x": [1, 2.5], "y": (3, float("inf"), pd.Timestamp("2024-03-01 10:00")), "z": None}
    inner = sb.Single(Own(scales=scales | {"array": np.arange(3)}), SHORT)
    model = sb.Ensemble(OwnForecaster(inner, 0.5), 2).fit(TRAIN, seed=0)
    expected = ahead(model, 0.8)
    model.save(tmp_path)
    loaded = sb.load(tmp_path)
    np.testing.assert_array_equal(ahead(loaded, 0.8).lower, expected.lower)
    assert isinstance(loaded, sb.Ensemble)
    assert loaded.in_words() == "0.5 times the last value"
    member: Any = loaded.members[1]
    np.testing.assert_array_equal(member.levels, [[np.nan, 2.0]])
    assert (member.limit, member.said) == (float("inf"), "fine")
    cell = member.of_inner.model.cell
    assert cell.again.weight is cell.mix.weight
    np.testing.assert_array_equal(cell.scales.pop("array"), np.arange(3))
    assert cell.scales == scales


class Line(sb.Forecaster):
    """Looks back further than it says, and keeps what is no array."""

    name = "line"

    def learn(self, records: Any, **_: Any) -> None:
        self.line = np.poly1d([1.0, 0.0])

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.tile(self.line(known.y[-20:].mean(axis=0)), (known.steps, 1))


class WithState(Line):
    """Says what is to be saved of it."""

    def state(self) -> dict[str, npt.NDArray[Any]]:
        return {"coefficients": self.line.coef}

    @classmethod
    def from_state(cls, options: Mapping[str, Any], arrays: Any) -> WithState:
        new = cls(**options)
        new.line = np.poly1d(arrays["coefficients"])
        return new


def test_a_class_with_other_attributes_than_arrays_says_what_its_state_is(tmp_path: Path) -> None:
    says = "Line cannot be saved with its attribute line .* define state.. and from_state"
    with pytest.raises(ValueError, match=says):
        Line().fit(TRAIN).save(tmp_path)
    for name, own in (("alone", WithState()), ("several", sb.Ensemble(WithState(), 2))):
        model = own.fit(TRAIN)
        model.save(tmp_path / name)
        np.testing.assert_array_equal(ahead(sb.load(tmp_path / name)).y, ahead(model).y)


def test_a_class_of_ones_own_is_asked_for_by_its_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In another process, which has not imported it; once it has, the model is loaded."""
    (tmp_path / "my_parts.py").write_text(
        "import numpy as np\nimport splitband as sb\n"
        "class Last(sb.Forecaster):\n    name = 'last'\n"
        "    def extrapolate(self, known):\n        return np.tile(known.y[-1], (known.steps, 1))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import_module("my_parts").Last().fit(sb.Record(np.arange(9.0), 1.0)).save(tmp_path / "m")
    assert sb.load(tmp_path / "m").predict(1).y == [[8.0]]
    code = "import splitband as sb; sb.load('m')"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert "the class Last is not known here: import my_parts first" in done.stderr
    edit(tmp_path / "m", lambda d: d["forecaster"].update(module="__main__"))
    assert sb.load(tmp_path / "m").predict(1).y == [[8.0]]  # it was a script, and is imported now


class Forgetful(sb.GRU):
    """A cell that does not keep the argument of its constructor."""

    def __init__(self, units: int, ny: int = 1, nu: int = 0) -> None:
        super().__init__(2 * units, ny, nu)

    def sized(self, ny: int, nu: int, warmup: int) -> Forgetful:
        return Forgetful(self.hidden_size // 2, ny, nu)


def test_a_class_that_could_not_be_loaded_is_refused(tmp_path: Path) -> None:
    class Inner(OwnForecaster):
        pass

    for model, said in (
        (Inner(sb.Mean()), r"Inner cannot be saved: .* define it in a module"),
        (sb.Single(Forgetful(1), SHORT), "Forgetful cannot be saved: .* argument units"),
    ):
        model.fit(TRAIN)
        with pytest.raises(ValueError, match=said):
            model.save(tmp_path)
        assert not [*tmp_path.iterdir()]


def test_the_folder_of_a_result_stands_for_its_model_unless_it_holds_another(folder: Path) -> None:
    assert np.array_equal(ahead(sb.load(folder.parent)).y, ahead(fitted("gru")).y)
    fitted("gru").save(folder.parent)
    with pytest.raises(ValueError, match=r"must hold one model, got two.*remove"):
        sb.load(folder.parent)


def test_a_missing_file_is_named(folder: Path, tmp_path: Path) -> None:
    weights(folder).unlink()
    with pytest.raises(FileNotFoundError, match=rf"no model in {folder}: weights-.* is missing"):
        sb.load(folder)
    (folder / "forecaster.json").unlink()
    for path in (folder, tmp_path / "none"):
        with pytest.raises(FileNotFoundError, match=rf"no model in {path}: forecaster.json is mis"):
            sb.load(path)
    (folder / "model.json").write_text("{}")
    with pytest.raises(FileNotFoundError, match=r"0.1 or 0.2: train it again, with `splitband fit"):
        sb.load(folder)


@pytest.mark.parametrize("text", [b"{", b"[1]", b"\xff\xfe\x00", b"[" * 100_000, b" " * 200_001])
def test_a_damaged_description_is_named(
    folder: Path, text: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(saving, "LARGEST_DESCRIPTION", 200_000)
    (folder / "forecaster.json").write_bytes(text)
    with pytest.raises(sb.InputError, match=r"forecaster\.json is damaged"):
        sb.load(folder)


@pytest.mark.parametrize("version", [8, None])
def test_another_format_is_refused_with_what_to_do(folder: Path, version: object) -> None:
    edit(folder, lambda d: d.update(format=version))
    with pytest.raises(
        sb.InputError, match=rf"format {version!r}.*train it again, with `splitband"
    ):
        sb.load(folder)


def test_every_damaged_byte_of_the_weights_is_noticed(folder: Path) -> None:
    path = weights(folder)
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[-1] ^= 1
    for damaged in (whole[:-4], whole[:10], b"", whole + b"\0", bytes(flipped)):
        path.write_bytes(damaged)
        with pytest.raises(sb.InputError, match=r"weights-.*safetensors is damaged"):
            sb.load(folder)


def forge(folder: Path, **changes: Any) -> None:
    """Put other arrays in, with their checksum, or other facts and options; None removes them."""
    arrays = safetensors.numpy.load_file(weights(folder))
    description = json.loads((folder / "forecaster.json").read_text())
    said = description["forecaster"]
    for name, value in changes.items():
        is_array = name in arrays or isinstance(value, np.ndarray)
        place = (
            said["options"] if name in said["options"] else arrays if is_array else said["facts"]
        )
        place.pop(name, None)
        place |= {} if value is None else {name: value}
    content = safetensors.numpy.save(arrays)
    weights(folder).unlink()
    description["weights_sha256"] = hashlib.sha256(content).hexdigest()
    (folder / saving.WEIGHTS.format(description["weights_sha256"][:16])).write_bytes(content)
    (folder / "forecaster.json").write_text(json.dumps(description))


TWO = np.zeros(2)
BIAS = "_weights.cell.transition.bias_hh"


@pytest.mark.parametrize(
    ("kind", "name", "value", "said"),
    [
        ("mean", "level", None, "level is missing"),
        ("mean", "level", TWO, r"level must have the shape \(1,\), got \(2,\)"),
        ("mean", "level", TWO.astype(int), "level must be an array of float64, got int64"),
        ("mean", "learn", TWO, "learn must not be replaced"),
        ("mean", "fitted.begin", "7", "begin must not be '7'"),
        ("mean", "fitted.start", "NaT", "holds no forecaster that can be read"),
        ("mean", "fitted.record.columns", ["a", "b"], "columns"),
        ("periodic", "baseline.channels.0.dampings", None, "dampings is missing"),
        ("linear", "model.late", np.array([10**12]), "delays must be between"),
        ("linear", "u", np.zeros((200, 2)), r"u must have the shape \(any, 1\)"),
        ("calibrated", "applied.gain", TWO, "gain must have 1 value"),
        ("calibrated", "applied.clock", float("nan"), "must be finite, and its clock"),
        ("calibrated", "applied.speed", TWO, "applied is damaged: it has 'speed'"),
        ("gru", BIAS, TWO, "of the weights must be"),
        ("gru", BIAS, np.zeros(6, "f2"), "is torch.float16"),
        ("gru", BIAS, np.zeros(6), "weights must be of one precision"),
        ("gru", "cell", 3, "a cell must have"),
        ("ensemble", "count", 3, "'2' is missing"),
    ],
)
def test_what_no_fit_finds_is_refused_even_with_its_checksum(
    kind: str, name: str, value: Any, said: str, tmp_path: Path
) -> None:
    fitted(kind).save(tmp_path)
    forge(tmp_path, **{name: value})
    with pytest.raises(sb.InputError, match=said):
        sb.load(tmp_path)


def places(value: Any) -> list[tuple[Any, Any]]:
    """Where a description has a whole number."""
    if not isinstance(value, dict | list):
        return []
    keys = [*value] if isinstance(value, dict) else [*range(len(value))]
    return [(value, k) for k in keys if type(value[k]) is int] + [
        place for k in keys for place in places(value[k])
    ]


def test_a_size_that_was_forged_takes_no_memory(tmp_path: Path) -> None:
    """In a template of a cell, too, of which there are no weights in the file."""
    fitted("split").save(tmp_path)
    path = tmp_path / "forecaster.json"
    whole, before = path.read_text(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for i in range(len(places(json.loads(whole)))):
        description = json.loads(whole)
        part, key = places(description)[i]
        part[key] = 1_000_000
        path.write_text(json.dumps(description))
        with contextlib.suppress(ValueError):
            ahead(sb.load(tmp_path))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


@pytest.mark.parametrize(
    ("name", "module"),
    [("system", "os"), ("Linear", "torch.nn"), ("Fmu", None), ("load", None), (["x"], 3)],
)
def test_loading_runs_no_code_that_a_file_names(folder: Path, name: Any, module: Any) -> None:
    forged = {"kind": name, "options": {"command": f"touch {folder / 'ran'}"}}
    forged |= {"facts": {}} | ({} if module is None else {"module": module})
    for change in (
        lambda d: d.update(forecaster=forged),
        lambda d: d["forecaster"]["options"].update(cell=forged),
    ):
        edit(folder, change)
        with pytest.raises(sb.InputError, match="holds no forecaster that can be read"):
            sb.load(folder)
    assert not (folder / "ran").exists()


@pytest.mark.parametrize("renames", [(0, 0), (1, 1), (1, 0)])
def test_whichever_rename_is_interrupted_a_whole_forecaster_is_left(
    folder: Path, renames: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And if it is interrupted once more over what the first interruption has left."""
    before, new = ahead(sb.load(folder)).y, other()
    rename = Path.replace
    for allowed in renames:
        left = iter(range(allowed))

        def interrupted(self: Path, target: Any, left: Any = left) -> Path:
            if next(left, None) is None:
                raise KeyboardInterrupt
            return rename(self, target)

        with monkeypatch.context() as patched:
            patched.setattr(Path, "replace", interrupted)
            with pytest.raises(KeyboardInterrupt):
                new.save(folder)
        np.testing.assert_array_equal(ahead(sb.load(folder)).y, before)
    new.save(folder)
    np.testing.assert_array_equal(ahead(sb.load(folder)).y, ahead(new).y)
    assert len(contents(folder)) == 2
