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
from service.features.silences.tables import Silence, Silences
from service.store import Store, StoreUnavailableError
from service.tasks import Part

#: Wall seconds between two reads: another process may have made or ended a silence.
READ_S: Final = 2.0

_log = structlog.get_logger(__name__)


def part(core: Core) -> Part:
    """Make the part, and have the cell ask it what is silenced."""
    silences = KnownSilences(core.store, core.clock)
    core.silencing = silences
    return silences


class KnownSilences(Part, Silencing):
    """The silences of the store as they were at the last read."""

    name = "silences"

    def __init__(self, store: Store, clock: Clock) -> None:
        self._store = store
        self._clock = clock
        self._silences: Sequence[Silence] = []
        self._times = SilenceTimes()

    def covers(self, asset: str, now_us: int) -> bool:
        """Whether the alarms of an asset are not to be sent at a process time."""
        return self._times.covers(asset, now_us)

    def read(self) -> None:
        """Know what the store holds now.

        Raises `StoreUnavailableError` if the store does not answer; what was known still holds.
        """
        silences = self._store.part(Silences).load(self._clock.now_us())
        if silences != self._silences:
            self._silences, self._times = silences, SilenceTimes(silences)

    async def run(self) -> None:
        """Read until cancelled."""
        while True:
            await asyncio.sleep(READ_S)
            try:
                await to_thread.run_sync(self.read)
            except StoreUnavailableError:
                continue  # the health of the store says so
            except Exception:
                _log.exception("silences_failed")
