"""Assets that are not followed for a while: what their history says of it."""

import asyncio
import contextlib
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from anyio import to_thread

from adapters.samples import Quality, Sample, is_bad
from service.alarms import AlarmBook
from service.clock import DAY_US, MICROSECONDS, ProcessClock
from service.domain.alarm_condition import EventKind
from service.ingest import Ingest
from service.live.guard import Guard
from service.store import Outbox, ProvisionedAsset, Store, StoreUnavailableError
from service.tasks import Part

_NOT_FOLLOWED: Final = (
    "Not followed any more: the asset was removed, or its configuration does not fit"
)
_AGAIN: Final = "Followed again; no data were recorded in between"
_GONE_KIND: Final[EventKind] = "asset not followed"
_AGAIN_KIND: Final[EventKind] = "asset followed again"
#: Events of older changes are not looked for: the journal may not reach that far.
_EVENTS_US: Final = 30 * DAY_US
#: Wall seconds until what waits on the disk is looked at again.
_WAIT_S: Final = 1.0
_FLUSH_S: Final = 5.0


class Absences(Part):
    """Marks in history and journal from when to when an asset is not followed.

    Without the mark a reader would draw a line from the last value before to the first one after.
    What this run sees is marked at once. The table of provisioned assets says when each was
    removed and added: what an earlier run could not mark, because it was killed or did not run,
    is marked from there.

    Parameters
    ----------
    store
        Knows which assets have been followed before.
    outbox
        Where events wait for the store.
    ingest
        The way of the marks to the store.
    alarms
        Whose journal gets the events.
    clock
        Process time.
    """

    name = "absences"

    def __init__(
        self,
        store: Store,
        outbox: Outbox,
        ingest: Ingest,
        alarms: AlarmBook,
        clock: ProcessClock,
    ) -> None:
        self._store = store
        self._outbox = outbox
        self._ingest = ingest
        self._alarms = alarms
        self._clock = clock
        # Newest sample of each channel, of assets that are not followed but may still be read.
        self._latest: dict[str, Mapping[str, Sample]] = {}
        # Assets whose end this run has marked.
        self._marked: set[str] = set()
        # Events that this run has written.
        self._noted: set[tuple[EventKind, str]] = set()
        # Assets to be compared with the table; None: all.
        self._asked: list[Collection[str] | None] = []
        self._something = asyncio.Event()

    def known(self, assets: Sequence[str]) -> set[str]:
        """Give those of some new assets that have a history; reads from the store."""
        return self._store.samples.with_history(assets) if assets else set()

    def note(self, gone: Mapping[str, Mapping[str, Sample]], again: Collection[str]) -> None:
        """Record assets that are followed no longer, and of those that are again.

        Parameters
        ----------
        gone
            Newest sample of each channel, by asset.
        again
            Assets with a history.
        """
        self._latest |= gone
        self._noted |= {(_GONE_KIND, name) for name in gone} | {
            (_AGAIN_KIND, name) for name in again
        }
        self._alarms.record_events(sorted(gone), _GONE_KIND, _NOT_FOLLOWED)
        self._alarms.record_events(sorted(again), _AGAIN_KIND, _AGAIN)

    def mark(self, assets: Collection[str], now_us: int) -> None:
        """Mark the end of each channel of assets that are not read any more either."""
        self._marked |= self._latest.keys() & set(assets)
        marks = [
            _mark(asset, channel, max(now_us, latest.time_us + 1), now_us)
            for asset in assets
            for channel, latest in self._latest.pop(asset, {}).items()
            if not is_bad(latest.quality)
        ]
        self._ingest.submit(marks)

    def compare(self, assets: Collection[str] | None = None) -> None:
        """Have the history of some assets, or of all, compared with the table; see `run`."""
        if assets is not None:
            seen = self._marked & set(assets)
            self._marked -= seen
            assets = set(assets) - seen
        if assets is None or assets:
            self._asked.append(assets)
            self._something.set()

    @property
    def is_done(self) -> bool:
        """Whether all that is to be compared has been."""
        return not self._asked

    async def run(self) -> None:
        """Mark what the table says and no earlier run has marked, until cancelled."""
        looking = Guard("marking_absences", "")
        while True:
            await self._something.wait()
            self._something.clear()
            while self._asked:
                with looking(), contextlib.suppress(StoreUnavailableError):
                    if not self._ingest.spooled:  # what waits on the disk belongs before the marks
                        marks = await to_thread.run_sync(self._compare, self._asked[0])
                        self._ingest.submit(marks)
                        del self._asked[0]
                        continue
                await asyncio.sleep(_WAIT_S)

    def _compare(self, names: Collection[str] | None) -> list[Sample]:
        """Write the events that are missing, and give the marks that are; reads from the store."""
        found = self._store.assets.once_removed(names)
        if names is None:
            if not self._outbox.flush(_FLUSH_S):  # else what waits there is written twice
                raise StoreUnavailableError(self._outbox.problem or "events wait")
            self._add_events(found)
        now_us = self._clock.now_us()
        marks: list[Sample] = []
        for one in found:
            if one.added_us is None:  # nothing comes after its end yet
                continue
            end_us = self._clock.at_wall_us(one.added_us)
            ends = self._store.samples.open_ends([one.id], end_us)
            marks += (_mark(one.id, name, end + 1, now_us) for (_, name), end in ends.items())
        return marks

    def _add_events(self, found: Sequence[ProvisionedAsset]) -> None:
        known = self.known([one.id for one in found])
        found = [one for one in found if one.id in known]
        self._add(_GONE_KIND, _NOT_FOLLOWED, {one.id: one.removed_us for one in found})
        self._add(_AGAIN_KIND, _AGAIN, {one.id: one.added_us for one in found})

    def _add(self, kind: EventKind, message: str, times: Mapping[str, int | None]) -> None:
        times_us = {
            name: self._clock.at_wall_us(wall_us)
            for name, wall_us in times.items()
            if wall_us is not None
        }
        written = self._store.alarms.newest_events(kind, times_us)
        oldest_us = self._clock.now_us() - _EVENTS_US
        missing = sorted(
            name
            for name, time_us in times_us.items()
            if time_us > oldest_us
            and (kind, name) not in self._noted
            and written.get(name, 0) < time_us - MICROSECONDS
        )
        self._alarms.record_events(missing, kind, message, times_us)


def _mark(asset: str, channel: str, time_us: int, now_us: int) -> Sample:
    return Sample(asset, channel, time_us, float("nan"), Quality.OUT_OF_SERVICE, now_us)
