"""What the memory of a training on a long record costs in page faults and system time.

    python -m benchmarks.allocation [--out docs/benchmarks/allocation.json]

A GRU of 32 units learns 65,000 samples on one thread: windows of 100, 20 epochs of Adam and 30
iterations of L-BFGS. Each training is a process of its own; with and without
`runtime.memory.freed_memory_kept` they take turns.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import scipy

import splitband as sb
from benchmarks.timing import circumstances, write
from splitband.runtime import system
from splitband.runtime.threads import use_one_thread

SAMPLES = 65_000


def training(kept: bool) -> dict[str, float]:
    """Train in this process; what it took from the beginning of the training to its end."""
    use_one_thread()
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(SAMPLES // 10), 10)
    record = sb.Record(scipy.signal.lfilter([0.1, 0.05], [1, -1.6, 0.9], np.tanh(u)), 1.0, u=u)
    settings = sb.TrainingSettings(100, 33, 20, growth=0.0, max_batches=100, lbfgs_iterations=30)
    model = sb.Single(sb.GRU(32), settings)
    if not kept:
        system.glibc = lambda: None
    before = resource.getrusage(resource.RUSAGE_SELF)
    model.fit(record, seed=0)
    after = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "user, s": after.ru_utime - before.ru_utime,
        "system, s": after.ru_stime - before.ru_stime,
        "page faults": after.ru_minflt - before.ru_minflt,
        "peak, MiB": after.ru_maxrss / 1024,
    }


def main() -> None:
    """Measure, print, and write medians."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--here", choices=("before", "kept"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.here:
        print(json.dumps(training(arguments.here == "kept")))
        return
    found: dict[str, list[dict[str, float]]] = {"before": [], "kept": []}
    for _ in range(arguments.turns):
        for case, facts in found.items():
            words = [sys.executable, "-m", "benchmarks.allocation", "--here", case]
            done = subprocess.run(words, check=True, capture_output=True, text=True)
            facts.append(json.loads(done.stdout.splitlines()[-1]))
            print(case, facts[-1], flush=True)
    figures = circumstances("torch", "numba") | {
        case: {name: statistics.median(turn[name] for turn in facts) for name in facts[0]}
        for case, facts in found.items()
    }
    write(figures, arguments.out)


if __name__ == "__main__":
    main()
