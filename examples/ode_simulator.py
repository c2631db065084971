"""Your own differential equation in the low band of a hybrid model.

A pendulum swings on a shaking frame. The equation knows the pendulum and not the frame, whose
motion the network has to learn.
"""

import numpy as np

import splitband as sb
from splitband.simulators import run

SAMPLING_TIME, SAMPLES, TRAIN = 0.05, 450, 300

# The simulator: x = (angle, angular velocity), of which the angle is measured.
pendulum = sb.Ode(lambda t, x: [x[1], -4.0 * np.sin(x[0])], [1.0, 0.0], lambda x: x[:, 0])
angle = run(pendulum, SAMPLES, SAMPLING_TIME)

# The record is made up here; `splitband.read("record.csv")` reads a measured one.
frame = 0.3 * np.sin(2 * np.pi * 2.5 * SAMPLING_TIME * np.arange(SAMPLES))
noise = np.random.default_rng(0).normal(0, 0.02, SAMPLES)
record = sb.Record(angle[:, 0] + frame + noise, SAMPLING_TIME)

# Below 1.5 Hz the simulator, above it the network: L(simulator) + H(network) with L + H = 1.
bands = sb.Bands(cutoff=1.5, order=1, downsampling=1)
settings = sb.TrainingSettings(window=60, warmup=20, epochs=150)
model = sb.Filtered(pendulum, sb.GRU(16), bands, settings=settings)
model.fit(record[:TRAIN], seed=0)

# What follows the training samples, simulated from the last of them.
hybrid = model.predict(SAMPLES - TRAIN)
print(f"simulator RMSE {sb.rmse(record.y[TRAIN:], angle[TRAIN:]):.3f}")
print(f"hybrid RMSE {sb.rmse(record.y[TRAIN:], hybrid.y):.3f}")
