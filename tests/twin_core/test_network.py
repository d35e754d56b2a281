from dataclasses import replace

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.network import (
    AMBIENT,
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
from twin_core.simulation import kernels

SOURCE = HeatSource(
    FrictionKind.PALMGREN,
    tuple(Coefficient(value) for value in (0.5, 87.5, 45e3, 100.0, 0.05, 40.0)),
    "ring",
    (HeatShare("ring", Coefficient(0.25, "share")), HeatShare("house", Coefficient(1.0))),
)
NETWORK = Network(
    "two",
    (Node("ring", Coefficient(100.0, "scale")), Node("house", Coefficient(1000.0))),
    (
        Edge("ring", "house", EdgeKind.CONSTANT, (Coefficient(0.5, "joint"),)),
        Edge("house", AMBIENT, EdgeKind.CONSTANT, (Coefficient(2.0),)),
    ),
    SOURCE,
    (Sensor("t_ring_c", (("ring", 0.8), ("house", 0.2))),),
)
NAMES = ("joint", "scale", "share")


def _edge(kind: EdgeKind, *coefficients: float, speed: float, load: float = 2650.0) -> float:
    return float(kernels.edge_conductance(int(kind), np.array(coefficients), speed, load, 0.0))


def test_parameters_multiply_their_coefficients() -> None:
    compiled = compile_network(NETWORK, NAMES)
    capacity, edges, _, share = kernels.bind_network(compiled, np.array([3.0, 2.0, 0.8]))
    assert capacity.tolist() == [200.0, 1000.0]
    assert edges[:, 0].tolist() == [1.5, 2.0]
    assert share == pytest.approx([0.2, 0.8])  # 0.25 * 0.8, and all that is left
    matrix, to_ambient = kernels.conductance_matrix(compiled, edges, 0.0, 0.0, compiled.inputs)
    assert matrix == pytest.approx(np.array([[2 / 3, -2 / 3], [-2 / 3, 2 / 3 + 0.5]]))
    assert to_ambient.tolist() == [[0.0, 0.5]]


def test_the_papers_heat_split_is_one_two_one() -> None:
    compiled = build_model("paper", bearing=bearing("6311")).compiled
    _, _, _, share = kernels.bind_network(compiled, np.ones(15))
    assert share.tolist() == [0.0, 0.25, 0.5, 0.25, *[0.0] * 9]


def test_the_default_heat_split() -> None:
    model = build_model(bearing=bearing("6311"))
    values = model.parameters.centre.copy()
    for name, value in (("fm", 0.2), ("ball", 0.6), ("inn", 0.75)):
        values[model.parameters.index(name)] = value
    _, _, _, share = kernels.bind_network(model.compiled, values)
    assert share[[6, 2, 3, 1]] == pytest.approx([0.2, 0.8 * 0.6, 0.32 * 0.75, 0.32 * 0.25])
    assert share.sum() == pytest.approx(1.0)


def test_contact_resistance_falls_with_the_root_of_load_and_speed() -> None:
    """Kc1 + Kc2 / sqrt(F n), both exponents -1/2: 0.15 + 1500 / sqrt(2650 6200) = 0.520."""
    resistance = 1.0 / _edge(EdgeKind.CONTACT, 0.0, 0.15, 1500.0, speed=6200.0)
    assert resistance == pytest.approx(0.520, abs=1e-3)
    halved = 1.0 / _edge(EdgeKind.CONTACT, 0.0, 0.0, 1500.0, speed=6200.0, load=4 * 2650.0)
    assert halved == pytest.approx((resistance - 0.15) / 2.0)


def test_convective_resistances_at_6200_rpm() -> None:
    """6311, reference Nusselt laws: 38.56 / (2 + 1.34 6200^0.54) = 0.254 K/W for the balls."""
    assert 1.0 / _edge(EdgeKind.CONVECTIVE, 38.56, 2.0, 1.34, 0.54, speed=6200.0) == pytest.approx(
        0.254, abs=2e-3
    )
    assert 1.0 / _edge(
        EdgeKind.CONVECTIVE_REFERENCE, 38.56, 2.0, 100.0, 0.5, speed=3000.0
    ) == pytest.approx(0.3856)
    assert 1.0 / _edge(
        EdgeKind.CONVECTIVE_REFERENCE, 38.56, 2.0, 100.0, 0.5, speed=12000.0
    ) == pytest.approx(38.56 / 198.0)


def test_rotating_shaft_sink() -> None:
    assert _edge(EdgeKind.SHAFT_SINK, 0.2, 0.25, speed=6000.0) == pytest.approx(0.45)
    assert _edge(EdgeKind.SHAFT_SINK, 0.2, 0.25, speed=750.0) == pytest.approx(0.2625)


@pytest.mark.parametrize("load", [0.0, 2650.0])
@pytest.mark.parametrize("speed", [0.0, 1e-6, 0.5])
def test_every_kind_conducts_a_little_at_standstill(speed: float, load: float) -> None:
    contact = 1.0 / _edge(EdgeKind.CONTACT, 0.06, 0.15, 1500.0, speed=speed, load=load)
    assert 1.0 < contact < 100.0
    nusselt_at_rest = _edge(EdgeKind.CONVECTIVE, 1.0, 2.0, 1.3, 0.5, speed=speed, load=load)
    assert nusselt_at_rest == pytest.approx(2.0, abs=1.0)
    assert _edge(
        EdgeKind.CONVECTIVE_REFERENCE, 1.0, 2.0, 100.0, 0.5, speed=speed, load=load
    ) == pytest.approx(2.0, abs=1.5)
    assert _edge(EdgeKind.SHAFT_SINK, 0.2, 0.25, speed=speed) == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("difference", [-30.0, 3.0, 12.0, 48.0])
def test_film_law_and_its_slope(difference: float) -> None:
    """h ~ |dT|^0.25 around 12 K: linear part plus excess gives G (|dT| / 12)^0.25 dT."""
    excess, slope = kernels.film_excess_w(0.5, 0.25, difference)
    total = 0.5 * difference + excess
    assert total == pytest.approx(0.5 * (abs(difference) / 12.0) ** 0.25 * difference)
    above, _ = kernels.film_excess_w(0.5, 0.25, difference + 1e-5)
    assert slope == pytest.approx((above - excess) / 1e-5, rel=1e-4)


def test_film_at_no_difference() -> None:
    assert kernels.film_excess_w(0.5, -0.1, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"nodes": (*NETWORK.nodes, NETWORK.nodes[0])}, "node 'ring' is defined more than once"),
        ({"nodes": (*NETWORK.nodes, Node("x", Coefficient(1.0)))}, "'x' has no path to 'ambient'"),
        ({"nodes": (*NETWORK.nodes, Node(AMBIENT, Coefficient(1.0)))}, "is the boundary"),
        (
            {"edges": (*NETWORK.edges, Edge("ring", "cap", EdgeKind.CONSTANT, ()))},
            "edge ring-cap: unknown node 'cap', expected one of ring, house",
        ),
        (
            {"edges": (*NETWORK.edges, Edge("ring", "ring", EdgeKind.CONSTANT, ()))},
            "two different nodes",
        ),
        (
            {"edges": (*NETWORK.edges, Edge("ring", "house", EdgeKind.CONTACT, ()))},
            "0 coefficients, expected 3 for kind CONTACT",
        ),
        (
            {
                "edges": (
                    *NETWORK.edges,
                    Edge("ring", "house", EdgeKind.FILM, (Coefficient(1.0),) * 2),
                )
            },
            "a film leads to 'ambient'",
        ),
        ({"source": replace(SOURCE, temperature_node="oil")}, "heat source: unknown node 'oil'"),
        ({"source": replace(SOURCE, shares=())}, "at least one node that receives the heat"),
        ({"source": replace(SOURCE, coefficients=())}, "0 coefficients, expected 6 for kind PALM"),
        ({"sensors": (Sensor("s", (("oil", 1.0),)),)}, "sensor s: unknown node 'oil'"),
    ],
)
def test_parts_that_do_not_fit_are_named(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(NETWORK, **change)  # type: ignore[arg-type]


def test_parameters_that_do_not_fit_are_named() -> None:
    with pytest.raises(ValueError, match=r"unknown parameter 'scale', expected one of joint"):
        compile_network(NETWORK, ("joint", "share"))
    with pytest.raises(ValueError, match="'spare' is not used"):
        compile_network(NETWORK, (*NAMES, "spare"))
