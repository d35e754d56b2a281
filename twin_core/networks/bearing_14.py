"""The 14-node network of a bearing in its test drum (Wang et al., figure 5 and table 1).

Thirteen state nodes and the ambient (node 14). Geometry that the paper does not give is that of
a test bench of its size: a steel drum of 200 mm with the bearing in its middle, two end caps, a
shaft in two parts with two sleeves next to the bearing, all on a steel plate.
"""

import math
from dataclasses import dataclass, replace

from twin_core import materials, resistances
from twin_core.bearings import Bearing
from twin_core.network import (
    AMBIENT,
    Coefficient,
    Edge,
    EdgeKind,
    HeatSource,
    Network,
    Node,
    Sensor,
)

NODE_COUNT = 13
NODE_NAMES = tuple(f"t_node_{number}_c" for number in range(1, NODE_COUNT + 1))
"""In the paper's order: house, outer ring, balls, inner ring, shaft left, cage, grease-oil-air
mixture, end caps (2), sleeves (2), shaft centre, bench."""

# Bench geometry in m. The drum is the bench's, or as large as the bearing needs.
_DRUM_OUTER = 0.200
_DRUM_WALL = 0.020
_DRUM_LENGTH = 0.080
_DRUM_LENGTH_IN_WIDTHS = 2.5
_CAP_THICKNESS = 0.020
_CAP_CLEARANCE = 0.003
_SHAFT_LEFT_LENGTH = 0.150
_SHAFT_CENTRE_LENGTH = 0.250
_SHAFT_CENTRE_STEP = 0.005
_SHAFT_SPAN = 0.200
_SLEEVE_WALL = 0.0075
_SLEEVE_LENGTH = 0.030
_CAVITY_LENGTH = 0.020
_PLATE = (0.8, 0.5, 0.06)
_FOOT_AREA = 0.2 * 0.12

# Joint and film coefficients in W/m2K.
_FIT_JOINT = 2.0e4
_SLEEVE_FACE_JOINT = 3000.0
_CAP_HOUSE_JOINT = 2000.0
_CAP_RING_JOINT = 1500.0
_FOOT_JOINT = 3000.0
_OUTER_FILM = 8.0
_CAVITY_FILM = 15.0

# Outer ring in its bore: transition fit, mean gap and share of true contact.
_HOUSE_GAP = 15e-6
_HOUSE_CONTACT_FRACTION = 5e-4
_HOUSE_GAP_FLUID = 0.03

# Grease: share of the bearing's free volume and of the two side cavities.
_FILL_BEARING = 0.30
_FILL_CAVITY = 0.40


@dataclass(frozen=True, slots=True)
class Bearing14:
    """Capacities and resistances of the network, computed once from a bearing."""

    capacity_j_k: tuple[float, ...]  # per node, in node order
    #: Resistances of the constant edges by their pair of node numbers (14: ambient).
    constant_k_w: dict[tuple[int, int], float]
    half_balls_k_w: float  # half of the resistance of all balls, in each contact edge
    #: L / (k S) by pair: the resistance of a convective edge at Nu = 1.
    convection_k_w: dict[tuple[int, int], float]
    #: Weights by node number: ring bore, outer surface of the outer ring.
    inner_sensor: dict[int, float]
    outer_sensor: dict[int, float]
    half_inner_ring_k_w: float  # from the inner ring to its bore
    #: L / (k S) of the left and the centre part of the shaft, by node number.
    shaft_bars_k_w: dict[int, float]
    #: Of the piece of shaft inside the inner ring, which the paper's nodes do not contain.
    seat_capacity_j_k: float


def bearing_14_data(bearing: Bearing) -> Bearing14:
    """Compute the network's constant data from the bearing's dimensions.

    The bench is that of the paper's bearings; only the drum grows with a bearing that would not
    leave 20 mm of wall, or that is wider than two fifths of it.
    """
    bore, outer, width = (
        length * 1e-3 for length in (bearing.bore_mm, bearing.outer_mm, bearing.width_mm)
    )
    inner_shoulder = bearing.inner_shoulder_mm * 1e-3
    outer_shoulder = bearing.outer_shoulder_mm * 1e-3
    ball = bearing.ball_diameter_mm * 1e-3
    pitch = bearing.pitch_diameter_mm * 1e-3
    sleeve = bore + 2.0 * _SLEEVE_WALL
    centre = bore + _SHAFT_CENTRE_STEP
    cap_bore = inner_shoulder - _CAP_CLEARANCE
    drum = max(_DRUM_OUTER, outer + 2.0 * _DRUM_WALL)
    drum_length = max(_DRUM_LENGTH, _DRUM_LENGTH_IN_WIDTHS * width)

    drum_face = resistances.annulus(outer, drum)
    cap_face = resistances.annulus(cap_bore, drum)
    cavity_face = resistances.annulus(inner_shoulder, outer)
    outer_face = resistances.annulus(outer_shoulder, outer)
    inner_face = resistances.annulus(bore, inner_shoulder)
    sleeve_face = resistances.annulus(bore, sleeve)
    left_section = resistances.annulus(0.0, bore)
    centre_section = resistances.annulus(0.0, centre)
    plate_length, plate_width, plate_height = _PLATE
    plate_area = 2.0 * (plate_length * plate_width + (plate_length + plate_width) * plate_height)

    steel_heat = materials.STRUCTURAL_STEEL.volumetric_heat_j_m3k
    cap_heat = cap_face * _CAP_THICKNESS * steel_heat
    sleeve_heat = sleeve_face * _SLEEVE_LENGTH * steel_heat
    capacity = (
        drum_face * drum_length * steel_heat,
        bearing.outer_ring_kg * materials.RING_STEEL.specific_heat_j_kgk,
        bearing.balls_kg * materials.BALL_STEEL.specific_heat_j_kgk,
        bearing.inner_ring_kg * materials.RING_STEEL.specific_heat_j_kgk,
        left_section * _SHAFT_LEFT_LENGTH * steel_heat,
        bearing.cage_kg * materials.CAGE_METAL.specific_heat_j_kgk,
        _grease_kg(bearing) * materials.GREASE_SPECIFIC_HEAT_J_KGK,
        cap_heat,
        cap_heat,
        sleeve_heat,
        sleeve_heat,
        centre_section * _SHAFT_CENTRE_LENGTH * steel_heat,
        plate_length * plate_width * plate_height * steel_heat,
    )

    k = materials.STRUCTURAL_STEEL.conductivity_w_mk
    k_ring = materials.RING_STEEL.conductivity_w_mk
    half_outer_ring = resistances.radial_shell((outer + outer_shoulder) / 2.0, outer, width, k_ring)
    house_joint = resistances.clearance_joint(
        _HOUSE_GAP,
        resistances.cylinder_side(outer, width),
        _HOUSE_CONTACT_FRACTION,
        k_ring,
        _HOUSE_GAP_FLUID,
    )
    half_house = resistances.radial_shell(outer, (drum + outer) / 2.0, drum_length, k)
    half_inner_ring = resistances.radial_shell(bore, (bore + inner_shoulder) / 2.0, width, k_ring)
    # The left and the centre shaft each take half of the ring's seat, hence the factor two.
    seat = 2.0 * (
        half_inner_ring
        + resistances.joint(_FIT_JOINT, resistances.cylinder_side(bore, width))
        + resistances.heated_cylinder(width, k)
    )
    left_bar = resistances.bar(_SHAFT_LEFT_LENGTH, left_section, k)
    centre_bar = resistances.bar(_SHAFT_CENTRE_LENGTH, centre_section, k)
    sleeve_seat = (
        resistances.radial_shell(bore, (bore + sleeve) / 2.0, _SLEEVE_LENGTH, k)
        + resistances.joint(_FIT_JOINT, resistances.cylinder_side(bore, _SLEEVE_LENGTH))
        + resistances.heated_cylinder(_SLEEVE_LENGTH, k)
    )
    ring_to_sleeve = (
        resistances.joint(_SLEEVE_FACE_JOINT, sleeve_face)
        + resistances.bar(_SLEEVE_LENGTH / 2.0, sleeve_face, k)
        + resistances.bar(width / 2.0, inner_face, k_ring)
    )
    house_to_cap = resistances.joint(_CAP_HOUSE_JOINT, drum_face) + resistances.bar(
        (drum_length / 2.0 + _CAP_THICKNESS) / 2.0, drum_face, k
    )
    ring_to_cap = resistances.joint(_CAP_RING_JOINT, outer_face) + resistances.bar(
        (width + _CAP_THICKNESS) / 2.0, outer_face, k
    )
    cavity = resistances.joint(_CAVITY_FILM, cavity_face)
    foot = resistances.joint(_FOOT_JOINT, _FOOT_AREA) + resistances.spreading(
        math.sqrt(_FOOT_AREA / math.pi), k
    )
    # Half of the foot's area is lost to the drum's free surface.
    drum_film = resistances.joint(
        _OUTER_FILM, resistances.cylinder_side(drum, drum_length) - _FOOT_AREA / 2.0
    )
    cap_film = resistances.joint(
        _OUTER_FILM, cap_face + resistances.cylinder_side(drum, _CAP_THICKNESS)
    )
    house_to_ring = half_outer_ring + house_joint + half_house
    ring_to_left = seat + left_bar / 3.0
    ring_to_centre = seat + centre_bar / 3.0
    constant = {
        (1, 2): house_to_ring,
        (4, 5): ring_to_left,
        (4, 12): ring_to_centre,
        (5, 12): resistances.bar(_SHAFT_SPAN, left_section, k),
        (4, 10): ring_to_sleeve,
        (4, 11): ring_to_sleeve,
        (5, 10): sleeve_seat + left_bar / 6.0,
        (11, 12): sleeve_seat + centre_bar / 6.0,
        (1, 8): house_to_cap,
        (1, 9): house_to_cap,
        (2, 8): ring_to_cap,
        (2, 9): ring_to_cap,
        (7, 8): cavity,
        (7, 9): cavity,
        (1, 13): foot,
        (1, 14): drum_film,
        (8, 14): cap_film,
        (9, 14): cap_film,
        (13, 14): resistances.joint(_OUTER_FILM, plate_area),
        (5, 14): resistances.joint(
            _OUTER_FILM, resistances.cylinder_side(bore, _SHAFT_LEFT_LENGTH)
        ),
        (12, 14): resistances.joint(
            _OUTER_FILM, resistances.cylinder_side(centre, _SHAFT_CENTRE_LENGTH)
        ),
    }

    k_mixture = materials.MIXTURE_CONDUCTIVITY_W_MK
    gap = (outer_shoulder - inner_shoulder) / 2.0
    convection = {
        (3, 7): ball / (k_mixture * bearing.ball_count * math.pi * ball**2),
        (2, 7): gap / (k_mixture * resistances.cylinder_side(outer_shoulder, width)),
        (4, 7): gap / (k_mixture * resistances.cylinder_side(inner_shoulder, width)),
        (6, 7): pitch / 2.0 / (k_mixture * resistances.cylinder_side(pitch, width)),
    }
    # The sensors sit on the surfaces, part of the way from a ring node to its neighbour.
    to_left = half_inner_ring / ring_to_left
    to_centre = half_inner_ring / ring_to_centre
    to_house = half_outer_ring / house_to_ring
    return Bearing14(
        capacity_j_k=capacity,
        constant_k_w=constant,
        half_balls_k_w=resistances.ball(ball / 2.0, materials.BALL_STEEL.conductivity_w_mk)
        / bearing.ball_count
        / 2.0,
        convection_k_w=convection,
        inner_sensor={4: 1.0 - to_left - to_centre, 5: to_left, 12: to_centre},
        outer_sensor={2: 1.0 - to_house, 1: to_house},
        half_inner_ring_k_w=half_inner_ring,
        shaft_bars_k_w={5: left_bar, 12: centre_bar},
        seat_capacity_j_k=left_section * width * steel_heat,
    )


def with_shoulders(data: Bearing14) -> Bearing14:
    """Let the heat that leaves by the seat and that of a sleeve share the shaft next to them.

    Both enter the shaft at its shoulder and leave along the same bar, of which a third lies
    between the shoulder and the bar's mean temperature. Two separate ways to that mean, as in the
    paper's network, conduct nearly twice as much as the bar: the shaft comes out too hot, by 9 K
    on virtual benches, and a standing machine cools too slowly. The shoulder has no capacity, so
    that the star of seat, sleeve and bar becomes a triangle of edges between ring, sleeve and
    shaft. The piece of shaft inside the ring follows the ring, and its capacity is added there.
    """
    constant = dict(data.constant_k_w)
    inner = dict(data.inner_sensor)
    for shaft, sleeve in ((5, 10), (12, 11)):
        bar = data.shaft_bars_k_w[shaft]
        pair = (min(shaft, sleeve), max(shaft, sleeve))
        seat = constant[4, shaft] - bar / 3.0
        on_shaft = constant[pair] - bar / 6.0
        triangle = seat * on_shaft + (seat + on_shaft) * bar / 3.0
        constant[4, shaft] = triangle / on_shaft
        constant[pair] = triangle / seat
        across = triangle / (bar / 3.0)
        constant[4, sleeve] = 1.0 / (1.0 / constant[4, sleeve] + 1.0 / across)
        inner[shaft] = data.half_inner_ring_k_w / constant[4, shaft]
        inner[sleeve] = data.half_inner_ring_k_w / across
    inner[4] = 1.0 - sum(weight for node, weight in inner.items() if node != 4)
    capacity = list(data.capacity_j_k)
    capacity[4 - 1] += data.seat_capacity_j_k
    return replace(data, capacity_j_k=tuple(capacity), constant_k_w=constant, inner_sensor=inner)


def node_name(number: int) -> str:
    """Name of the paper's node *number* (14: the ambient)."""
    return AMBIENT if number == NODE_COUNT + 1 else NODE_NAMES[number - 1]


def edge_between(pair: tuple[int, int], kind: EdgeKind, *coefficients: Coefficient) -> Edge:
    """Edge between two of the paper's node numbers."""
    return Edge(node_name(pair[0]), node_name(pair[1]), kind, coefficients)


def assemble(
    name: str,
    data: Bearing14,
    edges: tuple[Edge, ...],
    source: HeatSource,
    capacity_parameter: str = "",
) -> Network:
    """Put the network together from its data, the edges of a model and its heat source."""
    nodes = tuple(
        Node(node_name(number), Coefficient(capacity, capacity_parameter))
        for number, capacity in enumerate(data.capacity_j_k, start=1)
    )
    sensors = (
        _sensor("t_inner_ring_c", data.inner_sensor),
        _sensor("t_outer_ring_c", data.outer_sensor),
    )
    return Network(name, nodes, edges, source, sensors)


def _sensor(name: str, weights: dict[int, float]) -> Sensor:
    return Sensor(name, tuple((node_name(number), weight) for number, weight in weights.items()))


def _grease_kg(bearing: Bearing) -> float:
    """Mass of the grease in the bearing and in the two 10 mm cavities next to it."""
    outer, width = bearing.outer_mm * 1e-3, bearing.width_mm * 1e-3
    solid = (
        (bearing.inner_ring_kg + bearing.outer_ring_kg) / materials.RING_STEEL.density_kg_m3
        + bearing.balls_kg / materials.BALL_STEEL.density_kg_m3
        + bearing.cage_kg / materials.CAGE_METAL.density_kg_m3
    )
    free = max(resistances.annulus(bearing.bore_mm * 1e-3, outer) * width - solid, 0.0)
    cavity = resistances.annulus(bearing.inner_shoulder_mm * 1e-3, outer) * _CAVITY_LENGTH
    return (_FILL_BEARING * free + _FILL_CAVITY * cavity) * materials.GREASE_DENSITY_KG_M3
