"""Costs of candidates: what searches make small, from whitened residuals.

A new cost is a class of this form that takes the place of `SUM_OF_SQUARES`, or is given to one
`IdentificationProblem`; every search uses it. Refinement and posterior are least squares: they
follow the residuals themselves, not the cost.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Cost(Protocol):
    """Cost of many candidates at once; NaN where a simulation failed."""

    def of(self, residuals: FloatArray) -> FloatArray:
        """Cost (B,) of residuals (B, m), NaN where a simulation failed."""

    def without_nuisance(self, residuals: FloatArray, sensitivity: FloatArray) -> FloatArray:
        """Cost (B,) with the nuisance unknowns at their best, their priors N(0, 1) included.

        `residuals` (B, m + ...) the m measurements first, the nuisance unknowns at zero;
        `sensitivity` (m, k) of the measurements to the nuisance unknowns.
        """


class SumOfSquares:
    """Sum of squared residuals: twice the negative log posterior where they are whitened."""

    def of(self, residuals: FloatArray) -> FloatArray:
        """Return the sums of squares (B,)."""
        return np.asarray(np.sum(residuals**2, axis=1))

    def without_nuisance(self, residuals: FloatArray, sensitivity: FloatArray) -> FloatArray:
        """Return the sums of squares (B,) after linear regression on the nuisance unknowns."""
        projected = residuals[:, : len(sensitivity)] @ sensitivity
        information = np.eye(sensitivity.shape[1]) + sensitivity.T @ sensitivity
        explained = np.sum(projected * np.linalg.solve(information, projected.T).T, axis=1)
        return np.asarray(np.sum(residuals**2, axis=1) - explained)


SUM_OF_SQUARES: Cost = SumOfSquares()


def failed_as_infinite(costs: FloatArray) -> FloatArray:
    """Return costs (B,) with infinity where they are not finite, as searches compare them."""
    return np.where(np.isfinite(costs), costs, np.inf)
