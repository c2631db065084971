"""Forecasters that bring a simulator of their own, on further records and on test records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband import GRU, Bands, Record, TrainingSettings
from tests.signals import Setup
from tests.support import compare

DT, WARMUP = 0.1, 12
SETTINGS = TrainingSettings.paper(40, WARMUP, 1, 16)
SETUP = Setup(160, SETTINGS, Bands(0.6, 1, 2))
pytestmark = pytest.mark.filterwarnings("error")


def slow(time: np.ndarray) -> np.ndarray:
    """By the clock of the record, whatever it shows at its first sample."""
    return np.sin(0.7 * time)


def rig(samples: int, begin: float) -> Record:
    time = begin + DT * np.arange(samples)
    y = slow(time) + 0.2 * np.sin(8 * time)
    return Record(y, DT, start=begin, name=f"from {begin:g}")


def known(record: Record) -> Record:
    """The record with the output of its simulator."""
    assert isinstance(record.start, float)
    return replace(record, y_sim=slow(record.start + DT * np.arange(len(record)))[:, None])


def test_a_test_record_is_simulated_by_its_own_clock() -> None:
    """As if each record had brought its simulator's output."""
    record, tests = rig(160, 3.0), [rig(90, 50.0), rig(300, 3.0)]
    own, brought = (
        [sb.Simulation(simulator), sb.Residual(sb.Simulation(simulator), GRU(3), settings=SETTINGS)]
        for simulator in (sb.Function(slow, start="record"), None)
    )
    found = compare(record, own, SETUP, tests=tests)
    expected = compare(known(record), brought, SETUP, tests=[*map(known, tests)])
    for mine, theirs in zip(own, brought, strict=True):
        for one, other in zip(
            found.fits[mine.name][0].tests, expected.fits[theirs.name][0].tests, strict=True
        ):
            np.testing.assert_allclose(one.y, other.y, atol=1e-6)
    (simulated,) = found.fits[own[0].name]
    assert found.errors(simulated).tests == pytest.approx([0.2 / np.sqrt(2)] * 2, rel=0.1)


def test_further_records_have_the_simulator_at_their_own_times() -> None:
    record, others = rig(160, 0.0), [rig(230, 0.0), rig(120, 77.0)]
    model = sb.Residual(sb.Function(slow, start="record"), GRU(3), settings=SETTINGS)
    found = compare(record, [model], SETUP, others=others, tests=[rig(90, 5.0)])
    alone = model.clone().fit(record, *others)
    test = rig(90, 5.0)
    expected = alone.predict(len(test) - WARMUP, test[:WARMUP], other_record=True).y
    np.testing.assert_allclose(found.fits[model.name][0].tests[0].y, expected, atol=1e-6)


def test_an_export_that_covers_both_days_says_each_of_them() -> None:
    first, second = pd.Timestamp("2024-05-01"), pd.Timestamp("2024-05-02")
    days = np.arange(2 * 86400 // 60) / 60.0
    model = sb.Simulation(sb.Recorded(np.sin(days), 60.0, first))
    record = Record(np.sin(days[:400]), 60.0, start=first)
    test = Record(np.sin(days[1440:1540]), 60.0, start=second)
    found = model.fit(record).predict(88, test[:12], other_record=True)
    np.testing.assert_allclose(found.y[:, 0], np.sin(days[1452:1540]), atol=1e-9)


def test_the_bands_of_a_simulator_of_ones_own_are_chosen_beside_it() -> None:
    """Not those for two networks, which a setup holds where the record brings no simulator."""
    record = rig(200, 0.0)
    model = sb.Filtered(sb.Function(slow, start="record"), GRU(3), settings=SETTINGS)
    chosen = sb.compare(record, 160, [model], seeds=1).model
    alone = model.clone().fit(record[:160])
    assert isinstance(chosen, sb.Filtered)
    assert isinstance(alone, sb.Filtered)
    assert chosen._trained_in == alone._trained_in


@pytest.mark.parametrize("cores", [1, 2])
def test_a_simulator_that_fails_is_a_row_that_says_why(cores: int) -> None:
    """Whatever it is: a lambda could not be sent to another process."""
    broken = sb.Simulation(sb.Function(lambda time: 1 / np.zeros(0)[0] + time, start=0))
    result = compare(rig(200, 3.0), [broken, sb.Mean()], SETUP, cores=cores)
    assert result.recommended == "mean"
    assert "index 0 is out of bounds" in result.require_trial().failed["simulator"]
