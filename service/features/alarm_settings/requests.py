"""Changes of alarm settings as callers ask for them."""

from pydantic import ConfigDict, Field
from pydantic.config import JsonDict

from service.domain.requests import RequestBody
from service.domain.texts import OneLine


class AlarmSettingFields(RequestBody):
    """Which alarm, and what is to change; null brings back what the configuration has."""

    asset: str = Field(max_length=200, examples=["bench-1"])
    tag: str = Field(max_length=200, description="Channel.", examples=["t_inner_ring_c"])
    kind: str = Field(max_length=100, examples=["measured limit"])
    level: str = Field("", max_length=20, examples=["warning"])
    setpoint: float | None = Field(None, description="In the unit of the alarm.", examples=[65])
    deadband: float | None = None
    on_delay_s: float | None = None
    off_delay_s: float | None = None
    priority: int | None = Field(None, description="1 high, 2 medium, 3 low.")
    latched: bool | None = None
    re_alarm_s: float | None = Field(None, description="0: never.")
    enabled: bool | None = None
    alarm_class: OneLine | None = Field(None, alias="class", max_length=1000)
    probable_causes: OneLine | None = Field(None, max_length=1000)
    consequence_of_inaction: OneLine | None = Field(None, max_length=1000)
    operator_action: OneLine | None = Field(None, max_length=1000)
    allowable_response_time_s: float | None = None
    severity_of_consequence: OneLine | None = Field(None, max_length=1000)
    identification_method: OneLine | None = Field(None, max_length=1000)
    status: str | None = Field(None, description="default, proposed or approved.")
    rationalised_by: OneLine | None = Field(None, max_length=1000)
    rationalised_at: str | None = Field(None, description="Date.", examples=["2026-11-23"])
    remarks: OneLine | None = Field(None, max_length=1000)


_AN_ALARM: JsonDict = {
    "asset": "bench-1",
    "tag": "t_inner_ring_c",
    "kind": "measured limit",
    "level": "warning",
    "setpoint": 65.0,
}


class AlarmSettingPatch(AlarmSettingFields):
    """A change of one alarm, and why."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [_AN_ALARM | {"comment": "as the maker of the grease says"}]}
    )

    comment: OneLine = Field(min_length=1, max_length=500, description="Why.")


class AlarmSettingsToImport(RequestBody):
    """Changes of many alarms; a row may also hold the other columns of the sheet."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"rows": [_AN_ALARM], "comment": "as the maker of the grease says"}]
        }
    )

    rows: list[AlarmSettingFields]
    comment: OneLine = Field("", max_length=500, description="Why; may be a parameter too.")
