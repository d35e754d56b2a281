"""Alarm settings, the rationalisation sheet, and what was changed of them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from service.alarm_kinds import forecast_limit
from service.alarms.records import assets_of
from service.clock import rfc3339
from service.documents.alarms import AlarmDocument, alarm_document
from service.documents.base import Document, Number, Page, Time
from service.domain.json_values import Json
from service.features.alarm_settings.settings_changes import Difference, JudgedSettings, Mistake
from service.features.alarm_settings.sheets import OF_THE_TWIN, cells_of
from service.site.alarm_overlay import FORECAST, MEASURED, AlarmedAsset, Overlay, rows_of
from service.store import Alarm, AlarmSettingChange, Store
from service.store.forecast_records import ForecastRecords, StoredForecast, all_degrees
from twin_core.response_time import ResponseTime, time_between, time_to

#: Of an asset the time to respond rests on so many kept forecasts at most, the newest.
FORECASTS_MAX = 500
#: What a forecast of a model that is not identified says along with it.
_NOT_IDENTIFIED = "not identified yet"
_UNKNOWN = "not known: no forecast of an identified model is kept"

_Kept = tuple[Sequence[int], NDArray[np.float64]]
Status = Literal["default", "proposed", "approved"]


class AlarmSetting(Document):
    """One alarm that an asset can have: its settings in effect, and what is documented of it."""

    asset: str = Field(examples=["bench-1"])
    tag: str = Field(
        description="Channel, or `source:NAME` for a whole source.", examples=["t_inner_ring_c"]
    )
    kind: str = Field(examples=["measured limit"])
    level: str = Field(
        description="`warning` or `alarm`; empty where there is one level only.",
        examples=["warning"],
    )
    description: str = Field(examples=["Inner ring: measured limit (warning)"])
    alarm_type: str = Field(examples=["absolute"])
    setpoint: Number = Field(description="In `unit`; null where it has none.", examples=[70.0])
    unit: str | None = Field(examples=["°C"])
    deadband: Number = Field(description="In `unit`; null where it has none.", examples=[1.0])
    on_delay_s: float
    off_delay_s: float
    priority: int = Field(ge=1, le=3, description="1 high, 2 medium, 3 low.")
    alarm_class: str = Field(alias="class", description="Group of alarms that are managed alike.")
    latched: bool
    re_alarm_s: float
    enabled: bool
    probable_causes: str
    consequence_of_inaction: str
    operator_action: str
    allowable_response_time_s: Number = Field(description="As the site says; null: not said.")
    time_to_respond_p05_s: Number = Field(
        description="From the twin: 5 % of the forecasts leave less time; null: never within the "
        "horizon, or not known, see `time_basis`."
    )
    time_to_respond_p50_s: Number = Field(description="The median; null likewise.")
    time_basis: str = Field(
        description="From what to what the time counts, and on how many forecasts it rests."
    )
    severity_of_consequence: str
    identification_method: str
    suppression: str = Field(description="When it is suppressed by design.")
    status: Status
    rationalised_by: str
    rationalised_at: str
    remarks: str
    changed: list[str] = Field(description="Fields that differ from the configuration.")
    origin: Literal["file", "provisioned"] = Field(
        description="Where the configuration of the asset stands."
    )


class AlarmSettingList(Page):
    """Alarm settings in effect."""

    revision: int = Field(description="Of the latest change of any alarm setting; 0: none.")
    items: list[AlarmSetting]


class SettingDifference(Document):
    """What of an alarm would be, or is, another setting."""

    asset: str
    tag: str
    kind: str
    level: str
    field: str
    before: Json
    after: Json


class SettingMistake(Document):
    """What is wrong, and where."""

    row: int = Field(description="Line of the CSV file, or the place from 1 in JSON.")
    column: str
    detail: str


class ImportedAlarmSettings(Document):
    """What a sheet changes; nothing with `dry_run`, and nothing where there is a mistake."""

    dry_run: bool
    changed: int = Field(description="Alarms whose settings change.")
    differences: list[SettingDifference]
    mistakes: list[SettingMistake]
    silences: list[AlarmDocument] = Field(
        description="Alarms that are there now and that the change ends or makes less urgent."
    )
    revision: int = Field(description="Of the change; else of the latest one.")
    in_effect: bool = Field(description="False: stored; the cell applies it automatically.")


class AlarmSettingChangeDocument(Document):
    """A change of one alarm; changes of one revision were made together."""

    revision: int
    time: Time = Field(description="Wall time.")
    who: str
    comment: str
    asset: str
    tag: str
    kind: str
    level: str
    before: dict[str, Json] = Field(description="What differed from the configuration.")
    after: dict[str, Json] = Field(description="What differs from then on.")


class AlarmSettingHistory(Page):
    """Changes of alarm settings, newest first."""

    items: list[AlarmSettingChangeDocument]


def sheet_of(store: Store, asset: AlarmedAsset, overlay: Overlay) -> list[dict[str, Any]]:
    """Give the rationalisation sheet of an asset, row by row; reads kept forecasts."""
    rows = rows_of(asset, overlay)
    limits = {
        row.name: row.values["setpoint"] for row in rows if row.name[0] in (MEASURED, FORECAST)
    }
    kept: list[StoredForecast] = []
    if limits:
        kept = list(store.part(ForecastRecords).page(asset.section.id, FORECASTS_MAX).items)
    kept = [
        one
        for one in kept
        if not any(_NOT_IDENTIFIED in label for label in one.issued.content.labels)
    ]
    probability = asset.section.alarms.rule(forecast_limit.KIND).raise_probability
    channels = {channel: _of_channel(kept, channel) for _, channel, _ in limits}
    times = {name: _time(name, limits, channels[name[1]], probability) for name in limits}
    nothing = dict.fromkeys(OF_THE_TWIN) | {OF_THE_TWIN[-1]: "not forecast for this kind"}
    return [cells_of(row, times.get(row.name, nothing)) for row in rows]


def _time(
    name: tuple[str, str, str],
    limits: Mapping[tuple[str, str, str], float],
    of_channel: Sequence[_Kept],
    probability: float,
) -> dict[str, Any]:
    kind, channel, level = name
    if not of_channel:
        return dict(zip(OF_THE_TWIN, (None, None, _UNKNOWN), strict=True))
    if kind == FORECAST:
        of_what = f"from the forecast's alarm to {level} {limits[name]:g} °C"
        return _cells(time_to(of_channel, limits[name], probability), of_what)
    if level == "alarm":
        said = "not known: there is no limit above the alarm"
        return dict(zip(OF_THE_TWIN, (None, None, said), strict=True))
    alarm_c = limits[kind, channel, "alarm"]
    of_what = f"from warning {limits[name]:g} °C to alarm {alarm_c:g} °C"
    return _cells(time_between(of_channel, limits[name], alarm_c), of_what)


def _of_channel(kept: Sequence[StoredForecast], channel: str) -> list[_Kept]:
    """Lead times and quantiles of a channel, of each forecast that has them all."""
    found: list[_Kept] = []
    for one in kept:
        content = one.issued.content
        if channel in content.channels:
            place = content.channels.index(channel)
            quantiles = all_degrees([of_lead[place] for of_lead in content.quantiles])
            if math.isfinite(float(quantiles.sum())):
                found.append((content.lead_times_s, quantiles))
    return found


def _cells(found: ResponseTime | None, of_what: str) -> dict[str, Any]:
    if found is None:
        return dict(zip(OF_THE_TWIN, (None, None, _UNKNOWN), strict=True))
    rests = f"{found.forecasts} of {found.looked_at} kept forecasts"
    if found.forecasts == 0:
        basis = f"{of_what}: never within the horizon; {rests} come so far"
    else:
        basis = f"{of_what}: {rests}; {100 * found.never_share:.0f} % never within the horizon"
    times = [round(one) if math.isfinite(one) else None for one in (found.p05_s, found.p50_s)]
    return dict(zip(OF_THE_TWIN, (*times, basis), strict=True))


def alarm_setting(cells: Mapping[str, Any]) -> AlarmSetting:
    """Show a row of the sheet."""
    named = {("alarm_class" if key == "class" else key): value for key, value in cells.items()}
    return AlarmSetting(**named | {"changed": str(cells["changed"]).split()})


def imported(
    judged: JudgedSettings,
    silences: Sequence[Alarm],
    revision: int,
    *,
    dry_run: bool,
    in_effect: bool,
) -> ImportedAlarmSettings:
    """Show what a sheet changes."""
    return ImportedAlarmSettings(
        dry_run=dry_run,
        changed=len(judged.changes),
        differences=[
            SettingDifference(
                asset=one.asset,
                tag=one.name[1],
                kind=one.name[0],
                level=one.name[2],
                field=one.field,
                before=one.before,
                after=one.after,
            )
            for one in judged.differences
        ],
        mistakes=[mistake_document(one) for one in judged.mistakes],
        silences=[alarm_document(one) for one in silences],
        revision=revision,
        in_effect=in_effect,
    )


def silenced(differences: Sequence[Difference], active: Sequence[Alarm]) -> list[Alarm]:
    """Say which alarms that are there now a change ends or makes less urgent."""
    after = {(one.asset, *one.name, one.field): one.after for one in differences}

    def falls_silent(alarm: Alarm, asset: str) -> bool:
        key = (asset, alarm.kind, alarm.channel, alarm.level)
        setpoint, priority = after.get((*key, "setpoint")), after.get((*key, "priority"))
        return (
            after.get((*key, "enabled")) is False
            or (setpoint is not None and alarm.value is not None and alarm.value < setpoint)
            or (setpoint is not None and alarm.predicted and setpoint > (alarm.limit_value or 0))
            or (priority is not None and priority > alarm.priority)
        )

    return [
        alarm
        for alarm in active
        if alarm.present and any(falls_silent(alarm, asset) for asset in assets_of(alarm))
    ]


def mistake_document(mistake: Mistake) -> SettingMistake:
    """Show a mistake."""
    return SettingMistake(row=mistake.place, column=mistake.column, detail=mistake.text)


def change_document(change: AlarmSettingChange) -> AlarmSettingChangeDocument:
    """Show a change."""
    kind, channel, level = change.name
    return AlarmSettingChangeDocument(
        revision=change.revision,
        time=rfc3339(change.at_us),
        who=change.who,
        comment=change.comment,
        asset=change.asset,
        tag=channel,
        kind=kind,
        level=level,
        before=dict(change.before),
        after=dict(change.after),
    )
