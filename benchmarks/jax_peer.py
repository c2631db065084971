"""jax-sysid on a record: errors on the test records as the CPU time of a training passes.

    PYTHON benchmarks/jax_peer.py SET TRAINING.npy TEST.npy ... --seconds 10 20 --seed 0

A script for an environment of its own, as jax-sysid 1.1 needs older versions of jax and SciPy than
the rest of the extra `bench`: it imports nothing of this package. `benchmarks.against` calls it.
A file holds a column of the input and one of the output.

Settings: x' = A x + B u + f(x, u), y = C x + D u + g(x, u), f and g a layer of tanh units each;
signals scaled to mean 0 and deviation 1, float64. A, B, C, D are those of jax-sysid's own linear
model, fitted first; output weights of f and g are near zero. Then Adam at 1e-3 and L-BFGS over the
whole record in one piece, until the time is over. The initial state of a test record is estimated
by `learn_x0` from its first samples: a smoother and then least squares.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import jax
import jax.numpy as jnp
import jax_sysid._model
import numpy as np
from jax_settings import SETTINGS, Setting
from jax_sysid.models import LinearModel, Model

jax.config.update("jax_enable_x64", True)
ENDLESS = 1_000_000
"""Evaluations of L-BFGS that no training gets to."""
KNOWN = 50
"""Samples at the beginning of a test record from which its first state is estimated."""
SMALL = 0.01
"""Deviation of the output weights of f and g at the beginning."""


class _OverError(Exception):
    """There is no later moment to look at."""


def state_fcn(x: Any, u: Any, params: Any) -> Any:
    """Return the next state."""
    a, b, _, _, hidden, bias, weights = params[:7]
    return a @ x + b @ u + weights @ jnp.tanh(hidden @ jnp.hstack((x, u)) + bias)


def output_fcn(x: Any, u: Any, params: Any) -> Any:
    """Return the output."""
    (c, d), (hidden, bias, weights, offset) = params[2:4], params[7:11]
    return c @ x + d @ u + weights @ jnp.tanh(hidden @ jnp.hstack((x, u)) + bias) + offset


class Run:
    """A training, looked at on its way."""

    def __init__(self, setting: Setting, files: list[Path], seed: int) -> None:
        self.setting, self.seed = setting, seed
        (u, y), *self.tests = (np.load(file).T for file in files)
        self.means, self.scales = (u.mean(), y.mean()), (u.std(), y.std())
        self.u, self.y = self._scaled(u, y)
        self.evaluations = 0

    def _scaled(self, u: Any, y: Any) -> tuple[Any, Any]:
        pairs = zip((u, y), self.means, self.scales, strict=True)
        scaled = [((x - mean) / scale)[:, None] for x, mean, scale in pairs]
        return scaled[0], scaled[1]

    def train(self, moments: list[float]) -> None:
        """Train until the last of the moments, in CPU seconds; print a point for each."""
        s, left = self.setting, sorted(moments)
        began = time.process_time()
        model, looked, looking = self._begun(), 0.0, False

        def watched(*_: Any) -> tuple[Any, None]:
            def look(z: Any) -> None:
                nonlocal looked, looking
                if looking:  # `learn_x0` minimises, too
                    return
                looking = True
                self.evaluations += 1
                at = time.process_time()
                seconds = at - began - looked
                while left and seconds >= left[0]:
                    left.pop(0)
                    self._print(model, z[:-1], seconds)
                looked += time.process_time() - at
                looking = False
                if not left:
                    raise _OverError

            return look, None

        jax_sysid._model.lbfgs_callback = watched
        model.loss(rho_x0=1e-8, rho_th=s.l2)
        model.optimization(
            adam_eta=1e-3, adam_epochs=s.adam, lbfgs_epochs=ENDLESS, iprint=-1, memory=20
        )
        try:
            model.fit(self.y, self.u)
        except _OverError:
            return
        self._print(model, model.params, time.process_time() - began - looked)

    def _begun(self) -> Model:
        """Return the model with the weights that it begins with."""
        s, draw = self.setting, np.random.default_rng(self.seed).standard_normal
        linear = LinearModel(s.states, 1, 1, feedthrough=True, seed=self.seed)
        linear.loss(rho_x0=1e-8, rho_th=1e-8)
        linear.optimization(adam_epochs=0, lbfgs_epochs=2000, iprint=-1)
        linear.fit(self.y[: s.linear], self.u[: s.linear])
        a, b, c, d = (np.asarray(x) for x in linear.params)
        layers = []
        for rows in (s.states, 1):
            first = draw((s.units, s.states + 1)) / np.sqrt(s.states + 1)
            layers += [first, 0.1 * draw(s.units), SMALL * draw((rows, s.units))]
        model = Model(s.states, 1, 1, state_fcn=state_fcn, output_fcn=output_fcn)
        model.init(params=[a, b, c, d, *layers, np.zeros(1)])
        return model

    def _print(self, model: Model, weights: Any, seconds: float) -> None:
        model.params = [np.asarray(each) for each in weights]
        point = {"library": "jax-sysid", "version": version("jax-sysid"), "seed": self.seed}
        point |= {"seconds": round(seconds, 1), "iterations": self.evaluations}
        errors = [self._error(model, *test) for test in self.tests]
        print(json.dumps(point | {"test_rmse": errors}), flush=True)

    def _error(self, model: Model, u: Any, y: Any) -> float:
        """Return the RMSE of what follows the first samples, in the unit of the file."""
        inputs, outputs = self._scaled(u, y)
        how = {"rho_x0": 1e-4, "verbosity": False, "LBFGS_refinement": True, "RTS_epochs": 3}
        x0 = model.learn_x0(inputs[:KNOWN], outputs[:KNOWN], **how)
        simulated, _ = model.predict(x0, inputs)
        wrong = self.scales[1] * np.asarray(simulated)[KNOWN:, 0] + self.means[1] - y[KNOWN:]
        return float(np.sqrt(np.mean(wrong**2)))


def main() -> None:
    """Train once, and print a line of JSON for each point."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", choices=[*SETTINGS])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--seconds", nargs="+", type=float, default=[10, 20, 40])
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    Run(SETTINGS[given.set], given.files, given.seed).train(given.seconds)


if __name__ == "__main__":
    main()
