"""A record on which training rewards a filtered hybrid that adds nothing, and one on which not."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.signal

import splitband as sb
from splitband import GRU, Bands, Record, TrainingSettings
from splitband.filters.spectrum import oracle
from tests.cli.support import call, results

DT, SAMPLES, CUTOFF, SLOW = 0.1, 200, 1.0, 0.3
QUICK = TrainingSettings.paper(window=30, warmup=10, epochs=1)
TIME = DT * np.arange(SAMPLES)
# Of the low-pass filter at the slow oscillation: a simulator that runs ahead by it is undone.
AHEAD = -np.angle(
    scipy.signal.freqz(*scipy.signal.butter(1, CUTOFF, fs=1 / DT), [SLOW], fs=1 / DT)[1][0]
)


def record(ahead: float) -> Record:
    """A slow oscillation and a fast one; the simulator knows the slow one, with another phase."""
    slow, fast = 2 * np.pi * SLOW * TIME, 2 * np.pi * 2.0 * TIME
    y = np.sin(slow) + 0.05 * np.sin(fast)
    return Record(y[:, None], DT, y_sim=np.sin(slow + ahead)[:, None], name="r")


def fitted(ahead: float, calibrated: bool = False) -> sb.Forecaster:
    base = sb.Calibrated() if calibrated else None
    filtered = sb.Filtered(base, GRU(2), Bands(CUTOFF, 1, 2), settings=QUICK)
    return filtered.fit(record(ahead))


def test_a_simulator_whose_lead_is_the_filters_delay_leaves_nothing_to_learn() -> None:
    """L(simulator) is then nearly the record, and H(record) is what an exact network adds to it."""
    for ahead, trap in ((AHEAD, True), (0.0, False)):
        of = record(ahead)
        found = oracle(of.y, of.y_sim, 1 / DT, CUTOFF)
        assert found.nothing_to_learn == trap
        high = scipy.signal.lfilter(*scipy.signal.butter(1, CUTOFF, "high", fs=1 / DT), of.y[:, 0])
        if trap:
            assert found.perfect_network == pytest.approx(np.sqrt(np.mean(high**2)), rel=0.1)


def test_a_fit_says_that_nothing_is_to_be_learned() -> None:
    (note,) = fitted(AHEAD).require_fitted().report.notes
    assert note.startswith("nothing to learn: ")
    assert note.endswith("calibrating it may change that")
    assert fitted(AHEAD).describe().endswith(f"; {note}")
    for without in (fitted(0.0), fitted(AHEAD, calibrated=True)):
        assert without.require_fitted().report.notes == ()


@pytest.mark.parametrize("trap", [True, False])
def test_the_commands_warn_of_it(
    trap: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    of = record(AHEAD if trap else 0.0)
    for name, values in (("r", of.y), ("simulated", of.y_sim)):
        table = pd.DataFrame({"time": TIME, "y": values[:, 0]})
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    options = f"{tmp_path}/r.csv --simulator {tmp_path}/simulated.csv --cutoff {CUTOFF} --order 1 "
    call(f"inspect {options} --train 150", tmp_path / "inspected")
    said = capsys.readouterr().out
    assert (results(tmp_path / "inspected")["simulator"]["calibrated"] is not None) == trap
    assert ("warning: nothing to learn" in said) == trap
    assert ("there is something to learn" in said) == trap
    quick = "--recipe constant-rate --epochs 1 --hidden 2,2 --window 30 --warmup 10 --jobs 1"
    hybrids = "--train 150 --methods filtered-gru,residual-gru --seeds 1"
    call(f"compare {options} {hybrids} {quick}", tmp_path / "compared")
    said = capsys.readouterr().out
    assert ("(filtered-gru): nothing to learn" in said) == trap
    assert "(residual-gru): nothing" not in said
