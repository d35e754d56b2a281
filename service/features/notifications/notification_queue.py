"""The notifications of one recipient, and the loop that sends them."""

import asyncio
import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Final

import structlog

from adapters.backoff import Backoff
from adapters.protocol import Clock
from service.alarms.silencing import Silencing
from service.clock import wall_us
from service.features.notifications import rules
from service.features.notifications.delivery_record import DeliveryRecord
from service.features.notifications.interface import NotificationState
from service.features.notifications.messages import Item, OutgoingMessage
from service.features.notifications.refusals import Refusals
from service.features.notifications.sections import NotificationSection
from service.features.notifications.sender import (
    ContentRefusedError,
    DeliveryError,
    PostponedError,
    Sender,
)
from service.features.notifications.tables import Notification
from service.pauses import Steps

#: Wall seconds in which alarms that come together are gathered for one message.
GATHER_S: Final = 2.0
#: Share of the interval between two messages that priority 1 waits.
URGENT_SHARE: Final = 1 / 6
#: Wall seconds between two tries.
RETRY_FIRST_S: Final = 2.0
RETRY_LAST_S: Final = 300.0
#: Alarms in one message.
MOST_ITEMS: Final = 200

_log = structlog.get_logger(__name__)


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
    give_up : callable
        Gets what the receiver refuses for good, and why.

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
        give_up: Callable[[Item, str], None],
    ) -> None:
        self.section = section
        self.notifications: dict[str, Notification] = {}
        self._pending: dict[str, Notification] = {}
        self._sender = sender
        self._clock = clock
        self._name_of = name_of
        self._keep = keep
        self._silencing = silencing
        self._give_up = give_up
        self._wake = asyncio.Event()
        self._last_s = -math.inf
        # What could not be sent before, and what is urgent of what came since: in messages that
        # stay as they are, as some addresses may have them.
        self._batch: list[Item] = []
        self._urgent: list[list[Item]] = []
        # Events that were tried by themselves since a message was accepted.
        self._tried: set[str] = set()
        self._most = MOST_ITEMS
        self._refusals = Refusals(RETRY_FIRST_S)
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
            self._refusals.forget(alarm_id)
        return before is None or _progress(before) != _progress(notification)

    def forget(self, assets: Iterable[str]) -> None:
        """Drop the notifications of some assets."""
        gone = set(assets)
        for kept in (self.notifications, self._pending, self._under_way):
            for alarm_id in [id for id, one in kept.items() if one.alarm.asset in gone]:
                del kept[alarm_id]
        self._refusals.keep(self._pending)

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
            given_up=self.delivery.given_up,
        )

    # ------------------------------------------------------------------ sending
    async def run(self) -> None:
        """Send what is pending, until cancelled."""
        backoff = Backoff(RETRY_FIRST_S, RETRY_LAST_S)
        try:
            while True:
                while not (await self._due(1) or self._refused_and_due()):
                    await self._woken()
                await asyncio.sleep(GATHER_S)
                while time.monotonic() < await self._free_s():
                    await self._woken()
                while items := await self._next_batch():
                    goes_on = await self._send(items)
                    _end_if_cancelled()
                    if goes_on:
                        backoff.reset()
                    else:
                        await self._rest(backoff.next())
        finally:
            await self._sender.close()

    async def _woken(self) -> None:
        """Wait until more is pending than at the last look, or a second has passed."""
        await self._wake.wait()
        self._wake.clear()

    async def _rest(self, wait_s: float) -> None:
        """Try nothing again for a while; what is urgent and new is tried once by itself.

        Ends early when that is accepted: the receiver takes messages again.
        """
        end_s = time.monotonic() + wait_s
        while (left_s := end_s - time.monotonic()) > 0:
            with suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    await self._woken()
            if await self._new_urgent(1):
                urgent_s = self._last_s + URGENT_SHARE * self.section.interval_s
                await asyncio.sleep(max(GATHER_S, urgent_s - time.monotonic()))
                if await self._send_urgent():
                    return

    async def _new_urgent(self, most: int) -> list[Item]:
        """What is urgent, and neither part of a message that waits nor tried by itself."""
        known = {item.alarm.id for batch in (self._batch, *self._urgent) for item in batch}
        return await self._due(
            most,
            lambda item: (
                _is_urgent(item)
                and item.alarm.id not in known
                and not self._tried.issuperset(_event_ids(item))
            ),
        )

    async def _send_urgent(self) -> bool:
        """Try once what is urgent and new; gives whether to go on with all."""
        urgent = await self._new_urgent(self._most)
        urgent = [one for one in urgent if self._pending.get(one.alarm.id) is one.notification]
        if not urgent:
            return False
        self._tried.update(event for item in urgent for event in _event_ids(item))
        self._urgent.insert(0, urgent)
        goes_on = await self._send(urgent)
        _end_if_cancelled()
        return goes_on

    async def _free_s(self) -> float:
        """Monotonic time of the next message at the earliest."""
        interval_s = self.section.interval_s
        is_urgent = interval_s and await self._due(1, _is_urgent)
        return self._last_s + (URGENT_SHARE * interval_s if is_urgent else interval_s)

    async def _due(
        self, most: int = sys.maxsize, is_asked: Callable[[Item], bool] = lambda item: True
    ) -> list[Item]:
        """What may be sent now, of what is asked; of thousands, all at once would delay a poll."""
        silencing, steps = self._silencing(), Steps()
        items: list[Item] = []
        for notification in list(self._pending.values()):
            # The clock may be set in a pause.
            item = Item(notification, rules.due(notification, silencing, self._clock.now_us()))
            if item.events and is_asked(item) and not self._refusals.holds(item):
                items.append(item)
                if len(items) == most:
                    break
            await steps.pause()
        await steps.pause()
        # What has changed meanwhile wakes its reader.
        return [item for item in items if self._pending.get(item.alarm.id) is item.notification]

    def _refused_and_due(self) -> list[Item]:
        """Give what was refused alone and not tried for the longest time, to be tried alone."""
        now_us, silencing = self._clock.now_us(), self._silencing()
        for alarm_id in self._refusals.due():
            notification = self._pending[alarm_id]
            item = Item(notification, rules.due(notification, silencing, now_us))
            if self._refusals.holds(item):
                return [item]
        return []

    async def _next_batch(self) -> list[Item]:
        """What goes out next: what could not be sent before, as long as all of it is pending.

        What is urgent and came since goes before that.
        """
        urgent: list[Item] = []
        if self._batch:
            known = {item.alarm.id for item in self._batch}
            urgent = await self._due(
                self._most, lambda item: _is_urgent(item) and item.alarm.id not in known
            )
        due = await self._due(self._most)
        # Nothing waits from here on until it is under way, so that no change is missed.
        self._batch = self._still_due(self._batch)
        self._urgent = [left for one in self._urgent if (left := self._still_due(one))]
        if self._batch and not self._urgent:
            self._urgent = [
                [one for one in urgent if self._pending.get(one.alarm.id) is one.notification]
            ]
        if any(self._urgent):
            return self._urgent[0]
        self._urgent = []
        self._batch = self._batch or due or self._refused_and_due()
        return self._batch

    def _still_due(self, batch: Sequence[Item]) -> list[Item]:
        """Give a batch as it is now; nothing if not all of it is to be sent any more."""
        now_us, silencing = self._clock.now_us(), self._silencing()
        again = []
        for item in batch:
            notification = self._pending.get(item.alarm.id)
            if notification and set(item.events) <= set(rules.due(notification, silencing, now_us)):
                again.append(Item(notification, item.events))
        return again if len(again) == len(batch) else []

    async def _send(self, items: Sequence[Item]) -> bool:
        """Send a message; gives whether to go on at once."""
        message = OutgoingMessage(self.section.id, items, self._name_of)
        self._under_way = {item.alarm.id: item.notification for item in items}
        try:
            detail = await self._sender.send(message) or ""
        except ContentRefusedError as error:
            return await self._divide(items, error)
        except DeliveryError as error:
            self.delivery.fail(str(error))
            if error.is_partial:
                self._last_s = time.monotonic()
            elif items is not self._batch:  # it goes with what else becomes urgent
                self._put_instead(items, [])
            return isinstance(error, PostponedError) and await self._postpone(items)
        except Exception as unexpected:
            # Whatever it was: it is tried again, and the service goes on.
            _log.exception("notification_failed", notification=self.section.id)
            refused = ContentRefusedError(type(unexpected).__name__, is_final=False)
            return await self._divide(items, refused)
        self.delivery.accept(detail)
        self.delivery.sent_us, self._last_s = wall_us(), time.monotonic()
        self._refusals.note_accepted(items)
        self._tried.clear()
        self._most = min(MOST_ITEMS, 2 * self._most)
        self._put_instead(items, [])
        self._finish(items, rules.sent)
        _log.info("notification_sent", notification=self.section.id, alarms=len(items))
        return True

    def _finish(
        self,
        items: Sequence[Item],
        outcome: Callable[[Notification, Sequence[str]], Notification],
    ) -> None:
        """Keep what has become of notifications that were under way."""
        changed = []
        for item in items:
            # It may have changed while the message was under way, or be another cell's.
            current = self._under_way.pop(item.alarm.id, None)
            if current is not None:
                notification = outcome(current, item.events)
                self._refusals.forget(item.alarm.id)
                self.put(notification)
                changed.append(notification)
        self._under_way = {}
        self._keep(changed)

    async def _divide(self, items: Sequence[Item], error: ContentRefusedError) -> bool:
        """Halve what a receiver refuses, down to one alarm, and go on: one alone waits."""
        if len(items) > 1:
            self._halve(items)
            return True
        (item,) = items
        self._put_instead(items, [])
        if item.alarm.id not in self._pending:  # shelved, say, while it was under way
            return True
        if self._refusals.note_alone(item, is_final=error.is_final):
            self._drop(item, str(error))
        else:
            self.delivery.fail(str(error))
        await asyncio.sleep(RETRY_FIRST_S)
        return True

    async def _postpone(self, items: Sequence[Item]) -> bool:
        """Halve what a receiver postpones again, and let one alone wait; none is given up for it.

        Gives whether to go on at once.
        """
        if not self._refusals.knows_any(items):
            self._note_together(items)
            return False
        goes_on = True
        if len(items) > 1:
            self._halve(items)
        else:
            (item,) = items
            self._put_instead(items, [])
            if item.alarm.id in self._pending:
                goes_on = self._refusals.holds(item)
                self._refusals.note_alone(item, is_final=False)
        if goes_on:
            await asyncio.sleep(RETRY_FIRST_S)
        return goes_on

    def _halve(self, items: Sequence[Item]) -> None:
        self._most = len(items) // 2
        self._put_instead(items, items[: self._most])
        self._note_together(items)

    def _note_together(self, items: Sequence[Item]) -> None:
        """Note alarms whose common message was refused, of those that are still pending."""
        self._refusals.note_together(
            item.alarm.id for item in items if item.alarm.id in self._pending
        )

    def _put_instead(self, items: Sequence[Item], left: Sequence[Item]) -> None:
        """Keep what is left of the batch that was under way."""
        if items is self._batch:
            self._batch = list(left)
        else:
            self._urgent = [list(left) if one is items else one for one in self._urgent]
            self._urgent = [one for one in self._urgent if one]

    def _drop(self, item: Item, error: str) -> None:
        """Give up what is said of an alarm, and say so."""
        self.delivery.give_up(error)
        _log.error(
            "notification_given_up",
            notification=self.section.id,
            alarm=item.alarm.id,
            events=list(item.events),
            reason=error,
        )
        self._give_up(item, error)
        self._finish([item], rules.not_taken)


def _end_if_cancelled() -> None:
    """End a task that was cancelled while it sent.

    `asyncio.wait_for` of Python 3.11, which aiosmtplib uses, swallows a cancellation that comes
    together with the answer it waits for; the service would not stop.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def _event_ids(item: Item) -> list[str]:
    return [f"{item.alarm.id}:{event}" for event in item.events]


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
