"""The methods that can be compared, by name, and the settings they share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch

from splitband.cells import GRU, Cell, EulerMLP
from splitband.data import Trajectory
from splitband.filters import ComplementaryPair, butterworth
from splitband.models import Filtered, Model, Recurrent, Residual, Split
from splitband.naive import Given, HarmonicRegression, Naive, Persistence, SeasonalNaive
from splitband.simulators import affine_fit
from splitband.spectrum import default_cutoff
from splitband.training import Settings

Array = npt.NDArray[np.float64]
CALIBRATED = "-calibrated"
"""Suffix of a hybrid method whose simulator is calibrated first."""


@dataclass(frozen=True)
class Setup:
    """What a comparison is made under.

    Attributes
    ----------
    train : Samples at the beginning of the record that are trained on.
    settings : How the networks are trained.
    cutoff : Of the filter pair, in Hz.
    order : Of each Butterworth filter.
    downsampling : k of the low band.
    hidden_high, hidden_low : Sizes of the two GRUs; a single one has their sum.
    state_size, step_size : Of the "RNN", an `EulerMLP`.
    overrides : Other settings for some methods.
    """

    train: int
    settings: Settings
    cutoff: float
    order: int = 1
    downsampling: int = 2
    hidden_high: int = 64
    hidden_low: int = 32
    state_size: int = 4
    step_size: float = 0.1
    overrides: Mapping[str, Settings] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check sizes."""
        for name in ("order", "downsampling", "hidden_high", "hidden_low", "state_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")

    def settings_of(self, method: str) -> Settings:
        """How a method is trained."""
        return self.overrides.get(method.removesuffix(CALIBRATED), self.settings)


def _gru(record: Trajectory, setup: Setup) -> Cell:
    return GRU(record.ny, setup.hidden_high + setup.hidden_low, record.nu)


def _rnn(record: Trajectory, setup: Setup) -> Cell:
    return EulerMLP(
        record.ny,
        setup.settings.warmup,
        setup.state_size,
        step_size=setup.step_size,
        nu=record.nu,
    )


def _split(record: Trajectory, setup: Setup, filter_output: bool = False) -> Model:
    pair = ComplementaryPair.butterworth(setup.cutoff, record.sampling_rate, setup.order)
    low, high = (GRU(record.ny, n, record.nu) for n in (setup.hidden_low, setup.hidden_high))
    return Split(low, high, pair, setup.downsampling, filter_output)


def _filtered(cell: Cell, record: Trajectory, setup: Setup, calibrate: bool) -> Model:
    rate = record.sampling_rate
    b, a = butterworth(setup.cutoff, rate, setup.order)
    return Filtered(cell, ComplementaryPair.perfect(b, a, rate, cutoff=setup.cutoff), calibrate)


def _affine(record: Trajectory, train: int) -> Naive:
    y_sim = _simulated(record)
    gain, offset = affine_fit(y_sim[:train], record.y[:train])
    description = f"gain {_few(gain)}, offset {_few(offset)} from the training samples"
    return Given(gain * y_sim + offset, description)


LEARNED: dict[str, Callable[[Trajectory, Setup], Model]] = {
    "gru": lambda record, setup: Recurrent(_gru(record, setup)),
    "rnn": lambda record, setup: Recurrent(_rnn(record, setup)),
    "split-gru": _split,
    "split-gru-hp": lambda record, setup: _split(record, setup, filter_output=True),
}
HYBRID: dict[str, Callable[[Trajectory, Setup, bool], Model]] = {
    "filtered-gru": lambda record, setup, cal: _filtered(_gru(record, setup), record, setup, cal),
    "filtered-rnn": lambda record, setup, cal: _filtered(_rnn(record, setup), record, setup, cal),
    "residual-gru": lambda record, setup, cal: Residual(_gru(record, setup), cal),
    "residual-rnn": lambda record, setup, cal: Residual(_rnn(record, setup), cal),
}
FIXED: dict[str, Callable[[Trajectory, int], Naive]] = {
    "simulator": lambda record, train: Given(_simulated(record), "as it comes"),
    "simulator-affine": _affine,
    "persistence": lambda record, train: Persistence(),
    "seasonal-naive": lambda record, train: SeasonalNaive.fit(record.y[:train]),
    "harmonic": lambda record, train: HarmonicRegression.fit(record.y[:train]),
}
TRAINED = (*LEARNED, *HYBRID, *(name + CALIBRATED for name in HYBRID))
METHODS = (*TRAINED, *FIXED)


def default_methods(with_simulator: bool) -> list[str]:
    """What is worth comparing in a reasonable time."""
    networks = ["filtered-gru", "residual-gru"] if with_simulator else ["split-gru", "split-gru-hp"]
    simulator = ["simulator", "simulator-affine"] if with_simulator else []
    return ["gru", *networks, *simulator, "persistence", "seasonal-naive", "harmonic"]


def default_setup(
    record: Trajectory, train: int, downsampling: int = 2, cutoff: float | None = None
) -> Setup:
    """A setup for a record of which nothing is known but its first `train` samples.

    Windows of up to 250 samples with up to 50 for the warm-up, and a cut-off with nine tenths of
    the power below.
    """
    y, rate = record.y[:train], record.sampling_rate
    window = min(250, max(2, train // 2))
    cutoff = default_cutoff(y, rate, downsampling) if cutoff is None else cutoff
    return Setup(train, Settings(window, default_warmup(window)), cutoff, downsampling=downsampling)


def default_warmup(window: int, most: int = 50) -> int:
    """At most a third of the window, and no more than `most`."""
    return min(most, max(1, window // 3))


def build(method: str, record: Trajectory, setup: Setup, seed: int) -> Model:
    """The untrained model of a method, its parameters drawn from `seed`."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        if method in LEARNED:
            return LEARNED[method](record, setup)
        base = method.removesuffix(CALIBRATED)
        return HYBRID[base](record, setup, base != method)


def check_train(record: Trajectory, train: int, ahead: int = 1) -> None:
    """Check that there is something to train on and `ahead` samples to predict."""
    if not 2 <= train <= len(record) - ahead:
        raise ValueError(
            f"train must be between 2 and {len(record) - ahead} for a record of {len(record)} "
            f"samples, got {train}"
        )


def check(record: Trajectory, methods: Sequence[str], setup: Setup) -> None:
    """Find what is wrong with a comparison before anything is computed."""
    unknown = [m for m in methods if m not in METHODS]
    if unknown or not methods:
        raise ValueError(f"methods must be out of {', '.join(METHODS)}, got {', '.join(unknown)}")
    check_train(record, setup.train)
    for method in methods:
        check_method(method, record, setup)


def check_method(method: str, record: Trajectory, setup: Setup) -> None:
    """Find what is wrong with one method's setup."""
    butterworth(setup.cutoff, record.sampling_rate, setup.order)
    check_simulator(method, record)
    if method not in TRAINED:
        return
    settings = setup.settings_of(method)
    if settings.window > setup.train:
        raise ValueError(
            f"window must fit into the {setup.train} training samples, got {settings.window}"
        )
    build(method, record, setup, seed=0)
    shortest = 3 * (setup.order + 1) if method.startswith("split") else setup.order - 1
    if settings.warmup <= shortest:
        raise ValueError(
            f"warmup must have more than {shortest} samples for filters of order {setup.order}, "
            f"got {settings.warmup}"
        )


def check_simulator(method: str, record: Trajectory) -> None:
    """Check that a method that needs a simulator has one."""
    if method.split("-", maxsplit=1)[0] in ("simulator", "filtered", "residual"):
        _simulated(record, method)


def _simulated(record: Trajectory, method: str = "this method") -> Array:
    if record.y_sim is None:
        raise ValueError(f"{method} needs a simulator (--simulator), the record has none")
    return record.y_sim


def _few(values: Array) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
