import json

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.initial_state import initial_state
from twin_core.models import ThermalModel, build_model
from twin_core.observer import Observer
from twin_core.simulation import OperatingProfile, simulate, steady_state

AMBIENT = 22.6
SENSORS = ("t_inner_ring_c", "t_outer_ring_c")
STAGE_S = 3600.0
STAGES = ((1500.0, 2650.0), (4200.0, 2650.0), (6200.0, 2650.0), (6200.0, 4500.0))
STEP_S = 10.0


def _truth() -> tuple[OperatingProfile, np.ndarray, np.ndarray]:
    """A bench with another friction law, contacts twice as bad and 60 % more viscous friction."""
    bench = build_model("paper", bearing=bearing("6311"))
    values = bench.parameters.centre.copy()
    values[bench.parameters.index("f2")] *= 1.6
    values[bench.parameters.index("Kc2")] *= 2.0
    time = np.arange(0.0, len(STAGES) * STAGE_S + 1.0, STEP_S)
    stage = np.minimum(time // STAGE_S, len(STAGES) - 1).astype(int)
    speed, load = np.array(STAGES)[stage].T
    profile = OperatingProfile(time, speed, load, np.full(time.size, AMBIENT))
    states = simulate(bench, values, profile, np.full(13, AMBIENT)).temperatures_c
    return profile, states, states @ bench.sensor_matrix(SENSORS).T


def _cold(model: ThermalModel) -> Observer:
    values = model.parameters.centre
    readings = dict.fromkeys(SENSORS, AMBIENT)
    return Observer(model, values, *initial_state(model, values, readings, AMBIENT, 0.0, 0.0, True))


def _follow(observer: Observer, every: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feed a mismatched bench; errors at the sensors, standard deviations, all estimates."""
    profile, states, readings = _truth()
    rng = np.random.default_rng(8)
    errors, spreads, estimates = [], [], []
    for row in range(1, profile.size):
        observer.predict(STEP_S, profile.speed_rpm[row - 1], profile.load_n[row - 1], AMBIENT)
        if row % every == 0:
            measured = np.round((readings[row] + rng.normal(0.0, 0.05, 2)) * 10.0) / 10.0
            observer.update(dict(zip(SENSORS, measured.tolist(), strict=True)))
        errors.append([observer.sensor(name)[0] for name in SENSORS] - readings[row])
        spreads.append([observer.sensor(name)[1] for name in SENSORS])
        estimates.append(observer.temperatures_c - states[row])
    return np.array(errors), np.array(spreads), np.array(estimates)


@pytest.mark.parametrize(("every", "worst_k", "rms_k"), [(1, 1.0, 0.12), (6, 4.0, 0.25)])
def test_it_follows_a_bench_that_its_model_does_not_match(
    model: ThermalModel, every: int, worst_k: float, rms_k: float
) -> None:
    profile, _, readings = _truth()
    blind = simulate(model, model.parameters.centre, profile, np.full(13, AMBIENT))
    blind_error = blind.temperatures_c[1:] @ model.sensor_matrix(SENSORS).T - readings[1:]
    assert np.abs(blind_error).max() > 8.0  # the mismatch is real
    errors, spreads, nodes = _follow(_cold(model), every)
    assert np.abs(errors).max() < worst_k  # in the first readings after a step
    assert (np.quantile(np.abs(errors), 0.95, axis=0) < 2.0 * rms_k).all()
    assert (np.sqrt((errors**2).mean(axis=0)) < rms_k).all()
    # smooth: it follows the bench from step to step, not the sensors' noise
    assert (np.diff(errors, axis=0).std(axis=0) < 0.7 * rms_k).all()
    assert spreads.max() < 1.1
    assert np.abs(nodes[-1, [0, 3, 7, 8]]).max() < 1.0


def test_unmeasured_nodes_have_an_honest_spread(model: ThermalModel) -> None:
    observer = _cold(model)
    _, _, nodes = _follow(observer, 6)
    scaled = nodes[-1] / observer.std_c
    assert observer.std_c[2] > 5.0 * observer.std_c[3]  # balls against inner ring
    assert np.sqrt((scaled**2).mean()) < 2.5


def test_without_sensors_the_spread_grows_and_stays_finite(model: ThermalModel) -> None:
    observer = _cold(model)
    _follow(observer, 6)
    spread = [observer.sensor(SENSORS[0])[1]]
    for _ in range(12):
        for _ in range(60):
            observer.predict(60.0, 6200.0, 4500.0, AMBIENT)
        spread.append(observer.sensor(SENSORS[0])[1])
    assert (np.diff(spread) > -0.01).all()
    assert spread[1] > 2.0
    assert 4.0 < spread[-1] < 15.0
    assert spread[-1] - spread[-2] < 0.1
    # and it comes back with the first readings
    observer.update({SENSORS[0]: 70.0, SENSORS[1]: 50.0})
    assert observer.sensor(SENSORS[0])[1] < 0.2
    assert observer.sensor(SENSORS[0])[0] == pytest.approx(70.0, abs=0.3)


def test_forced_readings_never_make_it_unstable(model: ThermalModel) -> None:
    """Readings that fit no state of the model pull hard; without them it must calm down."""
    observer = _cold(model)
    for _ in range(240):
        observer.predict(60.0, 5000.0, 2650.0, AMBIENT)
        observer.update({"t_inner_ring_c": 30.0, "t_outer_ring_c": 75.0})
    for _ in range(1200):
        observer.predict(60.0, 5000.0, 2650.0, AMBIENT)
    settled = steady_state(model, model.parameters.centre, 5000.0, 2650.0, AMBIENT, 1e9)
    assert observer.temperatures_c == pytest.approx(settled, abs=0.5)


def test_it_follows_the_cooling_after_a_stop(model: ThermalModel) -> None:
    """The twin's resistances are wrong, and there is no friction left to be wrong about."""
    bench = build_model("paper", bearing=bearing("6311"))
    hot = steady_state(bench, bench.parameters.centre, 6000.0, 4000.0, AMBIENT)
    time = np.arange(0.0, 7201.0, 60.0)
    still = np.zeros(time.size)
    profile = OperatingProfile(time, still, still, np.full(time.size, AMBIENT))
    readings = (
        simulate(bench, bench.parameters.centre, profile, hot).temperatures_c
        @ bench.sensor_matrix(SENSORS).T
    )
    values = model.parameters.centre
    first = dict(zip(SENSORS, readings[0].tolist(), strict=True))
    observer = Observer(
        model, values, *initial_state(model, values, first, AMBIENT, 6000.0, 4000.0, False)
    )
    worst = 0.0
    for row in range(1, time.size):
        observer.predict(60.0, 0.0, 0.0, AMBIENT)
        error = [observer.sensor(name)[0] for name in SENSORS] - readings[row]
        worst = max(worst, float(np.abs(error).max())) if row > 10 else worst
        observer.update(dict(zip(SENSORS, readings[row].tolist(), strict=True)))
    assert worst < 0.8


def test_one_sensor_alone_is_used(model: ThermalModel) -> None:
    observer = _cold(model)
    for _ in range(120):
        observer.predict(60.0, 5000.0, 2650.0, AMBIENT)
        innovation = observer.update({"t_outer_ring_c": 50.0})
    assert list(innovation) == ["t_outer_ring_c"]
    assert observer.sensor("t_outer_ring_c")[0] == pytest.approx(50.0, abs=0.1)
    assert observer.sensor("t_inner_ring_c")[1] > 5.0 * observer.sensor("t_outer_ring_c")[1]


def test_a_node_may_carry_a_sensor(model: ThermalModel) -> None:
    observer = _cold(model)
    observer.predict(60.0, 3000.0, 2650.0, AMBIENT)
    before = observer.std_c[6]
    innovation = observer.update({"t_node_7_c": 24.0})["t_node_7_c"]
    assert innovation.std_k > before
    assert observer.std_c[6] < before


def test_innovation_is_reading_minus_expectation(model: ThermalModel) -> None:
    observer = _cold(model)
    expected, std = observer.sensor("t_inner_ring_c")
    innovation = observer.update({"t_inner_ring_c": expected + 2.0})["t_inner_ring_c"]
    assert innovation.difference_k == pytest.approx(2.0)
    assert innovation.std_k > std
    assert observer.update({}) == {}


def test_quick_repetition_is_not_taken_for_independent_readings(model: ThermalModel) -> None:
    each_second, each_minute = _cold(model), _cold(model)
    for _ in range(60):
        each_second.predict(1.0, 0.0, 0.0, AMBIENT)
        each_second.update(dict.fromkeys(SENSORS, AMBIENT))
    each_minute.predict(60.0, 0.0, 0.0, AMBIENT)
    each_minute.update(dict.fromkeys(SENSORS, AMBIENT))
    ratio = each_second.sensor(SENSORS[0])[1] / each_minute.sensor(SENSORS[0])[1]
    assert 0.6 < ratio < 1.3


@pytest.mark.parametrize("parts", [2, 60])
def test_the_covariance_does_not_depend_on_the_step(model: ThermalModel, parts: int) -> None:
    """Transition and noise of a standing machine compose exactly."""
    once, often = _cold(model), _cold(model)
    once.predict(1800.0, 0.0, 0.0, AMBIENT)
    for _ in range(parts):
        often.predict(1800.0 / parts, 0.0, 0.0, AMBIENT)
    assert often.covariance == pytest.approx(once.covariance, rel=1e-6, abs=1e-9)
    assert often.temperatures_c == pytest.approx(once.temperatures_c, abs=1e-9)


def test_covariance_stays_symmetric_and_positive(model: ThermalModel) -> None:
    observer = _cold(model)
    rng = np.random.default_rng(9)
    for _ in range(500):
        observer.predict(rng.uniform(0.01, 600.0), rng.uniform(0, 6000), rng.uniform(0, 5000), 20.0)
        observer.update({name: 40.0 + rng.normal() for name in SENSORS if rng.random() < 0.7})
    covariance = observer.covariance
    assert np.array_equal(covariance, covariance.T) or np.allclose(covariance, covariance.T, 1e-12)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


@pytest.mark.parametrize("name", ["default", "paper", "paper-reduced"])
def test_a_standing_machine_lies_at_ambient(name: str) -> None:
    standing = build_model(name, bearing=bearing("6311"))
    observer = _cold(standing)
    for _ in range(200):
        observer.predict(300.0, 0.0, 0.0, AMBIENT)
    assert observer.temperatures_c == pytest.approx(AMBIENT, abs=0.01)
    assert observer.std_c.max() < 2.5
    assert observer.revolutions == 0.0


def test_hot_swap_keeps_the_state(model: ThermalModel) -> None:
    observer = _cold(model)
    _follow(observer, 6)
    values = model.parameters.values_from_z(np.full(model.parameters.size, 0.5))
    swapped = observer.with_parameters(model, values)
    assert swapped.temperatures_c.tolist() == observer.temperatures_c.tolist()
    assert swapped.covariance == pytest.approx(observer.covariance)
    assert swapped.revolutions == observer.revolutions
    assert swapped.values.tolist() == values.tolist()
    other = observer.with_parameters(build_model("paper", bearing=bearing("6311")), np.ones(15))
    assert other.model.name == "paper"
    swapped.predict(60.0, 6200.0, 2650.0, AMBIENT)
    assert np.abs(swapped.temperatures_c - observer.temperatures_c).max() < 8.0


def test_state_survives_json_and_continues_alike(model: ThermalModel) -> None:
    observer = _cold(model)
    observer.predict(600.0, 4000.0, 2650.0, AMBIENT)
    observer.update(dict.fromkeys(SENSORS, 35.0))
    data = json.loads(json.dumps(observer.to_dict()))
    restored = Observer.from_dict(model, observer.values, data)
    for one in (observer, restored):
        one.predict(60.0, 4000.0, 2650.0, AMBIENT)
    assert restored.temperatures_c.tolist() == observer.temperatures_c.tolist()
    assert restored.covariance.tolist() == observer.covariance.tolist()
    with pytest.raises(ValueError, match="observer state has shapes"):
        Observer.from_dict(model, observer.values, {**data, "state": [1.0]})
    with pytest.raises(ValueError, match="heat_w is None"):
        Observer.from_dict(model, observer.values, {**data, "heat_w": None})
    with pytest.raises(ValueError, match="revolutions is None"):
        Observer.from_dict(model, observer.values, {**data, "revolutions": None})


def test_initial_state_at_rest_is_ambient(model: ThermalModel) -> None:
    mean, covariance = initial_state(
        model, model.parameters.centre, dict.fromkeys(SENSORS, 22.4), AMBIENT, 0.0, 0.0, True
    )
    assert mean == pytest.approx(22.4, abs=0.2)
    assert np.sqrt(np.diag(covariance)).max() < 0.5


@pytest.mark.parametrize("minute", [5, 30, 120, 600])
@pytest.mark.parametrize("from_hot", [False, True])
def test_initial_state_of_a_running_machine_needs_no_past(
    model: ThermalModel, minute: int, from_hot: bool
) -> None:
    """Whatever happened before, the truth lies within a few standard deviations."""
    bench = build_model("paper", bearing=bearing("6311"))
    values = bench.parameters.centre
    start = np.full(13, AMBIENT)
    if from_hot:
        start = steady_state(bench, values, 6200.0, 5000.0, AMBIENT)
    n = minute + 1
    profile = OperatingProfile(
        np.arange(n) * 60.0, np.full(n, 3000.0), np.full(n, 2650.0), np.full(n, AMBIENT)
    )
    truth = simulate(bench, values, profile, start).temperatures_c[-1]
    readings = bench.sensor_matrix(SENSORS) @ truth
    mean, covariance = initial_state(
        model,
        model.parameters.centre,
        dict(zip(SENSORS, readings.tolist(), strict=True)),
        AMBIENT,
        3000.0,
        2650.0,
        False,
    )
    std = np.sqrt(np.diag(covariance))
    assert model.sensor_matrix(SENSORS) @ mean == pytest.approx(readings, abs=0.3)
    assert np.sqrt((((mean - truth) / std) ** 2).mean()) < 2.0
    assert np.abs(mean - truth).max() < 13.0


def test_initial_state_without_any_sensor_is_wide(model: ThermalModel) -> None:
    mean, covariance = initial_state(
        model, model.parameters.centre, {}, AMBIENT, 5000.0, 2650.0, False
    )
    assert (mean > AMBIENT + 3.0).all()
    assert np.sqrt(np.diag(covariance))[3] > 8.0


def test_a_warm_machine_that_claims_to_be_at_rest_is_not_believed(model: ThermalModel) -> None:
    mean, covariance = initial_state(
        model,
        model.parameters.centre,
        {"t_inner_ring_c": 45.0, "t_outer_ring_c": 38.0},
        AMBIENT,
        0.0,
        0.0,
        True,
    )
    assert mean[12] > AMBIENT
    assert mean[3] == pytest.approx(45.0, abs=1.5)
    assert np.sqrt(np.diag(covariance))[2] > 1.0


@pytest.mark.parametrize("arguments", [(-1.0, 0.0, 0.0, 20.0), (1.0, np.nan, 0.0, 20.0)])
def test_bad_predictions_are_refused(
    model: ThermalModel, arguments: tuple[float, float, float, float]
) -> None:
    with pytest.raises(ValueError, match="expected finite numbers and dt_s >= 0"):
        _cold(model).predict(*arguments)


def test_bad_readings_change_nothing(model: ThermalModel) -> None:
    observer = _cold(model)
    before = observer.to_dict()
    with pytest.raises(ValueError, match="reading of t_inner_ring_c is nan"):
        observer.update({"t_outer_ring_c": 30.0, "t_inner_ring_c": float("nan")})
    with pytest.raises(ValueError, match="unknown sensor 't_x_c'"):
        observer.update({"t_x_c": 30.0})
    assert observer.to_dict() == before


def test_zero_time_changes_nothing(model: ThermalModel) -> None:
    observer = _cold(model)
    before = observer.to_dict()
    observer.predict(0.0, 3000.0, 2650.0, AMBIENT)
    assert observer.to_dict() == before


def test_wrong_shapes_are_named(model: ThermalModel) -> None:
    values = model.parameters.centre
    with pytest.raises(ValueError, match=r"temperatures_c has shape \(4,\), expected \(13,\)"):
        Observer(model, values, np.zeros(4), np.eye(13))
    with pytest.raises(ValueError, match=r"covariance has shape"):
        Observer(model, values, np.zeros(13), np.eye(3))
    with pytest.raises(ValueError, match="temperatures_c is not finite"):
        Observer(model, values, np.full(13, np.nan), np.eye(13))
