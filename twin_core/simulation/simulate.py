"""Simulate one parameter vector or many, and find the state a constant point leads to."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import config as numba_config
from numpy.typing import ArrayLike, NDArray

from twin_core.network import CompiledNetwork, FrictionKind
from twin_core.network_model import NetworkModel
from twin_core.profiles import Point
from twin_core.simulation import kernels
from twin_core.simulation.compiling import kernel_array
from twin_core.simulation.profile import (
    OperatingProfile,
    OperatingProfiles,
    SimulationError,
    Trajectory,
    total_revolutions,
)

_CHUNKS_PER_THREAD = 4
_SETTLING_S = 48 * 3600.0
_NEWTON_ITERATIONS = 20
_BALANCE_W = 1e-6


def simulate(
    model: NetworkModel,
    values: ArrayLike,
    profile: OperatingProfile,
    initial_temperatures_c: ArrayLike,
    revolutions: float = 0.0,
) -> Trajectory:
    """Simulate one parameter vector (p,) from temperatures (nodes,); bounds are not enforced.

    Exact zero-order hold with one corrector for the temperature-dependent heat and films; rows
    longer than 60 s are subdivided. `revolutions` since greasing, like the temperatures, at the
    first row.

    Raises `SimulationError` if the temperatures do not stay finite and below 2000 degC,
    `ValueError` if a shape or a value is wrong.
    """
    parameters = _values(model, values, 1)
    initial = _finite("initial_temperatures_c", initial_temperatures_c)
    nodes = len(model.node_names)
    if initial.shape != (nodes,):
        raise ValueError(
            f"initial_temperatures_c has shape {initial.shape}, expected ({nodes},): one "
            "temperature per state node"
        )
    _check_inputs(model, profile.inputs)
    failed, temperatures = _run_one(
        model.compiled, parameters, OperatingProfiles.of([profile]), initial, revolutions
    )
    if failed >= 0:
        raise SimulationError(
            f"simulation of model {model.name!r} ran away before "
            f"time_s = {profile.time_s[failed]:g} at {profile.speed_rpm[failed - 1]:g} rpm and "
            f"{profile.load_n[failed - 1]:g} N"
        )
    return Trajectory(profile.time_s, temperatures, total_revolutions(profile, revolutions))


def advance(
    model: NetworkModel,
    values: ArrayLike,
    points: Sequence[Point],
    durations_s: Sequence[float],
    temperatures_c: ArrayLike,
    revolutions: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Hold machines at an operating point each for a time > 0, as `simulate` does for two rows.

    `values` (n, p), `points` and `durations_s` (n,), `temperatures_c` (n, nodes), `revolutions`
    (n,). Returns temperatures and revolutions at the ends; the temperatures of a machine are NaN
    where they do not stay finite and below 2000 degC, or where its point is not finite. Raises
    `ValueError` if a shape is wrong.
    """
    parameters, initial = _values(model, values, 2), kernel_array(temperatures_c)
    size = len(parameters)
    if initial.shape != (size, model.compiled.capacity.size):
        raise ValueError(f"temperatures_c has shape {initial.shape}: one per state node expected")
    turned = kernel_array(revolutions)
    given = np.zeros((4, size, 2))
    given[0, :, 1] = durations_s
    given[1:] = np.transpose([(one.speed_rpm, one.load_n, one.ambient_c) for one in points])[
        :, :, np.newaxis
    ]
    inputs = np.empty((size, 2, len(points[0].inputs)))
    inputs[:] = np.array([one.inputs for one in points])[:, np.newaxis]
    _check_inputs(model, inputs)
    ahead = OperatingProfiles(given[0], given[1], given[2], given[3], inputs, np.full(size, 2))
    failed, temperatures = _run_all(model.compiled, parameters, ahead, initial, turned)
    ends = temperatures[:, -1].copy()
    ends[failed >= 0] = np.nan
    return ends, turned + np.abs(given[1, :, 1]) * given[0, :, 1] / 60.0


def simulate_batch(
    model: NetworkModel,
    values: ArrayLike,
    profile: OperatingProfile | OperatingProfiles,
    initial_temperatures_c: ArrayLike,
    revolutions: ArrayLike = 0.0,
    *,
    disturbance_w: ArrayLike | None = None,
    disturbance_time_s: float = np.inf,
    disturbance_rows: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Simulate many parameter vectors over one profile, or each over its own, in parallel.

    Each candidate is computed on its own by the same code as :func:`simulate`, so the result
    does not depend, to the last bit, on the number of threads or on the other candidates. Safe
    to call from several threads at once.

    Parameters
    ----------
    values
        Shape (B, p).
    profile
        n rows, the same for all; or one of B profiles for each.
    initial_temperatures_c
        Shape (nodes,) for all, or (B, nodes).
    revolutions
        Revolutions since greasing at the first row, scalar or shape (B,).
    disturbance_w
        Heat in W beyond the model's at the first row, shape (nodes,) for all, or (B, nodes);
        default none.
    disturbance_time_s
        Over which it fades.
    disturbance_rows
        Row at which it ends, scalar or shape (B,); default never.

    Returns
    -------
    ndarray
        Shape (B, n, nodes). A candidate that runs away, or whose values are not finite, is NaN
        throughout; behind the last row of a shorter profile there is NaN.

    Raises
    ------
    ValueError
        If a shape is wrong.
    """
    parameters = _values(model, values, 2)
    count = parameters.shape[0]
    nodes = len(model.node_names)
    heat = np.zeros(nodes) if disturbance_w is None else _finite("disturbance_w", disturbance_w)
    starts = kernels.Starts(
        _for_all("initial_temperatures_c", initial_temperatures_c, count, (nodes,)),
        _for_all("revolutions", revolutions, count, ()),
        _for_all("disturbance_w", heat, count, (nodes,)),
        1.0 / disturbance_time_s,
    )
    ahead = OperatingProfiles.of([profile]) if isinstance(profile, OperatingProfile) else profile
    if ahead.size not in (1, count):
        raise ValueError(f"there are {ahead.size} profiles, expected 1 or {count}")
    _check_inputs(model, ahead.inputs)
    length = ahead.time_s.shape[1]
    ends = np.asarray(length if disturbance_rows is None else disturbance_rows, np.int64)
    if ends.shape not in ((), (count,)):
        raise ValueError(f"disturbance_rows has shape {ends.shape}, expected () or ({count},)")
    until = np.array(np.broadcast_to(ends, (count,)))
    failed = np.empty(count, np.int64)
    result = np.empty((count, length, nodes))

    def run(start: int, stop: int) -> None:
        kernels.simulate_range(
            model.compiled,
            parameters,
            ahead,
            starts,
            until,
            kernels.UNKNOWN_BASIS,
            start,
            stop,
            failed,
            result,
        )

    if count * length < 1000:
        run(0, count)
    else:
        run_in_threads(run, count)
    return result


def _for_all(
    name: str, given: ArrayLike, count: int, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Bring what is given for all, or for each, to (count, *shape)."""
    array, whole = np.asarray(given, dtype=np.float64), (count, *shape)
    if array.shape not in (shape, whole):
        raise ValueError(f"{name} has shape {array.shape}, expected {shape} or {whole}")
    return kernel_array(np.broadcast_to(array, whole))


def run_in_threads(run: Callable[[int, int], None], count: int) -> None:
    """Call a kernel for members first..last-1 of `count`, in threads of our own.

    It is serial and without the GIL, not one of numba's parallel loops: those abort the process on
    concurrent calls (workqueue) or after a fork (GNU OpenMP).
    """
    threads = min(int(numba_config.NUMBA_NUM_THREADS), count)
    if threads <= 1:
        run(0, count)
        return
    chunks = np.linspace(0, count, threads * _CHUNKS_PER_THREAD + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(run, chunks[:-1].tolist(), chunks[1:].tolist()):
            pass


def steady_state(
    model: NetworkModel,
    values: ArrayLike,
    speed_rpm: float,
    load_n: float,
    ambient_c: float,
    revolutions: float = 0.0,
) -> NDArray[np.float64]:
    """Temperatures that a machine at standstill at ambient reaches at a constant operating point.

    Approached in time from the cold side, so that of several equilibria the one is found that the
    machine would reach; polished by Newton until the heat balance of every node closes to better
    than 1e-6 W. The network's inputs are those that the model holds; running-in stands still.

    Raises `SimulationError` if there is no finite steady state.
    """
    parameters = _values(model, values, 1)
    speed, load, ambient = _finite("operating point", [speed_rpm, load_n, ambient_c]).tolist()
    speed, load = abs(speed), max(load, 0.0)
    held = _running_in_held(model, parameters, float(revolutions))
    nodes = len(model.node_names)
    settling = OperatingProfiles(
        np.array([[0.0, _SETTLING_S]]),
        np.full((1, 2), speed),
        np.full((1, 2), load),
        np.full((1, 2), ambient),
        np.stack((held.inputs, held.inputs))[np.newaxis],
        np.array([2]),
    )
    failed, path = _run_one(held, parameters, settling, np.full(nodes, ambient), 0.0)
    temperatures: NDArray[np.float64] = path[1]
    balance = np.inf
    if failed < 0:
        for _ in range(_NEWTON_ITERATIONS):
            flow, jacobian = kernels.heat_balance_linearised(
                held, parameters, temperatures, speed, load, ambient
            )
            previous, balance = balance, float(np.abs(flow).max())
            if balance >= previous:
                break
            temperatures = temperatures - np.linalg.solve(jacobian, flow)
        flow, _ = kernels.heat_balance(held, parameters, temperatures, speed, load, ambient, 0.0)
        balance = float(np.abs(flow).max())
    if not balance <= _BALANCE_W:
        raise SimulationError(
            f"model {model.name!r} has no steady state at {speed:g} rpm and {load:g} N"
        )
    return temperatures


def heat_balance_w(
    model: NetworkModel,
    values: ArrayLike,
    temperatures_c: ArrayLike,
    speed_rpm: float,
    load_n: float,
    ambient_c: float,
    revolutions: float = 0.0,
) -> tuple[NDArray[np.float64], float]:
    """Net heat flow (nodes,) into every node, and the heat of friction and losses, in W."""
    net, friction = kernels.heat_balance(
        model.compiled,
        _values(model, values, 1),
        _finite("temperatures_c", temperatures_c),
        abs(float(speed_rpm)),
        max(float(load_n), 0.0),
        float(ambient_c),
        float(revolutions),
    )
    return net, float(friction)


def heat_balance_slopes_w_k(
    model: NetworkModel,
    values: ArrayLike,
    temperatures_c: ArrayLike,
    speed_rpm: float,
    load_n: float,
    ambient_c: float,
    revolutions: float = 0.0,
) -> NDArray[np.float64]:
    """Derivatives (nodes, nodes) of the net heat flows by temperature, in W/K; no running-in."""
    parameters = _values(model, values, 1)
    _, jacobian = kernels.heat_balance_linearised(
        _running_in_held(model, parameters, float(revolutions)),
        parameters,
        _finite("temperatures_c", temperatures_c),
        abs(float(speed_rpm)),
        max(float(load_n), 0.0),
        float(ambient_c),
    )
    return np.asarray(jacobian)


def inputs_of(model: NetworkModel, profile: OperatingProfile) -> NDArray[np.float64]:
    """Inputs (n, k) of a profile; raises `ValueError` unless the model's network has these."""
    _check_inputs(model, profile.inputs)
    return profile.inputs


def _run_one(
    net: CompiledNetwork,
    values: NDArray[np.float64],
    ahead: OperatingProfiles,
    initial_c: NDArray[np.float64],
    revolutions: float,
) -> tuple[int, NDArray[np.float64]]:
    """Row that could not be reached, or -1, and the temperatures (n, nodes) of one member."""
    failed, temperatures = _run_all(
        net, values[np.newaxis], ahead, initial_c[np.newaxis], np.array([float(revolutions)])
    )
    return int(failed[0]), temperatures[0]


def _run_all(
    net: CompiledNetwork,
    values: NDArray[np.float64],
    ahead: OperatingProfiles,
    initial_c: NDArray[np.float64],
    revolutions: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """As `_run_one` of members (B,), each over its own rows, in this thread."""
    size = len(initial_c)
    temperatures = np.empty((size, ahead.time_s.shape[1], initial_c.shape[1]))
    failed = np.empty(size, np.int64)
    starts = kernels.Starts(initial_c, revolutions, np.zeros(initial_c.shape), 0.0)
    kernels.simulate_range(
        net,
        values,
        ahead,
        starts,
        ahead.rows,
        kernels.UNKNOWN_BASIS,
        0,
        size,
        failed,
        temperatures,
    )
    return failed, temperatures


def _check_inputs(model: NetworkModel, inputs: NDArray[np.float64]) -> None:
    expected = len(model.input_names)
    if inputs.shape[-1] != expected:
        raise ValueError(
            f"profile: inputs has {inputs.shape[-1]} columns, expected {expected} "
            f"({', '.join(model.input_names) or 'none'})"
        )


def _running_in_held(
    model: NetworkModel, values: NDArray[np.float64], revolutions: float
) -> CompiledNetwork:
    """Fold the running-in factor at *revolutions* into the friction's level."""
    net = model.compiled
    if net.friction_kind != FrictionKind.TWO_PART:
        return net
    scale = np.array([values[index] if index >= 0 else 1.0 for index in net.friction_parameter])
    coefficients = net.friction_coefficient * scale
    coefficients[0] *= 1.0 + coefficients[8] * np.exp(-revolutions / coefficients[9])
    coefficients[8] = 0.0
    return net._replace(
        friction_coefficient=coefficients,
        friction_parameter=np.full(coefficients.size, -1, dtype=np.int64),
    )


def _values(model: NetworkModel, values: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    array = kernel_array(values)
    size = model.parameters.size
    if array.ndim != dimensions or array.shape[-1] != size:
        expected = f"({size},)" if dimensions == 1 else f"(B, {size})"
        raise ValueError(f"values has shape {array.shape}, expected {expected}")
    return array


def _finite(name: str, values: ArrayLike | Sequence[float]) -> NDArray[np.float64]:
    array = kernel_array(values)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {array.tolist()}, expected finite numbers")
    return array
