"""Saved forecasters: the same to the bit when loaded, whole or not at all, and never code."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import safetensors.torch
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


def test_a_network_in_double_precision_stays_in_it(tmp_path: Path) -> None:
    model = sb.Single(sb.GRU(2), SHORT).fit(TRAIN)
    assert model.model is not None
    model.model.double()
    model.save(tmp_path)
    np.testing.assert_array_equal(ahead(sb.load(tmp_path)).y, ahead(model).y)


# ---------------------------------------------------------------- of the user's own


class Own(Leaky):
    """A cell of the user's own, with two names for one matrix."""

    def __init__(self, ny: int = 1, nu: int = 0, scales: Any = None) -> None:
        super().__init__(ny, nu)
        self.scales, self.again = scales, nn.Linear(ny + nu, ny)
        self.again.weight = self.mix.weight

    def sized(self, ny: int, nu: int, warmup: int) -> Own:
        return Own(ny, nu, self.scales)


class OwnForecaster(sb.Forecaster):
    """A forecaster of the user's own, around another one."""

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
        self.found = {"levels": (np.array([[np.nan, 2.0]]), float("inf")), "day": None}
        self.of_inner = self.inner.clone().fit(*records)

    def extrapolate(self, known: ForecastContext) -> Array:
        parts = self.of_inner.extrapolate(known)
        values = sum(parts.values()) if isinstance(parts, dict) else parts
        return self.factor * np.asarray(values)


def test_what_is_ones_own_is_saved_and_loaded_without_being_registered(tmp_path: Path) -> None:
    inner = sb.Single(Own(scales={"x": [1, 2.5]}), SHORT)
    model = sb.Ensemble(OwnForecaster(inner, 0.5), 2).fit(TRAIN, seed=0)
    expected = ahead(model, 0.8)
    model.save(tmp_path)
    loaded = sb.load(tmp_path)
    np.testing.assert_array_equal(ahead(loaded, 0.8).lower, expected.lower)
    assert isinstance(loaded, sb.Ensemble)
    assert loaded.in_words() == "0.5 times the last value"
    member: Any = loaded.members[1]
    (array, limit) = member.found["levels"]
    np.testing.assert_array_equal(array, [[np.nan, 2.0]])
    assert limit == float("inf")
    cell = member.of_inner.model.cell
    assert cell.again.weight is cell.mix.weight
    assert cell.scales == {"x": [1, 2.5]}


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


def test_of_classes_that_a_notebook_defines_again_the_latest_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notebook = ModuleType("notebook")
    monkeypatch.setitem(sys.modules, "notebook", notebook)

    def defined(level: float) -> sb.Forecaster:
        cell = (
            "import splitband as sb\nclass Level(sb.Forecaster):\n    name = 'level'\n"
            f"    def extrapolate(self, known):\n        return {level} + 0 * known.y[:1]\n"
        )
        exec(cell, vars(notebook))
        made: sb.Forecaster = notebook.Level()
        return made

    first, _ = defined(1.0), defined(2.0)
    first.fit(sb.Record(np.arange(9.0), 1.0)).save(tmp_path / "m")
    assert sb.load(tmp_path / "m").predict(1).y == [[2.0]]


class LastTwenty(sb.Forecaster):
    """Looks back further than it says, and keeps what `value` is."""

    name = "last-twenty"
    value: Any = None

    def learn(self, records: Any, **_: Any) -> None:
        self.kept = type(self).value

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.tile(known.y[-20:].mean(axis=0), (known.steps, 1))


def test_one_s_own_is_saved_with_all_of_its_history(tmp_path: Path) -> None:
    for name, own in (("alone", LastTwenty()), ("several", sb.Ensemble(LastTwenty(), 2))):
        model = own.fit(TRAIN)
        model.save(tmp_path / name)
        np.testing.assert_array_equal(ahead(sb.load(tmp_path / name)).y, ahead(model).y)


class Line(NamedTuple):
    slope: float
    places: Any


def test_what_one_keeps_is_loaded_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    value = {"1": [np.ones(2)], "1.0": np.zeros(2), "size": nn.Linear(3, 2).weight.shape}
    value["built"] = np.datetime64("2024-03-01T10:00", "ns")
    monkeypatch.setattr(LastTwenty, "value", value)
    LastTwenty().fit(TRAIN).save(tmp_path)
    loaded: Any = sb.load(tmp_path)
    assert loaded.kept.pop("built") == pd.Timestamp("2024-03-01 10:00")
    np.testing.assert_equal(loaded.kept, {k: v for k, v in value.items() if k != "built"})


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (np.ones(3, complex), "an array of complex128 cannot be saved"),
        (Line(2.0, np.arange(3.0)), "Line cannot be saved: "),
    ],
)
def test_what_no_file_holds_is_refused(
    value: Any, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LastTwenty, "value", value)
    with pytest.raises(ValueError, match=says):
        LastTwenty().fit(TRAIN).save(tmp_path)


class Dropping(Leaky):
    """A cell of the user's own that drops a half of what it sees, in training."""

    def sized(self, ny: int, nu: int, warmup: int) -> Dropping:
        return Dropping(ny, nu)

    def step(self, state: Any, y: Any, u: Any = None) -> Any:
        return nn.functional.dropout(super().step(state, y, u), training=self.training)


def test_what_is_drawn_in_training_is_not_in_a_prediction(tmp_path: Path) -> None:
    model = sb.Single(Dropping(), SHORT).fit(TRAIN)
    model.save(tmp_path)
    expected = ahead(model).y
    for each in (model, sb.load(tmp_path)):
        np.testing.assert_array_equal(ahead(each).y, expected)


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
        (sb.Single(Forgetful(1), SHORT), r"Forgetful cannot be saved: .* argument units"),
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


@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[1]", b"3", b"\xff\xfe\x00", b"[" * 100_000],
    ids=["empty", "cut", "list", "number", "binary", "deep"],
)
def test_a_damaged_description_is_named(folder: Path, text: bytes) -> None:
    (folder / "forecaster.json").write_bytes(text)
    with pytest.raises(ValueError, match=r"forecaster\.json is damaged"):
        sb.load(folder)


@pytest.mark.parametrize("version", [0, 5, "3", None])
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


def resealed(folder: Path, content: bytes) -> None:
    """Put other weights in, with their checksum."""
    weights(folder).unlink()
    digest = hashlib.sha256(content).hexdigest()
    (folder / saving.WEIGHTS.format(digest[:16])).write_bytes(content)
    edit(folder, lambda d: d.update(weights_sha256=digest))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: {k: v[..., :1] for k, v in t.items()}, "must be"),
        (lambda t: {k: v.half() if "weight" in k else v for k, v in t.items()}, "float16"),
        (lambda t: {}, "is missing"),
        (None, "is damaged"),
    ],
    ids=["size", "half precision", "none", "kind"],
)
def test_weights_that_do_not_fit_are_refused_even_with_their_checksum(
    folder: Path, change: Callable[[Any], Any] | None, said: str
) -> None:
    content = b"not safetensors"
    if change is not None:
        found = change(safetensors.torch.load_file(weights(folder)))
        content = safetensors.torch.save({k: v.contiguous() for k, v in found.items()})
    resealed(folder, content)
    with pytest.raises(ValueError, match=said):
        sb.load(folder)


def test_no_memory_is_taken_for_what_a_file_only_says(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A GRU of ten thousand units has 1.2 GB of weights."""

    def size(hidden: int) -> Callable[[dict[str, Any]], Any]:
        return lambda d: d["forecaster"]["fields"]["cell"]["fields"].update(hidden_size=hidden)

    edit(folder, size(10_000))
    with pytest.raises(ValueError, match=r"of the weights must be"):
        sb.load(folder)
    edit(folder, size(10_001))
    with pytest.raises(ValueError, match=r"hidden_size must be between 1 and 10000, got 10001"):
        sb.load(folder)
    monkeypatch.setattr("splitband.forecasters.saving.LARGEST_DESCRIPTION", 100)
    with pytest.raises(ValueError, match="larger than 100 bytes"):
        sb.load(folder)


@pytest.mark.parametrize(
    ("word", "name", "module"),
    [
        ("class", "system", "os"),
        ("class", "Popen", "subprocess"),
        ("cell", "Linear", "torch.nn"),
        ("class", "Fmu", None),
        ("class", "Isolated", None),
        ("class", ["x"], 3),
    ],
)
def test_loading_runs_no_code_that_a_file_names(
    folder: Path, word: str, name: Any, module: Any
) -> None:
    forged = {word: name, "fields": {"command": f"touch {folder / 'ran'}"}}
    forged |= {} if module is None else {"module": module}
    for change in (
        lambda d: d.update(forecaster=forged),
        lambda d: d["forecaster"]["fields"].update(cell=forged),
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
