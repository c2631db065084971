"""Forecasters of each kind that is exported."""

import pytest

import splitband as sb
from tests.streams import fitted

KINDS = (
    "persistence", "linear", "rnn", "state-space", "split, conditioned, +HP", "filtered",
    "residual of linear", "ensemble", "seasonal-naive, no inputs", "periodic, no inputs",
    "split, conditioned, no inputs", "filtered, no inputs", "filtered high",
    "filtered high at one rate", "filtered high, no inputs",
)  # fmt: skip


@pytest.fixture(params=KINDS)
def exported(request: pytest.FixtureRequest) -> tuple[sb.Forecaster, sb.Record]:
    """A fitted forecaster and its record."""
    return fitted(request.param)
