"""Forecasts by need: an ensemble where it matters, else its intervals around the path of now.

An ensemble takes a thousand times longer than the path of the best parameters alone. A machine that
goes on at its operating point, far from its limits, has the same spread as some minutes ago: its
intervals are moved to the present path. Whatever speaks against that has the ensemble made again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.live.estimate import EstimatedState
from service.live.presentation import LEVELS, LimitCrossings
from service.site.asset_section import Limits
from twin_core.forecasting import Forecast
from twin_core.forecasting.means import mean_forecasts, start_of
from twin_core.simulation import OperatingProfile, OperatingProfiles

#: Process seconds after which an ensemble is made again in any case.
CARRIED_FOR_S = 900.0
#: How near a limit the upper bound (97.5 %) may come.
CLEAR_OF_LIMIT_K = 5.0
#: By how much the present path may differ from that of the ensemble.
MOVED_K = 3.0
#: By how much the operating point may differ: a part of it, and at least so much.
_SAME_PART, _SAME_RPM, _SAME_N, _SAME_AMBIENT_K = 0.02, 20.0, 50.0, 2.0
#: By how much less may be known of the nodes: a part of their spread, and at least so much.
_WIDER_PART, _WIDER_K = 0.2, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Ensemble:
    """What is kept of an ensemble to carry it on.

    Attributes
    ----------
    result : Forecast
        The ensemble without its members' paths.
    path_c : ndarray, shape (n, names)
        Path of the best parameters from the same state.
    profile : OperatingProfile
        What it followed: one operating point, held.
    state : EstimatedState
        What it began from.
    """

    result: Forecast
    path_c: NDArray[np.float64]
    profile: OperatingProfile
    state: EstimatedState


def keep_ensemble(
    result: Forecast,
    state: EstimatedState,
    profile: OperatingProfile,
    limits: Mapping[str, Limits],
    crossings: LimitCrossings,
) -> Ensemble | None:
    """Take from an ensemble what is needed to carry it on; None where it must not be.

    Parameters
    ----------
    result : Forecast
        The ensemble.
    state : EstimatedState
        Where it began.
    profile : OperatingProfile
        What it follows.
    limits : mapping of str to Limits
        By sensor or node.
    crossings
        How likely its members exceed a limit: a single one that comes near is enough to speak
        against it.
    """
    likely = any(one.probability > 0.0 for levels in crossings.values() for one in levels.values())
    if likely or result.runaway_probability > 0.0 or not _is_clear(result, limits):
        return None
    # Moved as far as it may be, none of its members reaches a limit.
    for number, name in enumerate(result.sensors):
        if name in limits:
            highest_c = np.max(result.members_c[:, :, number], initial=-np.inf)
            if not highest_c + MOVED_K < _lowest_limit_c(limits[name]):
                return None
    path_c = _path_c(result, state, profile)
    if not np.isfinite(path_c).all():
        return None
    without_members = replace(
        result,
        quantiles=result.quantiles.astype(np.float32),
        members_c=np.empty((0, 0, 0)),
    )
    return Ensemble(without_members, path_c.astype(np.float32), profile, state)


def is_like(kept: Ensemble, state: EstimatedState, profile: OperatingProfile) -> bool:
    """Whether a machine goes on as it did when its ensemble was made, and is known as well."""
    before, then, now = kept.profile, kept.state.machine, state.machine
    if (
        kept.state.active.version != state.active.version
        or not 0.0 <= (state.time_us - kept.state.time_us) / 1e6 <= CARRIED_FOR_S
        # Fresh grease, an estimate that has begun again, a sensor that is lost.
        or now.revolutions < then.revolutions
        or now.course_known < then.course_known
        or _is_wider(then.covariance, now.covariance)
        or before.size != profile.size
        or not np.array_equal(before.time_s, profile.time_s)
    ):
        return False
    pairs = (
        (before.speed_rpm, profile.speed_rpm, _SAME_RPM),
        (before.load_n, profile.load_n, _SAME_N),
        (before.ambient_c, profile.ambient_c, _SAME_AMBIENT_K),
        (before.inputs, profile.inputs, 0.0),
    )
    return all(
        bool(np.all(np.abs(new - old) <= np.maximum(least, _SAME_PART * np.abs(old))))
        for old, new, least in pairs
    )


def _is_wider(then_k2: NDArray[np.float64], now_k2: NDArray[np.float64]) -> bool:
    then_k, now_k = np.sqrt(np.diagonal(then_k2)), np.sqrt(np.diagonal(now_k2))
    return bool(np.any(now_k > then_k + np.maximum(_WIDER_PART * then_k, _WIDER_K)))


def carried(
    kept: Ensemble, state: EstimatedState, profile: OperatingProfile, limits: Mapping[str, Limits]
) -> Forecast | None:
    """Give the forecast of now with the intervals of an earlier ensemble.

    None where it comes near a limit, moves far from the ensemble, or is not finite.
    """
    path_c = _path_c(kept.result, state, profile)
    moved_k = path_c - kept.path_c
    if not (np.abs(moved_k) <= MOVED_K).all():
        return None
    quantiles = kept.result.quantiles + moved_k
    sensors = [kept.result.names.index(name) for name in kept.result.sensors]
    result = replace(
        kept.result,
        quantiles=quantiles,
        # Far from every limit, which no member reached: these paths stand for the members'.
        members_c=quantiles[:, :, sensors],
    )
    return result if _is_clear(result, limits) else None


def _is_clear(result: Forecast, limits: Mapping[str, Limits]) -> bool:
    for name, pair in limits.items():
        if name in result.names:
            highest_c = np.max(result.quantile(name)[-1])
            if not highest_c <= _lowest_limit_c(pair) - CLEAR_OF_LIMIT_K:
                return False
    return True


def _lowest_limit_c(limits: Limits) -> float:
    return min(float(getattr(limits, level)) for level in LEVELS)


def _path_c(
    result: Forecast, state: EstimatedState, profile: OperatingProfile
) -> NDArray[np.float64]:
    """Path of the best parameters, (n, names)."""
    active = state.active
    start = start_of(active.values[np.newaxis], [active.posterior.sensor_lag_s], [state.machine])
    ahead = OperatingProfiles.of([profile])
    return np.asarray(mean_forecasts(active.model, start, ahead, result.names).readings_c[0])
