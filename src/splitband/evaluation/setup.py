"""Define the options that the forecasters of a comparison share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from splitband.data import Record
from splitband.evaluation.search import Search
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.configurable import parts_of
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.names import GREY_BOX, NAMES, QUICK, Sizes, named, with_base
from splitband.simulators.shooting import Adjustable
from splitband.training import Settings, default_warmup
from splitband.training.recipes import Recipe, recipe_settings

UNFITTED_SIMULATOR = "simulator-as-given"
"""Name of a simulator whose parameters are not fitted, but the middles of their ranges."""


@dataclass(frozen=True)
class Setup:
    """Hold the options of all forecasters of a comparison that have none themselves.

    Attributes
    ----------
    train : Length of the training part, in samples.
    settings : Training settings of networks.
    bands : Cut-off, order and down-sampling of models with bands.
    sizes : Sizes of the networks given by name.
    simulator : Simulator whose parameters are fitted, for methods without one.
    search : Limits of the search for better settings, for networks without settings; None: no
        search.
    initial : Known samples at the beginning of a test record; None: the warm-up.
    """

    train: int
    settings: Settings
    bands: Bands = field(default_factory=Bands)
    sizes: Sizes = field(default_factory=Sizes)
    search: Search | None = None
    simulator: Adjustable | None = None
    initial: int | None = None

    def forecaster(self, name: str) -> Forecaster:
        """Return the forecaster with this name; only `bands` may leave something to be chosen."""
        forecaster = named(name, self.sizes).with_defaults(self.settings, self.bands)
        forecaster = forecaster if self.simulator is None else forecaster.given(self.simulator)
        if forecaster.network is not None:
            forecaster.network.resizable = self.search is not None and self.search.sizes
        return forecaster

    def decided(
        self,
        record: Record,
        train: int,
        methods: Sequence[Forecaster | str] | None = None,
        tests: Sequence[Record] = (),
        others: Sequence[Record] = (),
    ) -> Setup:
        """Return this setup; raises ValueError where it is for another training part."""
        if train != self.train:
            raise ValueError(f"train must be that of setup, {self.train}, got {train}")
        return self

    def usual(self, record: Record) -> list[Forecaster | str]:
        """Return the default methods for a record; a simulator is also compared before its fit."""
        if self.simulator is None:
            return [*usual_names(record, self.bands)]
        middle = self.simulator.fixed(self.simulator.known.middle())
        names = with_base(default_names(True, record.nu > 0), GREY_BOX)
        at = names.index(GREY_BOX)
        return [*names[:at], GreyBox(middle, name=UNFITTED_SIMULATOR), *names[at:]]

    def as_json(self) -> dict[str, Any]:
        """Return the setup as a dictionary for a result file."""
        bands, sizes = asdict(self.bands), asdict(self.sizes)
        return (
            {"train": self.train, "settings": asdict(self.settings)}
            | {name: bands[name] for name in ("cutoff", "order", "downsampling")}
            | sizes
            | ({} if self.simulator is None else {"parameters": str(self.simulator.known)})
            | {"choice": bands["choice"]}
            | ({} if self.search is None else {"search": asdict(self.search)})
        )


def default_names(with_simulator: bool, with_inputs: bool = False) -> list[str]:
    """Return the names of the default methods, with a simulator that helps or without.

    Methods that ignore inputs are compared even on records with inputs, which may not matter.
    """
    # In the order of fitting where time is short; the first network is searched most thoroughly.
    naive = ["mean", "persistence", "seasonal-naive", "periodic", "harmonic"]
    first, cell = ["gru"], "gru"
    if with_inputs:
        naive.insert(2, "linear")
        first, cell = ["state-space", "gru"], "state-space"
    if not with_simulator:
        return [*first, "split-gru", "split-gru-conditioned", *naive]
    hybrids = [f"filtered-{cell}-calibrated-conditioned", f"residual-{cell}-calibrated-conditioned"]
    trained = [hybrids[1], first[0], hybrids[0], *first[1:]] if with_inputs else [*first, *hybrids]
    return [*trained, "simulator", "simulator-calibrated", *naive]


def usual_names(record: Record, bands: Bands) -> list[str]:
    """Return `default_names`, without hybrids where the record's simulator does not help."""
    names = default_names(record.y_sim is not None, record.nu > 0)
    if bands.choice is None or bands.choice.simulator_helps is not False:
        return names
    kept = [name for name in names if name in QUICK and "simulator" in NAMES[name].needs]
    learned = default_names(False, record.nu > 0)
    trained = learned.index("mean")
    return [*learned[:trained], *kept, *learned[trained:]]


@dataclass(frozen=True)
class Options:
    """Hold the options of a `Setup` that a user gives; the rest follows from training samples.

    Attributes
    ----------
    recipe : Training settings where none are given: "default" or "constant-rate".
    settings : Training settings in place of the recipe's.
    changes : Single settings, such as `{"epochs": 5}`, in place of those of the recipe or of
        `settings`. Any but `warmup` switches the search off.
    bands : Bands as far as they are given; the rest is chosen where methods need it, see
        `Bands.chosen`.
    sizes : Sizes of the networks given by name.
    search : Limits of the search. By default two minutes; no search where settings are given.
    simulator : Simulator whose parameters are fitted, for methods without one.
    initial : Known samples at the beginning of a test record, by default the warm-up.
    """

    recipe: Recipe = "default"
    settings: Settings | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    bands: Bands = field(default_factory=Bands)
    sizes: Sizes | None = None
    search: Search | None = None
    simulator: Adjustable | None = None
    initial: int | None = None

    def decided(
        self,
        record: Record,
        train: int,
        methods: Sequence[Forecaster | str] | None = None,
        tests: Sequence[Record] = (),
        others: Sequence[Record] = (),
    ) -> Setup:
        """Return the setup for a record, from its first `train` samples alone.

        Parameters
        ----------
        record, train : No measured sample after the first `train` is used.
        methods : Forecasters or names; by default `default_names`.
        tests : Test records, of which only the lengths are used: a warm-up that is not given is at
            most a third of the shortest one.
        others : Further training records, of which only the lengths are used, too: windows that are
            not given fit into the shortest one.
        """
        training = record[:train]
        settings = self._settings(recipe_settings(self.recipe, training, others), tests)
        names = default_names(record.y_sim is not None) if methods is None else methods
        made = [named(each) if isinstance(each, str) else each for each in names]
        bands = self._bands(training, settings, made)
        sizes = Sizes() if self.recipe == "constant-rate" else Sizes(hidden_high=32, hidden_low=16)
        sizes = self.sizes or sizes
        search = self._search()
        return Setup(train, settings, bands, sizes, search, self.simulator, self.initial)

    def _settings(self, usual: Settings, tests: Sequence[Record]) -> Settings:
        """Return the training settings before any search; `usual` are those of the recipe."""
        settings, said = self.settings or usual, {**self.changes}
        if "window" in said:
            said.setdefault("warmup", default_warmup(said["window"], settings.warmup))
        if "milestones" in said:
            said.setdefault("one_cycle", False)
        settings = replace(settings, **said)
        if tests and self.settings is None and "warmup" not in self.changes:
            shortest = default_warmup(min(map(len, tests)))
            settings = replace(settings, warmup=min(settings.warmup, shortest))
        return settings

    def _search(self) -> Search | None:
        decided = [name for name in self.changes if name != "warmup"]
        decided += ["recipe constant-rate"] if self.recipe == "constant-rate" else []
        if decided and self.search is not None:
            raise ValueError(
                "search must be None where it is decided how to train, got it beside "
                f"{', '.join(decided)}"
            )
        if decided or (self.search is None and self.settings is not None):
            return None
        search = self.search or Search.usual()
        return replace(search, sizes=search.sizes and self.sizes is None)

    def _bands(self, training: Record, settings: Settings, methods: Sequence[Forecaster]) -> Bands:
        """Return the bands: for hybrids where the simulator helps, else for networks alone."""
        given = self.bands.cutoff is not None
        if not given and not any(each.shares_bands for each in methods):
            return self.bands
        y_sim, beside = None, [base for method in methods for base in _simulators_in(method)]
        if training.y_sim is not None and beside:
            simulation = next((f for f in beside if f.calibrates), beside[0]).clone()
            y_sim = simulation.fit(training).on(training).y_sim
        # Where the record has no band to split off, the methods that need one report it.
        with nullcontext() if given else suppress(ValueError):
            rate = training.sampling_rate
            return self.bands.chosen(training.y, rate, settings.warmup, y_sim)
        return self.bands


def _simulators_in(forecaster: Forecaster) -> Iterator[Forecaster]:
    """Yield the parts of a forecaster that use the simulator's output in the record."""
    for part in parts_of(forecaster).values():
        if parts_of(part):
            yield from _simulators_in(part)
        elif "simulator" in part.needs:
            yield part
