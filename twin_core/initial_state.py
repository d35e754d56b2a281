"""What is known of a machine from its first readings: the state in which an observer begins."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import OperatingProfile, simulate

_REST_OFFSET_K = 1.0
_REST_SCATTER_K = 0.3
_REST_CONTRADICTION_K = 3.0
_ENSEMBLE_FLOOR_K = 0.5
_ENSEMBLE_SCATTER = 0.12
_ENSEMBLE_LEVELS = (0.75, 1.0, 1.3)
# How long a machine may have been run at a usual point, and at the present one since.
_PAST_S = 60.0 * np.array([0.0, 15.0, 60.0, 180.0, 600.0])
_LATELY_S = 60.0 * np.array([0.0, 1.0, 5.0, 30.0])


def initial_state(
    model: ThermalModel,
    values: ArrayLike,
    measured: Mapping[str, float],
    ambient_c: float,
    speed_rpm: float,
    load_n: float,
    at_rest: bool,
    past: Sequence[tuple[float, float]] = (),
    inputs: ArrayLike = (),
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Temperatures to start an observer with, and how little is known about them.

    A machine that stood still for long lies at ambient. Otherwise nothing is assumed about the
    past: the state is one that the model could be in while warming up or cooling down towards the
    present operating point, at some unknown moment and with an uncertain level of heat, given
    what the sensors say. If the sensors contradict *at_rest* by more than 3 K, it is ignored.

    `values` (p,); `measured`: readings in degC by sensor or node name; may be empty; `at_rest`:
    whether the machine stood still long enough to have cooled down. `past`: speeds in rpm and loads
    in N that the machine is usually run at. With some of them the state may also be one on the way
    towards each of these, with the present operating point for the last half hour or less: where
    the duty varies, a body that follows slowly is not on the way to where a momentary load would
    lead it. `inputs`: the network's inputs at present, (k,). Returns `mean`: shape (nodes,), degC,
    `covariance`: shape (nodes, nodes), K2. Raises `ValueError` if a name is unknown or a value not
    finite, `SimulationError` if the model runs away.
    """
    nodes = len(model.node_names)
    contradicted = any(abs(t - ambient_c) > _REST_CONTRADICTION_K for t in measured.values())
    if at_rest and not contradicted:
        mean = np.full(nodes, float(ambient_c))
        covariance = _REST_OFFSET_K**2 * np.ones((nodes, nodes)) + _REST_SCATTER_K**2 * np.eye(
            nodes
        )
    else:
        model = model.holding(inputs)
        states = _possible_states(model, values, ambient_c, speed_rpm, load_n)
        if past:
            states = np.concatenate(
                [
                    _varying_states(model, values, ambient_c, (speed_rpm, load_n), one)
                    for one in past
                ]
                + [states]
            )
        mean = states.mean(axis=0)
        scatter = _ENSEMBLE_FLOOR_K + _ENSEMBLE_SCATTER * np.abs(mean - ambient_c)
        covariance = np.cov(states, rowvar=False) + np.diag(scatter**2)
    observer = Observer(model, values, mean, covariance)
    observer.update(measured)
    return observer.temperatures_c, observer.covariance


def _hot_inputs(model: ThermalModel) -> NDArray[np.float64]:
    """Inputs (k,) of a heavy duty: drives well above the present and the usual ones."""
    boundaries = model.network.boundaries
    return np.array(
        [
            now if name in boundaries else 1.3 * max(abs(now), 0.75 * abs(usual))
            for name, now, usual in zip(
                model.input_names, model.compiled.inputs, model.reference_inputs, strict=True
            )
        ]
    )


def _possible_states(
    model: ThermalModel, values: ArrayLike, ambient_c: float, speed_rpm: float, load_n: float
) -> NDArray[np.float64]:
    """States on the way to an operating point from cold and from hot, shape (members, nodes)."""
    usual_speed, usual_load = model.reference_point
    hot_speed = 1.3 * max(abs(speed_rpm), 0.75 * usual_speed)
    hot_load = 1.5 * max(load_n, 0.75 * usual_load)
    minutes = np.concatenate(([0.0], np.geomspace(1.0, 600.0, 24)))
    heating_s = 4.0 * 3600.0
    cold = np.full(len(model.node_names), float(ambient_c))
    present = (np.full(minutes.size, float(speed_rpm)), np.full(minutes.size, float(load_n)))
    warming = OperatingProfile(
        minutes * 60.0,
        *present,
        np.full(minutes.size, float(ambient_c)),
        np.tile(model.compiled.inputs, (minutes.size, 1)),
    )
    heated = OperatingProfile(
        np.array([0.0, heating_s / 8.0, heating_s]),
        np.full(3, hot_speed),
        np.full(3, hot_load),
        np.full(3, float(ambient_c)),
        np.tile(_hot_inputs(model), (3, 1)),
    )
    up = simulate(model, values, warming, cold, LONG_RUN_IN).temperatures_c
    states = [up]
    for hot in simulate(model, values, heated, cold, LONG_RUN_IN).temperatures_c[1:]:
        states.append(simulate(model, values, warming, hot, LONG_RUN_IN).temperatures_c)
    rise = np.concatenate(states) - ambient_c
    result: NDArray[np.float64] = ambient_c + np.concatenate(
        [level * rise for level in _ENSEMBLE_LEVELS]
    )
    return result


def _varying_states(
    model: ThermalModel,
    values: ArrayLike,
    ambient_c: float,
    present: tuple[float, float],
    past: tuple[float, float],
) -> NDArray[np.float64]:
    """States (members, nodes) on the way to a past operating point, then towards the present."""
    cold = np.full(len(model.node_names), float(ambient_c))

    def path(
        point: tuple[float, float], times_s: NDArray[np.float64], start: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        speed, load = (np.full(times_s.size, float(value)) for value in point)
        ambient = np.full(times_s.size, float(ambient_c))
        held = np.tile(model.compiled.inputs, (times_s.size, 1))
        profile = OperatingProfile(times_s, speed, load, ambient, held)
        return simulate(model, values, profile, start, LONG_RUN_IN).temperatures_c

    warm = path(past, _PAST_S, cold)[1:]
    states = np.concatenate([path(present, _LATELY_S, start) for start in warm])
    rise = states - ambient_c
    result: NDArray[np.float64] = ambient_c + np.concatenate(
        [level * rise for level in _ENSEMBLE_LEVELS]
    )
    return result
