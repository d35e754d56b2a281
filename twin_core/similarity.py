"""How alike the operation was behind two identifications, and what that means for their difference.

A model is wrong in the same way on the same run, so where two data sets repeat one sequence of
operating points its error cancels in their difference, and the posteriors, which allow for it, are
too wide. With the same points in another order, or for other times, it cancels in part; between
different points it does not. The factors below on the covariance of a difference were measured on
virtual benches without any change; see docs/trust/drift.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from twin_core.identification.posterior import Posterior
from twin_core.operating_points import OperatingSpan, alike_points

_SCALE_SAME = 0.1
_SCALE_ALIKE = 0.7
_SCALE_OTHER = 2.0
# A colder ambient changes viscosity, radiation and preload, which the model follows roughly.
_SCALE_PER_K2 = 0.016
# Laid side by side, so much of two sequences must be the same for them to count as one.
_SAME_SEQUENCE = 0.95
# Shares of common points this near to the largest are as good as it.
_NEARLY = 0.1
# An operating point must have lasted this long to have left a mark.
_TAUGHT_S = 1200.0
# Before this many revolutions grease may still be running in, which the model follows only roughly.
_RUN_IN_REVOLUTIONS = 3.0e6


@dataclass(frozen=True, slots=True)
class Similarity:
    """How alike the operation was that two posteriors come from."""

    #: The smaller of the shares of time, 0 to 1, that each spent at points that the other visited
    #: too. Data of a bearing that was running in are like no data of one that was run in.
    points: float
    #: Share of the longer one in which both were at alike points, laid side by side from their
    #: beginnings; 0 where only one began at standstill.
    sequence: float
    #: By how much their mean ambient temperatures differ; 0 where one is not known.
    ambient_k: float = 0.0

    @property
    def same_run(self) -> bool:
        """Whether one sequence of operating points was run twice."""
        return self.sequence >= _SAME_SEQUENCE

    @property
    def scale(self) -> float:
        """Factor on the covariance of the difference."""
        scale = _SCALE_ALIKE**self.points * _SCALE_OTHER ** (1.0 - self.points)
        if self.same_run:
            scale = _SCALE_SAME
        return float(scale + _SCALE_PER_K2 * self.ambient_k**2)

    @property
    def text(self) -> str:
        """For people."""
        said = f"{self.points:.0%} of the operation alike"
        if self.same_run:
            said = "the same run again"
        return said if self.ambient_k < 1.0 else f"{said}, ambient {self.ambient_k:.0f} K apart"


def similarity(first: Posterior, second: Posterior) -> Similarity:
    """Compare the operation that two posteriors come from."""
    apart_k = _ambient_apart(first, second)
    running_in = [p.trained.revolutions < _RUN_IN_REVOLUTIONS for p in (first, second)]
    if running_in[0] != running_in[1]:
        return Similarity(0.0, 0.0, apart_k)
    points = [
        [p for p in posterior.trained.operating_points if p.duration_s >= _TAUGHT_S]
        or list(posterior.trained.duty)
        for posterior in (first, second)
    ]
    if not all(points):
        return Similarity(0.0, 0.0, apart_k)
    varying = any(posterior.trained.duty for posterior in (first, second))
    same_start = not varying and first.trained.from_rest == second.trained.from_rest
    return Similarity(
        min(_common(points[0], points[1]), _common(points[1], points[0])),
        _side_by_side(points[0], points[1]) if same_start else 0.0,
        apart_k,
    )


def _ambient_apart(first: Posterior, second: Posterior) -> float:
    ambient = [posterior.trained.ambient_c for posterior in (first, second)]
    if ambient[0] is None or ambient[1] is None:
        return 0.0
    return abs(ambient[0] - ambient[1])


def nearest(posteriors: Sequence[Posterior], posterior: Posterior) -> list[int]:
    """Positions of those of several posteriors whose operation was most like that of another.

    All that come from the same run, if any do; else all with nearly the largest share of common
    points. In order, so the last one is the newest; empty if there is none to choose from.
    """
    alike = [similarity(one, posterior) for one in posteriors]
    same = [k for k, one in enumerate(alike) if one.same_run]
    if same or not alike:
        return same
    most = max(one.points for one in alike)
    return [k for k, one in enumerate(alike) if one.points >= most - _NEARLY]


def _side_by_side(points: Sequence[OperatingSpan], others: Sequence[OperatingSpan]) -> float:
    begun = points[0].start_s - others[0].start_s
    together = sum(
        max(min(p.end_s, other.end_s + begun) - max(p.start_s, other.start_s + begun), 0.0)
        for p in points
        for other in others
        if alike_points(p, other)
    )
    longer = max(sum(p.duration_s for p in each) for each in (points, others))
    return min(together / longer, 1.0)


def _common(points: Sequence[OperatingSpan], others: Sequence[OperatingSpan]) -> float:
    total = sum(point.duration_s for point in points)
    met = sum(p.duration_s for p in points if any(alike_points(p, other) for other in others))
    return met / total if total else 0.0
