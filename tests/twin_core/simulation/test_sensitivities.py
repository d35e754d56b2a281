"""Derivatives from the kernel against central differences, for every law and every network."""

from itertools import pairwise

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.network import (
    AMBIENT,
    COEFFICIENT_COUNT,
    FRICTION_COEFFICIENT_COUNT,
    MAX_COEFFICIENTS,
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
from twin_core.network_model import NetworkModel
from twin_core.networks.simple_5 import simple_5_model, simple_5_profile
from twin_core.parameters import Parameter, ParameterSet
from twin_core.simulation import (
    OperatingProfile,
    SimulationError,
    laws,
    simulate,
    simulate_sensitivities,
)

EDGES = {
    EdgeKind.CONSTANT: (0.4,),
    EdgeKind.CONTACT: (0.05, 0.2, 900.0),
    EdgeKind.CONVECTIVE: (3.0, 2.0, 0.8, 0.5),
    EdgeKind.CONVECTIVE_REFERENCE: (20.0, 2.0, 60.0, 0.6),
    EdgeKind.FILM: (2.0, 0.3),
    EdgeKind.SHAFT_SINK: (0.3, 0.8),
    EdgeKind.SPEED_POWER: (0.7, 1000.0, 0.3),
}
LOSS_VECTORS = {
    EdgeKind.COPPER: (0.05, 0.00393),
    EdgeKind.POWER: (0.9, 100.0, 1.3),
    EdgeKind.SPEED_LOSS: (20.0, 3000.0, 1.4),
}
FRICTIONS = {
    FrictionKind.PALMGREN: (0.5, 87.5, 45e3, 280.0, 0.047, 20.0),
    FrictionKind.TWO_PART: (190.0, 0.45, -0.09, 0.38, -0.1, 0.16, 0.3, 1.6, 0.3, 1e6),
    FrictionKind.LINEAR: (0.02, 0.01, 15.0),
}
POINTS = [(0.0, 0.0), (5.0, 20.0), (1500.0, 2650.0), (5600.0, 5500.0)]


def _differences(function, vector):  # type: ignore[no-untyped-def]
    columns = []
    for k, value in enumerate(vector):
        step = 1e-5 * max(abs(value), 1e-3)
        ends = [np.array(vector, dtype=float) for _ in range(2)]
        ends[0][k] += step
        ends[1][k] -= step
        columns.append((function(ends[0]) - function(ends[1])) / (2.0 * step))
    return np.array(columns)


@pytest.mark.parametrize("kind", list(EdgeKind))
@pytest.mark.parametrize(("speed", "load"), POINTS)
def test_gradient_of_every_edge(kind: EdgeKind, speed: float, load: float) -> None:
    vector = (EDGES | LOSS_VECTORS)[kind]
    assert len(vector) == COEFFICIENT_COUNT[kind]
    gradient = np.full(MAX_COEFFICIENTS, np.nan)
    laws.edge_gradient(int(kind), np.array(vector), speed, load, 30.0, gradient)
    expected = _differences(
        lambda c: laws.edge_conductance(int(kind), c, speed, load, 30.0), vector
    )
    np.testing.assert_allclose(gradient[: len(vector)], expected, rtol=1e-7, atol=1e-12)
    assert not gradient[len(vector) :].any()


@pytest.mark.parametrize("kind", list(LOSS_VECTORS))
@pytest.mark.parametrize("speed", [0.0, 1500.0])
def test_gradient_of_every_loss(kind: EdgeKind, speed: float) -> None:
    vector = LOSS_VECTORS[kind]
    gradient = np.full(MAX_COEFFICIENTS, np.nan)
    laws.loss_gradient(int(kind), np.array(vector), speed, 30.0, gradient)
    expected = _differences(lambda c: laws.loss_at_zero_w(int(kind), c, speed, 30.0), vector)
    np.testing.assert_allclose(gradient[: len(vector)], expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("kind", list(FrictionKind))
@pytest.mark.parametrize(("speed", "load"), POINTS)
@pytest.mark.parametrize("temperature", [-70.0, 25.0, 140.0])
def test_gradient_of_every_friction_law(
    kind: FrictionKind, speed: float, load: float, temperature: float
) -> None:
    vector = FRICTIONS[kind]
    assert len(vector) == FRICTION_COEFFICIENT_COUNT[kind]

    def heat(c: np.ndarray, at: float = temperature) -> float:
        point = laws.friction_at_point(int(kind), c, speed, load)
        return float(laws.friction_heat_w(int(kind), c, point, at, 4e5))

    gradient = np.full(len(vector), np.nan)
    slope = laws.friction_gradient(
        int(kind), np.array(vector), speed, load, temperature, 4e5, gradient
    )
    expected = _differences(heat, vector)
    size = np.abs(expected).max()
    np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-9 * size)
    around = [heat(np.array(vector), temperature + side) for side in (1e-4, -1e-4)]
    assert slope == pytest.approx((around[0] - around[1]) / 2e-4, rel=1e-6, abs=1e-9)


def test_heat_at_its_limit_does_not_depend_on_anything() -> None:
    vector = np.array(FRICTIONS[FrictionKind.TWO_PART])
    vector[0] = 1e6
    gradient = np.ones(10)
    assert laws.friction_gradient(1, vector, 5000.0, 2650.0, 40.0, 0.0, gradient) == 0.0
    assert not gradient.any()


@pytest.mark.parametrize("difference", [-30.0, -0.5, 3.0, 60.0])
def test_gradient_of_a_film(difference: float) -> None:
    gradient = np.full((2, 3), np.nan)
    laws.film_gradient(0.6, 0.25, difference, gradient)
    for row in range(2):
        expected = _differences(
            lambda c, row=row: laws.film_excess_w(c[0], c[1], c[2])[row], (0.6, 0.25, difference)
        )
        np.testing.assert_allclose(gradient[row], expected, rtol=1e-6, atol=1e-10)


def _network_of_all_kinds(friction: FrictionKind) -> NetworkModel:
    """Seven nodes in a ring and to ambient by every kind of edge; every coefficient is free."""
    parameters: list[Parameter] = []

    def free(name: str, value: float) -> Coefficient:
        centre = 1.0 if value > 0.0 else -1.0
        parameters.append(Parameter(name, "-", "factor", "linear", centre, 0.2))
        return Coefficient(abs(value), name)

    names = [f"n{number}" for number in range(7)]
    nodes = [Node(name, free(f"C_{name}", 300.0 * 1.3**k)) for k, name in enumerate(names)]
    nodes[6] = Node("n6", Coefficient(500.0, "C_n5"))  # two nodes follow one parameter
    parameters.pop()
    edges = []
    for number, (kind, vector) in enumerate(EDGES.items()):
        ends = [(names[number], AMBIENT)]
        if kind is not EdgeKind.FILM:
            ends.append((names[number], names[(number + 1) % 7]))
        for place, (first, second) in enumerate(ends):
            coefficients = tuple(
                free(f"{kind.name}_{place}_{c}", value) for c, value in enumerate(vector)
            )
            edges.append(Edge(first, second, kind, coefficients))
    edges.append(Edge("n0", AMBIENT, EdgeKind.FILM, (Coefficient(0.5), Coefficient(0.2))))
    edges += [
        Edge(first, second, EdgeKind.CONSTANT, (Coefficient(0.5),))
        for first, second in pairwise(names)
    ]
    source = HeatSource(
        friction,
        tuple(free(f"f{c}", value) for c, value in enumerate(FRICTIONS[friction])),
        "n2",
        (
            HeatShare("n2", free("share", 0.3)),
            HeatShare("n4", Coefficient(0.5)),
            HeatShare("n5", Coefficient(1.0)),
        ),
    )
    network = Network("all", tuple(nodes), tuple(edges), source, (Sensor("t", (("n2", 1.0),)),))
    selected = ParameterSet(tuple(parameters))
    return NetworkModel("all", network, selected, compile_network(network, selected.names))


def _profile() -> OperatingProfile:
    """Standstill, steps of speed and load, a changing ambient, irregular rows."""
    speed = np.repeat([0.0, 1500.0, 5600.0, 5600.0, 3000.0], 14)
    load = np.repeat([0.0, 2650.0, 2650.0, 4000.0, 4000.0], 14)
    time_s = np.cumsum(np.tile([60.0, 60.0, 45.0, 60.0, 150.0], 14))
    return OperatingProfile(time_s, speed, load, 20.0 + 4.0 * np.sin(time_s / 600.0))


def _check(model: NetworkModel, values: np.ndarray, profile: OperatingProfile) -> None:
    nodes = len(model.node_names)
    rng = np.random.default_rng(nodes)
    start, seeds = 25.0 + 5.0 * rng.normal(size=nodes), rng.normal(size=(nodes, 3))
    found = simulate_sensitivities(model, values, profile, start, 2e5, initial_directions=seeds)

    def run(vector: np.ndarray, initial: np.ndarray) -> np.ndarray:
        return simulate(model, vector, profile, initial, 2e5).temperatures_c

    assert found.temperatures_c == pytest.approx(run(values, start), abs=1e-7)
    for k, name in enumerate(model.parameters.names):
        step = np.zeros(values.size)
        step[k] = 2e-5 * max(abs(values[k]), 1e-3)
        expected = (run(values + step, start) - run(values - step, start)) / (2.0 * step[k])
        error = np.abs(found.by_value[..., k] - expected).max()
        assert error <= 1e-5 * np.abs(expected).max() + 1e-7 / abs(values[k]), name
    for k in range(3):
        expected = (
            run(values, start + 1e-3 * seeds[:, k]) - run(values, start - 1e-3 * seeds[:, k])
        ) / 2e-3
        assert found.by_initial[..., k] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("friction", list(FrictionKind))
def test_a_network_of_all_kinds_with_every_coefficient_free(friction: FrictionKind) -> None:
    model = _network_of_all_kinds(friction)
    values = model.parameters.centre.copy()
    values *= np.random.default_rng(1).uniform(0.95, 1.05, values.size)
    _check(model, values, _profile())


@pytest.mark.parametrize("name", ["default", "paper"])
def test_the_models_of_a_bearing(name: str) -> None:
    model = build_model(name, bearing=bearing("6016"))
    z = np.random.default_rng(2).normal(0.0, 0.7, model.parameters.size)
    _check(model, model.parameters.values_from_z(z), _profile())


def test_the_simple_network_of_the_paper() -> None:
    model = simple_5_model()
    _check(model, model.parameters.centre, simple_5_profile())


def test_nodes_of_equal_rates() -> None:
    """Two equal nodes apart from each other: their modes could be turned at will."""
    nodes = tuple(Node(name, Coefficient(500.0)) for name in ("a", "b"))
    edges = (
        Edge("a", AMBIENT, EdgeKind.CONSTANT, (Coefficient(0.5, "ra"),)),
        Edge("b", AMBIENT, EdgeKind.CONSTANT, (Coefficient(0.5),)),
        Edge("a", "b", EdgeKind.CONSTANT, (Coefficient(1e9, "rab"),)),
    )
    source = HeatSource(
        FrictionKind.LINEAR,
        (Coefficient(0.01), Coefficient(0.0), Coefficient(0.0)),
        "a",
        (HeatShare("a", Coefficient(0.3)), HeatShare("b", Coefficient(1.0))),
    )
    network = Network("twins", nodes, edges, source, (Sensor("t", (("a", 1.0),)),))
    parameters = ParameterSet(
        tuple(Parameter(name, "-", "factor", "log", 1.0, 0.5) for name in ("ra", "rab"))
    )
    model = NetworkModel("twins", network, parameters, compile_network(network, parameters.names))
    _check(model, np.ones(2), _profile())
    # Strongly enough coupled to see what the second parameter does between the equal nodes.
    stronger = np.array([1.0, 1e-8])
    found = simulate_sensitivities(model, stronger, _profile(), np.array([20.0, 60.0]))
    assert np.abs(found.by_value[:, 0, 1]).max() > 1e6


def test_outputs_are_weighted_nodes() -> None:
    model = build_model("paper", bearing=bearing("6311"))
    values, start = model.parameters.centre, np.full(13, 22.0)
    rows = model.sensor_matrix(model.sensor_names)
    nodes = simulate_sensitivities(model, values, _profile(), start)
    sensors = simulate_sensitivities(model, values, _profile(), start, outputs=rows)
    assert sensors.temperatures_c == pytest.approx(nodes.temperatures_c @ rows.T, abs=1e-9)
    expected = np.einsum("si,nip->nsp", rows, nodes.by_value)
    np.testing.assert_allclose(sensors.by_value, expected, rtol=1e-9, atol=1e-9)
    assert sensors.by_initial.shape == (70, 2, 0)


def test_failures_and_wrong_shapes_are_named() -> None:
    model = build_model("paper", bearing=bearing("6311"))
    values, start = model.parameters.centre, np.full(13, 22.0)
    with pytest.raises(SimulationError, match="ran away"):
        simulate_sensitivities(model, np.full(15, np.nan), _profile(), start)
    with pytest.raises(ValueError, match=r"values has shape \(2,\), expected \(15,\)"):
        simulate_sensitivities(model, values[:2], _profile(), start)
    with pytest.raises(ValueError, match=r"outputs has shape \(2, 5\), expected \(2, 13\)"):
        simulate_sensitivities(model, values, _profile(), start, outputs=np.ones((2, 5)))
