"""The linear baseline, against linear systems of SciPy."""

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

import splitband as sb
from splitband.baselines import channel
from splitband.baselines.channel import stable
from splitband.baselines.linear import OutputError
from splitband.runtime.deadlines import Deadline, within

Array = npt.NDArray[np.float64]
TRAIN, LENGTH = 400, 600


def polynomial(roots: npt.ArrayLike) -> Array:
    return np.real(np.poly(np.asarray(roots))).astype(np.float64)


def inputs(samples: int = LENGTH, nu: int = 1, seed: int = 0) -> Array:
    """Steps of random height and length."""
    rng = np.random.default_rng(seed)
    u: Array = rng.standard_normal((samples, nu))
    held = np.maximum.accumulate(np.where(rng.random(samples) < 0.2, np.arange(samples), 0))
    return u[held]


def oscillators(u: Array, begin: float = 0.0) -> Array:
    """Two masses driven by all inputs, their two positions; SciPy's simulation."""
    a = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-9, 4, -0.4, 0.1], [4, -6, 0.1, -0.3]])
    b = np.zeros((4, u.shape[1]))
    b[2:] = np.arange(1, 2 * u.shape[1] + 1).reshape(2, -1)
    c = np.eye(2, 4)
    system = scipy.signal.cont2discrete((a, b, c, np.zeros((2, u.shape[1]))), 0.2)
    _, y, _ = scipy.signal.dlsim((*system[:4], 0.2), u, x0=begin * np.arange(1, 5))
    return np.asarray(y)


@pytest.mark.parametrize(("nu", "begin"), [(1, 0.0), (2, 1.0)], ids=["at rest", "in motion"])
def test_a_linear_system_is_found_and_goes_on_as_it_does(nu: int, begin: float) -> None:
    u = inputs(nu=nu)
    y = oscillators(u, begin)
    found = OutputError.fit(y[:TRAIN], u[:TRAIN])
    np.testing.assert_allclose(found.simulate(u), y, atol=1e-5)


def test_units_and_offsets_do_not_matter() -> None:
    u, noise = inputs(), np.random.default_rng(1).standard_normal((LENGTH, 2))
    y = oscillators(u) + 0.01 * noise
    plain = OutputError.fit(y[:TRAIN], u[:TRAIN]).simulate(u)
    moved_u = 300 - 50 * u
    moved = OutputError.fit(1e6 + 1e-3 * y[:TRAIN], moved_u[:TRAIN]).simulate(moved_u)
    np.testing.assert_allclose(moved, 1e6 + 1e-3 * plain, atol=1e-6)


@pytest.mark.parametrize(
    ("of_two", "poles"),
    [([0.9, 0.91, 0.9, 0.92, 0.9, 0.9], 2), ([1.05, 1.02, 1.04, 1.1, 0.98, 0.3], 1)],
    ids=["a little from every origin", "much from one origin"],
)
def test_more_poles_are_taken_only_where_they_pay(
    monkeypatch: pytest.MonkeyPatch, of_two: list[float], poles: int
) -> None:
    errors = {2: np.array(of_two)}
    monkeypatch.setattr(channel, "_held_out", lambda parts, order: errors.get(order, np.ones(6)))
    u = inputs()
    found = OutputError.fit(oscillators(u)[:TRAIN, :1], u[:TRAIN])
    assert len(found.channels[0].a) - 1 == poles


def test_what_was_not_measured_is_gone_around() -> None:
    u, noise = inputs(), np.random.default_rng(1).standard_normal((LENGTH, 2))
    y = oscillators(u, 1.0)
    seen = y + 0.1 * noise
    seen[:20] = seen[100:150] = seen[200:240, 1] = seen[390:400] = np.nan
    found = OutputError.fit(seen[:TRAIN], u[:TRAIN]).simulate(u)[TRAIN:]
    assert np.sqrt(np.mean((found - y[TRAIN:]) ** 2)) < 0.04


def test_the_poles_are_those_of_the_system() -> None:
    a = polynomial([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j)])
    u = inputs()
    y = scipy.signal.lfilter([0.5, -0.2], a, u[:, 0])[:, None] + 3
    (channel,) = OutputError.fit(y[:TRAIN], u[:TRAIN]).channels
    poles = np.roots(channel.a)
    for pole in np.roots(a):
        assert abs(poles - pole).min() < 1e-5


def test_of_a_long_record_the_end_is_fitted() -> None:
    u = inputs(9000)
    y = oscillators(u, 1.0)
    y[:3000] = 5 * np.sin(np.arange(3000))[:, None]
    found = OutputError.fit(y[:8500], u[:8500]).simulate(u)
    np.testing.assert_allclose(found[8500:], y[8500:], atol=1e-5)
    np.testing.assert_allclose(found[5000:], y[5000:], atol=1e-4)


@pytest.mark.parametrize("pole", [0.999])
def test_what_has_died_out_before_the_samples_that_are_fitted_is_not_made_up(pole: float) -> None:
    rng = np.random.default_rng(3)
    u = rng.standard_normal((9000, 1))
    y = scipy.signal.lfilter([1 - pole], [1, -pole], u[:, 0])[:, None]
    noisy = y + 0.1 * y.std() * rng.standard_normal(y.shape)
    found = OutputError.fit(noisy[:8500], u[:8500]).simulate(u)
    assert np.sqrt(np.mean((found - y) ** 2)) < 0.2 * y.std()


def test_an_input_that_was_stronger_before_still_counts() -> None:
    u = inputs(9000)
    u[:3000] *= 50
    y = oscillators(u)
    found = OutputError.fit(y[:8500], u[:8500]).simulate(u)[8500:]
    np.testing.assert_allclose(found, y[8500:], atol=1e-5)


@given(poles=st.lists(st.floats(0, 5), min_size=1, max_size=4), angle=st.floats(0.1, 3))
def test_no_pole_stays_outside_of_the_unit_circle(poles: list[float], angle: float) -> None:
    pair = np.array(poles) * np.exp(1j * angle)
    found = np.roots(stable(polynomial([*pair, *pair.conj()])))
    assert (abs(found) <= 1).all()


@pytest.mark.parametrize("radius", [0.5, 0.9, 1.05, 1.5, 4.0])
def test_a_pole_and_its_mirror_image_have_one_angle_and_inverse_radii(radius: float) -> None:
    inside = min(radius, 1 / radius)
    found = stable(polynomial([radius * np.exp(0.7j), radius * np.exp(-0.7j), 0.3]))
    expected = polynomial([inside * np.exp(0.7j), inside * np.exp(-0.7j), 0.3])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("poles", [[1.0001] * 8, [1.00001] * 6, np.linspace(1, 1.01, 8)])
def test_poles_close_to_each_other_come_inside_too(poles: npt.ArrayLike) -> None:
    assert (abs(np.roots(stable(polynomial(poles)))) <= 1).all()


def test_a_stable_denominator_stays() -> None:
    a = polynomial([0.5, -0.9, 0.99])
    np.testing.assert_array_equal(stable(a), a)


@settings(max_examples=settings().max_examples // 6)
@given(
    samples=st.integers(1, 30), nu=st.integers(1, 3), seed=st.integers(0, 99), same=st.booleans()
)
def test_short_and_constant_records_give_finite_numbers(
    samples: int, nu: int, seed: int, same: bool
) -> None:
    rng = np.random.default_rng(seed)
    u = np.ones((samples + 20, nu)) if same else rng.standard_normal((samples + 20, nu))
    for y in (np.full((samples, 1), 7.0), rng.standard_normal((samples, 1))):
        assert np.isfinite(OutputError.fit(y, u[:samples]).simulate(u)).all()
    constant = OutputError.fit(np.full((samples, 1), 7.0), u[:samples])
    np.testing.assert_allclose(constant.simulate(u)[samples:], 7, atol=1e-6)


def test_a_further_record_may_be_shorter_than_the_model_is_long() -> None:
    u = inputs()
    whole = sb.Record(oscillators(u), 0.2, u=u)
    fitted = sb.Linear().fit(whole[:TRAIN], whole[TRAIN : TRAIN + 3])
    np.testing.assert_allclose(
        fitted.predict(50, whole[:TRAIN], u=u[TRAIN : TRAIN + 50]).y,
        whole.y[TRAIN : TRAIN + 50],
        atol=0.1,
    )


def test_after_the_deadline_it_is_a_model_of_one_pole_and_says_that_it_was_cut() -> None:
    u = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 60), 10)
    y = scipy.signal.lfilter([0.0, 0.1], [1.0, -0.9], u)
    record = sb.Record(y, 0.1, u=u[:, None])
    with within(Deadline.after(-1.0)):
        late = sb.Linear().fit(record)
    assert late.require_fitted().report.cut
    assert late.poles() == pytest.approx([0.9], abs=1e-6)
    assert not sb.Linear().fit(record).require_fitted().report.cut
