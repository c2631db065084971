"""Trainings that are cut off and go on, or end in time; those that go wrong are gone back from."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splitband import Record, Settings
from splitband.models import Model
from splitband.runtime.deadlines import Deadline, within
from splitband.training import History, Progress, fit
from splitband.training.checkpoints import Checkpoint
from splitband.training.network import MOST_RESTARTS, NetworkTraining
from tests.records import QUICK, SETUP, TRAIN, Setup, record
from tests.support import slowed, untrained

RECIPE = Settings(40, QUICK.warmup, 4, 16, learning_rate=0.01, one_cycle=True, clip=0.5, growth=0.6)


def with_bands(**changes: Any) -> Setup:
    return replace(SETUP, bands=replace(SETUP.bands, **changes))


class Killed(BaseException):
    """What nothing catches."""


def trained(
    checkpoint: Checkpoint | None = None,
    die_after: int | None = None,
    seed: int = 3,
    training: Record | None = None,
    settings: Settings = RECIPE,
    setup: Setup = SETUP,
) -> tuple[Model, History, list[Progress]]:
    training = record()[:TRAIN] if training is None else training
    model = untrained("split-gru-conditioned", training, setup, seed)
    seen: list[Progress] = []

    def watch(at: Progress) -> None:
        seen.append(at)
        if len(seen) == die_after:
            raise Killed

    return model, fit(model, training, settings, seed, watch, checkpoint), seen


def assert_same(model: Model, other: Model) -> None:
    for name, value in model.state_dict().items():
        assert torch.equal(value, other.state_dict()[name]), name


@pytest.mark.parametrize("die_after", [1, 4, 8])
def test_a_training_that_was_cut_off_ends_with_the_same_bits(
    die_after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splitband.training.checkpoints.MOST_OVERHEAD", 1e9)  # one after each epoch
    whole, history, _ = trained()
    file = tmp_path / "training.safetensors"
    with pytest.raises(Killed):
        trained(Checkpoint(file), die_after)
    model, resumed, seen = trained(Checkpoint(file))
    assert_same(model, whole)
    assert resumed.losses == history.losses
    assert len(seen) == 8 - (die_after - 1)  # the epoch in which it died has no checkpoint


def test_a_finished_training_is_not_repeated(tmp_path: Path) -> None:
    file = tmp_path / "training.safetensors"
    whole, history, _ = trained(Checkpoint(file))
    model, again, seen = trained(Checkpoint(file))
    assert_same(model, whole)
    assert again.losses == history.losses
    assert not seen


def test_the_checkpoint_of_another_training_is_none(tmp_path: Path) -> None:
    file = tmp_path / "training.safetensors"
    trained(Checkpoint(file))
    other = record()[1 : TRAIN + 1]
    changed = Settings(**{**vars(RECIPE), "clip": 0.4})
    for _, _, seen in (
        trained(Checkpoint(file), seed=4),
        trained(Checkpoint(file), training=other),
        trained(Checkpoint(file), settings=changed),
        trained(Checkpoint(file), setup=with_bands(downsampling=3)),
        trained(Checkpoint(file), setup=with_bands(cutoff=0.5)),
    ):
        assert len(seen) == 8
    for cutoff, epochs in ((0.6, 4), (0.6, 0), (0.5, 4)):  # a hybrid's is in no weight
        model = untrained("filtered-gru", record(), with_bands(cutoff=cutoff), 0)
        seen = []
        fit(model, record()[:TRAIN], RECIPE, 0, seen.append, Checkpoint(tmp_path / "hybrid"))
        assert len(seen) == epochs


@pytest.mark.parametrize("kind", [np.array, torch.tensor, lambda table: {"of": [table]}])
def test_the_checkpoint_of_a_network_with_another_table_is_none(kind: Any, tmp_path: Path) -> None:
    for value, epochs in ((1.0, 4), (1.0, 0), (1.0 + 1e-12, 4)):
        model = untrained("gru", record(), SETUP, 0)
        table = np.ones(2000)
        table[1000] = value
        model.table = kind(table)
        seen: list[Progress] = []
        fit(model, record()[:TRAIN], RECIPE, 0, seen.append, Checkpoint(tmp_path / "table"))
        assert len(seen) == epochs


def test_where_no_checkpoint_can_be_written_training_goes_on(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="no checkpoint could be written"):
        model, _, _ = trained(Checkpoint(tmp_path / "gone" / "training.safetensors"))
    assert_same(model, trained()[0])


def test_a_full_disk_keeps_the_last_good_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "training.safetensors"
    trained(Checkpoint(file))
    kept = file.read_bytes()

    def full(tensors: object, path: Path, metadata: object) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("safetensors.torch.save_file", full)
    with pytest.warns(UserWarning, match="No space left"):
        trained(Checkpoint(file), seed=9)
    assert file.read_bytes() == kept
    assert [*tmp_path.iterdir()] == [file]


def test_checkpoints_take_a_small_share_of_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(np.arange(0.0, 1e6, 1.0))  # each look at the clock is a second later
    monkeypatch.setattr("splitband.training.checkpoints.time.monotonic", lambda: float(next(clock)))
    checkpoint = Checkpoint(tmp_path / "training.safetensors")
    written = []

    def state() -> dict[str, torch.Tensor]:
        written.append(1)
        return {"x": torch.zeros(1)}

    for _ in range(1000):
        checkpoint.offer("key", state, last=False)
    assert len(written) == pytest.approx(1000 / 20, rel=0.1)


def test_a_diverging_epoch_is_repeated_with_half_the_learning_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Once: the second pass of the first network blows up and leaves NaN weights behind."""
    rates: list[float] = []
    whole_pass = NetworkTraining._pass

    def sabotaged(self: NetworkTraining) -> float:
        loss = whole_pass(self)
        rates.append(self.optimizer.param_groups[0]["lr"])
        if len(rates) == 2:
            for p in self.task.network.parameters():
                p.data.fill_(float("nan"))
            return float("nan")
        return loss

    monkeypatch.setattr(NetworkTraining, "_pass", sabotaged)
    plain = Settings(40, QUICK.warmup, 4, 16, learning_rate=0.01)
    model, history, _ = trained(settings=plain)
    assert all(torch.isfinite(p).all() for p in model.parameters())
    assert [len(losses) for losses in history.losses.values()] == [4, 4]
    assert rates == pytest.approx([0.01, 0.01, *[0.005] * 3, *[0.01] * 4])
    (note,) = history.notes
    assert note == "low band: the loss diverged in epoch 2, repeated with half the learning rate"


def test_a_training_that_always_diverges_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    passes = []

    def exploding(self: object) -> float:
        passes.append(1)
        return 1e9

    monkeypatch.setattr("splitband.training.network.NetworkTraining._pass", exploding)
    with pytest.raises(FloatingPointError, match=r"diverged in epoch 1: the loss is 1e\+09"):
        trained()
    assert len(passes) == MOST_RESTARTS + 1


LONG = replace(RECIPE, epochs=4, quasi_newton=60)


def trained_until(
    deadline: Deadline, checkpoint: Checkpoint | None = None
) -> tuple[Model, History]:
    model = untrained("split-gru", record()[:TRAIN], SETUP, 0)
    with within(deadline):
        return model, fit(model, record()[:TRAIN], LONG, 0, None, checkpoint)


@pytest.mark.parametrize("looks", [0, 5, 80])
def test_at_its_deadline_a_training_ends_soon_and_its_weights_are_finite(
    looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    began = clock.at
    model, history = trained_until(Deadline(began + looks))
    assert clock.at - began <= looks + 20
    assert history.cut
    assert all(losses for losses in history.losses.values())
    assert all("stopped by the time limit at" in note for note in history.notes if "time" in note)
    assert all(torch.isfinite(weights).all() for weights in model.parameters())


def test_a_training_that_a_deadline_cut_goes_on_as_if_it_had_not_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the deadline has ended early is not taken for the end of the training."""
    whole, expected = trained_until(Deadline())
    assert not expected.cut
    assert not expected.notes
    with monkeypatch.context() as patch:
        clock = slowed(patch, 1.0)
        assert trained_until(Deadline(clock.at + 10), Checkpoint(tmp_path / "run"))[1].cut
    again, history = trained_until(Deadline(), Checkpoint(tmp_path / "run"))
    assert history.losses == expected.losses
    assert_same(again, whole)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="asks Linux what is mapped")
def test_a_checkpoint_that_was_loaded_is_not_kept_open(tmp_path: Path) -> None:
    """On Windows it could not be replaced."""
    file = tmp_path / "training.safetensors"
    checkpoint = Checkpoint(file)
    checkpoint.offer("key", lambda: {"x": torch.ones(100_000), "none": torch.empty(0)}, last=True)
    state = checkpoint.load("key")
    assert state is not None
    assert [len(state[name]) for name in ("x", "none")] == [100_000, 0]
    assert str(file) not in Path("/proc/self/maps").read_text(encoding="utf-8")
