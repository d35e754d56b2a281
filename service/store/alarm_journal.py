"""Alarms that are not over, and the journal of everything that happened to them."""

from collections.abc import Sequence
from dataclasses import asdict, fields

from sqlalchemy import insert, select, update

from service.store.records import Alarm, AlarmJournalPage, AlarmTransition
from service.store.section import Section
from service.store.tables import AlarmRow, AlarmTransitionRow

_ALARM_COLUMNS = tuple(getattr(AlarmRow, field.name) for field in fields(Alarm))
_JOURNAL_COLUMNS = tuple(
    getattr(AlarmTransitionRow, field.name) for field in fields(AlarmTransition)
)


class AlarmJournal(Section):
    """An alarm and the line in the journal that tells of its change are written together."""

    def save_alarm(self, alarm: Alarm, transitions: Sequence[AlarmTransition] = ()) -> None:
        """Write an alarm as it is now, and what happened to it, in one transaction."""
        values = asdict(alarm)
        with self._database.writing() as connection:
            changed = connection.execute(
                update(AlarmRow).where(AlarmRow.id == alarm.id).values(values)
            )
            if changed.rowcount == 0:
                connection.execute(insert(AlarmRow).values(values))
            if transitions:
                connection.execute(insert(AlarmTransitionRow), [asdict(one) for one in transitions])

    def load_alarms(self) -> list[Alarm]:
        """All alarms that are not over (state other than NORM), oldest first."""
        query = (
            select(*_ALARM_COLUMNS)
            .where(AlarmRow.state != "NORM")
            .order_by(AlarmRow.raised_at_us, AlarmRow.id)
        )
        with self._database.reading() as connection:
            return [Alarm(**row._mapping) for row in connection.execute(query)]

    def alarm_journal(
        self,
        start_us: int | None = None,
        end_us: int | None = None,
        limit: int = 100,
        cursor: int | None = None,
    ) -> AlarmJournalPage:
        """Part of the journal, newest first.

        Parameters
        ----------
        start_us, end_us : int, optional
            Process time, UTC microseconds; the start is included, the end is not.
        limit : int
            Lines at most.
        cursor : int, optional
            `AlarmJournalPage.next_cursor` of the page before.
        """
        query = select(AlarmTransitionRow.id, *_JOURNAL_COLUMNS).order_by(
            AlarmTransitionRow.id.desc()
        )
        if start_us is not None:
            query = query.where(AlarmTransitionRow.time_us >= start_us)
        if end_us is not None:
            query = query.where(AlarmTransitionRow.time_us < end_us)
        if cursor is not None:
            query = query.where(AlarmTransitionRow.id < cursor)
        with self._database.reading() as connection:
            rows = connection.execute(query.limit(limit + 1)).all()
        more = len(rows) > limit
        rows = rows[:limit]
        return AlarmJournalPage(
            items=[AlarmTransition(*row[1:]) for row in rows],
            next_cursor=rows[-1][0] if more else None,
        )
