"""Whether `splitband compare` keeps its budget of time, alone and beside other work.

    python -m benchmarks.budget [--out docs/benchmarks] [--only NAME,NAME] [--budgets 30s,1m,2m]

Five records are compared, each within several budgets; then likewise while another process keeps
every core busy. The time of a command is measured from outside, from its start to its end. The
record of 65,000 samples is the Silverbox training file (`splitband data fetch --benchmarks`); the
others are made here.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.runtime.files import write_json
from splitband.runtime.threads import available_cores

Array = npt.NDArray[np.float64]
BUDGETS = ("30s", "1m", "2m")
ALLOWED = 1.1
"""A budget is kept where the command takes at most so many times as long."""
HORIZON = 10.0
"""The command is ended, and has no result, after so many times its budget."""


def one_input(folder: Path) -> list[str]:
    """4,000 samples of a tank with one pump, emptied by its own weight."""
    rng = np.random.default_rng(1)
    u, levels = _steps(rng, 4000, 1), []
    level = 3.0
    for (pump,) in u:
        for _ in range(5):
            level = max(level + 0.4 * (0.12 * pump + 0.1 - 0.2 * np.sqrt(level)), 0.0)
        levels.append(level)
    y = np.array(levels)[:, None]
    path = _written(folder / "one_input.csv", u, y + 0.02 * y.std() * rng.standard_normal(y.shape))
    return [str(path), "--inputs", "u1"]


def five_inputs(folder: Path) -> list[str]:
    """2,500 samples of two coupled states that saturate, driven by five inputs."""
    rng = np.random.default_rng(2)
    u, states = _steps(rng, 2500, 5), []
    drive = rng.normal(size=(5, 3)) / 5
    state = np.zeros(3)
    for row in u:
        coupled = np.array([state[1], state[2] - state[0], state[0] - 0.4 * state[2]])
        state = 0.9 * state + 0.1 * np.tanh(coupled + row @ drive)
        states.append(state[:2])
    y = np.array(states)
    path = _written(
        folder / "five_inputs.csv", u, y + 0.02 * y.std(0) * rng.standard_normal(y.shape)
    )
    return [str(path), "--inputs", "u1,u2,u3,u4,u5"]


def silverbox(folder: Path) -> list[str]:
    """65,000 samples of an electronic oscillator with a cubic spring."""
    path = Path(os.environ["SPLITBAND_DATA_DIR"]) / "benchmarks" / "silverbox_train.csv"
    with path.open(encoding="utf-8") as opened:
        header = next(csv.reader(opened))
    return [str(path), "--inputs", next(name for name in header if name.lower().startswith("u"))]


def short(folder: Path) -> list[str]:
    """200 samples of a slow oscillation with a faster one on it."""
    rng = np.random.default_rng(3)
    t = np.arange(200)
    y = np.sin(2 * np.pi * t / 41) + 0.3 * np.sin(2 * np.pi * t / 7.3) ** 3
    path = _written(
        folder / "short.csv", np.empty((200, 0)), (y + 0.02 * rng.standard_normal(200))[:, None]
    )
    return [str(path)]


def simulated(folder: Path) -> list[str]:
    """1,500 samples of a pendulum, beside a simulator that takes it to be linear."""
    rng = np.random.default_rng(4)
    found, linear = [], []
    angle, speed, flat, flat_speed = 0.9, 0.0, 0.9, 0.0
    for n in range(1500 * 10):
        push = 0.25 * np.sin(2 * np.pi * n / 970)
        speed += 0.01 * (-np.sin(angle) * 4 - 0.05 * speed + push)
        angle += 0.01 * speed
        flat_speed += 0.01 * (-flat * 3.6 - 0.05 * flat_speed + push)
        flat += 0.01 * flat_speed
        if n % 10 == 0:
            found.append(angle)
            linear.append(flat)
    y, none = np.array(found)[:, None], np.empty((1500, 0))
    path = _written(folder / "simulated.csv", none, y + 0.01 * rng.standard_normal(y.shape))
    simulator = _written(folder / "simulator.csv", none, np.array(linear)[:, None])
    return [str(path), "--simulator", str(simulator)]


RECORDS = {
    "4,000 samples, one input": one_input,
    "2,500 samples, five inputs, two outputs": five_inputs,
    "65,000 samples, one input": silverbox,
    "200 samples": short,
    "1,500 samples, a simulator": simulated,
}


def _steps(rng: np.random.Generator, samples: int, inputs: int) -> Array:
    """Inputs that stay at random levels for a while, each at its own pace."""
    held = [rng.integers(15, 40) for _ in range(inputs)]
    levels = [np.repeat(rng.uniform(0, 2, samples // h + 1), h)[:samples] for h in held]
    return np.stack(levels, axis=1)


def _written(path: Path, u: Array, y: Array) -> Path:
    names = [f"u{i + 1}" for i in range(u.shape[1])] + [f"y{i + 1}" for i in range(y.shape[1])]
    time_column = 0.1 * np.arange(len(y))[:, None]
    np.savetxt(
        path, np.hstack([time_column, u, y]), "%.9g", ",",
        header=",".join(["time", *names]), comments="",
    )  # fmt: skip
    return path


@contextmanager
def _busy(wanted: bool) -> Iterator[None]:
    """Every core has something else to do, if that is wanted."""
    count = available_cores() if wanted else 0
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def measured(record: Sequence[str], budget: str, seconds: float, busy: bool) -> dict[str, Any]:
    """What a command took, and came to."""
    with tempfile.TemporaryDirectory() as name, _busy(busy):
        out = Path(name) / "out"
        command = [sys.executable, "-m", "splitband", "--quiet", "compare", *record]
        began = time.perf_counter()
        with subprocess.Popen(
            [*command, "--budget", budget, "--out", str(out)],
            stderr=subprocess.PIPE, text=True, start_new_session=True,
        ) as process:  # fmt: skip
            try:
                said = process.communicate(timeout=HORIZON * seconds)[1]
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, 9)
                said = "killed"
        took = time.perf_counter() - began
        file = out / "results.json"
        found = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None
    if found is None:
        print(said, file=sys.stderr)
    return {
        "took": round(took, 1),
        "kept": took <= ALLOWED * seconds,
        "recommended": None if found is None else found["recommended"],
        "held_out": _held_out(found),
        "time": None if found is None else found.get("time"),
    }


def _held_out(found: dict[str, Any] | None) -> float | None:
    """The error of what is recommended, as a multiple of the record's deviation."""
    if found is None:
        return None
    return float(f"{found['methods'][found['recommended']]['score']:.3g}")


def _seconds(budget: str) -> float:
    return float(budget[:-1]) * {"s": 1, "m": 60}[budget[-1]]


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--only", default="", help="names of records, or parts of them, by ;")
    parser.add_argument("--budgets", default=",".join(BUDGETS))
    parser.add_argument("--beside", default="nothing,work", help="nothing, work or both")
    given = parser.parse_args()
    wanted = [part for part in given.only.split(";") if part]
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "budget.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text())["rows"] if path.exists() else []
    with tempfile.TemporaryDirectory() as name:
        for record, make in RECORDS.items():
            if wanted and not any(part in record for part in wanted):
                continue
            line = make(Path(name))
            for beside in given.beside.split(","):
                for budget in given.budgets.split(","):
                    row = {"record": record, "beside": beside, "asked": _seconds(budget)}
                    rows = [each for each in rows if row != {key: each[key] for key in row}]
                    row |= measured(line, budget, row["asked"], beside == "work")
                    rows.append(row)
                    write_json(path, {"cores": available_cores(), "rows": rows})
                    print(
                        f"{record:42} beside {beside:8} asked {row['asked']:5.0f} s, "
                        f"took {row['took']:6.1f} s  {row['recommended']} {row['held_out']}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
