"""A whole training run: split GRU on system (i) at the paper's settings, kernels against the loop.

python -m benchmarks.system_i [--out FILE.json] [--epochs 300]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from unittest import mock

from benchmarks.timing import circumstances, threads, write
from reproduction import published
from reproduction.settings import LEARNING_BASED
from splitband.networks import GRU
from splitband.records.named import double_mass_spring


def seconds(epochs: int) -> float:
    """Of the fit of both networks."""
    record = double_mass_spring()
    setup = LEARNING_BASED["i"].setup(record.sampling_rate, "split-gru")
    short = replace(setup, settings=replace(setup.settings, epochs=epochs))
    fitted = short.forecaster("split-gru").fit(record[: short.train])
    return fitted.require_fitted().report.seconds


def main() -> None:
    """Print and, if asked to, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    parser.add_argument("--epochs", type=int, default=300)
    arguments = parser.parse_args()
    figures = circumstances("torch", "numba", "numpy")
    for count in (1, 2):
        with threads(count):
            seconds(1)  # kernels are loaded
            with mock.patch.object(GRU, "fusable", return_value=False):
                loop = seconds(arguments.epochs)
            kernels = seconds(arguments.epochs)
        figures[f"{count} threads"] = {
            "kernels, s": kernels,
            "plain loop, s": loop,
            "ratio": loop / kernels,
        }
        print(
            f"system (i), split GRU, {arguments.epochs} epochs, {count} thread(s): "
            f"kernels {kernels:.1f} s, plain loop {loop:.1f} s ({loop / kernels:.1f} times), "
            f"the paper {published.SECONDS['i']['split-gru'].mean:.0f} s"
        )
    write(figures, arguments.out)


if __name__ == "__main__":
    main()
