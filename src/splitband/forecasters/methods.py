"""The methods that can be compared, by name, and the settings they share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import torch

from splitband.baselines.harmonic import HarmonicRegression
from splitband.baselines.linear import OutputError
from splitband.baselines.naive import Given, Mean, Naive, Persistence
from splitband.baselines.periodic import PeriodicRegression
from splitband.baselines.seasonal import SeasonalNaive
from splitband.data import Trajectory
from splitband.data.gaps import first_after
from splitband.filters import ComplementaryPair, butterworth
from splitband.filters.cutoff import Choice
from splitband.forecasters.remembering import Remembered
from splitband.models import Filtered, Model, Recurrent, Residual, Split
from splitband.networks import GRU, Cell, EulerMLP
from splitband.simulators.calibration import Calibration, affine_fit, calibrate
from splitband.training import Settings
from splitband.training.windows import places_in

Array = npt.NDArray[np.float64]
CALIBRATED, CONDITIONED = "-calibrated", "-conditioned"
"""Suffixes: the simulator is calibrated first; faster networks are told what is slower."""

LARGEST_SIZE = 10_000
CALIBRATIONS = Remembered(calibrate)
"""Several methods, seeds and trials ask for the same calibration, which takes seconds."""

Maker: TypeAlias = "Callable[[Trajectory, Setup, bool], Cell]"


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
    hidden_high, hidden_low : Sizes of the two GRUs, here the paper's; a single one has their sum.
    state_size, step_size : Of the "RNN", an `EulerMLP`.
    overrides : Other settings for some methods.
    choice : Why cut-off, order and down-sampling are what they are, where they were chosen.
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
    choice: Choice | None = None

    def __post_init__(self) -> None:
        """Check sizes."""
        for name in ("order", "downsampling", "hidden_high", "hidden_low", "state_size"):
            if not 1 <= getattr(self, name) <= LARGEST_SIZE:
                raise ValueError(
                    f"{name} must be between 1 and {LARGEST_SIZE}, got {getattr(self, name)}"
                )

    def settings_of(self, method: str) -> Settings:
        """How a method is trained."""
        return self.overrides.get(base(method), self.settings)

    def only_for(self, method: str) -> Setup:
        """The setup of one method, whose settings are those of all there is."""
        return replace(self, settings=self.settings_of(method), overrides={})


def base(method: str) -> str:
    """The method without its suffixes."""
    return method.removesuffix(CONDITIONED).removesuffix(CALIBRATED)


def _told(record: Trajectory, conditioned: bool) -> int:
    """Inputs of a network: the record's, and value and slope of what is slower."""
    return record.nu + (2 * record.ny if conditioned else 0)


def _gru(record: Trajectory, setup: Setup, conditioned: bool = False) -> Cell:
    size = setup.hidden_high + setup.hidden_low
    return GRU(record.ny, size, _told(record, conditioned))


def _rnn(record: Trajectory, setup: Setup, conditioned: bool = False) -> Cell:
    return EulerMLP(
        record.ny,
        setup.settings.warmup,
        setup.state_size,
        step_size=setup.step_size,
        nu=_told(record, conditioned),
    )


def _split(
    record: Trajectory, setup: Setup, conditioned: bool, filter_output: bool = False
) -> Model:
    pair = ComplementaryPair.butterworth(setup.cutoff, record.sampling_rate, setup.order)
    low = GRU(record.ny, setup.hidden_low, record.nu)
    high = GRU(record.ny, setup.hidden_high, _told(record, conditioned))
    return Split([low, high], pair, setup.downsampling, filter_output, conditioned)


def _filtered(make: Maker, record: Trajectory, setup: Setup, conditioned: bool) -> Model:
    rate = record.sampling_rate
    b, a = butterworth(setup.cutoff, rate, setup.order)
    pair = ComplementaryPair.perfect(b, a, rate, cutoff=setup.cutoff)
    return Filtered(make(record, setup, conditioned), pair, conditioned)


def _residual(make: Maker, record: Trajectory, setup: Setup, conditioned: bool) -> Model:
    return Residual(make(record, setup, conditioned), conditioned)


def _affine(record: Trajectory, train: int) -> Naive:
    y_sim = simulated(record)
    gain, offset = affine_fit(y_sim[:train], record.seen[:train])
    description = f"gain {_few(gain)}, offset {_few(offset)} from the training samples"
    return Given(gain * y_sim + offset, description)


def _of_samples(fit: Callable[[Array], Naive]) -> Callable[[Trajectory, int], Naive]:
    """A baseline that is fitted to the measured training samples alone."""
    return lambda record, train: fit(record.seen[:train])


def _calibrated(record: Trajectory, train: int) -> Naive:
    seen, found = prepared("simulator" + CALIBRATED, record, train)
    untried = found.untried if found is not None else ""
    return Given(simulated(seen), "; ".join(filter(None, [str(found), untried])))


WHOLE: dict[str, Callable[[Trajectory, Setup, bool], Model]] = {
    "gru": lambda record, setup, _: Recurrent(_gru(record, setup)),
    "rnn": lambda record, setup, _: Recurrent(_rnn(record, setup)),
}
SPLIT: dict[str, Callable[[Trajectory, Setup, bool], Model]] = {
    "split-gru": _split,
    "split-gru-hp": partial(_split, filter_output=True),
}
HYBRID: dict[str, Callable[[Trajectory, Setup, bool], Model]] = {
    "filtered-gru": partial(_filtered, _gru),
    "filtered-rnn": partial(_filtered, _rnn),
    "residual-gru": partial(_residual, _gru),
    "residual-rnn": partial(_residual, _rnn),
}
FIXED: dict[str, Callable[[Trajectory, int], Naive]] = {
    "simulator": lambda record, train: Given(simulated(record), "as it comes"),
    "simulator-affine": _affine,
    "simulator" + CALIBRATED: _calibrated,
    "mean": lambda record, train: Mean(np.nanmean(record.seen[:train], axis=0)),
    "persistence": lambda record, train: Persistence(),
    "seasonal-naive": _of_samples(SeasonalNaive.fit),
    "harmonic": _of_samples(HarmonicRegression.fit),
    "periodic": _of_samples(PeriodicRegression.fit),
    "linear": lambda record, train: OutputError.fit(record.seen[:train], _inputs(record)),
}
TRAINED = (
    *WHOLE,
    *(name + suffix for name in SPLIT for suffix in ("", CONDITIONED)),
    *(
        name + suffix
        for name in HYBRID
        for suffix in ("", CALIBRATED, CONDITIONED, CALIBRATED + CONDITIONED)
    ),
)
METHODS = (*TRAINED, *FIXED)
HYBRIDS = tuple(method for method in TRAINED if method.startswith((*HYBRID,)))


def with_variants(methods: Sequence[str], calibrate: bool, conditioned: bool) -> list[str]:
    """The methods and, after each, its calibrated and its conditioned variants, if asked for."""
    found: dict[str, None] = {}
    for method in methods:
        found[method] = None
        for told in (False, True)[: 1 + conditioned]:
            for calibrated in (False, True)[: 1 + calibrate]:
                name = base(method)
                name += CALIBRATED if calibrated or CALIBRATED in method else ""
                name += CONDITIONED if told or CONDITIONED in method else ""
                found |= {name: None} if name in METHODS else {}
    for option, wanted, suffix in (
        ("--calibrate", calibrate, CALIBRATED),
        ("--conditioned", conditioned, CONDITIONED),
    ):
        if wanted and not any(suffix in method for method in found):
            able = dict.fromkeys(base(name) for name in METHODS if suffix in name)
            raise ValueError(f"{option} needs one of {', '.join(able)}, got {', '.join(methods)}")
    return [*found]


def build(method: str, record: Trajectory, setup: Setup, seed: int) -> Model:
    """The untrained model of a method, its parameters drawn from `seed`."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        make = (WHOLE | SPLIT | HYBRID)[base(method)]
        return make(record, setup.only_for(method), method.endswith(CONDITIONED))


def prepared(method: str, record: Trajectory, train: int) -> tuple[Trajectory, Calibration | None]:
    """The record as a method sees it: with a calibrated simulator, where its name says so."""
    if CALIBRATED not in method:
        return record, None
    y_sim, y = _simulated_beyond(record), record.seen[:train]
    found = CALIBRATIONS(y_sim, y, record.sampling_time, len(record))
    return as_seen(record, found), found


def calibrations_for(
    record: Trajectory, methods: Sequence[str], train: int, cuts: Sequence[int] = ()
) -> dict[str, Calibration]:
    """What `CALIBRATIONS` must know to run these methods, fitted here once for all processes."""
    asking = [method for method in methods if CALIBRATED in method]
    fitted_again = any(method in FIXED for method in asking)
    for end in (train, *(cuts if fitted_again else ())):
        if asking:
            # What cannot be fitted fails once more, and is reported, in the methods that ask.
            with suppress(ValueError):
                prepared(asking[0], record, end)
    return dict(CALIBRATIONS.results)


def as_seen(record: Trajectory, calibration: Calibration | None) -> Trajectory:
    """The record with its simulator calibrated."""
    if calibration is None:
        return record
    y_sim = calibration.apply(_simulated_beyond(record), len(record), record.sampling_time)
    return replace(record, y_sim=y_sim, beyond=None)


def check_train(record: Trajectory, train: int, ahead: int = 1) -> None:
    """Check that there is something to train on and `ahead` samples to predict."""
    if not 2 <= train <= len(record) - ahead:
        raise ValueError(
            f"train must be between 2 and {len(record) - ahead} for a record of {len(record)} "
            f"samples, got {train}"
        )


def check(
    record: Trajectory,
    methods: Sequence[str],
    setup: Setup,
    more: Sequence[Trajectory] = (),
) -> None:
    """Find what is wrong with a comparison before anything is computed."""
    unknown = [m for m in methods if m not in METHODS]
    if unknown or not methods:
        raise ValueError(f"methods must be out of {', '.join(METHODS)}, got {', '.join(unknown)}")
    check_train(record, setup.train)
    if setup.settings.warmup >= setup.train:
        raise ValueError(
            f"warmup must be shorter than the {setup.train} training samples, "
            f"got {setup.settings.warmup}"
        )
    for name, part in (("training", slice(setup.train)), ("predicted", slice(setup.train, None))):
        if np.isnan(record.truth[part]).all(axis=0).any():
            raise ValueError(f"the {name} part must have a measured sample in every channel")
    if more and not set(methods) & set(TRAINED):
        raise ValueError(f"further records (--more) are for networks, got {', '.join(methods)}")
    for method in methods:
        check_method(method, record, setup, more)


def check_method(
    method: str, record: Trajectory, setup: Setup, more: Sequence[Trajectory] = ()
) -> None:
    """Find what is wrong with one method's setup."""
    butterworth(setup.cutoff, record.sampling_rate, setup.order)
    check_simulator(method, record)
    if method == "linear":
        _inputs(record)
    settings = setup.settings_of(method)
    complete = record.complete[: setup.train]
    if not complete.all() and first_after(complete, settings.warmup) is None:
        raise ValueError(
            f"warmup must fit between the gaps of the {setup.train} training samples, "
            f"got {settings.warmup}"
        )
    if method not in TRAINED:
        return
    if settings.window > setup.train:
        raise ValueError(
            f"window must fit into the {setup.train} training samples, got {settings.window}"
        )
    for other in more:
        check_simulator(method, other)
        if (other.ny, other.nu) != (record.ny, record.nu):
            raise ValueError(
                f"{other.name} must have the record's {record.ny} channel(s) and {record.nu} "
                f"input(s), got {other.ny} and {other.nu}"
            )
        if abs(other.sampling_time - record.sampling_time) > 0.01 * record.sampling_time:
            raise ValueError(
                f"{other.name} must be sampled like the record, every {record.sampling_time:g} s, "
                f"got every {other.sampling_time:g} s"
            )
    places_in([record[: setup.train], *more], settings.window, settings.warmup)
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
        simulated(record, method)


def simulated(record: Trajectory, method: str = "this method") -> Array:
    """The simulator's output over the record, `(time, ny)`; raises ValueError without one."""
    if record.y_sim is None:
        raise ValueError(f"{method} needs a simulator (--simulator), the record has none")
    return record.y_sim


def _inputs(record: Trajectory) -> Array:
    """The known inputs, `(time, nu)`; raises ValueError without any."""
    if record.u is None:
        raise ValueError("linear needs known inputs (--inputs), the record has none")
    return record.u


def _simulated_beyond(record: Trajectory) -> Array:
    """The simulator's output over the record and, where it is known, after it."""
    y_sim = simulated(record)
    return y_sim if record.beyond is None else np.concatenate([y_sim, record.beyond])


def _few(values: Array) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
