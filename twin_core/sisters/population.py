"""The population that sisters' posteriors make, and who does not belong to it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.heat_laws import heat_growth
from twin_core.identification.data import IdentificationData
from twin_core.identification.family import SisterKnowledge
from twin_core.identification.posterior import Posterior, TrainedRange
from twin_core.identification.priors import NormalPrior
from twin_core.models import ThermalModel
from twin_core.operating_points import STANDING_RPM

FloatArray = NDArray[np.float64]

FEWEST_SISTERS = 2
"""One machine has no scatter."""

# How much the literature's spread weighs in the scatter, in sisters. Without it, a few sisters that
# happen to agree would make a prior that leaves no room for the next one. A third of a sister gave
# the best interval score on development benches with 19 and with 5 sisters.
_LITERATURE_WEIGHT = 0.3
# Up to a quarter of the sisters are strangers if the growth of their heat is off that of the others
# by more than both: what one of a hundred further sisters would be, and so much of a natural
# logarithm, a kelvin in ten of the rise. With fewer than six the others may be the strangers.
_STRANGE_SHARE, _STRANGE_GROWTH = 0.01, 0.10
_MOST_STRANGERS = 4
_FEWEST_TO_JUDGE = 6
_FAR_APART = 1.25
# Two machines do not read the same to a hundredth of a kelvin for long.
_SAME_K, _SAME_SHARE, _ROWS_TO_COMPARE = 0.01, 0.9, 10
_UNITS = {"load_n": "N", "speed_rpm": "rpm"}


@dataclass(frozen=True, slots=True, eq=False)
class Sister:
    """What is known of an identified machine, from its own data alone."""

    name: str
    #: (p,) and (p, p) posterior with the literature's prior. One that was made with sisters would
    #: count them twice.
    z: FloatArray
    covariance: FloatArray
    trained: TrainedRange  # where it has been
    data: IdentificationData | None = None  # its minute rows; None where they are not known


def sister_of(name: str, own: Posterior, data: IdentificationData | None) -> Sister:
    """Make a sister of what a machine's own data say.

    `own`: its posterior with the literature's prior; `data`: its minute rows, if they are known.
    Raises `ValueError` if that is no identified machine.
    """
    p = own.z.size
    if not own.identified:
        raise ValueError("identified from no data; expected an identified model")
    shapes = own.z.shape == (p,) and own.covariance.shape == (p, p)
    if not shapes or not (np.isfinite(own.z).all() and _is_definite(own.covariance)):
        raise ValueError("damaged model (its posterior is no distribution)")
    return Sister(name, own.z, own.covariance, own.trained, data)


def population_prior(sisters: Sequence[Sister]) -> NormalPrior:
    """Give the prior of a further machine of the family, correlations included.

    The mean of the sisters' coordinates; their scatter, that of a mean of n, and the mean of their
    own uncertainties (law of total variance). In no direction wider than the literature's.

    `sisters`: at least two, all of one model. Raises `ValueError` for fewer.
    """
    n = len(sisters)
    if n < FEWEST_SISTERS:
        raise ValueError(f"{n} sisters, expected at least {FEWEST_SISTERS}")
    z = np.array([sister.z for sister in sisters])
    centre = z.mean(axis=0)
    deviations = z - centre
    scatter = deviations.T @ deviations + _LITERATURE_WEIGHT * np.eye(centre.size)
    scatter *= (1.0 + 1.0 / n) / (n - 1 + _LITERATURE_WEIGHT)
    spread = scatter + np.mean([sister.covariance for sister in sisters], axis=0)
    variances, directions = np.linalg.eigh(0.5 * (spread + spread.T))
    return NormalPrior.of(centre, (directions * np.minimum(variances, 1.0)) @ directions.T)


def knowledge_of(sisters: Sequence[Sister]) -> SisterKnowledge:
    """Say where sisters have been, without any calibration."""
    return SisterKnowledge(
        tuple(sister.name for sister in sisters),
        tuple(sister.trained.load_n_max for sister in sisters),
        tuple(sister.trained.speed_rpm_max for sister in sisters),
    )


def strangers(model: ThermalModel, sisters: Sequence[Sister]) -> dict[str, str]:
    """Find those whose friction grows otherwise with load or speed than that of the others.

    Judged are those that have seen as much as half of the sisters have; six of them at least.

    Returns why each does not belong to the family, by its name.
    """
    found: dict[str, str] = {}
    speed_rpm = float(np.median([max(_reached(one, "speed_rpm")) for one in sisters]))
    load_n = float(np.median([min(_reached(one, "load_n")) for one in sisters]))
    for what, name in (("load", "load_n"), ("speed", "speed_rpm")):
        highest = [max(_reached(one, name)) for one in sisters]
        top = float(np.quantile(highest, 0.5, method="lower"))
        bottom = float(np.median([min(_reached(one, name)) for one in sisters]))
        judged = [one for one, most in zip(sisters, highest, strict=True) if most >= 0.98 * top]
        if len(judged) < _FEWEST_TO_JUDGE or not top > _FAR_APART * bottom > 0.0:
            continue
        ends = [
            (speed_rpm, value) if what == "load" else (value, load_n) for value in (bottom, top)
        ]
        growth = np.array([heat_growth(model, one.z, ends[0], ends[1]) for one in judged])
        centre = float(np.median(growth))
        for row in _outside(growth):
            found[judged[row].name] = (
                f"its friction heat grows {np.exp(growth[row]):.2f} times from {bottom:.0f} to "
                f"{top:.0f} {_UNITS[name]}, that of its sisters {np.exp(centre):.2f} times"
            )
    return found


def _is_definite(covariance: FloatArray) -> bool:
    if not np.isfinite(covariance).all():
        return False
    return bool(np.linalg.eigvalsh(covariance)[0] > 0.0)


def _outside(values: FloatArray) -> list[int]:
    """Which of the values (n,) do not belong to the others: the largest such group, or none."""
    from scipy.special import stdtrit  # loaded by what learns a population

    order = np.argsort(np.abs(values - np.median(values)))
    for group in range(values.size // _MOST_STRANGERS, 0, -1):
        core, far = values[order[:-group]], values[order[-group:]]
        usual = stdtrit(core.size - 1, 1.0 - _STRANGE_SHARE / 2.0)
        usual *= np.std(core, ddof=1) * np.sqrt(1.0 + 1.0 / core.size)
        if np.all(np.abs(far - np.mean(core)) > max(usual, _STRANGE_GROWTH)):
            return [int(row) for row in order[-group:]]
    return []


def same_run(one: IdentificationData, other: IdentificationData) -> bool:
    """Return whether two data sets are of one run of one machine: it is no sister of itself.

    Compared are their temperatures at equal times since their first rows.
    """
    ours, theirs = one.windows[0].minutes, other.windows[0].minutes
    our_s, their_s = ours.time_s - ours.time_s[0], theirs.time_s - theirs.time_s[0]
    differences = [
        np.abs(np.interp(our_s, their_s, theirs.temperatures_c[name], right=np.nan) - values)
        for name, values in ours.temperatures_c.items()
        if name in theirs.temperatures_c
    ]
    known = np.concatenate([found[np.isfinite(found)] for found in differences] or [np.zeros(0)])
    return known.size >= _ROWS_TO_COMPARE and float(np.mean(known < _SAME_K)) > _SAME_SHARE


def _reached(sister: Sister, name: str) -> list[float]:
    """Loads or speeds where a sister ran; 0 where it did not."""
    points = [point for point in sister.trained.points if point.speed_rpm >= STANDING_RPM]
    return [float(getattr(point, name)) for point in points] or [0.0]
