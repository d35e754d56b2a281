"""Runs of the machines, from start to standstill, with their names; and annotations.

Runs are found in the stored speed whenever somebody asks for them: what came late, from an import
or after an outage, is in the next answer. What people gave, names and annotations, is kept.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import ColumnElement, Connection, delete, func, insert, select, update

from service.clock import HOUR_US, MICROSECONDS, MINUTE_US
from service.domain.channels import SPEED
from service.features.runs.tables import AnnotationRow, RunRow
from service.store.audit import add_line
from service.store.database import Database
from service.store.history import History
from service.store.part import StorePart
from service.store.records import AuditEntry, Rollup
from service.store.tables import ChannelRow, RollupRow, StaleRollupRow
from twin_core.runs import TURNS_RPM, Ended, RunSpan, Stretch, find_runs

_COARSE_US: Final = 10 * MINUTE_US
_MOST_BUCKETS: Final = 10_000_000
#: Spans that are both above and below the threshold, of which the minutes are remembered.
_REMEMBERED: Final = 20_000


@dataclass(frozen=True, slots=True)
class Run:
    """A run of a machine (process time, microseconds).

    - ``id``: its start when it was first found; it stays when late data move the start.
    - ``end_us``: None while it goes on.
    - ``ended``: how: "standstill", or "no data" where it is unknown; empty while it goes on.
    """

    asset: str
    id: str
    start_us: int
    end_us: int | None
    ended: Ended
    name: str = ""
    named_by: str = ""

    def covers(self, time_us: int) -> bool:
        """Whether a time lies in it."""
        return self.start_us <= time_us and (self.end_us is None or time_us <= self.end_us)


@dataclass(frozen=True, slots=True)
class RunPage:
    """Runs, newest first; ``next_cursor`` is None on the last page."""

    items: Sequence[Run]
    next_cursor: int | None


@dataclass(frozen=True, slots=True)
class Annotation:
    """What somebody noted at a moment of an asset's history (process time)."""

    id: str
    asset: str
    time_us: int
    text: str
    who: str


_RUN_COLUMNS = tuple(getattr(RunRow, field.name) for field in fields(Run))
_NOTE_COLUMNS = tuple(getattr(AnnotationRow, field.name) for field in fields(Annotation))


class Runs(StorePart):
    """Runs by asset; names belong to a run, annotations to a time."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._history = History(database)
        self._minutes: dict[tuple[str, Rollup], list[Stretch]] = {}
        self._marks: dict[str, tuple[int, _Condensed]] = {}

    def refresh(self, asset: str, now_us: int) -> None:
        """Find the runs of an asset in the stored samples; writes only what has changed."""
        begin_us = self._looked_through(asset)
        condensed = self._condensed(asset, now_us)
        stretches = self._stretches(asset, begin_us, now_us)
        first_us = begin_us or (stretches[0].begin_s * MICROSECONDS if stretches else None)
        spans = find_runs(stretches, now_us // MICROSECONDS)
        self._write(asset, spans, begin_us, first_us)
        if self._condensed(asset, now_us) == condensed:  # nothing came while it was looked through
            until_us = _decided_us(spans, min(now_us, condensed.first_stale_us))
            if until_us > begin_us:
                self._marks[asset] = until_us, self._condensed(asset, until_us)

    def _write(
        self, asset: str, spans: Sequence[RunSpan], begin_us: int, first_us: int | None
    ) -> None:
        """Bring the kept runs from a time on in line with those that were found."""

        def read(connection: Connection) -> tuple[list[Run], list[Run]]:
            everything = _runs_of(connection, asset)
            kept = [one for one in everything if one.end_us is None or one.end_us > begin_us]
            taken = {one.id for one in everything}
            return kept, reconciled(asset, kept, spans, first_us, taken)

        with self._database.reading() as connection:
            kept, found = read(connection)
        if found == kept:
            return
        with self._database.writing() as connection:
            kept, found = read(connection)
            for gone in {one.id for one in kept} - {one.id for one in found}:
                connection.execute(delete(RunRow).where(*_is(asset, gone)))
            known = {one.id: one for one in kept}
            for one in found:
                if one.id not in known:
                    connection.execute(insert(RunRow).values(asdict(one)))
                elif one != known[one.id]:
                    change = update(RunRow).where(*_is(asset, one.id)).values(asdict(one))
                    connection.execute(change)

    def page(self, asset: str, limit: int, cursor: int | None = None) -> RunPage:
        """Part of the runs of an asset, the latest start first."""
        query = select(RunRow.start_us, *_RUN_COLUMNS).where(RunRow.asset == asset)
        rows, following = self._newest_first(query, RunRow.start_us, limit, cursor)
        return RunPage([Run(*row[1:]) for row in rows], following)

    def get(self, asset: str, run_id: str) -> Run | None:
        """One run, None where there is none of this id."""
        with self._database.reading() as connection:
            row = connection.execute(select(*_RUN_COLUMNS).where(*_is(asset, run_id))).first()
        return None if row is None else Run(*row)

    def rename(
        self, asset: str, run_id: str, name: str, who: str, line: AuditEntry | None = None
    ) -> bool:
        """Give a run another name, with its line of the audit trail; False where there is none."""
        change = update(RunRow).where(*_is(asset, run_id))
        with self._database.writing() as connection:
            values = {"name": name, "named_by": who if name else ""}
            if connection.execute(change.values(values)).rowcount == 0:
                return False
            add_line(connection, line)
        return True

    def annotations(self, asset: str, start_us: int, end_us: int) -> list[Annotation]:
        """What was noted from one time until another, both included, in the order of time."""
        query = (
            select(*_NOTE_COLUMNS)
            .where(
                AnnotationRow.asset == asset,
                AnnotationRow.time_us >= start_us,
                AnnotationRow.time_us <= end_us,
            )
            .order_by(AnnotationRow.time_us, AnnotationRow.id)
        )
        with self._database.reading() as connection:
            return [Annotation(*row) for row in connection.execute(query)]

    def annotate(self, annotation: Annotation, line: AuditEntry | None = None) -> None:
        """Write an annotation, and the line of who wrote it, in one transaction."""
        with self._database.writing() as connection:
            connection.execute(insert(AnnotationRow).values(asdict(annotation)))
            add_line(connection, line)

    def remove_annotation(
        self, asset: str, annotation_id: str, line: AuditEntry | None = None
    ) -> bool:
        """Remove an annotation; False, and no line, where there is none."""
        row = AnnotationRow
        with self._database.writing() as connection:
            gone = delete(row).where(row.asset == asset, row.id == annotation_id)
            if connection.execute(gone).rowcount == 0:
                return False
            add_line(connection, line)
        return True

    def _looked_through(self, asset: str) -> int:
        """Up to when there is nothing new to find: the rollups before are as they were then."""
        until_us, condensed = self._marks.get(asset, (0, None))
        if condensed is None or self._condensed(asset, until_us) == condensed:
            return until_us
        del self._marks[asset]
        return 0

    def _condensed(self, asset: str, until_us: int) -> "_Condensed":
        hour, stale = RollupRow, StaleRollupRow
        channel = (
            select(ChannelRow.id)
            .where(ChannelRow.asset == asset, ChannelRow.name == SPEED)
            .scalar_subquery()
        )
        hours = select(func.count(), func.sum(hour.good)).where(
            hour.channel_id == channel, hour.resolution_s == 3600, hour.time_us < until_us
        )
        first_stale = select(func.min(stale.hour_us)).where(
            stale.channel_id == channel, stale.hour_us < until_us
        )
        with self._database.reading() as connection:
            count, good = connection.execute(hours).one()
            return _Condensed(count, int(good or 0), connection.scalar(first_stale) or until_us)

    def _stretches(self, asset: str, begin_us: int, now_us: int) -> list[Stretch]:
        """What is known of the speed: by ten minutes, and by minutes where a run may begin or end.

        Ten minutes are enough where the machine stood all the time, or turned all the time, before
        and after as well.
        """
        coarse = [
            bucket
            for bucket in self._speed(asset, begin_us, now_us, _COARSE_US)
            if bucket.min is not None and bucket.max is not None
        ]
        turned = {bucket.time_us for bucket in coarse if (bucket.max or 0.0) > TURNS_RPM}
        found: list[Stretch] = []
        for bucket in coarse:
            at_us = bucket.time_us
            within = {at_us - _COARSE_US, at_us, at_us + _COARSE_US} <= turned
            if at_us not in turned or (within and (bucket.min or 0.0) > TURNS_RPM):
                found.append(_stretch(bucket, _COARSE_US, now_us))
            else:
                found += self._by_minutes(asset, bucket, now_us)
        return found

    def _by_minutes(self, asset: str, bucket: Rollup, now_us: int) -> list[Stretch]:
        key, end_us = (asset, bucket), bucket.time_us + _COARSE_US
        if key in self._minutes:
            return self._minutes[key]
        found = [
            _stretch(minute, MINUTE_US, now_us)
            for minute in self._speed(asset, bucket.time_us, min(end_us, now_us), MINUTE_US)
            if minute.mean is not None
        ]
        if len(self._minutes) >= _REMEMBERED:
            self._minutes.clear()
        # The last minutes reach up to now, and are others the next time.
        if end_us < now_us:
            self._minutes[key] = found
        return found

    def _speed(self, asset: str, start_us: int, end_us: int, bucket_us: int) -> list[Rollup]:
        return self._history.read(asset, [SPEED], start_us, end_us, bucket_us, _MOST_BUCKETS)


@dataclass(frozen=True, slots=True)
class _Condensed:
    """What there is of the rollups of a speed: hours, good samples, the first that is to come."""

    hours: int
    good: int
    first_stale_us: int


def _decided_us(spans: Sequence[RunSpan], limit_us: int) -> int:
    """The last full hour, an hour ago at least, before which no run begins that ends after it."""
    until_us = limit_us - HOUR_US
    for span in reversed(spans):
        end_us = None if span.end_s is None else span.end_s * MICROSECONDS
        until_us -= until_us % HOUR_US
        if span.begin_s * MICROSECONDS < until_us and (end_us is None or until_us <= end_us):
            until_us = span.begin_s * MICROSECONDS
    return until_us - until_us % HOUR_US


def reconciled(
    asset: str,
    kept: Sequence[Run],
    spans: Iterable[RunSpan],
    first_us: int | None,
    taken: Collection[str] = (),
) -> list[Run]:
    """Say which runs there are, from those that are kept and those that were found just now.

    A run that was found keeps the id and the name of the kept run that it overlaps; of several,
    those of the first, and all names. Nothing is forgotten that has a name, or that began before
    the speed that is stored. Kept runs and spans are in the order of their starts, and so is what
    it returns.

    - ``first_us``: when the stored speed begins; None without any.
    - ``taken``: ids that other runs of the asset have.
    """
    left = list(kept)
    ids = {one.id for one in kept}.union(taken)
    result: list[Run] = []
    for span in spans:
        start_us = span.begin_s * MICROSECONDS
        end_us = None if span.end_s is None else span.end_s * MICROSECONDS
        same = [one for one in left if _overlap(one, start_us, end_us)]
        left = [one for one in left if one not in same]
        if not same:
            run_id = _new_id(start_us, ids)
            ids.add(run_id)
            result.append(Run(asset, run_id, start_us, end_us, span.ended))
            continue
        named = [one for one in same if one.name]
        if first_us is not None and start_us <= first_us:  # its beginning is not stored any more
            start_us = min(start_us, same[0].start_us)
        result.append(
            Run(
                asset,
                same[0].id,
                start_us,
                end_us,
                span.ended,
                " + ".join(dict.fromkeys(one.name for one in named)),
                named[0].named_by if named else "",
            )
        )
    result += [one for one in left if one.name or first_us is None or one.start_us < first_us]
    return sorted(result, key=lambda one: (one.start_us, one.id))


def _overlap(run: Run, start_us: int, end_us: int | None) -> bool:
    begins_before = end_us is None or run.start_us < end_us
    return begins_before and (run.end_us is None or run.end_us > start_us)


def _new_id(start_us: int, taken: set[str]) -> str:
    text = datetime.fromtimestamp(start_us // MICROSECONDS, UTC).strftime("%Y%m%dT%H%MZ")
    run_id, number = text, 2
    while run_id in taken:
        run_id, number = f"{text}-{number}", number + 1
    return run_id


def _stretch(bucket: Rollup, length_us: int, now_us: int) -> Stretch:
    end_us = min(bucket.time_us + length_us, now_us)
    turns = bucket.mean is not None and bucket.mean > TURNS_RPM
    return Stretch(bucket.time_us // MICROSECONDS, end_us // MICROSECONDS, turns)


def _is(asset: str, run_id: str) -> tuple[ColumnElement[bool], ColumnElement[bool]]:
    return RunRow.asset == asset, RunRow.id == run_id


def _runs_of(connection: Connection, asset: str) -> list[Run]:
    query = select(*_RUN_COLUMNS).where(RunRow.asset == asset)
    rows = connection.execute(query.order_by(RunRow.start_us, RunRow.id))
    return [Run(*row) for row in rows]
