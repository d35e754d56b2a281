"""One asset in short: its state, and why it needs attention."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from adapters.samples import Quality
from service.alarms.records import urgency
from service.alarms.states import ACTIVE_STATES, UNACKNOWLEDGED_STATES
from service.clock import rfc3339
from service.documents.fleet import Attention, FleetAlarm, FleetAsset, FleetState
from service.documents.limits import Level, Limit
from service.documents.verdicts import VerdictDocument
from service.domain.channels import label
from service.live.readings import Readings
from service.live.verdict import FORECAST, IDENTIFIED_MODEL
from service.site.asset_section import AssetSection
from service.site.required_channels import judged_temperatures
from service.store import Alarm


class _Ahead(NamedTuple):
    limit: Limit | None
    probability: float | None
    seconds: float | None


#: Alarms of a measured temperature that is too high now.
_STANDING_KINDS = ("measured limit", "above ambient")
#: What a verdict can lack without a doubt about any measured value.
_OF_THE_MODEL = (IDENTIFIED_MODEL, FORECAST)


def asset_summary(
    settings: AssetSection,
    readings: Readings,
    verdict: VerdictDocument,
    alarms: Sequence[Alarm],
    *,
    version: int,
    trusted: bool,
    identified: bool,
    drifted: bool,
) -> FleetAsset:
    """Show an asset as the fleet does.

    Parameters
    ----------
    settings : AssetSection
        Its configuration.
    readings : Readings
        Its latest samples.
    verdict : VerdictDocument
        Of this moment.
    alarms : sequence of Alarm
        Its alarms that are not over.
    version : int
        Of its active model.
    trusted, identified, drifted : bool
        What is known of that model.
    """
    waiting = sorted((one for one in alarms if one.state in UNACKNOWLEDGED_STATES), key=urgency)
    standing = [one for one in alarms if one.state in ACTIVE_STATES and one.kind in _STANDING_KINDS]
    state = _state(verdict, bool(standing), readings)
    attention = _attention(state, bool(waiting), trusted, identified, drifted)
    ahead = _ahead(verdict) if state == "ahead" else None
    limit = verdict.now.limit or (ahead.limit if ahead else None) or _limit_of(standing)
    channel = limit.channel if limit else _hottest(settings, readings)
    sample = readings.latest.get(channel) if channel else None
    usable = sample is not None and sample.quality >= Quality.UNCERTAIN
    value_c = sample.value if sample and usable and math.isfinite(sample.value) else None
    return FleetAsset(
        id=settings.id,
        name=settings.name or settings.id,
        group=settings.group or None,
        family=settings.family or None,
        bearing=settings.bearing.name if settings.bearing else None,
        network=settings.network_name,
        state=state,
        attention=attention,
        now=verdict.now.word,
        next_step=verdict.next_step.word,
        reason=_reason(state, attention, verdict, waiting, standing),
        missing=verdict.missing,
        limit=limit,
        seconds_to_limit=ahead.seconds if ahead else None,
        probability=ahead.probability if ahead else None,
        channel=channel if sample else None,
        value_c=None if value_c is None else round(value_c, 1),
        value_at=rfc3339(sample.time_us) if sample else None,
        unacknowledged=len(waiting),
        alarm=_alarm(waiting[0]) if waiting else None,
        model_version=version,
        trusted=trusted,
        identified=identified,
        drifted=drifted,
    )


def _state(verdict: VerdictDocument, standing: bool, readings: Readings) -> FleetState:
    now = verdict.now
    # Over a limit comes first, also where the word is unknown because an input is missing.
    if standing or now.limit is not None or now.word in ("not safe", "recovering"):
        return "over"
    channels = [name for name in verdict.missing if name in readings.max_age_s]
    if channels and not readings.latest:
        return "waiting"
    if now.word == "unknown":
        return "lost" if channels else "unknown"
    return "safe" if _ahead(verdict) is None else "ahead"


def _ahead(verdict: VerdictDocument) -> _Ahead | None:
    """The limit that is expected to be exceeded; None where none is.

    Of all that is planned, or of the present and the next step, which are judged by limits of
    nodes as well.
    """
    toward = verdict.time_to_limit
    if toward is not None and toward.expected:
        return _Ahead(toward.limit, toward.probability, toward.earliest_s)
    for step in (verdict.present_step, verdict.next_step):
        if step.word == "not safe":
            return _Ahead(step.limit, step.probability, step.seconds_to_limit)
    return None


def _attention(
    state: FleetState, waits: bool, trusted: bool, identified: bool, drifted: bool
) -> Attention | None:
    if waits:
        return "alarm"
    if state in ("over", "ahead", "lost", "unknown"):
        return state
    if state == "waiting":
        return None
    if not trusted:
        return "not trusted"
    if not identified:
        return "not identified"
    return "drifted" if drifted else None


def _reason(
    state: FleetState,
    attention: Attention | None,
    verdict: VerdictDocument,
    waiting: Sequence[Alarm],
    standing: Sequence[Alarm],
) -> str:
    # What is exceeded already outweighs what is predicted.
    if waiting and not (state == "over" and waiting[0].predicted):
        return waiting[0].message
    if state == "over" and standing and verdict.now.limit is None:
        return standing[0].message
    ahead = _ahead(verdict) if state == "ahead" else None
    if ahead is not None and ahead.limit is not None:
        limit = ahead.limit
        return f"{label(limit.channel)} toward {limit.level} {limit.value_c:g} °C"
    if state == "waiting":
        return "no data yet"
    if attention == "not trusted":
        return "the estimate or the forecast of its model fails"
    if attention == "not identified":
        return "its model was never identified"
    if attention == "drifted":
        return "the machine has changed: see its drift report"
    reasons = verdict.now.reasons
    return reasons[0] if reasons else ""


def _limit_of(standing: Sequence[Alarm]) -> Limit | None:
    """The limit of a standing alarm, where it is one of a temperature in °C."""
    for alarm in sorted(standing, key=lambda one: one.priority):
        if alarm.kind == "measured limit" and alarm.limit_value is not None:
            level: Level = "alarm" if alarm.level == "alarm" else "warning"
            return Limit(channel=alarm.channel, level=level, value_c=alarm.limit_value)
    return None


def _hottest(settings: AssetSection, readings: Readings) -> str | None:
    """Of the temperatures that are judged, the one nearest to its limit, or the hottest."""
    known = [name for name in judged_temperatures(settings) if name in readings.latest]

    def margin_k(name: str) -> float:
        pair = settings.limits.get(name)
        value_c = readings.latest[name].value
        if not math.isfinite(value_c):
            return math.inf
        return (1000.0 if pair is None else pair.warning) - value_c

    return min(known, key=margin_k, default=None)


def _alarm(alarm: Alarm) -> FleetAlarm:
    return FleetAlarm(
        id=alarm.id,
        kind=alarm.kind,
        priority=alarm.priority,
        predicted=alarm.predicted,
        message=alarm.message,
        since=rfc3339(alarm.raised_at_us or alarm.since_us),
    )
