"""Give names to forecasters, for tables, files and the command line.

Names are derived from forecasters and never parsed. To add a method, write its class, add a line to
`_kinds` (cells, hybrids) or `BASELINES` of `forecasters.baselines`, and export it in
`splitband/__init__.pyi`.

The forecasters of the table have cells that are not built yet, so that the names are known without
torch; `built` builds them.
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


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """The sizes of the networks that a name stands for.

    Attributes
    ----------
    hidden_low, hidden_high : Hidden units of the two GRUs; a single GRU has their sum.
    state_size, step_size : Of the `EulerMLP`, the paper's "RNN".
    """

    hidden_low: int = 16
    hidden_high: int = 32
    state_size: int = 4
    step_size: float = 0.1

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("hidden_low", "hidden_high", "state_size"):
            object.__setattr__(self, name, whole(name, getattr(self, name), 1, LARGEST_SIZE))


@dataclass(frozen=True)
class Unbuilt:
    """A cell of the package, named and not built.

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


BASES = {each.name: each for each in _baselines() if each.slow_part}
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


def named(name: str, sizes: Sizes | None = None) -> Forecaster:
    """Return a new forecaster by its name, its cells built; see `forecasters`."""
    (method,) = forecasters([name], sizes)
    return built(method)


def is_built(forecaster: Forecaster) -> bool:
    """Return whether it has no cells that are only named."""
    return not any(isinstance(cell, Unbuilt) for cell in cells_of(forecaster).values())


def built(forecaster: Forecaster) -> Forecaster:
    """Return a forecaster with its cells built, where they are not; that loads torch."""
    if is_built(forecaster):
        return forecaster
    # Templates draw weights that are never used; this must not change the user's random numbers.
    with seeded(0):
        cells = cells_of(forecaster).items()
        made = {name: c.build() if isinstance(c, Unbuilt) else c for name, c in cells}
    return forecaster.clone().set_params(**made)


def forecasters(
    methods: Sequence[Forecaster | str] | str,
    sizes: Sizes | None = None,
    base: str | None = None,
    calibrate: bool = False,
    conditioned: bool = False,
) -> list[Forecaster]:
    """Return methods as forecasters: those given by name are made, and their cells are not built.

    Parameters
    ----------
    methods : Forecasters, which stay as they are, or names.
    sizes : Of the networks of those given by name.
    base : Replaces the simulator of those given by name: one of `BASES`, or the simulator with
        fitted parameters (`GREY_BOX`).
    calibrate, conditioned : Whether those given by name are followed by these variants.

    Raises
    ------
    ValueError
        For an unknown name, and where no method has a requested variant.
    """
    table = NAMES if sizes is None else {method.name: method for method in _methods(sizes)}
    asked = [methods] if isinstance(methods, str) else [*methods]
    names = [each for each in asked if isinstance(each, str)]
    strange = [each for each in asked if not isinstance(each, str | Forecaster)]
    if unknown := strange + [name for name in names if name not in table]:
        raise InputError(
            "methods must be forecasters or names that `splitband methods` lists, "
            f"got {unknown[0]!r}{did_you_mean(map(str, unknown[:1]), table)}"
        )
    several = {name: variants(table[name].clone(), calibrate, conditioned) for name in names}
    made = [variant for each in several.values() for variant in each]
    has = {
        "calibrate": any(variant.calibrates for variant in made),
        "conditioned": any(variant.get_params().get("conditioned") for variant in made),
    }
    for argument, wanted in (("calibrate", calibrate), ("conditioned", conditioned)):
        if wanted and not has[argument]:
            able = (n for n in NAMES if len(variants(NAMES[n], **_only(argument))) > 1)
            raise InputError(
                f"{argument} needs a method that has it, such as {', '.join(islice(able, 3))} "
                f"(splitband methods lists them), got {', '.join(names)}"
            )
    changed = bool(base or calibrate or conditioned)
    found, seen = list[Forecaster](), set[str]()
    for each in asked:
        if not isinstance(each, str):
            found.append(each)
            continue
        for variant in several[each]:
            method = variant if base is None else _on_base(variant, _REPLACEMENTS[base])
            # Variants of one method may be another one, and a base may make methods the same.
            if not (changed and method.name in seen):
                found.append(method)
            seen.add(method.name)
    return found


def _only(argument: str) -> dict[str, bool]:
    return {name: name == argument for name in ("calibrate", "conditioned")}
