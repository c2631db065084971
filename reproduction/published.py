"""What the paper reports: each number once, with its table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Value:
    """A mean and, in brackets in the paper, a standard deviation over five seeds."""

    mean: float
    std: float | None = None

    def __str__(self) -> str:
        return f"{self.mean:g}" + ("" if self.std is None else f" ({self.std:g})")


Row = Mapping[str, Value]

LEARNING_BASED: dict[str, Row] = {
    "i": {
        "gru": Value(0.587, 0.002),
        "split-gru": Value(0.127, 0.008),
        "split-gru-hp": Value(0.168, 0.03),
    },
    "ii": {
        "gru": Value(1.124, 0.485),
        "split-gru": Value(0.331, 0.065),
        "split-gru-hp": Value(0.318, 0.089),
    },
    "iii": {
        "gru": Value(0.287, 0.15),
        "split-gru": Value(0.159, 0.051),
        "split-gru-hp": Value(0.13, 0.02),
    },
    "iv": {
        "gru": Value(0.262, 0.17),
        "split-gru": Value(0.201, 0.07),
        "split-gru-hp": Value(0.18, 0.06),
    },
}
"""Table 1: total RMSE of systems (i) to (iv)."""

HYBRID_RNN: dict[str, Row] = {
    "v": {
        "rnn": Value(1.29, 0.63),
        "residual-rnn": Value(0.417, 0.03),
        "simulator": Value(0.418),
        "filtered-rnn": Value(0.347, 0.041),
    },
    "vi": {
        "rnn": Value(1.1, 1.26),
        "residual-rnn": Value(3.60, 1.62),
        "simulator": Value(0.729),
        "filtered-rnn": Value(0.487, 0.381),
    },
}
"""Table 2: total RMSE of systems (v) and (vi) with the RNN."""

HYBRID_GRU: dict[str, Row] = {
    "v": {
        "gru": Value(0.463, 0.305),
        "residual-gru": Value(0.476, 0.096),
        "simulator": Value(0.418),
        "filtered-gru": Value(0.387, 0.026),
    },
    "vi": {
        "gru": Value(1.140, 0.258),
        "residual-gru": Value(0.681, 0.055),
        "simulator": Value(0.729),
        "filtered-gru": Value(0.765, 0.008),
    },
}
"""Table 3: total RMSE of systems (v) and (vi) with the GRU."""

CUTOFF: dict[float, Row] = {
    0.2: {"split-gru": Value(0.149, 0.022), "split-gru-hp": Value(0.227, 0.043)},
    0.4: {"split-gru": Value(0.112, 0.025), "split-gru-hp": Value(0.116, 0.03)},
    0.5: {"split-gru": Value(0.204, 0.022), "split-gru-hp": Value(0.195, 0.028)},
}
"""Ablation of the cut-off w on system (i); the caption says k = 2, the row 0.4 is that of k = 5."""

DOWNSAMPLING: dict[int, Row] = {
    2: {"split-gru": Value(0.12, 0.008), "split-gru-hp": Value(0.168, 0.03)},
    5: {"split-gru": Value(0.112, 0.025), "split-gru-hp": Value(0.116, 0.03)},
    10: {"split-gru": Value(0.185, 0.023), "split-gru-hp": Value(0.187, 0.017)},
}
"""Ablation of the down-sampling k on system (i); the text says 3, 4 and 10."""

_SECONDS = {
    "i": {"gru": 535, "split-gru": 233, "split-gru-hp": 234},
    "ii": {"gru": 1017, "split-gru": 1436, "split-gru-hp": 1439},
    "iii": {"gru": 497, "split-gru": 703, "split-gru-hp": 699},
    "iv": {"gru": 496, "split-gru": 702, "split-gru-hp": 705},
}
_SECONDS_RNN = {  # printed there as systems (iii) and (iv)
    "v": {"rnn": 1414, "residual-rnn": 963, "filtered-rnn": 1867},
    "vi": {"rnn": 2161, "residual-rnn": 2913, "filtered-rnn": 4283},
}
_SECONDS_GRU = {
    "v": {"gru": 2071, "residual-gru": 2263, "filtered-gru": 5105},
    "vi": {"gru": 3831, "residual-gru": 3781, "filtered-gru": 6797},
}


def _values(table: Mapping[str, Mapping[str, float]]) -> dict[str, Row]:
    return {
        system: {method: Value(seconds) for method, seconds in row.items()}
        for system, row in table.items()
    }


SECONDS = _values(_SECONDS)
SECONDS_RNN = _values(_SECONDS_RNN)
SECONDS_GRU = _values(_SECONDS_GRU)
"""The three run-time tables of the supplement."""
