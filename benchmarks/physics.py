"""Parameters of simulators: the crane, the two tanks, a pendulum, and a model without its friction.

`python -m benchmarks.physics [--only crane]` writes docs/benchmarks/physics.json. The
tanks are read from SPLITBAND_DATA_DIR.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import splitband as sb
from splitband.data.crane import DAMPING, DRAG, DRIVE_LAG, GRAVITY, STEP, overhead_crane
from splitband.simulators import Effort

OUT = Path("docs/benchmarks/physics.json")
SEEDS = 20
STIFF, DAMPED, DRY = 64.2, 0.055, 0.2
ROUND = 0.05


def crane_rhs(t: float, x: Any, u: Any, p: Any) -> list[float]:
    """The demo's crane; the rope is `p.rope` times as long as its winch says."""
    acceleration = (u[0] - x[1]) / p.lag
    torque = -GRAVITY * np.sin(x[2]) - acceleration * np.cos(x[2])
    length = p.rope * u[1]
    swing = (torque - 2 * p.rope * u[2] * x[3]) / length
    return [x[1], acceleration, x[3], swing - p.damping * x[3] - DRAG * x[3] * abs(x[3])]


def crane(seed: int) -> tuple[sb.Record, sb.Ode]:
    """A record whose inputs include the speed of the winch, and the equation."""
    record = overhead_crane(seed=seed)
    assert record.u is not None
    u = np.column_stack([record.u, np.gradient(record.u[:, 1], STEP)])
    inputs = (*record.inputs, "hoisting [m/s]")
    record = replace(record, u=u, inputs=inputs, y_sim=None)

    def load(x: Any, u: Any, p: Any) -> Any:
        return x[:, 0] + p.rope * u[:, 1] * np.sin(x[:, 2])

    ranges = {"lag": (0.05, 2.0), "damping": (0.02, 1.0), "rope": (0.5, 2.0)}
    return record, sb.Ode(crane_rhs, [0.0] * 4, load, ranges, tolerances=(1e-6, 1e-7))


def measured_crane() -> dict[str, Any]:
    truth = {"lag": DRIVE_LAG, "damping": DAMPING, "rope": 1.0}
    _, simulator = crane(0)
    errors: dict[str, list[float]] = {name: [] for name in truth}
    covered = dict.fromkeys(truth, 0)
    for seed in range(SEEDS):
        record, _ = crane(seed)
        found = sb.identify(simulator, record[:3000], effort=Effort(starts=8))
        for name, true in truth.items():
            errors[name].append(found.values[name] / true - 1)
            covered[name] += abs(found.values[name] - true) < 1.96 * found.errors[name]
        print(seed, found, flush=True)
    return {
        "seeds": SEEDS,
        "largest_relative_error": {k: float(np.abs(v).max()) for k, v in errors.items()},
        "covered_by_95_percent": {k: v / SEEDS for k, v in covered.items()},
        "covered_together": sum(covered.values()) / (SEEDS * len(truth)),
    }


def tanks_rhs(t: float, x: Any, u: Any, p: Any) -> list[float]:
    """Two tanks below each other: what flows over the upper one's rim falls into the lower one."""
    upper, lower = max(x[0], 0.0), max(x[1], 0.0)
    over, lost = max(upper - 10.0, 0.0), max(lower - 10.0, 0.0)
    down = np.sqrt(upper)
    return [
        p.k4 * u[0] - p.k1 * down - p.k6 * upper - over,
        p.k2 * down - p.k3 * np.sqrt(lower) - p.k7 * lower + p.k5 * over - lost,
    ]


def tanks() -> sb.Ode:
    ranges: dict[str, Any] = dict.fromkeys(("k1", "k2", "k3", "k4"), (0.005, 0.5))
    ranges |= {"k5": (0.0, 3.0), "k6": (-0.05, 0.05), "k7": (-0.05, 0.05)}
    ranges |= {"x0_1": (0.0, 12.0), "x0_2": (0.0, 10.0)}
    return sb.Ode(tanks_rhs, [5.0, 5.0], lambda x: np.minimum(x[:, 1], 10.0), ranges, held=True,
                  tolerances=(1e-4, 1e-4))  # fmt: skip


def measured_tanks() -> dict[str, Any]:
    folder = Path(os.environ["SPLITBAND_DATA_DIR"]) / "benchmarks"
    train, test = (
        sb.read(folder / f"{name}.csv", inputs=["u"]) for name in ("ct_train", "ct_test")
    )
    assert test.u is not None
    alone = sb.GreyBox(tanks()).fit(train)
    # Of windows, epochs, sizes and penalties what forecast the last quarter of the file best.
    settings = sb.Settings(window=100, warmup=5, epochs=30)
    found: dict[str, Any] = {"parameters": alone.parameters}
    models: dict[str, Any] = {"grey box": alone}
    for name, kind in (("residual", sb.Residual), ("filtered", sb.Filtered)):
        model = kind(tanks(), sb.GRU(8), conditioned=True, settings=settings)
        models[name] = sb.Ensemble(model, 6).fit(train)
    for name, model in models.items():
        found[name] = {
            str(n): sb.rmse(test.y[n:], model.predict(len(test) - n, test[:n], test.u[n:],
                                                      other_record=True).y)
            for n in (5, 50)
        }  # fmt: skip
        print(name, found[name], flush=True)
    return found


def swinging(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [x[1], -p.k * np.sin(x[0]) - p.c * x[1] - p.dry * np.tanh(x[1] / ROUND)]


def swung(dry: float, seed: int) -> sb.Record:
    time = 0.02 * np.arange(2750)

    def rhs(t: float, x: Any) -> list[float]:
        friction = DAMPED * x[1] + dry * np.tanh(x[1] / ROUND)
        return [x[1], -STIFF * np.sin(x[0]) - friction]

    y = solve_ivp(rhs, (0, time[-1]), [1.6, 0.0], "LSODA", time, rtol=1e-9, atol=1e-10).y[0]
    noise = np.random.default_rng(seed).normal(0, 0.005, len(time))
    return sb.Record(y + noise, 0.02, y_true=y)


def pendulum(dry: Any = (0.0, 2.0)) -> sb.Ode:
    ranges = {"k": (1.0, 1000.0), "c": (0.0, 1.0), "dry": dry, "x0_1": (-3.0, 3.0)}
    return sb.Ode(swinging, [1.6, 0.0], parameters=ranges)


def measured_pendulum() -> dict[str, Any]:
    errors = []
    for seed in range(3):
        record = swung(DRY, seed)
        model = sb.GreyBox(pendulum(), starts=8).fit(record[:1000])
        errors.append(sb.nrmse(record.truth[1000:], model.predict(1750).y))
        print(seed, model.describe(), errors[-1], flush=True)
    return {"nrmse": errors}


def driven(t: float, x: Any, u: Any, p: Any) -> list[float]:
    """A pendulum with a torque, as its model has it: without dry friction."""
    return [x[1], -p.k * np.sin(x[0]) - p.c * x[1] + p.gain * u[0]]


def shaken(seed: int) -> sb.Record:
    """What is measured of it, with dry friction."""
    rng = np.random.default_rng(seed)
    time = 0.05 * np.arange(3000)
    tones = rng.uniform(0.05, 2.0, 12)
    u = np.sin(2 * np.pi * np.outer(time, tones) + rng.uniform(0, 2 * np.pi, 12)).sum(axis=1)

    def rhs(t: float, x: Any) -> list[float]:
        friction = 0.3 * x[1] + 3.0 * np.tanh(x[1] / ROUND)
        return [x[1], -25.0 * np.sin(x[0]) - friction + 3.0 * np.interp(t, time, u)]

    y = solve_ivp(rhs, (0, time[-1]), [0.0, 0.0], "LSODA", time, rtol=1e-7, atol=1e-9).y[0]
    return sb.Record(y + rng.normal(0, 0.005, len(time)), 0.05, u=u[:, None], y_true=y)


def trolley(t: float, x: Any, u: Any, p: Any) -> list[float]:
    """The crane, as a model has it whose load hangs still."""
    return [x[1], (u[0] - x[1]) / p.lag]


def measured_wrong() -> dict[str, list[dict[str, Any]]]:
    """Fit models that miss something, networks, and both together, as `compare` does by default.

    Seeds 0, 1 and 2 were for development.
    """
    friction: dict[str, Any] = {"k": (1.0, 100.0), "c": (0.0, 10.0), "gain": (0.1, 10.0)}
    still: dict[str, Any] = dict.fromkeys(("x0_1", "x0_2"), 0.0)
    cases = {
        "pendulum without dry friction": (
            shaken,
            sb.Ode(driven, [0, 0], parameters=friction | still),
        ),
        "crane without the swing": (
            lambda seed: crane(seed)[0],
            sb.Ode(trolley, [0, 0], parameters={"lag": (0.05, 2.0)} | still),
        ),
    }
    found: dict[str, list[dict[str, Any]]] = {}
    for case, (record, simulator) in cases.items():
        found[case] = []
        for seed in (3, 4, 5):
            options = sb.Options(search=sb.Search(120.0), simulator=simulator)
            result = sb.compare(record(seed), 2000, setup=options)
            print(case, result.table[["forecast RMSE", "score"]].to_string(), flush=True)
            errors = {name: of.forecast_rmse for name, of in result.medians.items()}
            found[case].append({"recommended": result.recommended, "forecast_rmse": errors})
    return found


def main() -> None:
    measure = {"crane": measured_crane, "tanks": measured_tanks, "pendulum": measured_pendulum,
               "wrong": measured_wrong}  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=measure)
    only = parser.parse_args().only
    for name in [only] if only else measure:
        found = json.loads(OUT.read_text()) if OUT.exists() else {}
        found[name] = measure[name]()
        OUT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
