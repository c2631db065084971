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
from tests.streams import Leaky
from tests.support import edit, known_after

Array = npt.NDArray[np.float64]
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
    "calibrated": sb.Calibrated,
    "residual": lambda: sb.Residual(sb.Periodic(), sb.GRU(2), settings=SHORT),
    "ensemble": lambda: sb.Ensemble(sb.Single(sb.GRU(2), SHORT), 2),
    "split": lambda: sb.Split(sb.GRU(2), sb.GRU(3), sb.Bands(0.5, 1, 2), settings=SHORT),
    "rnn": lambda: sb.Single(sb.networks.EulerMLP(hidden_size=4, recognition_size=3), SHORT),
}


@cache
def fitted(kind: str) -> sb.Forecaster:
    return EVERY[kind]().fit(TRAIN, seed=0)


@cache
def small(seed: int = 0) -> sb.Forecaster:
    """A network that is saved by many tests, and trained once."""
    return sb.Single(sb.GRU(2), SHORT).fit(TRAIN, seed=seed)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    small().save(tmp_path / "model")
    return tmp_path / "model"


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
    model = sb.Single(sb.GRU(2), SHORT).fit(TRAIN)
    assert model.model is not None
    model.model.double()
    model.save(tmp_path)
    np.testing.assert_array_equal(ahead(sb.load(tmp_path)).y, ahead(model).y)


# ---------------------------------------------------------------- of the user's own


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


class Polynomial(sb.Forecaster):
    """Keeps what is no array."""

    name = "polynomial"

    def learn(self, records: Any, **_: Any) -> None:
        self.line = np.poly1d(np.polyfit(np.arange(len(records[0])), records[0].y[:, 0], 2))

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.asarray(self.line(len(known.y) + np.arange(known.steps)))[:, None]


class WithState(Polynomial):
    """Says what is to be saved of it."""

    def state(self) -> dict[str, npt.NDArray[Any]]:
        return {"coefficients": self.line.coef}

    @classmethod
    def from_state(cls, options: Mapping[str, Any], arrays: Any) -> WithState:
        new = cls(**options)
        new.line = np.poly1d(arrays["coefficients"])
        return new


def test_what_is_no_array_is_refused_unless_the_class_says_what_its_state_is(
    tmp_path: Path,
) -> None:
    says = "Polynomial cannot be saved with its attribute line .* define state.. and from_state"
    with pytest.raises(ValueError, match=says):
        Polynomial().fit(TRAIN).save(tmp_path)
    model = WithState().fit(TRAIN)
    model.save(tmp_path)
    np.testing.assert_array_equal(ahead(sb.load(tmp_path)).y, ahead(model).y)


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


class LastTwenty(sb.Forecaster):
    """Looks back further than it says."""

    name = "last-twenty"

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.tile(known.y[-20:].mean(axis=0), (known.steps, 1))


def test_one_s_own_is_saved_with_all_of_its_history(tmp_path: Path) -> None:
    for name, own in (("alone", LastTwenty()), ("several", sb.Ensemble(LastTwenty(), 2))):
        model = own.fit(TRAIN)
        model.save(tmp_path / name)
        np.testing.assert_array_equal(ahead(sb.load(tmp_path / name)).y, ahead(model).y)


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
        (
            sb.Single(Forgetful(1), SHORT),
            "Forgetful cannot be saved: .* argument units",
        ),
    ):
        model.fit(TRAIN)
        with pytest.raises(ValueError, match=said):
            model.save(tmp_path)
        assert not [*tmp_path.iterdir()]


# ---------------------------------------------------------------- damage


def test_the_folder_of_a_result_stands_for_its_model_unless_it_holds_another(folder: Path) -> None:
    assert np.array_equal(ahead(sb.load(folder.parent)).y, ahead(small()).y)
    small().save(folder.parent)
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


@pytest.mark.parametrize("text", [b"{", b"[1]", b"\xff\xfe\x00", b"[" * 100_000])
def test_a_damaged_description_is_named(folder: Path, text: bytes) -> None:
    (folder / "forecaster.json").write_bytes(text)
    with pytest.raises(ValueError, match=r"forecaster\.json is damaged"):
        sb.load(folder)


@pytest.mark.parametrize("version", [8, None])
def test_another_format_is_refused_with_what_to_do(folder: Path, version: object) -> None:
    edit(folder, lambda d: d.update(format=version))
    with pytest.raises(ValueError, match=rf"format {version!r}.*train it again, with `splitband"):
        sb.load(folder)


def test_every_damaged_byte_of_the_weights_is_noticed(folder: Path) -> None:
    path = weights(folder)
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[-1] ^= 1
    for damaged in (whole[:-4], whole[:10], b"", whole + b"\0", bytes(flipped)):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"weights-.*safetensors is damaged"):
            sb.load(folder)


def resealed(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Put other arrays in, with their checksum."""
    arrays = safetensors.numpy.load_file(weights(folder))
    change(arrays)
    content = safetensors.numpy.save(arrays)
    weights(folder).unlink()
    digest = hashlib.sha256(content).hexdigest()
    (folder / saving.WEIGHTS.format(digest[:16])).write_bytes(content)
    edit(folder, lambda d: d.update(weights_sha256=digest))


def facts(d: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = d["forecaster"]["facts"]
    return found


def put(**changes: Any) -> Callable[[dict[str, Any]], None]:
    """Other values for arrays, or for facts; a dot is written as two underscores."""
    return lambda found: found.update({k.replace("__", "."): v for k, v in changes.items()})


TWO = np.zeros(2)


@pytest.mark.parametrize(
    ("kind", "change", "said"),
    [
        ("mean", lambda t: t.pop("level"), "level is missing"),
        ("mean", put(level=TWO), r"level must have the shape \(1,\), got \(2,\)"),
        ("mean", put(level=TWO.astype(int)), "level must be an array of float64, got int64"),
        ("mean", put(learn=TWO), "learn must not be replaced"),
        ("periodic", lambda t: t.pop("baseline.channels.0.dampings"), "dampings is missing"),
        ("linear", put(model__late=np.array([10**12])), "delays must be between"),
        ("linear", put(u=np.zeros((200, 2))), r"u must have the shape \(any, 1\)"),
        ("calibrated", put(applied__gain=TWO), "gain must have 1 value"),
        ("calibrated", put(applied__speed=TWO), "applied is damaged: it has 'speed'"),
        ("rnn", lambda t: t.update({k: v[..., :1] for k, v in t.items() if "wei" in k}), "must be"),
        ("rnn", lambda t: t.update({k: v.astype("f2") for k, v in t.items() if "wei" in k}), "16"),
    ],
)
def test_arrays_that_no_fit_finds_are_refused_even_with_their_checksum(
    kind: str, change: Callable[[Any], Any], said: str, tmp_path: Path
) -> None:
    fitted(kind).save(tmp_path)
    resealed(tmp_path, change)
    with pytest.raises(ValueError, match=said):
        sb.load(tmp_path)


@pytest.mark.parametrize(
    ("kind", "change", "said"),
    [
        ("mean", lambda d: put(fitted__begin="7")(facts(d)), "begin must not be '7'"),
        ("ensemble", lambda d: d["forecaster"]["options"].update(count=3), "'2' is missing"),
        ("residual", lambda d: d["forecaster"]["options"].update(cell=3), "a cell must have"),
    ],
)
def test_a_description_that_no_fit_has_is_refused(
    kind: str, change: Callable[[Any], Any], said: str, tmp_path: Path
) -> None:
    fitted(kind).save(tmp_path)
    edit(tmp_path, change)
    with pytest.raises(ValueError, match=said):
        sb.load(tmp_path)


def places(value: Any) -> list[tuple[Any, Any]]:
    """Where a description has a whole number."""
    if not isinstance(value, dict | list):
        return []
    keys = [*value] if isinstance(value, dict) else [*range(len(value))]
    return [(value, k) for k in keys if type(value[k]) is int] + [
        place for k in keys for place in places(value[k])
    ]


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
@pytest.mark.parametrize("kind", ["rnn", "split"])
def test_a_size_that_was_forged_takes_no_memory(kind: str, tmp_path: Path) -> None:
    """In a template of a cell, too, of which there are no weights in the file."""
    fitted(kind).save(tmp_path)
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


def test_a_description_that_is_too_large_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splitband.forecasters.saving.LARGEST_DESCRIPTION", 100)
    with pytest.raises(ValueError, match="larger than 100 bytes"):
        sb.load(folder)


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
        with pytest.raises(ValueError, match="holds no forecaster that can be read"):
            sb.load(folder)
    assert not (folder / "ran").exists()


# ---------------------------------------------------------------- writing


@pytest.mark.parametrize("renames", [(0, 0), (1, 1), (1, 0)])
def test_whichever_rename_is_interrupted_a_whole_forecaster_is_left(
    folder: Path, renames: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And if it is interrupted once more over what the first interruption has left."""
    before, new = ahead(sb.load(folder)).y, small(seed=5)
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


@pytest.mark.parametrize("suffix", [".safetensors", ".json"])
def test_a_full_disk_leaves_the_old_forecaster(
    folder: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, write = contents(folder), Path.write_bytes

    def crash(self: Path, data: bytes) -> int:
        if self.suffix != suffix:
            return write(self, data)
        write(self, data[: len(data) // 2])
        raise OSError("disk full")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", crash)
        with pytest.raises(OSError, match="disk full"):
            small(seed=5).save(folder)
    assert contents(folder) == before
