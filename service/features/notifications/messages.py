"""What the messages say: JSON for a webhook, text for an e-mail."""

import base64
import hashlib
import hmac
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from email.charset import QP, Charset
from email.header import Header
from email.message import Message
from email.utils import format_datetime
from typing import Final

from service.alarms.records import assets_of, shortened
from service.alarms.states import UNACKNOWLEDGED_STATES
from service.clock import MICROSECONDS, rfc3339, wall_us
from service.documents.alarms import alarm_document
from service.domain.texts import visible
from service.features.notifications.documents import NotificationEvent, NotificationMessage
from service.features.notifications.rules import ESCALATED, RETURNED, kind_of
from service.features.notifications.tables import Notification
from service.store import Alarm

#: Alarms that an e-mail lists; of the others it says how many there are.
LISTED: Final = 50
#: Assets that it names of an alarm of several.
NAMED: Final = 20
_SUBJECT_MAX: Final = 150


@dataclass(frozen=True, slots=True)
class Item:
    """Events of one alarm that are sent together."""

    notification: Notification
    events: tuple[str, ...]

    @property
    def alarm(self) -> Alarm:
        """The alarm."""
        return self.notification.alarm

    @property
    def event_ids(self) -> list[str]:
        """By which a recipient knows an event again."""
        return [f"{self.alarm.id}:{event}" for event in self.events]


@dataclass(frozen=True, slots=True)
class OutgoingMessage:
    """What a recipient gets at one time.

    - ``section_id``: of the recipient in the configuration.
    - ``items``: none in a test.
    - ``name_of``: gives the name of an asset.
    - ``who``: who asked for the test.
    """

    section_id: str
    items: Sequence[Item]
    name_of: Callable[[str], str]
    who: str = ""

    @property
    def id(self) -> str:
        """The same for the same events, so that a recipient drops repetitions."""
        text = "\n".join([self.section_id, *(self.event_ids or ["test", self.who, str(wall_us())])])
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    @property
    def event_ids(self) -> list[str]:
        """Of all items."""
        return [event_id for one in self.items for event_id in one.event_ids]

    def document(self, message_id: str) -> NotificationMessage:
        """Give the body of a webhook."""
        return NotificationMessage(
            id=message_id,
            type="alarms" if self.items else "test",
            notification=self.section_id,
            sent_at=rfc3339(wall_us()),
            events=[
                NotificationEvent(
                    id=event_id,
                    event=kind_of(event),
                    asset_name=self._name(one.alarm),
                    alarm=alarm_document(one.alarm),
                )
                for one in self.items
                for event, event_id in zip(one.events, one.event_ids, strict=True)
            ],
        )

    def email(self, message_id: str, sender: str, recipients: Sequence[str]) -> Message:
        """Give the message of a mail server."""
        message: Message[str, str | Header] = Message()
        message.set_payload(self._text(), _utf8())
        message["From"] = sender
        message["To"] = ", ".join(recipients)
        subject = self._subject()
        # As a whole: where only a part is encoded, the line is folded with one blank too many.
        message["Subject"] = Header(subject, None if subject.isascii() else "utf-8")
        message["Date"] = format_datetime(datetime.now(UTC))
        message["Message-ID"] = f"<{message_id}@{sender.rpartition('@')[2]}>"
        message["Auto-Submitted"] = "auto-generated"
        return message

    def _subject(self) -> str:
        if not self.items:
            return f"Bearing Twin: test of {self.section_id}"
        first = min(self.items, key=_urgency)
        alarm = first.alarm
        name = self._name(alarm)
        text = f"{_what(first)}: {f'{name}, ' if name else ''}{alarm.message}"
        if len(self.items) > 1:
            machines = len({one for item in self.items for one in assets_of(item.alarm)})
            on = "1 machine" if machines == 1 else f"{machines} machines"
            text = f"{len(self.items)} alarms on {on}; {text}"
        line = " ".join(visible(f"Bearing Twin: {text}").split())
        return line if len(line) <= _SUBJECT_MAX else line[: _SUBJECT_MAX - 1] + "…"

    def _text(self) -> str:
        if not self.items:
            return (
                f"This is a test of the notification {self.section_id}, asked for by "
                f"{self.who}.\nIf you read it, alarms will reach you the same way.\n"
            )
        ordered = sorted(self.items, key=_urgency)
        blocks = [self._block(one) for one in ordered[:LISTED]]
        if len(ordered) > LISTED:
            blocks.append(f"... and {len(ordered) - LISTED} more; the page Alarms lists all.\n")
        end = f"-- \nBearing Twin, notification {self.section_id}; times are UTC.\n"
        return "\n".join([*blocks, end])

    def _name(self, alarm: Alarm) -> str | None:
        """Give the name of the asset of an alarm; None where it has several."""
        assets = assets_of(alarm)
        return self.name_of(assets[0]) if len(assets) == 1 else None

    def _block(self, item: Item) -> str:
        alarm = item.alarm
        assets = assets_of(alarm)
        where = f"{len(assets)} machines: {shortened(list(map(self.name_of, assets)), NAMED)}"
        if len(assets) == 1:
            where = f"{self.name_of(assets[0])} ({assets[0]})"
        lines = [
            f"{_what(item).upper()}  {where}, priority {alarm.priority}",
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
        return "\n".join(map(visible, lines)) + "\n"


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


def _utf8() -> Charset:
    """Text that stays readable where a mail is looked at as it came."""
    charset = Charset("utf-8")
    charset.body_encoding = QP
    return charset


def _what(item: Item) -> str:
    """Say what happened last."""
    kinds = [kind_of(event) for event in item.events]
    if kinds[-1] == RETURNED and len(kinds) > 1:
        return "raised and returned"
    return "nobody has acknowledged" if kinds[-1] == ESCALATED else kinds[-1]


def _urgency(item: Item) -> tuple[bool, int, int]:
    alarm = item.alarm
    return kind_of(item.events[-1]) == RETURNED, alarm.priority, -alarm.raised_at_us


def _moment(time_us: int) -> str:
    return f"{datetime.fromtimestamp(time_us / MICROSECONDS, UTC):%Y-%m-%d %H:%M:%S}"
