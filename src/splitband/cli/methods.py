"""Define `splitband methods`: the methods by name."""

from __future__ import annotations

from rich.table import Table

from splitband.cli import printing
from splitband.comparison.methods import BASES, GREY_BOX, NAMES, QUICK

NETWORKS = "gru", "euler-mlp", "state-space"
COLUMNS = {
    "kind": ("filtered-", "filtered-high-", "residual-"),
    "base": ("(simulator)", *(f"{name}-" for name in (*BASES, GREY_BOX))),
    "network": NETWORKS,
    "options": ("-calibrated", "-conditioned"),
}
"""Parts of the names of hybrids: one of each column, of options any."""
MEANINGS = {
    "filtered-": "the base predicts the low band, and the network the high band",
    "filtered-high-": "the network predicts the low band, and the base the high band",
    "residual-": "the network learns the error of the base",
    "(simulator)": "without another base, the simulator of --simulator",
    "linear-": "a linear model, which needs --inputs",
    f"{GREY_BOX}-": "the simulator with fitted parameters (--simulator and --parameters)",
    "-calibrated": "the gain, offset, delay and clock of --simulator are fitted first",
    "-conditioned": "the network has the prediction of the base as an input",
}


def methods() -> None:
    """List the methods and what each needs.

    Use a network alone for any record, `split-gru` for one with a slow and a fast part, and a
    hybrid for one with a simulator that is roughly right or with a simple slow part. The other
    methods are references to beat. --methods takes names, separated by commas.
    """
    say = printing.console.print
    say(f"networks alone: {', '.join(NETWORKS)}")
    say("networks in two bands: split-gru, split-gru-hp (with a high-pass filter), -conditioned")
    say("\nhybrids: join a part of each column, as in filtered-linear-gru-conditioned")
    table = Table(*COLUMNS)
    table.add_row(*("\n".join(parts) for parts in COLUMNS.values()))
    say(table)
    for part, meaning in MEANINGS.items():
        say(f"{part}: {meaning}")
    table = Table("name", "what it is", "needs")
    for name in QUICK:
        method = NAMES[name]
        needs = method.needs | ({"simulator", "parameters"} if name == GREY_BOX else set())
        table.add_row(name, method.in_words(), ", ".join(f"--{n}" for n in sorted(needs)))
    say("\nwithout a network:")
    say(table)
    printing.as_json({name: method.in_words() for name, method in NAMES.items()})
