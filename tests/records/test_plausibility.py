"""What is wrong in a record is said, with a way out that works, and nothing of a good record."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import scipy

import splitband as sb
from benchmarks import recommendation, sets
from splitband.records.named import RECORDS
from splitband.records.public import PUBLIC, fetch

Array = npt.NDArray[Any]
Generator = np.random.Generator
N, STEP = 2000, 0.1
INDEX = np.arange(float(N))


def held(rng: Generator, low: float = 0.0, high: float = 1.0, samples: int = 40) -> Array:
    """Levels, each held for so many samples."""
    return np.repeat(rng.uniform(low, high, N // samples + 1), samples)[:N]


def lag(u: Array, pole: float = 0.9) -> Array:
    return np.asarray(scipy.signal.lfilter([0, 1 - pole], [1, -pole], u))


def record(y: Array, u: Array | None = None) -> sb.Record:
    return sb.Record(y, STEP, u=u)


def noise(rng: Generator, deviation: float) -> Array:
    return rng.normal(0, deviation, N)


def driven(
    y: Callable[[Array, Generator], Array], *levels: Any
) -> Callable[[Generator], sb.Record]:
    """A record whose output is a function of held levels."""

    def make(rng: Generator) -> sb.Record:
        u = held(rng, *levels)
        return record(y(u, rng), u)

    return make


def heading(rng: Generator) -> sb.Record:
    """A boat's heading in degrees, which does not start again; its rudder."""
    rudder = held(rng, -25, 25)
    rate = scipy.signal.lfilter([0, 0.02], [1, -0.9], rudder)
    return record(180 + 0.5 * np.cumsum(rate) + noise(rng, 0.2), rudder)


def turned(of: Array, period: float, lowest: float = 0.0) -> sb.Record:
    return record((of - lowest) % period + lowest)


def spoilt(values: Any, count: int, on_input: bool = False) -> Callable[[Generator], sb.Record]:
    """A speed that follows a pedal, with other values at some samples."""

    def make(rng: Generator) -> sb.Record:
        u = held(rng, 0, 60) + 0.1 * on_input * noise(rng, 1)
        y = (lag(u) + noise(rng, 0.2)).round(1)
        (u if on_input else y)[rng.choice(N, count, replace=False)] = np.resize(values, count)
        return record(y, u)

    return make


def stuck(rng: Generator, begin: int = 700, samples: int = 60) -> sb.Record:
    u = held(rng, 0, 60)
    y = lag(u) + noise(rng, 0.2)
    y[begin : begin + samples] = y[begin]
    return record(y, u)


def copied(shift: int, digits: int = 15) -> Callable[[Generator], sb.Record]:
    """An output, and itself as an input, earlier (a negative shift) or later."""

    def make(rng: Generator) -> sb.Record:
        y = lag(held(rng)) + noise(rng, 0.02)
        return record(y, np.roll(y, shift).round(digits))

    return make


def beside_pressure(rng: Generator) -> sb.Record:
    u = held(rng)
    pressure = (6 + noise(rng, 0.003)).round(3)
    return record(lag(u) + noise(rng, 0.01), np.column_stack([u, pressure]))


FAULTS: dict[str, tuple[Callable[[Generator], sb.Record], str]] = {
    "heading": (lambda rng: turned(heading(rng).y[:, 0], 360), "jumps by 360 "),
    "crank": (lambda rng: turned(np.cumsum(0.9 + noise(rng, 0.05)), 2 * np.pi), "jumps by 6.28"),
    "16 bits, scaled": (
        lambda rng: record(np.cumsum(rng.integers(20, 90, N)) % 2**16 * 0.1),
        "jumps by 6553.6 ",
    ),
    "32 bits": (
        lambda rng: turned(2**32 - 60_000 + np.cumsum(rng.integers(20, 90, N)), 2**32),
        "jumps by 4294967296 ",
    ),
    "65535 at 0.1": (spoilt(6553.5, 8), r"outliers, 6553.5 in 8 of 2000.*--missing 6553.5 "),
    "two of them": (spoilt([-32768, 65535], 10), "outliers, -32768, 65535 in 10 "),
    "spikes": (
        spoilt([*np.linspace(-900, -300, 15), *np.linspace(300, 880, 15)], 30),
        "outliers, -900 to 880 in 30 ",
    ),
    "of an input": (spoilt(6553.5, 5, on_input=True), "'u' has outliers, 6553.5 in 5 "),
    "constant": (driven(lambda u, rng: np.full(N, 3.2)), "'y' is constant, 3.2"),
    "stuck": (stuck, r"stays stuck at \S+ in 60 samples \(rows 700 to 759\)"),
    "stuck at the end": (lambda rng: stuck(rng, 1800, 200), "stays stuck at .* in 200 samples"),
    "saturated": (
        driven(lambda u, rng: np.minimum(lag(u) + noise(rng, 0.2), 45), 0, 60),
        "'y' stays at its highest value, 45, in ",
    ),
    "clipped tones": (
        lambda rng: record(np.clip(np.sin(INDEX / 20) + 0.3 * np.sin(INDEX / 7.7), -1, 2)),
        "'y' stays at its lowest value, -1, in ",
    ),
    "hardly moves": (beside_pressure, "'u1' hardly moves: it is from 5.9"),
    "the output itself": (copied(0), "'u' is 'y', noise included"),
    "the output, later": (copied(-3, 2), r"'u' is 'y' of 3 sample\(s\) later"),
    "an input written late": (
        driven(lambda u, rng: np.roll(lag(u), -4) + noise(rng, 0.002)),
        r"'y' moves before 'u', by up to 3 sample",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_said_in_one_sentence(name: str) -> None:
    make, said = FAULTS[name]
    found = [make(np.random.default_rng(seed)).warnings() for seed in (1000, 1001)]
    for sentences in found:
        assert len(sentences) == 1
        assert re.search(said, sentences[0])


def thermostat(rng: Generator) -> sb.Record:
    y, u = np.full(N, 15.0), np.zeros(N)
    for i in range(1, N):
        u[i] = y[i - 1] < 19.5 or (u[i - 1] and y[i - 1] < 20.5)
        y[i] = y[i - 1] + 0.02 * (5 - y[i - 1]) + 0.6 * u[i]
    return record((y + noise(rng, 0.02)).round(1), u)


def loop(rng: Generator, highest: float = np.inf, digits: int = 15) -> sb.Record:
    """A lag behind a PI controller, which saturates; the reference changes."""
    reference, y, u, whole = held(rng, 20, 80, 100), np.zeros(N), np.zeros(N), 0.0
    for i in range(1, N):
        y[i] = 0.95 * y[i - 1] + 0.02 * u[i - 1]
        error = reference[i] - y[i] + rng.normal(0, 0.1)
        u[i] = np.clip(20 * error + whole, 0, highest).round(digits)
        whole = np.clip(whole + 0.5 * error, 0, highest)
    return record(y + noise(rng, 0.1), u)


def friction(speed: bool, digits: int = 15) -> Callable[[Generator], sb.Record]:
    """A mass that sticks while the force is small: its position or speed."""

    def make(rng: Generator) -> sb.Record:
        u, v, x, found = held(rng, -1, 1), 0.0, 0.0, []
        for force in u:
            for _ in range(5):
                sign = np.sign(v) if v else np.sign(force)
                rate = 0.0 if v == 0 and abs(force) < 0.3 else force - 0.3 * sign - 0.5 * v
                after = v + 0.02 * rate
                v = 0.0 if after * v < 0 else after
                x += 0.02 * v
            found.append(v if speed else x)
        return record(np.array(found).round(digits), u)

    return make


def hammer(rng: Generator) -> sb.Record:
    u = noise(rng, 0.1)
    for at in rng.choice(N - 10, 6):
        u[at : at + 3] += rng.uniform(200, 500) * np.array([0.4, 1, 0.3])
    return record(scipy.signal.lfilter([1, -1], [1, -1.6, 0.8], u) + noise(rng, 0.5), u)


def inrush(rng: Generator) -> sb.Record:
    on = np.cumsum(rng.random(N) < 0.02) % 2.0
    peaks = np.maximum(np.diff(on, prepend=0), 0) * rng.uniform(32, 48, N)
    return record(5 * on + peaks + noise(rng, 0.1), on)


def rests(rng: Generator) -> sb.Record:
    u = held(rng, -1, 1, 50)
    u[:200] = u[400:700] = u[1300:1700] = 0
    return record(lag(u, 0.8).round(4), u)


def multisine(rng: Generator, high: float) -> Array:
    share = np.fft.rfftfreq(N) * 2
    phases = np.exp(2j * np.pi * rng.random(len(share))) * ((share > 0) & (share < high))
    return np.asarray(np.fft.irfft(phases, N) * N**0.5)


LOOKALIKES: dict[str, Callable[[Generator], sb.Record]] = {
    "PWM that saturates": lambda rng: loop(rng, 255, 0),
    "0 and 360, switched": lambda rng: record(360 * (np.sin(INDEX / 14) > 0) + noise(rng, 0.1)),
    "unwrapped": heading,
    "filled and emptied": lambda rng: record(INDEX % 345 + noise(rng, 0.2)),
    "hour of the day": lambda rng: record(lag(noise(rng, 1)), INDEX % 24),
    "hammer": hammer,
    "inrush": inrush,
    "heavy tails": lambda rng: record(rng.standard_t(3, N)),
    "ADC of 8 bits": driven(lambda u, rng: (128 + 60 * lag(u) + noise(rng, 2)).round(), -1, 1),
    "rests": rests,
    "sticks, encoder": friction(speed=False, digits=3),
    "stops": friction(speed=True, digits=3),
    "thermostat": thermostat,
    "kelvins": lambda rng: record(lag(u := 293 + np.cumsum(noise(rng, 0.01))), u),
    "two levels": lambda rng: record(lag(u := np.where(INDEX < 1000, 0.05, 0.06)).round(4), u),
    "controlled": loop,
    "a servo": lambda rng: record(
        np.append(0, (u := np.cumsum(lag(noise(rng, 1), 0.95)))[:-1]) + noise(rng, 1e-3), u
    ),
    "a delay": driven(lambda u, rng: np.roll(u, 3) + noise(rng, 0.02)),
    "a resonance": lambda rng: record(
        scipy.signal.lfilter([0, 1], [1, -1.95, 0.96], u := multisine(rng, 0.1)), u
    ),
}


@pytest.mark.parametrize("name", LOOKALIKES)
def test_nothing_is_said_of_a_record_without_faults(name: str) -> None:
    for seed in (1000, 1001, 1002):
        assert LOOKALIKES[name](np.random.default_rng(seed)).warnings() == []


def of(name: str, made: sb.Record) -> list[str]:
    """The name of the record with the beginning of each of its warnings."""
    return [f"{name}: {' '.join(said.split()[:6])}" for said in made.warnings()]


@pytest.mark.usefixtures("public_data")
def test_of_the_public_records_two_touch_a_rail() -> None:
    files = {f[0]: f for each in sets.SETS.values() for f in (each.training, *each.tests)}
    every = {name: sets.load(file) for name, file in files.items()}
    every |= {name: named.make() for name, named in RECORDS.items()}
    every |= {
        name: sb.read(fetch(name), sampling_time=p.sampling_time) for name, p in PUBLIC.items()
    }
    assert [said for name, made in every.items() for said in of(name, made)] == [
        "ct_train: 'y' stays at its highest value,",
        "ct_test: 'y' stays at its highest value,",
    ]


@pytest.mark.soak
@pytest.mark.usefixtures("public_data")
def test_nothing_is_said_of_the_drawn_records() -> None:
    parts = Path()
    jobs = recommendation.jobs(range(1000, 1005), True, "baselines", parts)
    jobs += recommendation.jobs(range(1005, 1008), False, "default", parts)
    assert len(jobs) == 120 + 66
    assert [said for job in jobs for said in of(job.name, job.record())] == []


def fit(made: sb.Record, clean: sb.Record) -> float:
    """Fit % of a linear model on another record, which has no faults."""
    model = sb.Linear().fit(made)
    known = clean[:50].like(made)
    found = model.predict(len(clean) - 50, known, clean.u[50:], other_record=True)
    return float(sb.fit_percent(clean.y[50:], found.y)[0])


def read_again(made: sb.Record, **options: Any) -> sb.Record:
    frame = pd.DataFrame({"time": made.time.round(1), "u": made.u[:, 0], "y": made.y[:, 0]})
    return sb.read(frame, inputs="u", **options)


@pytest.mark.parametrize("name", ["65535 at 0.1", "stuck", "saturated"])
def test_what_is_left_out_as_missing_leads_to_the_right_model(name: str) -> None:
    make, _ = FAULTS[name]
    made, rng = make(np.random.default_rng(1)), np.random.default_rng(2)
    clean = driven(lambda u, rng: lag(u), 0, 60)(rng)
    (said,) = made.warnings()
    words = re.search(r"missing=\['([^']+)'\], gaps='mask'", said)
    mended = read_again(made, missing=words[1], gaps="mask")
    assert mended.warnings() == []
    assert fit(mended, clean) > max(98, fit(made, clean))


@pytest.mark.parametrize("name", ["65535 at 0.1", "spikes"])
def test_outliers_that_are_limited_lead_to_the_right_model(name: str) -> None:
    made = FAULTS[name][0](np.random.default_rng(1))
    clean = driven(lambda u, rng: lag(u), 0, 60)(np.random.default_rng(2))
    assert "clip_outliers(columns=['y']) (--clip-outliers y)" in made.warnings()[0]
    limited = made.clip_outliers(columns=["y"])
    assert limited.warnings() == []
    assert fit(limited, clean) > 95 > fit(made, clean)


def test_an_input_that_is_shifted_is_in_time() -> None:
    u = held(np.random.default_rng(1))
    late = record(lag(u)[4:], u[:-4])
    early = re.search(r"by up to (\d) sample", late.warnings()[0])
    shifted = record(late.y[: -int(early[1]), 0], u[int(early[1]) : -4])
    assert shifted.warnings() == []
    assert fit(shifted, record(lag(u)[1:], u[:-1])) > 99


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
def test_an_angle_goes_on_in_history_prediction_and_file(tmp_path: Path) -> None:
    whole, other = (heading(np.random.default_rng(seed)) for seed in (1, 2))
    wrapped, past = (sb.Record(r.y % 360, STEP, u=r.u) for r in (whole, other))
    (said,) = wrapped.warnings()
    assert "unwrap={'y': 360} (--unwrap y=360)" in said
    record = wrapped.unwrap("y")
    np.testing.assert_allclose(record.y, whole.y - 360 * np.floor(whole.y[0] / 360), atol=1e-9)
    assert record.warnings() == []
    sb.Linear().fit(record).save(tmp_path / "model")
    model, u = sb.load(tmp_path / "model"), other.u
    assert model.fitted.record.reading.periods == {"y": 360}
    known = past[:50].like(model.fitted.record)
    found = model.predict(N - 50, known, u[50:], other_record=True).y
    expected = other.y[50:] - 360 * np.floor(other.y[0] / 360)
    assert float(sb.fit_percent(expected, found)[0]) > 99
    stream = model.stream(known, other_record=True)
    np.testing.assert_allclose([stream.step(row) for row in u[50:80]], found[:30], atol=1e-6)


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
def test_inputs_simulators_and_gaps_of_an_angle_go_on_too() -> None:
    turning = 7.0 * np.arange(300) + 355
    y = np.where(np.arange(300) % 50 == 1, np.nan, turning % 360)
    made = sb.Record.with_gaps(y, STEP, u=turning % 360, y_sim=(turning + 6) % 360)
    found = made[:200].unwrap({"y": None, "u": 360})
    np.testing.assert_allclose(found.y[:, 0], turning[:200])
    for signal, ahead in ((found.u, 0), (found.y_sim, 6)):
        np.testing.assert_allclose(signal[:, 0], turning[:200] + ahead)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"yaw": 360}, "must name one of y, u, got yaw"),
        ("u", r"must give the period of 'u', .* \(--unwrap u=360\)"),
        ({"y": 90}, "'y' a period of 359.* at least, which is its range, got 90"),
        ({"y": np.nan}, "got nan"),
    ],
)
def test_a_period_that_cannot_be_is_refused(asked: Any, said: str) -> None:
    rng = np.random.default_rng(1)
    made = sb.Record(heading(rng).y % 360, STEP, u=held(rng))
    with pytest.raises(ValueError, match=said):
        made.unwrap(asked)
    with pytest.raises(ValueError, match="unwrap must come once, in the order"):
        made.detrend().unwrap({"y": 360})


def test_a_missing_hour_where_clocks_are_put_forward_is_said() -> None:
    for day, said in (("2024-03-30", 1), ("2024-03-28", 0)):
        stamps = pd.date_range(f"{day} 12:00", periods=1600, freq="min", tz="Europe/Berlin")
        local = stamps.tz_localize(None)
        if not said:
            local = local[(local.hour != 2) | (local.day == 28)]
        table = pd.DataFrame({"time": local, "y": np.sin(np.arange(len(local)) / 30)})
        found = sb.read(table, gaps="mask").warnings()
        assert len([each for each in found if "an hour is missing at" in each]) == said
