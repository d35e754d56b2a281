"""Changes of alarm settings: judged all together, before anything is written."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any, Final

from pydantic import ValidationError

from adapters.configuration import listed, suggestion
from adapters.words import shown
from service.alarm_kinds import KINDS
from service.domain.alarm_guidance import AlarmName, PossibleAlarm
from service.domain.alarm_kind import LevelRule
from service.domain.texts import EXPECTED, is_one_line
from service.domain.upload_limits import in_time
from service.site.alarm_overlay import (
    FIELDS,
    FORECAST,
    MEASURED,
    AlarmedAsset,
    AlarmEntry,
    Overlay,
    first_message,
    home_of,
    in_effect,
    points_of,
    rows_of,
)

STATUSES: Final = ("default", "proposed", "approved")
#: No text of a sheet is longer.
TEXT_MAX: Final = 1000
_SWITCHES = ("latched", "enabled")
_NUMBERS = ("setpoint", "deadband", "on_delay_s", "off_delay_s", "re_alarm_s")
_NO_ACTION = ("monitor", "watch", "none", "note", "observe")
_YES, _NO = ("yes", "true", "1", "on"), ("no", "false", "0", "off")
_LONGEST_RESPONSE_S = 30 * 86_400.0


@dataclass(frozen=True, slots=True)
class WantedRow:
    """A row as somebody wants it.

    - ``place``: for people: line of the CSV file, or the place from 1 in JSON.
    - ``fields``: what it is to be; None: as the configuration has it. What is not there stays.
    - ``unit``: in which setpoint and deadband were given; None: not said.
    """

    place: int
    asset: str
    name: AlarmName
    fields: Mapping[str, Any]
    unit: str | None = None


@dataclass(frozen=True, slots=True)
class Mistake:
    """What is wrong in a row, and in which column."""

    place: int
    column: str
    text: str

    def __str__(self) -> str:
        return f"row {self.place}, {self.column}: {self.text}"


@dataclass(frozen=True, slots=True)
class Difference:
    """What would change of an alarm."""

    asset: str
    name: AlarmName
    field: str
    before: Any
    after: Any


@dataclass(slots=True)
class JudgedSettings:
    """What rows would change.

    - ``changes``: what differs from the configuration from then on, by asset and alarm; only what
      changes.
    - ``differences``: each setting in effect that becomes another one.
    - ``mistakes``: in the order of the rows; with one of them nothing may be written.
    """

    changes: dict[tuple[str, AlarmName], dict[str, Any]] = field(default_factory=dict)
    differences: list[Difference] = field(default_factory=list)
    mistakes: list[Mistake] = field(default_factory=list)

    @property
    def summary(self) -> str:
        """What is changed, in one line for the audit trail."""
        shown = [
            f"{one.asset} {'/'.join(part for part in one.name if part)} {one.field}: "
            f"{_shown(one.before)} -> {_shown(one.after)}"
            for one in self.differences[:5]
        ]
        others = len(self.differences) - len(shown)
        return "; ".join(shown) + (f"; and {others} more" if others > 0 else "")


def judge_settings(
    assets: Mapping[str, AlarmedAsset],
    overlays: Mapping[str, Overlay],
    wanted: Sequence[WantedRow],
    seconds: float | None = None,
) -> JudgedSettings:
    """Check wanted rows, and compare them with what is in effect.

    ``seconds``: of processor time that each of the two walks through them may take; None: any.
    Raises `UploadTooLargeError` if one takes longer.
    """
    judged = JudgedSettings()
    places: dict[tuple[str, AlarmName], int] = {}
    by_asset: dict[str, list[WantedRow]] = {}
    for row in in_time(wanted, seconds):
        if row.asset not in assets:
            text = f"no asset {row.asset!r}; {suggestion(row.asset, assets)}"
            judged.mistakes.append(Mistake(row.place, "asset", text))
        elif (row.asset, row.name) in places:
            first = places[row.asset, row.name]
            text = f"{_named(row.name)}: row {first} has it too; expected each alarm once"
            judged.mistakes.append(Mistake(row.place, "tag", text))
        else:
            places[row.asset, row.name] = row.place
            by_asset.setdefault(row.asset, []).append(row)
    for asset_id, rows in in_time(by_asset.items(), seconds):
        _judge_asset(judged, assets[asset_id], overlays.get(asset_id, {}), rows)
    judged.mistakes.sort(key=lambda mistake: mistake.place)
    if judged.mistakes:
        judged.changes.clear()
    return judged


def _judge_asset(
    judged: JudgedSettings, asset: AlarmedAsset, overlay: Overlay, rows: Sequence[WantedRow]
) -> None:
    points = points_of(asset)
    before = {row.name: row for row in rows_of(asset, overlay)}
    after: dict[AlarmName, dict[str, Any]] = {name: dict(one) for name, one in overlay.items()}
    setpoints: dict[AlarmName, tuple[int, float]] = {}
    places: dict[AlarmName, int] = {}
    mistakes = judged.mistakes
    for row in rows:
        forecast = (FORECAST, *row.name[1:])
        if row.name not in points and home_of(forecast, "setpoint") == row.name:
            # The limit of what is not measured, as the history names it.
            row = replace(row, name=forecast) if set(row.fields) <= {"setpoint"} else row
        point = points.get(row.name)
        if point is None:
            mistakes.append(Mistake(row.place, *_unknown(row.name, points)))
            continue
        places[row.name] = row.place
        if row.unit is not None and row.unit != (point.unit or ""):
            text = f"{row.unit!r}: expected {point.unit!r}" if point.unit else "expected none"
            mistakes.append(Mistake(row.place, "unit", text))
        present = before[row.name]
        for key, given in row.fields.items():
            if isinstance(given, str) and given and given == present.values[key]:
                continue  # also a text that was kept before its kind was refused
            try:
                value = _checked(asset, row.name, point, key, given)
            except ValueError as error:
                mistakes.append(Mistake(row.place, key, str(error)))
                continue
            value = present.base[key] if value is None else value
            if value == present.values[key]:
                continue
            home = home_of(row.name, key)
            if key == "setpoint":
                other = setpoints.setdefault(home, (row.place, value))
                if other[1] != value:
                    text = (
                        f"{value:g}: row {other[0]} sets the same limit to {other[1]:g}; "
                        f"{MEASURED} and {FORECAST} have one limit"
                    )
                    mistakes.append(Mistake(row.place, key, text))
                places.setdefault(home, row.place)
            changed = after.setdefault(home, {})
            if value == present.base[key]:
                changed.pop(key, None)
            else:
                changed[key] = value
    found = {row.name: row for row in rows_of(asset, after)}
    for name, problem in in_effect(asset, after).problems.items():
        if name in places or name not in in_effect(asset, overlay).problems:
            place = places.get(name) or min(places.values(), default=1)
            mistakes.append(Mistake(place, "setpoint", problem))
    for name, place in places.items():
        if name in found:
            mistakes += (Mistake(place, column, text) for column, text in _unfinished(found[name]))
    asset_id = asset.section.id
    for name, row_after in found.items():
        judged.differences += (
            Difference(asset_id, name, key, before[name].values[key], row_after.values[key])
            for key in FIELDS
            if before[name].values[key] != row_after.values[key]
        )
    judged.changes |= {
        (asset_id, name): one for name, one in after.items() if one != overlay.get(name, {})
    }


def _unknown(name: AlarmName, points: Mapping[AlarmName, PossibleAlarm]) -> tuple[str, str]:
    """Name the column that makes an alarm unknown, and say what is expected there."""
    kind, channel, level = name
    if kind not in KINDS:
        return "kind", f"{kind!r}: expected one of {listed(KINDS)}"
    channels = list(dict.fromkeys(one[1] for one in points if one[0] == kind))
    if channel not in channels:
        known = listed(channels) or "none of this asset"
        return "tag", f"{channel!r} has no alarm {kind!r}; expected one of {known}"
    levels = [one[2] or "empty" for one in points if one[:2] == (kind, channel)]
    return "level", f"{level!r}: expected {listed(levels)}"


def _checked(
    asset: AlarmedAsset, name: AlarmName, point: PossibleAlarm, key: str, given: object
) -> Any:
    """Read and check the value of a field; None where the configuration's is wanted.

    Raises `ValueError`: what is wrong with it.
    """
    if given is None or given == "":
        return None
    if key in _SWITCHES:
        value: Any = _switch(given)
        if key == "enabled" and value and not asset.section.alarms.rule(KINDS[name[0]]).enabled:
            raise ValueError("the configuration has this kind off; expected a change there")
        return value
    if key in _NUMBERS or key == "allowable_response_time_s":
        value = _number(given)
    elif key == "priority":
        value = _number(given)
        if value not in (1, 2, 3):
            raise ValueError(f"{given}: expected 1 (high), 2 (medium) or 3 (low)")
        return int(value)
    else:
        return _text(key, given) or None
    if key == "allowable_response_time_s":
        if not 0 < value <= _LONGEST_RESPONSE_S:
            raise ValueError(f"{value:g}: expected more than 0 and at most {_LONGEST_RESPONSE_S:g}")
    elif key == "setpoint":
        if point.pair is None:
            raise ValueError("this alarm has no setpoint; expected none")
    else:
        _check_rule(asset, name, point, key, value)
    return value


def _check_rule(
    asset: AlarmedAsset, name: AlarmName, point: PossibleAlarm, key: str, value: float
) -> None:
    """Let the settings of the kind say what is allowed: the same as in the configuration."""
    rule: LevelRule = asset.section.alarms.rule(KINDS[name[0]])
    if key == "deadband":
        if not point.deadband_key:
            raise ValueError("this alarm has no deadband; expected none")
        key = point.deadband_key
    try:
        type(rule).model_validate(rule.model_dump() | {key: value})
    except ValidationError as error:
        raise ValueError(first_message(error)) from error


def _switch(given: object) -> bool:
    if isinstance(given, bool):
        return given
    word = str(given).strip().lower()
    if word not in (*_YES, *_NO):
        raise ValueError(f"{shown(given)}: expected yes or no")
    return word in _YES


def _number(given: object) -> float:
    try:
        if isinstance(given, bool):
            raise ValueError
        value = float(given if isinstance(given, int | float) else str(given))
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{shown(given)}: expected a number") from error
    if not math.isfinite(value):
        raise ValueError(f"{shown(given)}: expected a finite number")
    return value


def _text(key: str, given: object) -> str:
    if not isinstance(given, str):
        raise ValueError(f"{shown(given)}: expected a text")
    text = given.strip()
    if len(text) > TEXT_MAX:
        raise ValueError(f"{len(text)} characters; expected at most {TEXT_MAX}")
    if not is_one_line(text):
        raise ValueError(EXPECTED)
    if text.startswith("'"):
        raise ValueError("expected no apostrophe at the beginning: a spreadsheet hides it")
    if key == "operator_action" and text.lower().rstrip(".") in _NO_ACTION:
        raise ValueError(f"{shown(text)} is no action; what needs none is an event, not an alarm")
    if key == "status" and text not in STATUSES:
        raise ValueError(f"{shown(text)}: expected {listed(STATUSES)}")
    if key == "rationalised_at" and text:
        try:
            date.fromisoformat(text)
        except ValueError as error:
            raise ValueError(f"{shown(text)}: expected a date such as 2026-11-23") from error
    return text


def _unfinished(row: AlarmEntry) -> Iterator[tuple[str, str]]:
    """What an approved row lacks."""
    if row.values["status"] == "approved":
        for key in ("rationalised_by", "rationalised_at"):
            if not row.values[key]:
                yield key, "missing; an approved row says who approved it and when"


def _named(name: AlarmName) -> str:
    return "/".join(part for part in name if part)


def _shown(value: object) -> str:
    if value is None or value == "":
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)
