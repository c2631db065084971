"""Hold what is asked of a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from numbers import Real
from typing import Any

from splitband.comparison.methods import Sizes
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.held_out import TRAINING_SHARE
from splitband.records import Record, require_records
from splitband.runtime.arguments import check_device, whole
from splitband.runtime.errors import InputError
from splitband.simulators import Simulator
from splitband.simulators.parameters import Adjustable
from splitband.training import TrainingSettings
from splitband.training.settings import Recipe

LARGEST_SEED = 2**32 - 1
"""Seeds of single trainings, which are multiples of it, must fit into 64 bits."""
_KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "methods": ((Sequence,), "a list of forecasters and names"),
    "others": ((Sequence,), "a list of records"),
    "tests": ((Sequence,), "a list of records"),
    "settings": ((TrainingSettings, Mapping), "sb.TrainingSettings, or a dictionary of some"),
    "bands": ((Bands,), "sb.Bands(cutoff=...)"),
    "sizes": ((Sizes,), "Sizes of splitband.comparison.methods"),
    "budget": ((Real,), "a positive number of seconds"),
    "also": ((Mapping,), "a dictionary of lists of simulations"),
}
"""What some arguments must be, which may be None where that is their default."""


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """Hold the arguments of `compare` that say what is computed, which documents them.

    Raises ValueError for those that are wrong whatever the others are.
    """

    record: Record
    train: int | None = None
    methods: Sequence[Forecaster | str] | str | None = None
    _: KW_ONLY
    horizon: int | None = None
    ahead: int | None = None
    others: Sequence[Record] = ()
    tests: Sequence[Record] = ()
    initial: int | None = None
    settings: TrainingSettings | Mapping[str, Any] | None = None
    recipe: Recipe = "default"
    bands: Bands | None = None
    sizes: Sizes | None = None
    simulator: Simulator | Adjustable | str | None = None
    calibrate: bool = False
    conditioned: bool = False
    budget: float | None = None
    rounds: int | None = None
    seed: int = 0
    seeds: int | None = None
    refit: bool = False
    device: str = "cpu"
    also: Mapping[str, Sequence[Simulator]] | None = None

    def __post_init__(self) -> None:
        require_records("record", self.record)
        for name, (kinds, words) in _KINDS.items():
            value = getattr(self, name)
            if not isinstance(value, kinds) and value is not getattr(PlanRequest, name):
                raise TypeError(f"{name} must be {words}, got {type(value).__name__} {value!r:.40}")
        for name, several in (("others", self.others), ("tests", self.tests)):
            require_records(name, *several)
        if self.ahead is not None and whole("ahead", self.ahead) and self.horizon:
            raise InputError(
                "horizon and ahead exclude each other (the one is how far one free run after the "
                "training part goes; the other scores forecasts of so many samples from many "
                f"origins, with the measurements until each), got {self.horizon} and {self.ahead}"
            )
        if self.initial is not None and not self.tests:
            raise InputError(f"initial must be used with test records, got {self.initial}")
        if self.budget is not None and not self.budget > 0:
            raise InputError(f"budget must be a positive number of seconds, got {self.budget}")
        if self.budget is not None and self.rounds is not None:
            raise InputError(
                "budget and rounds exclude each other (the one limits the time, the other the "
                f"work), got {self.budget} and {self.rounds}"
            )
        for name, runs in ({} if self.also is None else self.also).items():
            if not isinstance(runs, Sequence):
                raise TypeError(f"also must have a list of simulations by name: write [{name}]")
            if len(runs) not in (1, 1 + len(self.tests)):
                raise InputError(
                    "also (--also) must have one simulation, of the record, and may have one more "
                    f"for each of the {len(self.tests)} test records, got {len(runs)} of {name}"
                )
        whole("seed", self.seed, 0, LARGEST_SEED)
        for name, number in (("rounds", self.rounds), ("seeds", self.seeds)):
            if number is not None:
                whole(name, number)
        check_device(self.device)

    @property
    def samples(self) -> int:
        """Return how many samples train."""
        if self.train is not None:
            return self.train
        return len(self.record) if self.tests else int(TRAINING_SHARE * len(self.record))
