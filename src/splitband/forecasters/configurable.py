"""Define what is known of a forecaster before it is fitted: options, parts, needs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeGuard

import torch

from splitband.data import Record, check_alike, require_records
from splitband.forecasters.bands import Bands
from splitband.runtime.options import Written, options
from splitband.training import Settings

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster
    from splitband.forecasters.network import Network


@dataclass(frozen=True)
class AsBase:
    """Tell what a hybrid says of the forecaster that holds its slow part.

    Attributes
    ----------
    label : Of the slow part, among the components of a prediction.
    before, after : What the hybrid's name has before and after the cell's.
    words : In a sentence, such as "a linear model".
    described : Whether the hybrid's description has that of its base.
    """

    label: str
    before: str = ""
    after: str = ""
    words: str = ""
    described: bool = True


class Configurable(Written, ABC):
    """Say what a comparison has to know of a forecaster, and make others of it.

    What holds for one of its parts, an option that is a forecaster itself, holds for it.

    Attributes
    ----------
    cells : Options that hold the templates of its networks' cells; empty without networks.
    settings : How its networks are trained; None where that is open, or there is nothing to train.
    words : What it is, where that is the same for all of its class; see `in_words`.
    slow_part : What it is as a hybrid's slow part, likewise; see `as_base`.
    by_seed : What is fitted in its place with some seeds, as networks of other sizes and settings;
        not saved.
    """

    cells: ClassVar[tuple[str, ...]] = ()
    settings: Settings | None = None
    words: ClassVar[str] = ""
    slow_part: ClassVar[str] = ""
    by_seed: Mapping[int, Forecaster] = MappingProxyType({})

    @property
    @abstractmethod
    def name(self) -> str:
        """Return what tables and files call it; two of one comparison must differ."""

    @property
    def needs(self) -> frozenset[str]:
        """Return what a record must bring: "inputs", "simulator"."""
        return frozenset().union(*(part.needs for part in parts_of(self).values()))

    @property
    def random(self) -> bool:
        """Return whether the result depends on a seed: it is trained then, which takes longer."""
        return any(part.random for part in parts_of(self).values())

    @property
    def anchored(self) -> bool:
        """Return whether a forecast depends on the time since the training record began.

        Such a forecaster cannot be asked about a record that has nothing to do with that time.
        """
        return any(part.anchored for part in parts_of(self).values())

    @property
    def calibrates(self) -> bool:
        """Return whether a simulator is calibrated first, which may need output beyond the end."""
        return any(part.calibrates for part in parts_of(self).values())

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return those of the members of a mean of several, else just the first one."""
        return (0,)

    @property
    def network(self) -> Network | None:
        """Return it where it is trained by gradients: with settings, sizes and weights."""
        return None

    @property
    def shares_bands(self) -> bool:
        """Return whether it takes the bands that a comparison chooses, see `with_defaults`."""
        return any(part.shares_bands for part in parts_of(self).values())

    @property
    def refits(self) -> bool:
        """Return whether it is fitted again quickly, for each origin of a trial."""
        return not self.random

    @property
    def as_base(self) -> AsBase:
        """Return what a hybrid says of it where it holds the slow part."""
        return AsBase(self.name, before=f"-{self.name}", words=self.slow_part)

    def in_words(self) -> str:
        """Return what it is, in words that follow "is"; empty where nothing is known."""
        return self.words

    def training_in_words(self) -> str:
        """Return sizes, window and steps of its networks, for tables; empty without."""
        return ""

    def to(self, device: str | torch.device) -> Self:
        """Train and run networks on this device from now on, and return the forecaster itself."""
        for part in parts_of(self).values():
            part.to(device)
        return self

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """Return it with what a comparison shares, where it does not say otherwise."""
        return self.with_parts(lambda part: part.with_defaults(settings, bands))

    def for_samples(self, samples: int, instead_of: int) -> Self:
        """Return it for a part of the training record, of so many samples instead of all."""
        return self.with_parts(lambda part: part.for_samples(samples, instead_of))

    def simulated(self, record: Record, horizon: int, *others: Record) -> Self:
        """Return it with the output of its own simulator computed, the same in every process.

        That is over the training record and `horizon` samples more, and over other records.
        """
        return self.with_parts(lambda part: part.simulated(record, horizon, *others))

    def with_parts(self, changed: Callable[[Forecaster], Forecaster]) -> Self:
        """Return it, and those in `by_seed`, with each part changed; itself without parts."""
        if not parts_of(self):
            return self
        options = {name: _with_parts(value, changed) for name, value in self.get_params().items()}
        new = self.clone().set_params(**options)
        if self.by_seed:
            new.by_seed = {seed: each.with_parts(changed) for seed, each in self.by_seed.items()}
        return new

    def prepare(
        self,
        records: Sequence[Record],
        workers: int | Executor = 1,
        folder: Path | None = None,
    ) -> None:
        """Compute once what the fits of several forecasters and seeds to records share.

        `workers` may help, and what is cut off may go on from files in the `folder`.
        """
        for part in parts_of(self).values():
            part.prepare(records, workers, folder)

    def check(self, *records: Record) -> None:
        """Raise ValueError for what is wrong with the training records, before anything runs."""
        if not records:
            raise ValueError("records must be one or several, got none")
        require_records("records", *records)
        for other in records[1:]:
            check_alike(other, records[0], other.name or "another record")
        for record in records:
            if "inputs" in self.needs and record.u is None:
                raise ValueError(f"{self.name} needs known inputs, {_named(record)} has none")
            if "simulator" in self.needs and record.y_sim is None:
                raise ValueError(f"{self.name} needs a simulator, {_named(record)} has none")
        for part in parts_of(self).values():
            part.check(*records)

    def get_params(self) -> dict[str, Any]:
        """Return the options, which are what the constructor takes, by name.

        Raises TypeError where the constructor does not keep an argument as an attribute.
        """
        return options(self)

    def set_params(self, **params: Any) -> Self:
        """Change some options and return the forecaster itself, which is then not fitted.

        Raises TypeError for an unknown option, and what the constructor raises.
        """
        self._become(self._made({**self.get_params(), **params}), {})
        return self

    def clone(self) -> Self:
        """Return a new forecaster with the same options, not fitted."""
        return self._made(
            {
                name: _with_parts(value, lambda part: part.clone())
                for name, value in self.get_params().items()
            }
        )

    def _made(self, params: dict[str, Any]) -> Self:
        """Return a forecaster of the same class with these options."""
        new = type(self)(**params)
        if self.by_seed:
            new.by_seed = self.by_seed
        return new

    def _become(self, other: Self, kept: dict[str, Any]) -> None:
        """Take over all attributes of another one but those that are kept."""
        vars(self).clear()
        vars(self).update({**vars(other), **kept})


def parts_of(forecaster: Configurable) -> dict[str, Forecaster]:
    """Return the options of a forecaster that are forecasters themselves, by name.

    Those of a list are numbered.
    """
    found: dict[str, Forecaster] = {}
    for name, option in forecaster.get_params().items():
        several = [*enumerate(option)] if isinstance(option, list | tuple) else []
        parts = {f"{name}.{i}": part for i, part in several} or {name: option}
        found |= {at: part for at, part in parts.items() if _is_forecaster(part)}
    return found


def _with_parts(option: Any, changed: Callable[[Forecaster], Forecaster]) -> Any:
    """Return an option with the forecasters in it changed; everything else is shared."""
    if _is_forecaster(option):
        return changed(option)
    if type(option) in (list, tuple):
        return type(option)(_with_parts(part, changed) for part in option)
    return option


def _named(record: Record) -> str:
    return record.name or "the record"


def _is_forecaster(value: object) -> TypeGuard[Forecaster]:
    return isinstance(value, Configurable)
