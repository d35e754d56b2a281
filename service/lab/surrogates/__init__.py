"""The paper's other virtual models: surrogates and a neural network instead of physics.

Wang et al., Appl. Sci. 2025, 15(12), 6671, section 2 names three kinds of virtual model. Kind A,
the thermal network, is `twin_core`; here are kind B (response surface, radial basis
functions, Kriging, support vectors) and kind C (a small neural network), in the same form as the
naive forecasts, and a Gaussian process on the twin's own residual. Needs scikit-learn, the extra
``surrogates``; nothing of the product does.
"""

try:
    import sklearn  # noqa: F401 - only to say in one line what is missing
except ImportError as error:
    raise ImportError(
        "scikit-learn is not installed: pip install 'bearing-twin[surrogates]'"
    ) from error

from service.lab.surrogates.forecasters import (
    SURROGATE_KINDS,
    fit_surrogate,
    surrogate_forecasters,
)
from service.lab.surrogates.maps import SurrogateKind
from service.lab.surrogates.residual import ResidualModel, fit_residual, with_residual

__all__ = [
    "SURROGATE_KINDS",
    "ResidualModel",
    "SurrogateKind",
    "fit_residual",
    "fit_surrogate",
    "surrogate_forecasters",
    "with_residual",
]
