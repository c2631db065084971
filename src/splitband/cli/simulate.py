"""`splitband simulate`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from splitband.baselines.delays import delayed
from splitband.cli import devices, records, showing
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Device
from splitband.cli.options.records import FutureInputs, GapsOption, TimeColumn
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.simulators import Trained, opened_simulator, simulated_again
from splitband.data import Record
from splitband.data.gaps import Gaps, last_before
from splitband.data.record import described
from splitband.data.timing import from_json, near_sampling
from splitband.forecasters import saving as forecasters
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASED
from splitband.forecasters.prediction import Prediction
from splitband.metrics import leaves_range, leaving
from splitband.models import Hybrid, Model, saving
from splitband.runtime.files import output_folder, replacing
from splitband.simulators.calibration import Calibration

Array = npt.NDArray[np.float64]


@with_groups
def simulate(
    model_dir: Annotated[
        Path, typer.Argument(metavar="MODEL_DIR", help="What `fit` wrote.", show_default=False)
    ],
    history: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="Measured samples up to now, with the columns of the training record; the last "
            "ones warm the model up.",
            show_default=False,
        ),
    ],
    steps: Annotated[
        int, typer.Option(min=1, help="Samples to simulate after them.", show_default=False)
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE.csv", help="Where to write the samples.", show_default=False),
    ],
    simulator: SimulatorOptions,
    future_inputs: FutureInputs = None,
    gaps: GapsOption = "refuse",
    time_column: TimeColumn = None,
    other_run: Annotated[
        bool,
        typer.Option(
            "--other-run",
            help="The history is of another run: its time stamps are not compared with those of "
            "the training record. Refused where a forecast depends on them.",
        ),
    ] = False,
    device: Device = "cpu",
) -> None:
    """Simulate a saved model beyond a measured history.

    A model with a simulator also needs --simulator, which reaches --steps samples beyond the
    history. Where training record and history have time stamps, the model knows how much later the
    history begins: a function or an FMU is run from the beginning of the training record on, and
    periods, trends and a calibrated delay or clock count from there. Otherwise, and with
    --other-run, the history is taken to begin where the training record did. An exported trajectory
    has to cover the warm-up and what follows, by its time stamps. The CSV has a column `time`,
    which goes on with the time stamps of
    the history (without any: seconds after its last sample), and one for each measured channel.
    """
    if out.is_dir():
        raise ValueError(f"--out must be a file, got the folder {out}")
    saved, known = _opened(model_dir)
    past = _history(history, known, time_column, gaps)
    u = records.inputs_ahead(future_inputs, past, steps, time_column)
    doubts: tuple[str, ...] = ()
    with showing.without_warnings():  # warned of below, by the inputs' names
        if isinstance(saved, Model):
            model = devices.model_on_device(saved, device)
            if other_run:
                known.start = past.start
            y = _simulated(model, known, past, steps, u, simulator, time_column)
            beyond = [] if u is None else saved.extrapolations(u)
        else:
            if simulator.simulator is not None:
                opened = opened_simulator(simulator, past, time_column)
                with showing.warnings_as_lines():
                    saved = forecasters.load(model_dir, opened)
            found = devices.on_device(saved, device).predict(steps, past, u, other_record=other_run)
            y, doubts = found.y, found.doubts
            beyond = saved.require_fitted().inputs_beyond(u)
    prediction = Prediction(y, past.grid.after(steps), tuple(known.columns))
    output_folder(out.parent, "--out")
    with replacing(out) as temporary:
        prediction.to_frame().to_csv(temporary, index=False)
    showing.console.print(f"{steps} samples after {history}: {out}")
    left = leaves_range(known.range, y)
    if left is not None:
        showing.console.print(leaving(left))
    showing.warn_of_inputs(beyond, known.inputs)
    for doubt in doubts:
        showing.warn(doubt)
    written = {"model": str(model_dir), "method": known.method, "steps": steps, "file": str(out)}
    showing.as_json(written | {"leaves_range_after": left})


def _opened(folder: Path) -> tuple[Model | Forecaster, _Facts]:
    """What `fit` saved: a model, or where something is fitted besides networks the forecaster."""
    if not (folder / forecasters.FILE).is_file():
        model, facts = saving.load(folder)
        if facts.get("method") not in BASED:
            return model, _Facts(folder, (model.ny, model.nu), facts)
    forecaster, facts = forecasters.load_with_facts(folder)
    record = forecaster.require_fitted().record
    known = _Facts(folder, (record.ny, record.nu), facts)
    known.warmup = max(forecaster.warmup, 1)
    return forecaster, known


def _simulated(
    model: Model,
    known: _Facts,
    past: Record,
    steps: int,
    u: Array | None,
    simulator: SimulatorOptions,
    time_column: str | None,
) -> Array:
    """What a model says of the samples after a history, `(steps, ny)`."""
    start = last_before(past.complete, known.warmup, len(past))
    if start is None:
        raise ValueError(
            f"warmup must fit between the gaps of the first {len(past)} samples, got "
            f"{known.warmup} samples"
        )
    first, since = start - known.warmup, len(past) - start
    y_sim = None
    if isinstance(model, Hybrid):
        if simulator.simulator is None:
            raise ValueError(
                f"--simulator must be given for a hybrid model, this is {known.method}"
            )
        opened = opened_simulator(simulator, past, time_column)
        trained = Trained(known.start, known.calibration)
        y_sim = simulated_again(opened, simulator, past, first, steps, trained)
    if u is not None and past.u is not None:
        u = delayed(np.concatenate([past.u, u]), known.delays)[first:]
    y: Array = model.simulate(past.y[first:start], since + steps, u, y_sim)[since:]
    return y


def _history(file: Path, known: _Facts, time_column: str | None, gaps: Gaps) -> Record:
    """The measured samples up to now, at the model's sampling time."""
    past = records.read_file(
        file,
        f"the model is for {described(known.columns, known.inputs)}",
        columns=known.columns,
        inputs=known.inputs,
        time_column=time_column,
        fallback_sampling_time=known.sampling_time,
        gaps=gaps,
    )
    records.announce(past, str(file))
    if not near_sampling(past.sampling_time, known.sampling_time):
        raise ValueError(
            f"--history must be sampled like the training record, every {known.sampling_time:g} s, "
            f"got every {past.sampling_time:g} s in {file}"
        )
    past = records.like(past, known.sampling_time, str(file))
    if len(past) < known.warmup:
        raise ValueError(
            f"--history must have at least the {known.warmup} samples of the model's warm-up, "
            f"got {len(past)}"
        )
    return replace(past, columns=tuple(known.columns))


class _Facts:
    """What `fit` saved with the model and `simulate` needs."""

    def __init__(self, folder: Path, channels: tuple[int, int], facts: dict[str, Any]) -> None:
        ny, nu = channels
        try:
            self.method = str(facts["method"])
            self.columns = [str(name) for name in facts["columns"]]
            self.inputs = [str(name) for name in facts["inputs"]]
            self.sampling_time = float(facts["sampling_time"])
            self.warmup = int(facts["setup"]["settings"]["warmup"])
            # Models saved by older versions have neither, and are simulated without these checks.
            self.start = from_json(facts.get("start"))
            self.delays = [int(delay) for delay in facts.get("input_delays", [])]
            nothing = [[0.0] * ny] * 2
            self.range = np.array(facts.get("range", nothing), dtype=np.float64)
            self.calibration = Calibration.from_fields(**(facts["calibration"] or {}))
            self.calibration.check(ny)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{folder} was not written by `splitband fit`: {error!r}") from None
        if self.range.shape != (2, ny) or not np.isfinite(self.range).all():
            raise ValueError(f"{folder} is damaged: its range is {facts['range']}")
        if not 0 < self.sampling_time < math.inf:
            raise ValueError(f"{folder} is damaged: its sampling time is {self.sampling_time}")
        if self.warmup < 1:
            raise ValueError(f"{folder} is damaged: its warmup is {self.warmup}")
        if (len(self.columns), len(self.inputs)) != (ny, nu):
            raise ValueError(
                f"{folder} is damaged: its columns {self.columns} and inputs {self.inputs} are not "
                f"the model's {ny} and {nu}"
            )
