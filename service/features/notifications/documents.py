"""Notifications of alarms, and what a webhook gets."""

from typing import Literal

from pydantic import Field

from service.documents.alarms import AlarmDocument
from service.documents.base import Document, Page, Time


class NotificationDocument(Document):
    """One notification of the configuration, and how it is."""

    id: str = Field(examples=["control-room"])
    kind: Literal["email", "webhook"]
    receivers: list[str] = Field(
        description="Addresses; of a webhook its host.", examples=[["control-room@example.com"]]
    )
    priorities: list[int] = Field(description="Of the alarms that are sent.", examples=[[1, 2]])
    assets: list[str] = Field(description="Ids; empty: all.")
    families: list[str] = Field(description="Empty: all.")
    only_escalations: bool = Field(
        description="It sends only what another notification escalates to it."
    )
    quiet: bool = Field(description="Its quiet hours are now.")
    waiting: int = Field(ge=0, description="Alarms with a notification to be sent.")
    held: int = Field(ge=0, description="Of these, held back by quiet hours or a silence.")
    told_at: Time | None = Field(
        description="Wall time of the last message that was accepted; null: none since the start."
    )
    failing_since: Time | None = Field(
        description="Wall time of the first of the tries that have failed in a row; null: the last "
        "succeeded."
    )
    error: str | None = Field(
        description="What was wrong last, also with one of several addresses.",
        examples=["mail.example.com:587: Connection refused"],
    )
    given_up: int = Field(
        ge=0,
        description="Alarms of which the receiver refused a message for good, since the start; the "
        "journal names them.",
    )


class NotificationList(Page):
    """Notifications in the order of the configuration."""

    items: list[NotificationDocument]


class NotificationTest(Document):
    """Whether a test message was accepted."""

    told: bool = Field(description="Whether at least one recipient accepted it.")
    detail: str | None = Field(description="Why not, or by whom not.")


class NotificationEvent(Document):
    """One thing that happened to an alarm."""

    id: str = Field(
        description="The same whenever the event comes again: by it a receiver drops repetitions.",
        examples=["5d0c9a3e7b1f4e2a9c8d7e6f5a4b3c2d:raised:1"],
    )
    event: Literal["raised", "returned", "acknowledged", "escalated"] = Field(
        description="`returned`: the alarm is gone or was set aside. `escalated`: nobody has "
        "acknowledged it."
    )
    asset_name: str | None = Field(
        description="What the pages call the asset; null for an alarm of several."
    )
    alarm: AlarmDocument


class NotificationMessage(Document):
    """What a webhook gets."""

    id: str = Field(description="Of this set of events; header `webhook-id`.")
    type: Literal["alarms", "test"]
    notification: str = Field(
        description="Its `id` in the configuration.", examples=["control-room"]
    )
    sent_at: Time = Field(description="Wall time.")
    events: list[NotificationEvent] = Field(description="Oldest first; none in a test.")
