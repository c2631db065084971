"""An FMU in the low band of a hybrid model: `python fmu_simulator.py [FILE.fmu]`, of one output."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import splitband as sb
from splitband.simulators import run

SPRING = """from pythonfmu import Fmi2Causality, Fmi2Slave, Real
class Spring(Fmi2Slave):
    def __init__(self, **options):
        super().__init__(**options)
        self.x, self.v = 1.0, 0.0
        self.register_variable(Real("x", causality=Fmi2Causality.output))
    def do_step(self, time, step):
        for _ in range(20):  # steps of its own, so that the communication step hardly matters
            self.v -= step / 20 * 2 * self.x
            self.x += step / 20 * self.v
        return True"""
with TemporaryDirectory() as folder:
    path = Path(*sys.argv[1:] or [folder, "Spring.fmu"])
    if not sys.argv[1:]:
        from pythonfmu.builder import FmuBuilder  # only to have an FMU

        Path(folder, "spring.py").write_text(SPRING)
        FmuBuilder.build_FMU(f"{folder}/spring.py", path)
    with sb.Fmu(path) as fmu:
        # The record is made up: the FMU's motion and a vibration that it does not know.
        motion = run(fmu, samples=450, sampling_time=0.05)
        record = sb.Record(motion[:, 0] + 0.3 * np.sin(0.8 * np.arange(450)), 0.05)
        settings = sb.TrainingSettings(window=60, warmup=20, epochs=150)
        model = sb.Filtered(fmu, sb.GRU(16), sb.Bands(1.5, 1, 1), settings=settings)
        hybrid = model.fit(record[:300], seed=0).predict(150)
print(f"simulator RMSE {sb.rmse(record.y[300:], motion[300:]):.3f}")
print(f"hybrid RMSE {sb.rmse(record.y[300:], hybrid.y):.3f}")
