"""Commands on records with gaps, and on several records."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband import TrainingSettings, read
from splitband.comparison.methods import Sizes
from splitband.forecasters.bands import Bands
from tests.cli.support import QUICK, A, B, assert_fails, call, results, written
from tests.signals import DT, NAN, Setup, rms
from tests.support import compare, simulated, with_own_predictions
from tests.support import load_model as load

GRU_ON = f"--columns a --methods gru {QUICK} --seeds 1 --jobs 1 --out out"

FIT_ON = f"--columns a --method gru {QUICK} --out out"

BAD_ROWS = {*range(5), *range(80, 84), *range(140, 150), *range(160, 166)}

SEEN = np.where(np.isin(np.arange(200), [*BAD_ROWS]), NAN, A)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Records with gaps, and without."""
    found = tmp_path_factory.mktemp("gaps")
    whole = pd.DataFrame({"time": (DT * np.arange(200)).round(9), "a": A, "b": B})
    gappy = whole.copy()
    gappy.loc[:4, "a"] = NAN
    gappy.loc[140:149, "a"] = NAN
    gappy.loc[160:165, "a"] = np.inf
    history = whole.iloc[:60].copy()
    history.loc[52:59, "a"] = NAN
    slow = whole.iloc[:80].assign(time=(2 * DT * np.arange(80)).round(9))
    named, turned = whole.rename(columns={"a": "y", "b": "z"}), whole[["time", "b", "a"]]
    tables = {"whole": whole, "history": history, "slow": slow, "named": named, "turned": turned}
    tables |= {"short": whole[:25], "renamed": whole.rename(columns={"a": "z"})}
    tables |= {"gappy": gappy.drop(index=range(80, 84)), "wide": whole.assign(a=10 * A)}
    tables["ended"] = gappy.iloc[:166].drop(index=range(80, 84))
    for name, table in tables.items():
        table.to_csv(found / f"{name}.csv", index=False)
    return found


@pytest.fixture(autouse=True)
def inside_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.fixture(scope="module")
def compared(folder: Path) -> Path:
    line = f"compare {folder}/gappy.csv --gaps mask --columns a --more {folder}/whole.csv"
    call(f"{line} --methods gru,persistence,mean {QUICK} --seeds 2 --jobs 1", folder / "compared")
    return folder / "compared"


def test_compare_counts_gaps_and_leaves_them_empty_in_the_record_alone(compared: Path) -> None:
    facts, table = results(compared), written(compared / "predictions.csv")
    assert (facts["record"]["samples"], facts["record"]["gaps"]) == (200, len(BAD_ROWS))
    assert facts["arguments"]["gaps"] == "mask"
    np.testing.assert_array_equal(table["a"], SEEN)
    for name, found in facts["methods"].items():
        interval = found["interval"]
        numbers = [found["held_out_rmse"], interval["covers"]]
        assert np.isfinite([*numbers, *interval["first"], *interval["exponent"]]).all()
        from_start, forecast = (table[f"a, {name}, {p}"] for p in ("from start", "forecast"))
        # Warmed up on samples 5 to 14.
        assert np.flatnonzero(np.isfinite(from_start)).tolist() == [*range(15, 200)]
        assert np.flatnonzero(np.isfinite(forecast)).tolist() == [*range(150, 200)]
        median = found["median_of_seeds"]
        for key, predicted in (("total_rmse", from_start), ("forecast_rmse", forecast)):
            error = (SEEN - predicted).dropna().to_numpy()
            reported = found[key][0] if median is None else median[key]
            assert reported == pytest.approx(rms(error))
    assert (table["a, persistence, forecast"].dropna() == A[139]).all()


def test_compare_trains_on_further_records_and_tries_out_with_them(compared: Path) -> None:
    found = results(compared)["methods"]["gru"]
    setup = Setup(
        150,
        TrainingSettings.paper(30, 10, 2),
        bands=Bands(1.0, 1, 2),
        sizes=Sizes(hidden_high=4, hidden_low=3),
    )
    gappy, whole = (read(f"{name}.csv", columns="a", gaps="mask") for name in ("gappy", "whole"))
    result = compare(gappy, ["gru"], setup, seeds=2, others=[whole])
    assert found["total_rmse"] == [result.errors(fit).total for fit in result.fits["gru"]]
    errors = result.require_trial().errors
    assert (found["held_out_rmse"],) == errors["gru"]
    assert errors != compare(gappy, ["gru"], setup, seeds=2).require_trial().errors


def test_fit_and_simulate_go_around_gaps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"fit gappy.csv --gaps mask --columns a,b --method split-gru {QUICK}"
    call(f"{line} --more whole.csv --more ended.csv", tmp_path / "model")
    said = capsys.readouterr().out
    assert "25 of 200 samples are masked" in said
    assert "rows 0 to 4, 80 to 83, 140 to 149, 160 to 165" in said
    found = results(tmp_path / "model")
    assert found["more"] == ["whole.csv", "ended.csv"]
    assert np.isfinite(found["training_rmse"])
    ahead = f"simulate {tmp_path}/model --history history.csv --steps 20"
    call(f"{ahead} --gaps mask", tmp_path / "ahead.csv")
    model, _ = load(tmp_path / "model")
    y = np.stack([A, B], axis=1)[:60]
    y[52:, 0] = NAN  # in the gap of a, it is what the model predicts beside the measured b
    expected = simulated(model, with_own_predictions(model, y, 10)[50:], 20)
    table = written(tmp_path / "ahead.csv")
    np.testing.assert_allclose(table["time"], DT * np.arange(60, 80))
    np.testing.assert_allclose(table[["a", "b"]], expected, rtol=1e-6, atol=1e-7)


HYBRID = f"--columns a --simulator whole.csv --method residual-gru {QUICK} --out out"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (f"compare history.csv {GRU_ON}", ("history.csv", "rows 52 to 59", "--gaps mask")),
        (f"compare gappy.csv --gaps fill {GRU_ON}", ("--gaps", "fill")),
        (f"compare whole.csv --more renamed.csv {GRU_ON}", ("renamed.csv", "'a'", "'z'")),
        (f"compare whole.csv --more slow.csv {GRU_ON}", ("slow.csv", "every 0.1 s", "0.2 s")),
        (f"fit whole.csv --more short.csv {FIT_ON}", ("window", "25 samples", "30")),
        (f"fit whole.csv --more nothing.csv {FIT_ON}", ("--more", "nothing.csv")),
        (
            f"fit whole.csv --more gappy.csv --gaps mask {HYBRID}",
            ("--more-simulator", "gappy.csv has none"),
        ),
        (f"fit whole.csv --more-simulator whole.csv {HYBRID}", ("--more-simulator", "1 for 0")),
    ],
)
def test_what_cannot_be_is_one_line(
    line: str,
    says: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert_fails(line, says, capsys)


def test_each_further_record_has_its_own_simulator(tmp_path: Path) -> None:
    """The network of a residual model learns nothing from simulators that are right."""
    line = f"fit whole.csv --gaps mask --more wide.csv --more gappy.csv {HYBRID}"
    line = line.replace("--out out", "")
    call(f"{line} --more-simulator wide.csv --more-simulator whole.csv", tmp_path / "right")
    call(f"{line} --more-simulator whole.csv --more-simulator wide.csv", tmp_path / "swapped")
    right, swapped = (
        results(tmp_path / name)["final_loss"]["network"] for name in ("right", "swapped")
    )
    assert right < 0.2 * swapped


def test_the_columns_of_further_records_go_by_name(tmp_path: Path) -> None:
    for name in ("whole", "turned"):
        line = f"fit whole.csv --more {name}.csv --method gru {QUICK}"
        call(line, tmp_path / name)
    expected, found = (results(tmp_path / name)["final_loss"] for name in ("whole", "turned"))
    assert found == expected
    # One is called y, as a single column is.
    call("fit named.csv --more named.csv --columns y --method mean", tmp_path / "named")
