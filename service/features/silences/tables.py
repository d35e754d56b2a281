"""Planned times without notifications of alarms: from when until when, who and why."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import msgspec
import structlog
from sqlalchemy import delete, func, insert, select, update
from sqlalchemy.orm import Mapped, mapped_column

from service.domain.errors import BearingTwinError
from service.store import FeatureChange, RefuseChange
from service.store.audit import add_line
from service.store.deliveries import Delivery
from service.store.part import Parts, StorePart
from service.store.records import AuditEntry, JsonDocument
from service.store.tables import Base

#: So many that are in force or planned: every second each alarm is compared with them.
MOST_SILENCES: Final = 200

_log = structlog.get_logger(__name__)


class SilenceRow(Base):
    """A time without notifications of alarms."""

    __tablename__ = "silences"

    id: Mapped[str] = mapped_column(primary_key=True)
    ends_us: Mapped[int]
    document: Mapped[JsonDocument]


class TooManySilencesError(BearingTwinError, ValueError):
    """There are as many silences as there may be; the text says how many."""


@dataclass(frozen=True, slots=True)
class Silence:
    """A time without notifications of the alarms of some assets (process time).

    - ``days``, ``begins``, ``ends``, ``time_zone``: on a schedule: only on these days of the week
      (0 is Monday; none: all) between these times of the day (``HH:MM``; empty: all day), in a time
      zone.
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

    def moved(self, before_us: int, by_us: int) -> "Silence":
        """Give it as it lasts as long as before, where the clock was set by so much.

        One that had not begun, at the time that it was before, and one on a schedule go by the
        calendar.
        """
        if self.begins or self.days or not self.begins_us <= before_us < self.ends_us:
            return self
        return replace(self, begins_us=self.begins_us + by_us, ends_us=self.ends_us + by_us)

    def covers(self, asset: str) -> bool:
        """Whether it is about an asset."""
        return not self.assets or asset in self.assets


class Silences(StorePart):
    """Silences until they are over."""

    def add(self, silence: Silence, now_us: int, line: AuditEntry | None = None) -> None:
        """Write one, and the line of who asked for it, in one transaction.

        Those that are over at this process time leave: the audit trail has them. Raises
        `TooManySilencesError` if there are `MOST_SILENCES` already.
        """
        values = {"id": silence.id, **_columns(silence)}
        with self._database.writing() as connection:
            connection.execute(delete(SilenceRow).where(SilenceRow.ends_us <= now_us))
            standing = connection.scalar(select(func.count()).select_from(SilenceRow)) or 0
            if standing >= MOST_SILENCES:
                raise TooManySilencesError(
                    f"{standing} silences are in force or planned, expected at most "
                    f"{MOST_SILENCES}: end some, name several assets in one, or plan them weekly"
                )
            connection.execute(insert(SilenceRow).values(values))
            add_line(connection, line)

    def end(self, silence_ids: Collection[str], line: AuditEntry | None = None) -> list[str]:
        """Remove some, and give the ids of those that there were; without any there is no line."""
        wanted = SilenceRow.id.in_(silence_ids)
        with self._database.writing() as connection:
            ended = list(connection.scalars(select(SilenceRow.id).where(wanted)))
            if ended:
                connection.execute(delete(SilenceRow).where(wanted))
                add_line(connection, line)
        return ended

    def change(self, silences: Iterable[Silence], delivery: Delivery | None = None) -> None:
        """Write other times of some; those that were ended meanwhile stay so."""
        with self._writing_once(delivery) as connection:
            if connection is None:
                return
            for silence in silences:
                same = SilenceRow.id == silence.id
                connection.execute(update(SilenceRow).where(same).values(_columns(silence)))

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


def _columns(silence: Silence) -> dict[str, object]:
    return {"ends_us": silence.ends_us, "document": msgspec.to_builtins(silence)}


class MovedSilences(FeatureChange, frozen=True):
    """Silences with other times, as the clock was set while they were in force."""

    kind: ClassVar[str] = "moved silences"

    silences: tuple[Silence, ...]

    @property
    def summary(self) -> str:
        """What the list of changes that the store did not take calls it."""
        return "times of silences"

    def assets(self) -> set[str]:
        """Name no asset: no cell owns a silence."""
        return set()

    def save(self, parts: Parts, delivery: Delivery | None, refuse: RefuseChange) -> None:
        """Write them."""
        parts.part(Silences).change(self.silences, delivery)


CHANGES = (MovedSilences,)
