"""Who is told of alarms, and when nobody is."""

from typing import Literal

from pydantic import Field

from service.documents.base import Document, Page, Time


class NotificationDocument(Document):
    """One notification of the configuration, and how it is."""

    id: str = Field(examples=["control-room"])
    kind: Literal["email", "webhook"]
    receivers: list[str] = Field(
        description="Addresses; of a webhook its host.", examples=[["control-room@example.com"]]
    )
    priorities: list[int] = Field(description="Of alarms that are told.", examples=[[1, 2]])
    assets: list[str] = Field(description="Ids; empty: all.")
    families: list[str] = Field(description="Empty: all.")
    only_escalations: bool = Field(
        description="It is told only what another notification escalates to it."
    )
    quiet: bool = Field(description="Its quiet hours are now.")
    waiting: int = Field(ge=0, description="Alarms of which something has to be told.")
    held: int = Field(ge=0, description="Of these, held back by quiet hours or a silence.")
    told_at: Time | None = Field(
        description="Wall time of the last message that was taken; null: none since the start."
    )
    failing_since: Time | None = Field(
        description="Wall time of the first of the tries that have failed in a row; null: the last "
        "succeeded."
    )
    error: str | None = Field(
        description="What was wrong last, also with one of several addresses.",
        examples=["mail.example.com:587: Connection refused"],
    )


class NotificationList(Page):
    """Notifications in the order of the configuration."""

    items: list[NotificationDocument]


class NotificationTest(Document):
    """What came of a test message."""

    told: bool = Field(description="Whether it was taken, by one of the receivers at least.")
    detail: str | None = Field(description="Why not, or by whom not.")


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
    """A time in which nobody is told of alarms; they stand in all lists as ever."""

    id: str
    assets: list[str] = Field(description="Ids; empty: all.", examples=[["bench-1"]])
    begins_at: Time
    ends_at: Time
    weekly: WeeklyHours | None = Field(description="Only in these hours; null: all the time.")
    in_force: bool = Field(description="Whether nobody is told now.")
    who: str = Field(examples=["operator bt_1a2b3c4d"])
    comment: str = Field(examples=["bearing is being regreased"])


class SilenceList(Page):
    """Silences that are not over, the first to end first."""

    items: list[SilenceDocument]
