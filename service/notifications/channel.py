"""One notification: what it owes, and the loop that tells it."""

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import structlog

from adapters.backoff import Backoff
from adapters.protocol import Clock
from service.clock import wall_us
from service.notifications import rules
from service.notifications.messages import Item, Letter
from service.notifications.sender import NotToldError, Sender
from service.notifications.states import NotificationState
from service.site.notification_section import NotificationSection
from service.store import Silence, Telling

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


class Channel:
    """Tells the receivers of one notification what it owes.

    Parameters
    ----------
    section : NotificationSection
        Its configuration.
    sender : Sender
        Hands messages over.
    clock : Clock
        Process time.
    name_of : callable
        Gives the name of an asset.
    keep : callable
        Takes tellings that have changed, to be written.
    silences : callable
        Gives the silences that are known.

    Attributes
    ----------
    tellings : dict of str to Telling
        By alarm.
    """

    def __init__(
        self,
        section: NotificationSection,
        sender: Sender,
        clock: Clock,
        name_of: Callable[[str], str],
        keep: Callable[[Iterable[Telling]], None],
        silences: Callable[[], Sequence[Silence]],
    ) -> None:
        self.section = section
        self.tellings: dict[str, Telling] = {}
        self._sender = sender
        self._clock = clock
        self._name_of = name_of
        self._keep = keep
        self._silences = silences
        self._wake = asyncio.Event()
        self._last_s = -math.inf
        self._batch: list[Item] = []
        # As they are now, also those that are over since.
        self._under_way: dict[str, Telling] = {}
        self._tries = 0
        self._failing_since_us: int | None = None
        self._told_us: int | None = None
        self._error = ""

    # ------------------------------------------------------------------ what is owed
    def put(self, telling: Telling) -> bool:
        """Take a telling as it is now; says whether more than the figures of its alarm changed."""
        known = self.tellings.get(telling.alarm.id)
        if telling.alarm.id in self._under_way:
            self._under_way[telling.alarm.id] = telling
        if telling.over:
            self.tellings.pop(telling.alarm.id, None)
        else:
            self.tellings[telling.alarm.id] = telling
        if telling.owed:
            self._wake.set()
        return known is None or _progress(known) != _progress(telling)

    def forget(self, assets: Iterable[str]) -> None:
        """Know nothing of the alarms of some assets any more."""
        gone = set(assets)
        for known in (self.tellings, self._under_way):
            for alarm_id in [id for id, one in known.items() if one.alarm.asset in gone]:
                del known[alarm_id]

    def look(self) -> None:
        """Wake up: time has passed, and what was held back may be told."""
        self._wake.set()

    def state(self) -> NotificationState:
        """How it is."""
        waiting = sum(bool(one.owed) for one in self.tellings.values())
        return NotificationState(
            id=self.section.id,
            waiting=waiting,
            held=waiting - len(self._due()),
            told_us=self._told_us,
            failing_since_us=self._failing_since_us,
            tries=self._tries,
            error=self._error,
        )

    @property
    def problem(self) -> str | None:
        """What is wrong with it, if it has failed several times in a row."""
        if self._tries < FAILS_AFTER:
            return None
        return f"notification {self.section.id} fails: {self._error}"

    # ------------------------------------------------------------------ telling
    async def run(self) -> None:
        """Tell what is owed, until cancelled."""
        backoff = Backoff(RETRY_FIRST_S, RETRY_LAST_S)
        try:
            while True:
                while not self._due():
                    await self._woken()
                await asyncio.sleep(GATHER_S)
                while time.monotonic() < self._free_s():
                    await self._woken()
                while items := self._next_batch():
                    if await self._tell(items):
                        backoff.reset()
                    else:
                        await asyncio.sleep(backoff.next())
        finally:
            await self._sender.close()

    async def _woken(self) -> None:
        """Wait until there is more to tell, or a second has passed."""
        self._wake.clear()
        await self._wake.wait()

    def _free_s(self) -> float:
        """Monotonic time of the next message at the earliest."""
        interval_s = self.section.interval_s
        return self._last_s + (URGENT_SHARE * interval_s if self._is_urgent() else interval_s)

    def _due(self) -> list[Item]:
        now_us, silences = self._clock.now_us(), self._silences()
        found = []
        for telling in self.tellings.values():
            events = rules.due(telling, silences, now_us)
            if events:
                found.append(Item(telling, events))
        return found

    def _is_urgent(self) -> bool:
        return any(
            one.telling.alarm.priority == 1
            and any(rules.kind_of(event) != rules.RETURNED for event in one.events)
            for one in self._due()
        )

    def _next_batch(self) -> list[Item]:
        """What goes out next: what could not be told before, as long as all of it is still owed."""
        due = {one.telling.alarm.id: one for one in self._due()}
        again = [
            Item(due[one.telling.alarm.id].telling, one.events)
            for one in self._batch
            if one.telling.alarm.id in due
            and set(one.events) <= set(due[one.telling.alarm.id].events)
        ]
        if not again or len(again) < len(self._batch):
            again = list(due.values())[:MOST_ITEMS]
        self._batch = again
        return again

    async def _tell(self, items: Sequence[Item]) -> bool:
        letter = Letter(self.section.id, items, self._name_of)
        self._under_way = {one.telling.alarm.id: one.telling for one in items}
        try:
            error = await self._sender.send(letter) or ""
        except NotToldError as refusal:
            self._fail(str(refusal))
            return False
        except Exception as unexpected:
            # Whatever it was: it is tried again, and the service goes on.
            _log.exception("notification_failed", notification=self.section.id)
            self._fail(type(unexpected).__name__)
            return False
        self.note_success(error)
        self._told_us, self._last_s = wall_us(), time.monotonic()
        self._batch = []
        changed = []
        for item in items:
            # It may have changed while the message was under way, or be another cell's.
            known = self._under_way.pop(item.telling.alarm.id, None)
            if known is not None:
                telling = rules.sent(known, item.events)
                self.put(telling)
                changed.append(telling)
        self._under_way = {}
        self._keep(changed)
        _log.info("notification_told", notification=self.section.id, alarms=len(items))
        return True

    def note_success(self, error: str) -> None:
        """Note that a message was taken, and by whom not."""
        if self._tries >= FAILS_AFTER:
            _log.info("notification_told_again", notification=self.section.id)
        self._tries, self._failing_since_us, self._error = 0, None, error

    def _fail(self, error: str) -> None:
        self._tries += 1
        self._error = error
        if self._failing_since_us is None:
            self._failing_since_us = wall_us()
        if self._tries == FAILS_AFTER:
            _log.error("notification_fails", notification=self.section.id, reason=error)


def _progress(telling: Telling) -> tuple[object, ...]:
    """What must be known after a restart."""
    return (
        telling.alarm.state,
        telling.raise_number,
        telling.owed,
        telling.told,
        telling.released_us,
        telling.called,
        telling.steps,
        telling.over,
    )
