"""Runaway as a margin: how probable it is, and how far away in kelvins and newtons.

A bearing runs away when a rise feeds itself: heat that grows with temperature, by dQ/dT, times the
thermal resistance R on its way out, is the loop gain, and above 1 there is no way back. What the
rings' growth and the thinner oil make of the friction is in the identified law, so every member of
an ensemble has a gain. On the way to a real runaway the preload stiffens and the gain grows, which
no low-risk data show: the members' share that runs away says too little of it. The probability is
therefore a logistic of two figures that told best on benches that did run away: the upper edge of
the gain, and how far that of the hottest sensor reaches between the model's limits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, logit

from twin_core.identification.posterior import Posterior
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.models import ThermalModel
from twin_core.network_model import RunawayLimits
from twin_core.simulation import holding

FloatArray = NDArray[np.float64]

LIKELY = 0.05
"""Above this probability a runaway is not excluded; the margin in newtons ends here."""
UPPER = 0.975
# Fitted to 180 virtual benches of three families, 6 of which ran away, at 4000 and 5500 N each;
# tested on others, see docs/model.md.
_OFFSET, _BY_GAIN, _BY_REACH = -5.8, 3.3, 2.0
_SETTLED_S = 8 * 3600.0
_BELOW_SAFE = 1e-9


@dataclass(frozen=True, slots=True)
class RunawayMargin:
    """How far a machine is from a thermal runaway at an operating point.

    Attributes
    ----------
    speed_rpm, load_n
        The operating point.
    probability
        That the machine runs away there.
    loop_gain, loop_gain_upper
        Median and 97.5 % of the members' loop gain; infinite where so many run away.
    margin_k
        How much hotter the hottest sensor may become until the gain is 1 or the sensor is beyond
        the model's limit: 95 % of the members have more. Infinite where there is no limit.
    margin_n
        How much more load it takes until the probability is 5 %, negative beyond; NaN where none of
        the loads that were looked at is as bad.
    """

    speed_rpm: float
    load_n: float
    probability: float
    loop_gain: float
    loop_gain_upper: float
    margin_k: float
    margin_n: float


def runaway_probability(
    posterior: Posterior,
    hottest_c: ArrayLike,
    gain_upper: ArrayLike,
    share: ArrayLike,
    limits: RunawayLimits | None,
) -> FloatArray:
    """Probability of a thermal runaway.

    Parameters
    ----------
    posterior
        What the forecast rests on.
    hottest_c, gain_upper, share
        Upper edges (97.5 %) of the hottest sensor in degC and of the loop gain, and share of the
        members that run away; arrays of one shape, or scalars.
    limits
        The model's. Where they were not tested, and before any identification, the members' share
        is all there is.
    """
    if limits is None or not limits.tested or not posterior.identified:
        return np.asarray(share, np.float64)
    reach = (np.asarray(hottest_c, np.float64) - limits.hot_c) / (limits.lost_c - limits.hot_c)
    gain = np.clip(gain_upper, -1.0, 1.0)
    odds = _OFFSET + _BY_GAIN * gain + _BY_REACH * np.minimum(reach, 1.0)
    return np.asarray(expit(odds))


def upper_gain(gain: FloatArray, away: NDArray[np.bool_]) -> FloatArray:
    """Median and 97.5 % (2, points) of loop gains (members, points); of those lost infinite."""
    counted = np.where(away, np.inf, gain)
    return np.asarray(np.quantile(counted, (0.5, UPPER), axis=0, method="higher"))


def gain_at(
    model: ThermalModel,
    values: FloatArray,
    start_c: FloatArray,
    revolutions: float,
    heat_w: FloatArray,
    point: tuple[float, float, float],
) -> float:
    """97.5 % of the loop gains of members held at a point; infinite where so many run away.

    Parameters
    ----------
    model, values
        The model and the members' parameters (members, p).
    start_c, revolutions, heat_w
        Where they begin: (members, nodes) temperatures and heats that fade.
    point
        Speed in rpm, load in N, ambient in degC.
    """
    speed_rpm, load_n, ambient_c = point
    members, sensors = len(values), len(model.sensor_names)
    steady, gain = np.empty((members, 1, sensors)), np.empty((members, 1))
    holding.hold_points_range(
        model.compiled,
        values,
        start_c,
        revolutions,
        heat_w,
        1.0 / DISTURBANCE_TIME_S,
        ambient_c,
        np.array([abs(speed_rpm)]),
        np.array([max(load_n, 0.0)]),
        model.sensor_matrix(model.sensor_names),
        np.empty((members, sensors, 0)),
        np.empty((members, 1, sensors, 0)),
        model.errors.slow_s,
        _SETTLED_S,
        0,
        members,
        steady,
        np.empty((members, 1, sensors, 0)),
        gain,
        np.empty((members, 1, sensors)),
    )
    away = ~np.all(steady <= model.lost_c, axis=2)  # NaN: no steady state
    return float(upper_gain(gain, away)[1, 0])


def newtons_left(load_n: FloatArray, probability: FloatArray) -> FloatArray:
    """How much more load, (loads, speeds) in N, until the probability reaches 5 %.

    Parameters
    ----------
    load_n
        (loads,) increasing.
    probability
        (loads, speeds) at these loads; in between its log odds are taken as straight.

    Returns
    -------
    ndarray
        Negative beyond that load; NaN where no load of these is as bad. Where the least load is as
        bad already, it stands for the one that was looked for.
    """
    worst = np.maximum.accumulate(probability, axis=0)
    odds = logit(np.clip(worst, _BELOW_SAFE, 1.0 - _BELOW_SAFE))
    bar = float(logit(LIKELY))
    result = np.full(probability.shape, np.nan)
    for column, values in enumerate(odds.T):
        over = int(np.argmax(values >= bar))
        if values[over] < bar:
            continue
        reached_n = load_n[over]
        if over > 0:
            part = (bar - values[over - 1]) / (values[over] - values[over - 1])
            reached_n = load_n[over - 1] + part * (load_n[over] - load_n[over - 1])
        result[:, column] = reached_n - load_n
    return result
