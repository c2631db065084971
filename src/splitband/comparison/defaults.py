"""Choose the methods that are worth comparing on a record, and the bands of methods."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext, suppress

from splitband.comparison.methods import HYBRIDS, Sizes, forecasters
from splitband.filters import Band
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster, all_parts, parts_of
from splitband.forecasters.network import Network
from splitband.records import Record
from splitband.runtime.errors import InputError
from splitband.runtime.optional import has_torch
from splitband.training import TrainingSettings
from splitband.training.settings import recipe_settings


def default_names(with_simulator: bool, with_inputs: bool = False) -> list[str]:
    """Return the names of the default methods, with a simulator that helps or without.

    Of the methods that ignore inputs, a record with inputs is compared with the mean and with the
    last value alone. Without torch there are no networks.
    """
    naive, first = ["mean", "persistence", "seasonal-naive", "periodic", "harmonic"], ["gru"]
    if with_inputs:
        naive, first = ["linear", "mean", "persistence"], ["state-space", "gru"]
    if with_simulator:
        naive = ["simulator", "simulator-calibrated", *naive]
    if not has_torch():
        return naive
    if not with_simulator:
        return [*first, *naive]
    hybrids = [f"{kind}-state-space-calibrated-conditioned" for kind in ("filtered", "residual")]
    trained = [hybrids[1], first[0], hybrids[0], *first[1:]] if with_inputs else [*first, *hybrids]
    return [*trained, *naive]


def usual_names(names: list[str], bands: Bands, high: Bands) -> list[str]:
    """Return default names, with hybrids of the bands in which the record's simulator helps.

    A hybrid with the simulator in the high band, as of a sensor that drifts, is tried where a lower
    error is expected of it than of one with the low band. Without such a band, there are no
    hybrids.
    """
    if bands.choice is None or bands.choice.simulator_helps is None:
        return names
    below, above = bands.choice, high.choice
    at = next(i for i, name in enumerate(names) if name.startswith("filtered-"))
    hybrids = names[at : at + 1] if below.simulator_helps else []
    helps = above is not None and above.simulator_helps
    if above is not None and helps and (not hybrids or above.expected < below.expected):
        hybrids = ["filtered-high-state-space-conditioned", *hybrids]
    if hybrids:
        return [*names[:at], *hybrids, *names[at + 1 :]]
    return [name for name in names if name not in HYBRIDS]


def usual_methods(
    given: Bands, training: Record, settings: TrainingSettings, sizes: Sizes
) -> tuple[list[Forecaster], Bands, Bands]:
    """Return the default methods for a record, and their bands, low and high."""
    listed = forecasters(default_names(training.y_sim is not None, training.nu > 0), sizes)
    _check_bands(given, listed)
    low = chosen_bands(given, training, listed, settings)
    high = OPEN if low.choice is None else high_bands(given, training, settings)
    listed = forecasters(usual_names([method.name for method in listed], low, high), sizes)
    if not _any_takes_bands(listed, "low"):
        low = Bands(choice=low.choice)  # which says why the simulator does not help
    return listed, low, high


def bands_of(
    methods: Sequence[Forecaster], given: Bands, training: Record, settings: TrainingSettings
) -> tuple[Bands, Bands]:
    """Return the bands of these methods, low and high; see `chosen_bands` and `high_bands`."""
    above = _any_takes_bands(methods, "high")
    high = high_bands(given, training, settings) if above else OPEN
    return chosen_bands(given, training, methods, settings), high


def chosen_bands(
    given: Bands,
    training: Record,
    methods: Sequence[Forecaster],
    settings: TrainingSettings | None = None,
) -> Bands:
    """Return the bands of these methods: of hybrids where the simulator helps, else of networks.

    What is given stays. Settings are by default the usual ones for such a record.
    """
    settings = settings or recipe_settings("default", training)
    if given.cutoff is None and not _any_takes_bands(methods, "low"):
        return given
    methods = [method for method in methods if not _any_takes_bands([method], "high")]
    below = [each for method in methods for part in parts_of(method) for each in all_parts(part)]
    y_sim, beside = None, [p for p in below if not parts_of(p) and "simulator" in p.needs]
    if training.y_sim is not None and beside:
        simulation = next((f for f in beside if f.calibrates), beside[0]).clone()
        y_sim = simulation.fit(training).on(training).y_sim
    # Where the record has no band to split off, the methods that need one report it.
    with nullcontext() if given.cutoff is not None else suppress(ValueError):
        return given.chosen(training.y, training.sampling_rate, settings.warmup, y_sim)
    return given


def high_bands(given: Bands, training: Record, settings: TrainingSettings | None = None) -> Bands:
    """Return the bands of hybrids with the record's simulator in the high band.

    What is given stays. The simulator is not calibrated: its drift would decide its gain. Settings
    are by default the usual ones for such a record.
    """
    y, rate, y_sim = training.y, training.sampling_rate, training[:].y_sim
    settings = settings or recipe_settings("default", training)
    with nullcontext() if given.cutoff is not None else suppress(ValueError):
        return given.chosen(y, rate, settings.warmup, y_sim, "high")
    return given


def _any_takes_bands(methods: Sequence[Forecaster], simulator_band: Band) -> bool:
    """Return whether one of the methods takes a comparison's bands, of hybrids of this kind."""
    every = [part for method in methods for part in all_parts(method)]
    networks = [part for part in every if isinstance(part, Network)]
    return any(p.takes_bands and p.simulator_band == simulator_band for p in networks)


def _check_bands(bands: Bands, methods: Sequence[Forecaster]) -> None:
    """Raise ValueError if parameters of two bands are given, and none of the methods has any."""
    parts = [part for method in methods for part in all_parts(method)]
    if any(isinstance(part, Network) and part.bands is not None for part in parts):
        return
    for name in ("cutoff", "order", "downsampling"):
        if (value := getattr(bands, name)) is not None:
            raise InputError(
                f"{name} must be left out where no default method has two bands, got {value}: "
                "methods (--methods) takes those that have, such as split-gru"
            )
