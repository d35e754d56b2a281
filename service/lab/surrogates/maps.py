"""The surrogates proper: from an operating point to the sensors' steady excess over ambient.

Every method may choose among a few settings of its own by cross-validation over operating points,
each left out once: nothing but the training data decides. With fewer than three points there is
nothing to decide on, and the first setting of each kind is taken. The error at points left out is
also the method's band; Kriging has its own variance.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    Kernel,
    WhiteKernel,
)
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import Ridge
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.svm import SVR

from service.lab.surrogates.gaussian_process import predicted, unsettled_fits

FloatArray = NDArray[np.float64]

SurrogateKind = Literal["response_surface", "rbf", "kriging", "svr", "mlp"]
Predict = Callable[[FloatArray], tuple[FloatArray, FloatArray | None]]
Fit = Callable[[FloatArray, FloatArray], Predict]

# An input that varies less than this share of its largest value teaches nothing.
_LEAST_VARIATION = 0.05
_MOST_FOLDS = 6
_NETWORKS = 5
_HIDDEN = 8


@dataclass(frozen=True, slots=True, eq=False)
class SteadyMap:
    """A fitted map.

    Attributes
    ----------
    centre, scale
        (2,) of the inputs; the scale is infinite for an input that did not vary.
    mean_k, spread_k
        (s,) of the steady excesses learned from.
    predictors
        One per sensor: standard inputs (n, 2) to standard mean (n,) and, if any, deviation (n,).
    left_out_k
        (s,) rms error at operating points left out; None with fewer than three points.
    settings
        What cross-validation chose.
    """

    centre: FloatArray
    scale: FloatArray
    mean_k: FloatArray
    spread_k: FloatArray
    predictors: tuple[Predict, ...]
    left_out_k: FloatArray | None
    settings: Mapping[str, object]

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Steady excess over ambient in K.

        Parameters
        ----------
        points
            (n, 2) speed in krpm and load in kN.

        Returns
        -------
        mean_k : ndarray
            (n, s).
        deviation_k : ndarray or None
            (n, s) standard deviations; None where fewer than three points were learned from.
        """
        x = (points - self.centre) / self.scale
        found = [predict(x) for predict in self.predictors]
        mean = self.mean_k + self.spread_k * np.stack([mean for mean, _ in found], axis=1)
        if self.left_out_k is None:
            return mean, None
        columns = [
            np.full(len(points), left_out) if own is None else spread * own
            for left_out, spread, (_, own) in zip(
                self.left_out_k, self.spread_k, found, strict=True
            )
        ]
        return mean, np.stack(columns, axis=1)


def fit_map(kind: SurrogateKind, points: FloatArray, steady_k: FloatArray) -> SteadyMap:
    """Fit one kind of map.

    Parameters
    ----------
    kind
        Which.
    points
        (g, 2) speed in krpm and load in kN.
    steady_k
        (g, s) steady excesses over ambient.

    Raises
    ------
    ValueError
        For an unknown kind.
    """
    if kind not in _CANDIDATES:
        raise ValueError(f"surrogate {kind!r}, expected one of {', '.join(_CANDIDATES)}")
    centre = points.mean(axis=0)
    varies = np.ptp(points, axis=0) > _LEAST_VARIATION * points.max(axis=0)
    scale = np.where(varies, points.std(axis=0), np.inf)
    mean_k = steady_k.mean(axis=0)
    spread_k = np.maximum(steady_k.std(axis=0), 1e-6)
    if not varies.any():
        constant = (_constant,) * steady_k.shape[1]
        return SteadyMap(centre, scale, mean_k, spread_k, constant, None, {})
    x, y = (points - centre) / scale, (steady_k - mean_k) / spread_k
    candidates = list(_CANDIDATES[kind]())
    left_out = None
    best = candidates[0]
    with unsettled_fits():
        if len(x) >= 3:
            errors = [_left_out(candidate, x, y) for candidate in candidates]
            chosen = int(np.argmin([np.sum(error**2) for error in errors]))
            best, left_out = candidates[chosen], spread_k * errors[chosen]
        predictors = tuple(best.fit(x, column) for column in y.T)
    return SteadyMap(centre, scale, mean_k, spread_k, predictors, left_out, best.settings)


def _constant(x: FloatArray) -> tuple[FloatArray, None]:
    return np.zeros(len(x)), None


@dataclass(frozen=True, slots=True)
class _Candidate:
    settings: Mapping[str, object]
    fit: Fit
    trial: Fit | None = None
    """A cheaper fit for cross-validation."""


def _left_out(candidate: _Candidate, x: FloatArray, y: FloatArray) -> FloatArray:
    """Rms errors (s,) at points that were left out, a few at a time where there are many."""
    fit = candidate.trial or candidate.fit
    folds = np.arange(len(x)) % min(len(x), _MOST_FOLDS)
    errors = np.empty_like(y)
    for fold in range(int(folds.max()) + 1):
        out = folds == fold
        for column in range(y.shape[1]):
            mean, _ = fit(x[~out], y[~out, column])(x[out])
            errors[out, column] = mean - y[out, column]
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


def _alone(estimator: Any) -> Fit:
    """Fit of an estimator that knows no deviation; it is built again by each call."""

    def fit(x: FloatArray, y: FloatArray) -> Predict:
        fitted = estimator().fit(x, y)
        return lambda points: (np.asarray(fitted.predict(points)), None)

    return fit


def _response_surfaces() -> Iterator[_Candidate]:
    for degree, penalty in product((1, 2), (1e-2, 1e-4, 1e-1)):
        yield _Candidate(
            {"degree": degree, "penalty": penalty},
            _alone(
                lambda degree=degree, penalty=penalty: Pipeline(
                    [
                        ("powers", PolynomialFeatures(degree, include_bias=False)),
                        ("ridge", Ridge(penalty)),
                    ]
                )
            ),
        )


def _radial_basis() -> Iterator[_Candidate]:
    for width, penalty in product((2.0, 4.0, 1.0, 0.5), (1e-2, 1e-4, 1e-1)):
        yield _Candidate(
            {"width": width, "penalty": penalty},
            _alone(
                lambda width=width, penalty=penalty: KernelRidge(
                    alpha=penalty, kernel="rbf", gamma=0.5 / width**2
                )
            ),
        )


def _support_vectors() -> Iterator[_Candidate]:
    for width, cost in product((2.0, 4.0, 1.0, 0.5), (10.0, 1.0, 100.0)):
        yield _Candidate(
            {"width": width, "cost": cost},
            _alone(
                lambda width=width, cost=cost: SVR(
                    kernel="rbf", gamma=0.5 / width**2, C=cost, epsilon=0.02
                )
            ),
        )


def _networks() -> Iterator[_Candidate]:
    for penalty in (1e-1, 1e-2, 1.0):
        yield _Candidate(
            {"hidden": _HIDDEN, "penalty": penalty},
            _network(penalty, _NETWORKS),
            _network(penalty, 1),
        )


def _network(penalty: float, count: int) -> Fit:
    def fit(x: FloatArray, y: FloatArray) -> Predict:
        networks = [
            MLPRegressor(
                hidden_layer_sizes=(_HIDDEN,),
                activation="tanh",
                solver="lbfgs",
                alpha=penalty,
                max_iter=200,
                random_state=seed,
            ).fit(x, y)
            for seed in range(count)
        ]
        return lambda points: (
            np.mean([network.predict(points) for network in networks], axis=0),
            None,
        )

    return fit


def _krigings() -> Iterator[_Candidate]:
    smooth = ConstantKernel(1.0, (0.05, 50.0)) * RBF(1.5, (0.5, 10.0))
    noise = WhiteKernel(1e-2, (1e-5, 0.3))
    trend = ConstantKernel(1.0, (0.05, 50.0)) * DotProduct(1.0, "fixed")
    yield _Candidate({"trend": "linear"}, _kriging(trend + smooth + noise))
    yield _Candidate({"trend": "none"}, _kriging(smooth + noise))


def _kriging(kernel: Kernel) -> Fit:
    def fit(x: FloatArray, y: FloatArray) -> Predict:
        process = GaussianProcessRegressor(kernel, random_state=0).fit(x, y)
        return partial(predicted, process)

    return fit


_CANDIDATES: dict[str, Callable[[], Iterator[_Candidate]]] = {
    "response_surface": _response_surfaces,
    "rbf": _radial_basis,
    "kriging": _krigings,
    "svr": _support_vectors,
    "mlp": _networks,
}
