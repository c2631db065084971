"""Filters: ours, forward and backward, against SciPy's forward pass.

    python -m benchmarks.filters [--out FILE.json]

Times are medians of interleaved repeats in one run on one thread; read the ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import scipy
import torch
from torch import Tensor

from benchmarks.timing import circumstances, medians, write
from splitband.filters import ComplementaryPair


def case(batch: int, samples: int, repeats: int) -> dict[str, float]:
    """Seconds and ratios for one shape, order 1."""
    zero_phase = ComplementaryPair.butterworth(1.0, 10.0)
    one_way = ComplementaryPair.butterworth(1.0, 10.0, zero_phase=False)
    x = torch.randn(batch, samples, 1)
    leaf = x.clone().requires_grad_()
    array = x[..., 0].double().numpy()
    b, a = one_way.b_low, one_way.a

    def both(filtered: Callable[[], Tensor]) -> Callable[[], None]:
        def call() -> None:
            leaf.grad = None
            filtered().sum().backward()

        return call

    first = x[:, :1]
    found = medians(
        {
            "SciPy filtfilt, forward": lambda: scipy.signal.filtfilt(b, a, array),
            "zero-phase, forward and backward": both(lambda: zero_phase.lowpass(leaf)),
            "SciPy lfilter, forward": lambda: scipy.signal.lfilter(b, a, array),
            "one way, forward and backward": both(lambda: one_way.lowpass(leaf)),
            "joint, forward and backward": both(
                lambda: one_way.combine(low=x, high=leaf, first=first)
            ),
        },
        repeats,
    )
    scipy_zero, scipy_one = found["SciPy filtfilt, forward"], found["SciPy lfilter, forward"]
    ratios = {
        "zero-phase / SciPy filtfilt": found["zero-phase, forward and backward"] / scipy_zero,
        "one way / SciPy lfilter": found["one way, forward and backward"] / scipy_one,
        "joint / two SciPy lfilters": found["joint, forward and backward"] / scipy_one / 2,
    }
    return found | ratios


def main() -> None:
    """Print and, if asked to, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    figures = circumstances("torch", "numba", "scipy")
    for batch, samples, repeats in ((50, 1500, 30), (1, 1_000_000, 5)):
        found = case(batch, samples, repeats)
        figures[f"({batch}, {samples})"] = found
        print(f"batch {batch}, {samples} samples, float32, order 1")
        for name, value in found.items():
            print(
                f"  {name:45s} {value:8.2f}x"
                if "/" in name
                else f"  {name:45s} {1e3 * value:8.3f} ms"
            )
    write(figures, arguments.out)


if __name__ == "__main__":
    main()
