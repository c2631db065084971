"""How jax-sysid is trained on the public benchmarks; see `jax_peer`, which runs elsewhere."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Setting:
    """How jax-sysid is trained on one of the benchmarks.

    Attributes
    ----------
    states, units : Of the model; as many units in f as in g.
    penalty : `rho_th`.
    adam : Iterations of Adam before L-BFGS.
    linear : Samples that the linear model is fitted to.
    initial : Numbers of samples at the beginning of a test file that its first state is estimated
        from; the error is that of what follows.
    training, tests : Files.
    """

    states: int
    units: int
    penalty: float
    adam: int
    linear: int
    initial: tuple[int, ...]
    training: str
    tests: tuple[str, ...]


SETTINGS = {
    "silverbox": Setting(
        4, 10, 1e-8, 0, 10_000, (50,), "silverbox_train",
        ("silverbox_test_multisine", "silverbox_test_arrow_full",
         "silverbox_test_arrow_no_extrap"),
    ),
    "tanks": Setting(4, 8, 1e-3, 1000, 1024, (50, 5), "ct_train", ("ct_test",)),
}  # fmt: skip
