"""Pushed samples that wait on the disk of this web process for the cell of their asset."""

import asyncio
import sqlite3
import struct
import zlib
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Final, Self

import msgspec
import structlog
from anyio import to_thread

from adapters.samples import Sample
from service.bus.commands import HealthCheck
from service.bus.messages import encode
from service.bus.pushed_samples import PackedSamples
from service.domain.errors import BearingTwinError, CellUnavailableError, PushRefusedError
from service.store import DurableQueue, QueueFile, QueueLayout, QueueUnavailableError, Row
from service.store.closable import Closable
from service.store.queue_file import used_pages

FILE_NAME: Final = "pushes.db"
#: Wall seconds after which a push that found no room may come again, and between two tries to
#: hand over.
RETRY_AFTER_S: Final = 5
_RETRY_S: Final = 0.5
#: Pushes of one asset that are forgotten together once the cell has them, and assets at a time.
_BATCH: Final = 50
_AT_ONCE: Final = 8
_BYTES_PER_MIB: Final = 2**20
_APPLICATION_ID: Final = 0x4254_7075
_TABLES: Final = """
CREATE TABLE IF NOT EXISTS pushes (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    asset TEXT NOT NULL,
    received_us INTEGER NOT NULL,
    samples BLOB NOT NULL,
    checksum INTEGER
)
"""

HandOver = Callable[[str, PackedSamples, int], Awaitable[object]]
"""Gives samples of an asset, with the time at which they were received, to who stores them."""

_log = structlog.get_logger(__name__)
_samples = msgspec.msgpack.Decoder(PackedSamples)


class _FullError(BearingTwinError):
    """There is no room for more."""


class WaitingPushes(Closable):
    """A queue of pushes on the disk, handed over asset by asset, each in its order.

    A push is on the disk when `keep` returns, and stays there until the cell has it. What is handed
    over twice, after a kill in between, is stored once. All methods in one event loop. A push that
    finds no room of ``size_mib`` is refused.
    """

    def __init__(self, queue: DurableQueue, size_mib: int) -> None:
        self._queue = queue
        with queue.file.reading() as connection:
            page_bytes = int(connection.execute("PRAGMA page_size").fetchone()[0])
        self._pages_max = max(size_mib * _BYTES_PER_MIB // page_bytes, 16)
        self._new: list[tuple[Row, asyncio.Future[None]]] = []
        self._arriving: Counter[str] = Counter()
        self._writing = asyncio.Lock()
        self._something = asyncio.Event()
        self._numbers: dict[str, deque[int]] = {}
        self._is_mended = False
        queue.on_mended(self._note_mended)
        self._load()

    @classmethod
    def open(cls, data_dir: Path, size_mib: int) -> Self:
        """Open the queue of a data directory; pushes of an earlier run are still in it.

        Raises `StoreError` if the file can be neither opened nor made; one line that names it.
        """
        return cls(DurableQueue(QueueFile.open(data_dir / FILE_NAME, _LAYOUT)), size_mib)

    def __len__(self) -> int:
        """Pushes that wait."""
        return len(self._queue)

    def holds(self, asset: str) -> bool:
        """Whether earlier pushes of an asset wait: later ones go behind them."""
        return asset in self._numbers or self._arriving[asset] > 0

    def problem(self) -> HealthCheck:
        """Say what waits, as a check of the service."""
        count = len(self)
        if not count:
            return HealthCheck("pushes", "ok", "handed to the cells as they come")
        detail = f"{count} pushes wait on the disk of a web process for the cells of their assets"
        return HealthCheck("pushes", "degraded", detail)

    async def keep(self, asset: str, samples: Sequence[Sample], received_us: int) -> None:
        """Put a push at the end; when this returns it is on the disk.

        Raises `PushRefusedError` if there is no room, or the disk does not take it; then none of it
        is kept.
        """
        row = (asset, received_us, encode(PackedSamples.pack(samples)))
        kept: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._new.append((row, kept))
        self._arriving[asset] += 1
        # Who has gone meanwhile must not take those with it that share the transaction.
        writing = asyncio.ensure_future(self._write_all(kept))
        writing.add_done_callback(lambda done: done.cancelled() or done.exception())
        try:
            await asyncio.shield(writing)
        except _FullError:
            raise PushRefusedError(
                "no cell takes them, and the room on the disk for pushes that wait is used up",
                RETRY_AFTER_S,
            ) from None
        except QueueUnavailableError as error:
            raise PushRefusedError(f"no cell takes them, nor does the disk ({error})", 1) from error

    async def _write_all(self, kept: "asyncio.Future[None]") -> None:
        """Write what is new, one transaction for all that came while the one before was written."""
        async with self._writing:
            if not kept.done():
                portion, self._new = self._new, []
                rows = [row for row, _ in portion]
                try:
                    last = await to_thread.run_sync(self._append, rows)
                except Exception as error:
                    for _, future in portion:
                        future.set_exception(error)
                        future.exception()  # who has gone does not ask
                else:
                    for number, (row, future) in enumerate(portion, last - len(rows) + 1):
                        self._numbers.setdefault(row[0], deque()).append(number)
                        future.set_result(None)
                    self._something.set()
                finally:
                    self._arriving.subtract(row[0] for row in rows)
                    self._arriving = +self._arriving
        await kept

    def _append(self, rows: Sequence[Row]) -> int:
        self._queue.append(rows, self._require_room)
        with self._queue.file.reading() as connection:
            return int(connection.execute("SELECT MAX(number) FROM pushes").fetchone()[0])

    def _require_room(self, connection: sqlite3.Connection, _count: int) -> int:
        if used_pages(connection) > self._pages_max:
            raise _FullError
        return 0

    # ------------------------------------------------------------------ handing over
    async def run(self, hand_over: HandOver) -> None:
        """Hand over what waits, until cancelled.

        ``hand_over``: raises `CellUnavailableError` or `PushRefusedError` where it is to be tried
        again.
        """
        while True:
            await self._something.wait()
            self._something.clear()
            if self._is_mended:
                self._is_mended = False
                await to_thread.run_sync(self._load)
            limit = asyncio.Semaphore(_AT_ONCE)
            await asyncio.gather(
                *(self._hand_over(asset, hand_over, limit) for asset in list(self._numbers))
            )
            if self._numbers:
                await asyncio.sleep(_RETRY_S)
                self._something.set()

    async def _hand_over(self, asset: str, hand_over: HandOver, limit: asyncio.Semaphore) -> None:
        async with limit:
            try:
                while await self._hand_over_some(asset, hand_over):
                    pass
            except (CellUnavailableError, PushRefusedError):
                return  # it waits
            except Exception:
                # One asset that cannot be handed over must not hold up the others.
                _log.exception("push_not_handed_over", asset=asset)

    async def _hand_over_some(self, asset: str, hand_over: HandOver) -> bool:
        """Hand some pushes of an asset over; False when none is left."""
        numbers = self._numbers[asset]
        done: list[int] = []
        try:
            for number in list(numbers)[:_BATCH]:
                row = await to_thread.run_sync(self._queue.one, number)
                if row is None:
                    self._queue.note_damaged(1)
                else:
                    _, received_us, samples = row
                    await hand_over(asset, _samples.decode(samples), received_us)
                done.append(number)
        finally:
            if done:
                await to_thread.run_sync(self._queue.discard, done)
                for _ in done:
                    numbers.popleft()
                if not numbers:
                    self._numbers.pop(asset, None)
        return bool(numbers)

    def _load(self) -> None:
        numbers: dict[str, deque[int]] = {}
        with self._queue.file.reading() as connection:
            rows = connection.execute("SELECT number, asset FROM pushes ORDER BY number")
            for number, asset in rows.fetchall():
                numbers.setdefault(asset, deque()).append(number)
        self._numbers = numbers
        if numbers:
            self._something.set()

    def _note_mended(self) -> None:
        self._is_mended = True

    def close(self) -> None:
        """Close the file; what waits stays in it."""
        self._queue.close()


def _checksum(row: Row) -> int:
    asset, received_us, samples = row
    try:
        return zlib.crc32(samples, zlib.crc32(f"{asset}\0{received_us}".encode()))
    except (struct.error, TypeError, UnicodeEncodeError):
        return -1  # a damaged row has other kinds of values


def _salvage(row: Row) -> Row | None:
    asset, received_us, samples = row
    kinds: Collection[tuple[Any, type]] = ((asset, str), (received_us, int), (samples, bytes))
    return row if all(isinstance(value, kind) for value, kind in kinds) else None


_LAYOUT = QueueLayout(
    application_id=_APPLICATION_ID,
    tables=_TABLES,
    table="pushes",
    key="number",
    columns=("asset", "received_us", "samples"),
    checksum=_checksum,
    salvage=_salvage,
)
