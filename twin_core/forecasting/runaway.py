"""Runaway as a margin: how probable it is, and how far away in kelvins and newtons.

A bearing runs away when a rise feeds itself. Heat that grows with temperature, by dQ/dT, times the
thermal resistance R on its way out is the loop gain, and above 1 there is no way back. What the
rings' growth and the thinner oil make of the friction is in the identified law, so every member of
an ensemble has a gain. But on the way to a real runaway the clearance is used up, the preload
stiffens and the gain grows, which no low-risk data show. What takes up the clearance is known: the
inner ring that is hotter than the outer one. The probability is therefore a logistic of the
clearance that their difference takes up; gain and hottest sensor added nothing to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.identification.posterior import Posterior
from twin_core.network_model import RunawayLimits

FloatArray = NDArray[np.float64]

LIKELY = 0.05
"""Above this probability a runaway is not excluded; the margin in newtons ends here."""
UPPER = 0.975
DIFFERENCE = 0.8
"""Quantile of the members' difference between the rings that the probability follows from."""
# Fitted to 1131 runs of virtual benches, three families and two bearings, trained under one load or
# three (these count four times); 53 ran away. Tested on others, see docs/trust/model.md.
_OFFSET, _BY_CLEARANCE_PER_UM, _USED_UP_UM = -9.8, 0.164, 60.0
_INNER, _OUTER = "t_inner_ring_c", "t_outer_ring_c"
_BELOW_SAFE = 1e-9


@dataclass(frozen=True, slots=True)
class RunawayDistance:
    """How far a machine is from a thermal runaway at an operating point."""

    speed_rpm: float
    load_n: float
    probability: float  # that the machine runs away there
    #: Median and 97.5 % of the members' loop gain; infinite where so many run away.
    loop_gain: float
    loop_gain_upper: float
    #: How much hotter the hottest sensor may become until the gain is 1 or the sensor is beyond the
    #: model's limit: 95 % of the members have more. Infinite where there is no limit.
    margin_k: float
    #: How much more load it takes until the probability is 5 %, negative beyond; NaN where none of
    #: the loads that were looked at is as bad.
    margin_n: float


def ring_difference_k(sensors: Sequence[str], readings_c: FloatArray) -> FloatArray:
    """Inner ring minus outer one (...), of readings (..., sensors); 0 without both."""
    if not {_INNER, _OUTER} <= set(sensors):
        return np.zeros(readings_c.shape[:-1])
    inner, outer = sensors.index(_INNER), sensors.index(_OUTER)
    return np.asarray(readings_c[..., inner] - readings_c[..., outer])


def difference_quantiles_k(difference_k: FloatArray, away: NDArray[np.bool_]) -> FloatArray:
    """Median and 80 % (2, ...) of differences between the rings (members, ...).

    Of the members that run away they are infinite.
    """
    counted = np.where(away, np.inf, difference_k)
    return np.asarray(np.quantile(counted, (0.5, DIFFERENCE), axis=0, method="higher"))


def runaway_probability(
    posterior: Posterior,
    difference_k: ArrayLike,
    share: ArrayLike,
    limits: RunawayLimits | None,
) -> FloatArray:
    """Probability of a thermal runaway.

    `difference_k`, `share`: 80 % of the members' difference between the rings in K, and share of
    the members that run away; arrays of one shape, or scalars. `limits`: the model's. Where they
    were not tested, and before any identification, the members' share is all there is.
    """
    if limits is None or not limits.tested or not posterior.identified:
        return np.asarray(share, np.float64)
    taken_up_um = limits.clearance_um_k * np.asarray(difference_k, np.float64)
    odds = _OFFSET + _BY_CLEARANCE_PER_UM * np.minimum(taken_up_um, _USED_UP_UM)
    return 0.5 * (1.0 + np.tanh(0.5 * odds))


def log_odds(probability: ArrayLike) -> FloatArray:
    """Natural logarithm of the odds of a probability between 0 and 1."""
    share = np.asarray(probability, np.float64)
    return np.asarray(np.log(share / (1.0 - share)))


def upper_gain(gain: FloatArray, away: NDArray[np.bool_]) -> FloatArray:
    """Median and 97.5 % (2, points) of loop gains (members, points); of those lost infinite."""
    counted = np.where(away, np.inf, gain)
    return np.asarray(np.quantile(counted, (0.5, UPPER), axis=0, method="higher"))


def newtons_left(load_n: FloatArray, probability: FloatArray) -> FloatArray:
    """How much more load, (loads, speeds) in N, until the probability reaches 5 %.

    `load_n` (loads,) increasing; `probability` (loads, speeds) at these loads; in between its log
    odds are taken as straight. Negative beyond that load; NaN where no load of these is as
    bad. Where the least load is as bad already, it stands for the one that was looked for.
    """
    worst = np.maximum.accumulate(probability, axis=0)
    odds = log_odds(np.clip(worst, _BELOW_SAFE, 1.0 - _BELOW_SAFE))
    bar = float(log_odds(LIKELY))
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
