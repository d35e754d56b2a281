"""How long an operator has: the distribution of the time from an early sign to a limit.

It is read from kept forecasts, each of which is known by a few quantiles at a few lead times. The
members of a forecast are taken to keep their rank: one that is among the hottest stays so. That
holds where the intervals come from the model and the state, not from noise.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import erf, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.scores import QUANTILE_LEVELS

FloatArray = NDArray[np.float64]

_RANKS = np.linspace(QUANTILE_LEVELS[0], QUANTILE_LEVELS[-1], 39)


def _weights() -> FloatArray:
    """(5, r) weights of the quantiles at each rank, linear on the normal scale."""
    z = np.linspace(-2.5, 2.5, 5001)
    share = np.array([0.5 * (1.0 + erf(one / sqrt(2.0))) for one in z])
    scores, ranks = np.interp(QUANTILE_LEVELS, share, z), np.interp(_RANKS, share, z)
    return np.array([np.interp(ranks, scores, one) for one in np.eye(len(QUANTILE_LEVELS))])


_WEIGHTS = _weights()


@dataclass(frozen=True, slots=True)
class ResponseTime:
    """The distribution of the time to respond, of many forecasts together."""

    #: Quantiles in seconds; infinite where the limit is not reached within the horizon.
    p05_s: float
    p50_s: float
    never_share: float  # share that does not reach the limit within the horizon
    forecasts: int  # how many forecasts it rests on
    looked_at: int  # how many there were; the others do not come so far


def crossing_times_s(
    lead_times_s: ArrayLike, quantiles_c: ArrayLike, limit_c: float, sooner_s: float
) -> FloatArray:
    """Time (r,) in s at which each rank of a forecast first reaches a limit; infinite if never.

    `lead_times_s` (l,) ascending; `quantiles_c` (l, 5) at `QUANTILE_LEVELS`; `sooner_s` is what is
    said of a rank that is at the limit by the first lead time already.
    """
    leads = np.asarray(lead_times_s, np.float64)
    paths = np.asarray(quantiles_c, np.float64) @ _WEIGHTS
    over = paths >= limit_c
    first = np.argmax(over, axis=0)
    ranks = np.arange(paths.shape[1])
    before = np.maximum(first - 1, 0)
    low, high = paths[before, ranks], paths[first, ranks]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(high > low, (limit_c - low) / (high - low), 1.0)
    times = leads[before] + np.clip(part, 0.0, 1.0) * (leads[first] - leads[before])
    times = np.where(first == 0, sooner_s, times)
    return np.where(over.any(axis=0), times, np.inf)


def time_between(
    forecasts: Iterable[tuple[ArrayLike, ArrayLike]], from_c: float, to_c: float
) -> ResponseTime | None:
    """Return how long it takes from one limit to a higher one; None without any forecast.

    Only forecasts that reach the first limit count, each rank of them that does. A rank that is at
    the first limit by the first lead time counts from there, so that no time is made up. Forecasts
    are lead times (l,) in seconds and quantiles (l, 5) in degC.
    """
    found, looked_at = [], 0
    for leads_s, quantiles_c in forecasts:
        looked_at += 1
        first_s = float(np.asarray(leads_s)[0])
        begin = crossing_times_s(leads_s, quantiles_c, from_c, first_s)
        reached = np.isfinite(begin)
        if reached.any():
            end = crossing_times_s(leads_s, quantiles_c, to_c, first_s)
            found.append(np.maximum(end[reached] - begin[reached], 0.0))
    return _pooled(found, looked_at)


def time_to(
    forecasts: Iterable[tuple[ArrayLike, ArrayLike]], limit_c: float, probability: float
) -> ResponseTime | None:
    """Return how long it takes from a forecast that warns of a limit to that limit.

    A forecast warns of it where at least the share `probability` reaches it. None where there is no
    forecast at all. Forecasts are lead times (l,) in seconds and quantiles (l, 5) in degC.
    """
    found, looked_at = [], 0
    for leads_s, quantiles_c in forecasts:
        looked_at += 1
        times = crossing_times_s(leads_s, quantiles_c, limit_c, 0.0)
        if np.isfinite(times).mean() >= probability:
            found.append(times)
    return _pooled(found, looked_at)


def _pooled(found: list[FloatArray], looked_at: int) -> ResponseTime | None:
    if not looked_at:
        return None
    if not found:
        return ResponseTime(np.inf, np.inf, 1.0, 0, looked_at)
    times = np.sort(np.concatenate(found))
    # The sooner of two neighbours: no time is made up between them, nor between one and never.
    p05_s, p50_s = (float(times[int(share * (times.size - 1))]) for share in (0.05, 0.5))
    return ResponseTime(p05_s, p50_s, float(np.isinf(times).mean()), len(found), looked_at)
