"""Heats of single nodes and more than one boundary, compared with hand calculation and scipy."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from twin_core.initial_state import initial_state
from twin_core.models import ThermalModel
from twin_core.network import (
    Coefficient,
    Edge,
    EdgeKind,
    FrictionKind,
    HeatShare,
    HeatSource,
    Network,
    Node,
    Sensor,
    compile_network,
)
from twin_core.observer import Observer
from twin_core.parameters import Parameter, ParameterSet
from twin_core.simulation import (
    OperatingProfile,
    SimulationError,
    heat_balance_w,
    simulate,
    simulate_batch,
    steady_state,
)
from twin_core.simulation.sensitivities import simulate_sensitivities

FloatArray = NDArray[np.float64]

ALPHA = 0.00393
VALUES = {
    "cw": 150.0, "slot": 0.2, "air": 1.5, "cool": 0.01, "r20": 0.05, "part": 0.9, "iron": 20.0,
    "growth": 1.4, "bend": 1.2,
}  # fmt: skip
START = np.array([30.0, 25.0])
EDGES = (
    Edge("t_winding_c", "t_body_c", EdgeKind.CONSTANT, (Coefficient(1.0, "slot"),)),
    Edge("t_body_c", "ambient", EdgeKind.CONSTANT, (Coefficient(1.0, "air"),)),
    Edge(
        "t_body_c",
        "coolant_c",
        EdgeKind.CONVECTIVE,
        (Coefficient(1.0), Coefficient(1.0), Coefficient(1.0, "cool"), Coefficient(0.5)),
    ),
    Edge(
        "t_winding_c",
        "current_a",
        EdgeKind.COPPER,
        (Coefficient(1.0, "r20"), Coefficient(ALPHA)),
    ),
    Edge(
        "t_body_c",
        "power_w",
        EdgeKind.POWER,
        (Coefficient(1.0, "part"), Coefficient(100.0), Coefficient(1.0, "bend")),
    ),
    Edge(
        "t_body_c",
        "",
        EdgeKind.SPEED_LOSS,
        (Coefficient(1.0, "iron"), Coefficient(3000.0), Coefficient(1.0, "growth")),
    ),
)


@pytest.fixture(scope="module")
def motor() -> ThermalModel:
    network = Network(
        "motor",
        (Node("t_winding_c", Coefficient(1.0, "cw")), Node("t_body_c", Coefficient(900.0))),
        EDGES,
        HeatSource(
            FrictionKind.LINEAR,
            (Coefficient(0.001), Coefficient(0.0), Coefficient(0.0)),
            "t_body_c",
            (HeatShare("t_body_c", Coefficient(1.0)),),
        ),
        (Sensor("t_winding_c", (("t_winding_c", 1.0),)),),
        ("coolant_c", "current_a", "power_w"),
    )
    parameters = ParameterSet(
        tuple(Parameter(name, "-", name, "log", value, 0.5) for name, value in VALUES.items())
    )
    return ThermalModel(
        "motor",
        network,
        parameters,
        compile_network(network, parameters.names),
        "motor",
        reference_point=(3000.0, 1.0),
        reference_inputs=(25.0, 50.0, 100.0),
    )


@pytest.fixture(scope="module")
def values() -> FloatArray:
    return np.array(list(VALUES.values()))


@pytest.fixture(scope="module")
def duty() -> OperatingProfile:
    """Everything changes, at times of any spacing."""
    rng = np.random.default_rng(1)
    n = 40
    inputs = np.stack(
        (
            rng.uniform(20.0, 50.0, n),
            np.repeat(rng.uniform(0.0, 80.0, n // 2), 2),
            rng.uniform(0.0, 200.0, n),
        ),
        axis=1,
    )
    return OperatingProfile(
        np.cumsum(np.append(0.0, rng.uniform(5.0, 300.0, n - 1))),
        np.repeat(rng.uniform(0.0, 5000.0, n // 4), 4),
        np.zeros(n),
        rng.uniform(18.0, 25.0, n),
        inputs,
    )


def integrated(duty: OperatingProfile) -> FloatArray:
    """The same network by scipy, from the laws as they stand in the documentation."""
    v = VALUES
    path = [START]
    for k in range(duty.size - 1):
        speed, ambient = duty.speed_rpm[k], duty.ambient_c[k]
        coolant, current, power = duty.inputs[k]

        def rates(
            _: float, t: FloatArray, s: float = speed, a: float = ambient, c: float = coolant,
            i: float = current, p: float = power,
        ) -> list[float]:  # fmt: skip
            through = (t[0] - t[1]) / v["slot"]
            out = (t[1] - a) / v["air"] + (1.0 + v["cool"] * s**0.5) * (t[1] - c)
            heat = (
                v["part"] * 100.0 * (p / 100.0) ** v["bend"]
                + v["iron"] * (s / 3000.0) ** v["growth"]
                + 0.001 * s
            )
            copper = v["r20"] * (1.0 + ALPHA * (t[0] - 20.0)) * i * i
            return [(copper - through) / v["cw"], (through - out + heat) / 900.0]

        span = (duty.time_s[k], duty.time_s[k + 1])
        path.append(solve_ivp(rates, span, path[-1], rtol=1e-11, atol=1e-11).y[:, -1])
    return np.array(path)


def test_every_loss_and_boundary_agrees_with_an_integrator(
    motor: ThermalModel, values: FloatArray, duty: OperatingProfile
) -> None:
    path = simulate(motor, values, duty, START).temperatures_c
    assert np.ptp(path[:, 0]) > 50.0
    # Nothing here depends on temperature but linearly: the simulation is exact at any row.
    np.testing.assert_allclose(path, integrated(duty), atol=1e-6)


def test_sensitivities_agree_with_differences(
    motor: ThermalModel, values: FloatArray, duty: OperatingProfile
) -> None:
    found = simulate_sensitivities(motor, values, duty, START, initial_directions=np.eye(2))
    for place in range(values.size):
        step = 1e-5 * values[place] * np.eye(values.size)[place]
        ends = [simulate(motor, values + side * step, duty, START) for side in (1.0, -1.0)]
        expected = (ends[0].temperatures_c - ends[1].temperatures_c) / (2e-5 * values[place])
        size = np.abs(expected).max()
        np.testing.assert_allclose(found.by_value[:, :, place], expected, atol=1e-6 * size)


def test_a_batch_is_as_the_single_simulation(
    motor: ThermalModel, values: FloatArray, duty: OperatingProfile
) -> None:
    batch = simulate_batch(motor, np.stack((values, values)), duty, START)
    np.testing.assert_array_equal(batch[1], simulate(motor, values, duty, START).temperatures_c)


def test_the_steady_state_by_hand(motor: ThermalModel, values: FloatArray) -> None:
    """Two balances by hand: all heat leaves through air and coolant."""
    held = motor.holding([40.0, 60.0, 100.0])
    winding, body = steady_state(held, values, 0.0, 0.0, 20.0).tolist()
    copper = 0.05 * (1.0 + ALPHA * (winding - 20.0)) * 60.0**2
    assert copper == pytest.approx((winding - body) / 0.2)
    assert copper + 90.0 == pytest.approx((body - 20.0) / 1.5 + (body - 40.0))
    net, heat = heat_balance_w(held, values, np.array([winding, body]), 0.0, 0.0, 20.0)
    assert net == pytest.approx([0.0, 0.0], abs=1e-6)
    assert heat == pytest.approx(copper + 90.0)


def test_copper_that_heats_itself_faster_than_it_cools_runs_away(
    motor: ThermalModel, values: FloatArray
) -> None:
    # 0.05 ohm * 0.00393 / K * I^2 is more than the 5 W/K of the slot from 160 A on.
    held = motor.holding([20.0, 200.0, 0.0])
    with pytest.raises(SimulationError):
        steady_state(held, values, 0.0, 0.0, 20.0)


def test_a_profile_without_the_inputs_is_refused(
    motor: ThermalModel, values: FloatArray, duty: OperatingProfile
) -> None:
    bare = OperatingProfile(duty.time_s, duty.speed_rpm, duty.load_n, duty.ambient_c)
    with pytest.raises(ValueError, match="coolant_c, current_a, power_w"):
        simulate(motor, values, bare, START)
    with pytest.raises(ValueError, match="one number for each of coolant_c"):
        Observer(motor, values, START, np.eye(2)).predict(60.0, 0.0, 0.0, 20.0)


def test_the_observer_follows_with_the_inputs(
    motor: ThermalModel, values: FloatArray, duty: OperatingProfile
) -> None:
    truth = simulate(motor, values, duty, START).temperatures_c
    mean, covariance = initial_state(
        motor,
        values,
        {"t_winding_c": truth[0, 0]},
        float(duty.ambient_c[0]),
        float(duty.speed_rpm[0]),
        0.0,
        False,
        inputs=duty.inputs[0],
    )
    observer = Observer(motor, values, mean, covariance)
    for k in range(duty.size - 1):
        observer.predict(
            float(duty.time_s[k + 1] - duty.time_s[k]),
            float(duty.speed_rpm[k]),
            0.0,
            float(duty.ambient_c[k]),
            duty.inputs[k],
        )
        observer.update({"t_winding_c": truth[k + 1, 0]})
    # The body has no sensor: it is found by winding, coolant and air.
    assert observer.temperatures_c == pytest.approx(truth[-1], abs=1.0)
    assert observer.state().inputs == tuple(duty.inputs[-2])
