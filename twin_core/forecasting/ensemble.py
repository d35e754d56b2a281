"""Forecasts with intervals: an ensemble over parameters, present state and what models leave out.

`forecast` has six steps. For member m, row k at the time t_k, sensor s and node i:

1. *draw*: parameters p_m from the posterior, temperatures T_m(t_0) from the observer's state, heats
   q_m beyond the model that set each member on the observed course, all random numbers; in
   antithetic pairs.
2. *simulate*: C dT_m/dt = -L(p_m) T_m + g Ta + Q(p_m, T_m) + q_m exp(-(t - t_0) / 5400 s) over the
   profile, q_m until the machine stops or starts. A sensor shows y_ms(t) = sum_i w_si T_mi(t - lag)
   and rises by r_s = median_m y_ms - Ta.
3. *deviate*: what no parameter vector can express. The state has just been observed, so x_0 = 0,
   x_k = e_k x_k-1 + D (1 - e_k^2)^1/2 z_mk, e_k = exp(-(t_k - t_k-1) / tau), standard normal z:

       y_ms += x_ms (1 + (c_s / 0.25 K)^2)^1/2 + 0.1 K z_ms
       c_s^2 = (0.04 r_s ln(F / F_trained))^2 + (0.04 max(r_s, mean_s r_s) started)^2
       T_mi += x_mi + max(mean_s r_s, 0) (1 - exp(-2 (t - t_0) / 5400 s))^1/2 (S z_m)_i
       T_mi += 0.5 z (T_mj - T_mi) for a body i between joints and its neighbour j

   D and tau are those of the model's errors, S is `twin_core.process_noise.hidden_spread`; ln and
   started follow the profile with a lag.
4. *add noise*: a reading is y_ms + (0.05^2 + 0.1^2 / 12)^1/2 K z_msk, white noise and resolution.
5. *calibrate*: where sisters of this very machine went as far beyond what it was trained at, y and
   noise spread about their median by what their bands needed. No general factor: one learned on
   machines that share a load law would be knowledge of those machines
   (`twin_core.forecasting.calibrated`). Then quantiles over the members.
6. *label*: what must be said with it, such as the probability of a runaway.

The numbers are those of the constants below and in `twin_core.process_noise`.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.calibrated import band_factor, spread_members, untrained_rows
from twin_core.forecasting.draws import paired_draws, standard_normals
from twin_core.forecasting.heat_laws import law_verdicts
from twin_core.forecasting.labels import doubtful_start, forecast_labels
from twin_core.forecasting.members import (
    Members,
    beyond_load,
    draw_members,
    goes_on_as,
    member_paths,
    stands,
)
from twin_core.forecasting.paths import add_deviations, delayed, gather_members, shift_between
from twin_core.forecasting.result import Forecast
from twin_core.forecasting.runaway import (
    UPPER,
    difference_quantiles_k,
    ring_difference_k,
    runaway_probability,
)
from twin_core.forecasting.whole_run import whole_run_factor
from twin_core.identification.family import BandFactor
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
from twin_core.profiles import Point
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

    `profile` (n,) the first row is now; `members`: even number of members; random numbers come in
    antithetic pairs, so that the ensemble's centre is the posterior's; `seed`: same seed, same
    forecast. Raises `ValueError` if posterior and model do not belong together, or ``members`` is
    odd or below 2.
    """
    drawn = _draw(model, posterior, state, profile, members, np.random.default_rng(seed))
    paths = _simulate(model, posterior, state, profile, drawn.members)
    _deviate(model, posterior, state, profile, drawn, paths)
    runaway = paths.failed | np.any(paths.readings_c > model.lost_c, axis=(1, 2))
    # Before what sisters' bands have needed: that they stayed cool excludes no runaway.
    between_rings_k = np.max(ring_difference_k(model.sensor_names, paths.readings_c), axis=1)
    _, difference_k = difference_quantiles_k(between_rings_k, runaway)
    noise_k = _add_noise(drawn)
    factor = band_factor(posterior, profile)
    bands = _calibrate(model, posterior, profile, paths, noise_k, factor)
    share = float(np.mean(runaway))
    probability = float(runaway_probability(posterior, difference_k, share, model.runaway))
    own = [bands.names.index(name) for name in model.node_names]
    hidden_k = np.linalg.norm(drawn.hidden, axis=1) * np.maximum(paths.mean_rise_c, 0.0)[:, None]
    return Forecast(
        time_s=profile.time_s,
        names=bands.names,
        quantiles=bands.quantiles_c,
        members_c=paths.readings_c,
        sensors=model.sensor_names,
        runaway_share=share,
        not_known=_not_known(
            model,
            bands.names[len(model.sensor_names) :],
            bands.quantiles_c[2][:, own],
            state,
            hidden_k,
        ),
        runaway_probability=probability,
        labels=_label(model, posterior, state, profile, bands, probability, factor),
        whole_run_factor=bands.whole_run_factor,
    )


class _Draws(NamedTuple):
    """All that is random in a forecast; standard normal but for `members`.

    (members / 2, n - 1, sensors or nodes): `sensor_shocks`, `node_shocks`. (members, sensors or
    nodes): `offsets`, `lasting`, of which `hidden` (nodes, ...) is the spread. `noise` (members, n,
    sensors). `pairs` are bodies between joints and their neighbours, `joints` (members, pairs).
    """

    members: Members
    sensor_shocks: FloatArray
    offsets: FloatArray
    node_shocks: FloatArray
    hidden: FloatArray
    lasting: FloatArray
    noise: FloatArray
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]]
    joints: FloatArray


class _Paths(NamedTuple):
    """What the members do."""

    #: (members, n, nodes) and (members, n, sensors).
    nodes_c: FloatArray
    readings_c: FloatArray
    rise_c: FloatArray  # (n, sensors) rises over ambient of their median
    failed: NDArray[np.bool_]  # (members,) that have run away out of the model's range

    @property
    def mean_rise_c(self) -> FloatArray:
        """Mean of the sensors' rises over ambient, (n,)."""
        return np.asarray(np.mean(self.rise_c, axis=1))


class _Bands(NamedTuple):
    """Quantiles (5, n, names) of sensors, then nodes; hottest upper edge of any sensor."""

    names: tuple[str, ...]
    quantiles_c: FloatArray
    whole_run_factor: FloatArray
    hottest_c: float


def _draw(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    profile: OperatingProfile,
    count: int,
    rng: np.random.Generator,
) -> _Draws:
    """Step 1; the order of the draws is part of what a seed means."""
    point = state.operating_point
    goes_on = point is None or goes_on_as(point, profile)
    sensors, nodes, steps = len(model.sensor_names), len(model.node_names), profile.size - 1
    members = draw_members(model, posterior, state, count, rng, goes_on)
    pairs = between_joints(model)
    return _Draws(
        members,
        sensor_shocks=standard_normals(rng, (count // 2, steps, sensors)),
        offsets=paired_draws(rng, count, (sensors,)),
        node_shocks=standard_normals(rng, (count // 2, steps, nodes)),
        hidden=hidden_spread(model, members.best),
        lasting=paired_draws(rng, count, (nodes,)),
        noise=standard_normals(rng, (count, profile.size, sensors)),
        pairs=pairs,
        joints=paired_draws(rng, count, pairs[0].shape),
    )


def _simulate(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    profile: OperatingProfile,
    members: Members,
) -> _Paths:
    """Step 2."""
    nodes_c = member_paths(
        model,
        members.values,
        hold_operating_point(profile),
        members.start_c,
        state.revolutions,
        members.heat_w,
    )
    failed = ~np.all(np.isfinite(nodes_c), axis=(1, 2))
    nodes_c[failed] = _CEILING_C
    shown_c = nodes_c @ model.sensor_matrix(model.sensor_names).T
    readings_c = delayed(shown_c, profile.time_s, posterior.sensor_lag_s)
    rise_c = np.median(readings_c, axis=0) - profile.ambient_c[:, None]
    return _Paths(nodes_c, readings_c, rise_c, failed)


def _deviate(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    profile: OperatingProfile,
    drawn: _Draws,
    paths: _Paths,
) -> None:
    """Step 3; changes the paths."""
    slow_s, rise_c = model.errors.slow_s, paths.rise_c
    # The deviation follows the load within the time that it takes to build up.
    beyond = _following(beyond_load(profile.load_n, posterior.known_load_n), profile.time_s, slow_s)
    beyond += _beyond_drives(model, profile, posterior.trained.drives)
    started = _started(profile, state.operating_point)
    passed_on_c = np.maximum(rise_c, paths.mean_rise_c[:, None])
    change_k = np.hypot(
        LOAD_DEVIATION * beyond[:, None] * rise_c, START_DEVIATION * started[:, None] * passed_on_c
    )
    keep = np.exp(-np.diff(profile.time_s) / slow_s)
    shock = DEVIATION_K * model.errors.scale * np.sqrt(1.0 - keep**2)
    add_deviations(
        paths.readings_c,
        drawn.sensor_shocks,
        keep,
        shock,
        np.hypot(1.0, change_k / DEVIATION_K),
        SENSOR_OFFSET_K * drawn.offsets,
        np.ones(profile.size),
    )
    add_deviations(
        paths.nodes_c,
        drawn.node_shocks,
        keep,
        shock,
        np.ones(paths.nodes_c.shape[1:]),
        drawn.lasting @ drawn.hidden.T,
        _hidden_growth(profile.time_s, paths.mean_rise_c),
    )
    shift_between(paths.nodes_c, *drawn.pairs, JOINT_ERROR * drawn.joints)


def _add_noise(drawn: _Draws) -> FloatArray:
    """Step 4: what a reading has beyond a path, (members, n, sensors) in K."""
    return np.asarray(np.hypot(SENSOR_WHITE_K, SENSOR_RESOLUTION_K / np.sqrt(12.0)) * drawn.noise)


def _calibrate(
    model: ThermalModel,
    posterior: Posterior,
    profile: OperatingProfile,
    paths: _Paths,
    noise_k: FloatArray,
    factor: BandFactor | None,
) -> _Bands:
    """Step 5; changes readings and noise by the factor, if there is one."""
    sensors = model.sensor_names
    untrained = untrained_rows(profile, posterior.trained)
    hottest_c = -np.inf
    if factor is not None:
        hottest_c = float(np.max(np.quantile(paths.readings_c, UPPER, axis=0)))
        noise_k *= spread_members(paths.readings_c, sensors, factor, untrained)
    noisy = paths.readings_c + noise_k
    # What a sensor of the same name will read stands for the node as well.
    others = [k for k, name in enumerate(model.node_names) if name not in sensors]
    # In the order in which they are sorted: row, name, member.
    ordered = np.empty((profile.size, len(sensors) + len(others), len(noisy)))
    gather_members(noisy, np.arange(len(sensors)), ordered[:, : len(sensors)])
    gather_members(paths.nodes_c, np.array(others, np.int64), ordered[:, len(sensors) :])
    quantiles = _quantiles(ordered)
    of_members = whole_run_factor(noisy, ordered[:, : len(sensors)])
    whole_run = np.broadcast_to(of_members, noisy.shape[1:])
    if factor is not None:
        whole_run = whole_run * factor.of_whole_run(sensors, untrained)
    return _Bands(
        (*sensors, *(model.node_names[k] for k in others)),
        quantiles,
        whole_run,
        max(hottest_c, float(np.max(quantiles[-1, :, : len(sensors)]))),
    )


def _label(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    profile: OperatingProfile,
    bands: _Bands,
    runaway: float,
    factor: BandFactor | None,
) -> tuple[str, ...]:
    """Step 6."""
    laws = law_verdicts(model, posterior, profile)
    labels = forecast_labels(
        posterior, profile, bands.hottest_c, runaway, laws, model.runaway, model.input_names
    )
    if factor is not None:
        labels += (factor.label,)
    if state.course_known < 1.0:
        labels += doubtful_start(bands.names, bands.quantiles_c[:, 0], model.errors.scale)
    return labels


def _beyond_drives(
    model: ThermalModel, profile: OperatingProfile, trained: Mapping[str, float]
) -> FloatArray:
    """How far, as `beyond_load`, the currents and powers have gone beyond the trained ones."""
    beyond = np.zeros(profile.size)
    for name, values in zip(model.input_names, profile.inputs.T, strict=True):
        if trained.get(name, 0.0) > 0.0:
            beyond += np.log(np.maximum(np.abs(values) / trained[name], 1.0))
    return _following(beyond, profile.time_s, model.errors.slow_s)


def _started(profile: OperatingProfile, operating_point: Point | None) -> FloatArray:
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
