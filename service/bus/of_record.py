"""Which cell owns which partition: the database decides, whatever a message claims."""

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Final

import structlog

from service.bus.nats_bus import token_of
from service.store import StoreUnavailableError

#: Wall seconds between two looks into the database for who owns what is claimed.
_LOOK_EVERY_S: Final = 0.25
#: And where what is claimed is older than what is known: mostly by a cell that has lost it, but the
#: database may be an older copy of itself.
_LOOK_AGAIN_EVERY_S: Final = 2.0

_log = structlog.get_logger(__name__)


class OwnersOfRecord:
    """Epoch and cell of each partition as the database had them when a cell claimed others.

    Parameters
    ----------
    read : callable
        Reads epoch and owner of each partition from the database.
    """

    def __init__(self, read: Callable[[], Awaitable[Mapping[int, tuple[int, str]]]]) -> None:
        self._read = read
        self._known: dict[int, tuple[int, str]] = {}
        self._is_claimed = asyncio.Event()
        self._claiming: set[str] = set()
        self._read_s = -math.inf

    def has(self, cell: str, partition: int, epoch: int) -> bool:
        """Whether a partition is a cell's with this epoch."""
        return self._known.get(partition) == (epoch, cell)

    def take_claim(self, cell: str, partitions: Mapping[int, int]) -> None:
        """Have the database asked where a cell claims what is not known to be its own."""
        looks_again = asyncio.get_running_loop().time() - self._read_s > _LOOK_AGAIN_EVERY_S
        if any(
            (looks_again or epoch >= self._known.get(partition, (-1, ""))[0])
            and not self.has(cell, partition, epoch)
            for partition, epoch in partitions.items()
        ):
            self._claiming.add(cell)
            self._is_claimed.set()

    async def run(self, on_change: Callable[[], None]) -> None:
        """Ask the database as often as something is claimed, until cancelled."""
        reported: set[str] = set()
        while True:
            await self._is_claimed.wait()
            self._is_claimed.clear()
            claiming, self._claiming = self._claiming, set()
            self._read_s = asyncio.get_running_loop().time()
            try:
                rows = await self._read()
            except StoreUnavailableError:
                rows = {}  # no one can take anything over meanwhile; the claim comes again
            before = self._known
            self._known = before | {
                partition: (epoch, token_of(owner)) for partition, (epoch, owner) in rows.items()
            }
            if self._known != before:
                on_change()
            elif rows and claiming - reported:
                _log.warning("partitions_of_others_claimed", cells=sorted(claiming - reported))
                reported |= claiming
            await asyncio.sleep(_LOOK_EVERY_S)
