"""A simulation's samples depend on no input after their own time, and on no number of steps."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.signal
import torch

from splitband import GRU, ComplementaryPair
from splitband.filters import butterworth
from splitband.models import (
    FilteredHighModel,
    FilteredModel,
    Model,
    Recurrent,
    ResidualModel,
    Signals,
    SplitModel,
)
from splitband.networks import EulerMLP
from splitband.runtime.arrays import Array
from tests.support import Scripted
from tests.support import simulated as summed

WARMUPS, STEPS, NY, NU = (40, 47), 25, 2, 2
RNG = np.random.default_rng(7)
Y, Y_SIM = RNG.standard_normal((2, 50, NY)), RNG.standard_normal((47 + STEPS, NY))
U = RNG.standard_normal((47 + STEPS, NU))
PAIR = ComplementaryPair.butterworth(0.2, 10.0)
ONE_WAY = ComplementaryPair.perfect(*butterworth(0.5, 10.0, 2), 10.0)
UPPER = ComplementaryPair.perfect(*butterworth(0.5, 10.0, 2, "high"), 10.0, "high")


def gru(nu: int, told: int = 0) -> GRU:
    return GRU(5, NY, nu + told)


def split(k: int, conditioned: bool = False, hp: bool = False) -> Callable[[int], Model]:
    told = 2 * NY if conditioned else 0
    return lambda nu: SplitModel([gru(nu), gru(nu, told)], PAIR, k, hp, conditioned)


LEARNED: dict[str, Callable[[int], Model]] = {
    "gru": lambda nu: Recurrent(gru(nu)),
    "rnn": lambda nu: Recurrent(EulerMLP(NY, 40, 3, 6, 4, 0.3, nu)),
    **{f"split, k = {k}": split(k) for k in (1, 2, 5)},
    **{f"split, k = {k}, conditioned": split(k, conditioned=True) for k in (1, 3)},
}
FILTERED_AFTERWARDS = {"split + HP, k = 3": split(3, hp=True)}
HYBRID: dict[str, Callable[[int], Model]] = {
    "filtered": lambda nu: FilteredModel(gru(nu), ONE_WAY),
    "residual": lambda nu: ResidualModel(gru(nu)),
    "filtered high, k = 1": lambda nu: FilteredHighModel(gru(nu), UPPER),
    "filtered high, k = 3": lambda nu: FilteredHighModel(gru(nu), UPPER, 3),
    "filtered high, k = 3, conditioned": lambda nu: FilteredHighModel(gru(nu, 4), UPPER, 3, True),
}
CONDITIONED: dict[str, Callable[[int], Model]] = {
    "filtered, conditioned": lambda nu: FilteredModel(gru(nu, 4), ONE_WAY, conditioned=True),
    "residual, conditioned": lambda nu: ResidualModel(gru(nu, 4), conditioned=True),
}
AT_ONCE: dict[str, Callable[[int], Model]] = {
    "gru, feedthrough": lambda nu: Recurrent(gru(2 * nu), nu > 0),
    "rnn, feedthrough": lambda nu: Recurrent(EulerMLP(NY, 40, 3, 6, 4, 0.3, 2 * nu), nu > 0),
    "split, k = 3, feedthrough": lambda nu: SplitModel(
        [gru(nu), gru(2 * nu, 4)], PAIR, 3, conditioned=True, feedthrough=nu > 0
    ),
    "split, k = 1, feedthrough": lambda nu: SplitModel(
        [gru(2 * nu), gru(2 * nu)], PAIR, 1, feedthrough=nu > 0
    ),
    "residual, feedthrough": lambda nu: ResidualModel(gru(2 * nu), False, nu > 0),
    "filtered, feedthrough": lambda nu: FilteredModel(gru(2 * nu), ONE_WAY, False, nu > 0),
    "filtered high, conditioned, feedthrough": lambda nu: FilteredHighModel(
        gru(2 * nu, 4), UPPER, 1, True, nu > 0
    ),
}
ALL = LEARNED | FILTERED_AFTERWARDS | HYBRID | CONDITIONED | AT_ONCE


def built(name: str, nu: int) -> Model:
    """With large weights, so that what acts on an output is seen there."""
    torch.manual_seed(3)
    model = ALL[name](nu)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.mul_(2.0)
    return model


def simulated(
    model: Model, warmup: int, u: Array | None, y_sim: Array = Y_SIM, steps: int = STEPS
) -> Array:
    return summed(model, Y[0, :warmup], steps, u, y_sim if model.uses_simulator else None)


@pytest.mark.parametrize("name", ALL)
def test_an_input_acts_on_nothing_before_it(name: str) -> None:
    """To the bit; and it does act on what follows."""
    model = built(name, NU)
    for warmup in WARMUPS:
        before = simulated(model, warmup, U)
        for n in range(warmup + 1, warmup + STEPS, 3):
            changed, changed_sim = U.copy(), Y_SIM.copy()
            changed[n:] += 1
            changed_sim[n:] += 1
            after = simulated(model, warmup, changed, changed_sim)
            np.testing.assert_array_equal(after[: n - warmup], before[: n - warmup], err_msg=f"{n}")
        late = U.copy()
        late[warmup + 2] += 1
        assert (simulated(model, warmup, late)[-1] != before[-1]).any()


@pytest.mark.parametrize("name", AT_ONCE)
def test_with_feedthrough_an_input_acts_on_its_own_sample(name: str) -> None:
    """The first prediction too; without, it acts on the next one at the earliest."""
    model, plain = built(name, NU), built("gru", NU)
    for warmup in WARMUPS:
        for n in (warmup, warmup + 1, warmup + 9):
            changed = U.copy()
            changed[n] += 1
            at = n - warmup
            moved = simulated(model, warmup, changed) != simulated(model, warmup, U)
            assert moved[at].any()
            assert not moved[:at].any()
            moved = simulated(plain, warmup, changed) != simulated(plain, warmup, U)
            assert not moved[: at + 1].any()


@pytest.mark.parametrize("name", HYBRID | CONDITIONED)
def test_a_simulators_sample_acts_on_nothing_before_it_without_inputs_either(name: str) -> None:
    """A slope may look one sample ahead: the simulation depends on time alone, and is known."""
    model, warmup, ahead = built(name, 0), 40, int(name in CONDITIONED)
    before = simulated(model, warmup, None)
    for n in range(warmup + 1 + ahead, warmup + STEPS):
        changed = Y_SIM.copy()
        changed[n:] += 1
        after = simulated(model, warmup, None, changed)
        np.testing.assert_array_equal(after[: n - warmup - ahead], before[: n - warmup - ahead])


@pytest.mark.parametrize("nu", [0, NU])
@pytest.mark.parametrize("name", ALL)
def test_samples_do_not_depend_on_how_many_follow(name: str, nu: int) -> None:
    """Nor on inputs that are given for them."""
    if name in FILTERED_AFTERWARDS and not nu:
        pytest.skip("the paper's +HP filters the whole prediction forwards and backwards")
    model = built(name, nu)
    ahead = 1 if name in CONDITIONED and not nu else 0  # of the simulator, for its slope
    for warmup in WARMUPS:
        whole = simulated(model, warmup, U if nu else None)
        for steps in (1, 2, 3, 7, STEPS - 1):
            end = warmup + steps
            found = simulated(model, warmup, U[:end] if nu else None, Y_SIM[: end + ahead], steps)
            # Vector loops round the samples at their ends differently from those within.
            np.testing.assert_allclose(found, whole[:steps], rtol=0, atol=2e-6)


def silent(nu: int) -> Scripted:
    """A cell that says nothing and keeps its inputs."""
    return Scripted(torch.zeros(100, 1, dtype=torch.float64), 0, nu)


@pytest.mark.parametrize("k", [1, 2, 3, 7, 10])
def test_a_slow_band_is_given_the_mean_of_the_inputs_up_to_each_of_its_samples(k: int) -> None:
    """The moving average of SciPy, which stands still before the first sample."""
    for warmup in WARMUPS:
        low = silent(1)
        model = SplitModel([low, silent(1)], PAIR, k).double()
        u = torch.from_numpy(U[None, :, :1])
        model.components(Signals(torch.from_numpy(Y[:1, :warmup, :1]), u), STEPS)
        before = np.concatenate([np.full(k - 1, U[0, 0]), U[:, 0]])
        mean: Array = scipy.signal.lfilter(np.ones(k) / k, [1.0], before)[k - 1 :]
        expected = mean[warmup % k :: k]
        found = torch.cat(low.inputs)[:, 0].numpy()
        assert warmup // k < len(found) <= len(expected)
        np.testing.assert_allclose(found, expected[: len(found)], rtol=0, atol=1e-12)


def test_one_way_filters_have_the_square_root_of_the_gain() -> None:
    pair, frequencies = PAIR, np.linspace(0.01, 4.9, 20)
    for both, single in zip(
        pair.response(frequencies), pair.one_way().response(frequencies), strict=True
    ):
        np.testing.assert_allclose(abs(single) ** 2, both, rtol=1e-9)
    assert ONE_WAY.one_way() is ONE_WAY
