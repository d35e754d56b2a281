"""Which of a model's parameters make up which law, and a family's prior with one law in doubt."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.family import Law
from twin_core.identification.priors import NormalPrior
from twin_core.models import ThermalModel
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import heat_balance_w

FloatArray = NDArray[np.float64]

_STEP_Z = 0.1
_WARM_C, _WARMER_C = 50.0, 70.0
_RUN_IN = 1.0e6
_LEAST_HEAT_W = 1e-9
# What moves no growth of the heat by more than this is no part of a law of friction.
_LEAST_GROWTH = 1e-3


def laws_of(model: ThermalModel) -> dict[Law, list[int]]:
    """Numbers of the parameters of each law; a law without any is missing.

    A parameter belongs to the law whose growth of the heat it changes most: from a load to its
    double, from a speed to its double or a bearing to a warmer one, from fresh grease on. What
    changes none is of housing, films and the level of the friction.
    """
    held = model.at_reference(_WARM_C)
    parameters = model.parameters
    found: dict[Law, list[int]] = {}
    for k in range(parameters.size):
        low, high = np.zeros(parameters.size), np.zeros(parameters.size)
        low[k] = max(-_STEP_Z, parameters.z_lower[k])
        high[k] = min(_STEP_Z, parameters.z_upper[k])
        above, below = _growths(held, high), _growths(held, low)
        moved = {law: float(np.linalg.norm(above[law] - below[law])) for law in above}
        law = max(moved, key=lambda law: moved[law])
        enough = moved[law] > _LEAST_GROWTH * (high[k] - low[k])
        found.setdefault(law if enough else "housing", []).append(k)
    return found


def _growths(model: ThermalModel, z: FloatArray) -> dict[Law, FloatArray]:
    """Logarithms of how the heat at the reference point grows, by law."""
    values = model.parameters.values_from_z(z)
    speed_rpm, load_n = model.reference_point

    def heat(speed: float, load: float, body_c: float, revolutions: float) -> float:
        bodies_c = np.full(len(model.node_names), body_c)
        lost_w = heat_balance_w(model, values, bodies_c, speed, load, _WARM_C, revolutions)[1]
        return float(np.log(max(lost_w, _LEAST_HEAT_W)))

    usual = heat(speed_rpm, load_n, _WARM_C, LONG_RUN_IN)
    return {
        "load": np.array([heat(speed_rpm, 2.0 * load_n, _WARM_C, LONG_RUN_IN) - usual]),
        "speed": np.array(
            [
                heat(2.0 * speed_rpm, load_n, _WARM_C, LONG_RUN_IN) - usual,
                heat(speed_rpm, load_n, _WARMER_C, LONG_RUN_IN) - usual,
            ]
        ),
        "start": np.array(
            [heat(speed_rpm, load_n, _WARM_C, run_in) - usual for run_in in (0.0, _RUN_IN)]
        ),
    }


def load_growth(model: ThermalModel, z: FloatArray) -> float:
    """Logarithm of how the heat grows from the reference load to its double."""
    return float(_growths(model.at_reference(_WARM_C), z)["load"][0])


def doubted(prior: NormalPrior, rows: Sequence[int]) -> NormalPrior:
    """The prior of a machine that has these parameters from the literature, all others as here."""
    if not rows:
        return prior
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[list(rows)] = 0.0
    covariance[list(rows)] = 0.0
    covariance[:, list(rows)] = 0.0
    covariance[list(rows), list(rows)] = 1.0
    return NormalPrior.of(mean, covariance)


def information(covariance: FloatArray, rows: Sequence[int]) -> float:
    """What these parameters' covariance says beyond the literature's unit, in nats."""
    return -0.5 * float(np.linalg.slogdet(covariance[np.ix_(rows, rows)])[1])
