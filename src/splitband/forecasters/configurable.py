"""Define the properties of a forecaster before it is fitted: options, parts, needs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeGuard

from splitband.data import Record, check_alike, require_records
from splitband.forecasters.bands import Bands
from splitband.runtime.options import WithRepr, options
from splitband.training import Settings

if TYPE_CHECKING:
    import torch

    from splitband.forecasters.base import Forecaster
    from splitband.forecasters.network import Network


@dataclass(frozen=True)
class AsBase:
    """Hold the texts with which a hybrid describes the forecaster of its slow component.

    Attributes
    ----------
    label : Of the slow component of a prediction.
    before, after : Parts of the hybrid's name before and after the cell's.
    words : In a sentence, such as "linear model".
    described : Whether the hybrid's description includes that of its base.
    """

    label: str
    before: str = ""
    after: str = ""
    words: str = ""
    described: bool = True


class Configurable(WithRepr, ABC):
    """Define the options and needs of a forecaster, and make changed copies of it.

    Parts are options that are forecasters themselves. A property of a part is one of the whole.

    Attributes
    ----------
    cells : Options that hold the templates of its networks' cells; empty without networks.
    settings : Of its networks' training; None where they are not set or nothing is trained.
    fits_simulator : Whether its fit runs a simulator many times, which may take minutes.
    words : Description that all instances of the class share; see `in_words`.
    slow_part : Description as the slow component of a hybrid; see `as_base`.
    """

    cells: ClassVar[tuple[str, ...]] = ()
    settings: Settings | None = None
    fits_simulator: ClassVar[bool] = False
    words: ClassVar[str] = ""
    slow_part: ClassVar[str] = ""

    @property
    @abstractmethod
    def name(self) -> str:
        """Return its name in tables and files, unique within a comparison."""

    @property
    def needs(self) -> frozenset[str]:
        """Return what it needs of a record: "inputs", "simulator"."""
        return frozenset().union(*(part.needs for part in parts_of(self).values()))

    @property
    def random(self) -> bool:
        """Return whether its fit depends on a seed, as the slow training of a network does."""
        return any(part.random for part in parts_of(self).values())

    @property
    def anchored(self) -> bool:
        """Return whether a forecast depends on the time since the training record began.

        Such a forecaster cannot predict a record whose time is unrelated to that of training.
        """
        return any(part.anchored for part in parts_of(self).values())

    @property
    def calibrates(self) -> bool:
        """Return whether it calibrates a simulator, which may need output beyond the record."""
        return any(part.calibrates for part in parts_of(self).values())

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return the seeds of an ensemble's members; (0,) for a single forecaster."""
        return (0,)

    @property
    def network(self) -> Network | None:
        """Return itself if it is a network, with settings, sizes and weights; else None."""
        return None

    @property
    def shares_bands(self) -> bool:
        """Return whether it takes the bands that a comparison chooses, see `with_defaults`."""
        return any(part.shares_bands for part in parts_of(self).values())

    @property
    def refits(self) -> bool:
        """Return whether it is refitted at each origin of a trial, as its fit is quick."""
        return not self.random

    @property
    def as_base(self) -> AsBase:
        """Return its texts as the slow component of a hybrid."""
        return AsBase(self.name, before=f"-{self.name}", words=self.slow_part)

    def in_words(self) -> str:
        """Return a description that can follow "is"; empty where there is none."""
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
        """Return it with a comparison's settings and bands, where its own are not set."""
        return self.with_parts(lambda part: part.with_defaults(settings, bands))

    def for_samples(self, samples: int, instead_of: int) -> Self:
        """Return it adapted to `samples` of a training record of `instead_of` samples."""
        return self.with_parts(lambda part: part.for_samples(samples, instead_of))

    def simulated(self, record: Record, horizon: int, *others: Record) -> Self:
        """Return it with its own simulator's output computed once, for all processes.

        The output covers the training record and `horizon` samples more, and other records.
        """
        return self.with_parts(lambda part: part.simulated(record, horizon, *others))

    def with_parts(self, changed: Callable[[Forecaster], Forecaster]) -> Self:
        """Return it with each part changed; itself without parts."""
        if not parts_of(self):
            return self
        options = {name: _with_parts(value, changed) for name, value in self.get_params().items()}
        return self.clone().set_params(**options)

    def prepare(
        self,
        records: Sequence[Record],
        workers: int | Executor = 1,
        folder: Path | None = None,
    ) -> None:
        """Compute once the results that the fits of several forecasters and seeds share.

        `workers` may run it in parallel; an interrupted computation may resume from files in
        `folder`.
        """
        for part in parts_of(self).values():
            part.prepare(records, workers, folder)

    def check(self, *records: Record) -> None:
        """Raise ValueError for unsuitable training records, before anything runs."""
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
        """Return the options by name: the arguments of the constructor.

        Raises TypeError where the constructor does not keep an argument as an attribute.
        """
        return options(self)

    def set_params(self, **params: Any) -> Self:
        """Change some options and return the forecaster itself, which is then not fitted.

        Raises TypeError for an unknown option, and the errors of the constructor.
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
        return type(self)(**params)

    def _become(self, other: Self, kept: dict[str, Any]) -> None:
        """Replace all attributes by those of another forecaster and those that are kept."""
        vars(self).clear()
        vars(self).update({**vars(other), **kept})


def parts_of(forecaster: Configurable) -> dict[str, Forecaster]:
    """Return the options of a forecaster that are forecasters themselves, by name.

    Forecasters in a list are numbered.
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
