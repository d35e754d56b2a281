"""Mean forecasts of many machines of one network form: one call, one machine per row.

The path of one machine with its best parameters, from the mean of its state, without an ensemble:
what `twin_core.forecasting.ensemble.forecast` computes for each member, for a thousandth of the
cost. It has no interval and no probability. Use it to find the machines that need an ensemble::

    start = start_of(values, lags_s, states)
    ahead = OperatingProfiles.held(speed_rpm, load_n, ambient_c, horizon_s=4 * 3600.0)
    means = mean_forecasts(model, start, ahead)
    check = check_limits(means.time_s, means.readings_c, limits_c)
    ensembles_for = np.flatnonzero(check.near(band_k))

How wide the band has to be depends on what the data taught. With a model identified at three speeds
and one load, the upper edge (97.5 %) of an ensemble over 4 h lies up to 2.6 K, or 13 % of the rise
over ambient, above the mean at that load; a quarter of the rise at 1.5 times the load, and half of
it at 2.3 times.

A machine whose numbers are not finite, or whose model runs away, has a path of NaN and counts as
near every limit; the other machines are not affected.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.forecasting.members import member_paths
from twin_core.forecasting.paths import delayed
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.operating_points import STANDING_RPM
from twin_core.simulation import OperatingProfiles

FloatArray = NDArray[np.float64]

_TOGETHER = 64
"""So many paths of all nodes are kept at a time; they fit into a processor's cache."""


class MeanStart(NamedTuple):
    """Where the mean forecasts of machines begin."""

    values: FloatArray  # (machines, p) best parameters, physical units
    #: (machines, nodes) see `twin_core.machine_state.MachineState`.
    temperatures_c: FloatArray
    heat_disturbance_w: FloatArray
    revolutions: FloatArray  # (machines,) since the grease was fresh
    #: (machines,) what each ran at up to now; NaN for a machine that has not been followed.
    speed_rpm: FloatArray
    sensor_lag_s: FloatArray  # (machines,) lag of the sensors


class MeanForecasts(NamedTuple):
    """Mean forecasts of machines."""

    names: tuple[str, ...]  # sensors and nodes
    time_s: FloatArray  # (machines, n) times of the rows
    #: (machines, n, names) what the sensors will read, and the nodes' temperatures, in degC. NaN
    #: throughout where there is no forecast, and behind the last row of a shorter profile.
    readings_c: FloatArray


def start_of(
    values: ArrayLike, sensor_lag_s: ArrayLike, states: Sequence[MachineState]
) -> MeanStart:
    """Gather where mean forecasts begin.

    `values` (machines, p) best parameters: those at the posteriors' centres; `sensor_lag_s`
    (machines,) the posteriors' lags.
    """
    temperatures_c = np.stack([state.temperatures_c for state in states])
    heat_w = np.zeros(temperatures_c.shape)
    speed_rpm = np.full(len(states), np.nan)
    for machine, state in enumerate(states):
        if state.heat_disturbance_w is not None:
            heat_w[machine] = state.heat_disturbance_w
        if state.operating_point is not None:
            speed_rpm[machine] = state.operating_point.speed_rpm
    return MeanStart(
        np.asarray(values, np.float64),
        temperatures_c,
        heat_w,
        np.array([state.revolutions for state in states]),
        speed_rpm,
        np.asarray(sensor_lag_s, np.float64),
    )


def mean_forecasts(
    model: ThermalModel,
    start: MeanStart,
    ahead: OperatingProfiles,
    names: Sequence[str] | None = None,
) -> MeanForecasts:
    """Forecast the mean of many machines, each over its own profile.

    A machine's path is that of an ensemble's member with the best parameters and the mean of the
    state, see `twin_core.forecasting.members.member_paths`. Measured profiles should go through
    `twin_core.simulation.hold_operating_point` first, as an ensemble's do.

    `model`: its values are those of no machine; `ahead`: the first row is now. `names`: sensors and
    nodes that are forecast; by default the model's sensors. A node's own temperature has no lag.
    Raises `ValueError` if a shape is wrong or a name unknown.
    """
    chosen = model.sensor_names if names is None else tuple(names)
    weights = model.sensor_matrix(chosen).T
    lagging = np.array([name in model.sensor_names for name in chosen])
    known = _finite(start, ahead)
    ahead = ahead._replace(rows=np.where(known, ahead.rows, 0))
    goes_on = np.isnan(start.speed_rpm) | (
        (np.abs(start.speed_rpm) < STANDING_RPM) == (np.abs(ahead.speed_rpm[:, 0]) < STANDING_RPM)
    )
    heat_w = np.where((goes_on & known)[:, np.newaxis], start.heat_disturbance_w, 0.0)
    readings_c = np.empty((*ahead.time_s.shape, len(chosen)))
    for first in range(0, ahead.size, _TOGETHER):
        here = slice(first, first + _TOGETHER)
        paths = member_paths(
            model,
            start.values[here],
            ahead.chosen(here),
            start.temperatures_c[here],
            start.revolutions[here],
            heat_w[here],
        )
        np.matmul(paths, weights, out=readings_c[here])
    if lagging.any():
        readings_c[:, :, lagging] = delayed(
            readings_c[:, :, lagging], ahead.time_s, start.sensor_lag_s
        )
    return MeanForecasts(chosen, ahead.time_s, readings_c)


def _finite(start: MeanStart, ahead: OperatingProfiles) -> NDArray[np.bool_]:
    """Which machines have nothing but finite numbers, and times that increase."""
    behind = np.arange(ahead.time_s.shape[1]) >= ahead.rows[:, np.newaxis]
    usable: NDArray[np.bool_] = np.all(np.isfinite(ahead.inputs), axis=2)
    for column in (ahead.time_s, ahead.speed_rpm, ahead.load_n, ahead.ambient_c):
        usable &= np.isfinite(column)
    usable[:, 1:] &= np.diff(ahead.time_s) > 0.0
    known = (usable | behind).all(axis=1)
    for part in (start.values, start.temperatures_c, start.heat_disturbance_w):
        known &= np.isfinite(part).all(axis=1)
    return np.asarray(known & np.isfinite(start.revolutions) & np.isfinite(start.sensor_lag_s))
