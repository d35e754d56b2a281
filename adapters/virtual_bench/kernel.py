"""Compiled equations of the bench's thermal plant: heat made, heat moved, one implicit step."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench.bearings import BEARINGS
from adapters.virtual_bench.compiling import compiled
from adapters.virtual_bench.contacts import ContactConstants, contact_constants, contact_state
from adapters.virtual_bench.friction import (
    FrictionConstants,
    friction_constants,
    frictional_moment,
    grease_condition,
    oil_viscosity,
)
from adapters.virtual_bench.network import (
    BALL_CORE,
    BALL_SURFACE,
    CAGE,
    GREASE,
    INNER_RACEWAY,
    INNER_RING,
    OUTER_RACEWAY,
    OUTER_RING,
    BenchNetwork,
    build_network,
)
from adapters.virtual_bench.parameters import BenchParameters

_OIL_CONDUCTIVITY = 0.14  # W/(m K)
_OIL_VOLUME_HEAT = 1.76e6  # J/(m3 K)
_AIR_CONDUCTIVITY = 0.026
_AIR_VISCOSITY = 1.6e-5  # m2/s
_AIR_PRANDTL_THIRD = 0.89
_STEFAN_BOLTZMANN = 5.670e-8
_LIFE_C = 60.0  # temperature at which a grease's life is stated
_LIFE_HALVES_K = 15.0


class PlantConstants(NamedTuple):
    """Numbers of heat split and heat transfer that do not change during a run."""

    inner_share: float
    ball_share: float
    mixture_share: float
    film_scale: float
    shaft_scale: float
    outside_scale: float
    emissivity: float
    pitch_m: float
    gamma: float
    pocket_area_m2: float
    run_in_amplitude: float
    run_in_revolutions: float
    grease_life_s: float
    thickening: float


class BenchModel(NamedTuple):
    """Everything the kernel needs to know about one bench."""

    network: BenchNetwork
    friction: FrictionConstants
    contact: ContactConstants
    plant: PlantConstants


def build_model(parameters: BenchParameters) -> BenchModel:
    """Derive the kernel's constants from the parameters of a bench."""
    bearing = BEARINGS[parameters.bearing]
    return BenchModel(
        build_network(bearing, parameters),
        friction_constants(bearing, parameters),
        contact_constants(bearing, parameters),
        PlantConstants(
            inner_share=parameters.inner_share,
            ball_share=parameters.ball_share,
            mixture_share=parameters.mixture_share,
            film_scale=parameters.film_scale,
            shaft_scale=parameters.shaft_scale,
            outside_scale=parameters.outside_scale,
            emissivity=parameters.emissivity,
            pitch_m=bearing.pitch_m,
            gamma=bearing.ball_m / bearing.pitch_m,
            pocket_area_m2=0.3 * bearing.ball_count * math.pi * bearing.ball_m**2,
            run_in_amplitude=parameters.run_in_amplitude,
            run_in_revolutions=parameters.run_in_revolutions,
            grease_life_s=3600.0 * parameters.grease_life_h,
            thickening=parameters.thickening,
        ),
    )


@compiled
def _join(matrix: NDArray[np.float64], a: int, b: int, conductance: float) -> None:
    matrix[a, a] += conductance
    matrix[b, b] += conductance
    matrix[a, b] -= conductance
    matrix[b, a] -= conductance


@compiled
def _solve(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> None:
    """Solve a symmetric positive definite system in place (L D L^T, no pivoting)."""
    n = right.size
    for k in range(n):
        pivot = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            if matrix[i, k] != 0.0:
                factor = matrix[i, k] * pivot
                right[i] -= factor * right[k]
                for j in range(k + 1, i + 1):
                    matrix[i, j] -= factor * matrix[j, k]
    for k in range(n - 1, -1, -1):
        total = right[k]
        for i in range(k + 1, n):
            total -= matrix[i, k] * right[i]
        right[k] = total / matrix[k, k]


@compiled
def friction_heat(
    temperature: NDArray[np.float64],
    speed_rpm: float,
    load_n: float,
    grease: NDArray[np.float64],
    model: BenchModel,
    heat: NDArray[np.float64],
) -> float:
    """Add the friction heat of one operating point to `heat` (W per node); returns its sum.

    Every contact works at the oil temperature of its own inlet: raceway, ball and surrounding
    grease mixed. `grease` is its running-in state and the oil left in it.
    """
    plant = model.plant
    omega = math.pi / 30.0 * speed_rpm
    thicker, dry_share = grease_condition(grease[1], plant.thickening)
    total = 0.0
    for contact in range(2):
        raceway = INNER_RACEWAY if contact == 0 else OUTER_RACEWAY
        share = plant.inner_share if contact == 0 else 1.0 - plant.inner_share
        inlet_c = (
            0.4 * temperature[raceway] + 0.3 * temperature[BALL_SURFACE] + 0.3 * temperature[GREASE]
        )
        viscosity = thicker * oil_viscosity(
            inlet_c, model.friction.walther_a, model.friction.walther_b
        )
        rolling, sliding = frictional_moment(
            speed_rpm, load_n, viscosity, model.friction, dry_share
        )
        rolling *= share * (1.0 + plant.run_in_amplitude * grease[0]) * omega
        sliding *= share * omega
        at_contact = (1.0 - plant.mixture_share) * rolling + sliding
        heat[GREASE] += plant.mixture_share * rolling
        heat[BALL_SURFACE] += plant.ball_share * at_contact
        heat[raceway] += (1.0 - plant.ball_share) * at_contact
        total += rolling + sliding
    return total


@compiled
def _add_films(
    temperature: NDArray[np.float64],
    speed_rpm: float,
    model: BenchModel,
    matrix: NDArray[np.float64],
) -> None:
    """Heat transfer between grease and metal: laminar plate flow at a third of the cage speed."""
    plant, network = model.plant, model.network
    viscosity = 1e-6 * oil_viscosity(
        temperature[GREASE], model.friction.walther_a, model.friction.walther_b
    )
    cage_speed = math.pi / 120.0 * speed_rpm * (1.0 - plant.gamma) * plant.pitch_m
    prandtl = viscosity * _OIL_VOLUME_HEAT / _OIL_CONDUCTIVITY
    coefficient = (
        plant.film_scale
        * 0.332
        * _OIL_CONDUCTIVITY
        * prandtl ** (1.0 / 3.0)
        * math.sqrt(cage_speed / (3.0 * viscosity * plant.pitch_m))
    )
    for k in range(network.film_node.size):
        conductance = math.hypot(coefficient * network.film_area_m2[k], network.film_still[k])
        _join(matrix, GREASE, network.film_node[k], conductance)
    _join(matrix, CAGE, BALL_SURFACE, 0.05 + coefficient * plant.pocket_area_m2)


@compiled
def _still_air(
    surface_c: float, ambient_c: float, length_m: float, scale: float, emissivity: float
) -> float:
    """Natural convection 1.32 (dT/L)^0.25 and radiation to the surroundings in W/(m2 K)."""
    convection = 1.32 * scale * math.sqrt(math.sqrt(abs(surface_c - ambient_c) / length_m))
    hot, cold = surface_c + 273.15, ambient_c + 273.15
    radiation = emissivity * _STEFAN_BOLTZMANN * (hot * hot + cold * cold) * (hot + cold)
    return convection + radiation


@compiled
def _add_air(
    temperature: NDArray[np.float64],
    speed_rpm: float,
    ambient_c: float,
    cooling: float,
    model: BenchModel,
    matrix: NDArray[np.float64],
    right: NDArray[np.float64],
) -> None:
    """Heat given to the air by standing surfaces and by the rotating shaft (Becker 1963).

    `cooling` is a factor on the whole film of housing and base plate, radiation included.
    """
    plant, network = model.plant, model.network
    for k in range(network.outside_node.size):
        node = network.outside_node[k]
        conductance = (
            cooling
            * network.outside_area_m2[k]
            * _still_air(
                temperature[node],
                ambient_c,
                network.outside_length_m[k],
                plant.outside_scale,
                plant.emissivity,
            )
        )
        matrix[node, node] += conductance
        right[node] += conductance * ambient_c
    for k in range(network.shaft_node.size):
        node = network.shaft_node[k]
        diameter = network.shaft_diameter_m[k]
        reynolds = math.pi / 60.0 * speed_rpm * diameter * diameter / _AIR_VISCOSITY
        rotating = (
            plant.shaft_scale
            * 0.133
            * reynolds ** (2.0 / 3.0)
            * _AIR_PRANDTL_THIRD
            * _AIR_CONDUCTIVITY
            / diameter
        )
        # machined steel radiates a third of what the painted surfaces do
        still = _still_air(
            temperature[node], ambient_c, diameter, plant.outside_scale, plant.emissivity / 3.0
        )
        conductance = network.shaft_area_m2[k] * math.hypot(rotating, still)
        matrix[node, node] += conductance
        right[node] += conductance * ambient_c


@compiled
def integrate(
    temperature: NDArray[np.float64],
    grease: NDArray[np.float64],
    duration_s: NDArray[np.float64],
    speed_rpm: NDArray[np.float64],
    load_n: NDArray[np.float64],
    ambient_c: NDArray[np.float64],
    oil_loss: NDArray[np.float64],
    cooling: NDArray[np.float64],
    max_step_s: float,
    model: BenchModel,
    out_temperature: NDArray[np.float64],
    out_grease: NDArray[np.float64],
    out_power_w: NDArray[np.float64],
    out_preload: NDArray[np.float64],
) -> None:
    """Integrate rows; row k of the outputs is the state at the end of row k.

    `temperature` and `grease` (running-in state, oil left) begin with the present state and end
    with the last. Linearly implicit Euler: conductances and heat at the start of a step,
    temperatures at its end.
    """
    network, plant = model.network, model.plant
    n = network.capacity.size
    fixed = -network.conductance
    for i in range(n):
        fixed[i, i] = network.conductance[i].sum()
    matrix = np.empty((n, n))
    right = np.empty(n)
    for row in range(duration_s.size):
        power = 0.0
        preload = 1.0
        count = math.ceil(duration_s[row] / max_step_s - 1e-9)
        for _ in range(count):
            step = duration_s[row] / count
            matrix[:, :] = fixed
            for i in range(n):
                stored = network.capacity[i] / step
                matrix[i, i] += stored
                right[i] = stored * temperature[i]
            preload, inner, outer = contact_state(
                speed_rpm[row],
                load_n[row],
                0.5 * (temperature[INNER_RACEWAY] + temperature[INNER_RING]),
                0.4 * temperature[BALL_SURFACE] + 0.6 * temperature[BALL_CORE],
                0.5 * (temperature[OUTER_RACEWAY] + temperature[OUTER_RING]),
                model.contact,
            )
            _join(matrix, BALL_SURFACE, INNER_RACEWAY, inner)
            _join(matrix, BALL_SURFACE, OUTER_RACEWAY, outer)
            _add_films(temperature, speed_rpm[row], model, matrix)
            _add_air(
                temperature, speed_rpm[row], ambient_c[row], cooling[row], model, matrix, right
            )
            power = friction_heat(
                temperature, speed_rpm[row], load_n[row] * preload, grease, model, right
            )
            _solve(matrix, right)
            temperature[:] = right
            grease[0] *= math.exp(-speed_rpm[row] * step / 60.0 / plant.run_in_revolutions)
            if oil_loss[row] > 0.0 and speed_rpm[row] > 0.0:
                faster = 2.0 ** ((temperature[GREASE] - _LIFE_C) / _LIFE_HALVES_K)
                lost = oil_loss[row] * faster * step / plant.grease_life_s
                grease[1] = max(grease[1] - lost, 0.0)
        out_temperature[row] = temperature
        out_grease[row] = grease
        out_power_w[row] = power
        out_preload[row] = preload
