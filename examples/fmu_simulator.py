"""An FMU in the low band of a hybrid model: `python fmu_simulator.py [FILE.fmu]`, of one output."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from splitband import GRU, ComplementaryPair, Settings, Trajectory
from splitband.filters import butterworth
from splitband.metrics import rmse
from splitband.models import Filtered
from splitband.simulators import Fmu, run
from splitband.training import fit

SPRING = """from pythonfmu import Fmi2Causality, Fmi2Slave, Real
class Spring(Fmi2Slave):
    def __init__(self, **options):
        super().__init__(**options)
        self.x, self.v = 1.0, 0.0
        self.register_variable(Real("x", causality=Fmi2Causality.output))
    def do_step(self, time, step):
        self.v, self.x = self.v - step * 2 * self.x, self.x + step * (self.v - step * 2 * self.x)
        return True"""
with TemporaryDirectory() as folder:
    path = Path(*sys.argv[1:] or [folder, "Spring.fmu"])
    if not sys.argv[1:]:
        from pythonfmu.builder import FmuBuilder  # only to have an FMU

        Path(folder, "spring.py").write_text(SPRING)
        FmuBuilder.build_FMU(f"{folder}/spring.py", path)
    with Fmu(path) as fmu:
        y_sim = run(fmu, samples=450, sampling_time=0.05)
# The record is made up: the simulator's motion and a vibration that it does not know.
record = Trajectory(y_sim[:, 0] + 0.3 * np.sin(0.8 * np.arange(450)), 0.05, y_sim=y_sim)
torch.manual_seed(0)
pair = ComplementaryPair.perfect(*butterworth(1.5, record.sampling_rate), record.sampling_rate)
model = Filtered(GRU(hidden_size=16), pair)
fit(model, record[:300], Settings(window=60, warmup=20, epochs=150, learning_rate=0.01))
y, hybrid = record.y[300:], model.simulate(record.y[280:300], 150, y_sim=y_sim[280:])
print(f"simulator RMSE {rmse(y, y_sim[300:]):.3f}\nhybrid RMSE {rmse(y, hybrid):.3f}")
