"""Alarm settings of an asset as they are in effect: the configuration, and what was changed of it.

The configuration is the base. What was changed of an alarm lies over it, in the store; a limit that
is changed so is the limit of all parts of the service.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, cast

from pydantic import BaseModel, ValidationError

from service.alarm_kinds import KINDS, forecast_limit, measured_limit
from service.domain.alarm_guidance import (
    AlarmName,
    AlarmOverride,
    AlarmSubject,
    PossibleAlarm,
)
from service.domain.alarm_kind import AlarmKind, LevelRule, PlainRule
from service.domain.causes import source_of
from service.domain.channels import label
from service.site.asset_section import AssetSection, LimitsSection
from service.site.wiring import ChannelFacts

#: What the alarm book works with.
SETTINGS: Final = (
    "setpoint",
    "deadband",
    "on_delay_s",
    "off_delay_s",
    "priority",
    "latched",
    "re_alarm_s",
    "enabled",
)
#: What is written for people.
TEXTS: Final = (
    "class",
    "probable_causes",
    "consequence_of_inaction",
    "operator_action",
    "allowable_response_time_s",
    "severity_of_consequence",
    "identification_method",
    "status",
    "rationalised_by",
    "rationalised_at",
    "remarks",
)
FIELDS: Final = SETTINGS + TEXTS
MEASURED, FORECAST = measured_limit.KIND.name, forecast_limit.KIND.name

Overlay = Mapping[AlarmName, Mapping[str, Any]]
"""What differs from the configuration, by alarm and field."""
Origin = Literal["file", "provisioned"]


@dataclass(frozen=True, slots=True)
class AlarmedAsset:
    """An asset of the configuration file or of the store, with what is read of it."""

    section: AssetSection
    facts: Mapping[str, ChannelFacts]
    origin: Origin = "file"


@dataclass(frozen=True, slots=True)
class AlarmEntry:
    """One alarm that an asset can have: a row of the rationalisation sheet.

    - ``unit``: of setpoint and deadband.
    - ``base``, ``values``: each of `FIELDS` as the configuration has it, and as it is in effect;
      None: it has none.
    - ``origin``: where the base stands.
    """

    asset: str
    name: AlarmName
    unit: str | None
    base: Mapping[str, Any]
    values: Mapping[str, Any]
    changed: tuple[str, ...]
    origin: Origin

    @property
    def description(self) -> str:
        """Name the alarm for people."""
        kind, channel, level = self.name
        source = source_of(channel)
        what = f"Source {source}" if source else label(channel)
        return f"{what}: {kind}{f' ({level})' if level else ''}"

    @property
    def alarm_type(self) -> str:
        """How the alarm comes about."""
        return KINDS[self.name[0]].guidance.alarm_type

    @property
    def suppression(self) -> str:
        """When it is suppressed by design."""
        return KINDS[self.name[0]].guidance.suppression


@dataclass(frozen=True, slots=True)
class Effective:
    """What is in effect.

    - ``overrides``: what else single alarms have otherwise than their kind says.
    - ``problems``: what of the overlay does not fit the configuration (any more), by alarm: there
      the configuration holds.
    """

    section: AssetSection
    overrides: Mapping[AlarmName, AlarmOverride] = field(default_factory=dict)
    problems: Mapping[AlarmName, str] = field(default_factory=dict)


def home_of(name: AlarmName, setting: str) -> AlarmName:
    """Say under which alarm a setting is kept: a forecast limit has the setpoint of the limit."""
    if setting == "setpoint" and name[0] == FORECAST:
        return (MEASURED, *name[1:])
    return name


def points_of(asset: AlarmedAsset) -> dict[AlarmName, PossibleAlarm]:
    """Every alarm that an asset can have, as the configuration has it."""
    channels = {name: facts.source for name, facts in asset.facts.items()}
    subject = AlarmSubject(asset.section.limits, channels)
    return {
        (kind.name, point.channel, point.level): point
        for kind in KINDS.values()
        for point in kind.points(subject, asset.section.alarms.rule(kind))
    }


def in_effect(asset: AlarmedAsset, overlay: Overlay) -> Effective:
    """Put what was changed over the configuration."""
    if not overlay:
        return Effective(asset.section)
    points = points_of(asset)
    problems: dict[AlarmName, str] = {}
    limits: dict[str, LimitsSection] = {}
    overrides: dict[AlarmName, dict[str, Any]] = {}
    pairs: dict[tuple[str, str], dict[str, float]] = {}
    for name, changed in overlay.items():
        kind, channel, level = name
        of_limit = kind == MEASURED and (FORECAST, channel, level) in points
        if name not in points and not of_limit:
            problems[name] = "the configuration has no such alarm"
            continue
        settings = {key: changed[key] for key in SETTINGS if key in changed}
        if "setpoint" in settings:
            pairs.setdefault((kind, channel), {})[level] = settings.pop("setpoint")
        if settings:
            overrides[name] = settings
    for (kind, channel), levels in pairs.items():
        known = next(one for one in points_like(points, kind, channel) if one.pair is not None)
        try:
            pair = checked_pair(asset, known, levels)
        except ValueError as error:
            problems |= {(kind, channel, level): str(error) for level in levels}
            continue
        if isinstance(pair, LimitsSection):
            limits[channel] = pair
        else:
            for level, setpoint in levels.items():
                overrides.setdefault((kind, channel, level), {})["setpoint"] = setpoint
    section = asset.section
    if limits:
        section = section.model_copy(update={"limits": {**section.limits, **limits}})
    return Effective(
        section, {name: AlarmOverride(**one) for name, one in overrides.items()}, problems
    )


def points_like(
    points: Mapping[AlarmName, PossibleAlarm], kind: str, channel: str
) -> list[PossibleAlarm]:
    """Points of a channel that share the warning and alarm of a kind."""
    kinds = (MEASURED, FORECAST) if kind == MEASURED else (kind,)
    return [one for name, one in points.items() if name[0] in kinds and name[1] == channel]


def checked_pair(
    asset: AlarmedAsset, point: PossibleAlarm, levels: Mapping[str, float]
) -> BaseModel:
    """Check a warning and an alarm against each other and against the range of their sensor.

    A level that is not in ``levels`` stays as configured. Raises `ValueError` if they are not in
    order, or out of range.
    """
    pair = cast(BaseModel | None, point.pair)
    if pair is None:
        raise ValueError("the alarm has no setpoint")
    try:
        found = type(pair).model_validate(pair.model_dump() | dict(levels))
    except ValidationError as error:
        raise ValueError(first_message(error)) from error
    facts = asset.facts.get(point.channel)
    if isinstance(found, LimitsSection) and facts is not None:
        low, high = facts.limits.low, facts.limits.high
        for level in levels:
            setpoint = getattr(found, level)
            if not low <= setpoint <= high:
                raise ValueError(
                    f"{level} {setpoint:g} {point.unit} is outside of what the sensor can "
                    f"measure; expected {low:g} to {high:g}"
                )
    return found


def first_message(error: ValidationError) -> str:
    """Give what is wrong first, with its key where that is known."""
    found = error.errors()[0]
    where = ".".join(str(part) for part in found["loc"])
    said = found["msg"].removeprefix("Value error, ")
    return f"{where} {found['input']}: {said}" if where else said


def rows_of(asset: AlarmedAsset, overlay: Overlay) -> list[AlarmEntry]:
    """Give every alarm that an asset can have, with its settings in effect.

    What does not fit of the overlay is left out.
    """
    problems = in_effect(asset, overlay).problems
    rows = []
    for name, point in points_of(asset).items():
        kind = KINDS[name[0]]
        rule: LevelRule | PlainRule = asset.section.alarms.rule(kind)
        base = base_of(kind, rule, point)
        own: dict[str, Any] = {}
        for key in FIELDS:
            home = home_of(name, key)
            if home in overlay and key in overlay[home] and home not in problems:
                own[key] = overlay[home][key]
        changed = tuple(key for key, value in own.items() if value != base[key])
        rows.append(
            AlarmEntry(asset.section.id, name, point.unit, base, base | own, changed, asset.origin)
        )
    return rows


def base_of(
    kind: AlarmKind[Any], rule: LevelRule | PlainRule, point: PossibleAlarm
) -> dict[str, Any]:
    """Settings and texts of an alarm as the configuration and the product have them."""
    guidance = kind.guidance
    deadband = getattr(rule, point.deadband_key) if point.deadband_key else None
    return {
        "setpoint": point.setpoint,
        "deadband": deadband,
        "on_delay_s": rule.on_delay_s,
        "off_delay_s": rule.off_delay_s,
        "priority": rule.priority_of(point.level),
        "latched": rule.latched,
        "re_alarm_s": rule.re_alarm_s,
        "enabled": rule.enabled,
        "class": guidance.alarm_class,
        "probable_causes": guidance.probable_causes,
        "consequence_of_inaction": guidance.consequence_of_inaction,
        "operator_action": guidance.operator_action,
        "allowable_response_time_s": None,
        "severity_of_consequence": "",
        "identification_method": guidance.identification_method,
        "status": "default",
        "rationalised_by": "",
        "rationalised_at": "",
        "remarks": "",
    }
