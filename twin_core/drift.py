"""Has a machine changed between two identifications, what moved, and by how much.

Two posteriors of one model share their prior, which pulls both to its centre. If the machine is
the same, the difference d of their most probable standard coordinates has mean zero and, for
linear models and independent data, the covariance

    S = A + B - A B - B A

with the posterior covariances A and B (prior: the unit matrix): twice the posterior's where data
decide, nothing where both only repeat the prior. If the later data contain a part f of the
earlier, the covariance of the two estimates grows, down to S = A - B when they contain them all.

A model is wrong in the same way on the same run, so where both data sets repeat one sequence of
operating points its error cancels, and the posteriors, which allow for it, are too wide for their
difference. With the same points in another order, or for other times, it cancels in part; between
different points not at all, and S is too small. S is multiplied by a factor for each case
(`twin_core.similarity`).

What moved is decided between the groups of parameters (`twin_core.quantities`): a change of one
group alone, s times as wide as its prior, makes d a sample of

    N(0, S + s^2 M E E' M'),   M = I - B,   E the group's columns,

and the group that makes the d found most probable, over some sizes s, is named, with the
probabilities of the others. Nothing outside the directions that both data sets inform takes part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.posterior import Posterior
from twin_core.models import ThermalModel
from twin_core.operating_points import alike_points
from twin_core.quantities import (
    Group,
    Quantity,
    ReferencePoint,
    evaluate,
    log_gradient,
    parameter_groups,
    quantities,
    reference_point,
)
from twin_core.similarity import Similarity, similarity

FloatArray = NDArray[np.float64]

FALSE_ALARM_RATE = 0.01
"""How often a comparison of two versions of an unchanged machine may report a change."""

CANDIDATES: tuple[Group, ...] = (
    "friction",
    "contact",
    "convection inside",
    "convection outside",
    "shaft sink",
    "joints",
)
"""What may change on a machine; heat capacities do not, and no sensor separates heat splits."""

# Standard deviations of a change, in those of the prior: machines differ more than one changes.
_CHANGE_SIZES = (0.1, 0.3, 1.0)
# The common noise of shared data comes off their covariance; the error of the model, which other
# data next to them bend another way, does not. Also measured on unchanged benches.
_SHARED_MODEL_ERROR = 0.5
# Error of a change relative to its size, in the logarithm: a model that is wrong about a machine is
# wrong about its changes. On virtual benches 95 of 100 intervals then hold the truth.
_CHANGE_ERROR = 0.3
# Directions in which the mean posterior variance is below this share of the prior's. Weaker ones
# have more than one optimum at times, and no normal distribution describes a difference there.
_INFORMED_VARIANCE = 0.25
# Overlapping data leave no variance in some directions; the fits' own tolerance does.
_LEAST_VARIANCE = 1e-3
_Z95 = 1.959964


@dataclass(frozen=True, slots=True)
class Move:
    """By how much a quantity moved, if one group alone moved."""

    quantity: Quantity
    #: Relative change (0.1 is +10 %) and its 95 % interval.
    change: float
    low: float
    high: float

    @property
    def text(self) -> str:
        """For people."""
        return (
            f"{self.quantity.text}: {100 * self.change:+.0f} % "
            f"(95 %: {100 * self.low:+.0f} to {100 * self.high:+.0f} %)"
        )


@dataclass(frozen=True, slots=True)
class Drift:
    """Comparison of two posteriors of one machine."""

    #: d' S^-1 d over the informed directions, and their number.
    statistic: float
    dimensions: int
    probability: float  # of so large a statistic without any change
    changed: bool  # whether that is below the false alarm rate
    similarity: Similarity
    #: Probability of every candidate to be the one that moved, most probable first; they sum to one
    #: and mean nothing without a change.
    groups: dict[Group, float]
    #: Of the quantity of each group, were it the one that moved, in the same order.
    moves: tuple[Move, ...]
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorDifference:
    """The difference of two posteriors along the k directions that both inform."""

    basis: FloatArray  # (p, k) the directions
    #: (k,) and (k, k) the difference of the standard coordinates and its covariance without any
    #: change of the machine.
    value: FloatArray
    covariance: FloatArray
    similarity: Similarity

    @property
    def statistic(self) -> float:
        """Squared Mahalanobis length."""
        return float(self.value @ np.linalg.solve(self.covariance, self.value))

    @property
    def probability(self) -> float:
        """Of so large a statistic without any change."""
        from scipy.special import chdtrc  # loaded when the first comparison is made

        return float(chdtrc(self.value.size, self.statistic))


def difference_of(before: Posterior, after: Posterior, shared: float = 0.0) -> PosteriorDifference:
    """Difference of two posteriors of one model; parameters as for `compare`."""
    if not 0.0 <= shared <= 1.0:
        raise ValueError(f"shared is {shared}, expected 0 to 1")
    similar = similarity(before, after)
    basis = _informed(before.covariance, after.covariance)
    scale = similar.scale * (1.0 + _SHARED_MODEL_ERROR * shared)
    whole = scale * difference_covariance(before.covariance, after.covariance, shared)
    return PosteriorDifference(
        basis, basis.T @ (after.z - before.z), basis.T @ whole @ basis, similar
    )


def compare(
    model: ThermalModel,
    before: Posterior,
    after: Posterior,
    *,
    shared: float = 0.0,
    point: ReferencePoint | None = None,
) -> Drift:
    """Compare two posteriors.

    `before`, `after`: of fits that did not fail; `shared`: part of the data of ``before`` that went
    into ``after`` as well, 0 to 1; `point`: where quantities are stated; by default `usual_point`
    of ``before``. Raises `ValueError` if a posterior is not of this model or not identified from
    data, or ``shared`` is out of its range.
    """
    for posterior in (before, after):
        posterior.check(model)
        if not posterior.identified:
            raise ValueError("posterior: nothing but the prior, expected one identified from data")
    found = difference_of(before, after, shared)
    where = usual_point(model, before) if point is None else point
    described, start = quantities(model, where), evaluate(model, before.z, where)
    columns = _columns(model)
    response = found.basis.T @ (np.eye(after.z.size) - after.covariance)
    evidence: dict[Group, float] = {}
    moves: dict[Group, Move] = {}
    for group, own in columns.items():
        evidence[group], change, covariance = _explained(found, response[:, own])
        row = next(k for k, one in enumerate(described) if one.group == group)
        z = before.z.copy()
        z[own] += change
        gradient = log_gradient(model, z, where, own)[row]
        moved = float(np.log(evaluate(model, z, where)[row] / start[row]))
        error = float(np.hypot(np.sqrt(gradient @ covariance @ gradient), _CHANGE_ERROR * moved))
        half = _Z95 * error
        ends = np.expm1([moved, moved - half, moved + half])
        moves[group] = Move(described[row], *(float(end) for end in ends))
    ranked = sorted(evidence, key=lambda group: -evidence[group])
    weights = np.exp([evidence[group] - evidence[ranked[0]] for group in ranked])
    shares = weights / weights.sum()
    groups = {group: float(share) for group, share in zip(ranked, shares, strict=True)}
    changed = found.probability < FALSE_ALARM_RATE
    ordered = tuple(moves[group] for group in ranked)
    return Drift(
        found.statistic,
        found.value.size,
        found.probability,
        changed,
        found.similarity,
        groups,
        ordered,
        _text(changed, found.probability, groups, ordered),
    )


def usual_point(model: ThermalModel, posterior: Posterior) -> ReferencePoint:
    """Reference point at the operating point at which the data of a posterior lasted longest."""
    points = posterior.trained.points
    if not points:
        return reference_point(model, posterior.z, *model.reference_point)
    longest = max(
        points,
        key=lambda point: sum(p.duration_s for p in points if alike_points(point, p)),
    )
    return reference_point(
        model,
        posterior.z,
        float(np.round(longest.speed_rpm, -2)),
        float(np.round(longest.load_n, -2)),
    )


def difference_covariance(a: FloatArray, b: FloatArray, shared: float = 0.0) -> FloatArray:
    """Covariance of the difference of two estimates of one machine.

    `a`, `b` (p, p) posterior covariances under a common prior N(0, 1); `shared`: part of the data
    behind ``a`` that are behind ``b`` as well. Returns (p, p), with a least variance of 1e-3 in
    every direction.
    """
    # what both estimates owe to data that they share, next to the machine itself
    common = shared * (np.eye(a.shape[0]) - a) @ b
    covariance = a + b - a @ b - b @ a - common - common.T
    size, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((axes * np.maximum(size, _LEAST_VARIANCE)) @ axes.T)


def _informed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Directions (p, k) that data sets with these posterior covariances inform."""
    variance, directions = np.linalg.eigh(0.5 * (a + b))
    count = max(int(np.count_nonzero(variance < _INFORMED_VARIANCE)), 1)
    return np.asarray(directions[:, :count])


def _columns(model: ThermalModel) -> dict[Group, NDArray[np.intp]]:
    groups = parameter_groups(model)
    return {
        group: np.flatnonzero([groups[name] == group for name in model.parameters.names])
        for group in CANDIDATES
        if group in groups.values()
    }


def _log_normal(value: FloatArray, covariance: FloatArray) -> float:
    _, logarithm = np.linalg.slogdet(covariance)
    return float(-0.5 * (value @ np.linalg.solve(covariance, value) + logarithm))


def _explained(
    found: PosteriorDifference, effect: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """How well a change of some coordinates alone explains a difference, and which change.

    `found`: k informed directions; `effect` (k, g) what the g coordinates do to the difference.
    Returns `evidence`, `change`, `covariance`: logarithm of the probability density of the
    difference; mean (g,) and covariance (g, g) of the change. Changes of every size of
    `_CHANGE_SIZES` count as equally probable.
    """
    weighted = np.linalg.solve(found.covariance, effect)
    evidence, means, covariances = [], [], []
    for size in _CHANGE_SIZES:
        covariance = np.linalg.inv(np.eye(effect.shape[1]) / size**2 + effect.T @ weighted)
        means.append(covariance @ (weighted.T @ found.value))
        covariances.append(covariance)
        whole = found.covariance + size**2 * effect @ effect.T
        evidence.append(_log_normal(found.value, whole))
    total = float(np.logaddexp.reduce(evidence))
    shares = np.exp(np.array(evidence) - total)
    change = np.einsum("s,sg->g", shares, np.array(means))
    apart = np.array(means) - change
    spread = np.array(covariances) + apart[:, :, None] * apart[:, None, :]
    return total, change, np.einsum("s,sgh->gh", shares, spread)


def _text(
    changed: bool, probability: float, groups: dict[Group, float], moves: Sequence[Move]
) -> str:
    if not changed:
        return f"no change beyond what noise and model error explain (p = {probability:.2g})"
    best, *others = groups
    said = f"{best} moved, {moves[0].text}"
    doubtful = [f"{other} {groups[other]:.0%}" for other in others if groups[other] >= 0.1]
    if doubtful:
        said += f"; {best} {groups[best]:.0%}, not excluded: {', '.join(doubtful)}"
    return said
