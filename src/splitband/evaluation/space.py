"""What `tune` searches: kinds of networks, sizes, training and bands, and where it begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from splitband.data import Record
from splitband.evaluation.search import SIZES, ways
from splitband.evaluation.setup import Setup, default_names
from splitband.evaluation.tuned import Tuned
from splitband.filters.cutoff import LEAST_WARMUP, MOST_DOWNSAMPLING
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.hybrids import Filtered
from splitband.forecasters.names import TRAINED, Sizes, named
from splitband.forecasters.network import Network
from splitband.forecasters.simulation import Simulation
from splitband.forecasters.split import Split
from splitband.networks import GRU

HIDDEN = 6, 96
"""Hidden units of all networks of a method together."""
LOW_SHARE = 0.15, 0.85
"""Of them in the low band."""
WINDOW = 20, 800
"""Predicted samples of the shortest window, and all samples of the longest one."""
STEPS = 100, 3000
"""Of Adam."""
RATES = 1e-3, 3e-2
ITERATIONS = 50, 3200
"""Of L-BFGS, where there are any."""
ORDERS = 1, 3
BELOW_NYQUIST = 0.8
"""The highest cut-off, as a share of the Nyquist frequency; that of the low band, if sampled more
slowly, likewise."""
CYCLES = 3
"""Cycles of the lowest cut-off in the training part."""
Parameters = dict[str, Any]


class Draw(Protocol):
    """Something that chooses a value for each parameter, such as a trial of Optuna."""

    def suggest_categorical(self, name: str, choices: Sequence[Any]) -> Any:
        """One of the choices."""

    def suggest_int(self, name: str, low: int, high: int, *, log: bool = False) -> int:
        """A whole number from `low` to `high`."""

    def suggest_float(self, name: str, low: float, high: float, *, log: bool = False) -> float:
        """A number from `low` to `high`."""


def tunable_names(record: Record) -> list[str]:
    """The networks that are worth searching for such a record: of the GRU, all kinds that apply."""
    brings = {"inputs": record.u is not None, "simulator": record.y_sim is not None}
    return [
        name
        for name in TRAINED
        if isinstance(network := named(name), Network)
        and all(isinstance(getattr(network, cell), GRU) for cell in network.cells)
        and all(brings[need] for need in network.needs)
    ]


def usual_networks(record: Record, methods: Sequence[str]) -> list[str]:
    """Those of the methods that `compare` trains by default; the first one where there are none."""
    usual = default_names(record.y_sim is not None, record.nu > 0)
    return [name for name in methods if name in usual] or [*methods[:1]]


@dataclass(frozen=True, eq=False)
class Space:
    """All that can be drawn for a record.

    Attributes
    ----------
    methods : Names of networks.
    setup : The usual settings, bands and sizes; its warm-up is kept.
    sampling_rate : In Hz.
    """

    methods: tuple[str, ...]
    setup: Setup
    sampling_rate: float

    def drawn(self, draw: Draw) -> Tuned:
        """One way to train one network."""
        method = draw.suggest_categorical("method", self.methods)
        network = named(method, self.setup.sizes)
        usual = self.setup.settings
        shortest, longest = self._windows(method)
        settings = replace(usual, window=draw.suggest_int("window", shortest, longest, log=True))
        steps = draw.suggest_int("adam_steps", *_with(STEPS, self._steps(method)), log=True)
        rates = _with(RATES, usual.learning_rate)
        settings = replace(
            settings,
            epochs=max(1, round(steps / usual.batches_of(self.setup.train))),
            learning_rate=draw.suggest_float("learning_rate", *rates, log=True),
            quasi_newton=draw.suggest_int("lbfgs_iterations", *ITERATIONS, log=True)
            if draw.suggest_categorical("lbfgs", (False, True))
            else None,
        )
        return Tuned(method, settings, self._bands(draw, network), self._sizes(draw, network))

    def usual(self, method: str) -> Parameters:
        """The default recipe, as what is drawn."""
        settings, network = self.setup.settings, named(method, self.setup.sizes)
        hidden, share = self._hidden()
        return {
            "method": method,
            "hidden": hidden,
            "window": settings.window,
            "adam_steps": self._steps(method),
            "learning_rate": settings.learning_rate,
            "lbfgs": False,
            **({"low_share": share} if isinstance(network, Split) else {}),
            **({"bands": "usual"} if _has_bands(network) else {}),
        }

    def beginnings(self, record: Record) -> list[tuple[Parameters, bool]]:
        """Where to begin, and whether that is the default recipe.

        That is followed by what `search` tries first: of one network all short trainings, of the
        others the one on long windows of the smallest network.
        """
        usual = usual_networks(record, self.methods)
        short = {method: self._short(method) for method in dict.fromkeys([*usual, *self.methods])}
        return [
            *((self.usual(method), True) for method in usual),
            *((point, False) for point in short[usual[0]]),
            *((short[method][-len(SIZES)], False) for method in [*short][1:]),
        ]

    def _short(self, method: str) -> list[Parameters]:
        """Short trainings that end with L-BFGS, of windows and sizes that differ."""
        network = self.setup.forecaster(method)
        assert isinstance(network, Network)
        network.resizable = True
        usual = self.usual(method)
        batches = self.setup.settings.batches_of(self.setup.train)
        return [
            usual
            | {
                "hidden": max(HIDDEN[0], round(size * usual["hidden"])),
                "window": settings.window,
                "adam_steps": max(STEPS[0], settings.epochs * batches),
                "lbfgs": True,
                "lbfgs_iterations": max(ITERATIONS[0], settings.quasi_newton or 0),
            }
            for settings, size in ways(network, self.setup.train)[1:]
        ]

    def _windows(self, method: str) -> tuple[int, int]:
        """The shortest and the longest window."""
        usual, least = self.setup.settings, WINDOW[0]
        longest = max(usual.window, min(WINDOW[1], 3 * self.setup.train // 5))
        return min(usual.window, usual.warmup + least), longest

    def _steps(self, method: str) -> int:
        """Of Adam, in the default recipe."""
        usual = self.setup.settings
        return usual.epochs * usual.batches_of(self.setup.train)

    def _hidden(self) -> tuple[int, float]:
        """Usual units of all networks, and the share of the low band's."""
        sizes = self.setup.sizes
        hidden = sizes.hidden_high + sizes.hidden_low
        return hidden, sizes.hidden_low / hidden

    def _sizes(self, draw: Draw, network: Forecaster) -> Sizes:
        usual, share = self._hidden()
        hidden = draw.suggest_int("hidden", *_with(HIDDEN, usual), log=True)
        if isinstance(network, Split):
            share = draw.suggest_float("low_share", *_with(LOW_SHARE, share))
        low = min(max(round(share * hidden), 1), hidden - 1)
        return replace(self.setup.sizes, hidden_high=hidden - low, hidden_low=low)

    def _bands(self, draw: Draw, network: Forecaster) -> Bands:
        """The usual bands, or others; none where the method has no filter, or chooses by itself."""
        if not _has_bands(network):
            return Bands()
        usual = replace(self.setup.bands, choice=None)
        if draw.suggest_categorical("bands", ("usual", "searched")) == "usual":
            return usual
        highest = BELOW_NYQUIST * self.sampling_rate / 2
        lowest = min(CYCLES * self.sampling_rate / self.setup.train, highest / 2)
        cutoff = float(f"{draw.suggest_float('cutoff', lowest, highest, log=True):.3g}")
        order, warmup = draw.suggest_int("order", *ORDERS), self.setup.settings.warmup
        if not isinstance(network, Split):
            return Bands(cutoff, order, usual.downsampling)
        # Filters that run both ways need a warm-up, see `networks.check_warmup`.
        order = min(order, max((warmup - 1) // 3 - 1, 1))
        most = min(int(highest / cutoff), warmup // LEAST_WARMUP)
        k = draw.suggest_int("downsampling", 1, MOST_DOWNSAMPLING)
        return Bands(cutoff, order, min(k, max(most, 1)))


def _has_bands(network: Forecaster) -> bool:
    """Whether a cut-off can be given.

    Beside what is fitted to the record it is chosen after that fit, by where both agree.
    """
    simulated = isinstance(network, Filtered) and isinstance(network.base, Simulation)
    return simulated or isinstance(network, Split)


def _with(limits: tuple[Any, Any], value: Any) -> tuple[Any, Any]:
    """Limits that hold a value, too."""
    return min(limits[0], value), max(limits[1], value)
