"""What a comparison is made of where nobody says otherwise: methods, filters and training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.data import Trajectory
from splitband.filters.cutoff import Choice, choose, choose_with_simulator
from splitband.forecasters.methods import (
    CALIBRATED,
    CONDITIONED,
    HYBRIDS,
    Setup,
    prepared,
    simulated,
)
from splitband.training import Settings
from splitband.training.recipes import Recipe, recipe_settings


def default_methods(with_simulator: bool, with_inputs: bool = False) -> list[str]:
    """What is worth comparing in a reasonable time, with a simulator that helps or without.

    What knows no inputs is asked even where there are some: they may not matter.
    """
    both = CALIBRATED + CONDITIONED
    networks, simulator = ["split-gru", "split-gru" + CONDITIONED], []
    if with_simulator:
        networks = ["filtered-gru" + both, "residual-gru" + both]
        simulator = ["simulator", "simulator" + CALIBRATED]
    naive = ["mean", "persistence", "seasonal-naive", "periodic", "harmonic"]
    return ["gru", *networks, *simulator, *naive, *(["linear"] if with_inputs else [])]


def usual_methods(record: Trajectory, setup: Setup) -> list[str]:
    """`default_methods`, with the learned models where the record's simulator does not help."""
    methods = default_methods(record.y_sim is not None, record.nu > 0)
    if setup.choice is None or setup.choice.simulator_helps is not False:
        return methods
    kept = [method for method in methods if method.startswith("simulator")]
    learned = default_methods(False, record.nu > 0)
    return [*learned[:3], *kept, *learned[3:]]


def default_setup(
    record: Trajectory,
    train: int,
    recipe: Recipe = "default",
    settings: Settings | None = None,
    cutoff: float | None = None,
    order: int | None = None,
    downsampling: int | None = None,
    methods: Sequence[str] | None = None,
) -> Setup:
    """A setup for a record of which nothing is known but its first `train` samples.

    Parameters
    ----------
    record, train : No measured sample after the first `train` is looked at.
    recipe, settings : How to train; by default as the recipe says.
    cutoff, order, downsampling : Already decided; the rest is chosen, see `cutoff.choose`.
    methods : What the setup is for; by default `default_methods`.
    """
    if settings is None:
        settings = recipe_settings(recipe, record[:train])
    if methods is None:
        methods = default_methods(record.y_sim is not None)
    found = _choice(record, train, settings.warmup, (cutoff, order, downsampling), methods)
    setup = Setup(train, settings, found.cutoff, found.order, found.downsampling, choice=found)
    return setup if recipe == "paper" else replace(setup, hidden_high=32, hidden_low=16)


def _choice(
    record: Trajectory,
    train: int,
    warmup: int,
    decided: tuple[float | None, int | None, int | None],
    methods: Sequence[str],
) -> Choice:
    """Of the filter pair: for hybrid models, if there are any and the simulator helps."""
    y, rate = record[:train].y, record.sampling_rate
    learned = choose(y, rate, warmup, *decided)
    hybrid = any(method in HYBRIDS for method in methods)
    if record.y_sim is None or not hybrid:
        return learned
    calibrated = any(CALIBRATED in method for method in methods)
    seen = prepared("simulator" + CALIBRATED, record, train)[0] if calibrated else record
    found = choose_with_simulator(y, simulated(seen)[:train], rate, warmup, *decided)
    if found.simulator_helps:
        return found
    reason = f"{found.reason}; chosen for networks alone: {learned.reason}"
    return replace(learned, reason=reason, simulator_helps=False)
