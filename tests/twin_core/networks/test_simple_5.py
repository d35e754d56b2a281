import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin_core.networks.simple_5 import (
    AMBIENT_C,
    TARGETS,
    simple_5_model,
    simple_5_profile,
    target_values,
)
from twin_core.simulation import simulate, simulate_batch, steady_state

COLD = np.full(4, AMBIENT_C)


def _rates(temperature: np.ndarray, speed_rpm: float, load_n: float) -> np.ndarray:
    """dT/dt, written down once more by hand from the ladder with the target values."""
    t1, t2, t3, t4 = temperature
    heat = 1.0 * speed_rpm / 10 + 0.29 * load_n / 10 + 50.0
    shaft = 0.5 * (speed_rpm / 10) ** 0.18
    flow_12, flow_23, flow_34 = (t1 - t2) / 0.05, (t2 - t3) / 0.2, (t3 - t4) / 0.35
    flow_13, flow_24 = (t1 - t3) / 0.60, (t2 - t4) / 0.80
    return np.array(
        [
            (-flow_12 - flow_13 - (t1 - AMBIENT_C) / 0.08) / 900.0,
            (heat / 2 + flow_12 - flow_23 - flow_24) / 400.0,
            (heat / 2 + flow_23 + flow_13 - flow_34) / 350.0,
            (flow_34 + flow_24 - (t4 - AMBIENT_C) / shaft) / 700.0,
        ]
    )


def test_simulation_is_exact() -> None:
    """Heat that does not depend on temperature leaves the zero-order hold nothing to correct."""
    profile = simple_5_profile()
    simulated = simulate(simple_5_model(), target_values(), profile, COLD).temperatures_c
    state = COLD
    for point in range(5):
        row = 90 * point
        speed, load = profile.speed_rpm[row], profile.load_n[row]
        solved = solve_ivp(
            lambda _, y, speed=speed, load=load: _rates(y, speed, load),
            (0.0, 5400.0),
            state,
            t_eval=np.linspace(0.0, 5400.0, 91),
            rtol=1e-10,
            atol=1e-9,
            method="Radau",
        )
        assert np.abs(solved.y.T - simulated[row : row + 91]).max() < 1e-6
        state = solved.y[:, -1]


def test_the_profile_tells_all_parameters_apart() -> None:
    """No two operating points alike, and each held until the network is nearly settled."""
    profile = simple_5_profile()
    model = simple_5_model()
    assert profile.size == 451
    ends = simulate(model, target_values(), profile, COLD).temperatures_c[90::90]
    for end, row in zip(ends, range(0, 450, 90), strict=True):
        point = float(profile.speed_rpm[row]), float(profile.load_n[row])
        steady = steady_state(model, target_values(), *point, AMBIENT_C)
        assert np.abs(end - steady).max() < 0.2
    assert (
        len({tuple(point) for point in np.column_stack((profile.speed_rpm, profile.load_n))}) == 5
    )


def test_bounds_hold_two_decades_and_the_target_off_their_centre() -> None:
    parameters = simple_5_model().parameters
    assert parameters.names == tuple(TARGETS)
    assert parameters.upper / parameters.lower == pytest.approx(100.0)
    inside = np.log(target_values() / parameters.lower) / np.log(100.0)
    assert np.all((inside > 0.05) & (inside < 0.95))
    assert np.all(np.abs(inside - 0.5) > 0.04)
    linear = (target_values() - parameters.lower) / (parameters.upper - parameters.lower)
    assert np.all(np.abs(linear - 0.5) > 0.3)
    assert parameters.z_lower == pytest.approx(-3.0)
    assert parameters.z_upper == pytest.approx(3.0)


def test_hot_candidates_are_computed_not_refused() -> None:
    """The corner of the box heats to thousands of degrees; its cost must still rank it."""
    model = simple_5_model()
    hottest = np.array([model.parameters.upper, target_values()])
    temperatures = simulate_batch(model, hottest, simple_5_profile(), COLD)
    assert np.all(np.isfinite(temperatures))
    assert temperatures[0].max() > 2000.0


def test_seven_unknowns_are_identifiable_from_two_sensors() -> None:
    """Condition about 800; the weakest direction raises k6 and lowers k7."""
    model, profile, target = simple_5_model(), simple_5_profile(), target_values()
    step = 1e-4
    nudged = target * np.exp(step * np.concatenate((np.eye(7), -np.eye(7))))
    temperatures = simulate_batch(model, nudged, profile, COLD)[:, 1:, :2].reshape(14, -1)
    jacobian = (temperatures[:7] - temperatures[7:]).T / (2 * step)
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    assert 400 < singular[0] / singular[-1] < 1500
    weakest = directions[-1]
    assert sorted(np.argsort(np.abs(weakest))[-2:].tolist()) == [5, 6]
    assert weakest[5] * weakest[6] < 0


def test_standstill_stays_finite() -> None:
    model = simple_5_model()
    temperatures = steady_state(model, target_values(), 0.0, 0.0, AMBIENT_C)
    assert np.all(temperatures > AMBIENT_C)
    assert np.all(temperatures < 40.0)
