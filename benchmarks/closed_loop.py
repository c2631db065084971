"""Models of plants behind a controller: an inverted pendulum, and stable plants.

    python -m benchmarks.closed_loop --run [--tables pole pendulum stable]
    python -m benchmarks.closed_loop

The first command runs what is missing, the second prints the tables of what is there.

- pole: the unstable pole of a pendulum that a controller holds upright, by `Linear()`, from 1000
  samples of the angle, or of angle and rate.
- pendulum: fit 1, 10 and 50 samples ahead from many origins of another record of the loop, and of
  one with another controller: ARX by least squares, `Linear()`, and networks that were trained for
  simulation (windows of 400 samples), or on the usual windows of such a plant.
- stable: simulation fit of another open-loop record, without noise, by models that were trained in
  a closed and in an open loop of the same stable plant.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

import splitband as sb
from benchmarks import claims, clock, page
from benchmarks.claims import Row

FILE = page.OUT / "closed-loop.jsonl"
STEP, SAMPLES, GRAVITY, LENGTH, DAMPING = 0.02, 1000, 9.81, 1.0, 0.3
POLE = float(np.exp(max(np.roots([1, DAMPING, -GRAVITY / LENGTH])) * STEP))
AHEAD, ORIGINS = (1, 10, 50), range(100, SAMPLES - 50, 8)
CONTROLLERS = {"same": (25.0, 6.0), "other": (40.0, 8.0)}
"""Gains of the angle in m/s^2 per rad, and of its change in m/s^2 per rad/s."""
NOISES = {"1 % white": (0.01, 0.0), "20 % white": (0.2, 0.0), "20 % drifting": (0.2, 0.98)}
"""Deviation of the noise as a share of the output's, and the pole of its colour."""
METHODS: dict[str, Callable[[], sb.Forecaster]] = {
    "linear": sb.Linear,
    "state-space": lambda: sb.Single(sb.StateSpace(), settings=sb.TrainingSettings(200, epochs=20)),
    "GRU": lambda: sb.Single(sb.GRU(16), settings=sb.TrainingSettings(200, epochs=20)),
}
SIMULATION = sb.TrainingSettings.of(SAMPLES)
AHEAD_METHODS: dict[str, Callable[[], sb.Forecaster]] = {
    "linear": sb.Linear,
    "state-space": lambda: sb.Single(sb.StateSpace()),
    "state-space, trained for simulation": lambda: sb.Single(sb.StateSpace(), settings=SIMULATION),
    "GRU": lambda: sb.Single(sb.GRU()),
    "GRU, trained for simulation": lambda: sb.Single(sb.GRU(), settings=SIMULATION),
}

Array = npt.NDArray[np.float64]


def pendulum(seed: int, controller: str = "same") -> sb.Record:
    """Return angle and rate of a pendulum on a cart that a controller accelerates to hold it."""
    rng, (p, d) = np.random.default_rng(seed), CONTROLLERS[controller]
    x, before, reference, rows = np.zeros(2), 0.0, 0.0, []

    def rate(x: Array, u: float) -> Array:
        return np.array(
            [x[1], (GRAVITY * np.sin(x[0]) - u * np.cos(x[0])) / LENGTH - DAMPING * x[1]]
        )

    for _ in range(SAMPLES):
        if rng.random() < 0.04:
            reference = rng.uniform(-2, 2)
        y = x + rng.standard_normal(2) * [0.0005, 0.0025]
        u = p * y[0] + d * (y[0] - before) / STEP + reference
        before = y[0]
        rows.append([*y, u])
        for _ in range(4):  # by Heun
            first = rate(x, u)
            x = x + STEP / 8 * (first + rate(x + STEP / 4 * first, u))
    table = np.array(rows)
    return sb.Record(table[:, :2], STEP, u=table[:, 2:], columns=("angle", "rate"))


def plant(
    seed: int, run: int, closed: bool, noise: str = "", scale: float = 0.0, samples: int = 1500
) -> tuple[Array, Array]:
    """Return output and input of a drawn oscillator: in an open loop, or behind a PI controller.

    `scale` : Standard deviation of the output, of which the noise is a share.
    """
    rng, drawn = np.random.default_rng([seed, run]), np.random.default_rng(seed)
    share, colour = NOISES.get(noise, (0.0, 0.0))
    radius, angle, gain = drawn.uniform(0.8, 0.95), drawn.uniform(0.1, 0.4), drawn.uniform(0.3, 1)
    a1, a2 = 2 * radius * np.cos(angle), -(radius**2)
    steps = rng.uniform(-1, 1, samples).repeat(25)[:samples]
    e = scipy.signal.lfilter([np.sqrt(1 - colour**2)], [1, -colour], rng.standard_normal(samples))
    x, y, u, total = np.zeros(samples), np.zeros(samples), np.zeros(samples), 0.0
    for n in range(samples):
        x[n] = a1 * x[n - 1] + a2 * x[n - 2] + (1 - a1 - a2) * u[n - 1]  # 0 before the first sample
        y[n] = x[n] + share * scale * e[n]
        total += 0.05 * (steps[n] - y[n])
        u[n] = gain * (steps[n] - y[n]) + total if closed else steps[n]
    return y[:, None], u[:, None]


def stable(row: Row, _: Path) -> Row:
    """Return the fit of an open-loop simulation by a model of one loop."""
    seed, closed = row["seed"], row["loop"] == "closed"
    scale = float(plant(seed, 0, closed)[0].std())
    y, u = plant(seed, 0, closed, row["noise"], scale)
    model = METHODS[row["method"]]().fit(sb.Record(y, 1.0, u=u), seed=seed)
    y, u = plant(seed, 1, closed=False)
    test = sb.Record(y, 1.0, u=u)
    found = model.predict(len(y) - 50, test[:50], u=u[50:], other_record=True)
    return row | {"fit": float(sb.fit_percent(y[50:], found.y)[0])}


def arx(record: sb.Record, past: int = 4) -> Callable[[Array, Array], Array]:
    """Return forecasts of an ARX model by least squares, from past outputs and inputs to come."""
    y, u, rows = record.y, record.u, range(past, len(record))
    assert u is not None

    def regressors(y: Array, u: Array, n: int) -> Array:
        return np.concatenate([y[n - past : n].ravel(), u[n - past : n].ravel(), [1.0]])

    theta = np.linalg.lstsq(np.stack([regressors(y, u, n) for n in rows]), y[past:], rcond=None)[0]

    def forecast(before: Array, inputs: Array) -> Array:
        whole = np.concatenate([before, np.zeros((len(inputs) - len(before), before.shape[1]))])
        for n in range(len(before), len(inputs)):
            whole[n] = regressors(whole, inputs, n) @ theta
        return whole[len(before) :]

    return forecast


def ahead(row: Row, _: Path) -> Row:
    """Return the fits some samples ahead, of the angle and of the rate, by controller."""
    training = pendulum(row["seed"])
    if row["method"] == "ARX":
        forecast = arx(training)
    else:
        model = AHEAD_METHODS[row["method"]]().fit(training, seed=row["seed"])
    for controller in CONTROLLERS:
        test, made = pendulum(1000 + row["seed"], controller), list[Array]()
        assert test.u is not None
        for at in ORIGINS:
            if row["method"] == "ARX":
                made.append(forecast(test.y[:at], test.u[: at + max(AHEAD)]))
            else:
                u = test.u[at : at + max(AHEAD)]
                made.append(model.predict(max(AHEAD), test[:at], u, other_record=True).y)
        for k in AHEAD:
            truth = np.stack([test.y[at + k - 1] for at in ORIGINS])
            fits = sb.fit_percent(truth, np.stack([y[k - 1] for y in made]))
            row = row | {f"{controller} {k}": [float(fit) for fit in fits]}
    return row


def pole(row: Row, _: Path) -> Row:
    """Return the largest pole that the linear model finds."""
    record = pendulum(row["seed"])
    model = sb.Linear().fit(sb.Record(record.y[:, : row["outputs"]], STEP, u=record.u))
    return row | {"pole": float(abs(model.poles()).max())}


TABLES: dict[str, tuple[Callable[[Row, Path], Row], dict[str, Iterable[Any]]]] = {
    "pole": (pole, {"outputs": (1, 2), "seed": range(50)}),
    "pendulum": (ahead, {"method": ("ARX", *AHEAD_METHODS), "seed": range(5)}),
    "stable": (
        stable,
        {"noise": NOISES, "loop": ("open", "closed"), "method": METHODS, "seed": range(20)},
    ),
}


def middle(fits: Iterable[float]) -> str:
    """Return the median and the range of fits; empty without any."""
    values = [*fits]
    if not values:
        return ""
    least = f"{min(values):.0f}" if min(values) > -1000 else "< -999"
    return f"{np.median(values):.0f} ({least} to {max(values):.0f})"


def of_pendulum(rows: Sequence[Row]) -> str:
    """Return the table of the fits of the angle some samples ahead."""
    lines = []
    for method, controller in product(("ARX", *AHEAD_METHODS), CONTROLLERS):
        some = [r for r in rows if r["table"] == "pendulum" and r["method"] == method]
        fits = [middle(r[f"{controller} {k}"][0] for r in some) for k in AHEAD]
        lines.append([f"{method}; {controller} controller", *fits])
    return page.table(["model", *(f"{k} ahead" for k in AHEAD)], lines)


def of_loops(rows: Sequence[Row]) -> str:
    """Return the table of simulation fits of models from an open and a closed loop."""
    lines = []
    for noise, method in product(NOISES, METHODS):
        some = [r for r in rows if r.get("noise") == noise and r["method"] == method]
        both = [middle(r["fit"] for r in some if r["loop"] == loop) for loop in ("open", "closed")]
        lines.append([f"{noise}, {method}", *both])
    return page.table(["noise, model", "from an open loop", "from a closed loop"], lines)


def of_poles(rows: Sequence[Row]) -> str:
    """Return in a line how far the poles are off, by number of outputs."""
    off = {n: [abs(r["pole"] - POLE) for r in rows if r.get("outputs") == n] for n in (1, 2)}
    said = (f"{n}: {max(each):.4f} in {len(each)} seeds" for n, each in off.items() if each)
    return f"pole {POLE:.4f}, farthest off by number of outputs: {', '.join(said)}"


def main() -> None:
    """Run what is missing, or print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--tables", nargs="+", default=[*TABLES], choices=[*TABLES])
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args()
    warnings.simplefilter("ignore", sb.ExtrapolationWarning)
    for name in given.tables if given.run else ():
        run, axes = TABLES[name]
        rows = [
            {"table": name, **dict(zip(axes, each, strict=True))}
            for each in product(*axes.values())
        ]
        clock.complete(given.out, rows, run)
    rows = claims.read(given.out)
    print(of_poles(rows), of_pendulum(rows), of_loops(rows), sep="\n\n")


if __name__ == "__main__":
    main()
