"""Forecasts with intervals: an ensemble over parameters, present state and what models leave out.

Members are the model with parameter samples of the posterior, started from states drawn from the
observer's, run over the profile ahead. To each sensor and node a slow deviation is added, which
begins at zero (the state has just been observed) and grows to its stationary spread: what no
parameter vector can express. Sensors further get their lag, constant offset, noise and resolution.

Intervals are not shrunk by any general calibration: a factor learned on machines that share one
load law would be knowledge of those machines. Only what sisters of this very machine needed counts,
where enough of them have been (`twin_core.forecasting.calibrated`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.calibrated import band_factor, spread_members, untrained_rows
from twin_core.forecasting.draws import paired_draws, standard_normals
from twin_core.forecasting.heat_laws import law_verdicts
from twin_core.forecasting.labels import doubtful_start, forecast_labels
from twin_core.forecasting.limits import first_crossings
from twin_core.forecasting.members import (
    beyond_load,
    draw_members,
    goes_on_as,
    member_paths,
    stands,
)
from twin_core.forecasting.paths import add_deviations, delayed, gather_members, shift_between
from twin_core.forecasting.runaway import (
    UPPER,
    difference_quantiles_k,
    ring_difference_k,
    runaway_probability,
)
from twin_core.forecasting.whole_run import whole_run_band, whole_run_factor
from twin_core.identification.posterior import Posterior
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.operating_points import STANDING_RPM
from twin_core.process_noise import (
    DEVIATION_K,
    HALF_WIDTH_95,
    JOINT_ERROR,
    between_joints,
    hidden_spread,
    joint_variance,
    known_within_k,
)
from twin_core.profiles import OperatingPoint
from twin_core.scores import QUANTILE_LEVELS
from twin_core.simulation import (
    OperatingProfile,
    hold_operating_point,
)

FloatArray = NDArray[np.float64]

LOAD_DEVIATION = 0.04
"""What a greater load changes besides the friction (load zone, contacts, thermal preload) is not in
the model: a deviation by this part of a sensor's rise over ambient, per ln(load / trained load)."""
START_DEVIATION = 0.04
"""No start is like another: the grease is pushed aside again, and an inner ring that warms up ahead
of its housing tightens the bearing. A deviation by this part of a sensor's rise over ambient from
the first start out of standstill on; by that of all sensors' mean rise where it is more, for heat
that goes another way comes from the hottest part."""
START_S = 600.0
SENSOR_OFFSET_K = 0.10
SENSOR_WHITE_K = 0.05
SENSOR_RESOLUTION_K = 0.1
# What a failed simulation counts as: over every limit, and finite, so that it can be drawn.
_CEILING_C = 500.0
_EARLIEST = 0.025


@dataclass(frozen=True, slots=True)
class Exceedance:
    """How likely and when a limit is passed.

    Attributes
    ----------
    probability
        Share of the members that pass the limit within the span.
    median_s
        Time at which half of the members have passed it; None when fewer than half do.
    earliest_s
        Time at which 2.5 % of the members have passed it; None when fewer do.
    """

    probability: float
    median_s: float | None
    earliest_s: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """An ensemble forecast.

    Attributes
    ----------
    time_s
        (n,) times of the rows, as in the profile.
    names
        Sensors, then nodes.
    quantiles
        (5, n, names) at 2.5, 25, 50, 75 and 97.5 %, degC: of what a sensor will read, of a node's
        true temperature.
    members_c
        (members, n, sensors) readings of every member without their minute-to-minute noise.
    sensors
        Names of the members' last axis.
    runaway_probability
        That the machine runs away; see `twin_core.forecasting.runaway`.
    labels
        What must be said with this forecast; see `twin_core.forecasting.labels`.
    whole_run_factor
        (n, sensors) factors on the 95 % band of each moment with which 90 % of runs stay inside
        with all of their readings; see `twin_core.forecasting.whole_run`.
    runaway_share
        Share of the members that run away: a sensor passes the temperature of the model's limits
        (of a bearing 130 degC), or the simulation fails.
    not_known
        Nodes that no sensor shows well enough, by name: half the 95 % band, K, that they would have
        if all sensors were known exactly, where it is widest.
    """

    time_s: FloatArray
    names: tuple[str, ...]
    quantiles: FloatArray
    members_c: FloatArray
    sensors: tuple[str, ...]
    runaway_probability: float
    labels: tuple[str, ...]
    whole_run_factor: FloatArray
    runaway_share: float = 0.0
    not_known: Mapping[str, float] = field(default_factory=dict)

    def quantile(self, name: str) -> FloatArray:
        """Return the (5, n) quantiles of a sensor or node."""
        return np.asarray(self.quantiles[:, :, self._index(self.names, name)])

    def whole_run(self, name: str) -> FloatArray:
        """Return the edges (2, n) of the band that 90 % of runs of a sensor stay inside wholly."""
        factor = self.whole_run_factor[:, self._index(self.sensors, name)]
        return whole_run_band(self.quantile(name), factor)

    def exceedance(
        self, name: str, limit_c: float, start_s: float = -np.inf, end_s: float = np.inf
    ) -> Exceedance:
        """Tell how likely and when a sensor reaches a limit between two times.

        Crossing times are interpolated between rows; a member that is over the limit at the first
        row of the span crosses it there.

        Parameters
        ----------
        name
            A sensor.
        limit_c
            The limit in degC.
        start_s, end_s
            The span, on the forecast's time axis, both inclusive.

        Raises
        ------
        KeyError
            If there is no such sensor.
        ValueError
            If no row lies in the span.
        """
        rows = np.flatnonzero((self.time_s >= start_s) & (self.time_s <= end_s))
        if rows.size == 0:
            raise ValueError(f"no row of the forecast lies between {start_s} and {end_s} s")
        paths = self.members_c[:, rows, self._index(self.sensors, name)]
        if np.max(paths) < limit_c:
            return Exceedance(0.0, None, None)  # as of most machines: without a look at each member
        times = np.sort(first_crossings(self.time_s[rows], paths, limit_c))
        crossed = int(np.count_nonzero(np.isfinite(times)))
        return Exceedance(
            probability=crossed / times.size,
            median_s=_time_of_share(times, 0.5),
            earliest_s=_time_of_share(times, _EARLIEST),
        )

    @staticmethod
    def _index(names: Sequence[str], name: str) -> int:
        if name not in names:
            raise KeyError(f"{name!r} is not in this forecast, expected one of {', '.join(names)}")
        return names.index(name)


def forecast(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    profile: OperatingProfile,
    *,
    members: int = 200,
    seed: int = 0,
) -> Forecast:
    """Forecast all sensors and nodes over a profile.

    Parameters
    ----------
    model, posterior
        What is known of the machine; they must belong together.
    state
        The machine now; the observer's ``state()``.
    profile
        n rows ahead; the first is now.
    members
        Even number of members; random numbers come in antithetic pairs, so that the ensemble's
        centre is the posterior's.
    seed
        Same seed, same forecast.

    Raises
    ------
    ValueError
        If posterior and model do not belong together, or ``members`` is odd or below 2.
    """
    rng = np.random.default_rng(seed)
    operating_point = state.operating_point
    goes_on = operating_point is None or goes_on_as(operating_point, profile)
    drawn = draw_members(model, posterior, state, members, rng, goes_on)
    temperatures = member_paths(
        model,
        drawn.values,
        hold_operating_point(profile),
        drawn.start_c,
        state.revolutions,
        drawn.heat_w,
    )
    failed = ~np.all(np.isfinite(temperatures), axis=(1, 2))
    temperatures[failed] = _CEILING_C
    sensors = model.sensor_names
    readings = delayed(
        temperatures @ model.sensor_matrix(sensors).T, profile.time_s, posterior.sensor_lag_s
    )
    rise_c = np.median(readings, axis=0) - profile.ambient_c[:, None]
    # The deviation follows the load within the time that it takes to build up.
    beyond = _following(
        beyond_load(profile.load_n, posterior.known_load_n),
        profile.time_s,
        model.errors.slow_s,
    )
    beyond += _beyond_drives(model, profile, posterior.trained.drives)
    started = _started(profile, operating_point)
    passed_on_c = np.maximum(rise_c, np.mean(rise_c, axis=1, keepdims=True))
    change_k = np.hypot(
        LOAD_DEVIATION * beyond[:, None] * rise_c, START_DEVIATION * started[:, None] * passed_on_c
    )
    keep = np.exp(-np.diff(profile.time_s) / model.errors.slow_s)
    shock = DEVIATION_K * model.errors.scale * np.sqrt(1.0 - keep**2)
    add_deviations(
        readings,
        standard_normals(rng, (members // 2, keep.size, len(sensors))),
        keep,
        shock,
        np.hypot(1.0, change_k / DEVIATION_K),
        SENSOR_OFFSET_K * paired_draws(rng, members, (len(sensors),)),
        np.ones(profile.size),
    )
    normal = standard_normals(rng, (members // 2, keep.size, temperatures.shape[2]))
    # What a sensor of the same name will read stands for the node as well.
    others = [k for k, name in enumerate(model.node_names) if name not in sensors]
    spread = hidden_spread(model, drawn.best)
    hidden = paired_draws(rng, members, (temperatures.shape[2],)) @ spread.T
    growth = _hidden_growth(profile.time_s, np.mean(rise_c, axis=1))
    nodes, even = temperatures, np.ones(temperatures.shape[1:])
    add_deviations(nodes, normal, keep, shock, even, hidden, growth)
    noise_k = np.hypot(SENSOR_WHITE_K, SENSOR_RESOLUTION_K / np.sqrt(12.0))
    runaway = failed | np.any(readings > model.lost_c, axis=(1, 2))
    # Before what sisters' bands have needed: that they stayed cool excludes no runaway.
    between_rings_k = np.max(ring_difference_k(sensors, readings), axis=1)
    _, difference_k = difference_quantiles_k(between_rings_k, runaway)
    noise = noise_k * standard_normals(rng, readings.shape)
    factor = band_factor(posterior, profile)
    untrained = untrained_rows(profile, posterior.trained)
    hottest_c = -np.inf
    if factor is not None:
        hottest_c = float(np.max(np.quantile(readings, UPPER, axis=0)))
        noise *= spread_members(readings, sensors, factor, untrained)
    noisy = readings + noise
    pairs = between_joints(model)
    joints = JOINT_ERROR * paired_draws(rng, members, pairs[0].shape)
    shift_between(nodes, *pairs, joints)
    # In the order in which they are sorted: row, name, member.
    ordered = np.empty((profile.size, len(sensors) + len(others), members))
    gather_members(noisy, np.arange(len(sensors)), ordered[:, : len(sensors)])
    gather_members(nodes, np.array(others, np.int64), ordered[:, len(sensors) :])
    quantiles = _quantiles(ordered)
    whole_run = np.broadcast_to(
        whole_run_factor(noisy, ordered[:, : len(sensors)]), readings.shape[1:]
    )
    if factor is not None:
        whole_run = whole_run * factor.of_whole_run(sensors, untrained)
    share = float(np.mean(runaway))
    hottest_c = max(hottest_c, float(np.max(quantiles[-1, :, : len(sensors)])))
    probability = float(runaway_probability(posterior, difference_k, share, model.runaway))
    names = (*sensors, *(model.node_names[k] for k in others))
    doubts: tuple[str, ...] = ()
    if state.course_known < 1.0:
        doubts = doubtful_start(names, quantiles[:, 0], model.errors.scale)
    return Forecast(
        time_s=profile.time_s,
        names=names,
        quantiles=quantiles,
        members_c=readings,
        sensors=sensors,
        runaway_share=share,
        not_known=_not_known(
            model,
            [model.node_names[k] for k in others],
            quantiles[2][:, [names.index(name) for name in model.node_names]],
            state,
            np.linalg.norm(spread, axis=1) * np.maximum(np.mean(rise_c, axis=1), 0.0)[:, None],
        ),
        runaway_probability=probability,
        labels=forecast_labels(
            posterior,
            profile,
            hottest_c,
            probability,
            law_verdicts(model, posterior, profile),
            model.runaway,
            model.input_names,
        )
        + (() if factor is None else (factor.label,))
        + doubts,
        whole_run_factor=whole_run,
    )


def _beyond_drives(
    model: ThermalModel, profile: OperatingProfile, trained: Mapping[str, float]
) -> FloatArray:
    """How far, as `beyond_load`, the currents and powers have gone beyond the trained ones."""
    beyond = np.zeros(profile.size)
    for name, values in zip(model.input_names, profile.inputs.T, strict=True):
        if trained.get(name, 0.0) > 0.0:
            beyond += np.log(np.maximum(np.abs(values) / trained[name], 1.0))
    return _following(beyond, profile.time_s, model.errors.slow_s)


def _started(profile: OperatingProfile, operating_point: OperatingPoint | None) -> FloatArray:
    """Zero until the machine starts out of a standstill, then towards one, (n,).

    A machine that was not followed is taken to do what it did in its data.
    """
    standing = stands(profile)
    if operating_point is not None and abs(operating_point.speed_rpm) < STANDING_RPM:
        standing[0] = True
    since = np.logical_or.accumulate(standing) & ~standing
    return _following(np.maximum.accumulate(since.astype(np.float64)), profile.time_s, START_S)


def _following(values: FloatArray, time_s: FloatArray, within_s: float) -> FloatArray:
    """Values (n,) held over each step, as a first-order lag from zero follows them, (n,)."""
    followed = np.zeros(values.size)
    keep = np.exp(-np.diff(time_s) / within_s)
    for row in range(values.size - 1):
        followed[row + 1] = keep[row] * followed[row] + (1.0 - keep[row]) * values[row]
    return followed


def _hidden_growth(time_s: FloatArray, rise_c: FloatArray) -> FloatArray:
    """Rise (n,) by which unmeasured nodes' lasting deviations grow as those of the start fade."""
    faded = 1.0 - np.exp(-2.0 * (time_s - time_s[0]) / DISTURBANCE_TIME_S)
    return np.asarray(np.sqrt(faded) * np.maximum(rise_c, 0.0))


def _not_known(
    model: ThermalModel,
    unmeasured: Sequence[str],
    path_c: FloatArray,
    state: MachineState,
    hidden_k: FloatArray,
) -> dict[str, float]:
    """Half the own 95 % band of unmeasured nodes that are not known, K.

    A node's own band is what remains when all sensors are known exactly: what they cannot show.
    path_c, hidden_k (n, nodes): the nodes' course, and what `hidden_spread` makes of it.
    """
    variance = hidden_k**2
    variance[0] = np.maximum(variance[0], np.diag(state.covariance))
    variance += joint_variance(between_joints(model), path_c)
    variance += (DEVIATION_K * model.errors.scale) ** 2
    half_k = dict(zip(model.node_names, HALF_WIDTH_95 * np.sqrt(variance.max(axis=0)), strict=True))
    within_k = known_within_k(model)
    return {name: float(half_k[name]) for name in unmeasured if not half_k[name] <= within_k}


def _quantiles(values: FloatArray) -> FloatArray:
    """Quantiles (5, ...) of values (..., members), which end up sorted; linear in between."""
    ordered = values
    ordered.sort(axis=-1)
    position = np.array(QUANTILE_LEVELS) * (ordered.shape[-1] - 1)
    below = np.floor(position).astype(np.intp)
    weight = position - below
    above = np.minimum(below + 1, ordered.shape[-1] - 1)
    quantiles = (1.0 - weight) * ordered[..., below] + weight * ordered[..., above]
    return np.ascontiguousarray(quantiles.transpose(2, 0, 1))


def _time_of_share(ordered_times: FloatArray, share: float) -> float | None:
    """Time at which a share of the members has crossed; None when fewer do."""
    needed = max(int(np.ceil(share * ordered_times.size)), 1)
    time = float(ordered_times[needed - 1])
    return time if np.isfinite(time) else None
