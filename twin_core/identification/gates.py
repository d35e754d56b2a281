"""May a candidate model become the active one? Judged on data that its parameters have not seen.

The best fit can extrapolate worst, so a good fit is no reason to trust a candidate. What counts is
the nested test: the same procedure, fitted only to the easier part of the low-risk data, predicts
the most demanding part, and the latest part, at least as well as the active model does.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.data import IdentificationData
from twin_core.identification.identify import FitSettings, IdentificationResult, identify
from twin_core.identification.posterior import Posterior
from twin_core.identification.prediction_tests import (
    SHORTEST_TEST_S,
    PredictionTest,
    predict_rows,
    prediction_tests,
)
from twin_core.identification.priors import NormalPrior
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.whitening import Loss
from twin_core.models import ThermalModel
from twin_core.naive import naive_rms
from twin_core.operating_points import alike_points, new_points

FloatArray = NDArray[np.float64]

_LIMIT_Z = 3.8
_BETTER_K = 0.05
# Errors this near to each other are a matter of luck; what decides then is what more was learned.
_TIE_FACTOR, _TIE_K = 1.25, 0.25
# An active model that has learned from the test data itself need not be beaten on them; what it
# takes then is to have predicted most of what happened.
_SEEN_GOOD_K, _SEEN_SHARE = 1.5, 0.4
_STRUCTURE = 0.7


@dataclass(frozen=True, slots=True)
class GateCheck:
    """One condition: its name, whether it holds, why, and its figures."""

    name: str
    passed: bool
    detail: str
    values: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "name": self.name,
            "passed": self.passed,
            "detail": self.detail,
            "values": dict(self.values),
        }


@dataclass(frozen=True, slots=True)
class GateReport:
    """The verdict on a candidate."""

    accepted: bool  # whether every check passed
    reason: str  # the details of the failed checks, or what speaks for the candidate
    checks: tuple[GateCheck, ...]
    #: Rms in K: in the training data per sensor, and in each prediction test of candidate and
    #: active model.
    scores: Mapping[str, Any]
    #: Rms in K of the naive forecasts in the same tests, by test, kind and sensor.
    naive: Mapping[str, Any]

    def refused_by(self, check: GateCheck) -> "GateReport":
        """Give the verdict with a further check, which has failed."""
        failed = [one for one in self.checks if not one.passed]
        return replace(
            self,
            accepted=False,
            reason="; ".join(one.detail for one in (check, *failed)),
            checks=(*self.checks, check),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "accepted": self.accepted,
            "reason": self.reason,
            "checks": [check.to_dict() for check in self.checks],
            "scores": dict(self.scores),
            "naive": dict(self.naive),
        }


def judge(
    model: ThermalModel,
    data: IdentificationData,
    result: IdentificationResult,
    *,
    active: Posterior,
    seed: int = 0,
    loss: Loss = "linear",
    prior: NormalPrior | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> GateReport:
    """Decide whether an identification's result may become the active model.

    `active`: posterior of the active model, of the same model structure; `seed`, `loss`: for the
    nested fits; the loss is that of the candidate's own; `prior`: the candidate's, for the nested
    fits; the literature's by default. Raises `IdentificationCancelled` when ``cancelled`` says so.
    """
    active.check(model)
    checks = [_fit(result), _ranges(model, result), _structure(model, data, result, loss)]
    scores: dict[str, Any] = {"train_rms_k": dict(result.posterior.train_rms_k)}
    naive: dict[str, Any] = {}
    for test in prediction_tests(data):
        by_kind = naive_rms([window.minutes for window in test.training.windows], test.rows)
        change_k = _total(error for error in by_kind["persistence"].values() if error is not None)
        nested_z = _nested(model, test, seed, loss, prior, cancelled)
        check = _prediction(model, test, nested_z, result.posterior, active, change_k)
        checks.append(check)
        scores[test.name] = dict(check.values)
        naive[test.name] = by_kind
    failed = [check for check in checks if not check.passed]
    stated = failed or checks[3:] or checks[:1]
    return GateReport(
        accepted=not failed,
        reason="; ".join(check.detail for check in stated),
        checks=tuple(checks),
        scores=scores,
        naive=naive,
    )


def _nested(
    model: ThermalModel,
    test: PredictionTest,
    seed: int,
    loss: Loss,
    prior: NormalPrior | None,
    cancelled: Callable[[], bool] | None,
) -> FloatArray | None:
    """Coordinates (p,) fitted without the test's part; None where no simulation holds."""
    try:
        nested = identify(
            model,
            test.training,
            FitSettings(method="refine", seed=seed, samples=0, loss=loss),
            prior=prior,
            cancelled=cancelled,
        )
    except ValueError:
        return None
    return nested.posterior.z


def _prediction(
    model: ThermalModel,
    test: PredictionTest,
    nested_z: FloatArray | None,
    candidate: Posterior,
    active: Posterior,
    change_k: float,
) -> GateCheck:
    """Compare both models on one test; ``change_k`` is the rms error of persistence there."""
    known_z = [active.z, candidate.z, *([] if nested_z is None else [nested_z])]
    totals = [_total(errors.values()) for errors in predict_rows(model, known_z, test)]
    theirs, full, own = totals if nested_z is not None else (*totals, float("inf"))
    known = active.trained.points
    seen = any(alike_points(test.point, point) for point in known)
    varied = bool(new_points(known, candidate.trained.points, SHORTEST_TEST_S))
    if seen:
        passed = full <= theirs + _TIE_K and own <= max(_SEEN_GOOD_K, _SEEN_SHARE * change_k)
    else:
        passed = own <= theirs - _BETTER_K or (varied and own <= _TIE_FACTOR * theirs + _TIE_K)
    detail = (
        f"{test.name}: {test.point.speed_rpm:.0f} rpm {test.point.load_n:.0f} N predicted with "
        f"{own:.2f} K rms without having seen it, "
        f"{'active model' if active.identified else 'prior parameters'} {theirs:.2f} K"
        + (" (which has seen it)" if seen else "")
    )
    return GateCheck(
        test.name,
        passed,
        detail,
        {
            "speed_rpm": test.point.speed_rpm,
            "load_n": test.point.load_n,
            "nested_rms_k": _finite(own),
            "active_rms_k": _finite(theirs),
            "candidate_rms_k": _finite(full),
            "active_has_seen_it": seen,
        },
    )


def _total(errors: Iterable[float]) -> float:
    squares = [error**2 for error in errors]
    return float(np.sqrt(np.mean(squares))) if squares else float("inf")


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _fit(result: IdentificationResult) -> GateCheck:
    return GateCheck(
        "fit",
        result.status == "converged",
        f"fit: {result.reason}",
        {
            "train_rms_k": dict(result.posterior.train_rms_k),
            "cost_per_residual": result.posterior.cost_per_residual,
        },
    )


def _ranges(model: ThermalModel, result: IdentificationResult) -> GateCheck:
    extreme = {
        name: float(z)
        for name, z in zip(model.parameters.names, result.posterior.z, strict=True)
        if abs(z) > _LIMIT_Z
    }
    detail = "ranges: every parameter lies within its physical range"
    if extreme:
        detail = f"ranges: {', '.join(extreme)} at the edge of the physical range"
    return GateCheck("ranges", not extreme, detail, {"at_the_edge": extreme})


def _structure(
    model: ThermalModel, data: IdentificationData, result: IdentificationResult, loss: Loss
) -> GateCheck:
    """Lag-1 autocorrelation of the whitened residuals; wrong only where they are large as well."""
    problem = IdentificationProblem(model, data, loss=loss)
    unknowns = result.unknowns
    if unknowns.size != problem.unknown_count:
        raise ValueError("the result belongs to other data than those given")
    series: dict[str, list[FloatArray]] = {}
    for by_sensor in problem.whitened(unknowns):
        for name, values in by_sensor.items():
            series.setdefault(name, []).append(values)
    lag = {name: _autocorrelation(parts) for name, parts in series.items()}
    size = {name: float(np.mean(np.concatenate(parts) ** 2)) for name, parts in series.items()}
    wrong = [name for name in lag if lag[name] > _STRUCTURE and size[name] > 1.0]
    detail = "residuals: no structure beyond what the error model allows for"
    if wrong:
        detail = f"residuals: {', '.join(wrong)} deviates systematically from the fit"
    return GateCheck(
        "residuals", not wrong, detail, {"lag_1_autocorrelation": lag, "mean_square": size}
    )


def _autocorrelation(parts: Sequence[FloatArray]) -> float:
    products = sum(float(values[1:] @ values[:-1]) for values in parts)
    squares = sum(float(values @ values) for values in parts)
    return float(products / squares) if squares > 0.0 else 0.0
