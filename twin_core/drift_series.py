"""A machine followed over its model versions: quantities with intervals, slow changes summed up.

Two neighbouring versions may differ by less than can be distinguished while the machine keeps going
the same way. Every version is therefore also compared with the mean of all unchanged ones of alike
operation before it, and the standardised deviations of every quantity are summed up by two
one-sided cumulative sums

    up = max(0, up + u - 1/2),   down = max(0, down - u - 1/2),

which report at 5. For independent standard normal u one quantity reports by chance once in 465
versions (Montgomery, Introduction to Statistical Quality Control, average run lengths of the
two-sided scheme with h = 5, k = 1/2); all eight of a bearing together once in about 60.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.drift import Drift, compare, difference_covariance
from twin_core.identification.posterior import Posterior
from twin_core.models import ThermalModel
from twin_core.quantities import Quantity, ReferencePoint, evaluate, log_gradient, quantities
from twin_core.similarity import nearest, similarity

FloatArray = NDArray[np.float64]

ALLOWANCE = 0.5
LIMIT = 5.0

_Z95 = 1.959964


@dataclass(frozen=True, slots=True)
class Value:
    """A quantity of one version with its 95 % interval."""

    quantity: Quantity
    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class SeriesVersion:
    """One version of the series."""

    #: Position of the newest unchanged version of most alike operation; None at the first.
    against: int | None
    drift: Drift | None  # comparison with it; None at the first
    #: Larger of the two cumulative sums of every quantity, with the sign of its direction; by name
    #: of the quantity.
    sums: dict[str, float]
    creeping: tuple[str, ...]  # names of the quantities whose sum is at its limit

    @property
    def changed(self) -> bool:
        """Whether a change is reported, sudden or creeping."""
        return bool(self.creeping) or (self.drift is not None and self.drift.changed)


def values_of(
    model: ThermalModel, posterior: Posterior, point: ReferencePoint
) -> tuple[Value, ...]:
    """Quantities of a posterior with 95 % intervals, without those that have no value.

    Intervals are those of the posterior, the prior's share included: they show how well a quantity
    is known, not how well a change of it would be seen (that is `twin_core.drift.compare`).
    """
    logarithms = np.log(evaluate(model, posterior.z, point))
    gradient = log_gradient(model, posterior.z, point)
    variance = np.einsum("kp,pq,kq->k", gradient, posterior.covariance, gradient)
    half = _Z95 * np.sqrt(variance)
    return tuple(
        Value(quantity, *(float(one) for one in np.exp([middle, middle - each, middle + each])))
        for quantity, middle, each in zip(quantities(model, point), logarithms, half, strict=True)
        if np.isfinite(middle) and np.isfinite(each)
    )


def follow(
    model: ThermalModel, posteriors: Sequence[Posterior], point: ReferencePoint
) -> tuple[SeriesVersion, ...]:
    """Follow a machine over versions that share no data.

    Every version is compared with the unchanged ones before it whose operation was most like its
    own. A version at which a change is reported does not join those.

    `posteriors`: in time order, of fits that did not fail.
    """
    names = [quantity.name for quantity in quantities(model, point)]
    up, down = np.zeros(len(names)), np.zeros(len(names))
    unchanged: list[int] = []
    readings = []
    for position, posterior in enumerate(posteriors):
        drift = None
        alike = nearest([posteriors[k] for k in unchanged], posterior)
        chosen = [unchanged[k] for k in alike]
        if chosen:
            before = [posteriors[k] for k in chosen]
            drift = compare(model, before[-1], posterior, point=point)
            deviation = _deviation(model, before, posterior, point)
            up = np.maximum(up + deviation - ALLOWANCE, 0.0)
            down = np.maximum(down - deviation - ALLOWANCE, 0.0)
        larger = np.where(up >= down, up, -down)
        creeping = tuple(
            name for name, size in zip(names, np.abs(larger), strict=True) if size >= LIMIT
        )
        sums = {name: float(size) for name, size in zip(names, larger, strict=True)}
        readings.append(SeriesVersion(chosen[-1] if chosen else None, drift, sums, creeping))
        if not readings[-1].changed:
            unchanged.append(position)
    return tuple(readings)


def _deviation(
    model: ThermalModel, before: Sequence[Posterior], posterior: Posterior, point: ReferencePoint
) -> FloatArray:
    """Standardised deviations (k,) of a version's quantities from the mean of others.

    0 where a quantity has no value. The plain mean: weights by information would make sums of
    estimates that lie in different places of a curved valley, and see deviations in them.
    """
    middle = np.mean([one.z for one in before], axis=0)
    spread = difference_covariance(before[-1].covariance, posterior.covariance)
    spread *= similarity(before[-1], posterior).scale * 0.5 * (1.0 + 1.0 / len(before))
    gradient = log_gradient(model, middle, point)
    variance = np.einsum("kp,pq,kq->k", gradient, spread, gradient)
    deviation = gradient @ (posterior.z - middle) / np.sqrt(variance)
    return np.where(np.isfinite(deviation), deviation, 0.0)
