"""The public benchmarks' files, and what their users have published of them.

The files are not part of the project: `SPLITBAND_DATA_DIR`/benchmarks must hold them.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, replace
from pathlib import Path

from splitband import Record
from splitband.records.reading import read


@dataclass(frozen=True)
class Benchmark:
    """A public benchmark.

    Attributes
    ----------
    title, source : What it is, and who published it.
    training, tests : Files, with the beginning of the SHA-256 of each.
    unit, scale : Of the errors, and how many of it make one of the files' unit.
    columns : What the tests are called in the table.
    published : Errors on the tests, by method.
    initial : Samples of a test file that are known.
    """

    title: str
    source: str
    training: tuple[str, str]
    tests: tuple[tuple[str, str], ...]
    unit: str
    scale: float
    columns: tuple[str, ...]
    published: dict[str, tuple[str, ...]]
    initial: int = 50


_OF_TANKS: dict[str, tuple[str, ...]] = {
    "linear state space (Champneys et al., 2024)": ("0.588",),
    "polynomial NARX (the same)": ("0.413",),
    "GRU, best of 10 restarts of 25 settings (the same)": ("0.396",),
    "LSTM (the same)": ("0.490",),
    "DT-SUBNET": ("0.37",),
    "CT-SUBNET (second-hand)": ("0.31",),
    "PNLSS": ("0.45",),
    "truncated simulation error (Forgione and Piga, 2021)": ("0.33",),
    "grey box and network, well-posed LFR (2026, second-hand)": ("0.25",),
    "grey box, the physics known": ("0.18 to 0.19",),
}
_TSFAST_GRU = "0.31 to 0.33", "1.31 to 1.65", "0.29 to 0.34"
_TANKS = Benchmark(
    "Cascaded tanks, 50 initial samples",
    "measured, 1,024 + 1,024 samples every 4 s; Schoukens and Noël, 2017. The repository of the "
    "loader `nonlinear_benchmarks` gives 50 initial samples",
    ("ct_train", "66617b0c3c764dd2"),
    (("ct_test", "83aaf392ce4df46e"),),
    "V",
    1.0,
    ("test",),
    {"jax-sysid, mean of 11 and of 22 seeds, measured by us": ("0.259 to 0.292",)},
)

SETS = {
    "tanks5": replace(
        _TANKS,
        title="Cascaded tanks, 5 initial samples",
        source="the same records; release 1.0.1 of the loader `nonlinear_benchmarks` gives 5 "
        "initial samples, as in the published scores",
        published=_OF_TANKS | {"jax-sysid, mean of 11 seeds, measured by us": ("0.286",)},
        initial=5,
    ),
    "tanks": _TANKS,
    "silverbox": Benchmark(
        "Silverbox",
        "measured, an electronic oscillator whose spring hardens, 65,062 samples to train on at "
        "610.35 Hz; Wigren and Schoukens, 2013",
        ("silverbox_train", "1ad2d6094a7792c8"),
        (
            ("silverbox_test_multisine", "acaf10ce564df16e"),
            ("silverbox_test_arrow_full", "fd9f8ad9a6a8e833"),
            ("silverbox_test_arrow_no_extrap", "a10814b983b5d7ee"),
        ),
        "mV",
        1000.0,
        ("multisine", "arrow", "arrow without extrapolation"),
        {
            "linear state space (Champneys et al., 2024)": ("6.96", "14.4", "6.58"),
            "polynomial NARX (the same)": ("0.64", "2.25", "0.57"),
            "GRU (the same)": ("1.49", "2.80", "0.95"),
            "LSTM (the same)": ("1.50", "2.68", "0.96"),
            "tsfast's default GRU, 320 s of a sixth of a GPU": _TSFAST_GRU,
            "tsfast's default LSTM, the same": ("0.35 to 0.39", "2.07 to 2.27", "0.30 to 0.34"),
            "DT-SUBNET": ("0.36", "1.4", "0.32"),
            "PNLSS": ("", "0.26", ""),
            "GP-NARX (Champneys et al., 2024)": ("0.301", "0.60", "0.259"),
        },
    ),
}


def load(file: tuple[str, str]) -> Record:
    """A file of the data folder, if it is the published one."""
    name, digest = file
    path = Path(os.environ["SPLITBAND_DATA_DIR"]) / "benchmarks" / f"{name}.csv"
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if not found.startswith(digest):
        raise ValueError(f"{path} must have a SHA-256 of {digest}..., got {found}")
    return replace(read(path, columns=["y"], inputs=["u"]), name=name)
