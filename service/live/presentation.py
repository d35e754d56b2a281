"""States, tags and profiles of a running twin as the documents that others rely on."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adapters.samples import Quality, Sample
from service.clock import rfc3339, rfc3339_exact
from service.documents import limits as documents
from service.documents.alarms import alarm_summary
from service.documents.assets import NodeState, State
from service.documents.forecasts import not_known_reason
from service.documents.limits import Crossing, Crossings, Level
from service.documents.measurements import SampleItem, sample_item
from service.documents.profiles import ForecastStep
from service.documents.tags import Tag, tag
from service.live.estimate import LiveEstimate
from service.live.profiles import StepAhead
from service.site.asset_section import LimitsSection
from service.store import Alarm
from twin_core.forecasting import Forecast

LEVELS: tuple[Level, ...] = ("warning", "alarm")
#: Among the quantiles of a forecast: 2.5, 25, 50, 75 and 97.5 %.
_MEDIAN = 2


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


LimitCrossings = Mapping[str, Mapping[str, LimitCrossing]]
"""By channel and level."""


def limit_crossings(forecast: Forecast, limits: Mapping[str, LimitsSection]) -> LimitCrossings:
    """Crossings of every warning and alarm limit of a sensor, by channel and level.

    A node has none: a forecast keeps the members' paths of the sensors alone.
    """
    return {
        channel: {level: _crossing(forecast, channel, getattr(pair, level)) for level in LEVELS}
        for channel, pair in limits.items()
        if channel in forecast.sensors
    }


def _crossing(forecast: Forecast, channel: str, limit_c: float) -> LimitCrossing:
    found = forecast.exceedance(channel, limit_c)
    return LimitCrossing(found.probability, found.median_s, found.earliest_s)


@dataclass(frozen=True, slots=True)
class ForecastSummary:
    """What tags show of a forecast.

    Attributes
    ----------
    made_us : int
        Process time of the state that it begins from.
    highest_c : mapping of str to float or None
        Highest median by limited channel; None where there is none.
    crossings : mapping
        How likely and when a limit is exceeded, by channel and level.
    """

    made_us: int
    highest_c: Mapping[str, float | None]
    crossings: LimitCrossings


def summarize(
    forecast: Forecast, limits: Mapping[str, LimitsSection], made_us: int
) -> ForecastSummary:
    """Take from a forecast what tags and alarms need.

    Parameters
    ----------
    forecast : Forecast
        The forecast.
    limits : mapping of str to LimitsSection
        By sensor or node.
    made_us : int
        Process time of the state that it begins from.
    """
    highest_c = {}
    for channel in limits:
        if channel in forecast.names:
            medians = np.round(forecast.quantile(channel)[_MEDIAN], 2)
            finite = medians[np.isfinite(medians)]
            highest_c[channel] = float(finite.max()) if finite.size else None
    return ForecastSummary(made_us, highest_c, limit_crossings(forecast, limits))


def crossings_document(crossings: LimitCrossings) -> Crossings:
    """Show when limits are exceeded."""
    return {
        channel: {level: _shown(levels[level]) for level in LEVELS if level in levels}
        for channel, levels in crossings.items()
    }


def _shown(crossing: LimitCrossing) -> Crossing:
    return Crossing(
        probability=crossing.probability,
        median_s=crossing.median_s,
        earliest_s=crossing.earliest_s,
    )


def limits_document(limits: Mapping[str, LimitsSection]) -> dict[str, documents.Limits]:
    """Show the limits of an asset."""
    return {
        channel: documents.Limits(warning=pair.warning, alarm=pair.alarm)
        for channel, pair in limits.items()
    }


def estimate_tags(estimate: LiveEstimate, began: str, blind: bool = False) -> dict[str, Tag]:
    """Tags ``<name>.twin`` of all sensors and nodes, uncertain where a node is not known.

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
    doubtful = Quality.LAST_USABLE if blind else Quality.UNCERTAIN
    not_known = estimate.not_known()
    return {
        f"{name}.twin": tag(
            round(float(model.sensor_row(name) @ temperatures), 3),
            "°C",
            doubtful if name in not_known else quality,
            made,
        )
        for name in names
    }


def forecast_tags(
    limits: Mapping[str, LimitsSection],
    forecast: ForecastSummary | None,
    began: str,
    blind: bool = False,
    *,
    prior: bool = False,
) -> dict[str, Tag]:
    """Tags of the forecast's maximum and the times to the limits, for every limited channel.

    While the twin does not know the operation (``blind``) they have no value: quality "last
    known". Of a model that was never identified (``prior``) they are uncertain.
    """
    tags: dict[str, Tag] = {}
    good = Quality.LAST_KNOWN if blind else Quality.UNCERTAIN if prior else Quality.GOOD
    waiting = Quality.WAITING_FOR_INITIAL_DATA
    for channel in limits:
        maximum, made = None, began
        if forecast is not None and channel in forecast.highest_c:
            maximum, made = forecast.highest_c[channel], rfc3339(forecast.made_us)
        tags[f"{channel}.forecast_max"] = tag(
            None if blind else maximum, "°C", waiting if maximum is None else good, made
        )
        crossings = {} if forecast is None else forecast.crossings.get(channel, {})
        for level in LEVELS:
            # No time and a good quality: the limit is not exceeded within the horizon.
            crossing = crossings.get(level)
            tags[f"{channel}.time_to_{level}_s"] = tag(
                None if crossing is None or blind else crossing.median_s,
                "s",
                waiting if crossing is None else good,
                made,
            )
    return tags


def alarm_tags(alarms: Sequence[Alarm], changed: str) -> dict[str, Tag]:
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


def state_document(estimate: LiveEstimate, now_us: int, missing: Sequence[str]) -> State:
    """Mean and standard deviation of the node temperatures, null before the first data.

    Parameters
    ----------
    estimate : LiveEstimate
        The twin.
    now_us : int
        Process time, which dates it before the first estimate.
    missing : sequence of str
        Operating channels that the twin does not know now.
    """
    active = estimate.active
    nodes = {
        name: NodeState(mean_c=None, std_c=None, known=False, reason="no estimate yet")
        for name in active.model.node_names
    }
    time_us = now_us
    if estimate.started:
        time_us = estimate.time_us or now_us
        not_known = estimate.not_known()
        for name, mean, std in zip(nodes, estimate.temperatures_c, estimate.std_c, strict=True):
            nodes[name] = NodeState(
                mean_c=round(float(mean), 3),
                std_c=round(float(std), 3),
                known=name not in not_known,
                reason=not_known_reason(not_known[name]) if name in not_known else None,
            )
    return State(
        # As the samples of the same estimate, which are stored.
        time=rfc3339_exact(time_us),
        model_version=active.version,
        revolutions=round(estimate.revolutions),
        nodes=nodes,
        missing=list(missing),
    )


def samples_document(samples: Iterable[Sample]) -> list[SampleItem]:
    """Samples as the stream shows them."""
    return [
        sample_item(sample.channel, sample.time_us, sample.value, sample.quality)
        for sample in samples
    ]


def steps_document(steps: Sequence[StepAhead]) -> list[ForecastStep]:
    """The profile that a forecast follows."""
    return [
        ForecastStep(
            duration_s=step.duration_s,
            speed_rpm=step.speed_rpm,
            load_n=step.load_n,
            ambient_c=step.ambient_c,
        )
        for step in steps
    ]
