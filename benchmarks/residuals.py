"""How often the residual tests reject a linear model of the wrong order, and one of the right.

    python -m benchmarks.residuals

A system of second order with a resonance, driven by filtered noise, is measured with white noise of
a tenth of the output's deviation. Output-error models of order 1 and 2 are fitted to 1,000 or 8,000
samples, and tested on these and on 1,000 others, for 100 seeds. The tests have a level of 99 %. On
other samples the error of the fitted parameters adds to what is by chance: the less, the more
samples were fitted.
"""

from __future__ import annotations

import argparse
from unittest.mock import patch

import numpy as np
from scipy.signal import lfilter

from splitband import Linear, Record
from splitband.forecasters.checking import WARMUP
from splitband.forecasters.residuals import ResidualTests, residual_tests

SEEDS, CHECKED, NOISE = 100, 1000, 0.1
POLES = 0.9 * np.exp(1j * np.array([0.3, -0.3]))


def record(seed: int, samples: int) -> Record:
    """Return a record of the system."""
    rng = np.random.default_rng(seed)
    u = lfilter([1.0], [1.0, -0.8], rng.standard_normal(samples))
    x = lfilter([0.0, 0.2, 0.1], np.real(np.poly(POLES)), u)
    y = x + NOISE * x.std() * rng.standard_normal(samples)
    return Record(y, 0.1, u=u)


def tested(seed: int, order: int, fitted: int) -> tuple[ResidualTests, ResidualTests]:
    """Return the tests of a model of an order: on the samples it was fitted to, and on others."""
    whole = record(seed, fitted + CHECKED)
    with patch("splitband.baselines.channel.ORDERS", (order,)):
        model = Linear().fit(whole[:fitted])
    return _tests(model, whole[:fitted]), _tests(model, whole[fitted:])


def _tests(model: Linear, part: Record) -> ResidualTests:
    y = model.predict(len(part) - WARMUP, part[:WARMUP], other_record=True).y
    assert part.u is not None
    (test,) = residual_tests(part.y[WARMUP:] - y, part.u[WARMUP:], ("y",), ("u",))
    return test


def main() -> None:
    """Print the rates."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for fitted in (1000, 8000):
        for order in (1, 2):
            both = zip(*(tested(seed, order, fitted) for seed in range(SEEDS)), strict=True)
            for what, found in zip(("these", f"{CHECKED} others"), both, strict=True):
                dependent = sum(bool(test.dependent) for test in found)
                colored = sum(not test.white for test in found)
                print(
                    f"order {order} fitted to {fitted} samples, tested on {what}: residuals depend "
                    f"on the input in {dependent}, are not white in {colored} of {SEEDS}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
