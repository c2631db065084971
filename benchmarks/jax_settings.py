"""How jax-sysid is trained on the benchmarks; see `jax_peer`, which runs elsewhere."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Setting:
    """How jax-sysid is trained on one of the benchmarks.

    Attributes
    ----------
    states, units : Of the model; as many units in f as in g.
    l2 : `rho_th`.
    adam : Iterations of Adam before L-BFGS.
    linear : Samples that the linear model is fitted to.
    """

    states: int
    units: int
    l2: float
    adam: int
    linear: int


SETTINGS = {
    "silverbox": Setting(4, 10, 1e-8, 0, 10_000),
    "tanks": Setting(4, 8, 1e-3, 1000, 1024),
    "Wiener-Hammerstein": Setting(6, 10, 1e-8, 0, 10_000),
}
