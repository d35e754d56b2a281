"""Random draws that an ensemble is made of, in antithetic pairs."""

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.posterior import Posterior

FloatArray = NDArray[np.float64]


def parameter_draws(rng: np.random.Generator, members: int, posterior: Posterior) -> FloatArray:
    """Standard coordinates (members, p): the posterior's samples, or the normal distribution."""
    count = len(posterior.samples)
    if count == 0:
        return posterior.z + normal_draws(rng, members, posterior.covariance)
    # Whole rounds through the samples before any is used once more than another.
    order = np.concatenate([rng.permutation(count) for _ in range(-(-members // count))])
    return np.asarray(posterior.samples[order[:members]])


def paired_draws(rng: np.random.Generator, members: int, shape: tuple[int, ...]) -> FloatArray:
    """Standard normal numbers (members, ...) in antithetic pairs; members is even."""
    half = rng.standard_normal((members // 2, *shape))
    return np.concatenate((half, -half))


def normal_draws(rng: np.random.Generator, members: int, covariance: FloatArray) -> FloatArray:
    """Antithetic draws (members, k) of N(0, covariance); the covariance may be singular."""
    variance, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
    factor = directions * np.sqrt(np.maximum(variance, 0.0))
    return np.asarray(paired_draws(rng, members, (len(covariance),)) @ factor.T)
