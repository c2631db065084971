"""Networks of other settings that are trained in a forecaster's place, by seed."""

import numpy as np
import numpy.typing as npt

import splitband as sb

Array = npt.NDArray[np.float64]
SHORT = sb.Settings(window=20, warmup=5, epochs=1)


def test_a_simulator_of_its_own_is_run_once_for_all_of_them() -> None:
    calls: list[int] = []

    def swing(t: Array) -> Array:
        calls.append(len(t))
        return np.asarray(np.sin(3 * t))

    record = sb.Record(np.sin(0.3 * np.arange(60) - 0.1), 0.1)
    networks = [
        sb.Residual(sb.Simulation(sb.Function(swing)), sb.GRU(units), settings=SHORT)
        for units in (2, 3)
    ]
    first = networks[0]
    first.by_seed = {1: networks[1]}
    ready = first.simulated(record, 0)
    assert calls
    calls.clear()
    for seed in (0, 1):
        ready.for_seed(seed).clone().fit(record, seed=seed)
    assert not calls
