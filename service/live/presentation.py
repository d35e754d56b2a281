"""Forecasts, states and tags as the JSON that others rely on."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from adapters.samples import Quality, Sample
from service.clock import rfc3339, rfc3339_exact
from service.documents.alarms import alarm_summary
from service.live.ahead import Step
from service.live.estimate import LiveEstimate
from service.site.settings import Limits
from service.store import Alarm
from twin_core.forecasting import Forecast

KNOWN_WITHIN_K = 8.0
"""A node is known where half its 95 % interval is within a tenth of the scale of 20 to 100 °C."""
_HALF_WIDTH = 1.959964

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
    """Crossings of every warning and alarm limit of a sensor, by channel and level.

    A node has none: a forecast keeps the members' paths of the sensors alone.
    """
    return {
        channel: {
            level: _crossing(forecast, channel, getattr(pair, level))
            for level in ("warning", "alarm")
        }
        for channel, pair in limits.items()
        if channel in forecast.sensors
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
    rows = [forecast.names.index(name) for name in wanted]
    # By name, quantile and time.
    rounded = np.round(forecast.quantiles[:, :, rows].transpose(2, 0, 1), 2)
    values = rounded.tolist()
    if not np.isfinite(rounded).all():
        values = [
            [[one if math.isfinite(one) else None for one in series] for series in of_name]
            for of_name in values
        ]
    return {
        "time_s": [round(float(t), 3) for t in forecast.time_s],
        "nodes": {
            name: dict(zip(QUANTILE_NAMES, of_name, strict=True))
            for name, of_name in zip(wanted, values, strict=True)
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


def estimate_tags(
    estimate: LiveEstimate, began: str, blind: bool = False
) -> dict[str, dict[str, Any]]:
    """Tags ``<name>.twin`` of all sensors and nodes.

    Parameters
    ----------
    estimate : LiveEstimate
        The twin.
    began : str
        Dates them before the first estimate.
    blind : bool
        Whether the twin does not know the operation: its values are then uncertain.
    """
    model = estimate.active.model
    names = [*model.sensor_names, *model.node_names]
    if not estimate.started:
        waiting = Quality.WAITING_FOR_INITIAL_DATA
        return {f"{name}.twin": tag(None, "°C", waiting, began) for name in names}
    temperatures = estimate.temperatures_c
    made = rfc3339(estimate.time_us or 0)
    quality = Quality.LAST_USABLE if blind else Quality.GOOD
    return {
        f"{name}.twin": tag(
            round(float(model.sensor_row(name) @ temperatures), 3), "°C", quality, made
        )
        for name in names
    }


def forecast_tags(
    limits: Mapping[str, Limits],
    forecast: Mapping[str, Any] | None,
    crossings: Mapping[str, Mapping[str, LimitCrossing]],
    began: str,
    blind: bool = False,
) -> dict[str, dict[str, Any]]:
    """Tags of the forecast's maximum and the times to the limits, for every limited channel.

    While the twin does not know the operation (``blind``) they have no value: quality "last
    known".
    """
    tags: dict[str, dict[str, Any]] = {}
    good = Quality.LAST_KNOWN if blind else Quality.GOOD
    for channel in limits:
        maximum, made = None, began
        if forecast is not None and channel in forecast["nodes"]:
            made = forecast["made_at"]
            medians = forecast["nodes"][channel]["q50"]
            maximum = max((value for value in medians if value is not None), default=None)
        waiting = Quality.WAITING_FOR_INITIAL_DATA
        tags[f"{channel}.forecast_max"] = tag(
            None if blind else maximum, "°C", waiting if maximum is None else good, made
        )
        levels = crossings.get(channel, {})
        for level in ("warning", "alarm"):
            # No time and a good quality: the limit is not passed within the horizon.
            known = level in levels
            tags[f"{channel}.time_to_{level}_s"] = tag(
                levels[level].median_s if known and not blind else None,
                "s",
                good if known else waiting,
                made,
            )
    return tags


def alarm_tags(alarms: Sequence[Alarm], changed: str) -> dict[str, dict[str, Any]]:
    """Tags that count the alarms that are not over; ``changed`` is when one last changed.

    What is shelved, suppressed or out of service is neither active nor unacknowledged. Highest
    priority: 1 to 3, or 0 when no alarm is active or waits for an operator.
    """
    summary = alarm_summary(alarms)
    counts = {
        "active": summary.active,
        "unacknowledged": summary.unacknowledged,
        "shelved": summary.shelved,
        "highest_priority": summary.highest_priority,
    }
    return {
        f"alarms.{name}": tag(count, "", Quality.GOOD, changed) for name, count in counts.items()
    }


def state_json(estimate: LiveEstimate, now_us: int) -> dict[str, Any]:
    """Mean and standard deviation of the node temperatures, null before the first data."""
    active = estimate.active
    nodes: dict[str, dict[str, float | bool | None]] = {
        name: {"mean_c": None, "std_c": None, "known": False} for name in active.model.node_names
    }
    time_us = now_us
    if estimate.started:
        observer, time_us = estimate.observer, estimate.time_us or now_us
        for name, mean, std in zip(nodes, estimate.temperatures_c, observer.std_c, strict=True):
            known = bool(_HALF_WIDTH * std <= KNOWN_WITHIN_K)
            nodes[name] = {
                "mean_c": round(float(mean), 3),
                "std_c": round(float(std), 3),
                "known": known,
            }
    return {
        # As the samples of the same estimate, which are stored.
        "time": rfc3339_exact(time_us),
        "model_version": active.version,
        "revolutions": round(estimate.revolutions),
        "nodes": nodes,
    }


def samples_json(samples: Iterable[Sample]) -> list[dict[str, Any]]:
    """Samples as the stream shows them."""
    return [
        {
            "channel": sample.channel,
            "time": rfc3339_exact(sample.time_us),
            "value": sample.value,
            "quality": int(sample.quality),
        }
        for sample in samples
    ]


def steps_json(steps: Sequence[Step]) -> list[dict[str, float]]:
    """The profile that a forecast follows."""
    return [asdict(step) for step in steps]


def tag(value: float | None, unit: str, quality: int, time: str) -> dict[str, Any]:
    """One snapshot tag; a value that is not a number is null."""
    if value is not None:
        # A scaled register is 24.7, not 24.700000000000003.
        value = round(value, 6) if math.isfinite(value) else None
    return {"value": value, "unit": unit, "quality": int(quality), "time": time}
