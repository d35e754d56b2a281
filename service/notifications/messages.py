"""What the messages say: JSON for a webhook, text for an e-mail."""

import base64
import hashlib
import hmac
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from email.message import EmailMessage
from email.utils import format_datetime
from typing import Final, Literal

from pydantic import Field

from service.alarms.states import UNACKNOWLEDGED_STATES
from service.clock import MICROSECONDS, rfc3339, wall_us
from service.documents.alarms import AlarmDocument, alarm_document
from service.documents.base import Document, Time
from service.notifications.rules import ESCALATED, RETURNED, kind_of
from service.store import Alarm, Telling

#: Alarms that an e-mail lists; of the others it says how many there are.
LISTED: Final = 50
_SUBJECT_MAX: Final = 150


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
    asset_name: str = Field(description="What the pages call the asset.")
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


@dataclass(frozen=True, slots=True)
class Item:
    """Events of one alarm that are told together."""

    telling: Telling
    events: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Letter:
    """What is handed to a receiver in one go.

    Attributes
    ----------
    notification
        Its id.
    items
        What is told; nothing in a test.
    name_of
        Gives the name of an asset.
    who
        Who asked for the test.
    """

    notification: str
    items: Sequence[Item]
    name_of: Callable[[str], str]
    who: str = ""

    @property
    def id(self) -> str:
        """The same for the same events, so that it is known when it comes again."""
        names = [f"{one.telling.alarm.id}:{event}" for one in self.items for event in one.events]
        text = "\n".join([self.notification, *(names or ["test", self.who, str(wall_us())])])
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def document(self, message_id: str) -> NotificationMessage:
        """Give the body of a webhook."""
        return NotificationMessage(
            id=message_id,
            type="alarms" if self.items else "test",
            notification=self.notification,
            sent_at=rfc3339(wall_us()),
            events=[
                NotificationEvent(
                    id=f"{one.telling.alarm.id}:{event}",
                    event=kind_of(event),
                    asset_name=self.name_of(one.telling.alarm.asset),
                    alarm=alarm_document(one.telling.alarm),
                )
                for one in self.items
                for event in one.events
            ],
        )

    def email(self, message_id: str, sender: str, recipients: Sequence[str]) -> EmailMessage:
        """Give the message of a mail server."""
        message = EmailMessage()
        message["From"] = sender
        message["To"] = ", ".join(recipients)
        message["Subject"] = self._subject()
        message["Date"] = format_datetime(datetime.now(UTC))
        message["Message-ID"] = f"<{message_id}@{sender.rpartition('@')[2]}>"
        message["Auto-Submitted"] = "auto-generated"
        message.set_content(self._text())
        return message

    def _subject(self) -> str:
        if not self.items:
            return f"Bearing Twin: test of {self.notification}"
        first = min(self.items, key=_urgency)
        alarm = first.telling.alarm
        text = f"{_what(first)}: {self.name_of(alarm.asset)}, {alarm.message}"
        if len(self.items) > 1:
            machines = len({one.telling.alarm.asset for one in self.items})
            on = "1 machine" if machines == 1 else f"{machines} machines"
            text = f"{len(self.items)} alarms on {on}; {text}"
        line = " ".join(f"Bearing Twin: {text}".split())
        return line if len(line) <= _SUBJECT_MAX else line[: _SUBJECT_MAX - 1] + "…"

    def _text(self) -> str:
        if not self.items:
            return (
                f"This is a test of the notification {self.notification}, asked for by "
                f"{self.who}.\nIf you read it, alarms will reach you the same way.\n"
            )
        ordered = sorted(self.items, key=_urgency)
        blocks = [self._block(one) for one in ordered[:LISTED]]
        if len(ordered) > LISTED:
            blocks.append(f"... and {len(ordered) - LISTED} more; the page Alarms lists all.\n")
        end = f"-- \nBearing Twin, notification {self.notification}; times are UTC.\n"
        return "\n".join([*blocks, end])

    def _block(self, item: Item) -> str:
        alarm = item.telling.alarm
        lines = [
            f"{_what(item).upper()}  {self.name_of(alarm.asset)} ({alarm.asset}), "
            f"priority {alarm.priority}",
            f"  {alarm.message}",
            f"  {alarm.kind}, raised {_moment(alarm.raised_at_us or alarm.since_us)}",
        ]
        if alarm.value is not None:
            unit = alarm.unit or ""
            limit = "" if alarm.limit_value is None else f", limit {alarm.limit_value:.1f} {unit}"
            lines.append(f"  value {alarm.value:.1f} {unit}{limit}".rstrip())
        if alarm.returned_at_us is not None and not alarm.present:
            lines.append(f"  returned {_moment(alarm.returned_at_us)}")
        if alarm.acknowledged_by:
            lines.append(f"  acknowledged by {alarm.acknowledged_by}")
        elif alarm.state in UNACKNOWLEDGED_STATES:
            lines.append("  nobody has acknowledged it")
        return "\n".join(lines) + "\n"


def signature_headers(message_id: str, body: bytes, key: bytes | None) -> Mapping[str, str]:
    """Give the headers of a webhook after the Standard Webhooks specification.

    Parameters
    ----------
    message_id
        Of the message.
    body
        Its JSON text.
    key
        Signs it with HMAC-SHA256; None: no signature.
    """
    timestamp = str(wall_us() // MICROSECONDS)
    headers = {"webhook-id": message_id, "webhook-timestamp": timestamp}
    if key is not None:
        signed = b".".join((message_id.encode(), timestamp.encode(), body))
        digest = hmac.new(key, signed, hashlib.sha256).digest()
        headers["webhook-signature"] = f"v1,{base64.b64encode(digest).decode()}"
    return headers


def _what(item: Item) -> str:
    """Say what happened last."""
    kinds = [kind_of(event) for event in item.events]
    if kinds[-1] == RETURNED and len(kinds) > 1:
        return "raised and returned"
    return "nobody has acknowledged" if kinds[-1] == ESCALATED else kinds[-1]


def _urgency(item: Item) -> tuple[bool, int, int]:
    alarm: Alarm = item.telling.alarm
    return kind_of(item.events[-1]) == RETURNED, alarm.priority, -alarm.raised_at_us


def _moment(time_us: int) -> str:
    return f"{datetime.fromtimestamp(time_us / MICROSECONDS, UTC):%Y-%m-%d %H:%M:%S}"
