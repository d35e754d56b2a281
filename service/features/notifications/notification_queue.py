"""The notifications of one recipient, and the loop that sends them."""

import asyncio
import math
import sys
import time
from collections.abc import Callable, Container, Iterable, Sequence
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
        # Messages that could not be sent: they stay as they are, as some addresses may have them.
        # The first is the one that is sent; what is urgent and came later goes before the others.
        self._messages: list[list[Item]] = []
        # Events that were tried since a message was accepted.
        self._tried: set[str] = set()
        self._most = MOST_ITEMS
        self._backoff = Backoff(RETRY_FIRST_S, RETRY_LAST_S)
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
        try:
            while True:
                while not (await self._due(1) or self._refused_and_due()):
                    await self._woken()
                await asyncio.sleep(GATHER_S)
                while time.monotonic() < await self._free_s():
                    await self._woken()
                while items := await self._next_message():
                    rest_s = await self._send(items)
                    await self._rest(self._backoff.next() if rest_s is None else rest_s)
        finally:
            await self._sender.close()

    async def _woken(self) -> None:
        """Wait until a notification has changed since the last look, or a second has passed."""
        await self._wake.wait()
        self._wake.clear()

    async def _rest(self, rest_s: float) -> None:
        """Try nothing again for a while; what is urgent and new is tried once alone.

        Ends early when that is accepted: the receiver takes messages again.
        """
        end_s = time.monotonic() + rest_s
        while (left_s := end_s - time.monotonic()) > 0:
            # Changes of alarms that wait do not wake it: of thousands, each would be a look at all.
            await asyncio.sleep(min(GATHER_S, left_s))
            if time.monotonic() < self._last_s + URGENT_SHARE * self.section.interval_s:
                continue
            if urgent := await self._urgent(self._tried):
                self._messages.insert(0, urgent)
                if await self._send(urgent) == 0:
                    return

    async def _urgent(self, tried: Container[str] = ()) -> list[Item]:
        """What is urgent and in no message that waits, if not all of its events were tried."""
        waiting = self._waiting()
        return await self._due(
            self._most,
            lambda item: (
                _is_urgent(item)
                and item.alarm.id not in waiting
                and any(event not in tried for event in item.event_ids)
            ),
        )

    def _waiting(self) -> set[str]:
        """Alarms in messages that could not be sent."""
        return {item.alarm.id for message in self._messages for item in message}

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

    def _refused_and_due(self, is_asked: Callable[[Item], bool] = lambda item: True) -> list[Item]:
        """Give what was refused alone and not tried for the longest time, to be tried alone."""
        now_us, silencing, waiting = self._clock.now_us(), self._silencing(), self._waiting()
        for alarm_id in self._refusals.due():
            notification = self._pending[alarm_id]
            item = Item(notification, rules.due(notification, silencing, now_us))
            if alarm_id not in waiting and self._refusals.holds(item) and is_asked(item):
                return [item]
        return []

    async def _next_message(self) -> list[Item]:
        """What goes out next: what is urgent, then what could not be sent, then all that is due."""
        urgent = await self._urgent()
        due = await self._due(self._most)
        # Nothing waits from here on until it is under way, so that no change is missed.
        urgent = self._still_due(urgent)
        self._messages = [left for one in self._messages if (left := self._still_due(one))]
        message = urgent
        if not self._messages:
            known = {item.alarm.id for item in urgent}
            message = [*urgent, *(one for one in due if one.alarm.id not in known)][: self._most]
        if not urgent:
            message = self._refused_and_due(_is_urgent) or message
        if not (message or self._messages):
            message = self._refused_and_due()
        if message:
            self._messages.insert(0, message)
        return self._messages[0] if self._messages else []

    def _still_due(self, message: Sequence[Item]) -> list[Item]:
        """Give what is still to be sent of a message, as it is now.

        It is not joined with anything else: some addresses may have it.
        """
        now_us, silencing = self._clock.now_us(), self._silencing()
        left = []
        for item in message:
            if notification := self._pending.get(item.alarm.id):
                # What some addresses have the others get, too, whatever is silenced since.
                due = {*rules.due(notification, silencing, now_us), *notification.partly}
                if events := tuple(event for event in item.events if event in due):
                    left.append(Item(notification, events))
        return left

    async def _send(self, items: Sequence[Item]) -> float | None:
        """Send the first message; gives wall seconds of rest, None for those of the back-off."""
        message = OutgoingMessage(self.section.id, items, self._name_of)
        self._under_way = {item.alarm.id: item.notification for item in items}
        self._tried.update(message.event_ids)
        rest_s: float | None = None
        try:
            detail = await self._sender.send(message) or ""
        except ContentRefusedError as error:
            rest_s = self._refuse(items, error)
        except PostponedError as error:
            self.delivery.fail(str(error))
            rest_s = self._postpone(items)
        except DeliveryError as error:
            self.delivery.fail(str(error))
            self._keep_for_later(items, is_partial=error.is_partial)
        except Exception as unexpected:
            # Whatever it was: it is tried again, and the service goes on.
            _log.exception("notification_failed", notification=self.section.id)
            refused = ContentRefusedError(type(unexpected).__name__, is_final=False)
            rest_s = self._refuse(items, refused)
        else:
            self._accept(items, detail)
            rest_s = 0.0
        _end_if_cancelled()
        return rest_s

    def _accept(self, items: Sequence[Item], detail: str) -> None:
        """Note that the first message was accepted."""
        self.delivery.accept(detail)
        self.delivery.sent_us, self._last_s = wall_us(), time.monotonic()
        self._refusals.note_accepted(items)
        self._backoff.reset()
        self._tried.clear()
        if len(items) >= self._most:
            self._most = min(MOST_ITEMS, 2 * self._most)
        del self._messages[0]
        self._finish(items, rules.sent)
        _log.info("notification_sent", notification=self.section.id, alarms=len(items))

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

    def _keep_for_later(self, items: Sequence[Item], *, is_partial: bool) -> None:
        """Let the first message wait; what is urgent and no address has goes with what follows."""
        if is_partial:
            self._last_s = time.monotonic()
            self._finish(items, rules.partly_sent)
        elif len(self._messages) > 1:
            del self._messages[0]

    def _refuse(self, items: Sequence[Item], error: ContentRefusedError) -> float:
        """Halve the first message, down to one alarm, which waits; gives wall seconds of rest."""
        if len(items) > 1:
            self._halve(items)
            return 0.0
        (item,) = items
        del self._messages[0]
        if item.alarm.id not in self._pending:  # shelved, say, while it was under way
            return 0.0
        if self._refusals.note_alone(item, is_final=error.is_final):
            self._drop(item, str(error))
        else:
            self.delivery.fail(str(error))
        return RETRY_FIRST_S

    def _postpone(self, items: Sequence[Item]) -> float | None:
        """Halve the first message when it is postponed again, and let one alarm alone wait.

        No alarm is given up for it. Gives wall seconds of rest, None for those of the back-off.
        """
        # In parts it is tried again soon: others in it may be taken.
        self._tried.difference_update(event for item in items for event in item.event_ids)
        if not self._refusals.knows_any(items):
            self._note_together(items)
            self._keep_for_later(items, is_partial=False)
            return None
        if len(items) > 1:
            self._halve(items)
            return RETRY_FIRST_S
        (item,) = items
        del self._messages[0]
        if item.alarm.id in self._pending:
            self._refusals.note_alone(item, is_final=False)
        return RETRY_FIRST_S

    def _halve(self, items: Sequence[Item]) -> None:
        """Have the first message, which no address has, gathered again in smaller ones."""
        self._most = len(items) // 2
        del self._messages[0]
        self._note_together(items)

    def _note_together(self, items: Sequence[Item]) -> None:
        """Note alarms whose common message was refused, of those that are still pending."""
        self._refusals.note_together(
            item.alarm.id for item in items if item.alarm.id in self._pending
        )

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
