"""May a candidate model become the active one? Judged on data that its parameters have not seen.

The best fit can extrapolate worst, so a good fit is no reason to trust a candidate. What counts is
the nested test: the same procedure, fitted only to the easier part of the low-risk data, predicts
the most demanding part, and the latest part, at least as well as the active model does.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.naive import naive_rms
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import IdentificationResult, identify
from twin_core.identification.posterior import Posterior
from twin_core.identification.problem import (
    IdentificationProblem,
    first_measurements,
    profile_of,
)
from twin_core.identification.whitening import Loss
from twin_core.models import ThermalModel
from twin_core.observer import Observer, initial_state
from twin_core.operating_points import OperatingPoint, alike_points, demand, new_points
from twin_core.scores import rms
from twin_core.simulation import SimulationError, simulate
from twin_core.windows import MinuteData, window_of

FloatArray = NDArray[np.float64]

_LIMIT_Z = 3.8
_BETTER_K = 0.05
# Errors this near to each other are a matter of luck; what decides then is what more was learned.
_TIE_FACTOR, _TIE_K = 1.25, 0.25
# An active model that has learned from the test data itself need not be beaten on them; what it
# takes then is to have predicted most of what happened.
_SEEN_GOOD_K, _SEEN_SHARE = 1.5, 0.4
_SHORTEST_TEST_S = 1200.0
_FEWEST_ROWS = 20
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
    """The verdict on a candidate.

    Attributes
    ----------
    accepted
        Whether every check passed.
    reason
        The details of the failed checks, or what speaks for the candidate.
    checks
        All checks.
    scores
        Rms in K: in the training data per sensor, and in each prediction test of candidate and
        active model.
    naive
        Rms in K of the naive forecasts in the same tests, by test, kind and sensor.
    """

    accepted: bool
    reason: str
    checks: tuple[GateCheck, ...]
    scores: Mapping[str, Any]
    naive: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "accepted": self.accepted,
            "reason": self.reason,
            "checks": [check.to_dict() for check in self.checks],
            "scores": dict(self.scores),
            "naive": dict(self.naive),
        }


@dataclass(frozen=True, slots=True, eq=False)
class PredictionTest:
    """A part of the data to predict, and what may be learned from for it.

    Attributes
    ----------
    name
        ``"extrapolation"`` or ``"latest"``.
    training
        The data without that part and without anything as demanding as it.
    window
        The window that holds it.
    first, last
        First and last of its rows among the window's good rows.
    point
        Its operating point.
    """

    name: str
    training: IdentificationData
    window: IdentificationWindow
    first: int
    last: int
    point: OperatingPoint

    @property
    def rows(self) -> MinuteData:
        """The rows to predict; the first is where the prediction starts."""
        good = self.window.minutes.take(self.window.minutes.good)
        return good.take(slice(self.first, self.last + 1))


def judge(
    model: ThermalModel,
    data: IdentificationData,
    result: IdentificationResult,
    *,
    active: Posterior,
    seed: int = 0,
    loss: Loss = "linear",
    cancelled: Callable[[], bool] | None = None,
) -> GateReport:
    """Decide whether an identification's result may become the active model.

    Parameters
    ----------
    model, data, result
        The candidate and what it was identified from.
    active
        Posterior of the active model, of the same model structure.
    seed, loss
        For the nested fits; the loss is that of the candidate's own.
    cancelled
        Asked during the nested fits.

    Raises
    ------
    IdentificationCancelled
        When ``cancelled`` says so.
    """
    active.check(model)
    checks = [_fit(result), _ranges(model, result), _structure(model, data, result, loss)]
    scores: dict[str, Any] = {"train_rms_k": dict(result.posterior.train_rms_k)}
    naive: dict[str, Any] = {}
    for test in prediction_tests(data):
        by_kind = naive_rms([window.minutes for window in test.training.windows], test.rows)
        change_k = _total(error for error in by_kind["persistence"].values() if error is not None)
        nested_z = _nested(model, test, seed, loss, cancelled)
        check = _prediction(model, test, nested_z, result.posterior, active, change_k)
        checks.append(check)
        scores[test.name] = dict(check.values)
        naive[test.name] = by_kind
    failed = [check for check in checks if not check.passed]
    telling = failed or checks[3:] or checks[:1]
    return GateReport(
        accepted=not failed,
        reason="; ".join(check.detail for check in telling),
        checks=tuple(checks),
        scores=scores,
        naive=naive,
    )


def prediction_tests(data: IdentificationData) -> list[PredictionTest]:
    """Choose what to predict: the most demanding operating point and the latest one.

    With a single lasting operating point the last third of its rows is the only test; where the
    duty varies, the last third of the last window. Otherwise there is none.
    """
    lasting = [
        (number, point)
        for number, window in enumerate(data.windows)
        for point in window_of(window.minutes).operating_points
        if point.duration_s >= _SHORTEST_TEST_S
    ]
    if not lasting:
        return _of_varying_duty(data)
    hard_number, hardest = max(lasting, key=lambda found: demand(found[1]))
    tests = [
        _test(
            "extrapolation", data, hard_number, hardest, lambda point: not _as_hard(point, hardest)
        )
    ]
    number, latest = lasting[-1]
    if tests[0] is None or (number, latest.start_s) != (hard_number, hardest.start_s):
        tests.append(_test("latest", data, number, latest, lambda _: True))
    found = [test for test in tests if test is not None]
    if found:
        return found
    start_s = latest.start_s + 2.0 / 3.0 * latest.duration_s
    third = OperatingPoint(latest.speed_rpm, latest.load_n, latest.end_s - start_s, start_s)
    test = _test("latest", data, number, third, lambda _: True)
    return [test] if test is not None else []


def _of_varying_duty(data: IdentificationData) -> list[PredictionTest]:
    for number, window in reversed(list(enumerate(data.windows))):
        found = window_of(window.minutes)
        if not found.duty:
            continue
        start_s = found.start_s + 2.0 / 3.0 * found.duration_s
        rows = window.minutes.take(window.minutes.good & (window.minutes.time_s >= start_s))
        third = OperatingPoint(
            float(np.mean(np.abs(rows.speed_rpm))),
            float(np.mean(rows.load_n)),
            found.end_s - start_s,
            start_s,
        )
        test = _test("latest", data, number, third, lambda _: True)
        return [] if test is None else [test]
    return []


def _as_hard(point: OperatingPoint, hardest: OperatingPoint) -> bool:
    return demand(point) > 0.95 * demand(hardest)


def _test(
    name: str,
    data: IdentificationData,
    number: int,
    point: OperatingPoint,
    usable: Callable[[OperatingPoint], bool],
) -> PredictionTest | None:
    """Set up one test; None when too little is left to learn from."""
    windows: list[IdentificationWindow] = []
    for index, window in enumerate(data.windows):
        end_s = np.inf
        if index == number:
            end_s = point.start_s
        elif index > number and name == "latest":
            continue
        for other in window_of(window.minutes).operating_points:
            if not usable(other):
                end_s = min(end_s, other.start_s)
        rows = window.minutes.take(window.minutes.time_s < end_s)
        if int(rows.good.sum()) >= _FEWEST_ROWS:
            windows.append(IdentificationWindow(rows, window.at_rest, window.revolutions))
    if not windows:
        return None
    window = data.windows[number]
    time_s = window.minutes.time_s[window.minutes.good]
    # The prediction starts with the row at which the machine is still at the point before.
    first = max(int(np.searchsorted(time_s, point.start_s)) - 1, 0)
    last = int(np.searchsorted(time_s, point.end_s, side="left")) - 1
    if last - first < 3:
        return None
    return PredictionTest(name, IdentificationData(tuple(windows)), window, first, last, point)


def predict_rows(model: ThermalModel, z: FloatArray, test: PredictionTest) -> dict[str, float]:
    """Rms error in K per sensor of a prediction over a test's rows, started like a live forecast.

    The observer follows the window's measurements up to the first row; from there on the model
    runs alone. Infinite where it runs away.
    """
    values = model.parameters.values_from_z(z)
    window = test.window
    rows = window.minutes.take(window.minutes.good)
    profile = profile_of(window.minutes)
    try:
        mean, covariance = initial_state(
            model,
            values,
            dict(first_measurements(window.minutes)),
            float(profile.ambient_c[0]),
            float(profile.speed_rpm[0]),
            float(profile.load_n[0]),
            window.at_rest,
            inputs=profile.inputs[0],
        )
        observer = Observer(model, values, mean, covariance, window.revolutions)
        for row in range(test.first):
            observer.predict(
                float(profile.time_s[row + 1] - profile.time_s[row]),
                float(profile.speed_rpm[row]),
                float(profile.load_n[row]),
                float(profile.ambient_c[row]),
                profile.inputs[row],
            )
            observer.update(_known(rows, row + 1))
        chosen = slice(test.first, test.last + 1)
        ahead = simulate(
            model,
            values,
            profile.rows(chosen),
            observer.temperatures_c,
            observer.revolutions,
        )
    except SimulationError:
        return dict.fromkeys(rows.sensors, float("inf"))
    errors = {
        name: rms(ahead.temperatures_c @ model.sensor_row(name), values_c[chosen])
        for name, values_c in rows.temperatures_c.items()
    }
    return {name: error for name, error in errors.items() if not np.isnan(error)}


def _known(rows: MinuteData, row: int) -> dict[str, float]:
    readings = {name: float(values[row]) for name, values in rows.temperatures_c.items()}
    return {name: value for name, value in readings.items() if np.isfinite(value)}


def _nested(
    model: ThermalModel,
    test: PredictionTest,
    seed: int,
    loss: Loss,
    cancelled: Callable[[], bool] | None,
) -> FloatArray | None:
    """Coordinates (p,) fitted without the test's part; None where no simulation holds."""
    try:
        nested = identify(
            model,
            test.training,
            method="refine",
            seed=seed,
            samples=0,
            loss=loss,
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
    own = float("inf")
    if nested_z is not None:
        own = _total(predict_rows(model, nested_z, test).values())
    theirs = _total(predict_rows(model, active.z, test).values())
    full = _total(predict_rows(model, candidate.z, test).values())
    known = active.trained.points
    seen = any(alike_points(test.point, point) for point in known)
    varied = bool(new_points(known, candidate.trained.points, _SHORTEST_TEST_S))
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
