"""What was changed of alarms: setpoints, delays, priorities and texts, with every earlier state."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, func, insert, select, text

from service.domain.alarm_guidance import AlarmName
from service.domain.errors import ChangedMeanwhileError
from service.store.audit import add_line
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import AlarmSettingRow

_COLUMNS = (
    AlarmSettingRow.id,
    AlarmSettingRow.revision,
    AlarmSettingRow.asset,
    AlarmSettingRow.kind,
    AlarmSettingRow.channel,
    AlarmSettingRow.level,
    AlarmSettingRow.before,
    AlarmSettingRow.after,
    AlarmSettingRow.who,
    AlarmSettingRow.at_us,
    AlarmSettingRow.comment,
)


@dataclass(frozen=True, slots=True)
class AlarmSettingChange:
    """A change of what one alarm has otherwise than the configuration says.

    - ``revision``: the same for all changes of one transaction, greater than all before.
    - ``before``, ``after``: fields that differ from the configuration, by name.
    - ``who``, ``at_us``, ``comment``: who changed it, when (UTC microseconds), and why.
    """

    id: int
    revision: int
    asset: str
    name: AlarmName
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    who: str
    at_us: int
    comment: str


@dataclass(frozen=True, slots=True)
class AlarmSettingPage:
    """Changes of alarm settings, newest first."""

    items: Sequence[AlarmSettingChange]
    next_cursor: int | None


class AlarmOverlays(StorePart):
    """Changes of alarm settings; none is ever removed, and the latest of an alarm holds."""

    def revision(self) -> int:
        """Give the latest revision; 0 before the first."""
        with self._database.reading() as connection:
            return _revision(connection)

    def present(
        self, assets: Collection[str] | None = None, until_us: int | None = None
    ) -> dict[str, dict[AlarmName, dict[str, Any]]]:
        """Give what differs from the configuration, by asset and alarm.

        ``until_us``: as it was at this time, UTC microseconds; None: as it is.
        """
        row = AlarmSettingRow
        latest = select(func.max(row.id)).group_by(row.asset, row.kind, row.channel, row.level)
        if until_us is not None:
            latest = latest.where(row.at_us <= until_us)
        query = select(*_COLUMNS).where(row.id.in_(latest))
        if assets is not None and len(assets) == 1:
            query = query.where(row.asset.in_(assets))
        found: dict[str, dict[AlarmName, dict[str, Any]]] = {}
        with self._database.reading() as connection:
            rows = connection.execute(query).all()
        for one in rows:
            if one.after and (assets is None or one.asset in assets):
                name = (one.kind, one.channel, one.level)
                found.setdefault(one.asset, {})[name] = dict(one.after)
        return found

    def changed_since(self, revision: int) -> tuple[int, set[str]]:
        """Give the latest revision, and the assets that changed after another one."""
        query = select(AlarmSettingRow.asset).where(AlarmSettingRow.revision > revision).distinct()
        with self._database.reading() as connection:
            latest = _revision(connection)
            return latest, set(connection.scalars(query)) if latest > revision else set()

    def change(
        self,
        changes: Mapping[tuple[str, AlarmName], Mapping[str, Any]],
        line: AuditEntry,
        comment: str,
        based_on: int,
    ) -> int:
        """Write all changes and the line of the audit trail in one transaction.

        ``changes`` are what differs from the configuration from now on, ``based_on`` is the
        revision that they were made of. Returns the new revision. Raises `ChangedMeanwhileError` if
        there is a later revision; nothing is written.
        """
        with self._database.writing() as connection:
            if connection.dialect.name == "postgresql":
                # Revisions are seen in their order: no reader knows the later of two first.
                connection.execute(text("LOCK TABLE alarm_settings IN EXCLUSIVE MODE"))
            newest = _revision(connection)
            if newest != based_on:
                raise ChangedMeanwhileError(
                    "alarm settings were changed meanwhile; read them again, then change them"
                )
            rows = [
                {
                    "revision": newest + 1,
                    "asset": asset,
                    "kind": name[0],
                    "channel": name[1],
                    "level": name[2],
                    "before": _latest(connection, asset, name),
                    "after": dict(after),
                    "who": line.who,
                    "at_us": line.time_us,
                    "comment": comment,
                }
                for (asset, name), after in changes.items()
            ]
            if rows:
                connection.execute(insert(AlarmSettingRow), rows)
            add_line(connection, line)
        return newest + 1

    def history(
        self, limit: int, cursor: int | None = None, asset: str | None = None
    ) -> AlarmSettingPage:
        """Part of the changes, of one asset or of all, the latest first."""
        query = select(*_COLUMNS)
        if asset is not None:
            query = query.where(AlarmSettingRow.asset == asset)
        rows, following = self._newest_first(query, AlarmSettingRow.id, limit, cursor)
        return AlarmSettingPage([_change(row) for row in rows], following)


def _revision(connection: Connection) -> int:
    return connection.scalar(select(func.max(AlarmSettingRow.revision))) or 0


def _latest(connection: Connection, asset: str, name: AlarmName) -> dict[str, Any]:
    kind, channel, level = name
    query = (
        select(AlarmSettingRow.after)
        .where(
            AlarmSettingRow.asset == asset,
            AlarmSettingRow.kind == kind,
            AlarmSettingRow.channel == channel,
            AlarmSettingRow.level == level,
        )
        .order_by(AlarmSettingRow.id.desc())
        .limit(1)
    )
    return dict(connection.scalar(query) or {})


def _change(row: Row[*tuple[Any, ...]] | Sequence[Any]) -> AlarmSettingChange:
    number, revision, asset, kind, channel, level, before, after, who, at_us, comment = row
    name = (kind, channel, level)
    return AlarmSettingChange(number, revision, asset, name, before, after, who, at_us, comment)
