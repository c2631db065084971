"""What the forecasters of a comparison share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from splitband.data import Record
from splitband.evaluation.search import Search
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster, parts_of
from splitband.forecasters.names import NAMES, QUICK, Sizes, named
from splitband.forecasters.network import Network
from splitband.training import Settings
from splitband.training.recipes import Recipe, recipe_settings


@dataclass(frozen=True)
class Setup:
    """What the forecasters of a comparison share where they do not say otherwise.

    Attributes
    ----------
    train : Samples at the beginning of the record that are trained on.
    settings : How networks are trained.
    bands : Which band is whose.
    sizes : Of the networks that go by a name.
    search : How much may go into finding better settings where a forecaster has none of its own;
        None: the settings are what they are.
    """

    train: int
    settings: Settings
    bands: Bands = field(default_factory=Bands)
    sizes: Sizes = field(default_factory=Sizes)
    search: Search | None = None

    def forecaster(self, name: str) -> Forecaster:
        """The forecaster of a name, with nothing left open but what the bands do."""
        forecaster = named(name, self.sizes).with_defaults(self.settings, self.bands)
        if isinstance(forecaster, Network):
            forecaster.resizable = self.search is not None and self.search.sizes
        return forecaster

    def as_json(self) -> dict[str, Any]:
        """For a result file: flat, and with the settings that each of them is made of."""
        bands, sizes = asdict(self.bands), asdict(self.sizes)
        return (
            {"train": self.train, "settings": asdict(self.settings)}
            | {name: bands[name] for name in ("cutoff", "order", "downsampling")}
            | sizes
            | {"choice": bands["choice"]}
            | ({} if self.search is None else {"search": asdict(self.search)})
        )


def default_names(with_simulator: bool, with_inputs: bool = False) -> list[str]:
    """What is worth comparing in a reasonable time, with a simulator that helps or without.

    What knows no inputs is asked even where there are some: they may not matter.
    """
    networks, simulator = ["split-gru", "split-gru-conditioned"], []
    if with_simulator:
        networks = ["filtered-gru-calibrated-conditioned", "residual-gru-calibrated-conditioned"]
        simulator = ["simulator", "simulator-calibrated"]
    # In the order in which they are fitted where time is short.
    driven = ["linear"] if with_inputs else []
    naive = ["mean", "persistence", *driven, "seasonal-naive", "periodic", "harmonic"]
    return ["gru", *networks, *simulator, *naive]


def usual_names(record: Record, setup: Setup) -> list[str]:
    """`default_names`, with the learned models where the record's simulator does not help."""
    names = default_names(record.y_sim is not None, record.nu > 0)
    if setup.bands.choice is None or setup.bands.choice.simulator_helps is not False:
        return names
    kept = [name for name in names if name in QUICK and "simulator" in NAMES[name].needs]
    learned = default_names(False, record.nu > 0)
    return [*learned[:3], *kept, *learned[3:]]


def trying_bases(setup: Setup) -> Setup:
    """The setup of a comparison that may add to the `usual_names`: see `evaluation.bases`."""
    search = setup.search
    return setup if search is None else replace(setup, search=replace(search, bases=True))


def default_setup(
    record: Record,
    train: int,
    recipe: Recipe = "default",
    settings: Settings | None = None,
    bands: Bands | None = None,
    methods: Sequence[Forecaster | str] | None = None,
) -> Setup:
    """A setup for a record of which nothing is known but its first `train` samples.

    Parameters
    ----------
    record, train : No measured sample after the first `train` is looked at.
    recipe, settings : How to train; by default as the recipe says.
    bands : What is decided of them already; the rest is chosen, see `Bands.chosen`, where methods
        need it: for hybrid models, if there are any and the simulator helps, otherwise for networks
        alone.
    methods : What the setup is for, or names of it; by default `default_names`.
    """
    search = None
    if settings is None:
        settings = recipe_settings(recipe, record[:train])
        search = Search.usual() if recipe == "default" else None
    if methods is None:
        methods = default_names(record.y_sim is not None)
    beside = [base for method in _made(methods) for base in _simulators_in(method)]
    y_sim = None
    if record.y_sim is not None and beside:
        simulation = next((f for f in beside if f.calibrates), beside[0]).clone()
        simulation.fit(record[:train])
        y_sim = simulation.on(record[:train]).y_sim
    bands = bands or Bands()
    given = bands.cutoff is not None
    if given or any(each.shares_bands for each in _made(methods)):
        # A record without a band to split off concerns the methods that need one: they say so.
        with nullcontext() if given else suppress(ValueError):
            bands = bands.chosen(record[:train].y, record.sampling_rate, settings.warmup, y_sim)
    sizes = Sizes() if recipe == "paper" else Sizes(hidden_high=32, hidden_low=16)
    return Setup(train, settings, bands, sizes, search=search)


def _made(methods: Sequence[Forecaster | str]) -> list[Forecaster]:
    return [named(each) if isinstance(each, str) else each for each in methods]


def _simulators_in(forecaster: Forecaster) -> Iterator[Forecaster]:
    """Yield what a forecaster is made of and reads the simulator's output of the record."""
    for part in parts_of(forecaster).values():
        if parts_of(part):
            yield from _simulators_in(part)
        elif "simulator" in part.needs:
            yield part
