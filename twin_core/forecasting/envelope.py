"""Safe operating envelope: what would become of each point of the (speed, load) plane.

For every point of a grid the machine is held there from its present state, by every member of an
ensemble over the parameter posterior, the present state and what the model leaves out. From the
members follow the steady temperature with its interval, and when and how probably each limit is
passed on the way. A point where a member has no steady state, or a sensor beyond the model's limit
(of a bearing 130 degC), counts as run away in that member.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.forecasting.draws import paired_draws
from twin_core.forecasting.ensemble import (
    LOAD_DEVIATION,
    SENSOR_OFFSET_K,
    SENSOR_RESOLUTION_K,
    SENSOR_WHITE_K,
)
from twin_core.forecasting.labels import runaway_not_excluded
from twin_core.forecasting.members import Members, beyond_load, draw_members
from twin_core.forecasting.runaway import (
    difference_quantiles_k,
    newtons_left,
    ring_difference_k,
    runaway_probability,
    upper_gain,
)
from twin_core.identification.posterior import Posterior
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.process_noise import DEVIATION_K
from twin_core.simulation import holding
from twin_core.simulation.kernels import Starts
from twin_core.simulation.simulate import run_in_threads

FloatArray = NDArray[np.float64]

ENVELOPE_LEVELS = (0.025, 0.5, 0.975)
HORIZON_S = 8 * 3600.0
MEMBERS = 80
_EARLIEST = 0.025
# What a member without a steady state counts as: over every limit, and finite.
_CEILING_C = 500.0
_NARROWEST_K = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class LimitGrid:
    """When and how probably a sensor reaches a limit, held at each point from the present state."""

    limit_c: float
    probability: FloatArray  # (loads, speeds) share of the members that reach it within the horizon
    #: (loads, speeds) probability that the steady temperature is at or over it: members count
    #: smoothly, so that its contours are no staircases.
    steady_probability: FloatArray
    #: (loads, speeds) times at which half and 2.5 % of the members have reached it; infinite where
    #: fewer do.
    median_s: FloatArray
    earliest_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """The safe operating envelope over a grid."""

    #: Axes of the grid, (speeds,) and (loads,).
    speed_rpm: FloatArray
    load_n: FloatArray
    #: Ambient temperature that was assumed; how long each point is held for the times.
    ambient_c: float
    horizon_s: float
    members: int
    sensors: tuple[str, ...]
    #: Per sensor (3, loads, speeds): 2.5, 50 and 97.5 % of what the sensor will read when
    #: temperatures no longer change, in degC; 500 stands for a member that has run away.
    steady_c: Mapping[str, FloatArray]
    limits: Mapping[str, tuple[LimitGrid, ...]]  # per sensor, one map for each of its limits
    runaway_share: FloatArray  # (loads, speeds) share of the members that run away
    #: (loads, speeds) probability that the machine runs away; see `twin_core.forecasting.runaway`.
    runaway_probability: FloatArray
    #: (loads, speeds) verdict by the rule of `twin_core.forecasting.labels`.
    runaway_not_excluded: NDArray[np.bool_]
    #: (2, loads, speeds) median and 80 % of how much hotter the inner ring is than the outer one;
    #: infinite where so many members run away.
    ring_difference_k: FloatArray
    #: (2, loads, speeds) median and 97.5 % of the members' loop gain in their steady state;
    #: infinite where so many have none.
    loop_gain: FloatArray
    #: (loads, speeds) how much hotter the hottest sensor may become until the gain is 1 or the
    #: model's limit is passed: 95 % of the members have more. Infinite without a limit.
    margin_k: FloatArray
    #: (loads, speeds) how much more load it takes until the probability is 5 %, negative beyond;
    #: NaN where no load of the grid is as bad.
    margin_n: FloatArray


def envelope(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    speed_rpm: ArrayLike,
    load_n: ArrayLike,
    limits: Mapping[str, Sequence[float]],
    *,
    horizon_s: float = HORIZON_S,
    members: int = MEMBERS,
    seed: int = 0,
) -> Envelope:
    """Compute the safe operating envelope.

    All points share the same members, so that the maps are smooth over the grid.

    `state`: the machine now; its ambient temperature and inputs are held; `speed_rpm`, `load_n`
    (speeds,) and (loads,) axes of the grid, increasing, not negative; `limits`: limits in degC per
    sensor; sensors without limits have steady temperatures all the same. `horizon_s`: how long each
    point is held for the times to the limits. Steady temperatures are those of grease run in until
    then. `members`: even number of members. Raises `ValueError` if posterior and model do not
    belong together, an axis is not increasing or negative, a limit names no sensor, or a number is
    out of range.
    """
    posterior.check(model)
    model = model.holding(state.inputs)
    speeds, loads = _axis("speed_rpm", speed_rpm), _axis("load_n", load_n)
    if not (horizon_s > 0.0 and np.isfinite(horizon_s)):
        raise ValueError(f"horizon_s is {horizon_s}, expected a positive number of seconds")
    sensors = model.sensor_names
    table = _limit_table(model, limits)
    rng = np.random.default_rng(seed)
    drawn = draw_members(model, posterior, state, members, rng)
    ambient_c = float(state.ambient_c)
    offset, slow, noise = _sensor_draws(rng, members, len(sensors))
    cells = np.tile(speeds, loads.size), np.repeat(loads, speeds.size)
    beyond = beyond_load(cells[1], posterior.known_load_n)
    slow_k = partial(_slow_k, model.errors.scale, beyond)
    at_limits = np.where(np.isfinite(table), np.maximum(table - ambient_c, 0.0), 0.0)
    held = _hold(
        model,
        drawn,
        state.revolutions,
        holding.Grid(*cells, ambient_c, horizon_s),
        # A sensor that reads too high by its offset reaches its limit that much earlier.
        table - offset[:, :, None],
        slow[:, None, :, None] * slow_k(np.tile(at_limits, (beyond.size, 1, 1))),
    )
    steady, crossing = held.steady_c, held.crossing_s
    lasting = np.median(np.where(np.isfinite(steady), steady, _CEILING_C), axis=0)
    deviation = slow[:, None] * slow_k(np.maximum(lasting - ambient_c, 0.0))
    readings = np.where(np.isfinite(steady), steady + deviation + offset[:, None], _CEILING_C)
    away = np.any((readings > model.lost_c) | np.isfinite(crossing[..., -1]), axis=2)
    shape = (loads.size, speeds.size)
    quantiles = np.quantile(readings + noise[:, None], ENVELOPE_LEVELS, axis=0)
    share = np.mean(away, axis=0)
    hottest = np.max(quantiles[-1], axis=1)
    difference_k = difference_quantiles_k(ring_difference_k(sensors, readings), away)
    probability = runaway_probability(posterior, difference_k[1], share, model.runaway)
    return Envelope(
        speed_rpm=speeds,
        load_n=loads,
        ambient_c=ambient_c,
        horizon_s=horizon_s,
        members=members,
        sensors=sensors,
        steady_c=_steady_grids(sensors, quantiles, shape),
        limits={
            name: _limit_grids(limits.get(name, ()), readings[..., row], crossing[:, :, row], shape)
            for row, name in enumerate(sensors)
        },
        runaway_share=share.reshape(shape),
        runaway_probability=probability.reshape(shape),
        runaway_not_excluded=runaway_not_excluded(
            posterior, cells[1], hottest, probability, model.runaway
        ).reshape(shape),
        ring_difference_k=difference_k.reshape(2, *shape),
        loop_gain=upper_gain(held.gain, away).reshape(2, *shape),
        margin_k=_margin_k(held.room_k, model.lost_c - readings, away).reshape(shape),
        margin_n=newtons_left(loads, probability.reshape(shape)),
    )


def _sensor_draws(
    rng: np.random.Generator, members: int, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offset, slow deviation in its spreads, and noise of so many sensors for each member."""
    # The same pairs in all three, so that their sum has no bias in any percentile.
    offset, slow, noise = (paired_draws(rng, members, (count,)) for _ in range(3))
    white_k = np.hypot(SENSOR_WHITE_K, SENSOR_RESOLUTION_K / np.sqrt(12.0))
    return SENSOR_OFFSET_K * offset, slow, white_k * noise


def _slow_k(scale: float, beyond: FloatArray, rise_c: FloatArray) -> FloatArray:
    """Spread (points, ...) of the slow deviation at rises over ambient of that shape."""
    by_load = LOAD_DEVIATION * beyond.reshape(-1, *[1] * (rise_c.ndim - 1)) * rise_c
    return np.asarray(scale * np.hypot(DEVIATION_K, by_load))


def _margin_k(room_k: FloatArray, below_k: FloatArray, away: NDArray[np.bool_]) -> FloatArray:
    """What all but 5 % of the members have left.

    Until its gain is 1 (`room_k`), or until its hottest sensor is beyond the limit (`below_k`).
    """
    left_k = np.where(away[..., None], 0.0, np.minimum(room_k, below_k)).min(axis=2)
    return np.asarray(np.quantile(np.maximum(left_k, 0.0), 0.05, axis=0, method="lower"))


def _steady_grids(
    sensors: Sequence[str], quantiles: FloatArray, shape: tuple[int, int]
) -> dict[str, FloatArray]:
    """Map the steady temperatures of each sensor, from quantiles (3, points, sensors)."""
    return {
        name: np.ascontiguousarray(quantiles[:, :, row]).reshape(3, *shape)
        for row, name in enumerate(sensors)
    }


def _limit_grids(
    limits_c: Sequence[float], readings: FloatArray, times: FloatArray, shape: tuple[int, int]
) -> tuple[LimitGrid, ...]:
    """Map each limit of a sensor, from its crossing times (members, points, limits)."""
    return tuple(
        _limit_grid(limit_c, readings, times[..., level], shape)
        for level, limit_c in enumerate(limits_c)
    )


def _limit_grid(
    limit_c: float, readings: FloatArray, times: FloatArray, shape: tuple[int, int]
) -> LimitGrid:
    """Map a limit from steady readings and crossing times (members, points)."""
    ordered = np.sort(times, axis=0)
    members = len(ordered)

    def time_of(share: float) -> FloatArray:
        needed = max(int(np.ceil(share * members)), 1)
        return np.asarray(ordered[needed - 1].reshape(shape))

    return LimitGrid(
        limit_c=float(limit_c),
        probability=np.mean(np.isfinite(times), axis=0).reshape(shape),
        steady_probability=_smooth_share(readings, limit_c).reshape(shape),
        median_s=time_of(0.5),
        earliest_s=time_of(_EARLIEST),
    )


def _limit_table(model: ThermalModel, limits: Mapping[str, Sequence[float]]) -> FloatArray:
    """Each sensor's own limits (sensors, limits), then where it counts as run away."""
    sensors = model.sensor_names
    for name in limits:
        if name not in sensors:
            raise ValueError(f"limits: no sensor {name!r}, expected one of {', '.join(sensors)}")
    most = max((len(values) for values in limits.values()), default=0)
    table = np.full((len(sensors), most + 1), np.inf)
    for row, name in enumerate(sensors):
        table[row, : len(limits.get(name, ()))] = limits.get(name, ())
    table[:, most] = model.lost_c
    return table


def _smooth_share(readings: FloatArray, limit_c: float) -> FloatArray:
    """Share (points,) of readings (members, points) over a limit, each member a small normal.

    Silverman's width for a normal kernel, from the quartiles: members that ran away do not count.
    """
    from scipy.special import ndtr  # not loaded by processes that make no maps

    low, high = np.quantile(readings, (0.25, 0.75), axis=0)
    width = 0.9 * (high - low) / 1.349 * len(readings) ** -0.2
    return np.asarray(np.mean(ndtr((readings - limit_c) / np.maximum(width, _NARROWEST_K)), axis=0))


def _hold(
    model: ThermalModel,
    drawn: Members,
    revolutions: float,
    grid: holding.Grid,
    limit_c: FloatArray,
    deviation_k: FloatArray,
) -> holding.HeldResult:
    """Hold the members at every point of the grid, in parallel."""
    members, sensors, limits = limit_c.shape
    points = grid.speed_rpm.size
    turned = np.full(members, float(revolutions))
    starts = Starts(drawn.start_c, turned, drawn.heat_w, 1.0 / DISTURBANCE_TIME_S)
    rows = model.sensor_matrix(model.sensor_names)
    crossable = holding.Crossable(rows, limit_c, deviation_k, model.errors.slow_s)
    held = holding.HeldResult(
        np.empty((members, points, sensors)),
        np.empty((members, points, sensors, limits)),
        np.empty((members, points)),
        np.empty((members, points, sensors)),
    )

    def run(first: int, last: int) -> None:
        holding.hold_points_range(
            model.compiled, drawn.values, starts, grid, crossable, first, last, held
        )

    run_in_threads(run, members)
    return held


def _axis(name: str, values: ArrayLike) -> FloatArray:
    axis = np.ascontiguousarray(values, np.float64)
    if axis.ndim != 1 or axis.size == 0 or not np.all(np.isfinite(axis)):
        raise ValueError(f"{name} is {axis.tolist()}, expected a list of finite numbers")
    if axis[0] < 0.0 or np.any(np.diff(axis) <= 0.0):
        raise ValueError(f"{name} is {axis.tolist()}, expected increasing numbers from 0 up")
    return axis
