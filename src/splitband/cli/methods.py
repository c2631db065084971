"""`splitband methods`: what there is to choose from, grouped and explained."""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table
from rich.text import Text

from splitband.cli import showing
from splitband.forecasters.names import (
    BASED,
    BASES,
    CALIBRATED,
    CONDITIONED,
    HYBRIDS,
    NAMES,
    TRAINED,
    named,
)
from splitband.forecasters.names import base as name_without_suffixes


@dataclass(frozen=True)
class Group:
    """Methods of one kind.

    Attributes
    ----------
    title, when : What they are, and for which record they are worth trying.
    names : Of the methods, in the order in which they are shown.
    """

    title: str
    when: str
    names: tuple[str, ...]


_SPLIT = tuple(name for name in TRAINED if name.startswith("split-"))
_SINGLE = tuple(name for name in TRAINED if name not in {*_SPLIT, *HYBRIDS, *BASED})
_SIMULATORS = tuple(name for name in NAMES if name.startswith("simulator"))
_BASELINES = tuple(name for name in NAMES if name not in {*TRAINED, *_SIMULATORS})
GROUPS = (
    Group("one network", "any record; with known inputs often enough", _SINGLE),
    Group("two networks, a band each", "a record with a slow and a fast part", _SPLIT),
    Group("a simulator and a network", "a simulator that is right in the large", HYBRIDS),
    Group(
        "a fitted model and a network",
        "a record with a simple slow part, no simulator",
        BASED,
    ),
    Group("the simulator itself", "seeing what a network adds to it", _SIMULATORS),
    Group("simple baselines", "every record: what learning has to be better than", _BASELINES),
)
_ABOUT = {
    "gru": "a GRU",
    "rnn": "an MLP that adds to its state, the paper's RNN",
    "split-gru": "a GRU for the slow band at a lower rate, another for the fast band",
    "split-gru-hp": "the same, the fast one's output high-passed (the paper's +HP)",
    "filtered-gru": "the simulator's low band and a GRU's high band",
    "filtered-rnn": "the simulator's low band and the paper's RNN's high band",
    "residual-gru": "a GRU added to the simulator, no filters",
    "residual-rnn": "the paper's RNN added to the simulator, no filters",
    "simulator": "as it comes",
    "simulator-affine": "with offset and gain",
    "simulator-calibrated": "with offset, gain and clock, where each pays",
    "mean": "of the training samples",
    "persistence": "the last measured sample, held",
    "seasonal-naive": "the last period, repeated, with a trend where that pays",
    "harmonic": "a sum of sinusoids, decaying ones among them",
    "periodic": "the harmonics of one period",
    "linear": "a linear model of the inputs (output error)",
} | {
    f"{kind}-{base}-gru": f"{what} {base} model"
    for kind, what in (
        ("filtered", "a GRU's high band and the low band of a fitted"),
        ("residual", "a GRU added to a fitted"),
    )
    for base in BASES
}


def methods() -> None:
    """List the methods, what each is and when it is worth trying.

    A name that ends in -calibrated has its simulator calibrated first (offset, gain, clock); in one
    that ends in -conditioned the faster network is told what the slower part says. Give names to
    --methods, separated by commas.
    """
    table = Table(show_lines=False)
    for heading in ("method", "what it is", "also as", "needs"):
        table.add_column(heading)
    for group in GROUPS:
        table.add_section()
        table.add_row(Text(group.title, "bold"), Text(f"for {group.when}", "italic"))
        for name in group.names:
            if name in _ABOUT or name == name_without_suffixes(name):
                table.add_row(f"  {name}", _about(name), _variants(name), _needs(name))
    showing.console.print(table)
    showing.as_json({group.title: {name: _about(name) for name in group.names} for group in GROUPS})


def _about(name: str) -> str:
    """What a method is, its variants included."""
    base = name if name in _ABOUT else name_without_suffixes(name)
    return _ABOUT.get(base, "") + "".join(
        f"; {said}"
        for suffix, said in ((CALIBRATED, "simulator calibrated"), (CONDITIONED, "conditioned"))
        if suffix in name.removeprefix(base)
    )


def _variants(name: str) -> str:
    """The suffixes under which there is another variant of a method."""
    if name.startswith("simulator"):
        return ""
    suffixes = (CALIBRATED, CONDITIONED, CALIBRATED + CONDITIONED)
    return ", ".join(suffix for suffix in suffixes if name + suffix in NAMES)


def _needs(name: str) -> str:
    return ", ".join(f"--{need}" for need in sorted(named(name).needs))
