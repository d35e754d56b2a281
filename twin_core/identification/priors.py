"""What is known of a machine before its own data: a normal distribution of its coordinates.

Without anything else that is the literature's, N(0, 1) in every standard coordinate. Machines of
the same family that have been identified give a narrower one; see `twin_core.sisters`.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NormalPrior:
    """A normal prior of the standard coordinates, correlations included."""

    mean: FloatArray  # (p,) most probable coordinates; 0 is the literature's
    #: (p, p) lower triangular with positive diagonal; the covariance is factor @ factor.T. The
    #: literature's is the identity.
    factor: FloatArray

    @classmethod
    def of(cls, mean: FloatArray, covariance: FloatArray) -> Self:
        """Make a prior of a mean (p,) and a positive definite covariance (p, p).

        Raises `ValueError` if the covariance is not positive definite, or shapes do not fit.
        """
        p = mean.size
        if covariance.shape != (p, p):
            raise ValueError(f"covariance has shape {covariance.shape}, expected {(p, p)}")
        try:
            factor = np.linalg.cholesky(0.5 * (covariance + covariance.T))
        except np.linalg.LinAlgError as error:
            raise ValueError("covariance is not positive definite") from error
        return cls(np.array(mean, np.float64), np.asarray(factor, np.float64))

    @property
    def covariance(self) -> FloatArray:
        """(p, p)."""
        return np.asarray(self.factor @ self.factor.T)

    @property
    def std(self) -> FloatArray:
        """(p,) standard deviations; 1 is the literature's."""
        return np.asarray(np.sqrt(np.sum(self.factor**2, axis=1)))

    @property
    def whitener(self) -> FloatArray:
        """(p, p) matrix that makes deviations from the mean independent with unit variance."""
        return np.asarray(np.linalg.inv(self.factor))

    @property
    def log_determinant(self) -> float:
        """Natural logarithm of the factor's determinant; 0 is the literature's."""
        return float(np.sum(np.log(np.diag(self.factor))))


def literature_prior(size: int) -> NormalPrior:
    """Return the prior N(0, 1) of ``size`` coordinates."""
    return NormalPrior(np.zeros(size), np.eye(size))
