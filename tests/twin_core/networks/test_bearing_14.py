import numpy as np
import pytest

from twin_core.bearings import bearing, bearing_from_dimensions
from twin_core.models import build_model
from twin_core.network import EdgeKind
from twin_core.networks.bearing_14 import NODE_NAMES, bearing_14_data, with_shoulders
from twin_core.simulation import steady_state

CAPACITY = {
    "6311": [5452, 272, 143, 177, 1208, 162, 118, 1851, 1851, 150, 150, 2396, 81349],
    "6016": [5191, 147, 70, 135, 2556, 116, 86, 1685, 1685, 210, 210, 4808, 81349],
}
RESISTANCE = {
    (1, 2): (0.0385, 0.0423),
    (4, 5): (0.444, 0.263),
    (4, 12): (0.583, 0.341),
    (5, 12): (1.391, 0.658),
    (4, 10): (0.510, 0.374),
    (4, 11): (0.510, 0.374),
    (5, 10): (0.217, 0.119),
    (11, 12): (0.286, 0.158),
    (1, 8): (0.0495, 0.0520),
    (1, 9): (0.0495, 0.0520),
    (2, 8): (0.381, 0.538),
    (2, 9): (0.381, 0.538),
    (7, 8): (9.72, 12.6),
    (7, 9): (9.72, 12.6),
    (1, 13): (0.0615, 0.0615),
    (1, 14): (3.27, 3.27),
    (8, 14): (3.13, 3.34),
    (9, 14): (3.13, 3.34),
    (13, 14): (0.131, 0.131),
    (5, 14): (4.82, 3.32),
    (12, 14): (2.65, 1.87),
}
CONVECTION = {
    (3, 7): (38.56, 33.70),
    (2, 7): (30.29, 25.92),
    (4, 7): (41.83, 31.57),
    (6, 7): (109.8, 144.7),
}


@pytest.mark.parametrize(("column", "designation"), [(0, "6311"), (1, "6016")])
def test_capacities_and_resistances_of_both_bearings(column: int, designation: str) -> None:
    data = bearing_14_data(bearing(designation))
    assert data.capacity_j_k == pytest.approx(CAPACITY[designation], rel=0.01)
    assert set(data.constant_k_w) == set(RESISTANCE)
    for pair, expected in RESISTANCE.items():
        assert data.constant_k_w[pair] == pytest.approx(expected[column], rel=0.01), pair
    assert set(data.convection_k_w) == set(CONVECTION)
    for pair, expected in CONVECTION.items():
        assert data.convection_k_w[pair] == pytest.approx(expected[column], rel=0.002), pair
    assert data.half_balls_k_w == pytest.approx((0.0676, 0.0591)[column], rel=0.002)


def test_sensor_rows_of_the_6311() -> None:
    model = build_model("paper", bearing=bearing("6311"))
    inner, outer = np.zeros(13), np.zeros(13)
    inner[[3, 4, 11]] = 0.939, 0.035, 0.026
    outer[[0, 1]] = 0.163, 0.837
    assert model.sensor_row("t_inner_ring_c") == pytest.approx(inner, abs=1e-3)
    assert model.sensor_row("t_outer_ring_c") == pytest.approx(outer, abs=1e-3)
    assert model.sensor_row("t_node_7_c").tolist() == np.eye(13)[6].tolist()
    assert model.sensor_matrix(model.sensor_names).sum(axis=1) == pytest.approx(1.0)


def test_seat_and_sleeve_share_the_shaft_beside_them() -> None:
    """The triangle between ring, sleeve and shaft is the star of seat, sleeve's fit and bar."""
    apart = bearing_14_data(bearing("6311"))
    shared = with_shoulders(apart)
    for shaft, sleeve, pair in ((5, 10, (5, 10)), (12, 11, (11, 12))):
        third = apart.shaft_bars_k_w[shaft] / 3.0
        seat = apart.constant_k_w[4, shaft] - third
        on_shaft = apart.constant_k_w[pair] - third / 2.0
        # ring at 1, shaft at 0, the sleeve hangs on the star alone: heat into the shaft
        face = 1.0 / apart.constant_k_w[4, sleeve]
        across = 1.0 / shared.constant_k_w[4, sleeve] - face
        to_shaft = 1.0 / shared.constant_k_w[pair]
        sleeve_c = across / (across + to_shaft)
        heat_w = 1.0 / shared.constant_k_w[4, shaft] + to_shaft * sleeve_c
        assert heat_w == pytest.approx(1.0 / (seat + third))
        # the same with the sleeve held at the ring's temperature
        both = 1.0 / (1.0 / seat + 1.0 / on_shaft) + third
        assert 1.0 / shared.constant_k_w[4, shaft] + to_shaft == pytest.approx(1.0 / both)
    assert sum(shared.inner_sensor.values()) == pytest.approx(1.0)
    ring, seat_j_k = apart.capacity_j_k[3], np.pi / 4 * 0.055**2 * 0.029 * 7850 * 434
    assert shared.capacity_j_k[3] == pytest.approx(ring + seat_j_k, rel=0.02)
    assert shared.capacity_j_k[4:] == apart.capacity_j_k[4:]


def test_edge_count() -> None:
    """27 edges as in the paper's network, of which 2 contact, 4 convective."""
    kinds = [edge.kind.name for edge in build_model("paper", bearing=bearing("6311")).network.edges]
    assert len(kinds) == 27
    assert kinds.count("CONTACT") == 2
    assert kinds.count("CONVECTIVE") == 4


def test_any_deep_groove_ball_bearing_has_a_network() -> None:
    data = bearing_14_data(bearing_from_dimensions("6308", 40.0, 90.0, 23.0))
    small, large = np.array(data.capacity_j_k), np.array(CAPACITY["6311"])
    assert (small[1:7] < large[1:7]).all()
    assert len(NODE_NAMES) == small.size == 13


def test_the_drum_grows_with_a_large_bearing() -> None:
    usual = bearing_14_data(bearing_from_dimensions("6218", 90.0, 160.0, 30.0))
    large = bearing_14_data(bearing_from_dimensions("6324", 120.0, 260.0, 55.0))
    steel_j_m3k = 7850.0 * 434.0
    for data, outer_m, drum_m, length_m in (
        (usual, 0.160, 0.200, 0.080),
        (large, 0.260, 0.300, 0.1375),
    ):
        house = np.pi / 4.0 * (drum_m**2 - outer_m**2) * length_m * steel_j_m3k
        assert data.capacity_j_k[0] == pytest.approx(house, rel=0.01)


@pytest.mark.parametrize(
    ("bore_mm", "outer_mm", "width_mm"),
    [(8.0, 22.0, 7.0), (40.0, 80.0, 18.0), (100.0, 215.0, 47.0), (120.0, 260.0, 55.0)],
)
@pytest.mark.parametrize("name", ["default", "paper", "paper-reduced"])
def test_all_models_settle_for_deep_groove_ball_bearings_of_all_sizes(
    name: str, bore_mm: float, outer_mm: float, width_mm: float
) -> None:
    part = bearing_from_dimensions("other", bore_mm, outer_mm, width_mm)
    model = build_model(name, bearing=part)
    speed_rpm = 1.0e5 / part.pitch_diameter_mm
    load_n = 0.05 * part.static_load_rating_n
    settled = steady_state(model, model.parameters.centre, speed_rpm, load_n, 20.0)
    assert settled.min() > 20.0
    assert settled.max() < 90.0


def test_a_longer_shaft_end_gives_off_more_heat_resting_and_rotating() -> None:
    network = build_model(bearing=bearing("6311")).network
    resting, rotating = (
        [edge.coefficients[term] for edge in network.edges if edge.kind is EdgeKind.SHAFT_SINK]
        for term in (0, 1)
    )
    assert [one.parameter for one in (*resting, *rotating)] == ["hsh", "hsh", "gs", "gs"]
    assert rotating[0].factor / rotating[1].factor == pytest.approx(
        resting[0].factor / resting[1].factor
    )
    # The parameter is the mean of both ends of a 55 mm shaft.
    assert sum(one.factor for one in rotating) == pytest.approx(2.0)
