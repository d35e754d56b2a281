"""Which parameters' priors hang together.

The priors of the default model's friction law pool two literature laws. Those differ in all
exponents at once: Palmgren's viscous part has speed and viscosity exponents of 2/3 without
curvature and does not depend on load; the rolling part of the SKF catalogue law, regressed on the
same features, has .27 with curvature -.19, .43 with interaction -.17, and a load exponent of .54.
So a bearing that turns out like one law in its speed and load exponents will be like it in its
viscosity exponent too, which low-risk data hardly show. One common factor expresses that; it
carries three quarters of the spread between the laws, the rest stays each parameter's own.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin_core.models import ThermalModel

FloatArray = NDArray[np.float64]

# Loading = sqrt(.75) times half the difference of the laws over the prior's standard deviation (at
# most one): p .20/.18, p2 .095/.10, q .12/.18, pq .085/.10, b -.27/.25.
_FRICTION_LOADINGS: Mapping[str, float] = {
    "p": 0.87,
    "p2": 0.82,
    "q": 0.58,
    "pq": 0.74,
    "b": -0.87,
}


def prior_correlation(model: ThermalModel) -> FloatArray:
    """Return the prior covariance (p, p) of the standard coordinates; ones on the diagonal."""
    loadings = np.zeros(model.parameters.size)
    if model.name == "default":
        for name, loading in _FRICTION_LOADINGS.items():
            loadings[model.parameters.index(name)] = loading
    return np.asarray(np.outer(loadings, loadings) + np.diag(1.0 - loadings**2))
