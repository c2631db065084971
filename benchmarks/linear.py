"""The linear model against independent answers: fit, order, delay, time; its errors; closed loops.

    python -m benchmarks.linear                 all tables; `--table plants` one of them

"sizes": seconds, and memory up to then, from a thousand samples to a million, and for a structure
of 22 modes from one record and from six.
"plants": fifteen plants, of orders 1 to 40, with delays to 1,000 samples. "errors": how often an
estimate lies within 1.96 standard errors. "loop": bias behind a controller. "filter": the error one
step ahead as a multiple of the true Kalman filter's.

The independent answer is the drawn system itself, whose outputs without noise the fit is measured
on, for another draw of the input.
"""

from __future__ import annotations

import argparse
import resource
import time
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
import scipy

from splitband import Linear, Record
from splitband.linear.identification import identified
from splitband.linear.model import LinearModel
from splitband.metrics import fit_percent
from splitband.runtime.threads import use_one_thread

Array = npt.NDArray[np.float64]
Pair = tuple[Array, Array]
WARMUP = 0.2
"""Share of a test record that is known: a model's state is estimated from it."""


class Plant(NamedTuple):
    """Hold A, B, C and D, the delays `(ny, nu)`, and the training records.

    An input is held for `hold` samples, 1 is white; `noise` is a share of the output's deviation.
    """

    system: tuple[Any, ...]
    delay: Any = 0
    samples: int = 4000
    runs: int = 1
    hold: int = 1
    noise: float = 0.02

    def record(self, seed: int, samples: int) -> tuple[Array, Array, Array]:
        """Return inputs, outputs and measured outputs."""
        rng = np.random.default_rng(seed)
        a, b, c, d = self.system
        nu, ny = b.shape[1], len(c)
        delay = np.broadcast_to(self.delay, (ny, nu))
        u = rng.choice([-1.0, 1.0], (samples // self.hold + 1, nu)).repeat(self.hold, axis=0)
        u = rng.standard_normal((samples, nu)) if self.hold == 1 else u[:samples]
        y = np.zeros((samples, ny))
        for k in range(ny):
            late = [np.append(np.zeros(n), u[: samples - n, j]) for j, n in enumerate(delay[k])]
            of_output = (a, b, c[[k]], d[[k]], 1.0)
            y[:, k] = scipy.signal.dlsim(of_output, np.stack(late, axis=1))[1][:, 0]
        return u, y, y + self.noise * y.std(axis=0) * rng.standard_normal(y.shape)


def first(pole: float) -> tuple[Any, ...]:
    """Return a system of first order with the gain 1, or an integrator."""
    gain = 1 - pole if pole < 1 else 0.02
    return np.array([[pole]]), np.array([[gain]]), np.eye(1), np.zeros((1, 1))


def second(radius: float, angle: float) -> tuple[Any, ...]:
    """Return a system of second order."""
    a = np.real(np.poly(radius * np.exp([1j * angle, -1j * angle])))
    return scipy.signal.tf2ss([0.1, 0.05], a)


def modes(count: int, nu: int, ny: int, seed: int = 0, damping: float = 0.02) -> tuple[Any, ...]:
    """Return lightly damped modes."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.sort(rng.uniform(0.02, 0.42, count))
    blocks = (np.array([[0, x], [-x, -2 * damping * x]]) for x in w)
    b, c = np.zeros((2 * count, nu)), np.zeros((ny, 2 * count))
    b[1::2], c[:, ::2] = rng.standard_normal((count, nu)), rng.standard_normal((ny, count))
    continuous = scipy.linalg.block_diag(*blocks), b, c, np.zeros((ny, nu))
    return scipy.signal.cont2discrete(continuous, 1.0)[:4]


_BOTH = tuple(scipy.linalg.block_diag(*x) for x in zip(first(1.0), first(0.9), strict=True))
PLANTS = {
    "first order, 300 samples": Plant(first(0.9), samples=300),
    "first order, slow": Plant(first(0.999), samples=8000, hold=200),
    "first order, delay 40": Plant(first(0.9), 40),
    "first order, delay 1000": Plant(first(0.95), 1000, 6000, hold=20),
    "second order": Plant(second(0.9, 0.3)),
    "second order, slow, held": Plant(second(0.98, 0.05), samples=6000, hold=20),
    "second order, 100,000 samples": Plant(second(0.95, 0.2), samples=100_000, noise=0.5),
    "integrator": Plant(first(1.0), samples=2000, hold=30),
    "integrator and lag, 3 runs": Plant(_BOTH, samples=800, runs=3),
    "two outputs, delays 0 and 250": Plant(
        (*first(0.9)[:2], np.ones((2, 1)), np.zeros((2, 1))), [[0], [250]], hold=10
    ),
    "five inputs, two outputs": Plant(modes(2, 5, 2, damping=0.2), runs=2),
    "four modes": Plant(modes(4, 1, 1)),
    "two inputs, delays 3 and 60": Plant(modes(1, 2, 1, damping=0.3), [[3, 60]]),
    "12 modes, 3 x 3": Plant(modes(12, 3, 3), samples=16_000, noise=0.01),
    "20 modes, 3 x 3": Plant(modes(20, 3, 3), samples=16_000, noise=0.01),
}


def fitted(records: list[Pair]) -> tuple[LinearModel, float]:
    """Return a model of records of outputs and inputs, and its seconds of CPU time."""
    began = time.process_time()
    model = identified(records)
    return model, time.process_time() - began


def fit_of(model: LinearModel, u: Array, y: Array, known: int) -> Array:
    """Return the fit of each output after the first `known` samples."""
    ahead, *_ = model.continued(u, y[:known])
    return np.asarray(fit_percent(y[known:], ahead[known:]))


def plants() -> None:
    """Print the fit, order and delay of fifteen plants."""
    print(f"{'plant':32} {'order':>9} {'fit %':>7} {'CPU s':>6}  dead times")
    for name, plant in PLANTS.items():
        runs = [plant.record(seed, plant.samples) for seed in range(plant.runs)]
        model, seconds = fitted([(seen, u) for u, _, seen in runs])
        late = int(np.max(plant.delay))
        v, x, _ = plant.record(99, max(plant.samples // 2, 600) + late)
        known = late + int(WARMUP * len(v))
        # A held input acts one sample late without a dead time.
        dead = [max(delay - 1, 0) for _, delay in model.taps]
        order = f"{model.order} / {len(plant.system[0])}"
        said = dead if late or np.any(dead) else ""
        fit = fit_of(model, v, x, known).min()
        print(f"{name:32} {order:>9} {fit:7.2f} {seconds:6.2f}  {said}", flush=True)


def multisine(rng: np.random.Generator, samples: int, inputs: int) -> Array:
    """Return inputs with the same power at all frequencies up to 0.45 of the rate."""
    bins = np.arange(max(samples // 100, 1), int(0.45 * samples))
    u = np.zeros((samples, inputs))
    for j in range(inputs):
        spectrum = np.zeros(samples // 2 + 1, complex)
        spectrum[bins] = np.exp(2j * np.pi * rng.random(len(bins)))
        u[:, j] = np.fft.irfft(spectrum, samples)
    return u / u.std(axis=0)


def structure(seed: int, samples: int, hardens: float = 1.0) -> tuple[Array, Array]:
    """Return inputs and outputs of 22 modes of one per cent, with a joint that hardens a little."""
    a, b, c, d = modes(22, 3, 3, 11, 0.01)
    u = multisine(np.random.default_rng(seed), samples, 3)
    joint = c[0] / np.linalg.norm(c[0])
    usual = (scipy.signal.dlsim((a, b, c, d, 1.0), u)[2] @ joint).std()
    acts = np.zeros(44)
    acts[1::2] = 0.015 * hardens * np.random.default_rng(5).standard_normal(22)
    x, y = np.zeros(44), np.zeros((samples, 3))
    for n in range(samples):
        y[n] = c @ x + d @ u[n]
        moved = np.clip(joint @ x / usual, -4, 4)
        x = a @ x + b @ u[n] - acts * moved**3
    return u, y


def sizes() -> None:
    """Print seconds and memory of `Linear().fit` by size of the record."""
    pole = Plant(first(0.98), samples=20_000, runs=2, hold=50)
    two, several = Plant(second(0.95, 0.2), hold=5), Plant(modes(6, 3, 3, 3, 0.05))
    cases = {"1 x 1, one pole, 2 x 20,000 samples": pole}
    for n in (1_000, 10_000, 100_000, 1_000_000):
        cases[f"1 x 1, order 2, {n:,} samples"] = two._replace(samples=n)
    for n in (1_000, 10_000, 100_000):
        cases[f"3 x 3, order 12, {n:,} samples"] = several._replace(samples=n)
    print(f"{'record':40} {'seconds':>7} {'GB':>5} {'order':>5} fit %")

    def show(name: str, records: list[Pair], test: Pair) -> None:
        began = time.perf_counter()
        model = Linear().fit(*(Record(y, 1.0, u=u) for y, u in records)).model
        took, memory = (
            time.perf_counter() - began,
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        )
        fit = fit_of(model, *test, 500).round(2)
        print(f"{name:40} {took:7.2f} {memory:5.2f} {model.order:5} {fit}", flush=True)

    for name, plant in cases.items():
        runs = [plant.record(seed, plant.samples) for seed in range(plant.runs)]
        show(name, [(seen, u) for u, _, seen in runs], plant.record(99, 4000)[:2])
    rng = np.random.default_rng(0)
    drawn = [structure(seed, 16_384) for seed in range(6)]
    noisy = [(y + 0.01 * y.std(axis=0) * rng.standard_normal(y.shape), u) for u, y in drawn]
    test = structure(99, 8192)
    show("3 x 3, 22 modes, 16,384 samples", noisy[:1], test)
    show("3 x 3, 22 modes, 6 x 16,384 samples", noisy, test)


def errors(seeds: int) -> None:
    """Print how often the true poles and gains lie within 1.96 standard errors."""
    for name in ("second order", "first order, 300 samples", "integrator and lag, 3 runs"):
        plant, hits = PLANTS[name]._replace(noise=0.1), []
        a, b, c, d = plant.system
        poles = np.linalg.eigvals(a)
        for seed in range(seeds):
            runs = [plant.record(7 * seed + i, min(plant.samples, 1000)) for i in range(plant.runs)]
            model = identified(
                [(z, u) for u, _, z in runs], len(a), np.zeros((len(c), b.shape[1]), int)
            )
            found = model.uncertainty
            assert found is not None
            true = poles[abs(poles) < 1]
            for p in true:
                at = np.argmin(abs(found.poles - p))
                off = np.append(found.parts[at] - [p.real, p.imag], abs(found.poles[at]) - abs(p))
                # The imaginary part of a real pole has no error, and a pair counts once.
                counted = [True, p.imag != 0, True][: 3 if p.imag >= 0 else 0]
                hits += [*(abs(off) <= 1.96 * found.pole_errors[at])[: len(counted)][counted]]
            if len(true) == len(poles):
                gain = (c @ np.linalg.solve(np.eye(len(a)) - a, b) + d)[0, 0]
                hits.append(abs(found.gains[0, 0] - gain) <= 1.96 * found.gain_errors[0, 0])
        print(f"{name}: {100 * np.mean(hits):.1f} % of {len(hits)} within their errors", flush=True)


def looped(seed: int) -> Pair:
    """Return a plant of first order behind a proportional controller, with coloured noise."""
    rng = np.random.default_rng(seed)
    setpoint, e = rng.choice([-1.0, 1.0], 100).repeat(20), rng.standard_normal(2000)
    y, u, x = np.zeros(2000), np.zeros(2000), 0.0
    for n in range(2000):
        y[n] = x + 0.5 * e[n]
        u[n] = 2.0 * (setpoint[n] - y[n - 1])
        x = 0.9 * x + 0.1 * u[n] + 0.45 * e[n]
    return y[:, None], u[:, None]


def loop(seeds: int) -> None:
    """Print mean and deviation of a pole behind a controller, with and without noise model."""
    poles, plain, taken = [], [], 0
    for seed in range(seeds):
        record = looped(seed)
        model = identified([record], 1, integrators=0)
        taken += model.by == "prediction error"
        poles.append(model.poles()[0].real)
        with patch("splitband.linear.identification.feedback", return_value=False):
            plain.append(identified([record], 1, integrators=0).poles()[0].real)
    for what, found in (("chosen", poles), ("output error alone", plain)):
        print(f"pole 0.9, {what}: {np.mean(found):.4f} +- {np.std(found):.4f}, {seeds} seeds")
    print(f"the controller was noticed in {taken} of them")


def filters(seeds: int) -> None:
    """Print the error one step ahead, as multiples of the true filter's, on drawn systems."""
    ratios = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 5))
        a = rng.standard_normal((n, n))
        a *= rng.uniform(0.7, 0.97) / abs(np.linalg.eigvals(a)).max()
        b, c = rng.standard_normal((n, 1)), rng.standard_normal((1, n))
        p = scipy.linalg.solve_discrete_are(a.T, c.T, 0.3 * np.eye(n), np.eye(1))
        power = c @ p @ c.T + 1
        gain = (a @ p @ c.T / power)[:, 0]
        u, e = rng.standard_normal((6000, 1)), np.sqrt(power[0]) * rng.standard_normal(6000)
        x, y = np.zeros(n), np.zeros((6000, 1))
        for t in range(6000):
            y[t] = c @ x + e[t]
            x = a @ x + b[:, 0] * u[t] + gain * e[t]
        model = identified([(y[:3000], u[:3000])])
        left = (y - model.continued(u, y)[0])[3000:, 0]
        ratios.append(np.sqrt(np.mean(left**2) / np.mean(e[3000:] ** 2)))
    within = np.mean(np.array(ratios) <= 1.02)
    print(f"one step ahead, of the true filter: median {np.median(ratios):.4f}, most")
    print(f"{max(ratios):.4f}, {within:.0%} at most 1.02, {seeds} seeds")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    tables: dict[str, Callable[..., None]] = {"sizes": sizes, "plants": plants}
    tables |= {"errors": errors, "loop": loop, "filter": filters}
    parser.add_argument("--table", choices=tables)
    parser.add_argument("--seeds", type=int, default=100)
    given = parser.parse_args()
    use_one_thread()  # as `sb.Linear` does: BLAS's threads wait for each other more than they help
    warnings.simplefilter("ignore")
    for name, table in tables.items():
        if given.table in (None, name):
            table(*([given.seeds] if name in ("errors", "loop", "filter") else []))


if __name__ == "__main__":
    main()
