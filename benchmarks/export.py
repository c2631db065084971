"""How close exported models stay to `predict` over 10,000 steps, and microseconds a step.

    python -m benchmarks.export [--out docs/benchmarks/export.json]

A record with two inputs and a simulator that is half right; models of the usual sizes, hardly
trained: what is compared is arithmetic. Differences are the largest of a free run, as shares of
the signal's deviation. Times are medians of repetitions on one thread. It needs gcc, FMPy and
onnxruntime.
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
import numpy.typing as npt
import onnxruntime
from fmpy.simulation import instantiate_fmu
from torch import nn

import splitband as sb
from splitband.runtime.files import write_json_lines
from splitband.runtime.threads import one_thread

Array = npt.NDArray[np.float64]
Signals = dict[str, Array]
"""What comes with each sample, the first axis time."""

TRAINING, STEPS, SINGLE_STEPS = 2000, 10_000, 1000
SHORT = sb.Settings(window=200, warmup=50, epochs=2)
BANDS = sb.Bands(0.5, 2, 5)
MODELS: dict[str, Callable[[], sb.Forecaster]] = {
    "GRU": lambda: sb.Single(sb.GRU(64), SHORT),
    "split GRU": lambda: sb.Split(sb.GRU(64), sb.GRU(64), BANDS, settings=SHORT),
    "filtered hybrid, conditioned": lambda: sb.Filtered(
        None, sb.GRU(64), BANDS, conditioned=True, settings=SHORT
    ),
    "ensemble of 3 GRUs": lambda: sb.Ensemble(sb.Single(sb.GRU(64), SHORT), 3),
    "linear": sb.Linear,
}
DRIVER = """
#include "{name}.h"
int run({name}_state *s, int steps, const {real} *u, const {real} *y_sim, {real} *y)
{{
    int failed = 0;
    (void)y_sim;
    for (int n = 0; n < steps; n++) {{
        failed += {name}_step(s, u + 2 * n, {simulated}y + n);
    }}
    return failed;
}}
"""


def record() -> sb.Record:
    """A linear system of two inputs, with a spring that hardens, and a simulator without that."""
    rng = np.random.default_rng(0)
    samples = TRAINING + STEPS + 1
    u = np.repeat(rng.uniform(-1, 1, (samples // 20 + 1, 2)), 20, axis=0)[:samples]
    found = []
    for hardening in (1.0, 0.0):
        x, v, y = 0.0, 0.0, np.zeros(samples)
        for n in range(samples):
            for _ in range(10):
                v += 0.005 * (u[n, 0] + 0.5 * u[n, 1] - 2 * x - 6 * hardening * x**3 - 0.5 * v)
                x += 0.005 * v
            y[n] = x
        found.append(y)
    y = found[0] + 0.01 * rng.normal(size=samples)
    return sb.Record(y, 0.05, u=u, y_sim=found[1], inputs=("force", "valve"))


def fitted(name: str, measured: sb.Record) -> sb.Forecaster:
    """A model whose networks are in double precision."""
    forecaster = MODELS[name]().fit(measured[:TRAINING], seed=0)
    for member in getattr(forecaster, "members", [forecaster]):
        if isinstance(getattr(member, "model", None), nn.Module):
            member.model.double()
    return forecaster


def ahead(forecaster: sb.Forecaster, measured: sb.Record) -> Signals:
    """The inputs after the training part, and the simulator's output where it is needed."""
    assert measured.u is not None
    assert measured.y_sim is not None
    rows = slice(TRAINING, TRAINING + STEPS)
    signals = {"u": measured.u[rows]}
    if forecaster.stream().recursion.simulated:
        signals["y_sim"] = measured.y_sim[rows]
    return signals


def streamed(begun: sb.Stream, signals: Signals) -> Array:
    """The free run of a stream."""
    stream, found = begun.copy(), []
    for n in range(len(signals["u"])):
        found.append(stream.step(**{name: signal[n] for name, signal in signals.items()}))
    return np.stack(found)


def compiled(
    forecaster: sb.Forecaster, signals: Signals, folder: Path, precision: Any
) -> Callable[[], Array]:
    """The free run of exported C, in a loop that is C, too."""
    name = f"rig_{precision}"
    forecaster.export(folder / f"{name}.c", precision)
    simulated = "y_sim + n, " if "y_sim" in signals else ""
    driver = DRIVER.format(name=name, real=precision, simulated=simulated)
    (folder / f"{name}_run.c").write_text(driver)
    sources = [str(folder / f"{name}.c"), str(folder / f"{name}_run.c")]
    library = str(folder / f"{name}.so")
    options = ["-std=c99", "-O2", "-march=native", "-shared", "-fPIC"]
    subprocess.run(["gcc", *options, *sources, "-o", library, "-lm"], check=True)
    program = ctypes.CDLL(library)
    kind = np.float64 if precision == "double" else np.float32
    given = {k: np.ascontiguousarray(v, dtype=kind) for k, v in signals.items()}
    state = ctypes.create_string_buffer(10_000_000)

    def run() -> Array:
        y = np.zeros((len(given["u"]), 1), dtype=kind)
        arrays = [given["u"], given.get("y_sim", y), y]
        getattr(program, f"{name}_init")(state)
        assert not program.run(state, len(y), *(ctypes.c_void_p(a.ctypes.data) for a in arrays))
        return y.astype(np.float64)

    return run


def by_onnxruntime(
    forecaster: sb.Forecaster, signals: Signals, folder: Path, precision: Any
) -> tuple[Callable[[], Array], Callable[[], Array]]:
    """The free run of the graph of a simulation, and of that of a step."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 3
    step, rollout = (
        onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        for file in forecaster.export(folder / f"{precision}.onnx", precision)
    )
    kind = np.float64 if precision == "double" else np.float32
    given = {k: np.ascontiguousarray(v, dtype=kind) for k, v in signals.items()}
    given["y"] = np.full((len(given["u"]), 1), np.nan, dtype=kind)
    if "y_sim" in given:
        given["y_sim"] = given["y_sim"][:, None]

    def whole() -> Array:
        return np.asarray(rollout.run(["predicted"], given)[0], dtype=np.float64)

    def stepwise() -> Array:
        state: dict[str, Any] = {}
        found = []
        for n in range(len(given["u"])):
            row = {name: signal[n] for name, signal in given.items()}
            new, predicted = step.run(["state_out", "predicted"], row | state)
            state = {"state": new}
            found.append(predicted)
        return np.stack(found).astype(np.float64)

    return whole, stepwise


def by_fmpy(forecaster: sb.Forecaster, signals: Signals, folder: Path) -> Array:
    """The free run of an FMU; inputs are set before outputs are read."""
    (file,) = forecaster.export(folder / "rig.fmu")
    description = fmpy.read_model_description(str(file))
    fmu: Any = instantiate_fmu(fmpy.extract(str(file), str(folder / "rig")), description)
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    inputs = np.concatenate([*signals.values()], axis=1)
    references = [*range(1, 1 + inputs.shape[1])]
    found = []
    for n, row in enumerate(inputs):
        fmu.setReal(references, row)
        found.append(fmu.getReal([0]))
        fmu.doStep(0.05 * n, 0.05)
    fmu.terminate()
    fmu.freeInstance()
    return np.array(found)


def microseconds(run: Callable[[], Array], repetitions: int = 5) -> float:
    """The median time of a step, of the processor: other programs do not count."""
    times = []
    for _ in range(repetitions):
        began = time.thread_time()
        steps = len(run())
        times.append((time.thread_time() - began) / steps * 1e6)
    return round(statistics.median(times), 2)


def measured(name: str, of: sb.Record, folder: Path) -> dict[str, Any]:
    """Differences and times of a model."""
    forecaster = fitted(name, of)
    signals = ahead(forecaster, of)
    short = {k: v[:SINGLE_STEPS] for k, v in signals.items()}
    deviation = float(np.std(of.y[:TRAINING]))
    begun = forecaster.stream()
    stream = streamed(begun, signals)

    def off(found: Array) -> float:
        return float(f"{np.abs(found - stream[: len(found)]).max() / deviation:.2g}")

    predicted = forecaster.predict(STEPS, u=signals["u"], y_sim=signals.get("y_sim")).y
    c, single = (compiled(forecaster, s, folder, p)
                 for s, p in ((signals, "double"), (short, "float")))  # fmt: skip
    whole, _ = by_onnxruntime(forecaster, signals, folder, "double")
    single_whole, _ = by_onnxruntime(forecaster, short, folder, "float")
    _, stepwise = by_onnxruntime(forecaster, short, folder, "double")
    return {
        "difference from predict, 10,000 steps": {
            "stream": off(predicted),
        },
        "difference from stream, 10,000 steps": {
            "C, double": off(c()),
            "FMU": off(by_fmpy(forecaster, signals, folder)),
            "ONNX, double": off(whole()),
        },
        "difference from stream, 1,000 steps": {
            "C, float": off(single()),
            "ONNX, float": off(single_whole()),
        },
        "microseconds a step": {
            "stream": microseconds(lambda: streamed(begun, short)),
            "C, double": microseconds(c),
            "C, float": microseconds(single),
            "onnxruntime, step by step": microseconds(stepwise),
            "onnxruntime, a simulation": microseconds(whole),
        },
    }


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/export.json"))
    arguments = parser.parse_args()
    of, facts = record(), {}
    with one_thread(), TemporaryDirectory() as made:
        for i, name in enumerate(MODELS):
            folder = Path(made) / str(i)
            folder.mkdir()
            facts[name] = measured(name, of, folder)
            print(name, facts[name], flush=True)
    write_json_lines(arguments.out, facts)


if __name__ == "__main__":
    main()
