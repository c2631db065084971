"""Names for forecasters: for tables, files and the command line. Nothing else parses them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch

from splitband.forecasters.base import Forecaster
from splitband.forecasters.closed_form import (
    Harmonic,
    Linear,
    Mean,
    Periodic,
    Persistence,
    SeasonalNaive,
)
from splitband.forecasters.hybrids import Filtered, Residual
from splitband.forecasters.network import Template
from splitband.forecasters.simulation import AFFINE, Simulation
from splitband.forecasters.single import Single
from splitband.forecasters.split import Split
from splitband.networks import GRU, EulerMLP
from splitband.runtime.arguments import LARGEST_SIZE, whole

CALIBRATED, CONDITIONED = "-calibrated", "-conditioned"
"""Suffixes: the simulator is calibrated first; faster networks are told what is slower."""


@dataclass(frozen=True)
class Sizes:
    """Of the networks that go by a name.

    Attributes
    ----------
    hidden_high, hidden_low : Hidden units of the two GRUs, here the paper's; a single GRU has
        their sum.
    state_size, step_size : Of the "RNN", an `EulerMLP`.
    """

    hidden_high: int = 64
    hidden_low: int = 32
    state_size: int = 4
    step_size: float = 0.1

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("hidden_high", "hidden_low", "state_size"):
            object.__setattr__(self, name, whole(name, getattr(self, name), 1, LARGEST_SIZE))


def _gru(sizes: Sizes) -> Template:
    return GRU(sizes.hidden_high + sizes.hidden_low)


def _rnn(sizes: Sizes) -> Template:
    return EulerMLP(1, state_size=sizes.state_size, step_size=sizes.step_size)


def _split(sizes: Sizes, filter_output: bool, conditioned: bool) -> Forecaster:
    low, high = GRU(sizes.hidden_low), GRU(sizes.hidden_high)
    return Split(low, high, filter_output=filter_output, conditioned=conditioned)


def _hybrid(
    kind: Callable[..., Forecaster],
    cell: Callable[[Sizes], Template],
    sizes: Sizes,
    calibrated: bool,
    conditioned: bool,
) -> Forecaster:
    return kind(None, cell(sizes), calibrated=calibrated, conditioned=conditioned)


_SPLITS = {"split-gru": False, "split-gru-hp": True}
_HYBRIDS: dict[str, tuple[Callable[..., Forecaster], Callable[[Sizes], Template]]] = {
    "filtered-gru": (Filtered, _gru),
    "filtered-rnn": (Filtered, _rnn),
    "residual-gru": (Residual, _gru),
    "residual-rnn": (Residual, _rnn),
}
BASES: dict[str, Callable[[], Forecaster]] = {
    "linear": Linear,
    "periodic": Periodic,
    "harmonic": Harmonic,
}
"""What may hold the slow part in a simulator's place: it is fitted to the training samples."""


def _based(
    kind: Callable[..., Forecaster], base: Callable[[], Forecaster], sizes: Sizes, conditioned: bool
) -> Forecaster:
    return kind(base(), _gru(sizes), conditioned=conditioned)


# A line for each name: to add a cell, a baseline or a kind of model is to add its class and a line.
NAMES: dict[str, Callable[[Sizes], Forecaster]] = {
    "gru": lambda sizes: Single(_gru(sizes)),
    "rnn": lambda sizes: Single(_rnn(sizes)),
    **{
        name + CONDITIONED * told: partial(_split, filter_output=hp, conditioned=told)
        for name, hp in _SPLITS.items()
        for told in (False, True)
    },
    **{
        name + CALIBRATED * calibrated + CONDITIONED * told: partial(
            _hybrid, kind, cell, calibrated=calibrated, conditioned=told
        )
        for name, (kind, cell) in _HYBRIDS.items()
        for told in (False, True)
        for calibrated in (False, True)
    },
    **{
        f"{kind}-{base}-gru" + CONDITIONED * told: partial(
            _based, _HYBRIDS[f"{kind}-gru"][0], make, conditioned=told
        )
        for kind in ("filtered", "residual")
        for base, make in BASES.items()
        for told in (False, True)
    },
    "simulator": lambda _: Simulation(),
    "simulator-affine": lambda _: Simulation(calibrated=AFFINE),
    "simulator" + CALIBRATED: lambda _: Simulation(calibrated=True),
    "mean": lambda _: Mean(),
    "persistence": lambda _: Persistence(),
    "seasonal-naive": lambda _: SeasonalNaive(),
    "harmonic": lambda _: Harmonic(),
    "periodic": lambda _: Periodic(),
    "linear": lambda _: Linear(),
}
HYBRIDS = tuple(name for name in NAMES if name.startswith((*_HYBRIDS,)))
BASED = tuple(name for name in NAMES if any(f"-{base}-" in name for base in BASES))
"""Hybrid models whose slow part is fitted to the record: they need no simulator."""
TRAINED = (
    "gru",
    "rnn",
    *(name for name in NAMES if name.startswith((*_SPLITS,))),
    *HYBRIDS,
    *BASED,
)
QUICK = tuple(name for name in NAMES if name not in TRAINED)
"""What is fitted in closed form, and needs no seed."""


def named(name: str, sizes: Sizes | None = None) -> Forecaster:
    """The forecaster of a name; raises ValueError for an unknown one."""
    if name not in NAMES:
        raise ValueError(f"methods must be out of {', '.join(NAMES)}, got {name}")
    # A template draws weights that are never used; that must not change the user's random numbers.
    with torch.random.fork_rng(devices=[]):
        return NAMES[name](sizes or Sizes())


def with_base(names: Sequence[str], base: str) -> list[str]:
    """The names with one of `BASES` in a simulator's place, as a part of hybrids and by itself."""
    return [*dict.fromkeys(_on_base(name, base) for name in names)]


def _on_base(name: str, base: str) -> str:
    if name.startswith("simulator"):
        return base
    if name not in HYBRIDS:
        return name
    kind, _, rest = name.replace(CALIBRATED, "").partition("-")
    method = f"{kind}-{base}-{rest}"
    if method not in NAMES:
        raise ValueError(f"methods on {base} must be out of {', '.join(BASED)}, got {method}")
    return method


def base(name: str) -> str:
    """The name without its suffixes."""
    return name.removesuffix(CONDITIONED).removesuffix(CALIBRATED)


def with_variants(names: Sequence[str], calibrate: bool, conditioned: bool) -> list[str]:
    """The names and, after each, its calibrated and its conditioned variants, if asked for.

    Raises ValueError where there are none.
    """
    variants: dict[str, None] = {}
    for name in names:
        variants[name] = None
        for told in (False, True)[: 1 + conditioned]:
            for calibrated in (False, True)[: 1 + calibrate]:
                variant = base(name)
                variant += CALIBRATED if calibrated or CALIBRATED in name else ""
                variant += CONDITIONED if told or CONDITIONED in name else ""
                variants |= {variant: None} if variant in NAMES else {}
    for argument, wanted, suffix in (
        ("calibrate", calibrate, CALIBRATED),
        ("conditioned", conditioned, CONDITIONED),
    ):
        if wanted and not any(suffix in name for name in variants):
            able = dict.fromkeys(base(name) for name in NAMES if suffix in name)
            raise ValueError(f"{argument} needs one of {', '.join(able)}, got {', '.join(names)}")
    return [*variants]
