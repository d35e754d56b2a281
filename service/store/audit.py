"""The audit trail: lines are added and read, never changed, as the database itself sees to."""

from dataclasses import asdict, fields

from sqlalchemy import Connection, insert, select

from service.store.access_tables import AuditRow
from service.store.deliveries import Delivery
from service.store.part import StorePart
from service.store.records import AuditEntry, AuditPage

_COLUMNS = tuple(getattr(AuditRow, field.name) for field in fields(AuditEntry))


def add_line(connection: Connection, entry: AuditEntry | None) -> None:
    """Write one line, if there is one, within the transaction of its change."""
    if entry is not None:
        connection.execute(insert(AuditRow).values(asdict(entry)))


class Audit(StorePart):
    """Who did what to what, when and from where."""

    def add(self, entry: AuditEntry, delivery: Delivery | None = None) -> None:
        """Write one line; what an outbox delivers again is known."""
        with self._writing_once(delivery) as connection:
            if connection is not None:
                add_line(connection, entry)

    def expire(self, before_us: int) -> int:
        """Remove lines from before a wall time that is more than a year ago; returns how many.

        The database refuses to give up younger ones.
        """
        return self._expire(AuditRow, before_us)

    def page(self, limit: int = 100, cursor: int | None = None) -> AuditPage:
        """Part of the trail, newest first."""
        rows, following = self._newest_first(
            select(AuditRow.id, *_COLUMNS), AuditRow.id, limit, cursor
        )
        return AuditPage(items=[AuditEntry(*row[1:]) for row in rows], next_cursor=following)
