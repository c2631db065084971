"""An exported trajectory in the low band of a hybrid model: all you have of the simulator is a CSV.

On the command line, the same is
`splitband compare record.csv --simulator simulation.csv --methods filtered-gru,simulator`.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

import splitband as sb

TRAIN, AHEAD = 300, 150

with TemporaryDirectory() as folder:  # two files with a time column and one named "torque"
    time = 0.05 * np.arange(TRAIN + AHEAD)
    exported = 20 + 10 * np.sin(2 * np.pi * 0.3 * time)
    measured = exported + 3 * np.sin(2 * np.pi * 2.5 * time)
    for name, torque in (("record", measured), ("simulation", exported)):
        table = pd.DataFrame({"time": time, "torque": torque})
        table.to_csv(Path(folder) / f"{name}.csv", index=False)
    record = sb.read(Path(folder) / "record.csv")
    simulator = sb.Recorded.of(sb.read(Path(folder) / "simulation.csv"))  # by its time stamps

settings = sb.TrainingSettings(window=60, warmup=20, epochs=150)
bands = sb.Bands(cutoff=1.5, order=1, downsampling=1)
model = sb.Filtered(simulator, sb.GRU(16), bands, settings=settings)
alone = sb.Simulation(simulator)
for name, forecaster in (("simulator", alone), ("hybrid", model)):
    prediction = forecaster.fit(record[:TRAIN], seed=0).predict(AHEAD)
    print(f"{name} RMSE {sb.rmse(record.y[TRAIN:], prediction.y):.3f}")
