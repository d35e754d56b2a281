"""How well the data know how a machine's heat grows from what was trained to what lies ahead.

The heat at a point ahead over that at a trained point is what a load law, or a speed law, says. Its
logarithm has the gradient g by the standard coordinates; prior and posterior give it the variances
g'g and g'Cg. The ratio of the standard deviations is 1 where only the prior speaks, whatever the
data hold and whatever the parameters are called.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.identifiability import Verdict, verdict
from twin_core.identification.posterior import Posterior
from twin_core.models import ThermalModel
from twin_core.operating_points import STANDING_RPM
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import OperatingProfile, heat_balance_w

FloatArray = NDArray[np.float64]
Law = Literal["load", "speed"]

# The exponents of the model `default`.
_EXPONENTS: dict[Law, str] = {"load": "b", "speed": "p"}

_STEP_Z = 1e-2
_WARM_C = 50.0
_LEAST_GROWTH = 1e-6


def law_verdicts(
    model: ThermalModel, posterior: Posterior, profile: OperatingProfile
) -> dict[Law, Verdict | None]:
    """What the data say about the growth of the heat with load and speed up to a profile's.

    Of the model ``default`` on a machine that was held at points it is the verdict on the exponent,
    as its studies have it. None where there is nothing to know.
    """
    trained = posterior.trained
    running = np.abs(profile.speed_rpm) >= STANDING_RPM
    known = max(trained.speed_rpm_max, STANDING_RPM), max(trained.load_n_max, 1.0)
    fastest = max(float(np.max(np.abs(profile.speed_rpm), initial=0.0)), known[0])
    heaviest = max(float(np.max(profile.load_n[running], initial=0.0)), known[1])
    if (model.name == "default" or model.name.startswith("default ")) and not trained.duty:
        of = dict(zip(model.parameters.names, posterior.verdicts(), strict=True))
        return {law: of.get(name, "informed") for law, name in _EXPONENTS.items()}
    ahead: dict[Law, tuple[float, float]] = {
        "load": (known[0], heaviest),
        "speed": (fastest, known[1]),
    }
    verdicts: dict[Law, Verdict | None] = {}
    for law, point in ahead.items():
        ratio = growth_ratio(model, posterior, known, point)
        verdicts[law] = None if ratio is None else verdict(ratio)
    return verdicts


def growth_ratio(
    model: ThermalModel,
    posterior: Posterior,
    trained: tuple[float, float],
    ahead: tuple[float, float],
) -> float | None:
    """Posterior over prior standard deviation of the growth of the heat.

    `trained`, `ahead`: speed in rpm and load in N. Returns None where there is nothing to know: the
    network states the law and nothing of it is identified, or its heat does not change at all.
    """
    parameters = model.parameters
    low = np.maximum(posterior.z - _STEP_Z, parameters.z_lower)
    high = np.minimum(posterior.z + _STEP_Z, parameters.z_upper)
    gradient = np.zeros(posterior.z.size)
    for k in range(posterior.z.size):
        below, above = posterior.z.copy(), posterior.z.copy()
        below[k], above[k] = low[k], high[k]
        rise = heat_growth(model, above, trained, ahead) - heat_growth(model, below, trained, ahead)
        gradient[k] = rise / max(float(high[k]) - float(low[k]), _STEP_Z)
    prior = float(gradient @ gradient)
    if prior < _LEAST_GROWTH**2:
        return None
    variance = float(gradient @ posterior.covariance @ gradient)
    return float(np.sqrt(max(variance, 0.0) / prior))


def heat_growth(
    model: ThermalModel,
    z: FloatArray,
    trained: tuple[float, float],
    ahead: tuple[float, float],
) -> float:
    """Logarithm of the heat ahead over the trained one, everything as warm as a warm bearing.

    `z` (p,) standard coordinates; `trained`, `ahead`: speed in rpm and load in N.
    """
    values = model.parameters.values_from_z(z)
    warm = np.full(len(model.node_names), _WARM_C)
    first, second = (
        heat_balance_w(model, values, warm, *point, _WARM_C, LONG_RUN_IN)[1]
        for point in (trained, ahead)
    )
    return float(np.log(max(second, 1e-9)) - np.log(max(first, 1e-9)))
