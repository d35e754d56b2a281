"""Identification from a file of recorded data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import get_args

import numpy as np

from service.documents.models import IdentifiabilityDocument, Interval, ParameterDocument
from service.domain.errors import BearingTwinError
from service.jobs.unit_gate import UNITS, unless_in_another_unit
from service.offline.error_hint import hint
from service.offline.model_file import IdentifiedModel, RunIn
from service.offline.rows import contiguous, revolutions_at, rows_of_recording, step_of
from service.offline.searches import OTHER_SEARCHES
from service.offline.tables import Recording
from service.offline.unit_doubts import doubts_of_recording
from service.site.machines.machine import Machine
from twin_core.identification import (
    FitSettings,
    IdentificationData,
    IdentificationProgress,
    IdentificationWindow,
    identify,
    prior_posterior,
)
from twin_core.identification.gates import GateReport, judge
from twin_core.identification.identify import Method
from twin_core.identification.paper_view import paper_view
from twin_core.identification.searching import Search
from twin_core.identification.whitening import Loss
from twin_core.naive import NAIVE_KINDS, fit_naive
from twin_core.reduced_paper import REDUCED_NAME
from twin_core.simulation import OperatingProfile
from twin_core.sisters import (
    Sister,
    SisterVerdict,
    WithSisters,
    identify_with_sisters,
    law_documents,
    part_of,
)
from twin_core.windows import MinuteData, is_at_rest

_FEWEST_ROWS = 3
_LEAST_BUDGET = 25
_COLD_K = 3.0
# Share of the progress in which a machine is identified without its sisters.
_WITHOUT_SISTERS = 0.4
# A naive forecast must be better by more than this before it is spoken of.
_TIE_K = 0.25


class UnusableDataError(BearingTwinError, ValueError):
    """Data or options that nothing can be identified with; one line for the user."""


class FailedFitError(BearingTwinError):
    """The model does not follow the data, so it must not forecast; one line for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What was identified and how well it meets the data.

    - ``rms_k``, ``rms_by_sensor_k``: error in the data, over all sensors and of each; a robust loss
      gives outliers less weight.
    - ``naive_k``: error of the naive forecasts over the same rows, each made at the beginning of a
      window, by kind and sensor; None where a sensor has no reading.
    - ``windows``, ``rows``: how many contiguous spans and rows were used.
    - ``gates``: what would be asked of it before it may forecast in the service, with the prior's
      parameters in place of an active model: fit, ranges, residuals, predictions of what a fit had
      not seen.
    - ``doubts``: what of the recording may be in another unit.
    - ``sisters``: what became of the sisters; None without any.
    """

    model: IdentifiedModel
    method: str
    rms_k: float
    rms_by_sensor_k: dict[str, float]
    naive_k: dict[str, dict[str, float | None]]
    evaluations: int
    windows: int
    rows: int
    gates: GateReport
    doubts: tuple[str, ...] = ()
    sisters: SisterVerdict | None = None

    @property
    def warnings(self) -> list[str]:
        """What to look at before the model is relied upon, one line each."""
        found = list(self.doubts)
        found += [
            f"{name} = {row.value:.4g} {row.unit} is on its {row.at_bound} bound: the "
            "bound gives this value, the data would have it further out; unless the bound is a "
            "physical one, widen it or change the network"
            for name, row in self.parameters.items()
            if row.at_bound
        ]
        if self.sisters is not None:
            found += [
                f"not a sister: {name}: {why}" for name, why in self.sisters.set_aside.items()
            ]
            if not self.sisters.accepted:
                found.append(f"sisters not used: {self.sisters.reason}")
        found += [
            f"gate not passed: {check.detail}"
            for check in self.gates.checks
            if not check.passed and check.name != UNITS  # said first
        ]
        for test, by_kind in self.gates.naive.items():
            own = self.gates.scores[test]["nested_rms_k"]
            kind, best = _best_naive(by_kind)
            if best is not None and (own is None or own > best + _TIE_K):
                shown = "failed" if own is None else f"{own:.2f} K rms"
                found.append(
                    f"{test}: the naive forecast {kind.replace('_', ' ')} is better, {best:.2f} K "
                    f"rms; the model, without having seen it: {shown}"
                )
        return found

    @property
    def parameters(self) -> dict[str, ParameterDocument]:
        """Every parameter with its interval."""
        rows = self.model.posterior.parameters(self.model.model)
        return {name: ParameterDocument.model_validate(row) for name, row in rows.items()}

    @property
    def identifiability(self) -> IdentifiabilityDocument:
        """Rank, condition and combinations of parameters."""
        document = self.model.posterior.identifiability_document(self.model.model)
        return IdentifiabilityDocument.model_validate(document)

    @property
    def paper_view(self) -> dict[str, Interval]:
        """The paper's 15 numbers with intervals; of the model ``paper-reduced`` only, else none."""
        view = paper_view(self.model.model, self.model.posterior) or {}
        return {name: Interval.model_validate(one) for name, one in view.items()}

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON types as the command line prints them."""
        model, posterior = self.model.model, self.model.posterior
        view = paper_view(model, posterior)
        return {
            "model": model.name,
            "method": self.method,
            "bearing": model.machine,
            "parameters": posterior.parameters(model),
            "rms_error_k": self.rms_k,
            "rms_error_by_sensor_k": self.rms_by_sensor_k,
            "evaluations": self.evaluations,
            "rank": posterior.rank,
            "condition": posterior.condition,
            "informed_combinations": posterior.informed_combinations,
            "identifiability": posterior.identifiability_document(model),
            "naive": self.naive_k,
            "windows": self.windows,
            "rows": self.rows,
            "gates": self.gates.to_dict(),
            "warnings": self.warnings,
            "sisters": None if self.sisters is None else self.sisters.to_dict(),
            "laws": law_documents(model, posterior, self.sisters),
        } | ({} if view is None else {"paper_view": view})


@dataclass(frozen=True, slots=True)
class Procedure:
    """How to identify.

    - ``method``: which parts: a search, a refinement, or both.
    - ``search``: the global search in NOA's place; None for NOA.
    - ``budget``: evaluations of the search; None for the usual.
    - ``loss``: of the measurements; a robust one keeps outliers from bending the fit.
    """

    name: str
    method: Method
    search: Search | None
    budget: int | None
    loss: Loss = "linear"


REFINED = "+refine"
METHOD_NAMES: tuple[str, ...] = (
    *get_args(Method),
    *(name + refined for name in OTHER_SEARCHES for refined in ("", REFINED)),
)


def check_options(method: str, budget: int | None, seed: int, loss: str = "linear") -> Procedure:
    """Return how to identify, or complain.

    Raises `UnusableDataError` for an unknown method or loss, a method whose library is not
    installed, too small a budget or a negative seed.
    """
    if seed < 0:
        raise UnusableDataError(f"--seed {seed}: expected 0 or more")
    if method not in METHOD_NAMES:
        raise UnusableDataError(f"--method {method!r}: expected one of {', '.join(METHOD_NAMES)}")
    if budget is not None and budget < _LEAST_BUDGET:
        raise UnusableDataError(f"--budget {budget}: expected at least {_LEAST_BUDGET}")
    robust: Loss | None = next((known for known in get_args(Loss) if known == loss), None)
    if robust is None:
        raise UnusableDataError(f"--loss {loss!r}: expected one of {', '.join(get_args(Loss))}")
    for known in get_args(Method):
        if known == method:
            return Procedure(method, known, None, budget, robust)
    search, module = OTHER_SEARCHES[method.removesuffix(REFINED)]
    if module is not None and find_spec(module) is None:
        raise UnusableDataError(
            f"--method {method!r}: {module} is not installed: pip install 'bearing-twin[bench]'"
        )
    parts: Method = "noa+refine" if method.endswith(REFINED) else "noa"
    return Procedure(method, parts, search, budget, robust)


NOA_REFINE = Procedure("noa+refine", "noa+refine", None, None)


def identify_recording(
    recording: Recording,
    *,
    machine: Machine,
    procedure: Procedure = NOA_REFINE,
    seed: int = 0,
    at_rest: bool = False,
    family: str = "",
    sisters_of: Callable[[IdentificationData], Sequence[Sister]] | None = None,
    progress: Callable[[IdentificationProgress], None] | None = None,
) -> Identified:
    """Identify a model from all rows of a recording.

    Raises `UnusableDataError` if the data hold too little, or contradict ``at_rest``; `TableError`
    if they are in another unit; `FailedFitError` if the model does not follow the data.

    - ``recording``: low-risk data.
    - ``at_rest``: the machine stood at ambient at the first row. Then a window after a gap that
      shows a standing machine at ambient counts as such a start as well; otherwise every initial
      state is estimated.
    - ``sisters_of``: gives the machine's sisters, by its own rows; none by default.
    - ``progress``: called at every sweep and iteration.
    """
    doubts = doubts_of_recording(recording, machine)
    model = machine.build()
    minutes = rows_of_recording(recording, step_of(recording, machine, model))
    data = data_set(recording, minutes, at_rest)
    sisters = None if sisters_of is None else sisters_of(data)
    try:
        result = identify(
            model,
            data,
            FitSettings(
                method=procedure.method,
                budget=procedure.budget,
                search=procedure.search,
                loss=procedure.loss,
                seed=seed,
            ),
            progress=progress if sisters is None else part_of(progress, 0.0, _WITHOUT_SISTERS),
        )
    except ValueError as error:
        # All input has been checked: what is left is that no simulation holds on these data.
        raise FailedFitError(f"{recording.name}: {error}") from error
    if result.status != "converged":
        more = f"; see --model {REDUCED_NAME}" if model.name == "paper" else ""
        if machine.network is not None:
            more = f"; {hint(model, data, result, procedure.loss)}"
        raise FailedFitError(f"{recording.name}: failed fit: {result.reason}{more}")
    own = replace(result.posterior, samples=np.empty((0, result.posterior.z.size)))
    learned: WithSisters | None = None
    if sisters is not None:
        learned = identify_with_sisters(
            model,
            data,
            sisters,
            result,
            FitSettings(seed=seed, loss=procedure.loss),
            progress=part_of(progress, _WITHOUT_SISTERS, 1.0),
        )
        result = learned.result
    report = judge(
        model,
        data,
        result,
        active=prior_posterior(model),
        seed=seed,
        loss=procedure.loss,
        prior=None if learned is None else learned.prior,
    )
    report = unless_in_another_unit(report, machine.bearing, data)
    rms_by_sensor = dict(result.posterior.train_rms_k)
    return Identified(
        model=IdentifiedModel(
            machine,
            model,
            result.posterior,
            RunIn.of(recording, minutes, at_rest),
            family,
            data,
            None if result.posterior.sisters is None else own,
        ),
        method=procedure.name,
        rms_k=_total_rms(data, rms_by_sensor),
        rms_by_sensor_k=rms_by_sensor,
        naive_k=_naive_rms([window.minutes for window in data.windows]),
        evaluations=result.evaluations,
        windows=len(data.windows),
        rows=sum(window.minutes.size for window in data.windows),
        gates=report,
        doubts=tuple(doubts),
        sisters=None if learned is None else learned.verdict,
    )


def data_set(recording: Recording, minutes: MinuteData, at_rest: bool) -> IdentificationData:
    """Windows of at least three rows with a temperature; shorter ones can teach nothing.

    Raises `UnusableDataError` if there is none, or the first row contradicts ``at_rest``.
    """
    sensors = [name for name, values in minutes.temperatures_c.items() if np.isfinite(values).any()]
    if not minutes.good.any() or not sensors:
        what = "temperature" if minutes.good.any() else "speed_rpm, load_n and ambient_c"
        raise UnusableDataError(f"{recording.name}: no row with {what}; expected at least 3")
    if at_rest:
        _check_rest(recording, minutes)
    spans = contiguous(minutes)
    good = minutes.take(minutes.good)
    revolutions = revolutions_at(minutes)
    windows = []
    for number, span in enumerate(spans):
        span = _with_sensors(span, sensors)
        known = np.any([np.isfinite(values) for values in span.temperatures_c.values()], axis=0)
        if int(np.count_nonzero(known)) < _FEWEST_ROWS:
            continue
        first = int(np.searchsorted(good.time_s, span.time_s[0]))
        windows.append(
            IdentificationWindow(
                span,
                at_rest=at_rest and (number == 0 or is_at_rest(span)),
                revolutions=float(revolutions[first]),
            )
        )
    if not windows:
        raise UnusableDataError(
            f"{recording.name}: {good.size} rows with an operating point, but no 3 of them with a "
            "temperature within one contiguous span; expected at least 3"
        )
    return IdentificationData(tuple(windows))


def _with_sensors(span: MinuteData, sensors: list[str]) -> MinuteData:
    return MinuteData(
        span.time_s,
        span.speed_rpm,
        span.load_n,
        span.ambient_c,
        {name: span.temperatures_c[name] for name in sensors},
        span.good,
        span.inputs,
    )


def _check_rest(recording: Recording, minutes: MinuteData) -> None:
    good = minutes.take(minutes.good)
    for name, values in good.temperatures_c.items():
        excess_k = float(values[0] - good.ambient_c[0])
        if abs(excess_k) > _COLD_K:
            raise UnusableDataError(
                f"{recording.name}: {name} = {values[0]:.1f} at the first row, with ambient_c = "
                f"{good.ambient_c[0]:.1f}: expected a machine at ambient temperature with --at-rest"
            )


def _total_rms(data: IdentificationData, rms_by_sensor: Mapping[str, float]) -> float:
    """Over all sensors, each by the number of its readings."""
    squares, count = 0.0, 0
    for name, rms_k in rms_by_sensor.items():
        readings = [
            window.minutes.temperatures_c[name][window.minutes.good] for window in data.windows
        ]
        known = int(sum(np.count_nonzero(np.isfinite(values)) for values in readings))
        squares += known * rms_k**2
        count += known
    return float(np.sqrt(squares / count))


def _best_naive(
    by_kind: Mapping[str, Mapping[str, float | None]],
) -> tuple[str, float | None]:
    """Kind and rms, over all sensors, of the naive forecast that is best at a test."""
    errors = {}
    for kind, by_sensor in by_kind.items():
        known = [rms_k for rms_k in by_sensor.values() if rms_k is not None]
        if known:
            errors[kind] = float(np.sqrt(np.mean(np.square(known))))
    if not errors:
        return "", None
    best = min(errors, key=lambda kind: errors[kind])
    return best, errors[best]


def _naive_rms(windows: list[MinuteData]) -> dict[str, dict[str, float | None]]:
    models = fit_naive(windows)
    squares: dict[str, dict[str, list[float]]] = {
        kind: {name: [] for name in windows[0].sensors} for kind in NAIVE_KINDS
    }
    for rows in windows:
        profile = OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)
        first = {
            name: float(next(iter(values[np.isfinite(values)]), np.nan))
            for name, values in rows.temperatures_c.items()
        }
        for kind, by_sensor in models.forecast(profile, first).items():
            for name, forecast_c in by_sensor.items():
                error = forecast_c - rows.temperatures_c[name]
                squares[kind][name].extend((error[np.isfinite(error)] ** 2).tolist())
    return {
        kind: {
            name: float(np.sqrt(np.mean(found))) if found else None
            for name, found in by_sensor.items()
        }
        for kind, by_sensor in squares.items()
    }
