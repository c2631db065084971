"""What a forecaster refuses: the argument, the rule and the value are named."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband import GRU, Forecaster, Record
from splitband.comparison.methods import named
from splitband.runtime.arrays import Array
from tests.forecasters.support import (
    DT,
    LENGTH,
    SETUP,
    TRAIN,
    WARMUP,
    fitted,
    record,
)


def plain() -> Record:
    return replace(record(), u=None, y_sim=None, inputs=())


def interrupted() -> Record:
    """Two stretches that are a sample shorter than a warm-up each."""
    known = np.ones((2 * WARMUP - 1, 1), bool)
    known[WARMUP - 1] = False
    return replace(record()[: len(known)], measured=known)


def two_channels() -> Record:
    r = plain()
    return replace(r, y=np.hstack([r.y, r.y]), columns=())


def untyped(value: Any) -> Any:
    """What type checkers would refuse."""
    return value


def mean() -> Forecaster:
    return sb.Mean().fit(plain()[:TRAIN])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sb.Mean().predict(3), "mean must be fitted first"),
        (lambda: sb.Single(GRU(3)).save("nowhere"), "gru must be fitted first"),
        (lambda: sb.Mean().fit(), "records must be one or several, got none"),
        (
            lambda: sb.Filtered(sb.Linear(), GRU(3), untyped(None)),
            r"bands must be Bands, such as Bands\(0.5\) .* got None",
        ),
        (lambda: mean().predict(0), "steps must be at least 1, got 0"),
        (lambda: mean().predict(3, u=np.ones(3)), "u must be left out: the record has no inputs"),
        (lambda: mean().predict(3, two_channels()), r"1 channel\(s\) and 0 .*, got 2 and 0"),
        (
            lambda: fitted("linear").predict(LENGTH),
            r"u must hold the 100 samples to predict in 1",
        ),
        (
            lambda: fitted("simulator").predict(9, u=np.ones(9), y_sim=np.ones(8)),
            r"y_sim must .* got \(8, 1\)",
        ),
        (
            lambda: fitted("simulator").predict(9, u=np.ones(9), y_sim=record().y_sim),
            f"y_sim must hold the 9 samples to predict alone, got the {TRAIN} of the history first",
        ),
        (
            lambda: fitted("simulator").predict(
                9, replace(record()[:TRAIN], y_sim=None), u=np.ones(9)
            ),
            "history must bring a simulator's output",
        ),
        (lambda: sb.Linear().fit(plain()), "linear needs known inputs, the record has none"),
        (lambda: SETUP.forecaster("filtered-gru").fit(plain()), "filtered-gru needs a simulator, "),
        (
            lambda: fitted("residual-euler-mlp").predict(
                5, interrupted()[4:11], np.ones(5), np.ones(5)
            ),
            "history must have 8 samples for residual-euler-mlp to warm up on, .*, got 7",
        ),
        (lambda: mean().predict(5, untyped(record().y)), "history must be a Record, got ndarray"),
        (lambda: sb.Linear().fit(untyped([record()])), "records must be a Record, got list"),
        (lambda: sb.Single(untyped(GRU)), r"an object, such as GRU\(...\), got the class GRU"),
        (lambda: sb.Filtered(sb.Mean(), GRU(3)), "base must say something about the whole record"),
        (lambda: sb.Ensemble(sb.Mean(), 0), "count must be at least 1, got 0"),
        (lambda: sb.Ensemble(sb.Mean(), seeds=(1, 1)), "seeds must be different numbers from 0 on"),
        (
            lambda: sb.Ensemble.of([mean(), sb.Mean().fit(plain()[10:TRAIN])]),
            "members must be fitted to the same record, got 60 samples of one and 50 of ",
        ),
        (
            lambda: fitted("linear").predict(2, u=[1.0, 2.0], other_record=True),
            "history must be given where other_record is True, got none",
        ),
        (lambda: mean().predict(5, level=1.0), "level must be"),
        (lambda: fitted("linear").predict(2, u=[1.0, np.nan]), "u must hold finite numbers"),
        (
            lambda: fitted("simulator").predict(2, u=[0.0, 0.0], y_sim=[1.0, np.nan]),
            "y_sim must hold finite numbers",
        ),
        (lambda: named("mena"), r"methods must be .*, got 'mena' \(did you mean mean\?\)"),
    ],
)
def test_errors_say_what_is_wrong(call: Callable[[], Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        call()


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"columns": ("b", "a")}, "columns of history must be in the order .* a, b, got b, a"),
        ({"inputs": ("w", "v")}, "inputs of history must be in the order .* v, w, got w, v"),
        ({"sampling_time": 0.2}, "history must be sampled like the training record, every 0.1 s"),
    ],
)
def test_a_history_has_the_channels_of_the_training_record(
    other: dict[str, Any], message: str
) -> None:
    values = np.random.default_rng(1).standard_normal((60, 2))
    known = Record(values, DT, values, columns=("a", "b"), inputs=("v", "w"))
    model = sb.Linear().fit(known)
    with pytest.raises(ValueError, match=message):
        model.predict(5, replace(known, **other), u=values[:5])


def test_the_time_since_the_training_record_asks_for_its_sampling() -> None:
    """A two-hundredth is off by five samples after a thousand."""
    t: Array = DT * np.arange(1000, dtype=np.float64)
    harmonic = sb.Harmonic().fit(Record(np.sin(t), DT))
    with pytest.raises(ValueError, match=r"for harmonic, .* every 0.1 s, got every 0.1005 s"):
        harmonic.predict(5, Record(np.sin(1.005 * t), 1.005 * DT))
    assert sb.Mean().fit(Record(np.sin(t), DT)).predict(5, Record(np.sin(t), 1.005 * DT))


def two_inputs() -> Record:
    u = np.random.default_rng(2).normal([1.0, 2.0], size=(80, 2))
    y = np.convolve(u @ [1.0, -0.3], 0.5 ** np.arange(9))[:80]
    return Record(y, DT, u, inputs=("a", "b"), start=0.0)


def test_inputs_of_another_shape_are_refused() -> None:
    known = two_inputs()
    ahead, model = known.u[60:70], sb.Linear().fit(known[:60])
    for wrong in (ahead.T, ahead.ravel(), ahead.reshape(-1, 1)):
        with pytest.raises(ValueError, match=r"u must hold the 10 samples .* in 2 channel\(s\), "):
            model.predict(10, known[:60], u=wrong)
    with pytest.raises(ValueError, match="alone, got the 60 of the history first"):
        model.predict(10, known[:60], u=known.u[:70])


def test_the_columns_of_a_table_are_found_by_their_names() -> None:
    known = two_inputs()
    model, ahead = sb.Linear().fit(known[:60]), pd.DataFrame(known.u, columns=["a", "b"])[60:70]
    expected = model.predict(10, u=ahead.to_numpy()).y
    for history in (None, known[:60], replace(known[:60], inputs=())):
        for table in (ahead, ahead[["b", "a"]], ahead.set_axis([0, 1], axis=1)):
            np.testing.assert_array_equal(model.predict(10, history, u=table).y, expected)
    with pytest.raises(ValueError, match="u must have the columns a, b, got a, c"):
        model.predict(10, u=ahead.rename(columns={"b": "c"}))
    with pytest.raises(ValueError, match="u must be left out"):
        mean().predict(10, u=ahead)


@pytest.mark.parametrize(
    ("argument", "call", "values"),
    [
        ("steps", lambda n: mean().predict(n), [3.0, "3", None, float("nan"), True]),
        ("seed", lambda n: sb.Mean().fit(record()[:30], seed=n), [None]),
        ("count", lambda n: sb.Ensemble(sb.Mean(), n), ["3"]),
        ("seeds", lambda n: sb.Ensemble(sb.Mean(), seeds=[0, n]), [True]),
        ("hidden_size", GRU, [float("nan")]),
        ("window", lambda n: sb.TrainingSettings.paper(window=n), [3.0]),
        ("order", lambda n: sb.Bands(order=n), ["3"]),
        ("train", lambda n: sb.compare(record(), n, [sb.Mean()]), [True]),
        ("seeds", lambda n: sb.compare(record(), 30, [sb.Mean()], seeds=n), [3.0]),
    ],
)
def test_what_must_be_a_whole_number_is_named(
    argument: str, call: Callable[[Any], Any], values: list[Any]
) -> None:
    for value in values:
        with pytest.raises(ValueError, match=f"^{argument} must be a whole number, got "):
            call(value)


def test_a_whole_number_of_numpy_is_one(tmp_path: Path) -> None:
    three = np.int64(3)
    assert len(mean().predict(three).y) == 3  # type: ignore[arg-type]
    settings = sb.TrainingSettings.paper(window=np.int64(20), warmup=three, epochs=1)  # type: ignore[arg-type]
    model = sb.Single(GRU(three), settings).fit(record()[:TRAIN], seed=three)  # type: ignore[arg-type]
    model.save(tmp_path)
    u = np.ones(3)
    np.testing.assert_array_equal(sb.load(tmp_path).predict(3, u=u).y, model.predict(3, u=u).y)
