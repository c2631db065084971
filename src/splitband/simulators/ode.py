"""Use an ordinary differential equation as a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.options import Written

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Ode(Written):
    """Solve an ordinary differential equation by `scipy.integrate.solve_ivp`.

    Attributes
    ----------
    derivative : `f(t, x) -> dx/dt`.
    initial_state : x at the record's first sample.
    observe : Maps the states `(time, nx)` to the measured channels; the first state by default.
    rtol, atol : Tolerances of the solver.
    method : Its name for SciPy.
    key : As for `Function`; it stands for `derivative` and `observe`.
    """

    derivative: Callable[[float, Array], Any]
    initial_state: npt.ArrayLike
    observe: Callable[[Array], npt.ArrayLike] = lambda x: x[:, 0]
    rtol: float = 1e-8
    atol: float = 1e-10
    method: Literal["RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"] = "RK45"
    key: str | None = None

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Solve at the times `time` in s; raises RuntimeError if the solver fails."""
        solution = scipy.integrate.solve_ivp(
            self.derivative,
            (time[0], time[-1]),
            np.asarray(self.initial_state, float),
            method=self.method,
            t_eval=time,
            rtol=self.rtol,
            atol=self.atol,
        )
        if not solution.success:
            raise RuntimeError(f"the solver stopped at t = {solution.t[-1:]} s: {solution.message}")
        return self.observe(solution.y.T)

    def fingerprint(self) -> str | None:
        """Return the cache key: the key, the initial state and the solver's settings."""
        if self.key is None:
            return None
        state = np.asarray(self.initial_state, float).tolist()
        return f"{self.key} {state} {self.method} {self.rtol} {self.atol}"
