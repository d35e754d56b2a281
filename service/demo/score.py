"""How good the forecasts were: predicted before a stage against measured in it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from service.clock import from_rfc3339, rfc3339
from service.documents.forecasts import LiveForecast
from service.domain.channels import RING_SENSORS

SENSORS = RING_SENSORS
NAIVE = ("persistence", "linear", "arx")


class NaiveErrors(BaseModel):
    """What the demo reads of the errors of a simple forecast."""

    mae_k: float | None


class RiskScore(BaseModel):
    """What the demo reads of an item of ``GET /assets/{id}/forecast-performance``."""

    risk: str
    n: int
    set_aside: int
    coverage_95: float | None
    mae_k: float | None
    naive: Mapping[str, NaiveErrors]


class Performance(BaseModel):
    """What the demo reads of ``GET /assets/{id}/forecast-performance``."""

    items: Sequence[RiskScore]


@dataclass(frozen=True, slots=True)
class ScoredForecast:
    """The part of a live forecast that is scored later.

    ``time_us``: (n,) process times of its rows; ``quantiles``: (3, n) 2.5 %, 50 % and 97.5 %
    quantile by sensor.
    """

    made_at_us: int
    model_version: int
    time_us: NDArray[np.float64]
    quantiles: Mapping[str, NDArray[np.float64]]

    @classmethod
    def of(cls, shown: LiveForecast) -> "ScoredForecast":
        """Keep a forecast as the REST interface gives it."""
        made_at_us = from_rfc3339(shown.made_at)
        return cls(
            made_at_us,
            shown.model_version,
            made_at_us + 1e6 * np.array(shown.time_s, dtype=np.float64),
            {
                sensor: np.array([nodes.q025, nodes.q50, nodes.q975], dtype=np.float64)
                for sensor, nodes in shown.nodes.items()
                if sensor in SENSORS
            },
        )

    def moved_to(self, begin_us: int) -> "ScoredForecast":
        """Give the same forecast as if it had been made at another time."""
        return replace(self, time_us=self.time_us + (begin_us - self.made_at_us))

    def at(self, sensor: str, time_us: NDArray[np.float64]) -> NDArray[np.float64]:
        """Quantiles at given times, shape (3, m)."""
        return np.array([np.interp(time_us, self.time_us, row) for row in self.quantiles[sensor]])

    def may_pass(self, sensor: str, limit_c: float, stage: "Stage") -> bool:
        """Whether the band reaches a limit within a stage."""
        inside = (self.time_us >= stage.start_us) & (
            self.time_us <= (stage.end_us or stage.start_us)
        )
        return bool(np.any(self.quantiles[sensor][-1, inside] >= limit_c))


@dataclass(frozen=True, slots=True)
class MeasuredMinutes:
    """Minute means of one sensor during a stage, at the middle of each minute."""

    time_us: NDArray[np.float64]
    temperature_c: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of the story as it happened; ``end_us`` is None while it runs."""

    name: str
    risk: str
    speed_rpm: float
    load_n: float
    start_us: int
    end_us: int | None


def ended(stage: Stage, next_start_us: int, planned_s: float) -> Stage:
    """Give a stage its end: the planned one where the bench waited before the next stage.

    No forecast knows of the waiting: what is measured in it says nothing of any.
    """
    return replace(stage, end_us=min(next_start_us, stage.start_us + round(planned_s * 1e6)))


def made_before(
    forecasts: Sequence[ScoredForecast], stage: Stage, waited_from_us: float = math.inf
) -> ScoredForecast | None:
    """Latest forecast that was made before the stage and reaches its end.

    ``waited_from_us``: since when the bench waited with the stage. A forecast of that time takes
    the stage to begin at once: it is moved to when the stage began.
    """
    for forecast in reversed(forecasts):
        end_us = stage.end_us or stage.start_us
        if forecast.made_at_us >= stage.start_us:
            continue
        waited = forecast.made_at_us >= waited_from_us
        moved = forecast.moved_to(stage.start_us) if waited else forecast
        if moved.time_us[-1] >= end_us - 60e6:
            return moved
    return None


class WarningAccount(TypedDict):
    """When the limits of a stage were first announced, and when first reached by measurement."""

    forecast_limit_at: str | None
    measured_limit_at: str | None


class SensorAccount(TypedDict):
    """Forecast and measurement of a sensor at the end of a stage, and over the whole of it."""

    forecast_c: float | None
    q025: float | None
    q975: float | None
    measured_c: float | None
    error_c: float | None
    inside_95: bool | None
    max_error_c: float | None
    coverage_95: float | None


class StageAccount(TypedDict):
    """One stage in the demo's JSON."""

    name: str
    risk: str
    start: str
    end: str | None
    speed_rpm: float
    load_n: float
    forecast_made_at: str | None
    forecast_model_version: int | None
    sensors: dict[str, SensorAccount]
    warning: WarningAccount
    without_sisters: NotRequired[dict[str, SensorAccount]]


class WindowAccount(TypedDict):
    """What a version was identified from."""

    start: str
    end: str
    speed_rpm_max: float | None
    load_n_max: float | None


class VersionAccount(TypedDict):
    """One identified model version."""

    version: int
    identified_at: str
    activated: bool
    windows: list[WindowAccount]


class SampleAccount(TypedDict):
    """Good samples that were stored, by wire."""

    modbus: int
    can: int


class KeptAccount(TypedDict):
    """What came of the forecasts of a risk that the service kept; errors in K."""

    readings: int
    inside_95: int
    set_aside: int
    mae_k: float | None
    naive_mae_k: dict[str, float | None]


class Account(TypedDict):
    """The demo's JSON document."""

    model_versions: list[VersionAccount]
    stages: list[StageAccount]
    samples: SampleAccount
    complete: bool
    forecasts_kept: dict[str, KeptAccount]
    sisters: NotRequired[dict[str, list[StageAccount]]]


def stage_account(
    stage: Stage,
    forecast: ScoredForecast | None,
    measured: Mapping[str, MeasuredMinutes],
    warning: WarningAccount,
    alone: ScoredForecast | None = None,
) -> StageAccount:
    """One stage in the shape of the demo's JSON; without a forecast its figures are null.

    With ``alone``, a forecast without sisters, its figures stand beside them.
    """
    account: StageAccount = {
        "name": stage.name,
        "risk": stage.risk,
        "start": rfc3339(stage.start_us),
        "end": rfc3339(stage.end_us) if stage.end_us is not None else None,
        "speed_rpm": stage.speed_rpm,
        "load_n": stage.load_n,
        "forecast_made_at": rfc3339(forecast.made_at_us) if forecast else None,
        "forecast_model_version": forecast.model_version if forecast else None,
        "sensors": {
            sensor: _sensor_account(sensor, forecast, measured.get(sensor)) for sensor in SENSORS
        },
        "warning": warning,
    }
    if alone is not None:
        account["without_sisters"] = {
            sensor: _sensor_account(sensor, alone, measured.get(sensor)) for sensor in SENSORS
        }
    return account


def kept_account(performance: Performance) -> dict[str, KeptAccount]:
    """What came of the forecasts that the service kept, by risk."""
    items = performance.items
    risks = [risk for risk in ("low", "high") if any(item.risk == risk for item in items)]
    return {risk: _of_risk([item for item in items if item.risk == risk]) for risk in risks}


def _of_risk(items: Sequence[RiskScore]) -> KeptAccount:
    scored = [item for item in items if item.n]
    return {
        "readings": sum(item.n for item in scored),
        "inside_95": round(sum(item.n * (item.coverage_95 or 0.0) for item in scored)),
        "set_aside": sum(item.set_aside for item in items),
        "mae_k": _mean([(item.n, item.mae_k) for item in scored]),
        "naive_mae_k": {
            kind: _mean([(item.n, item.naive[kind].mae_k) for item in scored]) for kind in NAIVE
        },
    }


def _mean(weighted: Sequence[tuple[int, float | None]]) -> float | None:
    known = [(count, value) for count, value in weighted if value is not None]
    total = sum(count for count, _ in known)
    return round(sum(count * value for count, value in known) / total, 3) if total else None


def _sensor_account(
    sensor: str, forecast: ScoredForecast | None, measured: MeasuredMinutes | None
) -> SensorAccount:
    row: SensorAccount = {
        "forecast_c": None,
        "q025": None,
        "q975": None,
        "measured_c": None,
        "error_c": None,
        "inside_95": None,
        "max_error_c": None,
        "coverage_95": None,
    }
    if measured is None or not measured.time_us.size:
        return row
    row["measured_c"] = round(float(measured.temperature_c[-1]), 2)
    if forecast is None:
        return row
    low, median, high = forecast.at(sensor, measured.time_us)
    error = median - measured.temperature_c
    inside = (low <= measured.temperature_c) & (measured.temperature_c <= high)
    return {
        **row,
        "forecast_c": round(float(median[-1]), 2),
        "q025": round(float(low[-1]), 2),
        "q975": round(float(high[-1]), 2),
        "error_c": round(float(error[-1]), 2),
        "inside_95": bool(inside[-1]),
        "max_error_c": round(float(np.abs(error).max()), 2),
        "coverage_95": round(float(inside.mean()), 4),
    }
