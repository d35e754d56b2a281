from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.network import Sensor
from twin_core.process_noise import between_joints, hidden_spread, transition_and_noise

CAPACITY = np.array([100.0, 400.0])
CONDUCTANCE = np.array([[3.0, -2.0], [-2.0, 2.5]])
TIME_S = 5400.0
DISTURBANCE_W = np.array([[10.0, 0.0], [-4.0, 2.0]])
DENSITY = np.array([16.0, 4.0])


def _ours(dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    root = np.sqrt(CAPACITY)
    rate, vector = np.linalg.eigh(CONDUCTANCE / np.outer(root, root))
    return transition_and_noise(
        dt_s, rate, vector / root[:, None], (vector * root[:, None]).T,
        DISTURBANCE_W, TIME_S, DENSITY,
    )  # fmt: skip


def _van_loan(dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise from one matrix exponential (Van Loan 1978)."""
    a = np.zeros((4, 4))
    a[:2, :2] = -CONDUCTANCE / CAPACITY[:, None]
    a[:2, 2:] = DISTURBANCE_W / CAPACITY[:, None]
    a[2:, 2:] = -np.eye(2) / TIME_S
    q = np.diag([*(DENSITY / CAPACITY**2), 2.0 / TIME_S, 2.0 / TIME_S])
    block = expm(np.block([[-a, q], [np.zeros((4, 4)), a.T]]) * dt_s)
    transition = block[4:, 4:].T
    return transition, transition @ block[:4, 4:]


@pytest.mark.parametrize("dt_s", [0.1, 10.0, 60.0, 200.0])
def test_against_van_loan(dt_s: float) -> None:
    transition, noise = _ours(dt_s)
    expected_transition, expected_noise = _van_loan(dt_s)
    assert transition == pytest.approx(expected_transition, rel=1e-9, abs=1e-12)
    assert noise == pytest.approx(expected_noise, rel=1e-6, abs=1e-12)


def test_disturbances_settle_at_variance_one() -> None:
    _, noise = _ours(20.0 * TIME_S)
    assert np.diag(noise)[2:] == pytest.approx([1.0, 1.0])


def test_a_mode_as_fast_as_the_disturbance_is_no_singularity() -> None:
    rate = np.array([1.0 / TIME_S])
    transition, noise = transition_and_noise(
        600.0, rate, np.eye(1), np.eye(1), np.eye(1), TIME_S, np.zeros(1)
    )
    # the integral of exp(-a s) exp(-a (t - s)) is t exp(-a t)
    assert transition[0, 1] == pytest.approx(600.0 * np.exp(-600.0 / TIME_S), rel=1e-3)
    assert noise[0, 0] > 0.0


def test_hidden_nodes_may_deviate_where_no_sensor_would_show_it() -> None:
    model = build_model(bearing=bearing("6311"))
    spread = hidden_spread(model, model.parameters.centre)
    sensors = model.sensor_matrix(model.sensor_names) @ spread
    assert np.linalg.norm(sensors, axis=1).max() < 0.005
    nodes = dict(zip(model.node_names, np.linalg.norm(spread, axis=1), strict=True))
    # K per kelvin of the sensors' mean rise: balls and shaft ends hang loosely on the rings.
    assert 0.1 < nodes["t_node_3_c"] < 0.6
    assert 0.03 < nodes["t_node_12_c"] < 0.3
    assert nodes["t_node_4_c"] < 0.01


def test_sleeves_and_cage_hang_between_joints_unless_a_sensor_sits_on_them() -> None:
    model = build_model(bearing=bearing("6311"))
    bodies, neighbours = between_joints(model)
    pairs = {(body + 1, other + 1) for body, other in zip(bodies, neighbours, strict=True)}
    assert pairs == {(6, 3), (6, 7), (10, 4), (10, 5), (11, 4), (11, 12)}

    sensor = Sensor("t_sleeve_c", (("t_node_10_c", 1.0),))
    network = replace(model.network, sensors=(*model.network.sensors, sensor))
    bodies, _ = between_joints(replace(model, network=network))
    assert set((bodies + 1).tolist()) == {6, 11}
