"""What a global search may ask of an identification, so that any optimiser can take NOA's place.

The searched space is the unit box over the parameters' standard coordinates, where the prior has
practically all its mass: log-scaled for positive parameters. Lag and initial states are eliminated.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin_core import TwinCoreError
from twin_core.identification.costs import failed_as_infinite
from twin_core.identification.problem import IdentificationProblem

FloatArray = NDArray[np.float64]

_SEARCH_Z = 3.0


class SearchEnd(TwinCoreError):  # noqa: N818 - not an error, a search is over
    """The budget is used up, or what was searched for is found."""


class SearchSpace(Protocol):
    """A unit box with a cost, and a budget of evaluations."""

    @property
    def dimensions(self) -> int:
        """Number of coordinates, d."""

    @property
    def budget(self) -> int:
        """Evaluations that may be asked for, one per point."""

    def costs(self, unit: FloatArray) -> FloatArray:
        """Cost (B,) of points (B, d); raises `SearchEnd` when the search is over."""

    def residuals(self, unit: FloatArray) -> FloatArray:
        """Residuals (B, m) whose sums of squares are the costs; raises as `costs` does."""


Search = Callable[[SearchSpace, int], None]
"""A global search with a seed: goes on until `SearchEnd`, or returns when nothing is left to do."""


class IdentificationSpace:
    """The parameters of an identification problem as a `SearchSpace`.

    `budget`: points that may be evaluated; `after_batch`: called after every batch; what it raises
    ends the search.

    Attributes: `evaluations`, `best_z`, `best_cost`: points so far, and the best of them: (p,)
    standard coordinates, cost. The prior's centre until a point has a finite cost.
    """

    def __init__(
        self,
        problem: IdentificationProblem,
        budget: int,
        after_batch: Callable[["IdentificationSpace"], None] | None = None,
    ) -> None:
        self.dimensions = problem.parameter_count
        self.budget = budget
        self.evaluations = 0
        self.best_z: FloatArray = np.zeros(self.dimensions)
        self.best_cost = float("inf")
        self._problem = problem
        self._lower = np.maximum(problem.lower[: self.dimensions], -_SEARCH_Z)
        upper = np.minimum(problem.upper[: self.dimensions], _SEARCH_Z)
        self._width = upper - self._lower
        self._after_batch = after_batch

    def z(self, unit: FloatArray) -> FloatArray:
        """Standard coordinates (..., p) of points (..., p) of the unit box."""
        return np.asarray(self._lower + self._width * unit)

    def costs(self, unit: FloatArray) -> FloatArray:
        """Costs (B,) of the problem, infinite where a simulation failed."""
        z = self._within_budget(unit)
        costs = self._problem.costs(z)
        self._take(z, costs, len(unit))
        return costs

    def residuals(self, unit: FloatArray) -> FloatArray:
        """Residuals (B, m + d) with lag and initial states at their best, priors included."""
        z = self._within_budget(unit)
        residuals = self._problem.reduced_residuals(z)
        self._take(z, failed_as_infinite(self._problem.cost.of(residuals)), len(unit))
        return residuals

    def _within_budget(self, unit: FloatArray) -> FloatArray:
        left = self.budget - self.evaluations
        if left <= 0:
            raise SearchEnd
        return self.z(unit[:left])

    def _take(self, z: FloatArray, costs: FloatArray, asked: int) -> None:
        best = int(np.argmin(costs))
        if costs[best] < self.best_cost:
            self.best_z, self.best_cost = z[best].copy(), float(costs[best])
        self.evaluations += len(z)
        if self._after_batch is not None:
            self._after_batch(self)
        if len(z) < asked:
            raise SearchEnd
