"""What was told of the alarms that are not over, and what still has to be: one row per receiver."""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import structlog
from sqlalchemy import and_, delete, insert, or_, select

from service.store.alarm_records import Alarm
from service.store.deliveries import Delivery
from service.store.errors import NotOwnerError
from service.store.part import StorePart
from service.store.tables import TellingRow

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Telling:
    """What one notification has said of one alarm, and what it owes.

    Attributes
    ----------
    notification
        Its id.
    alarm
        As it was when it was last looked at.
    raise_number
        How often the alarm has called for an operator in its life.
    since_us
        Process time of the last of these.
    owed
        Events that have to be told, in their order: ``raised:1``, ``returned:1``, …
    told
        Whether the receiver was told that the alarm is there, and not since that it is not.
    released_us
        Process time from which on the alarm could be told; None while it is held back.
    called
        Whether another notification escalated the alarm to this one.
    steps
        Steps of its own escalation that were taken since the alarm called.
    over
        Whether nothing is left to be told; such a record is not kept.
    """

    notification: str
    alarm: Alarm
    raise_number: int = 1
    since_us: int = 0
    owed: tuple[str, ...] = ()
    told: bool = False
    released_us: int | None = None
    called: bool = False
    steps: int = 0
    over: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """What tells one from another."""
        return self.notification, self.alarm.id


@dataclass(frozen=True, slots=True)
class TellingChange:
    """Tellings as they are now."""

    tellings: tuple[Telling, ...]


class Tellings(StorePart):
    """One record for each notification and alarm; it leaves with the alarm."""

    def save(self, tellings: Sequence[Telling], delivery: Delivery | None = None) -> None:
        """Write tellings as they are now, in one transaction; those that are over are removed.

        Raises
        ------
        NotOwnerError
            If another cell has owned all of their assets since.
        """
        latest = {one.key: one for one in tellings}
        with self._writing_once(delivery) as connection:
            fence = self._database.fence
            if connection is None or not latest:
                return
            if fence is not None:
                assets = {one.alarm.asset for one in latest.values()}
                held = (
                    fence.held(connection, assets)
                    if delivery is None
                    else fence.deliverable(connection, assets, delivery.run)
                )
                latest = {key: one for key, one in latest.items() if one.alarm.asset in held}
                if not latest:
                    raise NotOwnerError("tellings: another cell has owned their assets since")
            keys = list(latest)
            row = TellingRow
            for begin in range(0, len(keys), 200):
                portion = keys[begin : begin + 200]
                same = [
                    and_(row.notification == one, row.alarm_id == other) for one, other in portion
                ]
                connection.execute(delete(row).where(or_(*same)))
            rows = [
                {
                    "notification": one.notification,
                    "alarm_id": one.alarm.id,
                    "asset": one.alarm.asset,
                    "document": msgspec.to_builtins(one),
                }
                for one in latest.values()
                if not one.over
            ]
            if rows:
                connection.execute(insert(row), rows)

    def load(self) -> list[Telling]:
        """All that are kept."""
        with self._database.reading() as connection:
            documents = connection.scalars(select(TellingRow.document)).all()
        found = []
        for document in documents:
            try:
                found.append(msgspec.convert(document, Telling))
            except msgspec.ValidationError as error:  # of another version: told once more
                _log.error("telling_refused", reason=str(error))
        return found
