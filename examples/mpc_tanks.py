"""Predictive control of two tanks, with a model that is learned from a record and CasADi's Opti.

A pump fills the upper tank, which empties into the lower one, whose level is measured. The
controller plans the pump's voltage for the next 25 samples, applies the first one, measures, and
plans again.
"""

import time

import casadi
import numpy as np

import splitband as sb

STEP, HORIZON = 4.0, 25  # seconds, samples
LEAST, MOST = 0.5, 5.5  # of the pump, in V


class Tanks:
    """Two tanks in a row; `move` runs the pump for a sample and measures the lower level."""

    def __init__(self, seed):
        self.levels, self.random = np.array([3.0, 3.0]), np.random.default_rng(seed)

    def move(self, pump):
        """Run the pump at a voltage for a sample; return the measured level."""
        for _ in range(20):
            out = 0.12 * np.sqrt(self.levels)
            rate = np.array([0.06 * pump - out[0], out[0] - out[1]])
            self.levels = np.clip(self.levels + STEP / 20 * rate, 0.01, 10.0)
        return self.levels[1] + self.random.normal(0, 0.02)


def planner(step):
    """Return a function of the state, the target, the pump now and a first guess: the plan."""
    opti = casadi.Opti()
    start, target, now = opti.parameter(len(step.state())), opti.parameter(), opti.parameter()
    pump = opti.variable(HORIZON)
    cost, state, before = 0, start, now
    for n in range(HORIZON):
        state, level = step(state, pump[n])
        cost += (level - target) ** 2 + 0.02 * (pump[n] - before) ** 2
        before = pump[n]
    opti.minimize(cost)
    opti.subject_to(opti.bounded(LEAST, pump, MOST))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    return opti.to_function("plan", [start, target, now, pump], [pump])


# A record for identification: the pump steps at random.
rig = Tanks(seed=0)
voltages = np.repeat(rig.random.uniform(1, 5, 50), 20)
levels = np.array([rig.move(v) for v in voltages])
record = sb.Record(levels, STEP, u=voltages, columns=("level",), inputs=("pump",))

settings = sb.TrainingSettings(window=100, warmup=20, epochs=60)
model = sb.Single(sb.StateSpace(3, 8), settings).fit(record[:800], seed=0)
ahead = model.predict(200, u=record.u[800:])
print(f"model fit {sb.fit_percent(record.y[800:], ahead.y)[0]:.1f} %")

step = sb.casadi_step(model, record)
plan = planner(step)
targets = np.repeat([3.0, 5.0, 2.0], 60)
pump, guess, controlled, applied, seconds = voltages[-1], np.full(HORIZON, 3.0), [], [], []
for target in targets:
    began = time.perf_counter()
    guess = plan(step.state(), target, pump, guess).full().ravel()
    seconds.append(time.perf_counter() - began)
    pump = float(np.clip(guess[0], LEAST, MOST))
    guess = np.append(guess[1:], guess[-1])
    level = rig.move(pump)
    step.stream.observe(level, pump)
    controlled.append(level)
    applied.append(pump)

settled = np.arange(len(targets)) % 60 >= 30
error = (np.array(controlled) - targets)[settled]
print(f"distance from the target, settled {np.sqrt(np.mean(error**2)):.3f}")
print(f"pump from {min(applied):.2f} V to {max(applied):.2f} V")
print(f"a plan takes {1000 * np.median(seconds):.1f} ms")
