"""What is found in place of an unknown term of an equation, and how well it forecasts.

    python -m benchmarks.unknown drive pendulum spring crane [--seeds 20] [--rounds 2]
    python -m benchmarks.unknown tanks [--seeds 5]
    python -m benchmarks.unknown drawn-tanks drawn-springs [--seeds 6]
    python -m benchmarks.unknown intervals [--seeds 200]
    python -m benchmarks.unknown gradient
    python -m benchmarks.unknown --table
    python -m benchmarks.unknown intervals --again 3

A run is a line of OUT with its commit and the hash of the code that decides it, and what is there
by the same code is not run again. `--again` runs stored ones of older code to see whether they
come out the same. `--rounds 0` leaves out networks, and the rooms of comparisons. The
drive, the pendulum, the spring and the crane are simulated, 2,000 samples for training and 1,000
to forecast, with noise of 1 % of the output's deviation. `intervals` counts how often the 95 %
interval of the drive's inertia holds the truth. The tanks are the public record, on which one of
the trainings is chosen by the last quarter of the training file. By the
errors of the drawn systems, a range of weight decays is chosen, and how a term goes on outside its
range. `gradient` is the median time of
the derivatives of 1,000 samples of the pendulum by 30 weights, and parameters and states beside.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

import splitband as sb
from benchmarks import claims
from benchmarks.sets import SETS, load
from splitband.records.named import overhead_crane
from splitband.report.environment import environment
from splitband.simulators import identification

Array = npt.NDArray[np.float64]
OUT = Path(__file__).parents[1] / "docs/results/benchmarks/unknown.jsonl"
TRAIN, AHEAD, STEP, NOISE = 2000, 1000, 0.02, 0.01


def stribeck(v: Any) -> Any:
    """Return friction in N m: breakaway, a fall, and a viscous part."""
    return (0.5 + 0.7 * np.exp(-((v / 0.4) ** 2))) * np.tanh(v / 0.1) + 0.4 * v


def dry(v: Any) -> Any:
    """Return dry friction, smooth within 0.1 rad/s."""
    return 0.4 * np.tanh(v / 0.05)


@dataclass(frozen=True)
class System:
    """A simulated system with an unknown term.

    `rhs(t, x, u, p, w)` is what is known of it, `force` what it knows not, a function of the state
    at the place `of`, and `truth` its parameters; `whole(p, z, w)` is what is compared with the
    truth, the found `w` or more.
    """

    rhs: Callable[..., Any]
    truth: dict[str, float]
    ranges: dict[str, Any]
    x0: tuple[float, ...]
    of: int
    force: Callable[[Any], Any]
    push: float
    whole: Callable[[Any, Any, Any], Any] = lambda p, z, w: w

    def equation(self, **options: Any) -> sb.Ode:
        """Return the equation with its unknown term."""
        term = sb.Unknown([f"x{self.of + 1}"], odd=True, **options)
        return sb.Ode(self.rhs, [*self.x0], parameters=self.ranges, unknown=term)

    def record(
        self, seed: int, samples: int = TRAIN + AHEAD, harder: int | None = None
    ) -> tuple[sb.Record, Array]:
        """Return a record, and the states without noise; it is pushed harder from a sample on."""
        rng = np.random.default_rng(seed)
        force, rhs = self.force, self.rhs

        def true(t: float, x: Any, u: Any, p: Any) -> Any:
            return rhs(t, x, u, p, [force(x[self.of])])

        u = np.repeat(rng.uniform(-1, 1, samples // 25 + 1), 25)[:samples, None] * self.push
        if harder is not None:
            u[harder:] *= 1.6
        ode = sb.Ode(true, [*self.x0], lambda x: x, self.truth)
        x = np.asarray(ode.simulate(STEP * np.arange(1.0 * samples), u), dtype=float)
        y = x[:, :1] + rng.normal(0, NOISE * x[:, 0].std(), (samples, 1))
        return sb.Record(y, STEP, u=u, y_true=x[:, :1]), x


SYSTEMS = {
    "drive": System(
        lambda t, x, u, p, w: [(u[0] - w[0]) / p.inertia],
        {"inertia": 0.5},
        {"inertia": (0.1, 2.0)},
        (0.0,),
        0,
        stribeck,
        2.5,
    ),
    "pendulum": System(
        lambda t, x, u, p, w: [x[1], -p.k * np.sin(x[0]) - p.c * x[1] + u[0] - w[0]],
        {"k": 9.0, "c": 0.1},
        {"k": (1.0, 50.0), "c": 0.1},
        (1.0, 0.0),
        1,
        dry,
        2.5,
    ),
    "spring": System(
        lambda t, x, u, p, w: [x[1], (u[0] - p.k * x[0] - 0.4 * x[1] - w[0]) / p.mass],
        {"k": 4.0, "mass": 1.0},
        {"k": (1.0, 20.0), "mass": (0.2, 5.0)},
        (0.5, 0.0),
        0,
        lambda x: 2.0 * x**3,
        6.0,
        lambda p, z, w: p["k"] * z + w,
    ),
}


def curve_error(system: System, model: sb.GreyBox, x: Array) -> float:
    """Return the RMS error of the curve where the record went, as a share of its RMS value."""
    z = np.sort(x[:TRAIN, system.of])
    curve = model.unknown_curve(z=z[TRAIN // 100 : -TRAIN // 100])  # the ends are visited once
    found = system.whole(model.parameters["used"], curve.z, curve.w[:, 0])
    wanted = system.whole(system.truth, curve.z, system.force(curve.z))
    return float(sb.rmse(wanted, found) / np.sqrt(np.mean(wanted**2)))


def simulated(name: str, seed: int, rounds: int) -> dict[str, Any]:
    """Return the facts of a run of a simulated system."""
    system = SYSTEMS[name]
    record, x = system.record(seed)
    model, facts = compared(record, system.equation(), seed, rounds)
    values, errors = model.estimate.values, model.estimate.errors
    return {
        "parameters": {k: values[k] / system.truth[k] - 1 for k in values},
        "standard_errors": {k: errors[k] / system.truth[k] for k in values},
        "curve": curve_error(system, model, x),
        **facts,
    }


def compared(
    record: sb.Record, ode: sb.Ode, seed: int, rounds: int
) -> tuple[sb.GreyBox, dict[str, Any]]:
    """Return the grey box, the NRMSE of the forecast of each method, and what is recommended."""
    truth = record.y if record.y_true is None else record.y_true
    u = None if record.u is None else record.u[TRAIN:]
    alone = sb.GreyBox(ode.without_terms(), name="grey-box-without-terms")
    facts: dict[str, Any] = {}
    if rounds:
        methods: list[Any] = ["grey-box", alone, "residual-gru-conditioned", "gru"]
        result = sb.compare(record, TRAIN, methods, simulator=ode, seed=seed, rounds=rounds)
        ahead = {name: fits[0].ahead for name, fits in result.fits.items()}
        model: Any = result.fits["grey-box"][0].fitted
        facts = {"best": result.recommended}
        from splitband.report import words  # noqa: PLC0415  loads the rooms of comparisons

        facts |= {"says": [w for w in words.warnings(result) if "unknown terms" in w]}
    else:
        model = sb.GreyBox(ode).fit(record[:TRAIN], seed=seed)
        fitted = {"grey-box": model, alone.name: alone.fit(record[:TRAIN])}
        ahead = {n: each.predict(len(truth) - TRAIN, u=u).y for n, each in fitted.items()}
    errors = {name: float(np.max(sb.nrmse(truth[TRAIN:], y))) for name, y in ahead.items()}
    return model, {"nrmse": errors, **facts}


def crane(seed: int, rounds: int) -> dict[str, Any]:
    """Return the facts of a run of the crane, whose swing the equation omits."""

    def trolley(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
        return [x[1], (u[0] - x[1]) / p.lag + w[0]]

    ode = sb.Ode(trolley, [0.0, 0.0], parameters={"lag": (0.05, 2.0)}, unknown=sb.Unknown())
    record = replace(overhead_crane(TRAIN + AHEAD, seed=seed), y_sim=None)
    return compared(record, ode, seed, rounds)[1]


def two_tanks(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
    """Return the flows of two tanks that overflow, smooth within 0.05 V of their rims."""
    upper, lower = np.maximum(x[0], 1e-6), np.maximum(x[1], 1e-6)
    full = 0.5 + 0.5 * np.tanh((upper - p.rim) / 0.05)
    high = 0.5 + 0.5 * np.tanh((lower - 10.0) / 0.05)
    fill = p.pump * u[0] - p.upper * np.sqrt(upper) - p.seep * upper + w[0]
    over = full * np.maximum(fill, 0.0)
    out = p.lower * np.sqrt(lower) + p.leak * lower
    fall = p.down * np.sqrt(upper) - out + p.caught * over + w[1]
    return [fill - over, fall - high * np.maximum(fall, 0.0)]


FLOWS: dict[str, Any] = {
    **dict.fromkeys(("pump", "upper", "down", "lower"), (0.005, 0.5)),
    **dict.fromkeys(("seep", "leak"), (-0.05, 0.05)),  # an outlet may differ from a square root
    "caught": (0.0, 3.0),
    "rim": (8.0, 14.0),
    "x0_1": (0.0, 12.0),
    "x0_2": (0.0, 10.0),
}


def tanks_equation(term: sb.Unknown) -> sb.Ode:
    """Return the equation of two tanks, of which the lower one's level is measured."""
    how: Any = {"hold": "zoh", "tolerances": (1e-6, 1e-7), "unknown": term}
    return sb.Ode(two_tanks, [5.0, 5.0], lambda x: np.minimum(x[:, 1], 10.0), FLOWS, **how)


def tanks(seed: int, rounds: int) -> dict[str, Any]:
    """Return the RMSE in V on the test file, with and without the term, chosen on the training."""
    training, test = load(SETS["tanks"].training), load(SETS["tanks"].tests[0])
    held, facts = 3 * len(training) // 4, dict[str, Any]()
    for name, term in {
        "without the term": sb.Unknown(outputs=2, hidden=0),
        "with it": sb.Unknown(["x1", "x2"], outputs=2, hidden=8),
    }.items():
        ode = tanks_equation(term)
        trial = sb.GreyBox(ode).fit(training[:held], seed=seed)
        ahead = trial.predict(len(training) - held, u=training.u[held:])  # type: ignore[index]
        model = sb.GreyBox(ode).fit(training, seed=seed)
        facts[name] = {"held_out": float(sb.rmse(training.y[held:], ahead.y))}
        for initial in (5, 50):
            assert test.u is not None
            u = test.u[initial:]
            said = model.predict(len(u), test[:initial], u=u, other_record=True)
            facts[name][f"test, {initial}"] = float(sb.rmse(test.y[initial:], said.y))
    return facts


RANGES = (1e1,), (1e1, 1e3), (1e0, 1e2), (1e-3, 1e-1, 1e1, 1e3)
"""Weight decays to try, of which one choice is made by drawn systems."""


def by_range(ode: sb.Ode, record: sb.Record, error: Callable[[sb.GreyBox], Any]) -> dict[str, Any]:
    """Return the errors of an equation that is fitted with each range of weight decays."""
    facts, starts, real = dict[str, Any](), list[Any](), identification.tried

    def tried(*arguments: Any) -> Any:
        starts.extend(() if starts else real(*arguments))  # the same for all ranges
        return starts

    for decays in RANGES:
        with (
            patch.object(identification, "DECAYS", decays),
            patch.object(identification, "tried", tried),
        ):
            facts[str(decays)] = error(sb.GreyBox(ode, starts=4).fit(record))
    return facts


def drawn_tanks(seed: int, rounds: int) -> dict[str, Any]:
    """Return errors in deviations of a further record of tanks with drawn flows and losses."""
    rng, flows = np.random.default_rng(seed), {"seep": 0.0, "leak": 0.0}
    flows |= {"pump": rng.uniform(0.03, 0.06), "upper": rng.uniform(0.03, 0.06)}
    flows |= {"caught": rng.uniform(0, 0.8), "rim": rng.uniform(9, 11)}
    flows["down"] = flows["upper"] * rng.uniform(0.7, 1.2)
    flows["lower"] = flows["down"] * rng.uniform(0.8, 1.2)
    most, above = rng.uniform(0.1, 0.4, 2) * flows["upper"], rng.uniform(1, 5, 2)
    power = rng.uniform(0.5, 1.5, 2)

    def true(t: float, x: Any, u: Any, p: Any) -> list[Any]:
        lost = 2 * most * (np.maximum(np.asarray(x) - above, 0.0) / 3) ** power
        return two_tanks(t, x, u, p, -lost)

    def run() -> tuple[sb.Record, Array]:
        wave = np.fft.irfft(np.exp(2j * np.pi * rng.uniform(size=501)) * (np.arange(501) < 58))
        u = np.clip(3.0 + 1.3 * wave / wave.std(), 0.5, 6.0)[:, None]
        how: Any = {"hold": "zoh", "tolerances": (1e-6, 1e-7)}
        ode = sb.Ode(true, rng.uniform(2, 8, 2), lambda x: x, flows, **how)
        level = np.asarray(ode.simulate(4.0 * np.arange(1000.0), u))[:, 1:]
        y = level + rng.normal(0, 0.02 * level.std(), level.shape)
        return sb.Record(y, 4.0, u=u), level

    (record, _), (other, level) = run(), run()

    def error(model: sb.GreyBox) -> float:
        u = other.u[50:]  # type: ignore[index]
        said = model.predict(len(u), other[:50], u=u, other_record=True)
        return float(sb.rmse(level[50:], said.y) / level.std())

    term = sb.Unknown(["x1", "x2"], outputs=2, hidden=8)
    return by_range(tanks_equation(term), record, error)


def drawn_forces(rng: np.random.Generator) -> list[tuple[int, Callable[[Any], Any]]]:
    """Return forces, with the place of the state that each is a function of."""
    a, b, c, d = rng.uniform(0.5, 1.5, 4)
    return [
        (1, lambda v: 0.4 * a * np.tanh(v / (0.1 * b))),
        (
            1,
            lambda v: (
                (0.3 * a + 0.4 * b * np.exp(-((v / (0.4 * c)) ** 2))) * np.tanh(v / 0.1)
                + 0.2 * d * v
            ),
        ),
        (1, lambda v: 0.3 * a * v * abs(v)),
        (1, lambda v: 0.25 * a * v + 0.2 * b * np.tanh(v / 0.1)),
        (0, lambda z: 1.5 * a * z**3),
        (0, lambda z: 2.0 * a * np.arctan(z / (0.6 * b))),
    ]


def drawn_springs(seed: int, rounds: int) -> dict[str, Any]:
    """Return the NRMSE of the forecast of a mass with a drawn force, pushed harder than before.

    Also that with the term held outside its range, in place of going on straight.
    """
    rng = np.random.default_rng(seed)
    forces = drawn_forces(rng)
    of, force = forces[seed % len(forces)]
    stiffness = rng.uniform(2, 12)

    def rhs(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
        return [x[1], u[0] - p.k * x[0] - 0.2 * x[1] - w[0]]

    system = System(rhs, {"k": stiffness}, {"k": (1.0, 50.0)}, (0.3, 0.0), of, force, 4.0)
    record, _ = system.record(seed, 1500, harder=1000)
    assert record.u is not None
    u = record.u

    def error(model: sb.GreyBox) -> dict[str, float]:
        (term,), found = model.terms, {"straight": model.predict(500, u=u[1000:]).y}
        if (state := term.trained) is not None:

            def held(t: float, x: Any, u: Any, p: Any) -> list[Any]:
                return rhs(t, x, u, p, term.value(state.clipped(x[of : of + 1])))

            ode = sb.Ode(held, [*system.x0], parameters={"k": model.parameters["used"]["k"]})
            found["held"] = np.asarray(ode.simulate(STEP * np.arange(1500.0), u))[1000:]
        return {name: float(np.max(sb.nrmse(record.truth[1000:], y))) for name, y in found.items()}

    return by_range(system.equation(), record[:1000], error)


def interval(seed: int, rounds: int) -> dict[str, Any]:
    """Return whether the 95 % interval of the drive's inertia holds the truth."""
    system = SYSTEMS["drive"]
    record, _ = system.record(seed, 600)
    model = sb.GreyBox(system.equation(), starts=2).fit(record, seed=seed)
    value, error = model.estimate.values["inertia"], model.estimate.errors["inertia"]
    within = abs(value - system.truth["inertia"]) <= 1.96 * error
    return {"error": value - system.truth["inertia"], "se": error, "holds": bool(within)}


def gradient(seed: int, rounds: int) -> dict[str, Any]:
    """Return the median seconds of a simulation with its derivatives."""
    record, x = SYSTEMS["pendulum"].record(seed, 1000)
    ode = SYSTEMS["pendulum"].equation(hidden=10).matched(record.columns, record.inputs).coarse()
    (term,) = ode.terms
    ode = ode.taught([term.begun(x[:, 1:], seed=seed)])
    rng = np.random.default_rng(seed)
    ode = ode.weighted(rng.normal(0, 0.3, len(ode.weights)))
    point, seconds = (ode.known.middle(), np.array([1.0, 0.0])), []
    for _ in range(130):
        begin = perf_counter()
        ode.derivatives(record.time, record.u, point, ode.known.shared)
        seconds.append(perf_counter() - begin)
    return {"weights": len(ode.weights), "milliseconds": 1e3 * median(seconds[30:])}


RUNS: dict[str, Callable[[int, int], dict[str, Any]]] = {
    **{name: (lambda s, r, name=name: simulated(name, s, r)) for name in SYSTEMS},  # type: ignore[misc]
    "crane": crane,
    "tanks": tanks,
    "drawn-tanks": drawn_tanks,
    "drawn-springs": drawn_springs,
    "intervals": interval,
    "gradient": gradient,
}


def table(rows: Sequence[claims.Row]) -> str:
    """Return medians and ranges of all numbers of each system, a line each."""
    by_name: dict[tuple[str, str], list[float]] = {}

    def add(system: str, name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                add(system, f"{name} {key}".strip(), inner)
        elif isinstance(value, int | float):
            by_name.setdefault((system, name), []).append(float(value))

    for row in rows:
        add(row["system"] + claims.sign([row]), "", row["facts"])
    lines = ["| system | what | runs | median | least | most |", "|---|---|---|---|---|---|"]
    for (system, name), values in by_name.items():
        numbers = [f"{f(np.abs(values)):.4g}" for f in (median, min, max)]
        if name == "holds":
            numbers = [f"{np.mean(values):.1%} of the 95 % intervals", "", ""]
        lines.append(f"| {system} | {name} | {len(values)} | {' | '.join(numbers)} |")
    return "\n".join([*lines, claims.note(rows)])


def again(rows: Sequence[claims.Row], count: int) -> None:
    """Run some stored rows, of one hash and the same rooms, once more.

    If all facts are the same, to the bit, the hash is listed as equal to today's.
    """
    from benchmarks.frozen import list_as_equal  # noqa: PLC0415  loads the rooms of comparisons

    lines = []
    for row in rows[:: max(1, len(rows) // count)][:count]:
        same = RUNS[row["system"]](row["seed"], row["rounds"]) == row["facts"]
        lines.append(f"{row['system']}, seed {row['seed']}: {'equal' if same else 'other'}")
        print(lines[-1], flush=True)
    if all(line.endswith("equal") for line in lines):
        pair = [rows[0]["sources"], claims.sources(rooms=rows[0]["rooms"])]
        list_as_equal(rows[0]["commit"], pair, lines)


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("systems", nargs="*", metavar=" ".join(RUNS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--again", type=int, default=0, help="stored rows to compare with")
    given = parser.parse_args()
    text = given.out.read_text(encoding="utf-8") if given.out.exists() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    if given.again:
        old = [row for row in rows if row["system"] in given.systems and "rooms" in row]
        old = [row for row in old if not claims.current(row)]
        again([row for row in old if row["sources"] == old[0]["sources"]], given.again)
        return
    current = filter(claims.current, rows)
    done = {(row["system"], row["seed"], row["rounds"]) for row in current}
    commit = environment()["commit"]
    for name in given.systems:
        for seed in range(given.first, given.first + given.seeds):
            if (name, seed, given.rounds) in done:
                continue
            began = perf_counter()
            facts = RUNS[name](seed, given.rounds)
            row = {"system": name, "seed": seed, "rounds": given.rounds, "facts": facts}
            row |= {"seconds": round(perf_counter() - began, 1), "commit": commit}
            rooms = claims.loaded()
            rows.append(row | {"rooms": rooms, "sources": claims.sources(rooms=rooms)})
            print(json.dumps(rows[-1]), flush=True)
            with given.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
