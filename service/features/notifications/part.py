"""Follows the alarms of a cell and gives each recipient its notifications."""

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import msgspec
import structlog
from prometheus_client import CollectorRegistry, Counter, Gauge

from adapters.protocol import Clock
from service.alarms import AlarmBook, AlarmState
from service.alarms.records import assets_of
from service.alarms.silencing import Silencing
from service.bus.calls import answering
from service.bus.interface import Handlers
from service.cell.core import Core
from service.clock import MICROSECONDS
from service.features.notifications import rules
from service.features.notifications.interface import Notifications, NotificationState
from service.features.notifications.messages import Item
from service.features.notifications.notification_queue import NotificationQueue
from service.features.notifications.sections import NotificationSection, sections_of
from service.features.notifications.senders import make_sender, send_test
from service.features.notifications.tables import (
    Notification,
    NotificationChange,
    load_notifications,
)
from service.pauses import Steps
from service.site.settings import Settings
from service.store import Alarm, AuditEntry, Outbox, Store
from service.tasks import Part

#: Wall seconds between two looks for changed alarms, and for what time brings.
TICK_S: Final = 0.2
LOOK_S: Final = 1.0
#: Changed alarms that are looked at without a pause.
_BATCH_SIZE: Final = 20
#: Notifications in one change of the outbox.
_CHANGE_SIZE: Final = 200

_log = structlog.get_logger(__name__)


def part(core: Core) -> Part:
    """Make the part of the cell."""
    return Notifier(
        core.settings,
        core.store,
        core.outbox,
        core.clock,
        core.names_of,
        core.alarms,
        lambda: core.silencing,
        core.registry,
        core.loaded_by_us,
    )


class Notifier(Part):
    """Notifies people and programs of alarms; nothing that follows machines ever waits for it.

    What is sent follows from the alarms and from what was sent before. Both are kept in the store,
    so that it goes on where it was after a restart, or in another cell.

    Parameters
    ----------
    settings : Settings
        The configuration.
    store, outbox
        Where notifications are kept.
    clock : Clock
        Process time: quiet hours and escalation count in it.
    asset : callable
        Gives name and family of an asset.
    book : AlarmBook
        The alarms as they are now.
    silencing : callable
        Gives what says which assets are silenced.
    registry : CollectorRegistry
        Where the state of each notification is measured.
    loaded_by_us : int or None
        By how many microseconds the clock was set since the last run; None: not known.

    Raises
    ------
    SettingsError
        If a notification cannot be used as it is configured.
    """

    name = "notifications"

    def __init__(
        self,
        settings: Settings,
        store: Store,
        outbox: Outbox,
        clock: Clock,
        asset: Callable[[str], tuple[str, str]],
        book: AlarmBook,
        silencing: Callable[[], Silencing],
        registry: CollectorRegistry,
        loaded_by_us: int | None = 0,
    ) -> None:
        self._loaded_by_us = loaded_by_us
        self._moved: Sequence[Notification] = ()
        self._settings = settings
        self._store = store
        self._outbox = outbox
        self._clock = clock
        self._asset = asset
        self._book = book
        self._silencing = silencing
        # Of other assets it is not known yet what was sent.
        self._assets: set[str] = set()
        self._all_assets = False
        self._news: deque[Callable[[], None]] = deque()
        # While what came before the clock was set is taken in: by how much it was.
        self._behind_us = 0
        self._queues = {
            one.id: NotificationQueue(
                one,
                make_sender(one, settings),
                clock,
                lambda name: self._asset(name)[0],
                self._keep,
                silencing,
                partial(self._give_up, one.id),
            )
            for one in sections_of(settings).notifications
        }
        self._given_up = Counter(
            "bearing_twin_notification_given_up",
            "Alarms of which a notification was refused for good.",
            ["notification"],
            registry=registry,
        )
        up = Gauge(
            "bearing_twin_notification_up",
            "Whether the last try of a notification succeeded.",
            ["notification"],
            registry=registry,
        )
        for name, queue in self._queues.items():
            up.labels(name).set_function(partial(_is_up, queue))
            self._given_up.labels(name)

    # ------------------------------------------------------------------ from any thread
    def alarm_changed(self, alarm: Alarm) -> None:
        """Note that an alarm has changed; returns at once."""
        if self._queues:
            self._news.append(lambda: self._take(alarm))

    def take_over(self, assets: Collection[str] | None = None) -> None:
        """Go on with the alarms of some assets, or of all, as they are kept; reads from the store.

        Raises `StoreUnavailableError` if the store does not answer.
        """
        if not self._queues:
            return
        self._silencing().read()
        kept = load_notifications(self._store, self._outbox)
        notifications = [one for one in kept if assets is None or one.alarm.asset in assets]
        by_us = self._loaded_by_us if assets is None else 0
        if by_us:
            notifications = [rules.moved(one, by_us) for one in notifications]
            self._moved = notifications
        self._news.append(lambda: self._begin(notifications, assets))

    def leave(self, assets: Sequence[str]) -> None:
        """Drop the alarms of some assets: another cell sends their notifications."""
        self._drain(len(self._news))
        self._assets.difference_update(assets)
        for queue in self._queues.values():
            queue.forget(assets)

    def keep_moved(self) -> None:
        """Have written what was moved as it was loaded."""
        self._keep(self._moved)
        self._moved = ()

    def clock_set(self, by_us: int) -> None:
        """Let escalations wait for as long as before: the clock was set by so much.

        What has changed before that is taken in first, with the time that was then.
        """
        self._behind_us = by_us
        while self._news:  # some of it brings more
            self._drain(len(self._news))
        self._behind_us = 0
        elsewhere = self._book.dated_elsewhere()
        for queue in self._queues.values():
            known = queue.notifications.values()
            later = [rules.moved(one, by_us) for one in known if one.alarm.id not in elsewhere]
            for notification in later:
                queue.put(notification)
            self._keep(later)

    # ------------------------------------------------------------------ what is asked
    def handlers(self) -> Handlers:
        """What it answers; see `Notifications`."""
        return answering(Notifications)(self)

    async def states(self) -> list[NotificationState]:
        """How each notification is, in the order of the configuration."""
        return [await queue.state() for queue in self._queues.values()]

    def problems(self) -> Mapping[str, str | None]:
        """What is wrong with notifications that have failed several times in a row."""
        problems = (queue.delivery.problem for queue in self._queues.values())
        return {self.name: "; ".join(one for one in problems if one) or None}

    async def test(
        self, notification: str, who: str, audit: AuditEntry | None = None
    ) -> tuple[bool, str]:
        """Send a test message; see `send_test`."""
        queue = self._queues.get(notification)
        if queue is None:
            return False, f"the cell has another configuration, without {notification!r}"
        if audit is not None:
            self._outbox.record(audit)
        is_sent, detail = await send_test(self._settings, queue.section, who)
        if is_sent:
            queue.delivery.accept(detail)
        return is_sent, detail

    # ------------------------------------------------------------------ work
    async def run(self) -> None:
        """Follow the alarms and send notifications, until cancelled."""
        if not self._queues:
            await asyncio.Event().wait()
        async with asyncio.TaskGroup() as tasks:
            for name, queue in self._queues.items():
                tasks.create_task(queue.run(), name=f"notification {name}")
            while True:
                for _ in range(round(LOOK_S / TICK_S)):
                    while self._news:
                        self._drain(_BATCH_SIZE)
                        await asyncio.sleep(0)  # a poll that is due comes in between
                    await asyncio.sleep(TICK_S)
                await self._look()

    def _drain(self, most: int) -> None:
        for _ in range(min(most, len(self._news))):
            _try(self._news.popleft())

    def _begin(self, notifications: Sequence[Notification], assets: Collection[str] | None) -> None:
        """Go on with what is kept, and with what became of its alarms since."""
        if assets is None:
            self._all_assets = True
        else:
            self._assets.update(assets)
        changed: list[Notification] = []
        for notification in notifications:
            queue = self._queues.get(notification.section_id)
            if queue is None:  # it is not configured any more
                changed.append(msgspec.structs.replace(notification, over=True))
            else:
                queue.put(notification)
        self._keep(changed)
        active = self._book.active()
        alarms = {one.id: one for one in active if assets is None or one.asset in assets}
        for notification in notifications:
            if notification.alarm.id not in alarms:
                alarms[notification.alarm.id] = self._ended(notification.alarm)
        # Before what has changed since; of thousands, all at once would make a poll late.
        self._news.extendleft(partial(self._take, one) for one in reversed(alarms.values()))

    def _ended(self, alarm: Alarm) -> Alarm:
        """Make an alarm that is not open any more one that is over."""
        returned_us = alarm.returned_at_us or self._now_us()
        state = AlarmState.NORM.value
        return replace(alarm, state=state, present=False, returned_at_us=returned_us)

    def _take(self, alarm: Alarm) -> None:
        if self._all_assets or alarm.asset in self._assets:
            self._keep(self._updated(alarm))

    def _updated(self, alarm: Alarm) -> list[Notification]:
        """Note an alarm as it is now; gives the notifications that have changed."""
        changed = []
        for queue in self._queues.values():
            section = queue.section
            before = queue.notifications.get(alarm.id)
            selected = rules.is_selected(section, alarm, lambda name: self._asset(name)[1])
            notification = rules.updated(before, alarm, section, selected)
            if notification is None:
                continue
            notification = self._released(notification, section)
            if queue.put(notification):
                changed.append(notification)
        return changed

    def _now_us(self) -> int:
        return self._clock.now_us() - self._behind_us

    def _released(self, notification: Notification, section: NotificationSection) -> Notification:
        now_us = self._now_us()
        if notification.released_us is not None or notification.over:
            return notification
        if rules.is_held(section, notification.alarm, self._silencing(), now_us):
            return notification
        return msgspec.structs.replace(notification, released_us=now_us)

    async def _look(self) -> None:
        """See what time brings: the end of quiet hours and silences, and escalation."""
        for queue in self._queues.values():
            steps = Steps()
            for alarm_id in list(queue.notifications):
                # The clock may be set in a pause.
                _try(partial(self._look_at, queue, alarm_id, self._clock.now_us()))
                await steps.pause()
            queue.look()

    def _look_at(self, queue: NotificationQueue, alarm_id: str, now_us: int) -> None:
        notification = queue.notifications.get(alarm_id)
        if notification is None:  # over since the look began, or another cell's
            return
        changed: dict[tuple[str, str], Notification] = {}
        after = rules.given_up(self._released(notification, queue.section), now_us)
        if after is not notification and queue.put(after):
            changed[after.key] = after
        for one in self._escalated(queue.section, after, now_us):
            self._queues[one.section_id].put(one)
            changed[one.key] = one
        self._keep(changed.values())

    def _escalated(
        self, section: NotificationSection, notification: Notification, now_us: int
    ) -> Iterable[Notification]:
        """Notify further recipients of an alarm that is not acknowledged in time."""
        released_us, alarm = notification.released_us, notification.alarm
        steps = section.escalation[notification.steps :]
        if not steps or released_us is None or alarm.state != AlarmState.UNACK:
            return
        if rules.is_silenced(alarm, self._silencing(), now_us):
            return
        for step in steps:
            if now_us - released_us < step.after_min * 60 * MICROSECONDS:
                return
            other = self._queues[step.to].notifications.get(alarm.id)
            yield rules.escalated(notification, other, step.to, now_us)
            notification = msgspec.structs.replace(notification, steps=notification.steps + 1)
            yield notification

    def _give_up(self, section_id: str, item: Item, reason: str) -> None:
        """Say that a recipient was not notified of an alarm."""
        self._given_up.labels(section_id).inc()
        alarm = item.alarm
        what = ", ".join(dict.fromkeys(map(rules.kind_of, item.events)))
        message = f"{section_id} was not notified ({what}) of: {alarm.message}; {reason}"
        self._book.record_events(assets_of(alarm), "notification refused", message)

    def _keep(self, notifications: Iterable[Notification]) -> None:
        changed = list(notifications)
        for begin in range(0, len(changed), _CHANGE_SIZE):
            portion = tuple(changed[begin : begin + _CHANGE_SIZE])
            self._outbox.record(NotificationChange(portion))


def _try(work: Callable[[], None]) -> None:
    """Work; whatever it is that fails, machines are followed and the next alarm is sent."""
    try:
        work()
    except Exception:
        _log.exception("notifications_failed")


def _is_up(queue: NotificationQueue) -> float:
    return float(not queue.delivery.tries)
