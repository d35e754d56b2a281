"""Silences of the alarms' notifications."""

from typing import Literal

from pydantic import Field

from service.documents.base import Document, Page, Time


class WeeklyHours(Document):
    """When a silence on a schedule is in force."""

    days: list[Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]] = Field(
        description="Days on which it begins; empty: all.", examples=[["sat", "sun"]]
    )
    begins: str = Field(description="Time of the day.", examples=["22:00"])
    ends: str = Field(
        description="Time of the day, of the next day where it is not later than `begins`.",
        examples=["06:00"],
    )
    time_zone: str = Field(examples=["Europe/Berlin"])


class SilenceDocument(Document):
    """A time without notifications of alarms; the alarms stay in all lists."""

    id: str
    assets: list[str] = Field(description="Ids; empty: all.", examples=[["bench-1"]])
    begins_at: Time
    ends_at: Time
    weekly: WeeklyHours | None = Field(description="Only in these hours; null: all the time.")
    in_force: bool = Field(description="Whether it applies now.")
    who: str = Field(examples=["operator bt_1a2b3c4d"])
    comment: str = Field(examples=["bearing is being regreased"])


class SilenceList(Page):
    """Silences that are not over, the first to end first."""

    items: list[SilenceDocument]


class EndedSilences(Document):
    """Silences that were ended, and ids of which there was none."""

    ended: list[str]
    unknown: list[str]
