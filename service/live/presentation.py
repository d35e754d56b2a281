"""Forecasts, states and tags as the JSON that others rely on."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.live.ahead import Step
from service.settings import Limits
from twin_core.forecasting import Forecast

QUANTILE_NAMES = ("q025", "q25", "q50", "q75", "q975")


@dataclass(frozen=True, slots=True)
class LimitCrossing:
    """How likely and when a forecast passes a limit.

    Attributes
    ----------
    probability : float
        Share of the members that pass the limit within the horizon.
    median_s : float or None
        Seconds until half of the members have passed it; None when fewer than half do.
    earliest_s : float or None
        Seconds until 2.5 % of the members have passed it; None when fewer do.
    """

    probability: float
    median_s: float | None
    earliest_s: float | None


def limit_crossings(
    forecast: Forecast, limits: Mapping[str, Limits]
) -> dict[str, dict[str, LimitCrossing]]:
    """Crossings of every warning and alarm limit, by channel and level."""
    return {
        channel: {
            level: _crossing(forecast, channel, getattr(pair, level))
            for level in ("warning", "alarm")
        }
        for channel, pair in limits.items()
        if channel in forecast.names
    }


def _crossing(forecast: Forecast, channel: str, limit_c: float) -> LimitCrossing:
    found = forecast.exceedance(channel, limit_c)
    return LimitCrossing(found.probability, found.median_s, found.earliest_s)


def forecast_json(
    forecast: Forecast,
    limits: Mapping[str, Limits],
    crossings: Mapping[str, Mapping[str, LimitCrossing]],
    nodes: Sequence[str] | None = None,
) -> dict[str, Any]:
    """A forecast in the shape of the what-if answer, temperatures rounded to 0.01 K."""
    wanted = forecast.names if nodes is None else nodes
    return {
        "time_s": [round(float(t), 3) for t in forecast.time_s],
        "nodes": {
            name: {
                quantile: _rounded(forecast.quantiles[row, :, forecast.names.index(name)])
                for row, quantile in enumerate(QUANTILE_NAMES)
            }
            for name in wanted
        },
        "limits": {
            channel: {"warning": pair.warning, "alarm": pair.alarm}
            for channel, pair in limits.items()
        },
        "time_to_limit": {
            channel: {level: asdict(crossing) for level, crossing in levels.items()}
            for channel, levels in crossings.items()
        },
        "labels": list(forecast.labels),
        "runaway_probability": float(forecast.runaway_probability),
    }


def steps_json(steps: Sequence[Step]) -> list[dict[str, float]]:
    """The profile that a forecast follows."""
    return [asdict(step) for step in steps]


def _rounded(values: NDArray[np.float64]) -> list[float | None]:
    return [round(value, 2) if math.isfinite(value) else None for value in values.tolist()]


def tag(value: float | None, unit: str, quality: int, time: str) -> dict[str, Any]:
    """One snapshot tag; a value that is not a number is null."""
    if value is not None:
        # A scaled register is 24.7, not 24.700000000000003.
        value = round(value, 6) if math.isfinite(value) else None
    return {"value": value, "unit": unit, "quality": int(quality), "time": time}


def unit_of(name: str) -> str:
    """Unit of a channel, from its name."""
    if name.startswith("speed"):
        return "rpm"
    if name.startswith("load"):
        return "N"
    return "°C" if name.split(".")[0].endswith("_c") else ""
