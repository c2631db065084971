"""A cell and a forecaster of one's own go everywhere that built-in ones go."""

from pathlib import Path

import numpy as np
import pytest

import splitband as sb
from examples.own_cell import LSTM
from examples.own_forecaster import Drift

TRAIN, STEPS = 120, 15


def record() -> sb.Record:
    time = 0.1 * np.arange(180)
    noise = np.random.default_rng(0).standard_normal(180)
    return sb.Record(np.sin(0.9 * time) + 0.01 * time + 0.02 * noise, 0.1)


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize(
    "own",
    [
        sb.Single(LSTM(4), sb.TrainingSettings.paper(window=30, warmup=10, epochs=1)),
        Drift(),
    ],
    ids=["a cell", "a forecaster"],
)
def test_it_is_compared_saved_loaded_and_streamed(own: sb.Forecaster, tmp_path: Path) -> None:
    whole = record()
    result = sb.compare(whole, TRAIN, [own, sb.Mean()], seeds=1)
    assert set(result.table.index) == {own.name, "mean"}
    result.report(tmp_path / "page.html")
    assert own.name in (tmp_path / "page.html").read_text(encoding="utf-8")

    model = own.clone().fit(whole[:TRAIN])
    said = model.predict(STEPS, level=0.8)
    assert (said.lower < said.y).all()
    model.save(tmp_path / "model")
    loaded = sb.load(tmp_path / "model")
    again = loaded.predict(STEPS, level=0.8)
    np.testing.assert_array_equal(again.y, said.y)
    np.testing.assert_array_equal(again.lower, said.lower)

    if isinstance(own, Drift):
        with pytest.raises(ValueError, match="drift has no step form"):
            loaded.stream()
        return
    stream = loaded.stream(whole[:TRAIN])
    stepped = np.array([stream.step() for _ in range(STEPS)])
    np.testing.assert_allclose(stepped.reshape(STEPS, 1), said.y, rtol=1e-4, atol=1e-5)
