"""Open alarms, and the journal of everything that happened to them."""

from collections.abc import Collection, Sequence
from dataclasses import asdict, fields
from typing import Any

import structlog
from sqlalchemy import (
    ColumnElement,
    Connection,
    Select,
    delete,
    exists,
    func,
    insert,
    or_,
    select,
    update,
)

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
from service.store.part import StorePart, rows_of
from service.store.records import AuditEntry
from service.store.tables import AlarmRow, AlarmTransitionRow, names

_ALARM_COLUMNS = tuple(getattr(AlarmRow, field.name) for field in fields(Alarm))
_JOURNAL_COLUMNS = tuple(
    getattr(AlarmTransitionRow, field.name) for field in fields(AlarmTransition)
)
_TEN_MINUTES_US = 600_000_000
_MOST_FREQUENT = 10
_EVERYTHING = JournalFilter()
_CONDITION = ("asset", "kind", "channel", "level")
_UNKNOWN = "the owner of the asset does not know it"

_log = structlog.get_logger(__name__)


class AlarmJournal(StorePart):
    """An alarm and the line in the journal for its change are written together."""

    def save(
        self,
        alarm: Alarm | None,
        lines: Sequence[AlarmTransition] = (),
        delivery: Delivery | None = None,
        audit: AuditEntry | None = None,
    ) -> None:
        """Write an alarm as it is now, and what happened to it, in one transaction.

        Who writes it owns its asset: another alarm of the same condition that is still open in the
        store is one that the owner does not know, and is closed. Without an alarm it writes lines
        alone. What ``delivery`` delivers again is known. Raises `NotOwnerError` if another cell has
        owned the asset since the change was recorded.
        """
        with self._writing_once(delivery) as connection:
            if connection is None:
                return
            # The lines of events may be of several assets.
            assets = {line.asset for line in lines} | ({alarm.asset} if alarm else set())
            others = assets - self._ours(connection, assets, delivery)
            if others:
                raise NotOwnerError(
                    f"asset {min(others)}: another cell owns it"
                    + (" or has owned it since" if delivery else "")
                )
            if alarm is not None:
                _close_unknown(connection, alarm)
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
        """Part of the journal, newest first."""
        query = select(AlarmTransitionRow.id, *_JOURNAL_COLUMNS).where(*_conditions(wanted))
        rows, following = self._newest_first(query, AlarmTransitionRow.id, limit, cursor)
        lines = [AlarmTransition(*row[1:]) for row in rows]
        ids = {line.alarm_id for line in lines if line.alarm_id is not None}
        units = select(AlarmRow.id, AlarmRow.unit).where(AlarmRow.unit.is_not(None))
        with self._database.reading() as connection:
            return AlarmJournalPage(
                lines, following, dict(rows_of(connection, AlarmRow.id, units, ids))
            )

    def newest_events(self, kind: str, assets: Collection[str]) -> dict[str, int]:
        """Process time of the newest event of a kind, by asset, of those that have any."""
        query = (
            select(AlarmTransitionRow.asset, func.max(AlarmTransitionRow.time_us))
            .where(AlarmTransitionRow.alarm_id.is_(None), AlarmTransitionRow.kind == kind)
            .group_by(AlarmTransitionRow.asset)
        )
        with self._database.reading() as connection:
            rows = rows_of(connection, AlarmTransitionRow.asset, query, assets)
            return {asset: int(time_us) for asset, time_us in rows}

    def expire(self, before_us: int) -> int:
        """Remove lines from before a process time, and alarms that were over by then."""
        removed = self._expire(AlarmTransitionRow, before_us)
        with self._database.writing() as connection:
            over = delete(AlarmRow).where(
                AlarmRow.state == "NORM",
                AlarmRow.since_us < before_us,
                ~exists().where(AlarmTransitionRow.alarm_id == AlarmRow.id),
            )
            return removed + connection.execute(over).rowcount

    def annunciations(self, now_us: int, asset: str | None = None) -> Annunciations:
        """Count how often alarms called for an operator in the last day."""
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


def _close_unknown(connection: Connection, alarm: Alarm) -> None:
    """Close an open alarm of the same condition that the owner, who writes this one, does not know.

    A condition has one alarm. The row is left from a copy of the database, or from a change that
    was not taken.
    """
    row = AlarmRow
    same = [getattr(row, name) == getattr(alarm, name) for name in _CONDITION]
    unknown = (row.state != "NORM", row.id != alarm.id)
    left = connection.execute(select(*_ALARM_COLUMNS).where(*same, *unknown)).all()
    for found in left:
        known = Alarm(**found._mapping)
        _log.warning("alarm_closed", asset=known.asset, alarm=known.id, reason=_UNKNOWN)
        over = {"state": "NORM", "since_us": alarm.since_us, "present": False}
        connection.execute(update(row).where(row.id == known.id).values(over))
        line = AlarmTransition(
            alarm_id=known.id,
            asset=known.asset,
            kind=known.kind,
            channel=known.channel,
            level=known.level,
            time_us=alarm.since_us,
            from_state=known.state,
            to_state="NORM",
            who="service",
            comment=_UNKNOWN,
            value=known.value,
            message=known.message,
            event="withdraw",
            priority=known.priority,
        )
        connection.execute(insert(AlarmTransitionRow).values(asdict(line)))


def _conditions(wanted: JournalFilter) -> list[ColumnElement[bool]]:
    line = AlarmTransitionRow
    conditions: list[ColumnElement[bool]] = []
    if wanted.asset is not None:
        # An alarm of several: its whole history, also from before it was about this one.
        about = select(AlarmRow.id).where(names(AlarmRow.assets, wanted.asset))
        conditions.append(
            or_(
                line.asset == wanted.asset,
                names(line.assets, wanted.asset),
                line.alarm_id.in_(about),
            )
        )
    if wanted.alarm_id is not None:
        conditions.append(line.alarm_id == wanted.alarm_id)
    if wanted.start_us is not None:
        conditions.append(line.time_us >= wanted.start_us)
    if wanted.end_us is not None:
        conditions.append(line.time_us < wanted.end_us)
    if wanted.events is not None:
        conditions.append(line.alarm_id.is_(None) if wanted.events else line.alarm_id.is_not(None))
    return conditions
