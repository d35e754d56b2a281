"""Times in which nobody is told of alarms: planned, with who and why, and an end."""

from dataclasses import dataclass

import msgspec
import structlog
from sqlalchemy import delete, insert, select

from service.store.audit import add_line
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import SilenceRow

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Silence:
    """A time in which nobody is told of the alarms of some assets (process time).

    Attributes
    ----------
    assets
        Ids; empty for all.
    begins_us, ends_us
        From when until when.
    days, begins, ends, time_zone
        On a schedule: only on these days of the week (0 is Monday; none: all) between these times
        of the day (``HH:MM``; empty: all day), in a time zone.
    who, comment
        Who asked for it, and why.
    """

    id: str
    assets: tuple[str, ...]
    begins_us: int
    ends_us: int
    who: str
    comment: str
    days: tuple[int, ...] = ()
    begins: str = ""
    ends: str = ""
    time_zone: str = "UTC"

    def covers(self, asset: str) -> bool:
        """Whether it is about an asset."""
        return not self.assets or asset in self.assets


class Silences(StorePart):
    """Silences until they are over."""

    def add(self, silence: Silence, now_us: int, line: AuditEntry | None = None) -> None:
        """Write one, and the line of who asked for it, in one transaction.

        Those that are over at this process time leave: the audit trail tells of them.
        """
        values = {
            "id": silence.id,
            "ends_us": silence.ends_us,
            "document": msgspec.to_builtins(silence),
        }
        with self._database.writing() as connection:
            connection.execute(delete(SilenceRow).where(SilenceRow.ends_us <= now_us))
            connection.execute(insert(SilenceRow).values(values))
            add_line(connection, line)

    def end(self, silence_id: str, line: AuditEntry | None = None) -> bool:
        """Remove one; False, and no line, where there is none."""
        with self._database.writing() as connection:
            gone = delete(SilenceRow).where(SilenceRow.id == silence_id)
            if connection.execute(gone).rowcount == 0:
                return False
            add_line(connection, line)
        return True

    def load(self, now_us: int) -> list[Silence]:
        """Those that are not over at a process time, the first to end first."""
        query = (
            select(SilenceRow.document)
            .where(SilenceRow.ends_us > now_us)
            .order_by(SilenceRow.ends_us, SilenceRow.id)
        )
        with self._database.reading() as connection:
            documents = connection.scalars(query).all()
        found = []
        for document in documents:
            try:
                found.append(msgspec.convert(document, Silence))
            except msgspec.ValidationError as error:  # of another version
                _log.error("silence_refused", reason=str(error))
        return found
