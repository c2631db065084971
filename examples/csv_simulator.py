"""An exported trajectory in the low band of a hybrid model: all you have of the simulator is a CSV.

On the command line, the same is
`splitband compare record.csv --simulator simulation.csv --methods filtered-gru,simulator`.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import torch

from splitband import GRU, ComplementaryPair, Settings, read
from splitband.filters import butterworth
from splitband.metrics import rmse
from splitband.models import Filtered
from splitband.simulators import Recorded, run
from splitband.training import fit

TRAIN, WARMUP = 300, 20

with TemporaryDirectory() as folder:  # two files with a time column and one named "torque"
    time = 0.05 * np.arange(450)
    exported = 20 + 10 * np.sin(2 * np.pi * 0.3 * time)
    measured = exported + 3 * np.sin(2 * np.pi * 2.5 * time)
    for name, torque in (("record", measured), ("simulation", exported)):
        table = pd.DataFrame({"time": time, "torque": torque})
        table.to_csv(Path(folder) / f"{name}.csv", index=False)
    record = read(Path(folder) / "record.csv")
    simulator = Recorded.of(read(Path(folder) / "simulation.csv"))

y_sim = run(simulator, len(record), record.sampling_time, start=record.start)  # by time stamps
record = replace(record, y_sim=y_sim)
b, a = butterworth(cutoff=1.5, sampling_rate=record.sampling_rate)
torch.manual_seed(0)
model = Filtered(GRU(hidden_size=16), ComplementaryPair.perfect(b, a, record.sampling_rate))
fit(model, record[:TRAIN], Settings(window=60, warmup=WARMUP, epochs=150, learning_rate=0.01))
y, start = record.y[TRAIN:], TRAIN - WARMUP
hybrid = model.simulate(record.y[start:TRAIN], len(y), y_sim=y_sim[start:])
print(f"simulator RMSE {rmse(y, y_sim[TRAIN:]):.3f}\nhybrid RMSE {rmse(y, hybrid):.3f}")
