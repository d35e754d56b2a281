"""Forecasts by need: an ensemble where it matters, else its intervals around the path of now.

An ensemble takes a thousand times longer than the path of the best parameters alone. A machine that
goes on at its operating point, far from its limits, has the same spread as some minutes ago: its
intervals are moved to the present path. Whatever speaks against that has the ensemble made again.
"""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.live.estimate import EstimatedState
from service.live.presentation import LEVELS
from service.site.asset_section import LimitsSection
from twin_core.forecasting import Forecast
from twin_core.forecasting.means import mean_forecasts, start_of
from twin_core.forecasting.runaway import RunawayDistance
from twin_core.simulation import OperatingProfile, OperatingProfiles

#: Process seconds after which an ensemble is made again in any case. Each asset has its own moments
#: for that: a fleet that starts, or stops, at once does not go on making all of them at once.
REUSED_FOR_S = 900.0
#: How near a limit the upper bound (97.5 %) may come.
CLEAR_OF_LIMIT_K = 5.0
#: By how much the present path may differ from that of the ensemble; of what has no limit also by
#: a part of its interval, for what no sensor shows is learnt slowly.
MOVED_K, _MOVED_PART = 3.0, 0.3
#: Share of the members that may come so near a limit that the move could bring them to it.
_NEAR_SHARE = 0.05
#: By how much the operating point may differ: a part of it, and at least so much.
_SAME_PART, _SAME_RPM, _SAME_N, _SAME_AMBIENT_K = 0.02, 20.0, 50.0, 2.0
#: By how much less may be known of now: a part of its spread, and at least so much. What has no
#: limit may be known less by another part; its intervals are widened by as much.
_WIDER_PART, _FOLLOWED_PART, _WIDER_K = 0.2, 0.5, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Ensemble:
    """What is kept of an ensemble to carry it on.

    Attributes
    ----------
    result : Forecast
        The ensemble; of its members only the paths that come near a limit, in front of the others.
    members : int
        How many there are.
    path_c : ndarray, shape (n, names)
        Path of the best parameters from the same state.
    profile : OperatingProfile
        What it followed: one operating point, held.
    state : EstimatedState
        What it began from.
    margin : RunawayMargin or None
        How far it was from a thermal runaway.
    """

    result: Forecast
    members: int
    path_c: NDArray[np.float64]
    profile: OperatingProfile
    state: EstimatedState
    margin: RunawayDistance | None


def keep_ensemble(
    result: Forecast,
    margin: RunawayDistance | None,
    state: EstimatedState,
    profile: OperatingProfile,
    limits: Mapping[str, LimitsSection],
) -> Ensemble | None:
    """Take from an ensemble what is needed to carry it on; None where it must not be.

    Parameters
    ----------
    result : Forecast
        The ensemble.
    margin : RunawayMargin or None
        How far it is from a thermal runaway.
    state : EstimatedState
        Where it began.
    profile : OperatingProfile
        What it follows.
    limits : mapping of str to LimitsSection
        By sensor or node.
    """
    members = len(result.members_c)
    if result.runaway_share > _NEAR_SHARE or not _is_clear(result, limits):
        return None
    # Moved and widened as far as may be, none of the others reaches a limit.
    near = np.zeros(members, np.bool_)
    for number, name in enumerate(result.sensors):
        if name in limits:
            median_c = result.quantile(name)[2]
            beyond_k = (1.0 + _WIDER_PART) * (result.members_c[:, :, number] - median_c)
            highest_c = (median_c + beyond_k).max(axis=1)
            near |= ~(highest_c + MOVED_K < _lowest_limit_c(limits[name]))
    if np.count_nonzero(near) > _NEAR_SHARE * members:
        return None
    path_c = _path_c(result, state, profile)
    if not np.isfinite(path_c).all():
        return None
    result = replace(
        result,
        quantiles=result.quantiles.astype(np.float32),
        members_c=result.members_c[near].astype(np.float32),
    )
    return Ensemble(result, members, path_c.astype(np.float32), profile, state, margin)


def renewal_phase(asset: str) -> float:
    """Give when in each period the ensemble of an asset is made again: a share, always the same."""
    return zlib.crc32(asset.encode()) / 2**32


def is_current(made_us: int, now_us: int, phase: float) -> bool:
    """Whether an ensemble has not been due since it was made; it is when its period is over."""
    made, now = (time_us / 1e6 / REUSED_FOR_S - phase for time_us in (made_us, now_us))
    return made_us <= now_us and math.floor(made) == math.floor(now)


def is_like(kept: Ensemble, state: EstimatedState, profile: OperatingProfile, phase: float) -> bool:
    """Whether a machine goes on as it did when its ensemble was made, with as many sensors.

    ``phase``: see `renewal_phase`.
    """
    before, then, now = kept.profile, kept.state.machine, state.machine
    if (
        kept.state.active.version != state.active.version
        or not is_current(kept.state.time_us, state.time_us, phase)
        # Fresh grease, an estimate that has begun again, a sensor that is lost.
        or now.revolutions < then.revolutions
        or now.course_known < then.course_known
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


def _widened(kept: Ensemble, state: EstimatedState) -> NDArray[np.float64]:
    """How much less is known of now than was when the ensemble was made: factors (names,)."""
    rows = state.active.model.sensor_matrix(list(kept.result.names))
    then_k, now_k = (
        np.sqrt(np.einsum("ij,jk,ik->i", rows, one.machine.covariance, rows))
        for one in (kept.state, state)
    )
    return np.where(now_k > then_k + _WIDER_K, now_k / np.maximum(then_k, _WIDER_K), 1.0)


def reuse(
    kept: Ensemble,
    state: EstimatedState,
    profile: OperatingProfile,
    limits: Mapping[str, LimitsSection],
) -> Forecast | None:
    """Give the forecast of now with the intervals of an earlier ensemble.

    None where it comes near a limit, moves far from the ensemble, is known much less, or is not
    finite.
    """
    result = kept.result
    moved_k = _path_c(result, state, profile) - kept.path_c
    widened = _widened(kept, state)
    limited = np.array([name in limits for name in result.names])
    may_move_k = np.maximum(MOVED_K, _MOVED_PART * (result.quantiles[-1] - result.quantiles[0]))
    may_move_k[:, limited] = MOVED_K
    may_widen = 1.0 + np.where(limited, _WIDER_PART, _FOLLOWED_PART)
    if not ((np.abs(moved_k) <= may_move_k).all() and (widened <= may_widen).all()):
        return None
    median_c = result.quantiles[2]
    quantiles = median_c + moved_k + widened * (result.quantiles - median_c)
    sensors = [result.names.index(name) for name in result.sensors]
    # These paths, far from every limit, stand for the members that reach none.
    members_c = quantiles[:, :, sensors]
    near_c = result.members_c
    if len(near_c):
        others_c = np.broadcast_to(members_c[2], (kept.members - len(near_c), *members_c.shape[1:]))
        near_c = members_c[2] + widened[sensors] * (near_c - median_c[:, sensors])
        members_c = np.concatenate((near_c, others_c))
    result = replace(result, quantiles=quantiles, members_c=members_c)
    return result if _is_clear(result, limits) else None


def _is_clear(result: Forecast, limits: Mapping[str, LimitsSection]) -> bool:
    for name, pair in limits.items():
        if name in result.names:
            highest_c = np.max(result.quantile(name)[-1])
            if not highest_c <= _lowest_limit_c(pair) - CLEAR_OF_LIMIT_K:
                return False
    return True


def _lowest_limit_c(limits: LimitsSection) -> float:
    return min(float(getattr(limits, level)) for level in LEVELS)


def _path_c(
    result: Forecast, state: EstimatedState, profile: OperatingProfile
) -> NDArray[np.float64]:
    """Path of the best parameters, (n, names)."""
    active = state.active
    start = start_of(active.values[np.newaxis], [active.posterior.sensor_lag_s], [state.machine])
    ahead = OperatingProfiles.of([profile])
    return np.asarray(mean_forecasts(active.model, start, ahead, result.names).readings_c[0])
