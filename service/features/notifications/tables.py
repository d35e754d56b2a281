"""Notifications in the store: one row for each recipient and each alarm that is not over."""

from collections.abc import Sequence
from typing import ClassVar

import msgspec
import structlog
from sqlalchemy import Index, and_, delete, insert, or_, select
from sqlalchemy.orm import Mapped, mapped_column

from service.store import Alarm, FeatureChange, NotOwnerError, Outbox, RefuseChange, Store
from service.store.deliveries import Delivery
from service.store.part import Parts, Refuse, StorePart
from service.store.records import JsonDocument
from service.store.tables import Base

#: Rows that one statement removes.
_BATCH_SIZE = 200

_log = structlog.get_logger(__name__)


class NotificationRow(Base):
    """What a recipient was notified of an alarm that is not over."""

    __tablename__ = "tellings"
    __table_args__ = (Index("ix_tellings_asset", "asset"),)

    notification: Mapped[str] = mapped_column(primary_key=True)
    alarm_id: Mapped[str] = mapped_column(primary_key=True)
    asset: Mapped[str]
    document: Mapped[JsonDocument]


class Notification(
    msgspec.Struct,
    frozen=True,
    # The store has these names since 1.0.
    rename={"section_id": "notification", "pending": "owed", "is_notified": "told"},
):
    """What one recipient was notified of one alarm, and what is pending.

    - ``section_id``: of the recipient in the configuration.
    - ``alarm``: as it was when it was last looked at.
    - ``raise_number``: how often the alarm has called for an operator in its life.
    - ``since_us``: process time of the last of these.
    - ``pending``: events that have to be sent, in their order: ``raised:1``, ``returned:1``, …
    - ``is_notified``: whether the recipient knows of the alarm: its raise was sent, and no return
      since.
    - ``released_us``: process time from which on the alarm could be sent; None while it is held
      back.
    - ``called``: whether another notification escalated the alarm to this one.
    - ``steps``: steps of its own escalation that were taken since the alarm called.
    - ``over``: whether nothing is left to be sent; such a record is not kept.
    - ``partly``: events of ``pending`` that some addresses have.
    """

    section_id: str
    alarm: Alarm
    raise_number: int = 1
    since_us: int = 0
    pending: tuple[str, ...] = ()
    is_notified: bool = False
    released_us: int | None = None
    called: bool = False
    steps: int = 0
    over: bool = False
    partly: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, str]:
        """What distinguishes it from others."""
        return self.section_id, self.alarm.id


class NotificationRecords(StorePart):
    """One record for each recipient and alarm; it leaves with the alarm."""

    def save(
        self,
        notifications: Sequence[Notification],
        delivery: Delivery | None = None,
        refuse: Refuse | None = None,
    ) -> None:
        """Write them as they are now, in one transaction; those that are over are removed.

        ``refuse`` takes those of assets that another cell owns. Raises `NotOwnerError` if another
        cell has owned all of their assets since.
        """
        latest = {one.key: one for one in notifications}
        with self._writing_once(delivery) as connection:
            if connection is None or not latest:
                return
            ours = self._ours(connection, {one.alarm.asset for one in latest.values()}, delivery)
            rest = [one for one in latest.values() if one.alarm.asset not in ours]
            if len(rest) == len(latest):
                raise NotOwnerError("notifications: another cell has owned their assets since")
            if rest and refuse is not None:
                refuse(connection, rest)
            latest = {key: one for key, one in latest.items() if one.alarm.asset in ours}
            keys = list(latest)
            row = NotificationRow
            for begin in range(0, len(keys), _BATCH_SIZE):
                same = [
                    and_(row.notification == section_id, row.alarm_id == alarm_id)
                    for section_id, alarm_id in keys[begin : begin + _BATCH_SIZE]
                ]
                connection.execute(delete(row).where(or_(*same)))
            rows = [
                {
                    "notification": one.section_id,
                    "alarm_id": one.alarm.id,
                    "asset": one.alarm.asset,
                    "document": msgspec.to_builtins(one),
                }
                for one in latest.values()
                if not one.over
            ]
            if rows:
                connection.execute(insert(row), rows)

    def load(self) -> list[Notification]:
        """All that are kept."""
        with self._database.reading() as connection:
            documents = connection.scalars(select(NotificationRow.document)).all()
        notifications = []
        for document in documents:
            try:
                notifications.append(msgspec.convert(document, Notification))
            except msgspec.ValidationError as error:  # of another version: sent once more
                _log.error("notification_refused", reason=str(error))
        return notifications


class NotificationChange(FeatureChange, frozen=True, rename={"notifications": "tellings"}):
    """Notifications as they are now."""

    kind: ClassVar[str] = "tellings"

    notifications: tuple[Notification, ...]

    @property
    def summary(self) -> str:
        """What the list of changes that the store did not take calls it."""
        return "states of notifications"

    def assets(self) -> set[str]:
        """Name the assets that it is about."""
        return {one.alarm.asset for one in self.notifications}

    def save(self, parts: Parts, delivery: Delivery | None, refuse: RefuseChange) -> None:
        """Write them; ``refuse`` takes those of assets that another cell owns."""
        parts.part(NotificationRecords).save(
            self.notifications,
            delivery,
            lambda connection, rest: refuse(connection, NotificationChange(tuple(rest))),
        )


CHANGES = (NotificationChange,)


def load_notifications(store: Store, outbox: Outbox) -> list[Notification]:
    """All that are not over, as they are when all that waits has been written."""
    # The file first: what leaves it meanwhile is in the store by then.
    waiting = outbox.waiting_changes(NotificationChange)
    latest = {one.key: one for one in store.part(NotificationRecords).load()}
    latest |= {one.key: one for change in waiting for one in change.notifications}
    return [one for one in latest.values() if not one.over]
