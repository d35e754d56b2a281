"""Gaussian processes without the warnings that say nothing to the caller."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor

FloatArray = NDArray[np.float64]


@contextmanager
def unsettled_fits() -> Iterator[None]:
    """Let fits end at a bound or before they settle.

    Likelihoods of few points have flat valleys, networks of few points do not settle, and an input
    that does not vary leaves its reach anywhere: cross-validation judges the result, not the
    search's own stopping rule.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        yield


def predicted(process: GaussianProcessRegressor, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation (n,) at points (n, d)."""
    with warnings.catch_warnings():
        # At a training point the variance is a difference of equal numbers, rounded below zero.
        warnings.filterwarnings("ignore", "Predicted variances smaller than 0", UserWarning)
        mean, deviation = process.predict(x, return_std=True)
    return np.asarray(mean), np.asarray(deviation)
