"""The paper's systems, and one method on one of them as a job to be run."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

from reproduction.settings import HYBRID, LEARNING_BASED, OURS, Hybrid, LearningBased, Setup, in_hz
from reproduction.systems import MassSpringOracle, double_torsion_pendulum, noisy_van_der_pol
from splitband.comparison.methods import NAMES, QUICK
from splitband.forecasters.base import Forecaster
from splitband.records import Record, double_torsion, drill_string, read
from splitband.records.named import double_mass_spring, van_der_pol

ORACLE = "oracle"
"""Method on system (i): least squares on the true form."""

_once = lru_cache(maxsize=64)
"""For records that are simulated: a table asks for them again with every run."""


@dataclass(frozen=True)
class System:
    """A record under the settings of one of the paper's columns.

    Attributes
    ----------
    title : For tables.
    column : The paper's settings.
    record : Makes the record; the argument is the noise draw, of which only simulated ones have
        several.
    """

    title: str
    column: LearningBased | Hybrid
    record: Callable[[int], Record]


def _torsion(row: str, _: int) -> Record:
    """The record of a row where SPLITBAND_DATA_DIR has it, otherwise the one that is public."""
    folder = os.environ.get("SPLITBAND_DATA_DIR")
    own = Path(folder or ".") / f"double_torsion_{row}.csv"
    if folder is None or not own.is_file():
        return double_torsion()
    y = read(own, sampling_time=0.01).y[:2000]
    return Record((y - y.mean(axis=0)) / y.std(axis=0), 0.01, name=own.stem, columns=("phi2",))


SYSTEMS = {
    "i": System(
        "double mass-spring",
        LEARNING_BASED["i"],
        _once(lambda draw: double_mass_spring(seed=draw)),
    ),
    **{
        row: System("double-torsion record", LEARNING_BASED[row], partial(_torsion, row))
        for row in ("ii", "iii", "iv")
    },
    **{
        f"{row}-simulated": System(
            "simulated pendulum",
            LEARNING_BASED[row],
            _once(partial(double_torsion_pendulum, row, 2000)),
        )
        for row in ("ii", "iii", "iv")
    },
    "v": System("Van der Pol", HYBRID["v"], _once(lambda draw: van_der_pol())),
    "v-noisy": System("Van der Pol with noise", HYBRID["v"], _once(noisy_van_der_pol)),
    "vi": System("drill string", HYBRID["vi"], _once(lambda draw: drill_string())),
}
"""By the paper's numbers; it has one record for each of (ii) to (iv), of which one is public. Its
text reads as if all simulated systems had noise, and does not say how much."""


@dataclass(frozen=True)
class Job:
    """One method on one system with one seed; None is the paper's value.

    Attributes
    ----------
    draw : Of the noise.
    cutoff : w, in the unit of the paper's tables.
    downsampling : k.
    epochs : The paper's training steps.
    own_warmup : Of split models: whether the warm-up of each training window is filtered alone,
        instead of being cut from the filtered training record (paper, Eq. 10, training).
    """

    system: str
    method: str
    seed: int = 0
    draw: int = 0
    cutoff: float | None = None
    downsampling: int | None = None
    epochs: int | None = None
    own_warmup: bool = False

    def __post_init__(self) -> None:
        """Drop what is the paper's own value or has no effect: equal runs are equal jobs."""
        if self.system not in SYSTEMS:
            raise ValueError(f"systems must be out of {', '.join(SYSTEMS)}, got {self.system}")
        if OURS.get(self.method, self.method) not in (*NAMES, ORACLE):
            raise ValueError(f"methods must be out of {', '.join(NAMES)}, got {self.method}")
        column = SYSTEMS[self.system].column
        trained = self.method not in (*QUICK, ORACLE)
        for name, value, matters in (
            ("cutoff", column.cutoff, self.method.startswith(("split-", "filtered-"))),
            ("downsampling", column.downsampling, self.splits),
            ("epochs", self.full_epochs, trained),
        ):
            if vars(self)[name] == value or not matters:
                vars(self)[name] = None
        if not self.splits:
            vars(self)["own_warmup"] = False

    @property
    def splits(self) -> bool:
        """Whether it trains two networks, one for each band."""
        return self.method.startswith("split-")

    @property
    def path(self) -> Path:
        """Of its file in a folder of results."""
        marks = {
            "draw": self.draw or None,
            "w": self.cutoff,
            "k": self.downsampling,
            "epochs": self.epochs,
        }
        parts = [f"{name}{value:g}" for name, value in marks.items() if value is not None]
        parts = ["own-warmup", *parts] if self.own_warmup else parts
        return Path(self.system, self.method, "-".join([*parts, f"seed{self.seed}"]) + ".json")

    @property
    def full_epochs(self) -> int:
        """The paper's for this method on this system."""
        return SYSTEMS[self.system].column.epochs_of(self.method)

    @property
    def record(self) -> Record:
        """What it learns from and is measured on."""
        return SYSTEMS[self.system].record(self.draw)

    def forecaster(self, setup: Setup) -> Forecaster:
        """The untrained method."""
        if self.method == ORACLE:
            return MassSpringOracle()
        made = setup.forecaster(self.method)
        return made.clone().set_params(own_warmup=self.own_warmup) if self.splits else made

    def setup(self, record: Record) -> Setup:
        """The paper's settings with what this job changes."""
        setup = SYSTEMS[self.system].column.setup(record.sampling_rate, self.method)
        if self.epochs is not None:
            setup = replace(setup, settings=replace(setup.settings, epochs=self.epochs))
        if self.cutoff is not None:
            cutoff = in_hz(self.cutoff, record.sampling_rate)
            setup = replace(setup, bands=replace(setup.bands, cutoff=cutoff))
        if self.downsampling is not None:
            setup = replace(setup, bands=replace(setup.bands, downsampling=self.downsampling))
        return setup
