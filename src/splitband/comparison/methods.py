"""Give names to forecasters, for tables, files and the command line.

Names are derived from forecasters and never parsed. To add a method, write its class, add a line to
`_kinds` (cells, hybrids) or `closed_form.BASELINES`, and export it in `splitband/__init__.pyi`.

The forecasters of the table have cells that are not built yet, so that the names are known without
torch; `named` builds them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from splitband import networks
from splitband.forecasters.base import Forecaster, cells_of, parts_of, with_parts_changed
from splitband.forecasters.baselines import BASELINES
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.hybrid import Filtered, Residual, Single, Split
from splitband.forecasters.linear import Linear
from splitband.forecasters.simulation import AFFINE, Calibrated, Simulation
from splitband.networks.cell import Cell, Template
from splitband.runtime.arguments import LARGEST_SIZE, did_you_mean, whole
from splitband.runtime.errors import InputError
from splitband.runtime.threads import seeded


@dataclass(frozen=True)
class Sizes:
    """Hold the sizes of the networks that a name stands for.

    Attributes
    ----------
    hidden_high, hidden_low : Hidden units of the two GRUs, by default the paper's; a single GRU
        has their sum.
    state_size, step_size : Of the `EulerMLP`, the paper's "RNN".
    """

    hidden_high: int = 64
    hidden_low: int = 32
    state_size: int = 4
    step_size: float = 0.1

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("hidden_high", "hidden_low", "state_size"):
            object.__setattr__(self, name, whole(name, getattr(self, name), 1, LARGEST_SIZE))


@dataclass(frozen=True)
class Unbuilt:
    """Stand for a cell of the package by what it is called.

    Attributes
    ----------
    label, words : Those of the cell.
    kind, options : Name of its class in `splitband.networks`, and arguments of the constructor.
    """

    label: str
    words: str
    kind: str
    options: Mapping[str, Any]

    def build(self) -> Template:
        """Return the cell."""
        found: Template = getattr(networks, self.kind)(**self.options)
        return found

    def sized(self, ny: int, nu: int, warmup: int) -> Cell:
        """Return a cell of these sizes."""
        return self.build().sized(ny, nu, warmup)


def _kinds(sizes: Sizes) -> list[Forecaster]:
    """Return one forecaster of each kind, the simple ones last."""
    low, high = sizes.hidden_low, sizes.hidden_high
    alone, of_low, of_high = (
        Unbuilt("gru", "GRU", "GRU", {"hidden_size": hidden}) for hidden in (high + low, low, high)
    )
    euler = {"state_size": sizes.state_size, "step_size": sizes.step_size}
    cells = (
        alone,
        Unbuilt("euler-mlp", "EulerMLP", "EulerMLP", euler),
        Unbuilt("state-space", "state-space network", "StateSpace", {"states": 4, "hidden": 10}),
    )
    return [
        *(Single(cell) for cell in cells),
        Split(of_low, of_high),
        Split(of_low, of_high, filter_output=True),
        *(kind(None, cell) for kind in (Filtered, Residual) for cell in cells),
        *(Filtered(None, cell, simulator_band="high") for cell in cells),
        Simulation(),
        Calibrated(terms=AFFINE),
        Calibrated(),
        GreyBox(),
        *_baselines(),
    ]


def _baselines() -> list[Forecaster]:
    return [*(kind() for kind in BASELINES), Linear()]


BASES = {each.name: each for each in _baselines() if each._slow_part}
"""Baselines that can replace the simulator of a hybrid; they are fitted to the training samples."""
GREY_BOX = GreyBox().name
_REPLACEMENTS: dict[str, Forecaster] = {**BASES, GREY_BOX: GreyBox()}


def _methods(sizes: Sizes) -> Iterator[Forecaster]:
    """Yield each kind alone and on each base, all of them with their variants."""
    for kind in _kinds(sizes):
        for based in (
            kind,
            *(_on_base(kind, base) for base in _REPLACEMENTS.values() if parts_of(kind)),
        ):
            yield from variants(based, calibrate=True, conditioned=True)


def variants(forecaster: Forecaster, calibrate: bool, conditioned: bool) -> list[Forecaster]:
    """Return a forecaster and, if requested, its calibrated and conditioned variants."""
    found = [forecaster]
    if calibrate:
        found.append(with_parts_changed(forecaster, _calibrated))
    if conditioned and "conditioned" in forecaster.get_params():
        found += [each.clone().set_params(conditioned=True) for each in found]
    return [*{each.name: each for each in found}.values()]


def _calibrated(part: Forecaster) -> Forecaster:
    return Calibrated(part.simulator) if isinstance(part, Simulation) else part


def _on_base(forecaster: Forecaster, base: Forecaster) -> Forecaster:
    """Return a forecaster with its simulator replaced by a base."""
    return with_parts_changed(
        forecaster, lambda part: base.clone() if "simulator" in part.needs else part
    )


NAMES = {each.name: each for each in _methods(Sizes())}
"""All methods by name, with the default sizes and cells that are `Unbuilt`."""
TRAINED = tuple(name for name, method in NAMES.items() if method.random)
QUICK = tuple(name for name, method in NAMES.items() if not method.random)
"""Methods that need no seed."""
HYBRIDS = tuple(name for name in TRAINED if "simulator" in NAMES[name].needs)
BASED = tuple(name for name in TRAINED if parts_of(NAMES[name]) and name not in HYBRIDS)
"""Hybrids whose slow component is fitted to the record: they need no simulator's output."""


def named(name: str, sizes: Sizes | None = None) -> Forecaster:
    """Return a new forecaster by its name; raises ValueError for an unknown one."""
    return built(known(name, sizes))


def built(forecaster: Forecaster) -> Forecaster:
    """Return a forecaster with its cells built, where they are not; that loads torch."""
    cells: dict[str, Any] = {**cells_of(forecaster)}
    if not any(hasattr(cell, "build") for cell in cells.values()):
        return forecaster
    # Templates draw weights that are never used; this must not change the user's random numbers.
    with seeded(0):
        made = {option: cell.build() for option, cell in cells.items()}
    return forecaster.clone().set_params(**made)


def known(name: str, sizes: Sizes | None = None) -> Forecaster:
    """Return a new forecaster by its name, as `named`, whose cells are not built."""
    if name not in NAMES:
        raise InputError(
            "methods must be forecasters or names that `splitband methods` lists, "
            f"got {name!r}{did_you_mean([name], NAMES)}"
        )
    if sizes is None:
        return NAMES[name].clone()
    return next(method for method in _methods(sizes) if method.name == name)


def with_base(names: Sequence[str], base: str) -> list[str]:
    """Return the names of these methods with their simulator replaced by a base.

    The base is one of `BASES`, or the simulator with fitted parameters (`GREY_BOX`).
    """
    put = _REPLACEMENTS[base]
    return [*dict.fromkeys(_on_base(known(name), put).name for name in names)]


def with_variants(names: Sequence[str], calibrate: bool, conditioned: bool) -> list[str]:
    """Return the names, each followed by its calibrated and conditioned variants.

    Raises ValueError where no method has a requested variant.
    """
    found = {v.name: v for name in names for v in variants(known(name), calibrate, conditioned)}
    for argument, wanted, has in (
        ("calibrate", calibrate, lambda variant: variant._calibrates),
        ("conditioned", conditioned, lambda variant: getattr(variant, "conditioned", False)),
    ):
        if wanted and not any(map(has, found.values())):
            able = (n for n in NAMES if len(variants(NAMES[n], **_only(argument))) > 1)
            raise InputError(
                f"{argument} needs a method that has it, such as {', '.join(islice(able, 3))} "
                f"(splitband methods lists them), got {', '.join(names)}"
            )
    return [*found]


def _only(argument: str) -> dict[str, bool]:
    return {name: name == argument for name in ("calibrate", "conditioned")}
