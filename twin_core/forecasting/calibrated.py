"""Bands made wider by what the forecasts of sisters would have needed.

Never narrower: a few tens of bearings can confirm a band, not narrow it, and that a machine is one
of its family is doubted in the band itself (`twin_core.sisters.trust`).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.family import BEYOND, BandFactor
from twin_core.identification.posterior import Posterior, TrainedRange
from twin_core.operating_points import STANDING_RPM
from twin_core.simulation import OperatingProfile

FloatArray = NDArray[np.float64]


def untrained_rows(profile: OperatingProfile, trained: TrainedRange) -> NDArray[np.bool_]:
    """Return from which row on a machine has gone beyond its trained loads and speeds, (n,)."""
    speed = np.abs(profile.speed_rpm)
    running = speed >= STANDING_RPM
    beyond = running & (profile.load_n > BEYOND * trained.load_n_max)
    beyond |= speed > BEYOND * trained.speed_rpm_max
    return np.asarray(np.logical_or.accumulate(beyond))


def band_factor(posterior: Posterior, profile: OperatingProfile) -> BandFactor | None:
    """Factor on a forecast's band; None where too few sisters went that far."""
    if posterior.sisters is None:
        return None
    rows = untrained_rows(profile, posterior.trained)
    if not rows.any():
        return None
    speed = np.abs(profile.speed_rpm)
    load_n = float(np.max(profile.load_n[speed >= STANDING_RPM], initial=0.0))
    speed_rpm = float(np.max(speed))
    return posterior.sisters.band_factor(
        load_n if load_n > BEYOND * posterior.trained.load_n_max else 0.0,
        speed_rpm if speed_rpm > BEYOND * posterior.trained.speed_rpm_max else 0.0,
    )


def spread_members(
    readings: FloatArray,
    sensors: Sequence[str],
    factor: BandFactor,
    rows: NDArray[np.bool_],
) -> FloatArray:
    """Move members away from their median; returns the factors (n, sensors).

    `readings` (members, n, sensors) in degC; changed in place; `sensors`: their names; one that no
    run of a sister has keeps its band; `factor`: by how much; `rows` (n,) where.
    """
    wanted = np.array([factor.by_sensor.get(name, 1.0) for name in sensors])
    factors = np.where(rows[:, None], wanted, 1.0)
    centre = np.median(readings, axis=0)
    readings -= centre
    readings *= factors
    readings += centre
    return factors
