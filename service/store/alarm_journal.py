"""Open alarms, and the journal of everything that happened to them."""

from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from sqlalchemy import ColumnElement, Select, delete, exists, func, insert, select, update

from service.clock import DAY_US
from service.store.alarm_records import (
    Alarm,
    AlarmCount,
    AlarmJournalPage,
    AlarmTransition,
    Annunciations,
    JournalFilter,
)
from service.store.audit import add_line
from service.store.deliveries import Delivery
from service.store.errors import NotOwnerError
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import AlarmRow, AlarmTransitionRow

_ALARM_COLUMNS = tuple(getattr(AlarmRow, field.name) for field in fields(Alarm))
_JOURNAL_COLUMNS = tuple(
    getattr(AlarmTransitionRow, field.name) for field in fields(AlarmTransition)
)
_TEN_MINUTES_US = 600_000_000
_MOST_FREQUENT = 10
_EVERYTHING = JournalFilter()


class AlarmJournal(StorePart):
    """An alarm and the line in the journal that tells of its change are written together."""

    def save(
        self,
        alarm: Alarm | None,
        lines: Sequence[AlarmTransition] = (),
        delivery: Delivery | None = None,
        audit: AuditEntry | None = None,
    ) -> None:
        """Write an alarm as it is now, and what happened to it, in one transaction.

        Parameters
        ----------
        alarm : Alarm or None
            None writes lines alone: events that belong to no alarm.
        lines : sequence of AlarmTransition
            For the journal.
        delivery : Delivery, optional
            Of an outbox; what it delivers again is known.
        audit : AuditEntry, optional
            Line of the audit trail, where somebody asked for the change.

        Raises
        ------
        NotOwnerError
            If another cell has owned the asset since the change was recorded.
        """
        with self._writing_once(delivery) as connection:
            if connection is None:
                return
            asset = alarm.asset if alarm is not None else lines[0].asset if lines else None
            fence = self._database.fence
            if fence is not None and asset is not None:
                if delivery is None:
                    self._require(connection, asset)
                elif not fence.deliverable(connection, (asset,), delivery.run):
                    raise NotOwnerError(f"asset {asset}: another cell has owned it since")
            if alarm is not None:
                values = asdict(alarm)
                changed = connection.execute(
                    update(AlarmRow).where(AlarmRow.id == alarm.id).values(values)
                )
                if changed.rowcount == 0:
                    connection.execute(insert(AlarmRow).values(values))
            if lines:
                connection.execute(insert(AlarmTransitionRow), [asdict(line) for line in lines])
            add_line(connection, audit)

    def load(self) -> list[Alarm]:
        """All alarms that are not over (state other than NORM), oldest first."""
        query = (
            select(*_ALARM_COLUMNS)
            .where(AlarmRow.state != "NORM")
            .order_by(AlarmRow.raised_at_us, AlarmRow.id)
        )
        with self._database.reading() as connection:
            return [Alarm(**row._mapping) for row in connection.execute(query)]

    def journal(
        self,
        wanted: JournalFilter = _EVERYTHING,
        limit: int = 100,
        cursor: int | None = None,
    ) -> AlarmJournalPage:
        """Part of the journal, newest first.

        Parameters
        ----------
        wanted : JournalFilter
            Which lines.
        limit : int
            Lines at most.
        cursor : int, optional
            `AlarmJournalPage.next_cursor` of the page before.
        """
        query = select(AlarmTransitionRow.id, *_JOURNAL_COLUMNS).where(*_conditions(wanted))
        rows, following = self._newest_first(query, AlarmTransitionRow.id, limit, cursor)
        return AlarmJournalPage(
            items=[AlarmTransition(*row[1:]) for row in rows], next_cursor=following
        )

    def expire(self, before_us: int) -> int:
        """Remove lines from before a process time, and alarms that were over by then.

        Returns
        -------
        int
            Rows that were removed.
        """
        removed = self._expire(AlarmTransitionRow, before_us)
        with self._database.writing() as connection:
            over = delete(AlarmRow).where(
                AlarmRow.state == "NORM",
                AlarmRow.since_us < before_us,
                ~exists().where(AlarmTransitionRow.alarm_id == AlarmRow.id),
            )
            return removed + connection.execute(over).rowcount

    def annunciations(self, now_us: int, asset: str | None = None) -> Annunciations:
        """Count how often alarms called for an operator in the last day.

        Parameters
        ----------
        now_us : int
            Process time, UTC microseconds.
        asset : str, optional
            Only of this asset.
        """
        line = AlarmTransitionRow
        calls = [
            *_conditions(JournalFilter(asset, start_us=now_us - DAY_US + 1, end_us=now_us + 1)),
            line.to_state == "UNACK",
            line.from_state != "UNACK",
        ]
        ago = ((now_us - line.time_us) // _TEN_MINUTES_US).label("ago")
        with self._database.reading() as connection:

            def counted(query: Select[Any, int]) -> dict[int, int]:
                return {int(what): int(count) for what, count in connection.execute(query)}

            spans = counted(select(ago, func.count()).where(*calls).group_by("ago"))
            priorities = counted(
                select(line.priority, func.count())
                .where(*calls, line.priority.is_not(None))
                .group_by(line.priority)
            )
            count = func.count().label("count")
            frequent = connection.execute(
                select(line.kind, line.channel, count)
                .where(*calls)
                .group_by(line.kind, line.channel)
                .order_by(count.desc(), line.kind, line.channel)
                .limit(_MOST_FREQUENT)
            ).all()
        return Annunciations(
            in_last_10_min=spans.get(0, 0),
            in_last_24_h=sum(spans.values()),
            most_in_10_min=max(spans.values(), default=0),
            by_priority=priorities,
            most_frequent=[AlarmCount(*row) for row in frequent],
        )


def _conditions(wanted: JournalFilter) -> list[ColumnElement[bool]]:
    line = AlarmTransitionRow
    conditions: list[ColumnElement[bool]] = []
    if wanted.asset is not None:
        conditions.append(line.asset == wanted.asset)
    if wanted.alarm_id is not None:
        conditions.append(line.alarm_id == wanted.alarm_id)
    if wanted.start_us is not None:
        conditions.append(line.time_us >= wanted.start_us)
    if wanted.end_us is not None:
        conditions.append(line.time_us < wanted.end_us)
    if wanted.events is not None:
        conditions.append(line.alarm_id.is_(None) if wanted.events else line.alarm_id.is_not(None))
    return conditions
