"""Changes that the store did not take: where they are seen, and what of them can be repeated."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

from sqlalchemy import Connection, delete, exists, insert, select

from service.clock import wall_us
from service.store.alarm_records import AlarmTransition
from service.store.audit import add_line
from service.store.changes import (
    AlarmChange,
    Change,
    assets_of,
    change_of,
)
from service.store.deliveries import Delivery
from service.store.errors import StoreError
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import (
    AlarmRow,
    AlarmTransitionRow,
    RefusedChangeRow,
)

#: Why a change of a run that does not own its assets is refused.
NOT_OWNED: Final = "another cell has owned the asset since"
KIND: Final = "change not taken"
SERVICE: Final = "service"
_REASON_MAX: Final = 500

_COLUMNS = (
    RefusedChangeRow.id,
    RefusedChangeRow.time_us,
    RefusedChangeRow.sender,
    RefusedChangeRow.assets,
    RefusedChangeRow.summary,
    RefusedChangeRow.reason,
    RefusedChangeRow.document,
)


@dataclass(frozen=True, slots=True)
class Refused:
    """A change that is not taken; None for one that this version cannot read."""

    change: Change | None
    document: str
    reason: str
    delivery: Delivery | None


@dataclass(frozen=True, slots=True)
class RefusedChange:
    """A change as it is kept; ``time_us`` is when it was refused, on the wall clock."""

    id: int
    time_us: int
    sender: str
    assets: str
    summary: str
    reason: str
    document: str


class RefusedChanges(StorePart):
    """What the outboxes delivered and the store did not take.

    Each stands here with its document, in the audit trail, and in the journal of its assets.
    """

    def add(self, refused: Refused) -> None:
        """Keep a change that was refused as a whole; what an outbox delivers again is known."""
        with self._writing_once(refused.delivery) as connection:
            if connection is not None:
                _add(connection, refused)

    def add_within(self, connection: Connection, refused: Refused) -> None:
        """Keep a part of a change within the transaction that writes the rest of it."""
        _add(connection, refused)

    def list(self, limit: int = 1000) -> list[RefusedChange]:
        """Those that are kept, oldest first."""
        query = select(*_COLUMNS).order_by(RefusedChangeRow.id).limit(limit)
        with self._database.reading() as connection:
            return [RefusedChange(*row) for row in connection.execute(query)]

    def repeat(self, number: int, who: str) -> str:
        """Write the records of a change, and remove it from the list; returns what was written.

        Records are lines of the journal and of the audit trail, and forecasts: what happened. A
        state, of an alarm or of its notifications, comes from the owner of the asset alone. Raises
        `StoreError` if there is no such change, or this version cannot read it.
        """
        row = RefusedChangeRow
        with self._database.writing() as connection:
            document = connection.scalar(select(row.document).where(row.id == number))
            if document is None:
                raise StoreError(f"refused change {number}: not known; expected one of the list")
            change = change_of(document)
            if change is None:
                raise StoreError(f"refused change {number}: this version cannot read it")
            written = _repeat(connection, change)
            connection.execute(delete(row).where(row.id == number))
            _trail(connection, who, "change.repeat", str(number), written)
        return written

    def expire(self, before_us: int) -> int:
        """Remove changes that were refused before a wall time; returns how many."""
        with self._database.writing() as connection:
            old = delete(RefusedChangeRow).where(RefusedChangeRow.time_us < before_us)
            return connection.execute(old).rowcount


def one_line(error: BaseException) -> str:
    """Say what an error is, in one line of ASCII characters: every database takes it."""
    cause = getattr(error, "orig", None) or error
    text = " ".join(f"{type(cause).__name__}: {cause}".split())
    return text.encode("ascii", "backslashreplace").decode().replace("\0", "\\0")[:_REASON_MAX]


def _add(connection: Connection, refused: Refused) -> None:
    change, delivery = refused.change, refused.delivery
    assets, now_us = assets_of(change), wall_us()
    summary = _summary(change)
    connection.execute(
        insert(RefusedChangeRow).values(
            time_us=now_us,
            sender="" if delivery is None else f"{delivery.sender} {delivery.number}",
            assets=", ".join(assets),
            summary=summary,
            reason=refused.reason,
            document=refused.document,
        )
    )
    message = f"Not taken: {summary} ({refused.reason})"
    lines = [_event(asset, _time_us(change) or now_us, message) for asset in assets]
    if lines:
        connection.execute(insert(AlarmTransitionRow), lines)
    _trail(connection, SERVICE, "change.refuse", ", ".join(assets), message)


def _repeat(connection: Connection, change: Change) -> str:
    if isinstance(change, AuditEntry):
        add_line(connection, change)
        return "a line of the audit trail"
    if isinstance(change, AlarmChange):
        lines = [asdict(_of_known_alarm(connection, line)) for line in change.lines]
        if lines:
            connection.execute(insert(AlarmTransitionRow), lines)
        add_line(connection, change.audit)
        return f"{len(lines)} lines of the journal"
    return change.repeat(connection)


def _of_known_alarm(connection: Connection, line: AlarmTransition) -> AlarmTransition:
    known = connection.scalar(select(exists().where(AlarmRow.id == line.alarm_id)))
    return line if known else replace(line, alarm_id=None)


def _summary(change: Change | None) -> str:
    """Say what a change is without any text of a user, which may be what the store refuses."""
    if isinstance(change, AlarmChange):
        events = [line.event or line.kind for line in change.lines]
        state = "" if change.alarm is None else f", then {change.alarm.state}"
        return f"alarm: {', '.join(events) or 'no event'}{state}"
    if isinstance(change, AuditEntry):
        return "a line of the audit trail"
    return "a change that cannot be read" if change is None else change.summary


def _time_us(change: Change | None) -> int | None:
    """Process time of an alarm's change; None for others."""
    if not isinstance(change, AlarmChange):
        return None
    times: Sequence[int] = [line.time_us for line in change.lines]
    return max(times, default=None if change.alarm is None else change.alarm.since_us)


def _event(asset: str, time_us: int, message: str) -> dict[str, object]:
    return asdict(
        AlarmTransition(None, asset, KIND, "", "", time_us, "", "", SERVICE, "", None, message)
    )


def _trail(connection: Connection, who: str, action: str, target: str, detail: str) -> None:
    add_line(connection, AuditEntry(wall_us(), who, "", action, target, detail))
