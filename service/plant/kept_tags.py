"""The tags that a publisher's receiver keeps when the service has ended, in a file of their own."""

import asyncio
import contextlib
import math
import sqlite3
import sys
import time
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Final

import structlog

from service.files import make_private_file, make_private_folder
from service.live.guard import Guard

FILE_NAME: Final = "kept-tags.db"
_TABLE: Final = """
CREATE TABLE IF NOT EXISTS kept (
    receiver TEXT, asset TEXT, tag TEXT, PRIMARY KEY (receiver, asset, tag)
) WITHOUT ROWID
"""
#: Not longer: publishing waits for it.
_PATIENCE_S: Final = 0.5
#: After a failure the file is left alone for so long.
_PAUSE_S: Final = 10.0
_NOTE: Final = "INSERT OR IGNORE INTO kept VALUES (?, ?, ?)"
_FORGET: Final = "DELETE FROM kept WHERE receiver = ? AND asset = ? AND tag = ?"
_Rows = list[tuple[str, str, str]]

_log = structlog.get_logger(__name__)


class KeptTags:
    """What a receiver may still have: a later process withdraws what is gone, and nothing else.

    A tag is noted before it is handed on, until it is withdrawn. What is noted of one receiver
    counts for that one only. Where the file cannot be used that is logged, and publishing goes on.

    Parameters
    ----------
    folder : Path
        Of the publisher, in the data directory.
    publisher : str
        Its name, for the log.
    receiver : str
        Names who keeps the tags.

    Attributes
    ----------
    is_read : bool
        Whether what earlier processes have noted is known.
    """

    def __init__(self, folder: Path, publisher: str, receiver: str) -> None:
        self._path = folder / FILE_NAME
        self._publisher = publisher
        self._receiver = receiver
        self._noted: dict[str, set[str]] = {}
        self._guard = Guard(f"{publisher}_kept_tags", "")
        self._paused_until_s = -math.inf
        self.is_read = False

    async def read(self) -> Mapping[str, Collection[str]]:
        """Give the tags by asset; none where the file cannot be read yet."""
        with self._attempt() as may:
            if may:
                self._noted = await asyncio.to_thread(self._read)
                self.is_read = True
        return self._noted if self.is_read else {}

    async def add(self, tags: Mapping[str, Collection[str]]) -> None:
        """Note tags, by asset; what could not be noted is tried again with the next ones."""
        new = {
            asset: left
            for asset, names in tags.items()
            if (left := {*names} - self._noted.get(asset, set()))
        }
        if not new:
            return
        with self._attempt() as may:
            if not may:
                return
            await asyncio.to_thread(self._write, _NOTE, self._rows(new))
            for asset, names in new.items():
                # Thousands of assets have tags of the same names.
                self._noted.setdefault(asset, set()).update(map(sys.intern, names))

    async def remove(self, asset: str, tags: Collection[str]) -> None:
        """Forget tags that the receiver does not have any more."""
        with self._attempt() as may:
            if may:
                await asyncio.to_thread(self._write, _FORGET, self._rows({asset: tags}))
        # Also where they are still in the file: should they come again they are noted again.
        noted = self._noted.get(asset, set())
        noted.difference_update(tags)
        if not noted:
            self._noted.pop(asset, None)

    @contextlib.contextmanager
    def _attempt(self) -> Iterator[bool]:
        """Guard the use of the file; not while it is left alone after a failure."""
        if time.monotonic() < self._paused_until_s:
            yield False
            return
        with self._guard():
            yield True
        if self._guard.failing:
            self._paused_until_s = time.monotonic() + _PAUSE_S

    def _rows(self, tags: Mapping[str, Collection[str]]) -> _Rows:
        return [(self._receiver, asset, name) for asset, names in tags.items() for name in names]

    def _read(self) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        try:
            with self._opened() as connection:
                sql = "SELECT asset, tag FROM kept WHERE receiver = ?"
                for asset, tag in connection.execute(sql, (self._receiver,)):
                    found.setdefault(asset, set()).add(sys.intern(tag))
        except sqlite3.OperationalError:
            raise  # the state of the disk: the file may be whole
        except sqlite3.DatabaseError as error:
            self._path.unlink()
            _log.warning(
                f"{self._publisher}_kept_tags_damaged", file=str(self._path), reason=str(error)
            )
            return {}
        return found

    def _write(self, sql: str, rows: _Rows) -> None:
        with self._opened() as connection:
            connection.executemany(sql, rows)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Open the file for one transaction: there are few, and none is open when we are killed."""
        make_private_folder(self._path.parent)
        make_private_file(self._path)
        with contextlib.closing(sqlite3.connect(self._path, _PATIENCE_S)) as connection, connection:
            connection.execute(_TABLE)
            yield connection
