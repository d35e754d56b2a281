"""One simulation of 540 steps against a plain kernel, and against an adaptive library solver."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from bearing_twin_laboratory.benchmarks.common import Measurement, Progress, shortest_s
from twin_core.bearings import bearing
from twin_core.models import ThermalModel, build_model
from twin_core.simulation import OperatingProfile, kernels, simulate

FloatArray = NDArray[np.float64]

SPEEDS_RPM = (1500.0, 2400.0, 3300.0, 4200.0, 4900.0, 5600.0)
ROWS_PER_SPEED = 90
LOAD_N = 2650.0
AMBIENT_C = 22.6
BEARING = "6311"
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
"""Relative and absolute (K) tolerances of LSODA, the loosest of which that is as exact as the
twin's kernel is compared with it."""


def staircase() -> OperatingProfile:
    """Six speeds of 90 minutes each: 540 steps of 60 s."""
    speed = np.append(np.repeat(SPEEDS_RPM, ROWS_PER_SPEED), SPEEDS_RPM[-1])
    count = speed.size
    return OperatingProfile(
        60.0 * np.arange(count, dtype=np.float64),
        speed,
        np.full(count, LOAD_N),
        np.full(count, AMBIENT_C),
    )


def simulate_14_node(progress: Progress) -> Measurement:
    """The paper's model over the staircase, next to a plain kernel without corrector."""
    model = build_model("paper", bearing=bearing(BEARING))
    profile = staircase()
    progress(0.0, "the twin's kernel")
    duration = _own_s(model, profile)
    progress(0.3, "the default model")
    default = build_model("default", bearing=bearing(BEARING))
    default_duration = _own_s(default, profile)
    progress(0.5, "a plain kernel")
    inverses, capacity, to_ambient, friction, share = _plain_parts(model)
    cold = np.full(capacity.size, AMBIENT_C)

    def plain() -> FloatArray:
        path: FloatArray = _plain_kernel(
            inverses, capacity, to_ambient, friction, share, model.compiled.temperature_node, cold
        )
        return path

    reference = shortest_s(plain)
    progress(0.8, "an exact solution")
    exact = _solved(model, "Radau", 1e-8, 1e-8)
    return Measurement(
        duration,
        "s",
        reference,
        "backward Euler with prepared inverses, heat of the step before, no corrector, numba",
        {
            "max_error_k": _sensor_error_k(model, _own(model, profile), exact),
            "reference_max_error_k": _sensor_error_k(model, plain(), exact),
            "default_model_s": default_duration,
        },
    )


def simulate_vs_lsoda(progress: Progress) -> Measurement:
    """The paper's model over the staircase, next to scipy's LSODA on the same right-hand side."""
    model = build_model("paper", bearing=bearing(BEARING))
    profile = staircase()
    progress(0.0, "the twin's kernel")
    duration = _own_s(model, profile)
    progress(0.3, "an exact solution")
    exact = _solved(model, "Radau", 1e-8, 1e-8)
    error_k = _sensor_error_k(model, _own(model, profile), exact)
    progress(0.5, "LSODA")
    tolerance, reference_error_k = TOLERANCES[0], math.inf
    for tolerance in TOLERANCES:
        library = _solved(model, "LSODA", tolerance, tolerance)
        reference_error_k = _sensor_error_k(model, library, exact)
        if reference_error_k <= error_k:
            break
    reference = shortest_s(lambda: _solved(model, "LSODA", tolerance, tolerance), at_least_s=2.0)
    return Measurement(
        duration,
        "s",
        reference,
        f"scipy solve_ivp, LSODA, tolerance {tolerance:g}, compiled right-hand side",
        {
            "max_error_k": error_k,
            "reference_max_error_k": reference_error_k,
            "times_faster": reference / duration,
        },
    )


def _own(model: ThermalModel, profile: OperatingProfile) -> FloatArray:
    cold = np.full(len(model.node_names), AMBIENT_C)
    return simulate(model, model.parameters.centre, profile, cold).temperatures_c


def _own_s(model: ThermalModel, profile: OperatingProfile) -> float:
    return shortest_s(lambda: _own(model, profile))


def _sensor_error_k(model: ThermalModel, path: FloatArray, exact: FloatArray) -> float:
    sensors = model.sensor_matrix(model.sensor_names)
    return float(np.abs((path - exact) @ sensors.T).max())


def _solved(model: ThermalModel, method: str, relative: float, absolute: float) -> FloatArray:
    """Temperatures (541, nodes) by a solver of scipy, begun again at every change of speed."""
    values = model.parameters.centre
    capacity = kernels.bind_network(model.compiled, values)[0]
    rows = [np.full(capacity.size, AMBIENT_C)]
    turned = 0.0
    for speed in SPEEDS_RPM:

        def rate(
            t: float, state: FloatArray, speed: float = speed, turned: float = turned
        ) -> FloatArray:
            flow, _ = kernels.heat_balance(
                model.compiled, values, state, speed, LOAD_N, AMBIENT_C, turned + speed * t / 60.0
            )
            return np.asarray(flow / capacity)

        times = 60.0 * np.arange(1, ROWS_PER_SPEED + 1)
        found = solve_ivp(
            rate,
            (0.0, times[-1]),
            rows[-1],
            method=method,
            rtol=relative,
            atol=absolute,
            t_eval=times,
        )
        rows.extend(found.y.T)
        turned += speed * times[-1] / 60.0
    return np.array(rows)


def _plain_parts(model: ThermalModel) -> tuple[FloatArray, ...]:
    """Inverses (6, nodes, nodes) of backward Euler and everything else that the kernel needs."""
    values = model.parameters.centre
    capacity, coefficient, friction, share = kernels.bind_network(model.compiled, values)
    inverses = []
    to_ambient = np.empty(0)
    for speed in SPEEDS_RPM:
        net = model.compiled
        matrix, outside = kernels.conductance_matrix(net, coefficient, speed, LOAD_N, net.inputs)
        to_ambient = outside[0]
        inverses.append(np.linalg.inv(np.diag(capacity) + 60.0 * matrix))
    return np.array(inverses), capacity, to_ambient, friction, share


@njit(error_model="numpy")
def _plain_kernel(  # type: ignore[no-untyped-def]
    inverses, capacity, to_ambient, c, share, lubricant, cold
):
    """Backward Euler with Palmgren's heat at the temperature of the step before."""
    count = capacity.size
    path = np.empty((SPEEDS * ROWS + 1, count))
    path[0] = cold
    right = np.empty(count)
    for stage in range(SPEEDS):
        speed = SPEED[stage]
        constant = 0.0009 * (LOAD / c[2]) ** 0.55 * LOAD * c[1]
        for step in range(ROWS):
            row = stage * ROWS + step
            flow = c[3] * math.exp(-c[4] * (path[row, lubricant] - c[5])) * speed
            viscous = 160.0 if flow < 2000.0 else flow ** (2.0 / 3.0)
            moment = constant + 1e-7 * c[0] * viscous * c[1] ** 3
            heat = 1e-3 * 2.0 * math.pi / 60.0 * speed * moment
            for i in range(count):
                right[i] = capacity[i] * path[row, i]
                right[i] += 60.0 * (share[i] * heat + to_ambient[i] * AMBIENT)
            for i in range(count):
                total = 0.0
                for k in range(count):
                    total += inverses[stage, i, k] * right[k]
                path[row + 1, i] = total
    return path


# Under these names numba freezes them into the plain kernel.
SPEED, SPEEDS, ROWS = np.array(SPEEDS_RPM), len(SPEEDS_RPM), ROWS_PER_SPEED
LOAD, AMBIENT = LOAD_N, AMBIENT_C
