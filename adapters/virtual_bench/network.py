"""The 28 nodes of the virtual bench and what joins them.

Twice as fine as the network of Wang et al. (Appl. Sci. 2025, 15(12), 6671): raceways, ring bodies
and seats apart, balls with surface and core, the shaft in eight pieces, grease in the bearing and
in both cavities, housing and base plate in two pieces each.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench.bearings import (
    BRASS_HEAT_CAPACITY,
    STEEL_CONDUCTIVITY,
    STEEL_DENSITY,
    STEEL_HEAT_CAPACITY,
    BenchBearing,
)
from adapters.virtual_bench.parameters import BenchParameters

NODE_NAMES = (
    "outer_raceway",
    "outer_ring",
    "outer_surface",
    "inner_raceway",
    "inner_ring",
    "inner_bore",
    "ball_surface",
    "ball_core",
    "cage",
    "grease",
    "cavity_left",
    "cavity_right",
    "housing_bore",
    "housing_shell",
    "cap_left",
    "cap_right",
    "sleeve_left",
    "sleeve_right",
    "shaft_seat",
    "shaft_left_1",
    "shaft_left_2",
    "shaft_left_3",
    "shaft_right_1",
    "shaft_right_2",
    "shaft_right_3",
    "shaft_right_4",
    "base_foot",
    "base_plate",
)
NODE_COUNT = len(NODE_NAMES)
(
    OUTER_RACEWAY, OUTER_RING, OUTER_SURFACE, INNER_RACEWAY, INNER_RING, INNER_BORE,
    BALL_SURFACE, BALL_CORE, CAGE, GREASE, CAVITY_LEFT, CAVITY_RIGHT, HOUSING_BORE, HOUSING_SHELL,
    CAP_LEFT, CAP_RIGHT, SLEEVE_LEFT, SLEEVE_RIGHT, SHAFT_SEAT, SHAFT_LEFT_1, SHAFT_LEFT_2,
    SHAFT_LEFT_3, SHAFT_RIGHT_1, SHAFT_RIGHT_2, SHAFT_RIGHT_3, SHAFT_RIGHT_4, BASE_FOOT, BASE_PLATE,
) = range(NODE_COUNT)  # fmt: skip

# Which bench nodes make up a node of the paper's table 1; the shaft seat belongs half to each side.
PAPER_NODES: dict[int, dict[int, float]] = {
    1: {HOUSING_BORE: 1.0, HOUSING_SHELL: 1.0},
    2: {OUTER_RACEWAY: 1.0, OUTER_RING: 1.0, OUTER_SURFACE: 1.0},
    3: {BALL_SURFACE: 1.0, BALL_CORE: 1.0},
    4: {INNER_RACEWAY: 1.0, INNER_RING: 1.0, INNER_BORE: 1.0},
    5: {SHAFT_SEAT: 0.5, SHAFT_LEFT_1: 1.0, SHAFT_LEFT_2: 1.0, SHAFT_LEFT_3: 1.0},
    6: {CAGE: 1.0},
    7: {GREASE: 1.0, CAVITY_LEFT: 1.0, CAVITY_RIGHT: 1.0},
    8: {CAP_LEFT: 1.0},
    9: {CAP_RIGHT: 1.0},
    10: {SLEEVE_LEFT: 1.0},
    11: {SLEEVE_RIGHT: 1.0},
    12: {
        SHAFT_SEAT: 0.5, SHAFT_RIGHT_1: 1.0, SHAFT_RIGHT_2: 1.0, SHAFT_RIGHT_3: 1.0,
        SHAFT_RIGHT_4: 1.0,
    },
    13: {BASE_FOOT: 1.0, BASE_PLATE: 1.0},
}  # fmt: skip

_HOUSING_OUTSIDE = 0.200  # m, drum around the bearing
_HOUSING_LENGTH = 0.080
_CAP_THICKNESS = 0.020
_SLEEVE_LENGTH = 0.030
_SLEEVE_WALL = 0.0075
_SHAFT_LEFT_PIECE = 0.050  # three of them
_SHAFT_RIGHT_PIECE = 0.0625  # four of them, 5 mm thicker than the seat
_FOOT_AREA = 0.2 * 0.12
_PLATE_AREA = 0.8 * 0.5
_PLATE_THICKNESS = 0.06
_CAST_CONDUCTIVITY = 50.0
_GREASE_HEAT_CAPACITY = 1900.0
_FIT_COEFFICIENT = 2.0e4  # W/(m2 K), interference fit
_SLIDE_FIT_COEFFICIENT = 4.5e3  # outer ring in its housing
_FACE_COEFFICIENT = 1.5e3  # ring face against end cap
_CLAMPED_COEFFICIENT = 3.0e3  # ring face against sleeve, sleeve on shaft
_BOLTED_COEFFICIENT = 2.0e3  # cap on housing, housing on foot


class BenchNetwork(NamedTuple):
    """Compiled arrays of one bench (n = 28 nodes, W/K and J/K)."""

    capacity: NDArray[np.float64]  # (n,) heat capacities
    #: (n, n) constant conductances between nodes, symmetric, zero diagonal.
    conductance: NDArray[np.float64]
    #: Nodes washed by the grease, their areas, and the conductance in W/K at standstill.
    film_node: NDArray[np.int64]
    film_area_m2: NDArray[np.float64]
    film_still: NDArray[np.float64]
    #: Surfaces in still air and their characteristic length.
    outside_node: NDArray[np.int64]
    outside_area_m2: NDArray[np.float64]
    outside_length_m: NDArray[np.float64]
    #: Surfaces of the rotating shaft in air.
    shaft_node: NDArray[np.int64]
    shaft_area_m2: NDArray[np.float64]
    shaft_diameter_m: NDArray[np.float64]


def _tube(outside_m: float, inside_m: float, length_m: float, conductivity: float) -> float:
    """Radial conductance of a tube wall in W/K."""
    return 2.0 * math.pi * conductivity * length_m / math.log(outside_m / inside_m)


def _disc(outside_m: float, inside_m: float = 0.0) -> float:
    """Area of a disc or annulus in m2."""
    return 0.25 * math.pi * (outside_m**2 - inside_m**2)


def _series(*conductances: float) -> float:
    """Conductance of parts in a row."""
    return 1.0 / sum(1.0 / conductance for conductance in conductances)


def build_network(bearing: BenchBearing, parameters: BenchParameters) -> BenchNetwork:
    """Turn geometry into capacities and conductances."""
    return BenchNetwork(
        _capacities(bearing) * parameters.capacity_scale,
        _conductances(bearing, parameters),
        *_films(bearing),
        *_outside(bearing),
        *_shaft_surfaces(bearing),
    )


def _capacities(bearing: BenchBearing) -> NDArray[np.float64]:
    steel = STEEL_DENSITY * STEEL_HEAT_CAPACITY
    shaft = bearing.bore_m
    thick = shaft + 0.005
    housing = steel * _disc(_HOUSING_OUTSIDE, bearing.outside_m) * _HOUSING_LENGTH
    cap = steel * _disc(_HOUSING_OUTSIDE, shaft + 0.02) * _CAP_THICKNESS
    sleeve = steel * _disc(shaft + 2.0 * _SLEEVE_WALL, shaft) * _SLEEVE_LENGTH
    outer = bearing.outer_ring_kg * STEEL_HEAT_CAPACITY
    inner = bearing.inner_ring_kg * STEEL_HEAT_CAPACITY
    balls = bearing.ball_count * bearing.ball_kg * STEEL_HEAT_CAPACITY
    grease = bearing.grease_kg * _GREASE_HEAT_CAPACITY
    plate = steel * _PLATE_AREA * _PLATE_THICKNESS
    capacity = np.empty(NODE_COUNT)
    capacity[[OUTER_RACEWAY, OUTER_RING, OUTER_SURFACE]] = outer * np.array([0.2, 0.55, 0.25])
    capacity[[INNER_RACEWAY, INNER_RING, INNER_BORE]] = inner * np.array([0.2, 0.55, 0.25])
    capacity[[BALL_SURFACE, BALL_CORE]] = balls * np.array([0.4, 0.6])
    capacity[CAGE] = bearing.cage_kg * BRASS_HEAT_CAPACITY
    capacity[[GREASE, CAVITY_LEFT, CAVITY_RIGHT]] = grease * np.array([0.4, 0.3, 0.3])
    capacity[[HOUSING_BORE, HOUSING_SHELL]] = housing * np.array([0.35, 0.65])
    capacity[[CAP_LEFT, CAP_RIGHT]] = cap
    capacity[[SLEEVE_LEFT, SLEEVE_RIGHT]] = sleeve
    capacity[SHAFT_SEAT] = steel * _disc(shaft) * bearing.width_m
    capacity[SHAFT_LEFT_1 : SHAFT_LEFT_3 + 1] = steel * _disc(shaft) * _SHAFT_LEFT_PIECE
    capacity[SHAFT_RIGHT_1 : SHAFT_RIGHT_4 + 1] = steel * _disc(thick) * _SHAFT_RIGHT_PIECE
    capacity[[BASE_FOOT, BASE_PLATE]] = plate * np.array([0.13, 0.87])
    return capacity


def _conductances(bearing: BenchBearing, parameters: BenchParameters) -> NDArray[np.float64]:
    k = STEEL_CONDUCTIVITY
    width, shaft = bearing.width_m, bearing.bore_m
    thick = shaft + 0.005
    joint, shaft_joint = parameters.joint_scale, parameters.shaft_joint_scale
    matrix = np.zeros((NODE_COUNT, NODE_COUNT))

    def join(a: int, b: int, conductance: float) -> None:
        matrix[a, b] = matrix[b, a] = conductance

    outer_wall = _tube(bearing.outside_m, bearing.outer_groove_m, width, k)
    inner_wall = _tube(bearing.inner_groove_m, shaft, width, k)
    # heat enters a ring along a narrow track and spreads over its width
    outer_track = math.pi**2 * k * bearing.outer_groove_m / math.log(width / 0.004)
    inner_track = math.pi**2 * k * bearing.inner_groove_m / math.log(width / 0.004)
    join(OUTER_RACEWAY, OUTER_RING, _series(2.5 * outer_wall, outer_track))
    join(OUTER_RING, OUTER_SURFACE, 2.5 * outer_wall)
    join(INNER_RACEWAY, INNER_RING, _series(2.5 * inner_wall, inner_track))
    join(INNER_RING, INNER_BORE, 2.5 * inner_wall)
    # sphere: surface to the mean radius of its core, all balls
    join(BALL_SURFACE, BALL_CORE, bearing.ball_count * 2.0 * math.pi * k * bearing.ball_m)

    housing_wall = _tube(_HOUSING_OUTSIDE, bearing.outside_m, _HOUSING_LENGTH, _CAST_CONDUCTIVITY)
    seat_area = math.pi * bearing.outside_m * width
    bore_area = math.pi * shaft * width
    join(
        OUTER_SURFACE,
        HOUSING_BORE,
        _series(joint * _SLIDE_FIT_COEFFICIENT * seat_area, 5.0 * housing_wall),
    )
    join(HOUSING_BORE, HOUSING_SHELL, 2.0 * housing_wall)
    face = joint * _FACE_COEFFICIENT * _disc(bearing.outside_m, bearing.outer_shoulder_m)
    flange = joint * _BOLTED_COEFFICIENT * _disc(_HOUSING_OUTSIDE, 0.15)
    for cap, cavity in ((CAP_LEFT, CAVITY_LEFT), (CAP_RIGHT, CAVITY_RIGHT)):
        join(OUTER_RING, cap, face)
        join(HOUSING_SHELL, cap, flange)
        join(cavity, cap, 15.0 * _disc(bearing.outside_m, shaft + 0.02))
        join(GREASE, cavity, 0.25)
    join(
        HOUSING_SHELL,
        BASE_FOOT,
        _series(joint * _BOLTED_COEFFICIENT * _FOOT_AREA, 25.0),
    )
    join(BASE_FOOT, BASE_PLATE, 33.0)

    join(
        INNER_BORE,
        SHAFT_SEAT,
        _series(shaft_joint * _FIT_COEFFICIENT * bore_area, 8.0 * math.pi * k * width),
    )
    left = k * _disc(shaft) / _SHAFT_LEFT_PIECE
    right = k * _disc(thick) / _SHAFT_RIGHT_PIECE
    seat = 2.0 * k * _disc(shaft) / width
    join(SHAFT_SEAT, SHAFT_LEFT_1, _series(seat, 2.0 * left))
    join(SHAFT_LEFT_1, SHAFT_LEFT_2, left)
    join(SHAFT_LEFT_2, SHAFT_LEFT_3, left)
    join(SHAFT_SEAT, SHAFT_RIGHT_1, _series(seat, 2.0 * right))
    join(SHAFT_RIGHT_1, SHAFT_RIGHT_2, right)
    join(SHAFT_RIGHT_2, SHAFT_RIGHT_3, right)
    join(SHAFT_RIGHT_3, SHAFT_RIGHT_4, right)
    sleeve_outside = shaft + 2.0 * _SLEEVE_WALL
    clamped = _series(
        shaft_joint * _CLAMPED_COEFFICIENT * 0.6 * _disc(bearing.inner_shoulder_m, shaft),
        2.0 * k * _disc(sleeve_outside, shaft) / _SLEEVE_LENGTH,
    )
    on_shaft = shaft_joint * _CLAMPED_COEFFICIENT * math.pi * shaft * _SLEEVE_LENGTH
    for sleeve, piece, cavity in (
        (SLEEVE_LEFT, SHAFT_LEFT_1, CAVITY_LEFT),
        (SLEEVE_RIGHT, SHAFT_RIGHT_1, CAVITY_RIGHT),
    ):
        join(INNER_RING, sleeve, clamped)
        join(sleeve, piece, on_shaft)
        join(cavity, sleeve, 15.0 * math.pi * sleeve_outside * _SLEEVE_LENGTH)
    return matrix


def _films(
    bearing: BenchBearing,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    width = bearing.width_m
    gap = 0.5 * (bearing.outer_shoulder_m - bearing.inner_shoulder_m)
    nodes = np.array([BALL_SURFACE, OUTER_RING, INNER_RING, CAGE], dtype=np.int64)
    areas = math.pi * np.array(
        [
            bearing.ball_count * bearing.ball_m**2,
            bearing.outer_shoulder_m * width,
            bearing.inner_shoulder_m * width,
            2.0 * bearing.pitch_m * 0.6 * width,
        ]
    )
    return nodes, areas, 0.15 / (0.5 * gap) * areas  # grease at standstill conducts, 0.15 W/(m K)


def _outside(
    bearing: BenchBearing,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    cap = _disc(_HOUSING_OUTSIDE, bearing.bore_m + 0.02) + (
        math.pi * _HOUSING_OUTSIDE * _CAP_THICKNESS
    )
    plate = 2.0 * _PLATE_AREA + 2.0 * (0.8 + 0.5) * _PLATE_THICKNESS - _FOOT_AREA
    nodes = np.array([HOUSING_SHELL, CAP_LEFT, CAP_RIGHT, BASE_FOOT, BASE_PLATE], dtype=np.int64)
    areas = np.array(
        [math.pi * _HOUSING_OUTSIDE * _HOUSING_LENGTH, cap, cap, 0.1 * plate, 0.9 * plate]
    )
    return nodes, areas, np.array([0.2, 0.2, 0.2, 0.25, 0.25])


def _shaft_surfaces(
    bearing: BenchBearing,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    shaft = bearing.bore_m
    nodes = np.arange(SHAFT_LEFT_1, SHAFT_RIGHT_4 + 1)
    diameters = np.where(nodes <= SHAFT_LEFT_3, shaft, shaft + 0.005)
    lengths = np.where(nodes <= SHAFT_LEFT_3, _SHAFT_LEFT_PIECE, _SHAFT_RIGHT_PIECE)
    # the sleeves cover part of the pieces next to the bearing
    covered = np.isin(nodes, (SHAFT_LEFT_1, SHAFT_RIGHT_1)) * _SLEEVE_LENGTH
    return nodes.astype(np.int64), math.pi * diameters * (lengths - covered), diameters


def paper_node_weights(network: BenchNetwork) -> NDArray[np.float64]:
    """Rows (13, 28) that average nodes into the paper's by heat capacity; each sums to 1."""
    weights = np.zeros((len(PAPER_NODES), NODE_COUNT))
    for number, parts in PAPER_NODES.items():
        for node, part in parts.items():
            weights[number - 1, node] = part * network.capacity[node]
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
