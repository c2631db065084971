"""How much memory a long record takes: training on a million samples, simulating a million steps.

    python -m benchmarks.memory [--samples 1000000] [--out FILE.json]

Each command runs in a process of its own; what counts is the most that it held at once.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from splitband.runtime.files import write_json

LIMIT = 2 * 2**30
METHODS = ("gru", "split-gru-conditioned", "filtered-gru-conditioned")
_WATCHED = """
import json, resource, sys
from splitband.cli import main
status = main(sys.argv[1:])
print(json.dumps([status, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024]))
"""


def measured(*words: str) -> dict[str, float]:
    """The most memory in bytes and the time in s of one command."""
    began = time.perf_counter()
    command, alone = [sys.executable, "-c", _WATCHED, *words], {"OMP_NUM_THREADS": "1"}
    env = os.environ | alone
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    status, held = json.loads(done.stdout.splitlines()[-1])
    if status:
        raise RuntimeError(f"splitband {' '.join(words)}: {done.stderr}")
    return {"bytes": held, "seconds": time.perf_counter() - began}


def record(samples: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Two oscillations under noise, and a simulator that knows the slow one."""
    t = 0.01 * np.arange(samples)
    slow = np.sin(2 * np.pi * 0.2 * t)
    noise = 0.1 * np.random.default_rng(0).standard_normal(samples)
    y = slow + 0.3 * np.sin(2 * np.pi * 3.1 * t) + noise
    return pd.DataFrame({"time": t, "y": y}), pd.DataFrame({"time": t, "y": 0.9 * slow})


def main() -> None:
    """Measure, print, and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    n = arguments.samples
    found: dict[str, dict[str, float]] = {"no command": measured("--help")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file, simulator = folder / "record.csv", folder / "simulator.parquet"
        past, ahead = record(2 * n)
        past[:n].to_csv(file, index=False)
        ahead.to_parquet(simulator)
        for method in METHODS:
            model = str(folder / method)
            simulated = ["--simulator", str(simulator)] if method.startswith("filtered") else []
            fitted = ("fit", str(file), "--method", method, "--out", model, *simulated)
            found[f"fit --method {method}, {n} samples"] = measured(*fitted)
            steps = ("--steps", str(n), "--history", str(file), "--out", f"{model}.csv")
            found[f"simulate {method}, {n} steps"] = measured("simulate", model, *steps, *simulated)
    for what, facts in found.items():
        print(f"{what}: {facts['bytes'] / 2**30:.2f} GiB, {facts['seconds']:.0f} s", flush=True)
    most = max(facts["bytes"] for facts in found.values())
    print(f"at most {most / 2**30:.2f} GiB of the {LIMIT / 2**30:g} GiB allowed")
    if arguments.out:
        machine = f"{platform.system()} {platform.machine()}"
        write_json(arguments.out, {"limit": LIMIT, "machine": machine, "commands": found})


if __name__ == "__main__":
    main()
