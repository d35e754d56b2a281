"""Hours of a day at a place."""

from collections.abc import Sequence
from datetime import UTC, datetime, time, timedelta
from typing import Annotated, Self
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, model_validator

from service.clock import MICROSECONDS
from service.domain.section import Section


def _zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (OSError, ValueError, KeyError) as error:
        raise ValueError("expected a time zone such as Europe/Berlin or UTC") from error
    return name


TimeZone = Annotated[str, AfterValidator(_zone)]
"""Name of a time zone."""


class DailyHours(Section):
    """A span of each day, in the time of a place; one that ends before it begins ends next day."""

    begins: time
    ends: time
    time_zone: TimeZone = "UTC"

    @model_validator(mode="after")
    def _is_a_span(self) -> Self:
        if self.begins.tzinfo or self.ends.tzinfo:
            raise ValueError(
                "begins, ends: expected times such as 22:00, and time_zone beside them"
            )
        if self.begins == self.ends:
            raise ValueError(f"begins and ends at {self.begins:%H:%M}; expected two times")
        return self


def is_within(hours: DailyHours, days: Sequence[int], now_us: int) -> bool:
    """Whether a process time (UTC microseconds) lies in a span of the day.

    ``days``: days of the week on which it begins, 0 for Monday; none for all.
    """
    moment = datetime.fromtimestamp(now_us / MICROSECONDS, UTC)
    local = moment.astimezone(ZoneInfo(hours.time_zone))
    now, begins, ends = local.time(), hours.begins, hours.ends
    if begins < ends:
        begun = begins <= now < ends
        first = local
    else:  # over midnight: what is left of it belongs to the day before
        begun = now >= begins or now < ends
        first = local if now >= begins else local - timedelta(days=1)
    return begun and (not days or first.weekday() in days)
