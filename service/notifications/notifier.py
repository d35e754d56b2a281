"""Follows the alarms of a cell and hands them to its notifications."""

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import structlog
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge

from adapters.protocol import Clock
from service.alarms import AlarmBook, AlarmState
from service.clock import MICROSECONDS
from service.notifications import rules
from service.notifications.channel import Channel
from service.notifications.messages import Letter
from service.notifications.sender import NotToldError
from service.notifications.senders import make_sender
from service.notifications.states import NotificationState
from service.site.notification_section import NotificationSection
from service.site.settings import Settings
from service.store import (
    Alarm,
    AuditEntry,
    Outbox,
    Silence,
    Store,
    StoreUnavailableError,
    Telling,
    TellingChange,
)

#: Wall seconds between two looks for changed alarms, for what time brings, and for silences.
TICK_S: Final = 0.2
LOOK_S: Final = 1.0
SILENCES_S: Final = 2.0
#: Changed alarms that are looked at in one go.
_AT_ONCE: Final = 20
#: Tellings in one change of the outbox.
_PORTION: Final = 200

_log = structlog.get_logger(__name__)


class Notifier:
    """Tells people and programs of alarms; nothing that follows machines ever waits for it.

    What is told follows from the alarms and from what was told before. Both are kept in the store,
    so that it goes on where it was after a restart, or in another cell.

    Parameters
    ----------
    settings : Settings
        The configuration.
    store, outbox
        Where tellings and silences are kept.
    clock : Clock
        Process time: quiet hours and escalation count in it.
    asset : callable
        Gives name and family of an asset.
    registry : CollectorRegistry
        Where the state of each notification is measured.

    Raises
    ------
    SettingsError
        If a notification cannot be used as it is configured.
    """

    def __init__(
        self,
        settings: Settings,
        store: Store,
        outbox: Outbox,
        clock: Clock,
        asset: Callable[[str], tuple[str, str]],
        registry: CollectorRegistry,
    ) -> None:
        self._settings = settings
        self._store = store
        self._outbox = outbox
        self._clock = clock
        self._asset = asset
        self._silences: Sequence[Silence] = ()
        # Of other assets it is not known yet what was told.
        self._assets: set[str] = set()
        self._all_assets = False
        self._news: deque[Callable[[], None]] = deque()
        self._channels = {
            one.id: Channel(
                one,
                make_sender(one, settings),
                clock,
                lambda name: self._asset(name)[0],
                self._keep,
                lambda: self._silences,
            )
            for one in settings.notifications
        }
        up = Gauge(
            "bearing_twin_notification_up",
            "Whether the last try of a notification succeeded.",
            ["notification"],
            registry=registry,
        )
        for name, channel in self._channels.items():
            up.labels(name).set_function(partial(_is_up, channel))

    # ------------------------------------------------------------------ from any thread
    def take(self, alarm: Alarm) -> None:
        """Take note of an alarm that has changed; returns at once."""
        if self._channels:
            self._news.append(lambda: self._take(alarm))

    def take_over(self, book: AlarmBook, assets: Collection[str] | None = None) -> None:
        """Go on with the alarms of some assets, or of all, as they are kept; reads from the store.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        if not self._channels:
            return
        self._read_silences()
        known = self._outbox.load_tellings()
        tellings = [one for one in known if assets is None or one.alarm.asset in assets]
        self._news.append(lambda: self._begin(book, tellings, assets))

    def leave(self, assets: Sequence[str]) -> None:
        """Know nothing of the alarms of some assets any more: another cell tells them."""
        self._drain(len(self._news))
        self._assets.difference_update(assets)
        for channel in self._channels.values():
            channel.forget(assets)

    # ------------------------------------------------------------------ what there is
    def states(self) -> list[NotificationState]:
        """How each notification is, in the order of the configuration."""
        return [one.state() for one in self._channels.values()]

    def problem(self) -> str | None:
        """What is wrong with notifications that have failed several times in a row."""
        problems = (one.problem for one in self._channels.values())
        return "; ".join(one for one in problems if one) or None

    async def test(
        self, notification: str, who: str, audit: AuditEntry | None = None
    ) -> tuple[bool, str]:
        """Send a test message; see `send_test`."""
        channel = self._channels.get(notification)
        if channel is None:
            return False, f"the cell has another configuration, without {notification!r}"
        if audit is not None:
            self._outbox.record(audit)
        told, detail = await send_test(self._settings, channel.section, who)
        if told:
            channel.note_success(detail)
        return told, detail

    # ------------------------------------------------------------------ work
    async def run(self) -> None:
        """Follow the alarms and tell them, until cancelled."""
        if not self._channels:
            await asyncio.Event().wait()
        async with asyncio.TaskGroup() as tasks:
            for name, channel in self._channels.items():
                tasks.create_task(channel.run(), name=f"notification {name}")
            tasks.create_task(self._follow_silences(), name="silences")
            while True:
                for _ in range(round(LOOK_S / TICK_S)):
                    while self._news:
                        self._drain(_AT_ONCE)
                        await asyncio.sleep(0)  # a poll that is due comes in between
                    await asyncio.sleep(TICK_S)
                _try(self._look)

    def _drain(self, most: int) -> None:
        for _ in range(min(most, len(self._news))):
            _try(self._news.popleft())

    def _begin(
        self, book: AlarmBook, tellings: Sequence[Telling], assets: Collection[str] | None
    ) -> None:
        """Take in what is kept, and what became of its alarms since."""
        if assets is None:
            self._all_assets = True
        else:
            self._assets.update(assets)
        changed: list[Telling] = []
        for telling in tellings:
            channel = self._channels.get(telling.notification)
            if channel is None:
                changed.append(replace(telling, over=True))  # it is not configured any more
            else:
                channel.put(telling)
        alarms = {one.id: one for one in book.active() if assets is None or one.asset in assets}
        for telling in tellings:
            if telling.alarm.id not in alarms:
                alarms[telling.alarm.id] = self._ended(telling.alarm)
        for alarm in alarms.values():
            changed += self._noted(alarm)
        self._keep(changed)

    def _ended(self, alarm: Alarm) -> Alarm:
        """Say of an alarm that is not open any more that it is over."""
        returned_us = alarm.returned_at_us or self._clock.now_us()
        state = AlarmState.NORM.value
        return replace(alarm, state=state, present=False, returned_at_us=returned_us)

    def _take(self, alarm: Alarm) -> None:
        if self._all_assets or alarm.asset in self._assets:
            self._keep(self._noted(alarm))

    def _noted(self, alarm: Alarm) -> list[Telling]:
        """Take in an alarm; gives the tellings that have changed."""
        changed = []
        for channel in self._channels.values():
            section = channel.section
            known = channel.tellings.get(alarm.id)
            wanted = rules.is_wanted(section, alarm, self._asset(alarm.asset)[1])
            telling = rules.noted(known, alarm, section, wanted)
            if telling is None:
                continue
            telling = self._released(telling, section)
            if channel.put(telling):
                changed.append(telling)
        return changed

    def _released(self, telling: Telling, section: NotificationSection) -> Telling:
        now_us = self._clock.now_us()
        if telling.released_us is not None or telling.over:
            return telling
        if rules.is_held(section, telling.alarm, self._silences, now_us):
            return telling
        return replace(telling, released_us=now_us)

    def _look(self) -> None:
        """See what time brings: the end of quiet hours and silences, and escalation."""
        now_us = self._clock.now_us()
        changed: dict[tuple[str, str], Telling] = {}
        for channel in self._channels.values():
            for telling in list(channel.tellings.values()):
                after = rules.given_up(self._released(telling, channel.section), now_us)
                if after is not telling and channel.put(after):
                    changed[after.key] = after
                for one in self._escalated(channel.section, after, now_us):
                    self._channels[one.notification].put(one)
                    changed[one.key] = one
            channel.look()
        self._keep(changed.values())

    def _escalated(
        self, section: NotificationSection, telling: Telling, now_us: int
    ) -> Iterable[Telling]:
        """Call in whoever is to be called as nobody has acknowledged an alarm."""
        released_us, alarm = telling.released_us, telling.alarm
        steps = section.escalation[telling.steps :]
        if not steps or released_us is None or alarm.state != AlarmState.UNACK:
            return
        if rules.is_silent(alarm.asset, self._silences, now_us):
            return
        for step in steps:
            if now_us - released_us < step.after_min * 60 * MICROSECONDS:
                return
            known = self._channels[step.to].tellings.get(alarm.id)
            yield rules.escalated(telling, known, step.to, now_us)
            telling = replace(telling, steps=telling.steps + 1)
            yield telling

    def _keep(self, tellings: Iterable[Telling]) -> None:
        changed = list(tellings)
        for begin in range(0, len(changed), _PORTION):
            self._outbox.record(TellingChange(tuple(changed[begin : begin + _PORTION])))

    def _read_silences(self) -> None:
        self._silences = self._store.silences.load(self._clock.now_us())

    async def _follow_silences(self) -> None:
        """Know what was silenced: by another process, or before the start."""
        while True:
            await asyncio.sleep(SILENCES_S)
            await to_thread.run_sync(_try, self._read_silences)


def _try(work: Callable[[], None]) -> None:
    """Work; whatever it is that fails, machines are followed and the next alarm is told."""
    try:
        work()
    except StoreUnavailableError:
        return  # the silences that are known still hold
    except Exception:
        _log.exception("notifications_failed")


def _is_up(channel: Channel) -> float:
    return float(not channel.state().tries)


async def send_test(settings: Settings, section: NotificationSection, who: str) -> tuple[bool, str]:
    """Send a test message.

    Returns
    -------
    told : bool
        Whether it was taken, by one of the receivers at least.
    detail : str
        Why not, or by whom not; else empty.

    Raises
    ------
    SettingsError
        If the notification cannot be used as it is configured.
    """
    sender = await to_thread.run_sync(make_sender, section, settings)
    try:
        return True, await sender.send(Letter(section.id, (), lambda name: name, who)) or ""
    except NotToldError as error:
        return False, str(error)
    finally:
        await sender.close()
