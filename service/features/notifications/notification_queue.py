"""The notifications of one recipient, and the loop that sends them."""

import asyncio
import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import structlog

from adapters.backoff import Backoff
from adapters.protocol import Clock
from service.alarms.silencing import Silencing
from service.clock import wall_us
from service.features.notifications import rules
from service.features.notifications.interface import NotificationState
from service.features.notifications.messages import Item, OutgoingMessage
from service.features.notifications.sections import NotificationSection
from service.features.notifications.sender import DeliveryError, Sender
from service.features.notifications.tables import Notification
from service.pauses import Steps

#: Wall seconds in which alarms that come together are gathered for one message.
GATHER_S: Final = 2.0
#: Share of the interval between two messages that priority 1 waits.
URGENT_SHARE: Final = 1 / 6
#: Wall seconds between two tries.
RETRY_FIRST_S: Final = 2.0
RETRY_LAST_S: Final = 300.0
#: Tries in a row that fail before the notification counts as failing.
FAILS_AFTER: Final = 3
#: Alarms in one message.
MOST_ITEMS: Final = 200

_log = structlog.get_logger(__name__)


class DeliveryRecord:
    """What became of the last messages to a recipient.

    - ``tries``: how many have failed in a row.
    - ``error``: of the last one that failed, or what is wrong with some addresses.
    """

    def __init__(self, id: str) -> None:
        self.tries = 0
        self.error = ""
        self.failing_since_us: int | None = None
        self.sent_us: int | None = None
        self._id = id

    def accept(self, error: str) -> None:
        """Note that a message was accepted; ``error``: what is wrong with some of its addresses."""
        if self.tries >= FAILS_AFTER:
            _log.info("notification_sent_again", notification=self._id)
        self.tries, self.failing_since_us, self.error = 0, None, error

    def fail(self, error: str) -> None:
        """Note that a message was not accepted."""
        self.tries += 1
        self.error = error
        if self.failing_since_us is None:
            self.failing_since_us = wall_us()
        if self.tries == FAILS_AFTER:
            _log.error("notification_fails", notification=self._id, reason=error)

    @property
    def problem(self) -> str | None:
        """What is wrong with it, if it has failed several times in a row."""
        return None if self.tries < FAILS_AFTER else f"notification {self._id} fails: {self.error}"


class NotificationQueue:
    """Sends to one recipient of the configuration what is pending.

    Parameters
    ----------
    section : NotificationSection
        The recipient's configuration.
    sender : Sender
        Sends messages.
    clock : Clock
        Process time.
    name_of : callable
        Gives the name of an asset.
    keep : callable
        Gets notifications that have changed, to be written.
    silencing : callable
        Gives what says which assets are silenced.

    Attributes
    ----------
    notifications : dict of str to Notification
        By alarm.
    delivery : DeliveryRecord
        What became of the last messages.
    """

    def __init__(
        self,
        section: NotificationSection,
        sender: Sender,
        clock: Clock,
        name_of: Callable[[str], str],
        keep: Callable[[Iterable[Notification]], None],
        silencing: Callable[[], Silencing],
    ) -> None:
        self.section = section
        self.notifications: dict[str, Notification] = {}
        self._pending: dict[str, Notification] = {}
        self._sender = sender
        self._clock = clock
        self._name_of = name_of
        self._keep = keep
        self._silencing = silencing
        self._wake = asyncio.Event()
        self._last_s = -math.inf
        self._batch: list[Item] = []
        # As they are now, also those that are over since.
        self._under_way: dict[str, Notification] = {}
        self.delivery = DeliveryRecord(section.id)

    # ------------------------------------------------------------------ what is pending
    def put(self, notification: Notification) -> bool:
        """Keep a notification as it is now; whether more than figures of its alarm has changed."""
        alarm_id = notification.alarm.id
        before = self.notifications.get(alarm_id)
        if alarm_id in self._under_way:
            self._under_way[alarm_id] = notification
        if notification.over:
            self.notifications.pop(alarm_id, None)
        else:
            self.notifications[alarm_id] = notification
        if notification.pending and not notification.over:
            self._pending[alarm_id] = notification
            self._wake.set()
        else:
            self._pending.pop(alarm_id, None)
        return before is None or _progress(before) != _progress(notification)

    def forget(self, assets: Iterable[str]) -> None:
        """Drop the notifications of some assets."""
        gone = set(assets)
        for kept in (self.notifications, self._pending, self._under_way):
            for alarm_id in [id for id, one in kept.items() if one.alarm.asset in gone]:
                del kept[alarm_id]

    def look(self) -> None:
        """Wake up: time has passed, and what was held back may be due."""
        self._wake.set()

    async def state(self) -> NotificationState:
        """How it is."""
        now_us, silencing, steps = self._clock.now_us(), self._silencing(), Steps()
        held = 0
        for notification in list(self._pending.values()):
            held += not rules.due(notification, silencing, now_us)
            await steps.pause()
        return NotificationState(
            id=self.section.id,
            waiting=max(len(self._pending), held),
            held=held,
            sent_us=self.delivery.sent_us,
            failing_since_us=self.delivery.failing_since_us,
            tries=self.delivery.tries,
            error=self.delivery.error,
        )

    # ------------------------------------------------------------------ sending
    async def run(self) -> None:
        """Send what is pending, until cancelled."""
        backoff = Backoff(RETRY_FIRST_S, RETRY_LAST_S)
        try:
            while True:
                while not await self._due(1):
                    await self._woken()
                await asyncio.sleep(GATHER_S)
                while time.monotonic() < await self._free_s():
                    await self._woken()
                while items := await self._next_batch():
                    if await self._send(items):
                        backoff.reset()
                    else:
                        await asyncio.sleep(backoff.next())
        finally:
            await self._sender.close()

    async def _woken(self) -> None:
        """Wait until more is pending than at the last look, or a second has passed."""
        await self._wake.wait()
        self._wake.clear()

    async def _free_s(self) -> float:
        """Monotonic time of the next message at the earliest."""
        interval_s = self.section.interval_s
        is_urgent = interval_s and await self._due(1, _is_urgent)
        return self._last_s + (URGENT_SHARE * interval_s if is_urgent else interval_s)

    async def _due(
        self, most: int = sys.maxsize, is_asked: Callable[[Item], bool] = lambda item: True
    ) -> list[Item]:
        """What may be sent now, of what is asked; of thousands, all at once would delay a poll."""
        now_us, silencing, steps = self._clock.now_us(), self._silencing(), Steps()
        items: list[Item] = []
        for notification in list(self._pending.values()):
            item = Item(notification, rules.due(notification, silencing, now_us))
            if item.events and is_asked(item):
                items.append(item)
                if len(items) == most:
                    break
            await steps.pause()
        await steps.pause()
        # What has changed meanwhile wakes its reader.
        return [item for item in items if self._pending.get(item.alarm.id) is item.notification]

    async def _next_batch(self) -> list[Item]:
        """What goes out next: what could not be sent before, as long as all of it is pending."""
        due = await self._due(MOST_ITEMS)
        now_us, silencing = self._clock.now_us(), self._silencing()
        again = []
        for item in self._batch:
            notification = self._pending.get(item.alarm.id)
            if notification and set(item.events) <= set(rules.due(notification, silencing, now_us)):
                again.append(Item(notification, item.events))
        if not again or len(again) < len(self._batch):
            again = due
        self._batch = again
        return again

    async def _send(self, items: Sequence[Item]) -> bool:
        message = OutgoingMessage(self.section.id, items, self._name_of)
        self._under_way = {item.alarm.id: item.notification for item in items}
        try:
            error = await self._sender.send(message) or ""
        except DeliveryError as refusal:
            self.delivery.fail(str(refusal))
            return False
        except Exception as unexpected:
            # Whatever it was: it is tried again, and the service goes on.
            _log.exception("notification_failed", notification=self.section.id)
            self.delivery.fail(type(unexpected).__name__)
            return False
        self.delivery.accept(error)
        self.delivery.sent_us, self._last_s = wall_us(), time.monotonic()
        self._batch = []
        changed = []
        for item in items:
            # It may have changed while the message was under way, or be another cell's.
            current = self._under_way.pop(item.alarm.id, None)
            if current is not None:
                notification = rules.sent(current, item.events)
                self.put(notification)
                changed.append(notification)
        self._under_way = {}
        self._keep(changed)
        _log.info("notification_sent", notification=self.section.id, alarms=len(items))
        return True


def _is_urgent(item: Item) -> bool:
    return item.alarm.priority == 1 and any(
        rules.kind_of(event) != rules.RETURNED for event in item.events
    )


def _progress(notification: Notification) -> tuple[object, ...]:
    """What must be known after a restart."""
    return (
        notification.alarm.state,
        notification.raise_number,
        notification.pending,
        notification.is_notified,
        notification.released_us,
        notification.called,
        notification.steps,
        notification.over,
    )
