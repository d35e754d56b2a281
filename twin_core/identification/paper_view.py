"""The paper's 15 numbers as a view on what was identified in combinations of them."""

from typing import Any

import numpy as np

from twin_core.identification.posterior import Posterior
from twin_core.models import ThermalModel
from twin_core.reduced_paper import REDUCED_NAME, paper_numbers

_DRAWS = 400
_LEVELS = (0.025, 0.975)


def paper_view(model: ThermalModel, posterior: Posterior) -> dict[str, dict[str, Any]] | None:
    """Return value and 95 % interval of the paper's 15 numbers; None for other models.

    The intervals are those of the posterior's samples, or of its normal approximation where it has
    none. A number that the reduced model holds fixed has an interval without width.

    Raises `ValueError` if the posterior belongs to another model.
    """
    if model.name != REDUCED_NAME:
        return None
    posterior.check(model)
    parameters = model.parameters
    samples = posterior.samples
    if len(samples) == 0:
        factor = np.linalg.cholesky(posterior.covariance + 1e-12 * np.eye(posterior.z.size))
        normal = np.random.default_rng(0).standard_normal((_DRAWS, posterior.z.size))
        samples = posterior.z + normal @ factor.T
    best = paper_numbers(parameters, parameters.values_from_z(posterior.z))
    scattered = paper_numbers(parameters, parameters.values_from_z(samples))
    view = {}
    for name, value in best.items():
        low, high = np.quantile(scattered[name], _LEVELS)
        view[name] = {"value": float(value), "low": float(low), "high": float(high)}
    return view
