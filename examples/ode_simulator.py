"""Your own differential equation in the low band of a hybrid model.

A pendulum swings on a shaking frame. The equation knows the pendulum and not the frame, whose
motion the network has to learn.
"""

import numpy as np
import torch

from splitband import GRU, ComplementaryPair, Settings, Trajectory
from splitband.filters import butterworth
from splitband.metrics import rmse
from splitband.models import Filtered
from splitband.simulators import Ode, run
from splitband.training import fit

SAMPLING_TIME, SAMPLES, TRAIN, WARMUP = 0.05, 450, 300, 20

# The simulator: x = (angle, angular velocity), of which the angle is measured.
pendulum = Ode(lambda t, x: [x[1], -4.0 * np.sin(x[0])], initial_state=[1.0, 0.0])
angle = run(pendulum, SAMPLES, SAMPLING_TIME)

# The record is made up here; `splitband.read("record.csv")` reads a measured one.
frame = 0.3 * np.sin(2 * np.pi * 2.5 * SAMPLING_TIME * np.arange(SAMPLES))
noise = np.random.default_rng(0).normal(0, 0.02, SAMPLES)
record = Trajectory(angle[:, 0] + frame + noise, SAMPLING_TIME, y_sim=angle)

# Below 1.5 Hz the simulator, above it the network: L(simulator) + H(network) with L + H = 1.
b, a = butterworth(cutoff=1.5, sampling_rate=record.sampling_rate)
pair = ComplementaryPair.perfect(b, a, record.sampling_rate)
torch.manual_seed(0)
model = Filtered(GRU(hidden_size=16), pair)
fit(model, record[:TRAIN], Settings(window=60, warmup=WARMUP, epochs=150, learning_rate=0.01))

# What follows the training samples, simulated from the last of them.
y, start = record.y[TRAIN:], TRAIN - WARMUP
hybrid = model.simulate(record.y[start:TRAIN], SAMPLES - TRAIN, y_sim=angle[start:])
print(f"simulator RMSE {rmse(y, angle[TRAIN:]):.3f}")
print(f"hybrid RMSE {rmse(y, hybrid):.3f}")
