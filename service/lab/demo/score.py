"""How good the forecasts were: predicted before a stage against measured in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.clock import from_rfc3339, rfc3339
from service.domain.channels import RING_SENSORS

SENSORS = RING_SENSORS
QUANTILES = ("q025", "q50", "q975")


@dataclass(frozen=True, slots=True)
class KeptForecast:
    """The part of a live forecast that is scored later.

    Attributes
    ----------
    made_at_us : int
        Process time from which it looks ahead.
    model_version : int
        The model that made it.
    time_us : ndarray, shape (n,)
        Process times of its rows.
    quantiles : mapping of str to ndarray, shape (3, n)
        2.5 %, 50 % and 97.5 % quantile by sensor.
    """

    made_at_us: int
    model_version: int
    time_us: NDArray[np.float64]
    quantiles: Mapping[str, NDArray[np.float64]]

    @classmethod
    def from_json(cls, body: Mapping[str, Any]) -> "KeptForecast":
        """Keep a forecast as the REST interface gives it."""
        made_at_us = from_rfc3339(body["made_at"])
        return cls(
            made_at_us,
            int(body["model_version"]),
            made_at_us + 1e6 * np.array(body["time_s"], dtype=np.float64),
            {
                sensor: np.array(
                    [body["nodes"][sensor][quantile] for quantile in QUANTILES], dtype=np.float64
                )
                for sensor in SENSORS
            },
        )

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
class Measured:
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


def made_before(forecasts: Sequence[KeptForecast], stage: Stage) -> KeptForecast | None:
    """Latest forecast that was made before the stage and reaches its end."""
    for forecast in reversed(forecasts):
        end_us = stage.end_us or stage.start_us
        if forecast.made_at_us < stage.start_us and forecast.time_us[-1] >= end_us - 60e6:
            return forecast
    return None


def stage_json(
    stage: Stage,
    forecast: KeptForecast | None,
    measured: Mapping[str, Measured],
    warning: Mapping[str, str | None],
) -> dict[str, Any]:
    """One stage in the shape of the demo's JSON; without a forecast its figures are null."""
    return {
        "name": stage.name,
        "risk": stage.risk,
        "start": rfc3339(stage.start_us),
        "end": rfc3339(stage.end_us) if stage.end_us is not None else None,
        "speed_rpm": stage.speed_rpm,
        "load_n": stage.load_n,
        "forecast_made_at": rfc3339(forecast.made_at_us) if forecast else None,
        "forecast_model_version": forecast.model_version if forecast else None,
        "sensors": {
            sensor: _sensor_json(sensor, forecast, measured.get(sensor)) for sensor in SENSORS
        },
        "warning": dict(warning),
    }


def _sensor_json(
    sensor: str, forecast: KeptForecast | None, measured: Measured | None
) -> dict[str, Any]:
    empty = ("forecast_c", "q025", "q975", "measured_c", "error_c", "inside_95", "max_error_c",
             "coverage_95")  # fmt: skip
    row: dict[str, Any] = dict.fromkeys(empty)
    if measured is None or not measured.time_us.size:
        return row
    row["measured_c"] = round(float(measured.temperature_c[-1]), 2)
    if forecast is None:
        return row
    low, median, high = forecast.at(sensor, measured.time_us)
    error = median - measured.temperature_c
    inside = (low <= measured.temperature_c) & (measured.temperature_c <= high)
    return row | {
        "forecast_c": round(float(median[-1]), 2),
        "q025": round(float(low[-1]), 2),
        "q975": round(float(high[-1]), 2),
        "error_c": round(float(error[-1]), 2),
        "inside_95": bool(inside[-1]),
        "max_error_c": round(float(np.abs(error).max()), 2),
        "coverage_95": round(float(inside.mean()), 4),
    }
