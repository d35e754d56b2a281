"""What PostgreSQL says of the partitions, and a trigger in it that witnesses who writes."""

import asyncio
import contextlib
import time
from collections.abc import Collection, Mapping
from typing import Any, Final

import psycopg

from service.demo.processes import DemoError

LOOK_EVERY_S: Final = 0.1
#: A busy machine takes its time.
_PATIENCE_S: Final = 600.0

# Every kept state of a twin leaves a line: who wrote it, and whose partition it was then.
_TRIGGER = """
CREATE TABLE demo_partitions (asset text PRIMARY KEY, partition integer NOT NULL);
CREATE TABLE demo_witness (
    number bigserial PRIMARY KEY, asset text, writer text, owner text, epoch integer,
    at timestamptz DEFAULT clock_timestamp());
CREATE FUNCTION demo_witness() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO demo_witness (asset, writer, owner, epoch)
    SELECT NEW.asset, current_setting('application_name'), owner, epoch
    FROM demo_partitions JOIN partitions ON partitions.id = demo_partitions.partition
    WHERE demo_partitions.asset = NEW.asset;
    RETURN NEW;
END $$;
CREATE TRIGGER demo_witness AFTER INSERT ON asset_states
FOR EACH ROW EXECUTE FUNCTION demo_witness();
"""
_STALE = """
SELECT count(*) FROM (
    SELECT writer, owner, epoch, lag(epoch) OVER (PARTITION BY asset ORDER BY number) AS before
    FROM demo_witness) AS lines
WHERE writer <> owner OR epoch < before
"""
_OWNERS = """
SELECT id, owner, EXISTS (
    SELECT FROM pg_locks WHERE locktype = 'advisory' AND granted AND objsubid = 2
    AND classid = (SELECT %s::bigint)::oid AND objid = partitions.id::oid)
FROM partitions
"""


class Witness:
    """Looks at the partitions from outside, on a connection of its own.

    - ``url``: of the database.
    - ``locks``: first number of the advisory locks of the partitions.

    - ``longest_s``: longest time in which a partition had no owner that lives.
    """

    def __init__(self, url: str, locks: int) -> None:
        self.longest_s = 0.0
        self._url = url
        self._locks = locks
        self._connection: psycopg.AsyncConnection[Any] | None = None

    async def prepare(self, partitions: Mapping[str, int]) -> None:
        """Set the trigger up; knows the partition of each asset."""
        connection = await self._open()
        await connection.execute(_TRIGGER)
        async with connection.cursor() as cursor:
            await cursor.executemany(
                "INSERT INTO demo_partitions VALUES (%s, %s)", list(partitions.items())
            )

    async def stale_writes(self) -> int:
        """States written by who did not own the asset, or with an epoch before a newer one."""
        return int((await self._rows(_STALE))[0][0])

    async def states_written(self) -> int:
        """Kept states that the trigger has seen."""
        return int((await self._rows("SELECT count(*) FROM demo_witness"))[0][0])

    async def last_written_by(self, run: str) -> int:
        """Number of the last line of a run of a cell, 0 where there is none."""
        query = "SELECT coalesce(max(number), 0) FROM demo_witness WHERE writer = %s"
        return int((await self._rows(query, run))[0][0])

    async def owners(self) -> dict[int, str]:
        """Owner by partition of those that have one: its row, and its lock.

        Raises `psycopg.Error` if the server does not answer.
        """
        rows = await self._rows(_OWNERS, self._locks)
        return {id: owner if locked else "" for id, owner, locked in rows}

    async def until_owned(self, gone: Collection[str] = (), least_cells: int = 1) -> float:
        """Wait until every partition has a living owner; wall seconds that it took.

        - ``gone``: runs that were killed or stopped: what they hold has no owner.
        - ``least_cells``: so many different owners.
        """
        began_s = time.monotonic()
        while (passed_s := time.monotonic() - began_s) < _PATIENCE_S:
            with contextlib.suppress(psycopg.Error):
                owners = set((await self.owners()).values()) or {""}
                if not owners & {"", *gone} and len(owners) >= least_cells:
                    passed_s = time.monotonic() - began_s
                    return passed_s
            await asyncio.sleep(LOOK_EVERY_S)
        raise DemoError(f"partitions without an owner for {_PATIENCE_S:g} s")

    async def close(self) -> None:
        """Close the connection."""
        if self._connection is not None:
            await self._connection.close()

    async def _open(self) -> psycopg.AsyncConnection[Any]:
        if self._connection is None or self._connection.closed or self._connection.broken:
            self._connection = await psycopg.AsyncConnection.connect(
                self._url, autocommit=True, connect_timeout=5, application_name="fleet demo"
            )
        return self._connection

    async def _rows(self, query: str, *values: object) -> list[Any]:
        connection = await self._open()
        # The text is one of those above.
        found = await connection.execute(query.encode(), values or None)
        return await found.fetchall()
