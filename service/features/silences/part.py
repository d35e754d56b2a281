"""What is silenced in the cell: read from the store every two seconds."""

import asyncio
from collections.abc import Sequence
from typing import Final

import structlog
from anyio import to_thread

from adapters.protocol import Clock
from service.alarms.silencing import Silencing
from service.cell.core import Core
from service.features.silences.silence_times import SilenceTimes
from service.features.silences.tables import MovedSilences, Silence, Silences
from service.store import Outbox, Store, StoreUnavailableError
from service.tasks import Part

#: Wall seconds between two reads: another process may have made or ended a silence.
READ_S: Final = 2.0

_log = structlog.get_logger(__name__)


def part(core: Core) -> Part:
    """Make the part, and have the cell ask it what is silenced."""
    silences = KnownSilences(
        core.store,
        core.clock,
        core.outbox,
        is_alone=core.share is None,
        loaded_by_us=core.loaded_by_us,
    )
    core.silencing = silences
    return silences


class KnownSilences(Part, Silencing):
    """The silences of the store as they were at the last read.

    - ``is_alone``: no other cell has them, too; the clock of one says nothing of those of others.
    - ``loaded_by_us``: by how many microseconds the clock was set since the last run. None: it is
      not known how those are dated that there are at the start, and they go by the calendar.
    """

    name = "silences"

    def __init__(
        self,
        store: Store,
        clock: Clock,
        outbox: Outbox,
        *,
        is_alone: bool = True,
        loaded_by_us: int | None = 0,
    ) -> None:
        self._store, self._outbox = store, outbox
        self._clock = clock
        self._is_alone = is_alone
        # Until the first read.
        self._loaded_by_us = loaded_by_us
        # Those that go by the calendar, as they are dated by another clock.
        self._elsewhere: set[str] = set()
        # As they were and as they are since the clock was set; the store has these soon.
        self._moved: dict[str, tuple[Silence, Silence]] = {}
        self._times_set = 0
        self._silences: Sequence[Silence] = []
        self._times = SilenceTimes()

    def covers(self, asset: str, now_us: int) -> bool:
        """Whether the alarms of an asset are not to be sent at a process time."""
        return self._times.covers(asset, now_us)

    def read_store(self) -> None:
        """Know what there is before any alarm is sent."""
        self.read()

    def read(self) -> None:
        """Know what the store holds now.

        Raises `StoreUnavailableError` if the store does not answer; what was known still holds.
        """
        self._take(self._load())

    def clock_set(self, by_us: int) -> None:
        """Let silences last as long as before: those in force that go by no calendar."""
        self._times_set += 1
        if self._is_alone:
            self._silences = [self._with_times(one, by_us) for one in self._silences]
            self._times = SilenceTimes(self._silences)
            self.keep_moved()

    def _with_times(self, silence: Silence, by_us: int) -> Silence:
        later = silence.moved(self._clock.now_us() - by_us, by_us)
        if silence.id in self._elsewhere or later == silence:
            return silence
        stored, _ = self._moved.get(silence.id, (silence, silence))
        self._moved[silence.id] = stored, later
        return later

    def keep_moved(self) -> None:
        """Have written what was moved."""
        if self._moved:
            moved = tuple(later for _, later in self._moved.values())
            self._outbox.record(MovedSilences(moved))

    def _load(self) -> Sequence[Silence]:
        now_us = self._clock.now_us()
        # Also what is over by the new time only.
        ends_us = [stored.ends_us - 1 for stored, _ in tuple(self._moved.values())]
        before_us = now_us - (self._loaded_by_us or 0)
        return self._store.part(Silences).load(min(now_us, before_us, *ends_us))

    def _take(self, found: Sequence[Silence]) -> None:
        """Know what was found, as it is when all that waits has been written."""
        stored = {one.id: one for one in found}
        by_us, self._loaded_by_us = self._loaded_by_us, 0
        if by_us is None:
            self._elsewhere = set(stored)
        elif by_us:
            for silence in found:
                self._with_times(silence, by_us)
        self._moved = {
            name: (before, later)
            for name, (before, later) in self._moved.items()
            if stored.get(name) == before != later
        }
        silences = [self._moved[one.id][1] if one.id in self._moved else one for one in found]
        if silences != self._silences:
            self._silences, self._times = silences, SilenceTimes(silences)

    async def run(self) -> None:
        """Read until cancelled."""
        while True:
            await asyncio.sleep(READ_S)
            try:
                times_set = self._times_set
                found = await to_thread.run_sync(self._load)
                if times_set == self._times_set:  # else what is over was asked by another time
                    self._take(found)
            except StoreUnavailableError:
                continue  # the health of the store says so
            except Exception:
                _log.exception("silences_failed")
