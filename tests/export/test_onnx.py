"""Exported ONNX says what a stream says, as onnxruntime computes it."""

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

import splitband as sb
from tests.streams import rows


def session(path: Path) -> Any:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # it warns that the state is a constant and an input
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def test_onnx_says_what_a_stream_says(
    exported: tuple[sb.Forecaster, sb.Record], tmp_path: Path
) -> None:
    forecaster, record = exported
    step_file, rollout_file = forecaster.export(tmp_path / "rig.onnx")
    stream = forecaster.stream()
    at = rows(record, stream)
    rng = np.random.default_rng(0)
    measured, given, said = [], [], []
    observing = False
    for n in range(150, 240):
        observing ^= bool(rng.random() < 0.1)
        y = record.y[n] if observing else np.full(record.ny, np.nan)
        measured.append(y)
        given.append(at(n))
        if observing:
            stream.observe(y, **at(n))
            said.append(y)
        else:
            said.append(stream.step(**at(n)))
    signals = {"y": np.stack(measured)}
    signals |= {name: np.stack([row[name] for row in given]) for name in given[0]}
    if "y_sim" in signals:
        signals["y_sim"] = signals["y_sim"].reshape(len(said), -1, record.ny)
    free = np.isnan(signals["y"]).any(axis=1)

    _, predicted, ready = session(rollout_file).run(None, signals)
    scale = np.std(record.y)
    assert ready[free].all()
    assert np.abs(predicted - np.stack(said))[free].max() < 1e-9 * scale

    step, state = session(step_file), None
    for n in range(40):
        row = {name: signal[n] for name, signal in signals.items()}
        state, found, _ = step.run(None, row if state is None else row | {"state": state})
        assert np.allclose(found, predicted[n], rtol=1e-9, atol=1e-9 * scale, equal_nan=True)


def test_the_sampling_time_is_not_rounded_and_units_are_said(tmp_path: Path) -> None:
    sb.Mean().fit(sb.Record(np.arange(10.0), 1 / 3).detrend()).export(tmp_path / "rig.onnx")
    facts = session(tmp_path / "rig.onnx").get_modelmeta().custom_metadata_map
    assert (float(facts["sampling_time"]), facts["units"]) == (1 / 3, "y (minus 4.5)")
