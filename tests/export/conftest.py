"""Forecasters of each kind that is exported."""

import pytest

import splitband as sb
from tests.streams import fitted

DRIVEN = "persistence", "linear", "rnn", "state-space", "split, conditioned, +HP", "filtered"
HIGH = "filtered high", "filtered high at one rate"
FREE = "seasonal-naive", "periodic", "split, conditioned", "filtered", "filtered high"
ENDED = [f"{name}, no inputs" for name in FREE]
KINDS = (*DRIVEN, *HIGH, "residual of linear", "ensemble", *ENDED)


@pytest.fixture(params=KINDS)
def exported(request: pytest.FixtureRequest) -> tuple[sb.Forecaster, sb.Record]:
    """A fitted forecaster and its record."""
    return fitted(request.param)
