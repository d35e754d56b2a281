"""What to change when a fit on a network of one's own is refused: the network, or its [errors].

A network is refused where it misses the readings by more than its error model allows for. Either it
lacks something, or it follows the machine as well as so coarse a network can and the error model,
by default that of a bearing on its bench, does not fit: too strict, or so wide that the priors
outweigh the data. The residuals of a plain least-squares fit show which.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.offline.tables import FloatArray
from twin_core.identification import FitSettings, IdentificationData, identify
from twin_core.identification.identify import IdentificationResult
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.whitening import Loss
from twin_core.models import ThermalModel
from twin_core.network_model import ErrorModel

# A network that leaves less than this part of the temperatures' variance unexplained has the heat
# flows that matter; one that leaves more lacks one.
_UNEXPLAINED = 0.1
_LONGEST_S = 86400.0
# No error model is narrower than a good sensor; a slow part as small as this one is none, which
# leaves plain least squares with priors of no weight.
_LEAST_K, _PLAIN_K = 0.05, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class SensorResiduals:
    """Errors of one sensor in one window, K, at times in s, and what it read, degC."""

    time_s: FloatArray
    error_k: FloatArray
    measured_c: FloatArray


def hint(
    model: ThermalModel, data: IdentificationData, failed: IdentificationResult, loss: Loss
) -> str:
    """Say which of the two to change, with values for [errors] that the residuals suggest."""
    plain = replace(model, errors=replace(model.errors, slow_k=_PLAIN_K, offset_k=_PLAIN_K))
    try:
        first = identify(
            plain,
            data,
            FitSettings(method="refine", samples=0, loss=loss),
            guess_z=failed.posterior.z,
        )
        errors = suggested_errors(_residuals(plain, data, first, loss), model.errors)
        again = replace(model, errors=errors)
        better = identify(
            again,
            data,
            FitSettings(method="refine", samples=0, loss=loss),
            guess_z=first.posterior.z,
        )
    except ValueError:
        return "hint: change the network: no simulation of it holds with another error model either"
    series = _residuals(again, data, better, loss)
    unexplained = _unexplained(series)
    vary_k = float(np.std(np.concatenate([one.measured_c for one in series])))
    rms_k = max(better.posterior.train_rms_k.values())
    values = f"white_k = {errors.white_k:g}, slow_k = {errors.slow_k:g}, slow_s = {errors.slow_s:g}"
    if better.status == "converged" and unexplained <= _UNEXPLAINED:
        return (
            f"hint: change [errors] of the network, not the network: it explains "
            f"{1.0 - unexplained:.1%} of the temperatures' variance, and with [errors] {values} "
            f"the fit passes with {rms_k:.2g} K rms"
        )
    return (
        f"hint: change the network or its priors, not its [errors]: with those that a plain "
        f"least-squares fit suggests ({values}) it meets temperatures that vary by {vary_k:.2g} K "
        f"with {rms_k:.2g} K rms"
    )


def suggested_errors(series: Sequence[SensorResiduals], present: ErrorModel) -> ErrorModel:
    """Error model of residuals, by their variogram at one and two rows' distance.

    The present offset is kept; figures have two digits.
    """
    parts = [one for one in series if one.error_k.size >= 3]
    if not parts:
        return present
    errors = [one.error_k for one in parts]
    variance = float(np.mean(np.concatenate(errors) ** 2))
    near, far = (
        0.5 * float(np.mean(np.concatenate([(one[lag:] - one[:-lag]) ** 2 for one in errors])))
        for lag in (1, 2)
    )
    step_s = float(np.median(np.concatenate([np.diff(one.time_s) for one in parts])))
    # The variogram white^2 + slow^2 (1 - exp(-dt / slow_s)), taken back to no distance at all.
    white = min(max(2.0 * near - far, 0.0), near, variance)
    slow = max(variance - white, 0.0)
    kept = 1.0 - (near - white) / slow if slow > 0.0 else 0.0
    slow_s = -step_s / float(np.log(kept)) if 0.0 < kept < 1.0 else step_s
    return replace(
        present,
        white_k=_rounded(max(np.sqrt(white), _LEAST_K)),
        slow_k=_rounded(max(np.sqrt(slow), _LEAST_K)),
        slow_s=_rounded(min(max(slow_s, step_s), _LONGEST_S)),
    )


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


def _residuals(
    model: ThermalModel, data: IdentificationData, found: IdentificationResult, loss: Loss
) -> list[SensorResiduals]:
    errors = IdentificationProblem(model, data, loss=loss).errors_c(found.unknowns)
    series = []
    for window, by_sensor in zip(data.windows, errors, strict=True):
        rows = window.minutes.take(window.minutes.good)
        for name, error_k in by_sensor.items():
            known = np.isfinite(rows.temperatures_c[name])
            series.append(
                SensorResiduals(rows.time_s[known], error_k, rows.temperatures_c[name][known])
            )
    return series


def _unexplained(series: Sequence[SensorResiduals]) -> float:
    """Part of the readings' variance about their mean that is left in the errors."""
    error_k = np.concatenate([one.error_k for one in series])
    measured_c = np.concatenate([one.measured_c for one in series])
    return float(np.mean(error_k**2) / max(float(np.var(measured_c)), 1e-12))
