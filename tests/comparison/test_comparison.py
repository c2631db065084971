"""What is chosen and promised before any sample after the training part is looked at."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband import Record, TrainingSettings
from splitband.comparison.backtest import BacktestSpec, backtest
from splitband.comparison.defaults import default_names
from splitband.comparison.methods import Sizes
from splitband.comparison.plan import plan
from splitband.comparison.recommendation import Trial
from splitband.comparison.request import PlanRequest
from splitband.forecasters.bands import Bands
from splitband.forecasters.held_out import Origin
from splitband.forecasters.network import Network
from tests.signals import Setup
from tests.support import compare

DT, TRAIN, LENGTH, WARMUP = 0.1, 120, 200, 10
SETUP = Setup(
    TRAIN,
    TrainingSettings.paper(40, WARMUP, 1, 16),
    bands=Bands(0.6, 1, 2),
    sizes=Sizes(hidden_high=4, hidden_low=3),
)
SINES = ("persistence", "seasonal-naive", "harmonic")


def record(seed: int = 0, noise: float = 0.05) -> Record:
    rng = np.random.default_rng(seed)
    t = DT * np.arange(LENGTH)[:, None]
    y = np.sin(2 * np.pi * 0.2 * t) + 0.4 * np.sin(2 * np.pi * 1.13 * t)
    y_sim = 0.5 * y + 0.3
    return Record(y + noise * rng.standard_normal(y.shape), DT, y_true=y, y_sim=y_sim)


def test_the_trial_scores_by_what_was_measured() -> None:
    """Nobody has the noise-free samples."""
    known, unknown = (
        compare(r, ["mean"], SETUP).require_trial()
        for r in (record(), replace(record(), y_true=None))
    )
    assert known.errors == unknown.errors


@pytest.mark.parametrize(
    ("window", "warmup", "samples", "expected"),
    [
        (400, 50, 1000, 300),  # as the record does
        (160, 50, 1000, 150),  # a short one stays: what is tried is what is trained in the end
        (100, 50, 1000, 100),
        (80, 10, 120, 60),
        (60, 10, 120, 54),  # but it leaves two fifths of the record
        (80, 70, 120, 71),  # and is longer than the warm-up
    ],
)
def test_long_windows_shrink_with_the_record(
    window: int, warmup: int, samples: int, expected: int
) -> None:
    settings = TrainingSettings.paper(window, warmup, 1)
    network = replace(SETUP, settings=settings).forecaster("gru").for_trial(samples)
    assert isinstance(network, Network)
    assert network.settings == replace(settings, window=expected)


def test_the_trial_looks_at_nothing_after_the_training_part() -> None:
    methods = ["split-gru-conditioned", "simulator-affine", "seasonal-naive"]
    y = record().y.copy()
    y[TRAIN:] += 100
    expected = compare(record(), methods, SETUP).require_trial()
    found = compare(replace(record(), y=y), methods, SETUP).require_trial()
    assert found.recommended == expected.recommended
    assert found.intervals == expected.intervals
    assert found.errors == expected.errors


@pytest.mark.parametrize("simulated", [True, False])
def test_the_plan_looks_at_nothing_after_the_training_part(simulated: bool) -> None:
    r = record() if simulated else replace(record(), y_sim=None)
    y = r.y.copy()
    y[TRAIN:] += 100
    found, expected = (plan(PlanRequest(each, TRAIN)) for each in (replace(r, y=y), r))
    assert found.as_json() == expected.as_json()
    assert found.names == expected.names


@pytest.mark.parametrize("base", ["periodic", None])
def test_bands_that_are_given_hold_on_every_base(base: str | None) -> None:
    """Also where the fit of a base chooses what is not given."""
    method: Any
    r = record() if base is None else replace(record(), y_sim=None)
    (method,) = plan(
        PlanRequest(r, TRAIN, "filtered-gru", bands=Bands(1.5), simulator=base)
    ).methods
    assert method.bands.cutoff == 1.5


def test_a_simulator_that_does_not_help_leaves_what_needs_none_and_no_bands() -> None:
    useless = np.random.default_rng(1).standard_normal((LENGTH, 1))
    r = replace(record(), y_sim=useless)
    planned, alone = plan(PlanRequest(r, TRAIN)), plan(PlanRequest(replace(r, y_sim=None), TRAIN))
    assert planned.bands.choice is not None
    assert planned.bands.choice.simulator_helps is False
    assert planned.bands.cutoff is None
    assert {*planned.names} - {*alone.names} == {"simulator", "simulator-calibrated"}
    assert planned.names[0] == alone.names[0] == "gru"
    assert plan(PlanRequest(record(), TRAIN)).names == default_names(with_simulator=True)


def test_two_networks_are_compared_by_name_alone() -> None:
    alone = replace(record(), y_sim=None)
    driven = replace(alone, u=np.cumsum(alone.y, axis=0))
    for r in (alone, driven, record()):
        assert not [name for name in plan(PlanRequest(r, TRAIN)).names if name.startswith("split")]
    assert plan(PlanRequest(alone, TRAIN)).bands == Bands()
    says = r"cutoff must be left out .* two bands, got 0\.6: methods .* such as split-gru"
    with pytest.raises(sb.InputError, match=says):
        plan(PlanRequest(alone, TRAIN, bands=Bands(0.6)))
    (method,) = plan(PlanRequest(alone, TRAIN, "split-gru", bands=Bands(0.6))).methods
    assert method.get_params()["bands"].cutoff == 0.6


def test_a_simulator_that_helps_in_the_high_band_alone_is_tried_there() -> None:
    r = record()
    drifting = replace(r, y_sim=r.y + 0.5 * r.time[:, None])
    planned = plan(PlanRequest(drifting, TRAIN))
    above, kept = "filtered-high-state-space-conditioned", default_names(with_simulator=True)
    assert planned.names == [above if name.startswith("filtered") else name for name in kept]
    assert planned.as_json()["high"]["cutoff"] == planned.high.cutoff
    (method,) = (m for m in planned.methods if "high" in m.name)
    assert method.get_params()["bands"] is planned.high
    (alone,) = plan(PlanRequest(drifting, TRAIN, "filtered-high-gru", bands=Bands(order=2))).methods
    assert alone.get_params()["bands"].order == 2


class Damped:
    """A simulator that runs for as long as it is asked to."""

    def simulate(self, time: np.ndarray) -> np.ndarray:
        return 0.5 * np.sin(2 * np.pi * 0.2 * time) + 0.3


def test_a_simulator_is_run_beside_the_record_and_longer_where_it_is_calibrated() -> None:
    r = replace(record(), y_sim=None)
    usual = plan(PlanRequest(r, TRAIN, ["simulator"], simulator=Damped()))
    assert usual.record.y_sim is not None
    np.testing.assert_allclose(usual.record.y_sim[:, 0], Damped().simulate(r.time))
    calibrated = plan(PlanRequest(r, TRAIN, ["simulator"], simulator=Damped(), calibrate=True))
    assert calibrated.names == ["simulator", "simulator-calibrated"]
    assert calibrated.record.y_sim is not None
    assert len(calibrated.record.y_sim) > LENGTH
    hybrid = plan(PlanRequest(r, TRAIN, ["filtered-gru"], simulator="harmonic", conditioned=True))
    assert hybrid.names == ["filtered-harmonic-gru", "filtered-harmonic-gru-conditioned"]


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"methods": "filtered-gru"}, "simulator must be given for filtered-gru"),
        ({"methods": "linear"}, "inputs must be given for linear"),
        (
            {"methods": "gru", "device": "meta"},
            "device must be one that is there and has float64, got meta",
        ),
        ({"methods": "gru", "initial": 3}, "initial must be used with test records"),
        ({"simulator": "nothing.csv"}, "nothing.csv"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(asked: dict[str, Any], says: str) -> None:
    with pytest.raises((ValueError, FileNotFoundError), match=says):
        plan(PlanRequest(replace(record(), y_sim=None), TRAIN, **asked))


def test_a_record_with_inputs_is_compared_with_a_linear_model_too() -> None:
    u = np.random.default_rng(2).standard_normal((LENGTH, 1))
    r = replace(record(), u=u)
    methods = plan(PlanRequest(r, TRAIN)).names
    assert sorted(methods) == sorted(default_names(with_simulator=True, with_inputs=True))
    driven = replace(r, y=np.cumsum(0.3 * u - 0.1, axis=0), y_true=None)
    (found,) = compare(driven, ["linear"], SETUP).fits["linear"]
    assert "1 input and" in found.description


def test_methods_without_a_simulator_get_the_pair_they_would_get_without_one() -> None:
    alone = plan(PlanRequest(replace(record(), y_sim=None), TRAIN, ["split-gru"])).bands
    assert plan(PlanRequest(record(), TRAIN, ["split-gru", "mean"])).bands == alone
    assert plan(PlanRequest(record(), TRAIN, ["filtered-gru"])).bands != alone


def test_what_forecasts_the_held_out_part_best_is_recommended() -> None:
    trial = compare(record(), SINES, SETUP).require_trial()
    assert trial.recommended == "harmonic"
    methods = ["persistence", "seasonal-naive", "simulator", "simulator-affine"]
    simulated = compare(record(noise=0.3), methods, SETUP).require_trial()
    assert simulated.recommended == "simulator-affine"
    assert simulated.errors[simulated.recommended] == min(simulated.errors.values())


@pytest.mark.parametrize(("network", "chosen"), [(0.95, "harmonic"), (0.85, "gru")])
def test_a_network_has_to_be_a_tenth_better_than_what_needs_no_training(
    network: float, chosen: str
) -> None:
    scores = {"gru": network, "harmonic": 1.0, "mean": 1.2}
    trial = Trial({n: (s,) for n, s in scores.items()}, scores, frozenset({"gru"}))
    assert trial.recommended == chosen


def test_what_draws_nothing_runs_once() -> None:
    fits = compare(record(), ["gru", "mean"], SETUP, seeds=2).fits
    assert [fit.seed for fit in fits["gru"]] == [0, 1]
    assert len(fits["mean"]) == 1


def test_several_seeds_are_tried_out_by_their_median() -> None:
    r = record()
    trial = compare(r, ["gru"], SETUP, seeds=2).require_trial()
    part, shorter = r[:TRAIN], SETUP.forecaster("gru").for_trial(120)
    origins = [Origin(90, at) for at in (90, 100, 110)]
    spec = BacktestSpec(part, origins)
    found = [backtest(shorter, spec, seed).forecasts for seed in (0, 1)]
    medians = {o.at: np.median([each[o].y for each in found], axis=0) for o in origins}
    left = np.concatenate([part.y[start:] - y for start, y in medians.items()])
    assert trial.errors["gru"] == pytest.approx((np.sqrt(np.mean(left**2)),), rel=1e-5)


def test_each_channel_counts_the_same_in_the_recommendation() -> None:
    """In raw units the first channel would decide alone, for the mean."""
    noise = np.random.default_rng(0).standard_normal((LENGTH, 1))
    ramp = np.linspace(0, 1, LENGTH)[:, None]
    both = Record(np.hstack([1e6 * noise, ramp]), DT)
    trial = compare(both, ["mean", "persistence"], SETUP).require_trial()
    assert trial.errors["mean"][0] < trial.errors["persistence"][0]
    assert trial.recommended == "persistence"


def test_fits_to_too_few_samples_do_not_widen_an_interval() -> None:
    """A period of 40 samples is not found in 75, which hold less than two of them."""
    noise = 0.02 * np.random.default_rng(3).standard_normal((LENGTH, 1))
    season = np.sin(2 * np.pi * np.arange(LENGTH) / 40)[:, None] ** 3
    r = Record(season + noise, DT)
    found = compare(r, ["seasonal-naive"], SETUP)
    interval = found.require_trial().intervals["seasonal-naive"]
    assert interval.half_widths(1).max() < 0.15


def test_a_simulator_beside_a_record_that_has_the_output_of_one_is_refused() -> None:
    beside = sb.Recorded(record().y, DT)
    with pytest.raises(sb.InputError, match=r"simulator must be left out .*y_sim.* got both"):
        plan(PlanRequest(record(), TRAIN, ["mean"], simulator=beside))
