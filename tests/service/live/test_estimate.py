"""The running estimate: how it starts, goes on, and comes back."""

import json
from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from service.live.estimate import LiveEstimate, RunningModel
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import ThermalModel, build_model
from twin_core.observer import not_colder_than
from twin_core.simulation import OperatingProfile, simulate

START_US = 1_763_700_000_000_000
STEP_S = 30.0
AMBIENT_C = 23.0
REST = {
    "speed_rpm": 0.3,
    "load_n": 2650.0,
    "ambient_c": AMBIENT_C,
    "t_inner_ring_c": 23.4,
    "t_outer_ring_c": 22.9,
}
WARM = REST | {"speed_rpm": 2400.0, "t_inner_ring_c": 55.0, "t_outer_ring_c": 38.0}


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model("default", bearing=bearing("6311"))


@pytest.fixture
def estimate(model: ThermalModel) -> LiveEstimate:
    return LiveEstimate(RunningModel(1, model, prior_posterior(model), None))


def other_model(model: ThermalModel) -> RunningModel:
    """A version whose parameters differ a little from the priors."""
    prior = prior_posterior(model)
    document = prior.to_dict() | {"z": (prior.z + 0.3).tolist()}
    return RunningModel(2, model, type(prior).from_dict(document), START_US)


def at(seconds: float) -> int:
    return START_US + round(seconds * 1e6)


def follow(estimate: LiveEstimate, means: Mapping[str, float], from_s: float, to_s: float) -> float:
    """Take steps with the same readings; returns the time of the last."""
    time_s = from_s
    while time_s < to_s:
        time_s += STEP_S
        estimate.step(at(time_s), means)
    return time_s


def sensors(estimate: LiveEstimate) -> dict[str, float]:
    return {
        name: estimate.observer.sensor(name)[0] for name in ("t_inner_ring_c", "t_outer_ring_c")
    }


def spreads(estimate: LiveEstimate) -> NDArray[np.float64]:
    names = estimate.active.model.sensor_names
    return np.array([estimate.observer.sensor(name)[1] for name in names])


def test_nothing_is_assumed_before_a_temperature_has_come(estimate: LiveEstimate) -> None:
    estimate.step(at(0), {})
    estimate.step(at(5), {"speed_rpm": 0.0, "load_n": 0.0, "ambient_c": 23.0})
    assert not estimate.started
    assert estimate.to_dict() is None
    with pytest.raises(RuntimeError, match="has not started"):
        _ = estimate.observer


def test_nothing_is_assumed_before_speed_and_load_have_come(estimate: LiveEstimate) -> None:
    estimate.step(at(0), {"t_inner_ring_c": 23.0, "ambient_c": 23.0})
    assert not estimate.started


def test_a_standing_cold_machine_lies_at_ambient(estimate: LiveEstimate) -> None:
    estimate.step(at(0), REST)
    temperatures = estimate.observer.temperatures_c
    assert np.abs(temperatures - AMBIENT_C).max() < 0.5
    assert estimate.observer.std_c.max() < 0.7


def test_a_running_machine_is_not_taken_for_a_cold_one(estimate: LiveEstimate) -> None:
    estimate.step(at(0), WARM)
    assert sensors(estimate)["t_inner_ring_c"] == pytest.approx(55.0, abs=1.0)
    assert sensors(estimate)["t_outer_ring_c"] == pytest.approx(38.0, abs=1.0)
    # What no sensor sees is known less well than what one does.
    assert estimate.observer.std_c.max() > 2.0


def test_a_standing_machine_whose_ambient_nobody_measures_is_not_taken_for_cold(
    estimate: LiveEstimate,
) -> None:
    """It may have stopped a minute ago: both rings alike prove nothing."""
    hot = {"speed_rpm": 0.0, "load_n": 0.0, "t_inner_ring_c": 61.0, "t_outer_ring_c": 60.5}
    estimate.step(at(0), hot)
    assert estimate.observer.std_c.max() > 2.0


def test_without_an_ambient_sensor_the_coldest_reading_bounds_it(estimate: LiveEstimate) -> None:
    means = {name: value for name, value in WARM.items() if name != "ambient_c"}
    estimate.step(at(0), means)
    assert estimate.point is not None
    assert estimate.point.ambient_c == 38.0
    estimate.step(at(30), means | {"t_outer_ring_c": 31.0})
    assert estimate.point.ambient_c == 31.0
    estimate.step(at(60), means | {"t_outer_ring_c": 45.0})
    assert estimate.point.ambient_c == 31.0
    estimate.step(at(90), means | {"ambient_c": 24.0})
    assert estimate.point.ambient_c == 24.0
    estimate.step(at(120), means | {"t_outer_ring_c": 20.0})
    assert estimate.point.ambient_c == 24.0, "what was measured is kept"


def test_it_follows_the_machine(estimate: LiveEstimate, model: ThermalModel) -> None:
    """Fed with the sensors of another machine of the same kind, it comes onto them."""
    truth = other_model(model)
    time_s = np.arange(0.0, 5400.0 + STEP_S, STEP_S)
    machine = simulate(
        model,
        truth.values,
        OperatingProfile(time_s, *(np.full(time_s.size, v) for v in (2400.0, 2650.0, AMBIENT_C))),
        np.full(13, AMBIENT_C),
    )
    for row, time in enumerate(time_s.tolist()):
        readings = {
            name: float(machine.temperatures_c[row] @ model.sensor_row(name))
            for name in model.sensor_names
        }
        point = {"speed_rpm": 2400.0 if row else 0.0, "load_n": 2650.0, "ambient_c": AMBIENT_C}
        estimate.step(at(time), point | readings)
    assert sensors(estimate) == pytest.approx(readings, abs=0.3)
    errors = np.abs(estimate.observer.temperatures_c - machine.temperatures_c[-1])
    assert (errors < 3.0 * estimate.observer.std_c + 0.1).all()
    assert estimate.observer.revolutions == pytest.approx(2400.0 * 90, rel=0.01)


def test_lost_sensors_leave_the_point_held_and_the_spread_growing(estimate: LiveEstimate) -> None:
    time_s = follow(estimate, WARM, 0.0, 3600.0)
    known = spreads(estimate)
    follow(estimate, {}, time_s, time_s + 3600.0)
    assert estimate.point is not None
    assert estimate.point.speed_rpm == 2400.0
    assert estimate.time_us == at(time_s + 3600.0)
    assert (spreads(estimate) > 2.0 * known).all()


def test_a_short_gap_is_bridged(estimate: LiveEstimate) -> None:
    time_s = follow(estimate, WARM, 0.0, 3600.0)
    before = sensors(estimate)
    revolutions = estimate.observer.revolutions
    estimate.step(at(time_s + 1500.0), {})
    assert estimate.observer.revolutions == pytest.approx(revolutions + 2400.0 * 25)
    assert sensors(estimate) == pytest.approx(before, abs=3.0)


def test_after_a_long_gap_it_starts_anew_with_the_first_temperatures(
    estimate: LiveEstimate,
) -> None:
    time_s = follow(estimate, WARM, 0.0, 600.0)
    revolutions = estimate.observer.revolutions
    later_s = time_s + 7200.0
    estimate.step(at(later_s), {})
    assert not estimate.started, "an estimate of two hours ago is not one of now"
    cooler = WARM | {"t_inner_ring_c": 40.0, "t_outer_ring_c": 33.0}
    estimate.step(at(later_s + STEP_S), cooler)
    assert sensors(estimate)["t_inner_ring_c"] == pytest.approx(40.0, abs=1.0)
    assert estimate.observer.revolutions == revolutions, "the grease is no fresher for it"


def test_a_clock_set_back_does_not_stop_it(estimate: LiveEstimate) -> None:
    time_s = follow(estimate, WARM, 0.0, 4000.0)
    estimate.step(at(time_s - 10.0), WARM)
    assert estimate.time_us == at(time_s), "a little jitter is waited for"
    estimate.step(at(time_s - 3600.0), WARM)
    assert estimate.started
    assert estimate.time_us == at(time_s - 3600.0)


def test_stopped_it_waits_for_temperatures(estimate: LiveEstimate) -> None:
    time_s = follow(estimate, WARM, 0.0, 600.0)
    estimate.stop()
    estimate.step(at(time_s + STEP_S), {"speed_rpm": 2400.0})
    assert not estimate.started
    estimate.step(at(time_s + 2 * STEP_S), WARM)
    assert estimate.started


def test_a_swap_leaves_the_temperatures_as_they_are(
    estimate: LiveEstimate, model: ThermalModel
) -> None:
    follow(estimate, WARM, 0.0, 3600.0)
    before, revolutions = estimate.observer.temperatures_c, estimate.observer.revolutions
    estimate.swap(other_model(model))
    assert estimate.active.version == 2
    np.testing.assert_array_equal(estimate.observer.temperatures_c, before)
    np.testing.assert_array_equal(estimate.observer.values, other_model(model).values)
    assert estimate.observer.revolutions == revolutions


def test_a_swap_before_the_start_counts(estimate: LiveEstimate, model: ThermalModel) -> None:
    estimate.swap(other_model(model))
    estimate.step(at(0), REST)
    np.testing.assert_array_equal(estimate.observer.values, other_model(model).values)


def test_a_restored_estimate_goes_on_exactly_as_the_kept_one(
    estimate: LiveEstimate, model: ThermalModel
) -> None:
    """The heat disturbances that the observer has learned are part of it."""
    time_s = follow(estimate, WARM, 0.0, 3600.0)
    kept = json.loads(json.dumps(estimate.to_dict()))
    again = LiveEstimate(RunningModel(1, model, prior_posterior(model), None))
    again.restore(kept)
    for one in (estimate, again):
        follow(one, {}, time_s, time_s + 1200.0)
    np.testing.assert_allclose(
        again.observer.temperatures_c, estimate.observer.temperatures_c, rtol=1e-12
    )
    np.testing.assert_allclose(again.observer.std_c, estimate.observer.std_c, rtol=1e-9)
    assert again.observer.revolutions == estimate.observer.revolutions
    assert again.point == estimate.point


@pytest.mark.parametrize(
    "change",
    [
        {"observer": {"state": [20.0] * 13}},
        {"observer": None},
        {"speed_rpm": ...},
        {"time_us": "yesterday"},
        {"bearing": "6016"},
    ],
)
def test_what_cannot_be_restored_leaves_it_to_start_anew(
    estimate: LiveEstimate, model: ThermalModel, change: dict[str, object]
) -> None:
    estimate.step(at(0), REST)
    kept = (estimate.to_dict() or {}) | change
    kept = {name: value for name, value in kept.items() if value is not ...}
    again = LiveEstimate(RunningModel(1, model, prior_posterior(model), None))
    with pytest.raises(ValueError, match=r"observer|kept|invalid"):
        again.restore(kept)
    assert not again.started
    again.step(at(60), REST)
    assert again.started


# ---------------------------------------------------------------------- what is possible
def test_no_passive_body_is_colder_than_all_its_surroundings(estimate: LiveEstimate) -> None:
    """Rings at 36 and 58 °C in air of 22.7 °C had balls at 16 °C."""
    means = REST | {"ambient_c": 22.7, "t_inner_ring_c": 36.0, "t_outer_ring_c": 58.0}
    follow(estimate, means, 0.0, 4 * 3600.0)
    raw_c = estimate.observer.temperatures_c
    assert raw_c.min() < 22.2, "or this test shows nothing"
    assert estimate.temperatures_c.min() >= 22.7 - 1e-6
    rows = estimate.active.model.sensor_matrix(["t_inner_ring_c", "t_outer_ring_c"])
    assert rows @ estimate.temperatures_c == pytest.approx(rows @ raw_c, abs=0.5)


def test_a_machine_stays_colder_than_air_that_has_become_warmer(estimate: LiveEstimate) -> None:
    cold = REST | {"ambient_c": 12.0, "t_inner_ring_c": 12.0, "t_outer_ring_c": 12.0}
    follow(estimate, cold, 0.0, 600.0)
    follow(estimate, cold | {"ambient_c": 25.0}, 605.0, 1800.0)
    assert estimate.temperatures_c.max() < 14.0, "not as warm as the air"
    assert estimate.temperatures_c.min() >= 12.0 - 1e-6


def test_what_is_possible_is_never_further_from_a_possible_truth() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        factor = rng.normal(0.0, 3.0, (13, 13))
        covariance = factor @ factor.T + 0.01 * np.eye(13)
        truth_c = np.maximum(rng.normal(30.0, 8.0, 13), 23.0)
        mean_c = truth_c + np.linalg.cholesky(covariance) @ rng.standard_normal(13)
        inverse = np.linalg.inv(covariance)
        possible_c = not_colder_than(23.0, mean_c, covariance)
        assert possible_c.min() >= 23.0
        before, after = mean_c - truth_c, possible_c - truth_c
        # Not by much more than the bound itself is uncertain.
        assert after @ inverse @ after <= before @ inverse @ before + 13
