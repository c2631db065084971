"""Saved models: the same to the bit when loaded, whole or not at all, and never code."""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch

from splitband import GRU, ComplementaryPair, EulerMLP, Record, Settings, StateSpace
from splitband.filters import butterworth
from splitband.models import Filtered, Model, Recurrent, Residual, Split
from splitband.models.saving import load, save
from splitband.training import fit

RATE, WARMUP, STEPS = 10.0, 15, 40
NY, NU = 2, 1
RNG = np.random.default_rng(3)
RECORD = Record(
    RNG.standard_normal((80, NY)) + 5,
    1 / RATE,
    u=RNG.standard_normal((80, NU)),
    y_sim=RNG.standard_normal((80, NY)),
)
PAIR = ComplementaryPair.butterworth(1.0, RATE, 2)
ONE_WAY = ComplementaryPair.perfect(*butterworth(1.0, RATE, 2), RATE, cutoff=1.0)


def gru(told: int = 0) -> GRU:
    return GRU(5, NY, NU + told)


def rnn(warmup: int = WARMUP, told: int = 0) -> EulerMLP:
    return EulerMLP(NY, warmup, 3, 6, 4, 0.1, NU + told)


MODELS: dict[str, Callable[[], Model]] = {
    "gru": lambda: Recurrent(gru()),
    "rnn": lambda: Recurrent(rnn()),
    "split-gru": lambda: Split([gru(), gru()], PAIR, 3),
    "split-gru-hp": lambda: Split([gru(), gru()], PAIR, 2, filter_output=True),
    "split-rnn": lambda: Split([rnn(7), rnn()], PAIR, 2),
    "filtered-gru": lambda: Filtered(gru(), ONE_WAY),
    "filtered-rnn-conditioned": lambda: Filtered(rnn(told=2 * NY), ONE_WAY, conditioned=True),
    "residual-gru-conditioned": lambda: Residual(gru(told=2 * NY), conditioned=True),
    "three-bands-conditioned": lambda: Split(
        [gru(), gru(told=2 * NY), gru(told=2 * NY)],
        [ComplementaryPair.butterworth(0.4, RATE, 2), PAIR],
        [4, 2],
        conditioned=True,
    ),
    "residual-rnn": lambda: Residual(rnn()),
    "state-space": lambda: Recurrent(StateSpace(3, 4, NY, 2 * NU), feedthrough=True),
    "gru-feedthrough": lambda: Recurrent(gru(told=NU), feedthrough=True),
}


def simulate(model: Model) -> np.ndarray:
    assert RECORD.u is not None
    assert RECORD.y_sim is not None
    y_sim = RECORD.y_sim if isinstance(model, Filtered | Residual) else None
    return model.simulate(RECORD.y[:WARMUP], STEPS, RECORD.u[: WARMUP + STEPS], y_sim)


def trained(name: str) -> Model:
    model = MODELS[name]()
    fit(model, RECORD, Settings(window=30, warmup=WARMUP, epochs=1))
    return model


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A saved model."""
    save(Recurrent(gru()), tmp_path / "model", {"unit": "N m"})
    return tmp_path / "model"


def edit(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    path = folder / "model.json"
    description = json.loads(path.read_text())
    change(description)
    path.write_text(json.dumps(description))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


# ---------------------------------------------------------------- what comes back


@pytest.mark.parametrize("name", MODELS)
def test_a_loaded_model_simulates_as_before_to_the_bit(name: str, tmp_path: Path) -> None:
    model = trained(name)
    before = simulate(model)
    save(model, tmp_path / "deep" / "model")
    loaded, _ = load(tmp_path / "deep" / "model")
    assert type(loaded) is type(model)
    np.testing.assert_array_equal(simulate(loaded), before)
    assert np.isfinite(before).all()


@pytest.mark.parametrize(
    "name", ["split-gru-hp", "residual-gru-conditioned", "three-bands-conditioned"]
)
def test_a_loaded_model_trains_on_as_before(name: str, tmp_path: Path) -> None:
    model = trained(name)
    save(model, tmp_path)
    loaded, _ = load(tmp_path)
    more = Settings(window=30, warmup=WARMUP, epochs=1)
    assert fit(loaded, RECORD, more, seed=4).losses == fit(model, RECORD, more, seed=4).losses
    np.testing.assert_array_equal(simulate(loaded), simulate(model))


def test_a_model_in_double_precision_stays_in_it(tmp_path: Path) -> None:
    model = Recurrent(gru()).double()
    save(model, tmp_path)
    np.testing.assert_array_equal(simulate(load(tmp_path)[0]), simulate(model))


def test_saving_a_loaded_model_writes_the_same_files(folder: Path, tmp_path: Path) -> None:
    model, facts = load(folder)
    save(model, tmp_path / "again", facts)
    assert contents(tmp_path / "again") == contents(folder)


def test_facts_come_back_as_they_were(tmp_path: Path) -> None:
    facts = {"columns": ["a", "b"], "setup": {"warmup": 3}, "sampling_time": 0.1, "none": None}
    save(Recurrent(gru()), tmp_path, facts)
    assert load(tmp_path)[1] == facts


class Scaled(GRU):
    """A cell of the user's own."""

    def __init__(self, ny: int, hidden_size: int, nu: int, scales: Any = 1.0) -> None:
        super().__init__(hidden_size, ny, nu)
        self.arguments = {"ny": ny, "hidden_size": hidden_size, "nu": nu, "scales": scales}
        self.scales = scales

    def observe(self, h: Any) -> Any:
        scale = self.scales["y"] if isinstance(self.scales, dict) else float(np.sum(self.scales))
        return scale * super().observe(h)


@pytest.mark.parametrize(
    "scales",
    [
        3.0,
        [1, 2],
        {"y": 2.0},
    ],
    ids=["number", "list", "dict"],
)
def test_a_cell_of_ones_own_comes_back_through_cells(tmp_path: Path, scales: Any) -> None:
    model = Split([gru(), Scaled(NY, 4, NU, scales)], PAIR)
    save(model, tmp_path)
    loaded, _ = load(tmp_path, {"Scaled": Scaled})
    assert isinstance(loaded, Split)
    assert type(loaded.networks[1]) is Scaled
    np.testing.assert_array_equal(simulate(loaded), simulate(model))


def test_a_cell_of_ones_own_is_asked_for_by_name(tmp_path: Path) -> None:
    save(Recurrent(Scaled(NY, 4, NU)), tmp_path)
    with pytest.raises(ValueError, match=r"unknown type 'Scaled'; pass its constructor in `cells`"):
        load(tmp_path)


def test_a_cell_that_does_not_say_how_to_build_it_is_refused(tmp_path: Path) -> None:
    class Plain(GRU):
        pass

    with pytest.raises(ValueError, match="Plain cannot be saved: give it `arguments`"):
        save(Recurrent(Plain(4, NY, NU)), tmp_path)
    with pytest.raises(FileNotFoundError, match="no model in"):
        load(tmp_path)


# ---------------------------------------------------------------- damage


@pytest.mark.parametrize("name", ["model.json", "weights.safetensors"])
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"no model in {folder}: {name} is missing"):
        load(folder)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=f"no model in {tmp_path / 'none'}"):
        load(tmp_path / "none")


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[1]",
        b"3",
        b"{}",
        b"\xff\xfe\x00",
        b'{"format": 1, "model": {}}',
        b'{"format": 1, "model": {}, "weights_sha256": "", "facts": 3}',
        b"[" * 100_000,
    ],
    ids=["empty", "cut", "list", "number", "no keys", "binary", "some keys", "facts", "deep"],
)
def test_a_damaged_description_is_named(folder: Path, text: bytes) -> None:
    (folder / "model.json").write_bytes(text)
    with pytest.raises(ValueError, match=r"model\.json is damaged"):
        load(folder)


@pytest.mark.parametrize("version", [0, 1, "2", None])
def test_another_format_is_refused_with_both_numbers(folder: Path, version: object) -> None:
    edit(folder, lambda d: d.update(format=version))
    with pytest.raises(ValueError, match=rf"model\.json has format {version!r}; this is for 2"):
        load(folder)


def test_every_damaged_byte_of_the_weights_is_noticed(folder: Path) -> None:
    path = folder / "weights.safetensors"
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[-1] ^= 1
    for damaged in (whole[:-4], whole[:10], b"", whole + b"\0", bytes(flipped)):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"weights\.safetensors is damaged"):
            load(folder)


def test_the_weights_of_another_model_are_refused(folder: Path, tmp_path: Path) -> None:
    save(Recurrent(gru()), tmp_path / "other")
    (tmp_path / "other" / "weights.safetensors").replace(folder / "weights.safetensors")
    with pytest.raises(ValueError, match=r"weights\.safetensors is damaged: its checksum"):
        load(folder)


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        (safetensors.torch.save(dict(Recurrent(GRU(6, NY, NU)).state_dict())), "must be"),
        (safetensors.torch.save(dict(Recurrent(rnn()).state_dict())), "must be"),
        (safetensors.torch.save(dict(Recurrent(gru()).half().state_dict())), "float16"),
        (safetensors.torch.save(dict(Recurrent(gru()).state_dict())) + bytes(2**21), "at most"),
        (b"not safetensors", "damaged"),
    ],
    ids=["size", "cell", "half precision", "long", "kind"],
)
def test_weights_that_do_not_fit_are_refused_even_with_their_checksum(
    folder: Path, weights: bytes, said: str
) -> None:
    (folder / "weights.safetensors").write_bytes(weights)
    edit(folder, lambda d: d.update(weights_sha256=hashlib.sha256(weights).hexdigest()))
    with pytest.raises(ValueError, match=rf"weights\.safetensors .*{said}"):
        load(folder)


def test_no_memory_is_taken_for_what_a_file_only_says(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A GRU of ten thousand units has 1.2 GB of weights."""
    edit(folder, lambda d: d["model"]["cell"].update(hidden_size=10_000))
    with pytest.raises(ValueError, match=r"weights\.safetensors is not the model's: .* must be"):
        load(folder)
    edit(folder, lambda d: d["model"]["cell"].update(hidden_size=10_001))
    with pytest.raises(ValueError, match=r"hidden_size must be between 1 and 10000, got 10001"):
        load(folder)
    edit(folder, lambda d: d["model"]["cell"].update(hidden_size=1_000_001))
    with pytest.raises(ValueError, match=r"hidden_size of GRU must be a whole number up to"):
        load(folder)
    monkeypatch.setattr("splitband.models.saving.LARGEST_DESCRIPTION", 100)
    with pytest.raises(ValueError, match="larger than 100 bytes"):
        load(folder)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(model="Recurrent"),
        lambda d: d.update(model=d["model"]["cell"]),
        lambda d: d["model"].pop("cell"),
        lambda d: d["model"].update(extra=1),
        lambda d: d["model"]["cell"].update(hidden_size=-1),
        lambda d: d["model"]["cell"].update(hidden_size="5"),
        lambda d: d["model"]["cell"].update(hidden_size=[5]),
        lambda d: d["model"]["cell"].pop("type"),
        lambda d: d["model"].update(type=["Recurrent"]),
        lambda d: d["model"].update(cell=None),
    ],
    ids=[
        "name", "no model", "no cell", "too much", "negative size", "text size", "list size",
        "no type", "list type", "null cell",
    ],
)  # fmt: skip
def test_a_description_of_no_model_is_named(
    folder: Path, change: Callable[[dict[str, Any]], Any]
) -> None:
    edit(folder, change)
    with pytest.raises(ValueError, match=r"model\.json describes no model: \S"):
        load(folder)


@pytest.mark.parametrize("where", ["model", "cell"])
@pytest.mark.parametrize("name", ["os.system", "system", "eval", "__import__", "load"])
def test_loading_runs_no_code_that_a_file_names(folder: Path, name: str, where: str) -> None:
    def change(description: dict[str, Any]) -> None:
        part = description["model"] if where == "model" else description["model"]["cell"]
        part.clear()
        part.update(type=name, command=f"touch {folder / 'ran'}")

    edit(folder, change)
    with pytest.raises(ValueError, match=f"unknown type '{name}'"):
        load(folder)
    assert not (folder / "ran").exists()


# ---------------------------------------------------------------- writing


def test_saving_over_a_model_replaces_it(folder: Path) -> None:
    model = trained("residual-rnn")
    save(model, folder)
    np.testing.assert_array_equal(simulate(load(folder)[0]), simulate(model))
    assert sorted(contents(folder)) == ["model.json", "weights.safetensors"]


def crash_while_writing(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    write = getattr(Path, method)

    def crash(self: Path, data: Any, *args: Any, **options: Any) -> None:
        write(self, data[: len(data) // 2], *args, **options)
        raise OSError("disk full")

    monkeypatch.setattr(Path, method, crash)


@pytest.mark.parametrize(
    "method",
    [
        "write_bytes",
        "write_text",
    ],
)
def test_a_crash_while_saving_leaves_the_old_model(
    folder: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    before = contents(folder)
    with monkeypatch.context() as patched:
        crash_while_writing(patched, method)
        with pytest.raises(OSError, match="disk full"):
            save(trained("rnn"), folder)
    load(folder)
    assert contents(folder) == before


@pytest.mark.parametrize("fact", [float("nan"), object()], ids=["nan", "object"])
def test_facts_that_json_cannot_hold_leave_the_old_model(folder: Path, fact: object) -> None:
    with pytest.raises((TypeError, ValueError)):
        save(trained("gru"), folder, {"fact": fact})
    load(folder)


def test_a_crash_at_the_first_save_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        crash_while_writing(patched, "write_bytes")
        with pytest.raises(OSError, match="disk full"):
            save(Recurrent(gru()), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="file modes are POSIX")
def test_saved_files_have_the_usual_mode(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    usual = (tmp_path / "plain").stat().st_mode
    assert {path.stat().st_mode for path in folder.iterdir()} == {usual}


@pytest.mark.parametrize("name", ["gru", "split-gru", "filtered-gru", "residual-gru-conditioned"])
def test_a_model_that_010_saved_is_read_as_it_was(name: str, tmp_path: Path) -> None:
    """Its file does not know of feedthrough."""
    model = trained(name)
    save(model, tmp_path)
    edit(tmp_path, lambda description: description["model"].pop("feedthrough"))
    loaded = load(tmp_path)[0]
    assert not loaded.feedthrough
    np.testing.assert_array_equal(simulate(loaded), simulate(model))
